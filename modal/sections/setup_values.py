"""The set-up as a page shows it: what the test file says of the article and of each sensor, beside each channel."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from modal.identification.result import Identification

if TYPE_CHECKING:
    from modal.acceptance.test_file import SensorNote, Specification

__all__ = ["ChannelRow", "about_lines", "channel_rows", "sensor_columns"]

MOST_BANDS = 6
"""Bands of an input that are written out."""

_COLUMNS = (
    ("dof", "place"),
    ("kind", "sensor"),
    ("maker", "maker"),
    ("model", "type"),
    ("serial", "serial"),
    ("sensitivity", "sensitivity"),
    ("calibrated", "calibrated"),
    ("note", "note"),
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChannelRow:
    """One row of the table of channels.

    Attributes:
        name: of the channel.
        role: "input" or "output".
        unit: "" where unknown.
        notes: one an entry of `sensor_columns`.
        bands: where an input moves, in words; "" for an output.
    """

    name: str
    role: str
    unit: str
    notes: tuple[str, ...]
    bands: str


def about_lines(specification: "Specification | None") -> tuple[tuple[str, str], ...]:
    """(heading, text) of what the test file says of the test as a whole; nothing for what it leaves out."""
    if specification is None:
        return ()
    said = (
        ("Article", specification.article),
        ("Operator", specification.operator),
        ("Place", specification.place),
        ("Date", "" if specification.date is None else specification.date.isoformat()),
        ("Notes", specification.notes),
    )
    return tuple((what, text) for what, text in said if text)


def sensor_columns(specification: "Specification | None") -> tuple[str, ...]:
    """Headings of what is known of at least one sensor."""
    return tuple(heading for _, heading in _used(specification))


def channel_rows(result: Identification, specification: "Specification | None") -> tuple[ChannelRow, ...]:
    """Inputs, then outputs, each with what is known of its sensor."""
    record, used = result.records[0], _used(specification)
    notes = {} if specification is None else {note.channel: note for note in specification.sensors}
    bands = [_bands_text(bands) for bands in result.excitation.excited_bands] or [""] * record.n_inputs
    return tuple(
        ChannelRow(
            name=name,
            role=role,
            unit=unit,
            notes=tuple(_said(notes.get(name), key) for key, _ in used),
            bands=bands[number] if role == "input" else "",
        )
        for role, names, units in (
            ("input", record.input_names, record.input_units),
            ("output", record.output_names, record.output_units),
        )
        for number, (name, unit) in enumerate(zip(names, units, strict=True))
    )


def _used(specification: "Specification | None") -> tuple[tuple[str, str], ...]:
    notes = () if specification is None else specification.sensors
    return tuple((key, heading) for key, heading in _COLUMNS if any(getattr(note, key) for note in notes))


def _said(note: "SensorNote | None", key: str) -> str:
    said = None if note is None else getattr(note, key)
    return str(said) if said else "–"


def _bands_text(bands: tuple[tuple[float, float], ...]) -> str:
    if not bands:
        return "nowhere"
    more = f" and {len(bands) - MOST_BANDS} more bands" if len(bands) > MOST_BANDS else ""
    return ", ".join(f"{low:.3g} to {high:.3g}" for low, high in bands[:MOST_BANDS]) + more
