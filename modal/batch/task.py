"""One record of a batch, wherever it is worked on: read, identified, its result in a folder of its own.

The folder appears under its name when it is complete, so a result is there once or not at all. What the file itself
makes impossible is a result too, kept like the others; what may be another time (memory, a fault) is tried again by the
next call. A folder that cannot be written is no result of the file: it stops the batch.

Globs and folders are spread out and files grouped into records first; each record has a name, each file its hash.
"""

import glob
import hashlib
import json
import os
import re
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from modal.identification.pipeline import identify
from modal.identification.result import Identification
from modal.identification.words import trust_of
from modal.modes.mode import numbered
from modal.report.folder import write_folder
from modal.report.machine import csv_text
from modal.report.writing import keep_result
from modal.sections.validation import installed_version
from modal.wording.text import shorten
from okid.errors import IdentificationError, InvalidDataError, UnreadableFileError, visible
from okid.readers import read_records
from okid.readers.dispatch import READERS
from okid.record import InputHold, Record

Sources = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
"""A file, a folder or a pattern such as "runs/*.csv", or several of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How every record of a batch is read and identified; part of the name of each result."""

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
        twin: its file whose bytes another record holds too, and that record, which comes first; None without.
        key: name of its result: follows from the files' content, the name, the settings, the version and the twin.
    """

    record: str
    paths: tuple[str, ...]
    hashes: tuple[str, ...]
    twin: tuple[str, str] | None
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
        InvalidDataError: nothing matches a source, no file exists, or a file does not match `group_by`.
    """
    files = _spread(sources, beside)
    if group_by is None:
        groups = {name: [file] for name, file in zip(_names(files), files, strict=True)}
    else:
        groups = _grouped(files, group_by)
    first: dict[str, str] = {}
    units, version = [], installed_version()
    for record in sorted(groups):
        hashes = tuple(_hash(file) for file in groups[record])
        paths = tuple(map(str, groups[record]))
        twin = next(((path, first[one]) for path, one in zip(paths, hashes, strict=True) if one in first), None)
        first |= {one: record for one in hashes if one and one not in first}
        known = [version, asdict(settings), record, hashes, [] if all(hashes) else paths]
        key = _digest(json.dumps([*known, twin[1]] if twin else known))  # it fails no more once the other is gone
        units.append(Unit(record=record, paths=paths, hashes=hashes, twin=twin, key=key))
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
        named = own == [path]  # a file, even one of the results
        kept = {one.resolve(): one for one in own if named or results not in one.resolve().parents}
        if not kept:
            raise InvalidDataError(
                f"{_shown(source)} holds or matches no measured file; give files, a folder, or a pattern such as "
                "'runs/*.csv'."
            )
        found |= {place: one for place, one in kept.items() if place not in found}
    if not found:
        raise InvalidDataError("no file was given; name at least one.")
    files = list(found.values())
    if not any(file.exists() for file in files):  # one of many that is gone is a result of its own
        who = _shown(str(files[0])) if len(files) == 1 else f"none of the {len(files)} files"
        raise InvalidDataError(f"{who} {'does not exist' if len(files) == 1 else 'exists'}; check the path.")
    return files


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
    if not file.is_file():  # a pipe would be waited for
        return ""
    try:
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError:
        return ""  # reading it will say why


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode("utf-8", "backslashreplace")).hexdigest()


def _shown(path: object) -> str:
    return repr(shorten(visible(str(path)), 200))


RESULT, MODES, OUTCOME = "result.npz", "modes.csv", "outcome.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a record.

    Attributes:
        record: its name.
        paths: of its files.
        hash: of their content.
        status: "done" or "failed".
        message: why it failed, in one sentence; "" where it is done.
        seconds: that it took.
        lasting: False where another try may go better.
        trust: "carried", "with care" or "not carried"; "" where it failed.
        start_time: of the first sample [s].
        dt: time step as measured [s].
        n_samples: of all its files.
        inputs: channels identified, with their units.
        outputs: likewise, in the order of the shapes' components.
        left_out: outputs of the file that never moved.
    """

    record: str
    paths: tuple[str, ...]
    hash: str
    status: Literal["done", "failed"]
    message: str = ""
    seconds: float = 0.0
    lasting: bool = True
    trust: str = ""
    start_time: float = 0.0
    dt: float = 0.0
    n_samples: int = 0
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


def folder_of(unit: Unit, folder: Path) -> Path:
    """The folder of a record: its name to read, its key to be exact."""
    plain = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in unit.record)
    return folder / f"{plain[:60].lstrip('.') or 'record'}-{unit.key[:16]}"


def kept_outcome(place: Path) -> Outcome | None:
    """What an earlier call found, None where it found nothing that lasts."""
    try:
        known = json.loads((place / OUTCOME).read_text(encoding="utf-8"))
        listed = {field.name: known[field.name] for field in fields(Outcome)}
        values: dict[str, Any] = {name: tuple(one) if isinstance(one, list) else one for name, one in listed.items()}
        outcome, _ = Outcome(**values), known["modes"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return outcome if outcome.lasting and (outcome.status == "failed" or (place / RESULT).is_file()) else None


def run_unit(unit: Unit, settings: Settings, folder: str) -> Outcome:
    """Identify a record and keep its result; the result of an earlier try is taken as it is.

    Raises:
        InvalidDataError: the folder cannot be written.
    """
    place = folder_of(unit, Path(folder))
    kept = kept_outcome(place)
    if kept is not None:
        return kept
    began = time.perf_counter()
    blank = Outcome(record=unit.record, paths=unit.paths, hash=unit.hash, status="failed")
    try:
        records, result = _identified(unit, settings)
    except IdentificationError as error:
        return write_failure(replace(blank, message=_said(error), seconds=time.perf_counter() - began), place)
    except Exception as error:  # noqa: BLE001 - one file must not stop the batch
        fault = f"a fault in modal-report stopped the work ({type(error).__name__}: {error})."
        return write_failure(
            replace(blank, message=_said(fault), seconds=time.perf_counter() - began, lasting=False), place
        )
    first, known = records[0], result.channels
    outputs = _channels(known.output_names, known.output_units)
    outcome = replace(
        blank,
        status="done",
        trust=trust_of(result).trust,
        seconds=time.perf_counter() - began,
        start_time=first.start_time,
        dt=first.dt,
        n_samples=sum(one.n_samples for one in records),
        inputs=_channels(known.input_names, known.input_units),
        outputs=outputs,
        left_out=tuple(one for one in _channels(first.output_names, first.output_units) if one not in outputs),
    )

    def write(made: Path) -> None:
        keep_result(result, made / RESULT, files=unit.hashes)
        (made / MODES).write_bytes(csv_text(result).encode("utf-8"))

    return _commit(outcome, place, write, modes=_mode_rows(result))


def _mode_rows(result: Identification) -> list[dict[str, object]]:
    """What the table of modes says of a result: complex numbers as pairs."""
    return [
        {
            "mode": number,
            "frequency": mode.frequency,
            "frequency_std": mode.frequency_std,
            "damping_ratio": mode.damping_ratio,
            "damping_ratio_std": mode.damping_ratio_std,
            "probability": mode.probability,
            "verdict": mode.verdict,
            "shape": [[value.real, value.imag] for value in mode.shape.tolist()],
        }
        for number, mode in numbered(result.modes.modes)
    ]


def kept_modes(place: Path) -> list[dict[str, Any]]:
    """A row a pole of what is kept of a record.

    Raises:
        UnreadableFileError: it is damaged or gone.
    """
    try:
        rows: list[dict[str, Any]] = json.loads((place / OUTCOME).read_text(encoding="utf-8"))["modes"]
    except (OSError, ValueError, KeyError) as error:
        raise UnreadableFileError(
            f"{_shown(place)} is damaged or gone; remove what is left of it and give the same command again."
        ) from error
    return rows


def write_failure(outcome: Outcome, place: Path) -> Outcome:
    """Keep why a record failed.

    Raises:
        InvalidDataError: the folder cannot be written.
    """
    return _commit(outcome, place, lambda _made: None, modes=[])


def _identified(unit: Unit, settings: Settings) -> tuple[tuple[Record, ...], Identification]:
    if unit.twin:
        file, other = unit.twin
        it = "it" if len(unit.paths) == 1 else f"its file {Path(file).name}"
        raise InvalidDataError(
            f"{it} holds the same bytes as {other!r}, and a record counts once; leave one of the two out."
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what a reader must know stands in the result
        records = read_records(
            unit.paths, inputs=settings.inputs, outputs=settings.outputs, dt=settings.dt, input_hold=settings.input_hold
        )
        if len(unit.paths) == 1 or len(records) == 1:
            records = tuple(replace(record, name=unit.record) for record in records)
        return records, identify(
            records, observer_order=settings.observer_order, ridge=settings.ridge, order=settings.order
        )


def _commit(
    outcome: Outcome, place: Path, write: Callable[[Path], None], *, modes: Sequence[dict[str, object]]
) -> Outcome:
    def write_all(made: Path) -> None:
        write(made)
        (made / OUTCOME).write_text(json.dumps({**asdict(outcome), "modes": modes}) + "\n", encoding="utf-8")

    try:
        write_folder(place, [OUTCOME], write_all, existing="replace", swept=False)
    except InvalidDataError as error:
        kept = kept_outcome(place)  # another try was quicker
        if kept is not None:
            return kept
        if isinstance(error.__cause__, OSError):
            raise InvalidDataError(
                f"{_shown(place)} cannot be written ({error.__cause__.strerror or error.__cause__}); finished results "
                "are kept, so make room and give the same command again."
            ) from error
        raise
    return outcome


def _channels(names: tuple[str, ...], units: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True))


def _said(error: object) -> str:
    return shorten(visible(str(error)), 1000)  # it may quote a stranger's file
