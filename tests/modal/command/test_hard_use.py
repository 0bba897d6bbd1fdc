"""What a command does where the terminal, the memory, the file's name or the folder's name is poor."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import modal.command.run
from modal.command.main import status
from modal.command.view import recording_of
from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers import read_records

HERE = Path(modal.command.run.__file__).parents[2]


@pytest.fixture
def data(tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    table = np.column_stack([0.01 * np.arange(400), rng.standard_normal((400, 2))])
    for name in ("a.csv", "b.csv"):
        np.savetxt(
            tmp_path / name, table, delimiter=",", header="time [s],force [N],Größe [µm]", comments="", encoding="utf-8"
        )
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "cp437"])
def test_terminals_that_lack_letters_get_plain_ones(data, encoding):
    environment = {**os.environ, "PYTHONPATH": str(HERE), "PYTHONIOENCODING": encoding}
    run = subprocess.run(
        [sys.executable, "-c", "from modal.command.entry import main; main()", "check", "a.csv", "--inputs", "force"],
        env=environment,
        capture_output=True,
        check=False,
    )
    text = run.stdout.decode(encoding)
    assert run.returncode in (0, 1)
    assert run.stderr == b""
    assert ("Grosse" if encoding == "ascii" else "Größe") in text
    assert "?" not in text


@pytest.mark.parametrize(
    "command", [["run", "a.csv"], ["demo"], ["diff", "a", "b"], ["gap", "m.toml", "--fit", "a.csv"]]
)
def test_an_empty_name_is_no_folder(data, command, capsys):
    before = sorted(data.iterdir())
    assert status([*command, "-o", ""]) == 2
    assert "the name of the folder is empty; give one, such as -o result" in capsys.readouterr().err
    assert sorted(data.iterdir()) == before


def test_a_link_to_a_record_is_that_record(data):
    (data / "link.csv").symlink_to("a.csv")
    with pytest.raises(InvalidDataError, match=r"a\.csv, link\.csv is given more than once; a record counts once"):
        read_records(["a.csv", "link.csv"])
    assert len(read_records(["a.csv", "b.csv"])) == 2


def test_too_little_memory_is_a_sentence(data, monkeypatch, capsys):
    def greedy(*_arguments, **_options):
        return np.empty(1 << 49)

    monkeypatch.setattr(modal.command.run, "identify", greedy)
    assert status(["run", "a.csv", "--inputs", "force", "-o", "out"]) == 2
    assert "there is not enough memory for this (Unable to allocate" in capsys.readouterr().err
    assert not (data / "out").exists()


def test_what_memory_cannot_hold_is_said_before_the_work(data, monkeypatch, capsys):
    monkeypatch.setattr("modal.identification.pipeline.memory_budget", lambda: (1e5, "the container leaves"))
    assert status(["run", "a.csv", "--inputs", "force", "-o", "out"]) == 2
    said = capsys.readouterr().err
    assert "identifying 400 samples of 2 channels needs about" in said
    assert "that the container leaves; give a stretch of the record" in said
    assert not (data / "out").exists()


def test_a_recording_that_is_cut_off_is_a_sentence(data):
    head = b"RRF2\x00\x29\x00\x00" + bytes(100)
    (data / "a.rrd").write_bytes(head + b"RRF2FOOT\x01\x00\x00\x00")
    assert recording_of("a.rrd") == Path("a.rrd")
    (data / "a.rrd").write_bytes(head)
    with pytest.raises(UnreadableFileError, match=r"'a\.rrd' is cut off or damaged"):
        recording_of("a.rrd")


@pytest.mark.parametrize("what", ["result.npz", "folder"])
def test_a_damaged_result_is_a_sentence(data, what, capsys):
    (data / "result").mkdir()
    (data / "result" / "result.npz").write_bytes(b"PK\x03\x04 and no more")
    place = "result" if what == "folder" else "result/result.npz"
    assert status(["diff", place, place]) == 2
    assert "is damaged" in capsys.readouterr().err
