import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import modal.pipeline
import modal.recording
from modal.command import _status, app
from modal.command_options import plain_name

COMMAND = [sys.executable, "-c", "from modal.command import main; main()"]
HERE = Path(modal.pipeline.__file__).parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(HERE), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def run(*arguments, cwd):
    return subprocess.run(
        [*COMMAND, *map(str, arguments)],
        cwd=cwd,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture
def data(tmp_path):
    """A folder with files, good and bad."""
    folder = tmp_path / "data"
    folder.mkdir()
    rng = np.random.default_rng(3)
    table = np.column_stack([0.01 * np.arange(400), rng.standard_normal((400, 2))])
    write = lambda name, rows, header="time [s],force [N],tip [m]": np.savetxt(  # noqa: E731
        folder / name, rows, delimiter=",", header=header, comments=""
    )
    write("good.csv", table)
    write("short.csv", table[:6])
    write("nan.csv", np.where(np.arange(3) == 2, np.nan, table))
    write("constant.csv", np.where(np.arange(3) == 1, 2.5, table))
    write("wide.csv", rng.standard_normal((5, 9)), "force," + ",".join(f"y{i}" for i in range(8)))
    (folder / "text.csv").write_text("time [s],force [N],tip [m]\n0,1,2\n0.01,hello,3\n0.02,1,2\n")
    (folder / "prose.csv").write_text("Dear colleague,\nplease find the data attached.\n")
    (folder / "empty.csv").write_text("")
    (folder / "truncated.npz").write_bytes(b"PK\x03\x04" + bytes(40))
    (folder / "truncated.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(60))
    np.savez(folder / "complex.npz", time=table[:, 0], tip=1j * table[:, 1])
    np.savez(folder / "pickle.npz", force=np.array([{"a": 1}], dtype=object), tip=np.zeros(1))
    return folder


BAD = [
    ("nofile.csv", "--inputs", "force"),
    (".", "--inputs", "force"),
    ("good.csv", "--inputs", "wind"),
    ("good.csv", "--inputs", "force", "--outputs", "wind"),
    ("good.csv", "--inputs", ""),
    ("good.csv", "--inputs", "force", "--outputs", ","),
    ("x" * 5000 + ".csv", "--inputs", "force"),
    ("/dev/null", "--inputs", "force"),
    ("complex.npz", "--dt", "1"),
    ("good.csv", "--inputs", "force", "--dt", "-1"),
    ("wide.csv", "--inputs", "force", "--dt", "1e-320"),
    ("wide.csv", "--inputs", "force", "--dt", "1e300"),
    ("good.csv", "--inputs", "force", "--order", "none"),
    ("good.csv", "--inputs", "force", "--observer-order", "0"),
    ("good.csv", "--inputs", "force", "--ridge", "-1"),
    ("good.csv", "--inputs", "force", "--ridge", "nan"),
    ("good.csv", "--inputs", "force", "--hold", "sometimes"),
    ("good.csv", "--inputs", "force", "--no-such-option"),
    ("text.csv", "--inputs", "force"),
    ("prose.csv", "--inputs", "force"),
    ("empty.csv", "--inputs", "force"),
    ("nan.csv", "--inputs", "force"),
    ("constant.csv", "--inputs", "force"),
    ("short.csv", "--inputs", "force"),
    ("wide.csv", "--inputs", "force", "--dt", "0.01"),
    ("truncated.npz", "--inputs", "force", "--dt", "0.01"),
    ("truncated.mat", "--inputs", "force", "--dt", "0.01"),
    ("pickle.npz", "--inputs", "force", "--dt", "0.01"),
]


def one_sentence(text):
    lines = text.strip().splitlines()
    return (
        len(lines) == 1
        and lines[0].startswith("modal-report: ")
        and lines[0].endswith((".", "?"))
        and "Traceback" not in text
    )


@pytest.mark.parametrize("arguments", BAD, ids=" ".join)
def test_bad_input_is_one_sentence_and_nothing_written(data, arguments, capsys, monkeypatch):
    monkeypatch.chdir(data)
    before = sorted(data.iterdir())
    status = _status(["run", *arguments, "-o", str(data / "out")])
    captured = capsys.readouterr()
    assert status == 2, captured
    assert one_sentence(captured.err), captured.err
    assert captured.out == ""
    assert sorted(data.iterdir()) == before


def test_bad_input_in_a_process_of_its_own(data):
    for arguments in (("nofile.csv", "--inputs", "force"), ("text.csv", "--inputs", "force")):
        result = run("run", *arguments, cwd=data)
        assert result.returncode == 2
        assert one_sentence(result.stderr), result.stderr
        assert result.stdout == ""


@pytest.fixture
def quick(monkeypatch, identification):
    """The identification replaced by the hand-made result, the recording by a stub: the command itself is tested."""
    state = {"result": identification, "calls": []}

    def identify(records, **options):
        state["calls"].append((records, options))
        if isinstance(state["result"], BaseException):
            raise state["result"]
        return state["result"]

    monkeypatch.setattr(modal.pipeline, "identify", identify)
    monkeypatch.setattr("modal.identify", identify)
    monkeypatch.setattr(modal.recording, "save_recording", lambda _result, path: path.write_bytes(b"rrd"))
    monkeypatch.setattr("modal.report.writing.draw_pictures", lambda _result: {})
    return state


def invoke(*arguments):
    return CliRunner().invoke(app, ["run", *map(str, arguments)])


def test_a_good_run_writes_the_report_and_says_where(data, quick):
    result = invoke(data / "good.csv", "--inputs", "force", "-o", data / "out")
    assert result.exit_code == 0, result.output
    assert "Three modes of the system were found" in result.stdout
    assert str(data / "out" / "report.html") in result.stdout
    assert result.stderr == ""
    assert len(list((data / "out").iterdir())) == 5


def test_the_folder_has_the_name_of_the_file_unless_given(data, quick, monkeypatch):
    monkeypatch.chdir(data)
    assert invoke("good.csv", "--inputs", "force").exit_code == 0
    assert (data / "modal-report-good" / "report.html").is_file()


def test_a_folder_that_cannot_be_is_refused_before_any_work(data, quick):
    for folder in ("good.csv", "good.csv/below", "x" * 5000):
        result = invoke(data / "good.csv", "--inputs", "force", "-o", data / folder)
        assert result.exit_code == 2
        assert one_sentence(result.stderr), result.stderr
    assert quick["calls"] == []


def test_every_file_is_read_once(data, quick, monkeypatch):
    import okid.readers

    read, seen = okid.readers.read_table, []
    monkeypatch.setattr(okid.readers, "read_table", lambda path: seen.append(path) or read(path))
    monkeypatch.setattr("okid.readers.description.read_table", lambda path: seen.append(path) or read(path))
    assert invoke(data / "good.csv", "--inputs", "force", "-o", data / "out").exit_code == 0
    assert seen == [data / "good.csv"]


def test_channels_and_overrides_reach_the_work(data, quick):
    result = invoke(
        data / "good.csv",
        "--inputs",
        "force",
        "--order",
        "6",
        "--ridge",
        "1e-3",
        "--observer-order",
        "auto",
        "-o",
        data / "out",
    )
    assert result.exit_code == 0, result.output
    ((records, options),) = quick["calls"]
    assert records[0].input_names == ("force",)
    assert records[0].output_names == ("tip",)
    assert (options["order"], options["ridge"], options["observer_order"]) == (6, 1e-3, "auto")


@pytest.mark.parametrize("case", [(0.49, 3, 1), (0.51, 3, 0), (0.97, 0, 1), (0.97, 1, 0)])
def test_exit_status_says_whether_the_data_carry_it(data, quick, identification, case):
    fit, n_system, status = case
    modes = replace(identification.modes, modes=identification.modes.modes[3 - n_system :])
    fits = replace(identification.fit, cross_validated=np.full(3, fit))
    quick["result"] = replace(identification, modes=modes, fit=fits)
    result = invoke(data / "good.csv", "--inputs", "force", "-o", data / "out")
    assert result.exit_code == status
    assert (data / "out" / "report.html").is_file()
    assert ("do not carry" in result.stdout) == (status == 1)


def test_an_existing_report_is_never_overwritten_unasked(data, quick):
    out = data / "out"
    out.mkdir()
    (out / "report.html").write_text("mine")
    result = invoke(data / "good.csv", "--inputs", "force", "-o", out)
    assert result.exit_code == 2
    assert one_sentence(result.stderr)
    assert quick["calls"] == []
    assert [path.name for path in out.iterdir()] == ["report.html"]
    assert invoke(data / "good.csv", "--inputs", "force", "-o", out, "--overwrite").exit_code == 0
    assert "mine" not in (out / "report.html").read_text(encoding="utf-8")


def test_the_report_does_not_depend_on_its_folder(data, quick):
    for folder in ("one", "two"):
        invoke(data / "good.csv", "--inputs", "force", "-o", data / folder)
    for name in ("report.html", "report.md", "report.json", "modes.csv"):
        assert (data / "one" / name).read_bytes() == (data / "two" / name).read_bytes()


def test_the_report_tells_the_command(data, quick, monkeypatch):
    monkeypatch.chdir(data)
    invoke("good.csv", "--inputs", "force", "--hold", "linear", "-o", "out")
    text = (data / "out" / "report.md").read_text(encoding="utf-8")
    assert "    modal-report run good.csv --inputs force --hold linear\n" in text


def test_the_python_of_the_report_runs(data, quick, monkeypatch):
    monkeypatch.chdir(data)
    np.savetxt(
        "step.csv", np.random.default_rng(2).standard_normal((50, 2)), delimiter=",", header="force,tip", comments=""
    )
    result = invoke("step.csv", "--inputs", "force", "--dt", "0.01", "-o", "out")
    assert result.exit_code == 0, result.output
    text = (data / "out" / "report.md").read_text(encoding="utf-8")
    code = "\n".join(line[4:] for line in text[text.index("    import modal") :].splitlines())
    code = code.replace("floor_1", "tip").replace(", 'floor_2', 'floor_3'", "").replace("'ground'", "'force'")
    exec(compile(code, "snippet", "exec"), {})  # noqa: S102 - the page's own words
    assert (data / "report" / "report.html").is_file()
    assert len(quick["calls"]) == 2


def test_an_unknown_unit_is_said_once(data, quick):
    table = np.column_stack([0.01 * np.arange(50), np.random.default_rng(1).standard_normal((50, 2))])
    for name in ("a.csv", "b.csv"):
        np.savetxt(data / name, table, delimiter=",", header="time [s],force [counts],tip [g]", comments="")
    result = invoke(data / "a.csv", data / "b.csv", "--inputs", "force", "-o", data / "out")
    assert result.exit_code == 0, result.output
    words = " ".join(result.stdout.split())
    assert words.count("'counts'") == 1
    assert words.count("standard gravity") == 1


def test_an_interrupt_leaves_nothing(data, quick, capsys):
    before = sorted(data.iterdir())
    quick["result"] = KeyboardInterrupt()
    assert _status(["run", str(data / "good.csv"), "--inputs", "force", "-o", str(data / "out")]) == 130
    assert one_sentence(capsys.readouterr().err)
    assert sorted(data.iterdir()) == before


def test_a_fault_of_ours_is_one_sentence_that_tells_how_to_see_more(data, quick, capsys):
    quick["result"] = ZeroDivisionError("nobody expects\nit")
    arguments = ["run", str(data / "good.csv"), "--inputs", "force", "-o", str(data / "out")]
    assert _status(arguments) == 3
    error = capsys.readouterr().err
    assert one_sentence(error)
    assert "--traceback" in error
    with pytest.raises(ZeroDivisionError):
        _status([*arguments, "--traceback"])
    assert not (data / "out").exists()


def test_an_interrupted_process_leaves_nothing(tmp_path):
    process = subprocess.Popen(
        [*COMMAND, "demo", "-o", "out"],
        cwd=tmp_path,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    assert one_sentence(error), error
    assert list(tmp_path.iterdir()) == []


def test_version_tells_the_path_in_use(tmp_path):
    result = run("--version", cwd=tmp_path)
    assert result.returncode == 0
    assert str(HERE / "modal") in result.stdout


def test_help_is_quick_and_loads_nothing_heavy(tmp_path):
    code = (
        "import sys\nfrom modal.command import app\n"
        "app(['--help'], standalone_mode=False)\n"
        "heavy = {'rerun', 'matplotlib', 'control', 'jinja2', 'pint', 'pyarrow'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, cwd=tmp_path, check=True, capture_output=True)


@pytest.mark.parametrize("command", [[], ["run"], ["demo"], ["gap"]])
def test_help_shows_an_example(command):
    result = CliRunner().invoke(app, [*command, "--help"])
    assert result.exit_code == 0
    assert "modal-report" in result.stdout or "Usage" in result.stdout


@pytest.mark.parametrize("command", [[], ["run"], ["demo"], ["gap"]])
def test_help_asks_for_no_value_of_a_switch(command):
    lines = CliRunner().invoke(app, [*command, "--help"], env={"COLUMNS": "200"}).stdout.splitlines()
    ours = [line for line in lines if re.search(r"--(version|overwrite|traceback)\b", line)]
    assert ours
    assert not any("<" in line for line in ours)


@pytest.mark.parametrize(
    ("stem", "safe"),
    [("test 1", "test_1"), ("../../etc", "etc"), ("...", "result"), ("a\x1bb", "a_b"), ("x" * 300, "x" * 80)],
)
def test_default_folder_is_a_plain_name(stem, safe):
    assert plain_name(stem) == safe
