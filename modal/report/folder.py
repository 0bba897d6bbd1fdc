"""All files of a report or none: they are made in a folder of their own beside the target and moved when complete.

Stopping on request: Ctrl-C, a polite kill and a closed terminal all stop the work, and none leaves it half done.
"""

import contextlib
import errno
import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import Literal

from modal.wording.names import shorten
from okid.errors import InvalidDataError

__all__ = [
    "Existing",
    "recording_written",
    "refuse_names",
    "stop_no_more",
    "stop_politely",
    "uninterrupted",
    "write_folder",
]

_STOPS = tuple(
    number
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if (number := getattr(signal, name, None)) is not None
)
_AGAIN_AFTER = 3.0
"""Seconds within which a second request is taken for the same one: it must not stop the clearing up."""


def stop_politely() -> None:
    """Let every request to stop raise KeyboardInterrupt, so that what is half done is cleared away."""
    last = [-_AGAIN_AFTER]

    def stop(_number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if now - last[0] >= _AGAIN_AFTER:
            last[0] = now
            raise KeyboardInterrupt

    for number in _STOPS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, stop)


def stop_no_more() -> None:
    """Ignore requests to stop from here on: the work has stopped and is cleared away, only the exit status is left."""
    for number in _STOPS:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Put requests to stop off until the block is done: for the few steps of which all or none must happen.

    Example:
        >>> with uninterrupted():
        ...     done = ["both files", "moved"]
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # Python hands signals to the main thread alone
        return
    asked: list[tuple[int, FrameType | None]] = []
    before = {number: signal.getsignal(number) for number in _STOPS}
    handled = {number: handler for number, handler in before.items() if handler is not None}
    for number in handled:
        signal.signal(number, lambda number, frame: asked.append((number, frame)))
    try:
        yield
    finally:
        for number, handler in handled.items():
            signal.signal(number, handler)
        if asked:
            signal.raise_signal(asked[0][0])


LEAST_FREE = 1 << 20
"""Bytes: with less than 1 MiB free once the recording is written, the disk is taken to be full."""

LONGEST_PATH = 200
"""Letters of a path in a sentence."""

Existing = Literal["refuse", "replace"]
"""What to do with files of a report that are already there."""


def write_folder(target: Path, names: Iterable[str], write: Callable[[Path], None], *, existing: Existing) -> None:
    """Let `write` fill a folder; it appears as `target` once it is complete, and nothing is left behind otherwise.

    Args:
        target: made if it does not exist; other files in it stay.
        names: of the files that will be written.
        write: writes them into the folder that it is given.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.

    Raises:
        InvalidDataError: a file of that name exists already, or the folder cannot be written.
    """
    refuse_names(target, names, existing)
    made = _make_parents(target)
    temporary: Path | None = None
    try:
        temporary = Path(tempfile.mkdtemp(prefix=".modal-report-", dir=target.parent))
        write(temporary)
        _move(temporary, target)
    except BaseException as error:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        for parent in made:
            with contextlib.suppress(OSError):
                parent.rmdir()
        if isinstance(error, OSError):
            raise _cannot_write(target, error) from error
        raise


def refuse_names(folder: Path, names: Iterable[str], existing: Existing) -> None:
    """Raise before any work is done when files of these names could not be written.

    Raises:
        InvalidDataError: as in `write_folder`.
    """
    try:
        nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        there = [name for name in names if (folder / name).exists()]
    except OSError as error:  # a name that is too long, a folder that may not be looked into
        raise _cannot_write(folder, error) from error
    if not nearest.is_dir():
        raise InvalidDataError(
            f"{_named(folder)} cannot be a folder, because {str(nearest)!r} is a file; choose another folder for the "
            "report."
        )
    if there and existing == "refuse":
        raise InvalidDataError(
            f"{_named(folder)} already holds {', '.join(there)}; choose another folder, or replace them (--overwrite, "
            'in Python existing="replace").'
        )
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InvalidDataError(
            f"{_named(folder)} cannot be written (no right to write in {str(nearest)!r}); choose another folder for "
            "the report."
        )


@contextlib.contextmanager
def recording_written(path: Path) -> Iterator[None]:
    """Say that the disk is full where it is: the writer of recordings says that its thread stopped, or nothing at all.

    Its last words may fail to reach a full disk in silence, so a disk that is full afterwards counts as a failure too.

    Args:
        path: of the recording.

    Raises:
        OSError: less than 1 MiB is free now.
    """
    try:
        yield
    except RuntimeError as error:
        _refuse_full_disk(path, error)
        raise
    _refuse_full_disk(path, None)


def _refuse_full_disk(path: Path, cause: Exception | None) -> None:
    if shutil.disk_usage(path.parent).free < LEAST_FREE:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from cause


def _named(folder: Path) -> str:
    return repr(shorten(str(folder), LONGEST_PATH))


def _make_parents(target: Path) -> list[Path]:
    """Make the folders above the target; return those made, the innermost first."""
    missing = [parent for parent in target.absolute().parents if not parent.exists()]
    try:
        target.absolute().parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_write(target, error) from error
    return missing


def _move(temporary: Path, target: Path) -> None:
    """One rename for a new folder; file by file, each at once, into one that exists.

    Where open files are locked (Windows), renaming one to its own name fails, and so does the whole before anything
    is replaced; elsewhere that does nothing.
    """
    if not target.exists():
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o777 & ~mask)
        temporary.rename(target)
        return
    with uninterrupted():  # stopped half-way, it would leave files of two reports side by side
        files = sorted(temporary.iterdir())
        for there in (target / path.name for path in files):
            if there.exists():
                there.replace(there)
        for path in files:
            path.replace(target / path.name)
        temporary.rmdir()


def _cannot_write(target: Path, error: OSError) -> InvalidDataError:
    return InvalidDataError(
        f"{_named(target)} cannot be written ({error.strerror or error}); choose another folder for the report."
    )
