"""`modal-report view`: a recording in the Rerun viewer, or the exact command that opens it elsewhere."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from modal.command.options import Traceback, complain, examples, faults
from modal.wording.text import shorten
from okid.errors import InvalidDataError, UnreadableFileError, visible

RECORDING = "recording.rrd"
LONGEST = 200
"""Shorten a path to so many letters in a sentence."""

_MAGIC = (b"RRF2", b"RRF0", b"RRF1")
"""First bytes of a recording."""

_FOOTER, _WITH_FOOTER = b"RRF2FOOT", (0, 41)
"""Last words of a recording that is whole, and the version of Rerun from which we know them."""


def recording_of(result: str | Path) -> Path:
    """The recording in the folder of a result, or the file itself.

    Raises:
        UnreadableFileError: there is no such file, no recording in the folder, or it holds something else.
    """
    path = Path(result)
    shown = repr(shorten(visible(str(path)), LONGEST))
    try:
        if path.is_dir():
            path = _in_folder(path, shown)
        elif not path.is_file():
            raise UnreadableFileError(f"there is no {shown}; give a folder that modal-report run wrote.")
        with path.open("rb") as file:
            start = file.read(8)
            file.seek(max(0, path.stat().st_size - len(_FOOTER) - 4))
            end = file.read()
    except OSError as error:
        raise UnreadableFileError(f"{shown} cannot be read ({error.strerror or error}).") from error
    if start[:4] == _MAGIC[0] and tuple(start[4:6]) >= _WITH_FOOTER and _FOOTER not in end:
        raise UnreadableFileError(f"{shown} is cut off or damaged: its last part is missing; write it again.")
    if start[:4] not in _MAGIC:
        raise UnreadableFileError(f"{shown} is no Rerun recording; give a folder that modal-report run wrote.")
    return path


def find_viewer() -> Path | None:
    """The program `rerun`: the one beside this Python comes first, since it reads what this version wrote."""
    folder = str(Path(sys.executable).parent)
    found = shutil.which("rerun", path=folder) or shutil.which("rerun")
    return Path(found) if found else None


def open_recording(recording: Path) -> str:
    """Open the viewer and let it live on by itself.

    Returns:
        "" when it opened, else one sentence: why not, and what to do.

    Raises:
        InvalidDataError: the viewer is there but cannot be started.
    """
    viewer = find_viewer()
    command = shlex.join(["rerun", str(recording)])
    if viewer is None:
        return f"there is no Rerun viewer here; install it (pip install rerun-sdk), then: {command}."
    if not _has_display():
        in_browser = shlex.join([str(viewer), str(recording), "--web-viewer"])
        return f"there is no display here; on a machine with one: {command}, or here for a browser: {in_browser}."
    try:
        subprocess.Popen(  # noqa: S603 - no shell; the program was found by its name, the file is a path of its own
            [str(viewer), str(recording.absolute())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # closing the terminal does not close the viewer
        )
    except OSError as error:
        raise InvalidDataError(f"{viewer} cannot be started ({error.strerror or error}); try: {command}.") from error
    return ""


def _in_folder(folder: Path, shown: str) -> Path:
    if (folder / RECORDING).is_file():
        return folder / RECORDING
    others = sorted(path for path in folder.glob("*.rrd") if path.is_file())
    if len(others) == 1:
        return others[0]
    if others:
        names = ", ".join(shorten(visible(path.name), 60) for path in others[:5])
        raise UnreadableFileError(f"{shown} holds {len(others)} recordings ({names}); name one of them.")
    raise UnreadableFileError(f"{shown} holds no {RECORDING}; give a folder that modal-report run, demo or gap wrote.")


def _has_display() -> bool:
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


EXAMPLES = examples("what run or gap wrote: view result", "a recording by itself: view result/recording.rrd")


def view(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder that run, demo or gap wrote, or a recording (.rrd).")
    ],
    *,
    traceback: Traceback = False,
) -> None:
    """Open the recording of RESULT in the Rerun viewer.

    Exit status: 0 the viewer is open; 1 there is no viewer or no display here
    (it says the command that opens it elsewhere); 2 wrong use or no recording.
    """
    with faults(show=traceback):
        problem = open_recording(recording_of(result))
        if problem:
            complain(problem)
        raise typer.Exit(1 if problem else 0)
