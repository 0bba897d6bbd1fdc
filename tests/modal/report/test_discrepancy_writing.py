import pytest

import modal.recording
from modal.report import DiagnosisFiles, ReportFiles, write_report
from modal.report.discrepancy_writing import refuse_existing_diagnosis
from modal.structure.structural_model import StructuralModel
from okid.errors import InvalidDataError

NAMES = ["findings.csv", "model.json", "recording.rrd", "report.html", "report.json", "report.md"]


@pytest.fixture
def quick(monkeypatch):
    """A recording and pictures that cost nothing: what is tested here is that all files appear or none."""
    monkeypatch.setattr(modal.recording, "save_recording", lambda _result, path, **_options: path.write_bytes(b"rrd"))
    monkeypatch.setattr("modal.report.discrepancy_writing.draw_diagnosis", lambda _diagnosis: {})


def everything(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_one_function_writes_either_result_by_its_type(diagnosis, identification, tmp_path, quick, monkeypatch):
    monkeypatch.setattr("modal.report.writing.draw_pictures", lambda _result, _setting: {})
    files = write_report(diagnosis, tmp_path / "gap")
    assert isinstance(files, DiagnosisFiles)
    assert everything(tmp_path / "gap") == NAMES
    assert isinstance(write_report(identification, tmp_path / "modes"), ReportFiles)


def test_the_updated_model_can_be_read_again(diagnosis, tmp_path, quick):
    files = write_report(diagnosis, tmp_path / "gap")
    again = StructuralModel.load(files.model)
    assert again.output_names == diagnosis.model.output_names
    assert (again.stiffness == diagnosis.model.stiffness).all()


def test_a_model_that_is_a_function_has_no_file(make_gap, tmp_path, quick):
    files = write_report(make_gap(n_effects=1, model=lambda record: record), tmp_path / "gap")
    assert files.model is None
    assert everything(tmp_path / "gap") == [name for name in NAMES if name != "model.json"]
    assert len(list(files)) == 5
    assert "model.json" not in files.html.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", NAMES)
def test_an_existing_file_is_refused_and_left_alone(diagnosis, tmp_path, quick, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InvalidDataError, match=name):
        write_report(diagnosis, tmp_path)
    with pytest.raises(InvalidDataError, match=name):
        refuse_existing_diagnosis(tmp_path, "refuse")
    assert everything(tmp_path) == [name]
    assert (tmp_path / name).read_text() == "mine"
    write_report(diagnosis, tmp_path, existing="replace")
    assert (tmp_path / name).read_bytes() != b"mine"


@pytest.mark.parametrize("fault", [KeyboardInterrupt, RuntimeError, OSError(28, "No space left on device")])
def test_a_fault_leaves_nothing(diagnosis, tmp_path, quick, monkeypatch, fault):
    def fail(_result, _path, **_options):
        raise fault

    monkeypatch.setattr(modal.recording, "save_recording", fail)
    with pytest.raises(InvalidDataError if isinstance(fault, OSError) else fault):
        write_report(diagnosis, tmp_path / "new" / "deep")
    assert everything(tmp_path) == []


def test_same_diagnosis_same_bytes_and_a_real_recording(diagnosis_of, tmp_path):
    found = diagnosis_of("named", 1)
    first, second = (write_report(found, tmp_path / name) for name in ("a", "b"))
    assert first.recording.read_bytes()[:4] == b"RRF2"
    for one, other in zip(first, second, strict=True):
        if one.suffix != ".rrd":  # chunk identities differ from run to run
            assert one.read_bytes() == other.read_bytes()
