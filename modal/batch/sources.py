"""Which files make which record of a batch: globs and folders spread out, groups, names, and the hash of each file."""

import glob
import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from modal.sections.provenance import installed_version
from modal.wording.names import shorten, visible
from okid.errors import InvalidDataError
from okid.readers.dispatch import READERS
from okid.record import InputHold

__all__ = ["Settings", "Sources", "Unit", "units_of"]

Sources = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
"""A file, a folder or a pattern such as "runs/*.csv", or several of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How every record of a batch is read and identified; part of the name of each result.

    Attributes:
        inputs: names of the inputs, as in `okid.read_record`.
        outputs: names of the outputs.
        dt: time step [s], where the files have none.
        input_hold: what the inputs did between samples.
        observer_order: as in `modal.identify`.
        ridge: likewise.
        order: likewise.
    """

    inputs: tuple[str, ...] | None = None
    outputs: tuple[str, ...] | None = None
    dt: float | None = None
    input_hold: InputHold = "band_limited"
    observer_order: int | Literal["auto"] = "auto"
    ridge: float | Literal["auto"] = "auto"
    order: int | Literal["auto"] = "auto"


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """What is identified together: one file, or the files of one group.

    Attributes:
        record: its name, unique in the batch.
        paths: of its files.
        hashes: SHA-256 of each file; "" where it cannot be read.
        twin: record that holds the same bytes and comes first, "" where there is none.
        key: name of its result: follows from the files' content, the name, the settings and the version.
    """

    record: str
    paths: tuple[str, ...]
    hashes: tuple[str, ...]
    twin: str
    key: str

    @property
    def hash(self) -> str:
        """Of the file, or of the hashes of several."""
        return self.hashes[0] if len(self.hashes) == 1 else _digest(*self.hashes)


def units_of(sources: Sources, settings: Settings, *, group_by: str | None, beside: Path) -> tuple[Unit, ...]:
    """The records of a batch by name.

    Args:
        sources: files, folders (every file of a known type in them) and patterns.
        settings: of the batch.
        group_by: regular expression, searched in the path of each file below their common folder; its first group
            names the group.
        beside: folder of the results; its own files are no records.

    Raises:
        InvalidDataError: nothing matches a source, or a file does not match `group_by`.
    """
    files = _spread(sources, beside)
    if group_by is None:
        groups = {name: [file] for name, file in zip(_names(files), files, strict=True)}
    else:
        groups = _grouped(files, group_by)
    first: dict[tuple[str, ...], str] = {}
    units = []
    for record in sorted(groups):
        hashes = tuple(_hash(file) for file in groups[record])
        twin = first.setdefault(hashes, record) if all(hashes) else record
        paths = tuple(map(str, groups[record]))
        key = _digest(json.dumps([installed_version(), asdict(settings), record, hashes, [] if all(hashes) else paths]))
        units.append(Unit(record=record, paths=paths, hashes=hashes, twin="" if twin == record else twin, key=key))
    return tuple(units)


def _spread(sources: Sources, beside: Path) -> list[Path]:
    several = [sources] if isinstance(sources, str | os.PathLike) else list(sources)
    results = beside.resolve()
    found: dict[Path, Path] = {}
    for given in several:
        source = str(given)
        path = Path(source)
        if path.is_dir():
            own = [one for one in sorted(path.iterdir()) if one.suffix.lower() in READERS and one.is_file()]
        elif not path.exists() and glob.has_magic(source):
            own = [one for one in map(Path, sorted(glob.glob(source, recursive=True))) if one.is_file()]  # noqa: PTH207 - Path.glob takes no absolute pattern
        else:
            own = [path]
        kept = {one.resolve(): one for one in own if path in own or results not in one.resolve().parents}
        if not kept:
            raise InvalidDataError(
                f"{_shown(source)} holds or matches no measured file; give files, a folder, or a pattern such as "
                "'runs/*.csv'."
            )
        found |= {place: one for place, one in kept.items() if place not in found}
    if not found:
        raise InvalidDataError("no file was given; name at least one.")
    return list(found.values())


def _names(files: Sequence[Path]) -> list[str]:
    """The shortest kind of name that tells all files apart."""
    whole = _below_common(files)
    for names in (
        [file.stem for file in files],
        [file.name for file in files],
        [path.with_suffix("").as_posix() for path in whole],
    ):
        if max(Counter(names).values()) == 1:
            return names
    return [path.as_posix() for path in whole]


def _below_common(files: Sequence[Path]) -> list[Path]:
    """The paths from the folder on that all files have in common."""
    base = Path(os.path.commonpath([file.absolute().parent for file in files]))
    return [file.absolute().relative_to(base) for file in files]


def _grouped(files: Sequence[Path], pattern: str) -> dict[str, list[Path]]:
    try:
        compiled = re.compile(pattern)
    except re.error as error:
        raise InvalidDataError(f"{pattern!r} is no regular expression ({error}); see Python's re.") from error
    if not compiled.groups:
        raise InvalidDataError(
            f"{pattern!r} has no group; put the part that names the group into brackets, as in '(test\\d+)_'."
        )
    groups: dict[str, list[Path]] = {}
    for file, below in zip(files, _below_common(files), strict=True):
        match = compiled.search(below.as_posix())
        if match is None or not match[1]:
            raise InvalidDataError(
                f"{_shown(file)} does not match {pattern!r}, so it has no group; correct the pattern, or leave the "
                "file out."
            )
        groups.setdefault(match[1], []).append(file)
    return groups


def _hash(file: Path) -> str:
    try:
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError:
        return ""  # reading it will say why


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode("utf-8", "backslashreplace")).hexdigest()


def _shown(path: object) -> str:
    return repr(shorten(visible(str(path)), 200))
