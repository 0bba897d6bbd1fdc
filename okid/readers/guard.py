"""Checks before a file is opened: is it there, is it a file, does it fit into memory, is its library installed.

And the one way to write a file: whole or not at all.
"""

import contextlib
import errno
import importlib
import math
import os
import secrets
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np

from okid.errors import InvalidDataError, UnreadableFileError, quiet, visible

MAX_CHANNELS = 4096
"""More columns than this are a mistake of format or orientation, not channels of one experiment."""

MAX_MEMBERS = 2 * MAX_CHANNELS
"""Refuse a file of more arrays: each channel may have one and its name another."""

MAX_DEPTH = 4
"""Look into no structure within more structures."""

DEFLATE_RATIO = 1032
"""Refuse compressed data that claim to unpack to more times their size: deflate has no shorter code than two bits for
258 bytes."""

MEMORY_SHARE = 0.8
"""Refuse to read a file or to identify a record that would take a greater share of the memory."""

CGROUPS, CGROUP_ROOT = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
MOUNTS = Path("/proc/self/mountinfo")


class Damage(Exception):  # noqa: N818 - it never leaves the boundary
    """What a reader of ours finds wrong with the bytes of a file."""


@contextlib.contextmanager
def foreign(path: Path, kind: str) -> Iterator[None]:
    """The boundary around a format's library: whatever it raises becomes one sentence, and its warnings are not shown.

    Raises:
        UnreadableFileError: the library, or one of our own types at what it gave, raised an error.
    """
    try:
        with quiet(), np.errstate(all="ignore"):
            yield
    except UnreadableFileError:
        raise
    except Exception as error:
        if "Object arrays" in str(error) or "Python objects" in str(error):  # numpy's words and ours
            raise UnreadableFileError(
                f"{path.name} holds pickled Python objects, which are never loaded because they may run any program; "
                "save plain arrays of numbers."
            ) from error
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            raise UnreadableFileError(
                f"{path.name} has {path.stat().st_size} bytes, more than this process may map; raise the limit "
                "(ulimit -v), or cut the file into parts."
            ) from error
        raise UnreadableFileError(
            f"{path.name} is damaged, cut off or no {kind} ({first_line(error)}); save or copy it again."
        ) from error


@contextlib.contextmanager
def sound_archive(path: Path, *, most: float | None = None) -> Iterator[zipfile.ZipFile]:
    """A ZIP archive whose table of contents claims nothing that cannot be, looked at before a member is unpacked.

    Args:
        path: of the file.
        most: bytes that its members may unpack to; None: what memory holds twice.

    Raises:
        UnreadableFileError: encrypted, too large, or members that claim more than their bytes can hold.
    """
    with zipfile.ZipFile(path) as archive:
        if archive.fp is None or archive.fp.seek(0) or archive.fp.read(2) != b"PK":
            raise Damage("it does not begin as an archive")
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        if any(member.flag_bits & 1 for member in members):
            raise UnreadableFileError(f"{path.name} is encrypted; save it without a password.")
        if len({member.filename for member in members}) < len(members) or len(members) > MAX_MEMBERS:
            raise Damage(f"its {len(members)} members are more than {MAX_MEMBERS}, or two have one name")
        if sum(member.compress_size for member in members) > path.stat().st_size:
            raise Damage("its members overlap")
        if any(member.file_size > DEFLATE_RATIO * member.compress_size for member in members):
            raise Damage("a member claims to unpack to more than it can hold")
        if any(member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for member in members):
            raise Damage("a member is packed in a way that is not read")
        if most is not None and size > most:
            raise UnreadableFileError(f"{path.name} unpacks to {size} bytes, and may to {most:.0f}; keep less in it.")
        check_memory(path, 2.0 * size)
        yield archive


def check_file(given: Any) -> Path:
    """The path of a file that holds something.

    Raises:
        UnreadableFileError: no path, no such file, a folder, a pipe, an empty file, or one that may not be read.
    """
    if not isinstance(given, str | os.PathLike):
        raise UnreadableFileError(
            f"a file must be named by its path, a text or a Path, but a {type(given).__name__} was given; give one."
        )
    path = Path(given)
    try:
        found = path.stat()
    except (OSError, ValueError) as error:  # a name that holds a zero byte is a ValueError
        why = error.strerror if isinstance(error, OSError) else error
        reason = "does not exist" if isinstance(error, FileNotFoundError) else f"cannot be opened ({why})"
        raise UnreadableFileError(f"{path} {reason}; check the path.") from error
    if stat.S_ISDIR(found.st_mode):
        raise UnreadableFileError(f"{path} is a folder; give the file in it that holds the record.")
    if not stat.S_ISREG(found.st_mode):
        raise UnreadableFileError(
            f"{path} is a pipe or a device, and no file; save what comes out of it as a file first."
        )
    if found.st_size == 0:
        raise UnreadableFileError(f"{path} is empty (0 bytes); save the measurement again.")
    return path


Existing = Literal["refuse", "replace"]
"""What to do with a file that is already there."""


@contextlib.contextmanager
def complete_file(path: Path) -> Iterator[Path]:
    """A file beside `path` to write to, which takes its place when the block ends well and is gone otherwise."""
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def new_file(path: Path, existing: Existing) -> Iterator[Path]:
    """The same of a file that a user asks for, refused where it should not or cannot be written.

    Raises:
        InvalidDataError: the file exists and may not be replaced, its folder does not exist, or it cannot be written.
    """
    if existing not in get_args(Existing):
        raise InvalidDataError(f"existing must be refuse or replace, but is {existing!r}.")
    if path.is_dir() or (existing == "refuse" and path.exists()):
        raise InvalidDataError(f"{path} exists already; choose another name, or pass existing='replace' for a file.")
    if not path.parent.is_dir():
        raise InvalidDataError(f"the folder {path.parent} does not exist; make it first.")
    try:
        with complete_file(path) as part:
            yield part
    except OSError as error:
        raise InvalidDataError(f"{path} cannot be written ({error.strerror or error}); use another place.") from error


def check_memory(path: Path, n_bytes: float) -> None:
    """Raise if reading `path`, which takes about `n_bytes` of memory, cannot end well on this machine.

    Raises:
        UnreadableFileError: more than `MEMORY_SHARE` of the memory would be needed.
    """
    total, whose = memory_budget()
    if n_bytes > MEMORY_SHARE * total:
        raise UnreadableFileError(
            f"reading {path.name} needs about {n_bytes / 2**30:.1f} GiB, more than {MEMORY_SHARE:.0%} of the "
            f"{total / 2**30:.1f} GiB that {whose}; cut the file into parts, or save it as one .npy array, "
            "which stays on disk."
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


def first_line(error: Exception) -> str:
    """What a foreign error says, in one line of bounded length; its kind if it says nothing."""
    return visible((str(error).strip() or type(error).__name__).splitlines()[0])[:200].rstrip(" .")


def optional_package(module: str, path: Path, *, extra: str = "formats") -> ModuleType:
    """Import an optional library, or say which command installs it.

    Raises:
        UnreadableFileError: the library is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UnreadableFileError(
            f"reading {path.name} needs the library {module.partition('.')[0]}, which is not installed; "
            f'run: pip install "okid-modal[{extra}]".'
        ) from error


def memory_budget() -> tuple[float, str]:
    """Bytes that this process may have, and who says so in words; infinite where nobody tells.

    The least of what the machine has, of the limit of the control group (a container), less what its processes hold
    already, and of the limit on the address space (ulimit -v), less what is mapped already.
    """
    limits = ((_machine(), "this machine has"), (_group(), "the container leaves"), (_address_space(), "ulimit leaves"))
    return min(limits, key=lambda limit: limit[0])


def in_memory(folder: Path) -> bool:
    """Whether the files in a folder take memory instead of disk; False where nobody tells.

    Raises:
        OSError: no such folder.
    """
    device = folder.stat().st_dev
    mounts = [line.partition(" - ") for line in _words(MOUNTS).splitlines()]
    held = {place.split()[2] for place, _, kind in mounts if kind.startswith(("tmpfs ", "ramfs "))}
    return bool(held) and f"{os.major(device)}:{os.minor(device)}" in held


def _machine() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):  # not every system tells
        return math.inf


def _group() -> float:
    """The tightest limit of the control groups that this process is in, versions 1 and 2, less what they hold."""
    found = [math.inf]
    for line in _words(CGROUPS).splitlines():
        _, _, rest = line.partition(":")
        controllers, _, name = rest.partition(":")
        if controllers and "memory" not in controllers.split(","):
            continue
        root = CGROUP_ROOT / ("memory" if controllers else "")
        most, held = (
            ("memory.limit_in_bytes", "memory.usage_in_bytes") if controllers else ("memory.max", "memory.current")
        )
        place = root / name.lstrip("/")
        for folder in (place, *place.parents):
            limit, used = _words(folder / most).strip(), _words(folder / held).strip()
            if limit.isdigit():
                found.append(float(limit) - (_reclaimable(folder, float(used)) if used.isdigit() else 0.0))
            if folder == root:
                break
    return min(found)


def _reclaimable(folder: Path, used: float) -> float:
    """What a group holds less the files that it could let go."""
    files = (line.partition(" ") for line in _words(folder / "memory.stat").splitlines())
    cached = {name: float(value) for name, _, value in files if name in ("inactive_file", "active_file")}
    return used - sum(cached.values())


def _address_space() -> float:
    try:
        import resource
    except ImportError:  # Windows
        return math.inf
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return math.inf
    pages = _words(Path("/proc/self/statm")).partition(" ")[0]
    return float(limit) - (int(pages) * os.sysconf("SC_PAGE_SIZE") if pages.isdigit() else 0)


def _words(path: Path) -> str:
    try:
        return path.read_text(encoding="latin-1")
    except OSError:
        return ""
