import io
import json

import numpy as np
import pytest
from rich.console import Console

from modal.command.check import carry_out_check, quality_json, show_quality
from modal.command.run import FileSource
from modal.quality.check import check_quality
from okid.errors import InvalidDataError
from okid.record import Record


def record(names=("tip", "root"), *, clipped=True):
    rng = np.random.default_rng(0)
    force = rng.standard_normal(2000)
    tip = np.convolve(force, [0.0, 1.0, 1.6, 1.5, 0.8])[:2000]
    root = np.convolve(force, [0.0, 0.4, -1.0, 0.3])[:2000] + 0.01 * rng.standard_normal(2000)
    outputs = np.column_stack([np.clip(tip, -3.0, 3.0) if clipped else tip, root])
    return Record(force, outputs, 0.01, input_names=["force"], output_names=list(names), output_units=["g", ""])


def shown(one, *, width=110):
    console = Console(file=io.StringIO(), width=width, force_terminal=False)
    show_quality(console, check_quality(one), [one], remarks=("tip: g -> m/s^2",))
    return console.file.getvalue()


@pytest.fixture
def source(tmp_path):
    one = record()
    path = tmp_path / "shaker.csv"
    table = np.column_stack([one.time, one.inputs, one.outputs])
    np.savetxt(path, table, delimiter=",", header="time,force,tip,root", comments="", fmt="%.9g")
    return FileSource(files=[path], inputs=["force"], outputs=None, dt=None, hold="band_limited")


def test_a_file_is_checked_and_its_numbers_written(source, tmp_path, capsys):
    path = tmp_path / "check.json"
    assert carry_out_check(source, path).level == "bad"
    document = json.loads(path.read_text())
    assert document["level"] == "bad"
    assert [one["name"] for one in document["channels"]] == ["force", "tip", "root"]
    (clipped,) = [one for one in document["findings"] if one["what"] == "clipped"]
    assert clipped["channels"] == ["tip"]
    assert clipped["spans"][0]["record"] == 0
    printed = capsys.readouterr().out
    assert "clipped" in printed
    before = path.read_bytes()
    carry_out_check(source, path)
    assert path.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["check.json", "shaker.csv"]


def test_set_ups_convert_a_unit_in_one_sentence(tmp_path):
    """Each set-up repeated it, with its own channels, and so the terminal was filled."""
    files = []
    for number, moved in enumerate(("b", "c")):
        files.append(tmp_path / f"setup_{number}.csv")
        values = np.column_stack([0.01 * np.arange(50), np.random.default_rng(number).standard_normal((50, 3))])
        np.savetxt(
            files[-1], values, delimiter=",", header=f"time,force [N],a [g],{moved} [g]", comments="", fmt="%.9g"
        )
    _, remarks = FileSource(files=files, inputs=["force"], outputs=None, dt=None, hold="band_limited").read()
    assert remarks == ("a, b, c: g -> m/s^2, times 9.80665 (g read as standard gravity)",)


def test_a_measured_file_is_never_replaced_by_its_numbers(source):
    (path,) = source.files
    before = path.read_bytes()
    with pytest.raises(InvalidDataError, match="would replace a file that is read"):
        carry_out_check(source, path.parent / "." / path.name)
    assert path.read_bytes() == before


def test_numbers_stopped_while_they_are_written_leave_nothing(source, tmp_path, monkeypatch):
    def interrupted(_path, _target):
        raise KeyboardInterrupt

    monkeypatch.setattr("pathlib.Path.replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        carry_out_check(source, tmp_path / "check.json")
    assert [path.name for path in tmp_path.iterdir()] == ["shaker.csv"]


def test_numbers_that_cannot_be_written_are_one_sentence(source, tmp_path):
    with pytest.raises(InvalidDataError, match="could not be written"):
        carry_out_check(source, tmp_path / "no" / "check.json")


def test_nothing_bad_is_status_zero_and_unknown_numbers_are_null():
    one = record(clipped=False)
    quality = check_quality(one)
    document = json.loads(quality_json(quality, [one]))
    assert document["channels"][0]["explained"] is None
    assert document["channels"][1]["explained"] > 0.9


def test_the_page_has_a_row_a_channel_and_a_sentence_a_finding():
    text = shown(record())
    lines = text.splitlines()
    assert "1 bad fault" in lines[1]
    assert any(line.split()[:3] == ["tip", "clipped", "output"] for line in lines)
    assert any(line.split()[:3] == ["root", "good", "output"] for line in lines)
    assert "2000 samples every 0.01 s (100 Hz, 20 s), 1 input, 2 outputs" in text
    assert "tip: g -> m/s^2" in text
    good = shown(record(clipped=False))
    assert "No fault was found" in good
    assert "\nBad" not in good


def test_on_a_narrow_screen_what_was_found_is_read_in_full():
    wide, narrow = (shown(record(), width=width).splitlines() for width in (110, 80))
    assert ["least" in lines[4] for lines in (wide, narrow)] == [True, False]
    for lines in (wide, narrow):
        assert any(line.split()[:3] == ["tip", "clipped", "output"] for line in lines)
        assert any(line.split()[:3] == ["root", "good", "output"] for line in lines)


def test_names_from_files_are_harmless():
    text = shown(record(("[red]x[/red]\x1b[2J", "\u202eevil" + "y" * 400)))
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert "[red]" in text
    assert max(map(len, text.splitlines())) <= 110


def test_of_many_channels_the_faulty_ones_are_shown():
    rng = np.random.default_rng(0)
    outputs = rng.standard_normal((500, 60))
    outputs = np.cumsum(outputs, axis=0) - np.vstack([np.zeros((9, 60)), np.cumsum(outputs, axis=0)[:-9]])
    outputs[:, 57] = 1.0
    text = shown(
        Record(np.empty((500, 0)), outputs, 0.01, output_names=[f"c{i}" for i in range(60)], output_units=[""] * 60)
    )
    assert "and 20 more channels without a fault" in text
    assert any(line.startswith("c57 ") and "constant" in line for line in text.splitlines())
