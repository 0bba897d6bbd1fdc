"""One record of a batch, wherever it is worked on: read, identified, its result in a folder of its own.

The folder appears under its name when it is complete, so a result is there once or not at all. What the file itself
makes impossible is a result too, kept like the others; what may be another time (memory, a fault) is tried again by the
next call. A folder that cannot be written is no result of the file: it stops the batch.
"""

import json
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from modal.batch.sources import Settings, Unit
from modal.identification.pipeline import identify
from modal.identification.result import Identification
from modal.identification.words import trust_of
from modal.report.folder import write_folder
from modal.report.machine import csv_text
from modal.report.writing import keep_result
from modal.wording.names import shorten, visible
from okid.errors import IdentificationError, InvalidDataError
from okid.readers import read_records
from okid.record import Record

__all__ = ["RESULT", "Outcome", "folder_of", "kept_outcome", "run_unit", "write_failure"]

RESULT, MODES, OUTCOME = "result.npz", "modes.csv", "outcome.json"
LONGEST_NAME = 60
"""Shorten the name of a record in that of its folder to so many letters."""
LONGEST_MESSAGE = 1000
"""Shorten a sentence, which may quote a stranger's file, to so many letters."""


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
        inputs: channels, with their units.
        outputs: likewise.
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
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


def folder_of(unit: Unit, folder: Path) -> Path:
    """The folder of a record: its name to read, its key to be exact."""
    plain = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in unit.record)
    return folder / f"{plain[:LONGEST_NAME].lstrip('.') or 'record'}-{unit.key[:16]}"


def kept_outcome(place: Path) -> Outcome | None:
    """What an earlier call found, None where it found nothing that lasts."""
    try:
        known = json.loads((place / OUTCOME).read_text(encoding="utf-8"))
        listed = {field.name: known[field.name] for field in fields(Outcome)}
        values: dict[str, Any] = {name: tuple(one) if isinstance(one, list) else one for name, one in listed.items()}
        outcome = Outcome(**values)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return outcome if outcome.lasting and (outcome.status == "failed" or (place / RESULT).is_file()) else None


def run_unit(unit: Unit, settings: Settings, folder: str) -> Outcome:
    """Identify a record and keep its result; the result of an earlier try is taken as it is.

    Args:
        unit: what to identify.
        settings: how.
        folder: for the folders of all records.

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
    first = records[0]
    outcome = replace(
        blank,
        status="done",
        trust=trust_of(result).trust,
        seconds=time.perf_counter() - began,
        start_time=first.start_time,
        dt=first.dt,
        inputs=_channels(first.input_names, first.input_units),
        outputs=_channels(first.output_names, first.output_units),
    )

    def write(made: Path) -> None:
        keep_result(result, made / RESULT, files=unit.hashes)
        (made / MODES).write_bytes(csv_text(result).encode("utf-8"))

    return _commit(outcome, place, write)


def write_failure(outcome: Outcome, place: Path) -> Outcome:
    """Keep why a record failed.

    Raises:
        InvalidDataError: the folder cannot be written.
    """
    return _commit(outcome, place, lambda _made: None)


def _identified(unit: Unit, settings: Settings) -> tuple[tuple[Record, ...], Identification]:
    if unit.twin:
        raise InvalidDataError(
            f"it holds the same bytes as {unit.twin!r}, and a record counts once; leave one of the two out."
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what a reader must know stands in the result
        records = read_records(
            unit.paths,
            inputs=settings.inputs,
            outputs=settings.outputs,
            dt=settings.dt,
            input_hold=settings.input_hold,
        )
        if len(unit.paths) == 1 or len(records) == 1:
            records = tuple(replace(record, name=unit.record) for record in records)
        return records, identify(
            records, observer_order=settings.observer_order, ridge=settings.ridge, order=settings.order
        )


def _commit(outcome: Outcome, place: Path, write: Callable[[Path], None]) -> Outcome:
    def write_all(made: Path) -> None:
        write(made)
        (made / OUTCOME).write_text(json.dumps(asdict(outcome), indent=1) + "\n", encoding="utf-8")

    try:
        write_folder(place, [OUTCOME], write_all, existing="replace")
    except InvalidDataError:
        kept = kept_outcome(place)  # another try was quicker
        if kept is None:
            raise
        return kept
    return outcome


def _channels(names: tuple[str, ...], units: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True))


def _said(error: object) -> str:
    return shorten(visible(str(error)), LONGEST_MESSAGE)
