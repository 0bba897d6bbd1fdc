"""How a result can be made again, and from exactly which files."""

import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from okid.errors import InvalidDataError

DISTRIBUTION = "okid-modal"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SourceFile:
    """One file as it was when it was read.

    Attributes:
        name: path as it was given.
        size: in bytes.
        sha256: of its bytes, in hexadecimal.
    """

    name: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Provenance:
    """What a report says about where its result comes from; whoever calls the library knows, the result does not.

    Attributes:
        command: command line that made the result, "" where there was none.
        sources: paths of the files with the records (and the model of a comparison), as they were given.
        besides: paths of the other files that were read, such as a test file or a geometry.
        dt: time step that was given with them [s], None where the files have their own.
        remarks: what the reader did to the data, such as units that it converted, in words.
        files: size and hash of each file that was read; see `fingerprints`.
    """

    command: str = ""
    sources: tuple[str, ...] = ()
    besides: tuple[str, ...] = ()
    dt: float | None = None
    remarks: tuple[str, ...] = ()
    files: tuple[SourceFile, ...] = ()


def fingerprints(paths: Iterable[str | os.PathLike[str]]) -> tuple[SourceFile, ...]:
    """Size and SHA-256 of each file, so that a reader can tell years later whether it is the same.

    Raises:
        InvalidDataError: a file that cannot be read.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "a.csv"
        >>> _ = path.write_bytes(b"abc")
        >>> [(file.size, file.sha256[:8]) for file in fingerprints([path])]
        [(3, 'ba7816bf')]
    """
    return tuple(_fingerprint(path) for path in paths)


def _fingerprint(path: str | os.PathLike[str]) -> SourceFile:
    try:
        with Path(path).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
    except OSError as error:
        raise InvalidDataError(
            f"{str(path)!r} cannot be read again for its hash ({error.strerror or error}); keep the file in its place "
            "until the report is written."
        ) from error
    return SourceFile(name=str(path), size=size, sha256=digest)


def installed_version() -> str:
    """Version of the installed distribution, "not installed" when the packages run from a bare source tree."""
    try:
        return metadata.version(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return "not installed"
