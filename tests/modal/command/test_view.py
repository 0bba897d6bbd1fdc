"""The command `modal-report view`: which recording, which viewer, and what is said where there is none."""

import os
import subprocess
import sys

import pytest

import modal.command.results
from modal.command.main import status as _status
from modal.command.results import find_viewer, recording_of
from okid.errors import UnreadableFileError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A result with a recording, a folder with two, an empty one, and files that are none."""
    for name in ("result/recording.rrd", "one/other.rrd", "two/a.rrd", "two/b.rrd"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"RRF2" + bytes(20))
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.rrd").write_text("no recording")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def started(monkeypatch):
    """Commands that were started, instead of starting them."""
    commands = []

    class Popen:
        def __init__(self, command, **options):
            assert not options.get("shell")
            commands.append(command)

    monkeypatch.setattr(subprocess, "Popen", Popen)
    monkeypatch.setattr(modal.command.results, "find_viewer", lambda: "/bin/rerun")
    monkeypatch.setenv("DISPLAY", ":0")
    return commands


def test_the_recording_of_a_folder_or_the_file_itself(folder):
    assert recording_of("result").name == "recording.rrd"
    assert recording_of("result/recording.rrd").name == "recording.rrd"
    assert recording_of("one").name == "other.rrd"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with a name are of Unix")
def test_a_pipe_is_no_recording(folder):
    """It would be waited for."""
    os.mkfifo(folder / "empty" / "recording.rrd")
    with pytest.raises(UnreadableFileError, match=r"'empty' holds no recording\.rrd"):
        recording_of("empty")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no", "there is no 'no'"),
        ("empty", "holds no recording.rrd"),
        ("two", r"2 recordings \(a.rrd, b.rrd\)"),
        ("text.rrd", "no Rerun recording"),
        ("x" * 5000, "cannot be read"),
    ],
)
def test_what_is_no_recording_is_said(folder, name, words):
    with pytest.raises(UnreadableFileError, match=words):
        recording_of(name)


def test_the_viewer_is_opened_with_the_recording(folder, started, capsys):
    assert _status(["view", "result"]) == 0
    assert started == [["/bin/rerun", str(folder / "result" / "recording.rrd")]]
    assert capsys.readouterr().err == ""


def test_without_a_display_the_command_is_said(folder, started, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert _status(["view", "result"]) == 1
    error = capsys.readouterr().err
    assert "no display" in error
    assert "rerun result/recording.rrd" in error
    assert len(error.splitlines()) == 1
    assert started == []


def test_without_a_viewer_the_command_is_said(folder, started, capsys, monkeypatch):
    monkeypatch.setattr(modal.command.results, "find_viewer", lambda: None)
    (folder / "a b").mkdir()
    (folder / "a b" / "recording.rrd").write_bytes(b"RRF2")
    assert _status(["view", "a b"]) == 1
    error = capsys.readouterr().err
    assert "pip install rerun-sdk" in error
    assert "rerun 'a b/recording.rrd'" in error


def test_a_viewer_that_does_not_start_is_one_sentence(folder, started, capsys, monkeypatch):
    def refuse(*_arguments, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    assert _status(["view", "result"]) == 2
    assert "cannot be started (Permission denied)" in capsys.readouterr().err


def test_the_viewer_beside_this_python_is_found():
    viewer = find_viewer()
    assert viewer is None or viewer.name.startswith("rerun")
