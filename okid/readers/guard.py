"""Checks before a file is opened: is it there, is it a file, does it fit into memory, is its library installed."""

import importlib
import os
import stat
from pathlib import Path
from types import ModuleType

from okid.errors import UnreadableFileError

__all__ = ["MAX_CHANNELS", "check_channel_count", "check_file", "check_memory", "first_line", "optional_package"]

MAX_CHANNELS = 4096
"""More columns than this are a mistake of format or orientation, not channels of one experiment."""

LONGEST_PATH = 200
"""Letters of a path in a sentence."""

MEMORY_SHARE = 0.8
"""Share of the machine's memory that reading one file may take."""


def check_file(path: Path) -> None:
    """Raise unless `path` is a file that holds something.

    Raises:
        UnreadableFileError: no such file, a folder, a pipe, an empty file, or one that may not be read.
    """
    try:
        found = path.stat()
    except OSError as error:
        reason = "does not exist" if isinstance(error, FileNotFoundError) else f"cannot be opened ({error.strerror})"
        raise UnreadableFileError(f"{_shortened(path)} {reason}; check the path.") from error
    if stat.S_ISDIR(found.st_mode):
        raise UnreadableFileError(f"{path} is a folder; give the file in it that holds the record.")
    if not stat.S_ISREG(found.st_mode):
        raise UnreadableFileError(
            f"{path} is a pipe or a device, and no file; save what comes out of it as a file first."
        )
    if found.st_size == 0:
        raise UnreadableFileError(f"{path} is empty (0 bytes); save the measurement again.")


def check_memory(path: Path, n_bytes: float) -> None:
    """Raise if reading `path`, which takes about `n_bytes` of memory, cannot end well on this machine.

    Raises:
        UnreadableFileError: more than `MEMORY_SHARE` of the memory would be needed.
    """
    total = _memory_bytes()
    if total is not None and n_bytes > MEMORY_SHARE * total:
        raise UnreadableFileError(
            f"reading {path.name} needs about {n_bytes / 2**30:.1f} GiB, more than {MEMORY_SHARE:.0%} of the "
            f"{total / 2**30:.1f} GiB that this machine has; cut the file into parts, or save it as one .npy array, "
            "which is mapped and not loaded."
        )


def check_channel_count(path: Path, n_channels: int) -> None:
    """Raise if a file claims more columns than an experiment has.

    Raises:
        UnreadableFileError: more than `MAX_CHANNELS` columns.
    """
    if n_channels > MAX_CHANNELS:
        raise UnreadableFileError(
            f"{path.name} holds {n_channels} columns, more than the {MAX_CHANNELS} that one record may have; rows must "
            "be samples and columns channels, so save its transpose or fewer channels."
        )


def _shortened(path: Path) -> str:
    """The path as text of bounded length: one that is too long for the system is too long for a sentence as well."""
    text = str(path)
    return text if len(text) <= LONGEST_PATH else f"{text[: LONGEST_PATH // 2]}…{text[-LONGEST_PATH // 2 :]}"


def first_line(error: Exception) -> str:
    """What a foreign error says, in one line of bounded length; its kind if it says nothing."""
    return (str(error).strip() or type(error).__name__).splitlines()[0][:200]


def optional_package(module: str, path: Path) -> ModuleType:
    """Import an optional library, or say which command installs it.

    Raises:
        UnreadableFileError: the library is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UnreadableFileError(
            f"reading {path.name} needs the library {module.partition('.')[0]}, which is not installed; "
            'run: pip install "okid-modal[formats]".'
        ) from error


def _memory_bytes() -> int | None:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # not every system tells
        return None
