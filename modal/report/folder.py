"""All files of a report or none: they are made in a folder of their own, which takes the target's place when complete.

No request to stop is answered in the middle of that step.

The page on paper is printed by a browser that is installed already. A browser was weighed against libraries that lay
out HTML in Python. The page uses grids, custom properties and inline SVG with clip paths; a browser of the Chromium
family draws all of it exactly as on the screen, is installed on most desks, and adds nothing to install. Libraries add
dozens of megabytes and system libraries (Pango, Cairo), or download a browser of their own, and draw parts of the page
differently. So there is no extra package to install, and where no such browser is found, one sentence says so; every
browser prints the page by hand as well.

The file holds no clock: the browser's two dates are replaced by one fixed day, so the same page and the same browser
give the same bytes.
"""

import contextlib
import ctypes
import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from types import FrameType
from typing import Any

from okid.errors import IdentificationError, InvalidDataError
from okid.readers.guard import Existing

if sys.platform != "win32":  # there, a rename onto what is there fails by itself
    import fcntl

STOPS = tuple(
    number
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if (number := getattr(signal, name, None)) is not None
)
"""Requests to stop, where the system has them."""


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
    before = {number: signal.getsignal(number) for number in STOPS}
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


def write_folder(
    target: Path,
    names: Iterable[str],
    write: Callable[[Path], None],
    *,
    existing: Existing,
    gone: Sequence[str] = (),
    swept: bool = True,
) -> None:
    """Let `write` fill a folder; it appears as `target` once it is complete, and nothing is left behind otherwise.

    Of two that write into one folder at a time, the first to be complete has it, and the other is refused. What dead
    runs have left beside it goes first.

    Args:
        target: made if it does not exist; other files in it stay.
        names: of the files that will be written.
        write: writes them into the folder that it is given.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.
        gone: names of files that go with those that are replaced, for the new ones do not go with them.
        swept: False where the caller sweeps: beside one of many folders looking each time would cost their square.

    Raises:
        InvalidDataError: a file of that name exists already, or the folder cannot be written.
    """
    if swept:
        sweep(target.absolute().parent)
    names = list(names)
    refuse_names(target, names, existing)
    made = _make_parents(target)
    _MADE[:0] = made
    try:
        with scratch_folder(target.absolute().parent) as temporary:
            try:
                write(temporary)
            except InvalidDataError as error:  # it names a file in the scratch folder, which nobody chose
                if isinstance(error.__cause__, OSError):
                    raise error.__cause__ from error
                raise
            written = [path.name for path in temporary.iterdir()]
            _commit(temporary, target, names, existing, gone)
            _check_whole(target, written)
    except BaseException as error:
        _remove(made)
        if isinstance(error, OSError):
            raise _cannot_write(target, error) from error
        raise


# --- folders that are being made -------------------------------------------------------------------------------------

PREFIX = ".modal-report-"
_OPEN: set[Path] = set()
_MADE: list[Path] = []
_STANDING: list[Path] = []


@contextlib.contextmanager
def standing(folder: Path) -> Iterator[None]:
    """Within the block, write nothing below a folder that was there at its start and has gone since.

    Somebody removed it, or a disk is not mounted any more: what is made anew there would be on another disk.
    """
    nearest = _nearest(folder)
    _STANDING.append(nearest)
    try:
        yield
    finally:
        _STANDING.remove(nearest)


def _nearest(folder: Path) -> Path:
    """The innermost folder, or file, above a path that is there."""
    try:
        return next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    except OSError as error:  # a name that is too long, a folder that may not be looked into
        raise _cannot_write(folder, error) from error


@contextlib.contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """A folder to work in, gone when the block ends.

    Who works in a folder holds a lock on it, which the system lets go when the process ends in whatever way.
    """
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        lock = _locked(folder, wait=True)
        if folder.exists():  # swept away between the two lines
            break
        _unlocked(lock)
    _OPEN.add(folder)
    try:
        yield folder
    finally:
        _OPEN.discard(folder)
        if folder.exists():  # else it has taken its target's place
            shutil.rmtree(folder, ignore_errors=True)
        _unlocked(lock)


def sweep(parent: Path) -> None:
    """Remove the folders that runs which are dead have left in `parent`; those of running ones are locked."""
    if sys.platform == "win32":
        return
    with contextlib.suppress(OSError):
        for folder in parent.glob(f"{PREFIX}*"):
            lock = _locked(folder, wait=False) if folder.is_dir() and not folder.is_symlink() else None
            if lock is not None:
                shutil.rmtree(folder, ignore_errors=True)
                _unlocked(lock)


def clear_away() -> None:
    """Remove what this process is making, for one that ends at once."""
    for folder in tuple(_OPEN):
        shutil.rmtree(folder, ignore_errors=True)
    _remove(_MADE)


def _remove(parents: list[Path]) -> None:
    """Remove folders that were made for a target, the innermost first; those that hold something stay."""
    for parent in parents:
        with contextlib.suppress(OSError):
            parent.rmdir()


def _locked(folder: Path, *, wait: bool) -> int | None:
    """A lock on a folder; None where somebody else has it, or where the system has none."""
    if sys.platform == "win32":
        return None
    lock = None
    try:
        lock = os.open(folder, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        _unlocked(lock)
        return None
    return lock


def _unlocked(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


class FileSet:
    """The files of a report, a frozen dataclass of paths; None for one that there is not."""

    __slots__ = ()

    def __iter__(self) -> Iterator[Path]:
        own: Any = self  # a dataclass: this class has no fields of its own
        return (path for field in fields(own) if (path := getattr(self, field.name)) is not None)

    @property
    def names(self) -> list[str]:
        """File names alone."""
        return [path.name for path in self]


def refuse_names(folder: Path, names: Iterable[str], existing: Existing) -> None:
    """Raise before any work is done when files of these names could not be written.

    Raises:
        InvalidDataError: as in `write_folder`.
    """
    nearest = _nearest(folder)
    try:
        there = [name for name in names if (folder / name).exists()]
    except OSError as error:
        raise _cannot_write(folder, error) from error
    if folder.is_symlink() and not folder.exists():
        raise InvalidDataError(f"{_named(folder)} is a link to a place that does not exist; make it, or remove it.")
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


def _named(folder: Path) -> str:
    return repr(str(folder))


def _make_parents(target: Path) -> list[Path]:
    """Make the folders above the target; return those made, the innermost first."""
    try:
        above = (target.absolute(), *target.absolute().parents)
        missing = [parent for parent in above[1:] if not parent.exists()]
        if any(folder in above and not folder.exists() for folder in _STANDING):
            raise FileNotFoundError(errno.ENOENT, "the folder was removed while the program ran")
        target.absolute().parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_write(target, error) from error
    return missing


def _commit(temporary: Path, target: Path, names: list[str], existing: Existing, gone: Sequence[str]) -> None:
    """The one step in which the folder appears: a rename for a new one, an exchange for one that is there.

    Both are one step of the file system: a process that dies leaves the old folder or the new one. Other files of the
    old folder are linked into the new one before.
    """
    for path in temporary.rglob("*"):
        if path.is_file():
            _to_disk(path)
    lock = _locked(target.absolute().parent, wait=True)
    try:
        refuse_names(target, names, existing)  # another run may have been faster
        if not target.exists():
            mask = os.umask(0)
            os.umask(mask)
            temporary.chmod(0o777 & ~mask)
            temporary.rename(target)
            return
        with uninterrupted():
            replaced = {*names, *gone} if existing == "replace" else set()
            if not _exchanged(temporary, target.resolve(), replaced):
                _replace_each(temporary, target, replaced)
    finally:
        _unlocked(lock)


def _check_whole(target: Path, written: Iterable[str]) -> None:
    if not all((target / name).exists() for name in written):
        raise FileNotFoundError(errno.ENOENT, "files of it were removed while it was written")


def _to_disk(path: Path) -> None:
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _exchanged(temporary: Path, target: Path, replaced: set[str]) -> bool:
    """Exchange two folders in one step; False where that cannot be done.

    It cannot where the system has no such step, where somebody would stand in the old folder (this process, or what is
    mounted there), or where it holds folders, which cannot be linked.
    """
    kept = [path for path in target.iterdir() if path.name not in replaced]
    here = target in (Path.cwd(), *Path.cwd().parents)
    if here or any(path.is_dir() or path.is_symlink() for path in kept) or not _swaps():
        return False
    try:
        for path in kept:
            os.link(path, temporary / path.name)
        shutil.copymode(target, temporary)
        return _swap(temporary, target)
    except OSError:
        for path in kept:
            (temporary / path.name).unlink(missing_ok=True)
        return False


def _swaps() -> bool:
    return sys.platform == "linux" and hasattr(ctypes.CDLL(None), "renameat2")


def _swap(one: Path, other: Path) -> bool:
    """renameat2(2) with RENAME_EXCHANGE; relative paths are of the working folder (AT_FDCWD)."""
    here, exchange = -100, 2
    status = ctypes.CDLL(None).renameat2(here, os.fsencode(one), here, os.fsencode(other), exchange)
    return bool(status == 0)


def _replace_each(temporary: Path, target: Path, replaced: set[str]) -> None:
    """File by file, each at once.

    Where open files are locked (Windows), renaming one to its own name fails, and so does the whole before anything
    is replaced; elsewhere that does nothing.
    """
    files = sorted(temporary.iterdir())
    for there in (target / path.name for path in files):
        if there.exists():
            there.replace(there)
    for path in files:
        path.replace(target / path.name)
    for name in replaced - {path.name for path in files}:
        (target / name).unlink(missing_ok=True)


def _cannot_write(target: Path, error: OSError) -> InvalidDataError:
    return InvalidDataError(
        f"{_named(target)} cannot be written ({error.strerror or error}); choose another folder for the report."
    )


BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "msedge",
    "brave-browser",
)
"""Commands of browsers that print without a window, in the order in which they are looked for."""

BROWSER_VARIABLE = "MODAL_REPORT_BROWSER"
"""Environment variable that names another browser of this family."""

LONGEST_WAIT = 180.0
"""Seconds after which the browser is taken to be stuck."""

_QUIET = (
    "--headless",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-pdf-header-footer",
)

_DATE = re.compile(rb"/(CreationDate|ModDate) \(D:\d{14}[^)]*\)")


class NoBrowserError(IdentificationError):
    """No browser was found that can print a page, or it failed to."""


def find_browser() -> str | None:
    """The browser that would print: that of the variable MODAL_REPORT_BROWSER, else the first installed one."""
    named = os.environ.get(BROWSER_VARIABLE, "")
    if named:
        return shutil.which(named)
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def write_pdf(html: str | os.PathLike[str], pdf: str | os.PathLike[str]) -> Path:
    """Print a page of a report to A4.

    Args:
        html: the page, `report.html`.
        pdf: file to write; it appears once it is complete, in place of one of the same name.

    Returns:
        The path of the PDF.

    Raises:
        InvalidDataError: there is no such page, or the PDF cannot be written.
        NoBrowserError: no browser of the Chromium family is installed, or it failed.
    """
    page, target = Path(html).absolute(), Path(pdf)
    if not page.is_file():
        raise InvalidDataError(f"there is no page {str(page)!r} to print; write the report first.")
    browser = find_browser()
    if browser is None:
        raise NoBrowserError(
            "a PDF needs Chromium, Chrome or Edge, and none is installed (or name one in "
            f"{BROWSER_VARIABLE}); open {page.name} in any browser and print it to a file instead."
        )
    sweep(target.absolute().parent)
    try:
        with scratch_folder(target.absolute().parent) as folder:
            printed = folder / "report.pdf"
            _print(browser, page, printed)
            printed.write_bytes(_without_clock(printed.read_bytes()))
            printed.replace(target)
    except OSError as error:
        raise InvalidDataError(
            f"{str(target)!r} cannot be written ({error.strerror or error}); choose another folder for the PDF."
        ) from error
    return target


def _print(browser: str, page: Path, printed: Path) -> None:
    command = [browser, *_QUIET, f"--user-data-dir={printed.parent / 'profile'}"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.append("--no-sandbox")  # the sandbox of Chromium refuses to run for root, as in a container
    command += [f"--print-to-pdf={printed}", page.as_uri()]
    try:
        run = subprocess.run(command, capture_output=True, timeout=LONGEST_WAIT, check=False)  # noqa: S603 - no shell, our own page
    except subprocess.TimeoutExpired as error:
        raise NoBrowserError(
            f"{Path(browser).name} did not print {page.name} within {LONGEST_WAIT:.0f} s; print it from a window."
        ) from error
    if run.returncode or not printed.is_file():
        raise NoBrowserError(
            f"{Path(browser).name} could not print {page.name} (exit status {run.returncode}); print it from a window."
        )


def _without_clock(document: bytes) -> bytes:
    """The dates of the file exchanged for one day, without moving a byte: offsets in a PDF are counted.

    Example:
        >>> _without_clock(b"/CreationDate (D:20260504120000+00'00')")
        b"/CreationDate (D:20000101000000+00'00')"
    """
    return _DATE.sub(lambda date: re.sub(rb"D:\d{14}", b"D:20000101000000", date.group()), document)
