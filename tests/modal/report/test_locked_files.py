"""A report that replaces an older one of which a file is open elsewhere, where the system locks open files."""

from pathlib import Path

import pytest

from modal.report import folder
from modal.report.folder import write_folder
from okid.errors import InvalidDataError


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
