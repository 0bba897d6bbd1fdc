import sys
from dataclasses import replace

import numpy as np
import pytest

import modal.recording
from modal.comparison.shifts import read_result
from modal.identification.result import load
from modal.report import DiagnosisFiles, Provenance, ReportFiles, write_report
from modal.report import writing as kept_result
from modal.report.folder import refuse_names
from modal.report.writing import keep_result
from okid.errors import InvalidDataError, UnreadableFileError


@pytest.fixture
def quick(monkeypatch):
    """A recording and pictures that cost nothing: what is tested here is that all files appear or none."""
    monkeypatch.setattr(modal.recording, "save_recording", lambda _result, path, **_options: path.write_bytes(b"rrd"))
    monkeypatch.setattr("modal.report.writing.draw_pictures", lambda _result, _setting: {})
    monkeypatch.setattr("modal.report.discrepancy_writing.draw_diagnosis", lambda _diagnosis: {})


def everything(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


NAMES = {
    "identification": [
        *("report.html", "report.md", "report.json", "report.schema.json", "modes.csv", "modes.uff", "result.npz"),
        "recording.rrd",
    ],
    "diagnosis": ["report.html", "report.md", "report.json", "findings.csv", "recording.rrd", "model.json"],
}
kinds = pytest.mark.parametrize("kind", NAMES)


@pytest.fixture
def result(request, kind):
    """Either kind of result; one function writes both."""
    return request.getfixturevalue(kind)


@kinds
def test_all_files_are_written_and_iterated_in_their_order(result, kind, tmp_path, quick):
    files = write_report(result, tmp_path / "a" / "b")
    assert type(files) is {"identification": ReportFiles, "diagnosis": DiagnosisFiles}[kind]
    assert [path.name for path in files] == NAMES[kind]
    assert all(path.is_file() for path in files)
    assert everything(tmp_path / "a" / "b") == sorted(NAMES[kind])
    assert everything(tmp_path / "a")[0] == "b"


def test_same_result_same_bytes_and_a_real_recording(make_result, plain_files, diagnosis_of, tmp_path, monkeypatch):
    written = [write_report(diagnosis_of("named", 1), tmp_path / name) for name in "ab"]
    monkeypatch.setattr(modal.recording, "save_recording", lambda _result, path, **_options: path.write_bytes(b"rrd"))
    again = write_report(
        make_result(warnings=("Look at floor_1.",)),
        tmp_path / "again",
        provenance=Provenance(command="modal-report run x", sources=("x",), remarks=("x",)),
    )
    for first, second in ((plain_files, again), written):
        assert first.recording.read_bytes()[:4] == b"RRF2"
        for one, other in zip(first, second, strict=True):
            if one.suffix != ".rrd":  # chunk identities differ from run to run; the recording's own tests compare it
                assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in NAMES for name in NAMES[kind]])
def test_an_existing_file_is_refused_and_left_alone_or_replaced_when_asked_for(result, kind, tmp_path, quick, name):
    (tmp_path / name).write_text("mine")
    (tmp_path / "notes.txt").write_text("mine")
    for refused in (
        lambda: write_report(result, tmp_path),
        lambda: refuse_names(tmp_path, NAMES[kind], "refuse"),
    ):
        with pytest.raises(InvalidDataError, match=name):
            refused()
        assert everything(tmp_path) == sorted([name, "notes.txt"])
        assert (tmp_path / name).read_text() == "mine"
    write_report(result, tmp_path, existing="replace")
    assert (tmp_path / name).read_bytes() != b"mine"
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert len(everything(tmp_path)) == len(NAMES[kind]) + 1


@kinds
@pytest.mark.parametrize("fault", [KeyboardInterrupt, RuntimeError, OSError(28, "No space left on device")])
def test_a_fault_leaves_nothing(result, kind, *, tmp_path, quick, monkeypatch, fault):
    def fail(_result, _path, **_options):
        raise fault

    monkeypatch.setattr(modal.recording, "save_recording", fail)
    with pytest.raises(InvalidDataError if isinstance(fault, OSError) else fault):
        write_report(result, tmp_path / "new" / "deep")
    assert everything(tmp_path) == []


def test_a_file_in_place_of_the_folder_is_refused(identification, tmp_path, quick):
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(InvalidDataError, match="is a file"):
        write_report(identification, tmp_path / "taken")
    with pytest.raises(InvalidDataError, match=r"cannot be a folder, because .*taken' is a file"):
        write_report(identification, tmp_path / "taken" / "below")


def test_what_cannot_be_written_is_refused_before_any_work(tmp_path, monkeypatch):
    with pytest.raises(InvalidDataError, match="File name too long") as caught:
        refuse_names(tmp_path / ("x" * 5000), ["report.html"], "refuse")
    assert len(str(caught.value)) < 400
    monkeypatch.setattr("os.access", lambda _path, _mode: False)
    with pytest.raises(InvalidDataError, match="no right to write in"):
        refuse_names(tmp_path / "new", ["report.html"], "refuse")


def test_the_new_folder_has_ordinary_permissions(identification, tmp_path, quick):
    (tmp_path / "ordinary").mkdir()
    files = write_report(identification, tmp_path / "new")
    assert files.html.parent.stat().st_mode == (tmp_path / "ordinary").stat().st_mode


@pytest.mark.skipif(sys.platform == "win32", reason="limits on the size of a file are of POSIX")
@pytest.mark.parametrize("share", [0.001, 0.3, 0.98])
def test_a_file_that_finds_no_room_is_no_report(identification, tmp_path, quick, share):
    """The system refuses what is longer than a share of the recording: nothing is cut off in silence."""
    import resource

    whole = write_report(identification, tmp_path / "whole").recording.stat().st_size
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(share * whole), before[1]))
    try:
        with pytest.raises(InvalidDataError, match=r"^'.*out' cannot be written \(File too large\)"):
            write_report(identification, tmp_path / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]


def bytes_of_arrays(path):
    with np.load(path, allow_pickle=False) as archive:
        return sum(archive[name].nbytes for name in archive.files if name != "result.json")


def test_an_array_that_is_shared_counts_once(tmp_path, identification, monkeypatch):
    shared = replace(identification, predicted=identification.records)
    size = bytes_of_arrays(keep_result(shared, tmp_path / "whole.npz"))
    monkeypatch.setattr(kept_result, "LARGEST_KEPT", size)
    assert load(keep_result(shared, tmp_path / "shared.npz")).records[0].dt == shared.records[0].dt
    apart = replace(shared, predicted=tuple(replace(one, outputs=one.outputs + 0.0) for one in shared.records))
    with pytest.raises(UnreadableFileError, match="summary alone"):
        load(keep_result(apart, tmp_path / "apart.npz"))


def test_of_one_that_is_too_large_the_summary_is_kept(tmp_path, identification, monkeypatch):
    size = bytes_of_arrays(keep_result(identification, tmp_path / "whole.npz"))
    monkeypatch.setattr(kept_result, "LARGEST_KEPT", size - 1)
    path = keep_result(identification, tmp_path / "result.npz", files=["ab"])
    assert path.stat().st_size < 50_000
    summary = read_result(path)
    assert [mode.pole for mode in summary.modes] == [mode.pole for mode in identification.modes]
    assert summary.data == ("file ab",)
    with pytest.raises(UnreadableFileError, match="summary alone"):
        load(path)
