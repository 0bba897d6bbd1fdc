"""Where records stand on the timeline "time", and how finely each is stored.

Several records share the timeline. A record keeps its own time where it starts after the one before it has ended (parts
of one long measurement do); otherwise it is moved to follow the one before it after a short pause, which stays empty in
every plot. The entity `data/records` says where each one stands.
"""

from collections.abc import Sequence
from typing import Final, Protocol

import numpy as np

from modal.recording.levels import StoredStretch, stretches
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.record import Record

__all__ = ["Span", "Tracks", "laid_out", "stored_levels"]

LATEST: Final = 9.2e9
"""Rerun counts time in nanoseconds, with 63 bits [s]."""


class Tracks(Protocol):
    """Where each record stands on the timeline, and how finely it is stored; see `modal.recording.plan`."""

    @property
    def starts(self) -> tuple[float, ...]:
        """When each record begins on the timeline [s]."""

    @property
    def levels(self) -> tuple[tuple[StoredStretch, ...], ...]:
        """The stretches in which each record is stored."""


class Span(Protocol):
    """Where the timeline begins and ends; see `modal.recording.plan`."""

    @property
    def start(self) -> float:
        """Where it begins [s]."""

    @property
    def stop(self) -> float:
        """Where it ends [s]."""


def stored_levels(
    records: Sequence[Record], budget: int, *, around: Sequence[int] = ()
) -> tuple[tuple[StoredStretch, ...], ...]:
    """How each record is stored so that all of them together keep within the budget of rows.

    Args:
        records: of one recording.
        budget: rows that each series may have, over all records.
        around: for each record, the sample around which every sample is wanted.
    """
    n_samples = sum(record.n_samples for record in records)
    if n_samples <= budget:
        return tuple(stretches(record.n_samples, record.n_samples) for record in records)
    shares = [max(64, budget * record.n_samples // n_samples) for record in records]
    wanted: list[Sequence[int]] = [[sample] for sample in around] or [[]] * len(records)
    return tuple(
        stretches(record.n_samples, share, around=samples)
        for record, share, samples in zip(records, shares, wanted, strict=True)
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
