"""What a recording of one identification will hold, settled before anything is written.

The pages and the blueprint must agree on paths, on what is shown and on the time axis; they all read it here.

Several records share the timeline "time". A record keeps its own time where it starts after the one before it has
ended (parts of one long measurement do); otherwise it is moved to follow the one before it after a short pause, which
stays empty in every plot. The entity `fit/records` says where each one stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from modal.identification import Identification
from modal.mode import Mode
from modal.numbering import numbered
from modal.recording.levels import bucket_length, series_budget
from modal.recording.names import path_parts
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.record import Record

__all__ = ["SERIES_PER_OUTPUT", "Plan", "Span", "Tracks", "laid_out", "planned"]

SHOWN_INPUTS: Final = 6
SHOWN_OUTPUTS: Final = 12
SHOWN_MODES: Final = 9
"""Views stay bounded, whatever comes; the numbers of all the others are stored as well."""

LATEST: Final = 9.2e9
"""Rerun counts time in nanoseconds, with 63 bits [s]."""

SERIES_PER_OUTPUT: Final = 5  # measured, predicted, simulated, residuals of both


class Tracks(Protocol):
    """Where each record stands on the timeline, and how finely it is stored; see `Plan`."""

    @property
    def starts(self) -> tuple[float, ...]:
        """When each record begins on the timeline [s]."""

    @property
    def buckets(self) -> tuple[int, ...]:
        """Samples a stored bucket of each record."""


class Span(Protocol):
    """Where the timeline begins and ends; see `Plan`."""

    @property
    def start(self) -> float:
        """Where it begins [s]."""

    @property
    def stop(self) -> float:
        """Where it ends [s]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plan:
    """What is shown, where it is stored and when it plays.

    Attributes:
        input_paths: entity of each input.
        output_paths: entity above the series of each output.
        shown_outputs: outputs that have views of their own.
        modes: every mode in the order of its number (`modal.numbering`); their position from 1 is the number used on
            every page, in the report and on the timeline "mode".
        shapes: numbers (from 1) of the modes whose shapes are drawn.
        shifts: seconds by which each record is moved on the timeline.
        starts: when each record begins on the timeline [s].
        stops: when each record ends on the timeline [s].
        buckets: samples a stored bucket of each record, 1 where every sample is stored.
        window: length of the window which follows the cursor [s].
    """

    input_paths: tuple[str, ...]
    output_paths: tuple[str, ...]
    shown_outputs: tuple[int, ...]
    modes: tuple[Mode, ...]
    shapes: tuple[int, ...]
    shifts: tuple[float, ...]
    starts: tuple[float, ...]
    stops: tuple[float, ...]
    buckets: tuple[int, ...]
    window: float

    @property
    def compared(self) -> bool:
        """Whether there are shapes to compare: several, of several outputs each."""
        return len(self.shapes) > 1 and len(self.output_paths) > 1

    @property
    def start(self) -> float:
        """Where the timeline begins [s]."""
        return self.starts[0]

    @property
    def stop(self) -> float:
        """Where it ends [s]."""
        return self.stops[-1]


def planned(identification: Identification) -> Plan:
    """The plan for one identification.

    Args:
        identification: what will be recorded.

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    records = identification.records
    first = records[0]
    starts, stops = laid_out(records)
    n_samples = sum(record.n_samples for record in records)
    budget = series_budget(first.n_inputs + SERIES_PER_OUTPUT * first.n_outputs)
    bucket = bucket_length(n_samples, budget)
    modes = tuple(mode for _, mode in numbered(identification.modes.modes))
    return Plan(
        input_paths=tuple(f"fit/input/{part}" for part in path_parts(first.input_names)),
        output_paths=tuple(f"fit/output/{part}" for part in path_parts(first.output_names)),
        shown_outputs=tuple(range(min(first.n_outputs, SHOWN_OUTPUTS))),
        modes=modes,
        shapes=_drawn(modes),
        shifts=tuple(start - record.start_time for start, record in zip(starts, records, strict=True)),
        starts=starts,
        stops=stops,
        buckets=(bucket,) * len(records),
        window=_window(modes, first.dt, stops[-1] - starts[0]),
    )


def laid_out(records: Sequence[Record]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """When each record begins and ends on the common timeline [s].

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    starts, stops = _in_turn(np.array([[r.start_time, r.start_time + (r.n_samples - 1) * r.dt] for r in records]))
    furthest = max(abs(starts[0]), abs(stops[-1]))
    if not furthest <= LATEST:
        raise InvalidDataError(
            f"a recording holds times up to {LATEST:g} s (292 years), but the records reach {furthest:.3g} s; count "
            "time in a larger unit, so that dt is smaller."
        )
    return starts, stops


def _in_turn(spans: FloatArray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    lengths = spans[:, 1] - spans[:, 0]
    pause = 0.02 * float(lengths.sum())
    starts = [float(spans[0, 0])]
    stops = [float(spans[0, 1])]
    for (begin, _), length in zip(spans[1:], lengths[1:], strict=True):
        starts.append(float(begin) if begin > stops[-1] else stops[-1] + pause)
        stops.append(starts[-1] + float(length))
    return tuple(starts), tuple(stops)


def _drawn(modes: tuple[Mode, ...]) -> tuple[int, ...]:
    """Modes of the system; where there are none, the doubtful ones, so that there is something to judge."""
    for verdict in ("system", "doubtful"):
        chosen = [number for number, mode in enumerate(modes, start=1) if mode.verdict == verdict]
        if chosen:
            return tuple(chosen[:SHOWN_MODES])
    return ()


def _window(modes: tuple[Mode, ...], dt: float, duration: float) -> float:
    """Eight periods of the lowest system mode, but at least 60 and at most 600 samples, and a tenth of the record."""
    system = [mode.frequency for mode in modes if mode.verdict == "system" and mode.frequency > 0]
    wanted = 8.0 / min(system) if system else 300 * dt
    return float(min(np.clip(wanted, 60 * dt, 600 * dt), max(duration / 10, 20 * dt)))
