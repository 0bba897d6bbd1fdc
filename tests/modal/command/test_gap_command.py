"""The command `modal-report gap`: reading, options, exit status, nothing left behind; the diagnosis is a stand-in."""

from dataclasses import replace

import numpy as np
import pytest

import modal.recording
from modal.command.gap import chosen_effects
from modal.command.main import status as _status
from modal.command.options import spread_files
from modal.effects.catalogue import CATALOGUE
from modal.structure.structural_model import StructuralModel
from okid.errors import InsufficientDataError, InvalidDataError

MODEL = """
masses = [1.0, 1.0]
stiffnesses = [400.0, 400.0]
dampings = [0.8, 0.8]
force_dofs = [0]
sensor_dofs = [0, 1]
"""
NAMED = MODEL + 'input_names = ["force"]\noutput_names = ["lower", "upper"]\n'


@pytest.fixture
def data(tmp_path, monkeypatch):
    """A folder with models and records."""
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "frame.toml").write_text(NAMED)
    (folder / "numbered.toml").write_text(MODEL)
    (folder / "broken.toml").write_text("masses = [")
    (folder / "model.txt").write_text(NAMED)
    (folder / "function.py").write_text("def model(record):\n    return record\n")
    rng = np.random.default_rng(3)
    for name, header in (
        ("a", "time [s],force [N],lower [m],upper [m]"),
        ("b", "time [s],force [N],lower [m],upper [m]"),
        ("c", "time [s],upper [m],force [N],lower [m]"),
        ("other", "time [s],wind,lower [m],upper [m]"),
        ("nan", "time [s],force [N],lower [m],upper [m]"),
    ):
        table = np.column_stack([0.02 * np.arange(200), rng.standard_normal((200, 3))])
        if name == "nan":
            table[:, 1] = np.nan
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header=header, comments="")
    (folder / "empty.csv").write_text("")
    (folder / "a_again.csv").symlink_to("a.csv")
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def quick(monkeypatch, diagnosis_of):
    """The workflow replaced by a diagnosis made by hand, the recording by a stub: the command itself is tested."""
    state = {"result": diagnosis_of("named", 1), "calls": []}

    def diagnose(model, fit, held_out, **options):
        state["calls"].append((model, fit, held_out, options))
        options["progress"]("screening", 0.5)
        if isinstance(state["result"], BaseException):
            raise state["result"]
        return state["result"]

    monkeypatch.setattr("modal.command.gap.diagnose", diagnose)
    monkeypatch.setattr(modal.recording, "save_recording", lambda _result, path: path.write_bytes(b"rrd"))
    monkeypatch.setattr("modal.report.discrepancy_writing.draw_diagnosis", lambda _diagnosis: {})
    return state


def gap(capsys, *arguments):
    status = _status(["gap", *arguments])
    return status, capsys.readouterr()


def one_sentence(text):
    lines = text.strip().splitlines()
    return len(lines) == 1 and lines[0].startswith("modal-report: ") and lines[0].endswith((".", "?"))


GOOD = ("frame.toml", "--fit", "a.csv", "--held-out", "c.csv", "-o", "out")

BAD = [
    ("frame.toml", "--fit", "a.csv"),
    ("frame.toml", "--held-out", "a.csv"),
    ("--fit", "a.csv", "--held-out", "c.csv"),
    ("nofile.toml", "--fit", "a.csv", "--held-out", "c.csv"),
    ("model.txt", "--fit", "a.csv", "--held-out", "c.csv"),
    ("broken.toml", "--fit", "a.csv", "--held-out", "c.csv"),
    ("numbered.toml", "--fit", "a.csv", "--held-out", "c.csv"),
    ("function.py", "--fit", "a.csv", "--held-out", "c.csv"),
    ("frame.toml", "--fit", "nofile.csv", "--held-out", "c.csv"),
    ("frame.toml", "--fit", "a.csv", "--held-out", "a.csv"),
    ("frame.toml", "--fit", "a.csv", "--held-out", "a_again.csv"),
    ("frame.toml", "--fit", "a.csv", "--held-out", "other.csv"),
    ("frame.toml", "--fit", "other.csv", "--held-out", "c.csv"),
    ("frame.toml", "--fit", "empty.csv", "--held-out", "c.csv"),
    ("frame.toml", "--fit", "nan.csv", "--held-out", "c.csv"),
    ("frame.toml", "--fit", "a.csv", "--held-out", "c.csv", "--catalogue", "magic"),
    ("frame.toml", "--fit", "a.csv", "--held-out", "c.csv", "--inputs", "wind"),
    ("frame.toml", "--fit", "a.csv", "--held-out", "c.csv", "--hold", "sometimes"),
    ("frame.toml", "--fit", "a.csv", "--held-out", "c.csv", "--no-such-option"),
    ("frame.toml", "--fit", "a.csv", "--held-out", "c.csv", "-o", "a.csv"),
]


@pytest.mark.parametrize("arguments", BAD, ids=" ".join)
def test_wrong_use_is_one_sentence_and_nothing_is_written(data, quick, capsys, arguments):
    before = sorted(data.iterdir())
    status, captured = gap(capsys, *arguments)
    assert status == 2, captured
    assert one_sentence(captured.err), captured.err
    assert captured.out == ""
    assert sorted(data.iterdir()) == before
    assert quick["calls"] == []


def test_a_good_run_writes_everything_and_says_where(data, quick, capsys):
    status, captured = gap(capsys, *GOOD)
    assert status == 0, captured
    assert "The simulation lacks cubic stiffness at the link lower-upper." in captured.out
    assert "out/report.html" in captured.out
    assert "- Input force: " in captured.out
    assert "(--hold " in captured.out
    assert captured.err == ""
    assert len(list((data / "out").iterdir())) == 6
    StructuralModel.load(data / "out" / "model.json")


def test_a_long_search_is_said_beforehand_and_a_budget_shortens_it(data, quick, capsys, monkeypatch):
    monkeypatch.setattr("modal.command.terminal.Shown.LONG", 0.0)
    monkeypatch.setattr("modal.discrepancy.setup.SECONDS_A_STATE", (0.1, 1.0))  # 600 rows of four states at most
    rows = 200 * (1 + GOOD.count("b.csv") + GOOD.count("c.csv"))
    said = f"{rows} samples of 3 channels: expect {{}} min of one processor and up to 0.3 GiB of memory.\n"
    assert gap(capsys, *GOOD)[1].err == said.format(f"{-(-rows * 4 // 600)} to {-(-rows * 4 // 60)}")
    assert gap(capsys, *GOOD, "--budget", "90", "--overwrite")[1].err == said.format(2)


def test_records_have_the_channels_of_the_model_in_its_order(data, quick, capsys):
    status, captured = gap(capsys, "frame.toml", "--fit", "a.csv", "b.csv", "--held-out", "c.csv", "-o", "out")
    assert status == 0, captured
    ((model, fit, held_out, options),) = quick["calls"]
    assert isinstance(model, StructuralModel)
    assert [record.name for record in (*fit, *held_out)] == ["a", "b", "c"]
    for record in (*fit, *held_out):
        assert (record.input_names, record.output_names) == (("force",), ("lower", "upper"))
    assert options["catalogue"] is CATALOGUE


def test_columns_are_named_for_a_model_that_only_numbers_them(data, quick, capsys):
    arguments = ("numbered.toml", "--fit", "a.csv", "--held-out", "c.csv", "--inputs", "force")
    status, captured = gap(capsys, *arguments, "--outputs", "upper,lower", "--hold", "zero_order", "-o", "out")
    assert status == 0, captured
    ((_, fit, held_out, _),) = quick["calls"]
    assert fit[0].output_names == held_out[0].output_names == ("upper", "lower")
    assert fit[0].input_hold == "zero_order"


def test_a_function_is_a_model_once_its_inputs_are_named(data, quick, capsys):
    status, captured = gap(
        capsys, "function.py", "--fit", "a.csv", "--held-out", "c.csv", "--inputs", "force", "-o", "out"
    )
    assert status == 0, captured
    ((model, fit, _, _),) = quick["calls"]
    assert model(fit[0]) is fit[0]


def test_part_of_the_catalogue(data, quick, capsys):
    assert gap(capsys, *GOOD, "--catalogue", "cubic_stiffness,coulomb_friction")[0] == 0
    assert list(quick["calls"][0][3]["catalogue"]) == ["cubic_stiffness", "coulomb_friction"]
    with pytest.raises(InvalidDataError, match="there is no effect 'magic' in the catalogue; it holds cubic"):
        chosen_effects(["magic"])


@pytest.mark.parametrize("case", [("named", 1, 0), ("none", 0, 0), ("unresolved", 1, 1), ("unresolved", 0, 1)])
def test_exit_status_says_whether_it_is_proved(data, quick, capsys, diagnosis_of, case):
    status, n_effects, code = case
    quick["result"] = diagnosis_of(status, n_effects)
    assert gap(capsys, *GOOD)[0] == code
    assert (data / "out" / "report.html").is_file()


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (InsufficientDataError("the records are too short; measure longer."), 1),
        (InvalidDataError("the model has 1 input, the records have 2; name one."), 2),
        (KeyboardInterrupt(), 130),
        (ZeroDivisionError("nobody expects\nit"), 3),
    ],
)
def test_a_fault_is_one_sentence_and_leaves_nothing(data, quick, capsys, fault, code):
    quick["result"] = fault
    before = sorted(data.iterdir())
    status, captured = gap(capsys, *GOOD)
    assert status == code
    assert one_sentence(captured.err), captured.err
    assert sorted(data.iterdir()) == before


def test_an_existing_report_is_never_overwritten_unasked(data, quick, capsys):
    (data / "out").mkdir()
    (data / "out" / "model.json").write_text("mine")
    status, captured = gap(capsys, *GOOD)
    assert (status, one_sentence(captured.err), quick["calls"]) == (2, True, [])
    assert gap(capsys, *GOOD, "--overwrite")[0] == 0
    assert (data / "out" / "model.json").read_text() != "mine"


def test_the_report_tells_the_command_without_its_folder(data, quick, capsys):
    for folder in ("one", "two"):
        gap(capsys, *GOOD[:-1], folder, "--dt", "0.02")
    text = (data / "one" / "report.md").read_text(encoding="utf-8")
    assert "    modal-report gap frame.toml --fit a.csv --held-out c.csv --dt 0.02\n" in text
    for name in ("report.html", "report.md", "report.json", "findings.csv"):
        assert (data / "one" / name).read_bytes() == (data / "two" / name).read_bytes()


def test_the_folder_has_the_name_of_the_model_unless_given(data, quick, capsys):
    assert gap(capsys, *GOOD[:-2])[0] == 0
    assert (data / "modal-report-gap-frame" / "report.html").is_file()


def test_warnings_of_ours_are_remarks_of_the_report(data, quick, capsys, monkeypatch):
    import warnings

    from okid.errors import IdentificationWarning

    plain = modal.command.gap.diagnose

    def diagnose(*arguments, **options):
        warnings.warn(IdentificationWarning("mind the hold"), stacklevel=1)
        return plain(*arguments, **options)

    monkeypatch.setattr("modal.command.gap.diagnose", diagnose)
    assert "mind the hold" in gap(capsys, *GOOD)[1].out
    quick["result"] = replace(quick["result"], warnings=("mind the hold",))
    assert gap(capsys, *GOOD, "--overwrite")[1].out.lower().count("mind the hold") == 1


@pytest.mark.parametrize(
    ("given", "spread"),
    [
        ("m --fit a b --held-out c d", "m --fit a --fit b --held-out c --held-out d"),
        ("m --fit a --overwrite --held-out c", "m --fit a --overwrite --held-out c"),
        ("--fit a m --held-out c d", "--fit a m --held-out c --held-out d"),
        ("m --dt 0.1 --fit a -o out", "m --dt 0.1 --fit a -o out"),
        ("m --fit=a b --held-out c", "m --fit=a b --held-out c"),
        ("--help", "--help"),
    ],
)
def test_an_option_takes_all_the_files_that_follow(given, spread):
    assert spread_files(given.split(), ("--fit", "--held-out")) == spread.split()


def test_the_report_is_printed_when_that_is_asked_for(data, quick, capsys, monkeypatch):
    monkeypatch.setattr("modal.command.run.find_browser", lambda: "browser")
    monkeypatch.setattr("modal.command.gap.write_pdf", lambda html, pdf: pdf.write_text(f"printed {html.name}"))
    status, captured = gap(capsys, *GOOD, "--pdf")
    assert status == 0, captured.err
    assert (data / "out" / "report.pdf").read_text() == "printed report.html"
    assert "out/report.pdf" in captured.out
    quick["calls"].clear()
    status, captured = gap(capsys, *GOOD, "--pdf", "--catalogue", "gap_spring")
    assert (status, quick["calls"]) == (2, [])


def test_what_an_older_report_had_more_does_not_stay_beside_a_new_one(data, quick, capsys, diagnosis_of):
    assert gap(capsys, *GOOD)[0] == 0
    (data / "out" / "report.pdf").write_text("old")
    (data / "out" / "notes.txt").write_text("mine")
    quick["result"] = replace(quick["result"], model=lambda record: record)  # no file can hold it
    assert gap(capsys, *GOOD, "--overwrite")[0] == 0
    assert sorted(path.name for path in (data / "out").iterdir()) == sorted(
        ["findings.csv", "notes.txt", "recording.rrd", "report.html", "report.json", "report.md"]
    )


def test_neither_the_model_nor_a_report_of_another_kind_is_replaced(data, quick, capsys):
    out = data / "out"
    out.mkdir()
    (data / "frame.toml").rename(out / "model.json")
    before = (out / "model.json").read_bytes()
    status, captured = gap(capsys, "out/model.json", *GOOD[1:], "--overwrite")
    assert status == 2
    assert "would replace a file that is read" in captured.err
    assert (out / "model.json").read_bytes() == before
    (out / "model.json").rename(data / "frame.toml")
    for name in ("report.json", "modes.csv"):
        (out / name).write_text("old")
    status, captured = gap(capsys, *GOOD, "--overwrite")
    assert status == 2
    assert "another kind (modes.csv)" in captured.err
    assert sorted(path.name for path in out.iterdir()) == ["modes.csv", "report.json"]
    assert quick["calls"] == []
