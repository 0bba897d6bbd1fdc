"""Writing: complete or not at all, never over another file unasked, the same twice, valid for Rerun itself."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from modal.recording import log_identification, save_recording
from modal.recording.stream import content_id
from okid.errors import InvalidDataError


def test_two_recordings_of_the_same_result_compare_equal_and_verify(build, tmp_path, read, exit_of):
    first = save_recording(build(missing=True, n_records=2), tmp_path / "a.rrd")
    second = save_recording(build(missing=True, n_records=2), tmp_path / "b.rrd")
    assert exit_of("rrd", "compare", "--unordered", first, second) == 0
    assert exit_of("rrd", "verify", first) == 0
    ids = {read(path).reader.recordings()[0].recording_id for path in (first, second)}
    assert len(ids) == 1
    assert "log_time" not in read(first).timelines()
    # and another result is told apart
    third = save_recording(build(missing=True, n_records=2, seed=2), tmp_path / "c.rrd")
    assert exit_of("rrd", "compare", "--unordered", first, third) != 0


def test_the_identity_follows_the_content(identification, build):
    assert content_id(identification) == content_id(build())
    records = tuple(replace(r, output_names=("a", "b", "c", "d")) for r in identification.records)
    assert content_id(replace(identification, records=records)) != content_id(identification)


def test_an_existing_file_is_refused_and_left_alone(identification, tmp_path):
    path = tmp_path / "run.rrd"
    path.write_text("mine")
    with pytest.raises(InvalidDataError, match="exists already"):
        save_recording(identification, path)
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]
    assert save_recording(identification, path, existing="replace") == path
    assert path.read_bytes()[:4] == b"RRF2"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_left_behind_by_a_failure(identification, tmp_path):
    broken = replace(identification, simulated=())
    with pytest.raises((ValueError, IndexError)):
        save_recording(broken, tmp_path / "run.rrd")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("missing/run.rrd", {}, "does not exist"),
        (".", {}, "is a folder"),
        ("run.rrd", {"existing": "maybe"}, "'refuse' or 'replace'"),
    ],
)
def test_wrong_use_is_one_sentence(identification, tmp_path, name, options, words):
    with pytest.raises(InvalidDataError, match=words):
        save_recording(identification, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


def test_any_stream_of_the_caller_takes_it(identification):
    import rerun as rr

    sizes = {}
    for layout in ("send", "leave"):
        stream = rr.RecordingStream("survey", recording_id="today")
        memory = stream.memory_recording()
        log_identification(identification, stream, layout=layout)
        sizes[layout] = len(memory.drain_as_bytes())
    assert sizes["send"] > sizes["leave"] > 500_000
    with pytest.raises(InvalidDataError, match="'send' or 'leave'"):
        log_identification(identification, stream, layout="both")


def test_the_callers_strictness_comes_back(identification, tmp_path):
    import rerun as rr

    for mode in (False, True):
        rr.set_strict_mode(mode)
        save_recording(identification, tmp_path / f"{mode}.rrd")
        assert rr.strict_mode() is mode


def test_importing_the_package_does_not_import_rerun():
    code = "import sys, modal.recording; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_long_record_stays_small_and_keeps_its_extremes(build, tmp_path, read):
    n = 400_000
    found = build(n_samples=n, n_outputs=2, n_inputs=1, n_modes=1)
    record = found.records[0]
    path = save_recording(found, tmp_path / "long.rrd")
    assert path.stat().st_size < 60e6
    times, values = read(path).series("/data/output/floor_1")
    assert values.size <= 200_000
    assert np.nanmax(values) == record.outputs[:, 0].max()
    assert np.nanmin(values) == record.outputs[:, 0].min()
    assert times[0] == pytest.approx(record.time[0])
    assert times[-1] == pytest.approx(record.time[-1], abs=4 * record.dt)
    assert "smallest and the largest of every 5 samples" in read(path).static("/fit/text", "TextDocument:text")[0]


def test_records_without_a_name_give_the_same_recording_under_any_file_name(identification, tmp_path, exit_of):
    records = tuple(replace(record, name="") for record in identification.records)
    unnamed = replace(identification, records=records)
    first, second = (save_recording(unnamed, tmp_path / f"{name}.rrd") for name in "ab")
    assert exit_of("rrd", "compare", "--unordered", first, second) == 0
