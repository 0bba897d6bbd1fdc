"""One step in which a report appears: what two runs, a dead run and a second run leave."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from modal.report import folder
from modal.report import folder as folders
from modal.report.folder import write_folder
from okid.errors import InvalidDataError

NAMES = ["a.txt", "b.txt", "c.txt"]
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="folders are exchanged in one step on Linux")


def writes(text):
    return lambda made: [(made / name).write_text(text, encoding="utf-8") for name in NAMES]


def contents(target):
    return {path.name: path.read_text(encoding="utf-8") for path in target.iterdir() if path.is_file()}


def test_the_second_of_two_is_refused_at_the_rename(tmp_path):
    """The other run is complete while this one still writes: nothing of it is touched, and nothing is left over."""

    def slower(made):
        writes("slower")(made)
        write_folder(tmp_path / "out", NAMES, writes("faster"), existing="refuse")

    with pytest.raises(InvalidDataError, match=r"already holds a\.txt, b\.txt, c\.txt"):
        write_folder(tmp_path / "out", NAMES, slower, existing="refuse")
    assert contents(tmp_path / "out") == dict.fromkeys(NAMES, "faster")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("way", ["exchanged", "each"])
def test_other_files_stay_and_files_of_the_old_report_go(tmp_path, monkeypatch, way):
    if way == "each":
        monkeypatch.setattr(folders, "_swaps", lambda: False)
    elif sys.platform != "linux":
        pytest.skip("folders are exchanged in one step on Linux")
    target = tmp_path / "out"
    write_folder(target, NAMES, writes("old"), existing="refuse")
    (target / "notes.md").write_text("mine", encoding="utf-8")
    (target / "report.pdf").write_text("of the old one", encoding="utf-8")
    target.chmod(0o750)
    write_folder(target, [*NAMES, "d.txt"], writes("new"), existing="replace", gone=("report.pdf",))
    assert contents(target) == {**dict.fromkeys(NAMES, "new"), "notes.md": "mine"}
    assert target.stat().st_mode & 0o777 == 0o750
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_folders_in_the_folder_and_the_folder_one_stands_in_stay(tmp_path, monkeypatch):
    target = tmp_path / "out"
    write_folder(target, NAMES, writes("old"), existing="refuse")
    (target / "photos").mkdir()
    (target / "photos" / "one").write_text("mine", encoding="utf-8")
    monkeypatch.chdir(target)
    write_folder(target, NAMES, writes("new"), existing="replace")
    assert contents(target) == dict.fromkeys(NAMES, "new")
    assert (target / "photos" / "one").read_text(encoding="utf-8") == "mine"
    assert Path.cwd() == target


WRITER = """
import sys
from pathlib import Path
from modal.report.folder import write_folder
target, names = Path(sys.argv[1]), sys.argv[2].split()
for number in range(int(sys.argv[3]), 10**6):
    write = lambda made: [(made / name).write_text(str(number)) for name in names]
    write_folder(target, names, write, existing="replace")
    print("ready", flush=True)
"""


@LINUX
@pytest.mark.parametrize("n_kills", [3, pytest.param(12, marks=pytest.mark.slow)])
def test_killed_at_any_time_the_folder_is_the_old_or_the_new_one_whole(tmp_path, n_kills):
    target, rng = tmp_path / "out", random.Random(3)  # noqa: S311 - no secret
    write_folder(target, NAMES, writes("0"), existing="refuse")
    (target / "notes.md").write_text("mine", encoding="utf-8")
    seen = set()
    for start in range(1, n_kills + 1):
        command = [sys.executable, "-c", WRITER, str(target), " ".join(NAMES), str(1000 * start)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.05))
            process.send_signal(signal.SIGKILL)
        found = contents(target)
        assert found.pop("notes.md") == "mine"
        assert found.keys() == set(NAMES)
        assert len(set(found.values())) == 1
        seen |= set(found.values())
    assert len(seen) == n_kills
    write_folder(target, NAMES, writes("last"), existing="replace")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.skipif(sys.platform == "win32", reason="locks on folders are of POSIX")
def test_the_folder_of_a_run_that_lives_is_not_swept(tmp_path):
    (tmp_path / ".modal-report-dead").mkdir()
    with folders.scratch_folder(tmp_path) as mine:
        write_folder(tmp_path / "out", NAMES, writes("other"), existing="refuse")
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted([mine.name, "out"])
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_one_locked_file_keeps_all_of_the_older_report(tmp_path, monkeypatch):
    target, names = tmp_path / "report", ["a.txt", "b.txt", "c.txt"]

    def write(text):
        return lambda made: [(made / name).write_text(text, encoding="utf-8") for name in names]

    write_folder(target, names, write("old"), existing="refuse")
    rename = Path.replace

    def as_on_windows(path, goal):
        if target / "b.txt" in (path, Path(goal)):
            raise PermissionError(13, "the file is used by another process")
        return rename(path, goal)

    monkeypatch.setattr(Path, "replace", as_on_windows)
    monkeypatch.setattr(folder, "_swaps", lambda: False)
    with pytest.raises(InvalidDataError, match="used by another process"):
        write_folder(target, names, write("new"), existing="replace")
    assert [(target / name).read_text(encoding="utf-8") for name in names] == ["old"] * 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report"]
    monkeypatch.undo()
    write_folder(target, names, write("new"), existing="replace")
    assert [(target / name).read_text(encoding="utf-8") for name in names] == ["new"] * 3
