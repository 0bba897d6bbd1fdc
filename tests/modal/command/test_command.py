import contextlib
import hashlib
import itertools
import json
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
import scipy
from typer.main import get_command
from typer.testing import CliRunner

import modal.identification.pipeline
import modal.recording
from modal.command.main import app
from modal.command.main import status as _status
from modal.command.options import plain_name, spread_files
from modal.command.run import chosen_point
from modal.comparison.shifts import read_result
from okid.record import Record

COMMAND = [sys.executable, "-c", "from modal.command.entry import main; main()"]
HERE = Path(modal.identification.pipeline.__file__).parents[2]
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
    result = run("run", "text.csv", "--inputs", "force", cwd=data)
    assert (result.returncode, result.stdout) == (2, "")
    assert one_sentence(result.stderr), result.stderr


@pytest.fixture
def quick(monkeypatch, identification):
    """The identification replaced by the hand-made result, the recording by a stub: the command itself is tested."""
    state = {"result": identification, "calls": []}

    def identify(records, **options):
        state["calls"].append((records, options))
        if isinstance(state["result"], BaseException):
            raise state["result"]
        return state["result"]

    monkeypatch.setattr("modal.command.run.identify", identify)
    monkeypatch.setattr("modal.identify", identify)
    monkeypatch.setattr(modal.recording, "save_recording", lambda _result, path, **_options: path.write_bytes(b"rrd"))
    monkeypatch.setattr("modal.report.writing.draw_pictures", lambda _result, _setting: {})
    return state


def invoke(*arguments):
    return CliRunner().invoke(app, ["run", *map(str, arguments)])


def test_a_good_run_writes_the_report_and_says_where(data, quick):
    result = invoke(data / "good.csv", "--inputs", "force", "-o", data / "out")
    assert result.exit_code == 0, result.output
    assert "Three modes of the system were found" in result.stdout
    assert str(data / "out" / "report.html") in result.stdout
    assert result.stderr == ""
    assert sorted(path.name for path in (data / "out").iterdir()) == [
        *("modes.csv", "modes.uff", "recording.rrd", "report.html", "report.json", "report.md", "report.schema.json"),
        "result.npz",
    ]


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
    monkeypatch.setattr("okid.readers.dispatch.read_table", lambda path: seen.append(path) or read(path))
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


@pytest.mark.parametrize("case", [(0.49, 3, 0), (0.51, 3, 0), (0.97, 0, 1), (0.97, 1, 0)])
def test_exit_status_says_whether_the_data_carry_it(data, quick, identification, case):
    fit, n_system, status = case
    modes = replace(identification.modes, modes=identification.modes.modes[3 - n_system :])
    fits = replace(identification.fit, cross_validated=np.full(3, fit))
    quick["result"] = replace(identification, modes=modes, fit=fits)
    result = invoke(data / "good.csv", "--inputs", "force", "-o", data / "out")
    assert result.exit_code == status
    assert (data / "out" / "report.html").is_file()
    assert ("Not reliable" in result.stdout) == (status == 1)


@pytest.mark.parametrize(
    "words",
    [
        ["run", "gone.csv"],
        ["check", "gone.csv"],
        ["batch", "gone.csv", "-o", "out"],
        ["batch", "gone.csv", "gone_too.csv", "-o", "out"],
        ["track", "gone"],
        ["diff", "gone", "gone_too"],
        ["live", "gone.csv", "--inputs", "force"],
        ["gap", "gone.toml", "--fit", "gone.csv", "--held-out", "gone_too.csv"],
        ["view", "gone"],
    ],
    ids=" ".join,
)
def test_a_path_that_is_not_there_is_one_sentence_and_leaves_nothing(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    said = result.stderr.strip().replace("modal-report: ", "")
    assert "gone" in said or "none of the 2 files" in said
    assert said.count("\n") == 0
    assert not list(tmp_path.iterdir())


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
    lines = text[text.index("    import modal") :].splitlines()
    code = "\n".join(line[4:] for line in itertools.takewhile(lambda line: not line or line.startswith("    "), lines))
    code = code.replace("floor_1", "tip").replace(", 'floor_2', 'floor_3'", "").replace("'ground'", "'force'")
    exec(compile(code, "snippet", "exec"), {})  # noqa: S102 - the page's own words
    assert (data / "report" / "report.html").is_file()
    assert len(quick["calls"]) == 2


def test_an_unknown_unit_is_said_once(data, quick):
    table = np.column_stack([0.01 * np.arange(50), np.random.default_rng(1).standard_normal((50, 2))])
    for name, sign in (("a.csv", 1.0), ("b.csv", -1.0)):
        rows = table * [1.0, sign, sign]
        np.savetxt(data / name, rows, delimiter=",", header="time [s],force [counts],tip [g]", comments="")
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


WAITING = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it for what runs in its background
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it
import modal.identification.pipeline, modal.recording

def waiting(*_arguments, **_options):
    print("READY", flush=True)
    time.sleep(60)

if {stage!r} == "identify":
    identify = modal.identification.pipeline.identify
    def announced(*arguments, **options):
        print("READY", flush=True)
        return [identify(*arguments, **options) for _ in range(20)]
    modal.identification.pipeline.identify = announced
else:
    from modal.identification.result import load
    modal.identification.pipeline.identify = lambda *_arguments, **_options: load("result.npz")
    modal.recording.save_recording = waiting
from modal.command.entry import main
sys.argv[1:] = {arguments!r}
main()
"""


def stopped(cwd, number, *, stage, arguments):
    """Exit status and stderr of a process that gets a signal while it works."""
    code = WAITING.format(stage=stage, arguments=arguments)
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=cwd,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    if process.stdout.readline() != "READY\n":
        pytest.fail(process.communicate(timeout=60)[1])
    time.sleep(0.3)
    process.send_signal(number)
    time.sleep(0.05)
    process.send_signal(number)  # a second one, while it clears up
    _, error = process.communicate(timeout=60)
    return process.returncode, error


def test_a_process_stopped_while_it_identifies_leaves_nothing(tmp_path):
    status, error = stopped(tmp_path, signal.SIGINT, stage="identify", arguments=["demo", "-o", "new/out"])
    assert status == 130, error
    assert one_sentence(error), error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)])
def test_a_process_stopped_while_it_writes_leaves_an_old_report_as_it_was(tmp_path, number, identification):
    identification.save(tmp_path / "result.npz")
    old = {f"report.{ending}": f"old {ending}" for ending in ("html", "json")}
    (tmp_path / "out").mkdir()
    for name, text in old.items():
        (tmp_path / "out" / name).write_text(text)
    status, error = stopped(tmp_path, number, stage="write", arguments=["demo", "-o", "out", "--overwrite"])
    assert status == 130, error
    assert one_sentence(error), error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "result.npz"]
    assert {path.name: path.read_text() for path in (tmp_path / "out").iterdir()} == old


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["rnu"], "No such command 'rnu'. Did you mean 'run'? See modal-report --help."),
        (["view"], "Missing argument 'RESULT'; see modal-report view --help."),
        (["diff", "a", "b", "--otu"], "see modal-report diff --help."),
        (["--nope"], "see modal-report --help."),
    ],
)
def test_wrong_use_names_the_help_that_helps(arguments, words, capsys):
    assert _status(arguments) == 2
    error = capsys.readouterr().err
    assert words in error
    assert one_sentence(error)


def test_version_tells_the_path_in_use(tmp_path):
    result = run("--version", cwd=tmp_path)
    assert result.returncode == 0
    assert str(HERE / "modal") in result.stdout


def test_help_is_quick_and_loads_nothing_heavy(tmp_path):
    code = (
        "import sys\nfrom modal.command.main import app\n"
        "app(['--help'], standalone_mode=False)\n"
        "heavy = {'rerun', 'matplotlib', 'control', 'jinja2', 'pint', 'pyarrow'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, cwd=tmp_path, check=True, capture_output=True)


COMMANDS = ["run", "demo", "check", "gap", "diff", "view", "batch", "track", "live"]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_examples_that_the_command_accepts(command):
    result = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"})
    assert result.exit_code == 0
    lines = [line.strip() for line in result.stdout.split("Examples")[1].splitlines()]
    examples = [line for line in lines if line.startswith("modal-report ")]
    assert examples
    for example in examples:
        words = example.split()[1:]
        parsed = spread_files(words[1:], ("--fit", "--held-out")) if words[0] == "gap" else words[1:]
        get_command(app).commands[words[0]].make_context(words[0], list(parsed), resilient_parsing=False)


def test_the_root_help_names_every_command():
    text = CliRunner().invoke(app, ["--help"]).stdout
    assert all(f" {command} " in text for command in COMMANDS)
    assert "--install-completion" in text


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("modal-report ", set(COMMANDS)),
        ("modal-report run --h", {"--hold", "--help"}),
        ("modal-report run --hold z", {"zero_order"}),
        ("modal-report gap --catalogue gap_spring,coul", {"gap_spring,coulomb_friction"}),
    ],
)
def test_the_shell_completes(typed, offered, tmp_path):
    shell = {"_MODAL_REPORT_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    result = CliRunner().invoke(app, [], prog_name="modal-report", env=shell)
    assert set(result.stdout.split()) == offered
    if offered == set(COMMANDS):  # and as the shell does it
        process = subprocess.run(COMMAND, env=ENVIRONMENT | shell, cwd=tmp_path, capture_output=True, check=True)
        assert set(process.stdout.decode().split()) == offered


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


# --- test file, geometry, PDF ----------------------------------------------------------------------------------------

MET = '[[limits]]\nkind = "n_modes"\nat_least = 2\n'
NOT_MET = '[[limits]]\nkind = "n_modes"\nat_least = 9\n'
UNTOLD = '[[limits]]\nkind = "mode"\nfrequency = [3.0, 4.0]\n'  # the hand-made result knows no deviations


@pytest.mark.parametrize(("limits", "status"), [("", 0), (MET, 0), (MET + NOT_MET, 1), (MET + UNTOLD, 1)])
def test_limits_of_acceptance_decide_the_exit_status(data, quick, limits, status):
    (data / "test.toml").write_text('article = "frame"\n' + limits)
    result = invoke(data / "good.csv", "--inputs", "force", "--test", data / "test.toml", "-o", data / "out")
    assert result.exit_code == status, result.output
    assert ("Acceptance" in result.stdout) == bool(limits)
    assert ("not met" in result.stdout) == (NOT_MET in limits)
    assert ("cannot be told" in result.stdout) == (UNTOLD in limits)
    assert "frame" in (data / "out" / "report.html").read_text(encoding="utf-8")


def test_the_report_of_a_test_can_be_made_again(data, quick, monkeypatch):
    monkeypatch.chdir(data)
    (data / "test.toml").write_text(MET)
    (data / "frame.toml").write_text("[nodes]\n1 = [0, 0, 0]\n2 = [0, 0, 1]\n[sensors]\nfloor_1 = '2X+'\n")
    result = invoke("good.csv", "--inputs", "force", "--test", "test.toml", "--geometry", "frame.toml", "-o", "out")
    assert result.exit_code == 0, result.output
    document = json.loads((data / "out" / "report.json").read_text(encoding="utf-8"))
    assert document["command"] == "modal-report run good.csv --inputs force --test test.toml --geometry frame.toml"
    assert [one["name"] for one in document["files"]] == ["good.csv", "test.toml", "frame.toml"]
    assert document["files"][0]["sha256"] == hashlib.sha256((data / "good.csv").read_bytes()).hexdigest()
    assert document["sources"] == ["good.csv"]
    text = (data / "out" / "report.md").read_text(encoding="utf-8")
    assert "gap MODEL.toml --fit good.csv --held-out SECOND.csv " in text
    assert "    okid.read_records(\n" not in text
    assert "records = okid.read_records(\n        ['good.csv'],\n" in text


def test_a_measured_file_is_never_replaced(data, quick, monkeypatch):
    out = data / "out"
    out.mkdir()
    rng = np.random.default_rng(3)
    np.savez(out / "result.npz", force=rng.standard_normal(400), tip=rng.standard_normal(400))
    before = (out / "result.npz").read_bytes()
    result = invoke(out / "result.npz", "--inputs", "force", "--dt", "0.01", "-o", out, "--overwrite")
    assert result.exit_code == 2, result.output
    assert "would replace a file that is read" in result.stderr
    assert one_sentence(result.stderr), result.stderr
    assert quick["calls"] == []
    assert [path.name for path in out.iterdir()] == ["result.npz"]
    assert (out / "result.npz").read_bytes() == before
    assert invoke(data / "good.csv", "--inputs", "force", "-o", out, "--overwrite").exit_code == 0


def test_a_report_of_another_kind_is_not_replaced_in_part(data, quick):
    out = data / "out"
    out.mkdir()
    for name in ("report.json", "findings.csv", "model.json"):
        (out / name).write_text("old")
    result = invoke(data / "good.csv", "--inputs", "force", "-o", out, "--overwrite")
    assert result.exit_code == 2, result.output
    assert "another kind (findings.csv)" in result.stderr
    assert sorted(path.read_text() for path in out.iterdir()) == ["old", "old", "old"]
    assert quick["calls"] == []
    (out / "findings.csv").unlink()
    assert invoke(data / "good.csv", "--inputs", "force", "-o", out, "--overwrite").exit_code == 0


def test_a_report_stopped_while_it_is_printed_has_no_old_print_beside_it(data, quick, monkeypatch):
    def interrupted(_html, _pdf):
        raise KeyboardInterrupt

    monkeypatch.setattr("modal.command.run.find_browser", lambda: "browser")
    monkeypatch.setattr("modal.command.run.write_pdf", interrupted)
    (data / "out").mkdir()
    (data / "out" / "report.pdf").write_text("old")
    arguments = ["run", str(data / "good.csv"), "--inputs", "force", "--pdf", "-o", str(data / "out"), "--overwrite"]
    assert _status(arguments) == 130
    assert not (data / "out" / "report.pdf").exists()
    assert (data / "out" / "report.html").is_file()


def test_a_viewer_that_cannot_be_had_is_said_and_is_not_in_the_report(data, quick, monkeypatch):
    @contextlib.contextmanager
    def live_recording(*, tell):
        tell("No viewer was found.")
        yield None

    monkeypatch.setattr("modal.command.terminal.live_recording", live_recording)
    result = invoke(data / "good.csv", "--inputs", "force", "--live", "-o", data / "out")
    assert result.exit_code == 0, result.output
    assert "No viewer was found." in result.stdout
    assert "No viewer was found." not in (data / "out" / "report.html").read_text(encoding="utf-8")


def test_a_viewer_is_told_of_records_progress_and_result(data, quick, monkeypatch):
    told = []
    monkeypatch.setattr("modal.command.terminal.live_recording", lambda **_: contextlib.nullcontext("stream"))
    monkeypatch.setattr("modal.command.run.log_records", lambda records, to: told.append((to, len(records))))
    monkeypatch.setattr("modal.command.run.log_result", lambda result, to, **_: told.append((to, result)))
    assert invoke(data / "good.csv", "--inputs", "force", "--live", "-o", data / "out").exit_code == 0
    assert told == [("stream", 1), ("stream", quick["result"])]


def test_a_sensor_of_no_channel_is_said(data, quick):
    (data / "test.toml").write_text('[[sensors]]\nchannel = "tipp"\n[[sensors]]\nchannel = "tip"\n')
    result = invoke(data / "good.csv", "--inputs", "force", "--test", data / "test.toml", "-o", data / "out")
    assert result.exit_code == 0, result.output
    assert "the test file describes 'tipp', which the records as read do not have" in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    "arguments",
    [
        ("--test", "no.toml"),
        ("--test", "bad.toml"),
        ("--test", "good.csv"),
        ("--geometry", "no.toml"),
        ("--geometry", "bad.toml"),
    ],
)
def test_a_bad_test_file_or_geometry_is_refused_before_any_work(data, quick, monkeypatch, arguments):
    monkeypatch.chdir(data)
    (data / "bad.toml").write_text("artcle = 3\n")
    result = invoke("good.csv", "--inputs", "force", *arguments, "-o", "out")
    assert result.exit_code == 2, result.output
    assert one_sentence(result.stderr), result.stderr
    assert quick["calls"] == []
    assert not (data / "out").exists()


def test_a_pdf_that_cannot_be_is_refused_before_any_work(data, quick, monkeypatch):
    monkeypatch.setattr("modal.command.run.find_browser", lambda: None)
    result = invoke(data / "good.csv", "--inputs", "force", "--pdf", "-o", data / "out")
    assert (result.exit_code, quick["calls"]) == (2, [])
    assert one_sentence(result.stderr), result.stderr
    monkeypatch.setattr("modal.command.run.find_browser", lambda: "browser")
    (data / "out").mkdir()
    (data / "out" / "report.pdf").write_text("mine")
    result = invoke(data / "good.csv", "--inputs", "force", "--pdf", "-o", data / "out")
    assert (result.exit_code, quick["calls"]) == (2, [])
    assert (data / "out" / "report.pdf").read_text() == "mine"


def test_what_an_older_report_had_more_does_not_stay_beside_a_new_one(data, quick, monkeypatch):
    out = data / "out"
    out.mkdir()
    for name in ("report.html", "report.pdf", "result.npz", "notes.txt"):
        (out / name).write_text("old")
    monkeypatch.setattr("modal.report.writing.LARGEST_KEPT", 0)
    result = invoke(data / "good.csv", "--inputs", "force", "-o", out, "--overwrite")
    assert result.exit_code == 0, result.output
    assert not (out / "report.pdf").exists()
    assert len(read_result(out).modes) > 0  # the summary alone
    assert (out / "notes.txt").read_text() == "old"


def test_a_pdf_is_printed_from_the_page(data, quick, monkeypatch):
    monkeypatch.setattr("modal.command.run.find_browser", lambda: "browser")
    monkeypatch.setattr("modal.command.run.write_pdf", lambda html, pdf: pdf.write_text(f"printed {html.name}"))
    result = invoke(data / "good.csv", "--inputs", "force", "--pdf", "-o", data / "out")
    assert result.exit_code == 0, result.output
    assert (data / "out" / "report.pdf").read_text() == "printed report.html"
    assert str(data / "out" / "report.pdf") in result.stdout


def masses_on_springs(rng, n_samples, dt):
    """Force at the second of two masses and both displacements: exact for a held force, of nothing of ours."""
    mass, stiffness = np.diag([2.0, 1.5]), 1e4 * np.array([[3.0, -1.0], [-1.0, 1.5]])
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    force = rng.standard_normal(n_samples)
    motion = np.zeros((n_samples, 2))
    for square, shape in zip(squares, shapes.T, strict=True):
        pole = np.sqrt(square) * complex(-0.02, np.sqrt(1 - 0.02**2))
        step = np.exp(pole * dt)
        state = scipy.signal.lfilter([0, (step - 1) / pole / pole.imag], [1, -step], force.astype(complex))
        motion += np.outer(state.imag * shape[1], shape)
    motion += 0.003 * motion.std(axis=0) * rng.standard_normal(motion.shape)
    return np.column_stack([dt * np.arange(n_samples), force, motion]), 1 / np.abs(shapes).max(axis=0) ** 2


def test_modal_masses_come_from_a_driving_point_that_the_names_tell(tmp_path, quick, capsys, monkeypatch):
    monkeypatch.setattr("modal.command.run.identify", modal.identification.pipeline.identify)
    table, masses = masses_on_springs(np.random.default_rng(4), 400, 0.005)
    header = "time [s],force 2X+ [N],1X+ [m],2X+ [m]"
    np.savetxt(tmp_path / "test.csv", table, delimiter=",", header=header, comments="")
    given = ("--hold", "zero_order", "--order", "4", "--observer-order", "8", "-o", str(tmp_path / "out"))
    assert _status(["run", str(tmp_path / "test.csv"), "--inputs", "force 2X+", *given]) == 0
    assert "Modal mass [kg]: 1: " in capsys.readouterr().out
    modes = json.loads((tmp_path / "out" / "report.json").read_text())["modes"]["table"]
    found, std = np.array([[mode["modal_mass"], mode["modal_mass_std"]] for mode in modes]).T
    assert np.abs(found - masses) == pytest.approx(0.0, abs=4 * std.max())
    assert (std < 0.01 * masses).all()
    for name, words in (("html", "modal mass [kg]</th>"), ("md", "| modal mass [kg] |"), ("md", "driving point 2X+")):
        assert words in (tmp_path / "out" / f"report.{name}").read_text()
    assert "modal_mass_std" in (tmp_path / "out" / "modes.csv").read_text()


def test_a_driving_point_is_named_in_either_order_and_is_checked_before_any_work(data, quick, capsys):
    table = np.arange(20.0).reshape(5, 4)
    record = Record(table[:, :1], table[:, 1:], 0.1, input_names=["f"], input_units=["N"], output_units=["m"] * 3)
    assert chosen_point((record,), ["output_1", "f"]) == chosen_point((record,), ["f", "output_1"]) == ("output_1", "f")
    assert chosen_point((record,), []) is None
    for wrong in ("tip,wind", "tip", "force", "tip,tip,force"):
        assert _status(["run", str(data / "good.csv"), "--inputs", "force", "--driving-point", wrong, "-o", "no"]) == 2
        assert one_sentence(capsys.readouterr().err)
    assert not quick["calls"]
