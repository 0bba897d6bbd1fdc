"""Records cut into spans, each with its own initial state, where the motion cannot be followed along the whole.

Hard springs under a strong drive, and stops, part neighbouring motions exponentially: from the initial state to the end
of a long record no simulation, of the true model either, stays with the measurement. Over a few dozen periods it does.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from modal.discrepancy.noise.floor import NoiseFloor
from modal.discrepancy.validation.hold_hint import highest_frequency
from modal.wording.statements import number
from okid.arrays import FloatArray, frozen_with_gaps
from okid.record import Record

__all__ = ["cut_into_spans", "floor_of_spans", "span_words"]

PERIODS = 20.0
"""Length of a span in periods of the highest frequency that matters."""
FEWEST_SAMPLES = 200


def cut_into_spans(
    records: Sequence[Record], floor: FloatArray, *, fewest: int = 1
) -> tuple[tuple[Record, ...], tuple[int, ...]]:
    """Each record in spans of about equal length, in each of which every output is measured somewhere.

    Args:
        records: Whole ones.
        floor: (n_records, n_outputs) variance of their noise.
        fewest: Samples that a span must have.

    Returns:
        The spans, in order, and of each the position of its record.

    References:
        Bock, Recent advances in parameter identification techniques for ODE, 1983 (multiple shooting),
        https://doi.org/10.1007/978-1-4684-7324-7_7

    Example:
        >>> time = 0.01 * np.arange(2000)
        >>> record = Record(np.ones(2000), np.sin(2 * np.pi * 4.0 * time), 0.01, name="run")
        >>> spans, origin = cut_into_spans([record], np.array([[1e-9]]))
        >>> [(one.name, one.n_samples) for one in spans], origin
        ([('run, span 1', 500), ('run, span 2', 500), ('run, span 3', 500), ('run, span 4', 500)], (0, 0, 0, 0))
    """
    frequency = max(highest_frequency(tuple(records), floor), 1e-12)
    wanted = max(PERIODS / (frequency * records[0].dt), fewest, FEWEST_SAMPLES)
    spans: list[Record] = []
    origin: list[int] = []
    for position, record in enumerate(records):
        edges = _edges(record, max(int(record.n_samples / wanted), 1))
        own = [record.samples(first, last) for first, last in pairwise(edges)]
        if len(own) > 1:
            name = f"{record.name}, span" if record.name else "span"
            own = [replace(span, name=f"{name} {i + 1}") for i, span in enumerate(own)]
        spans += own
        origin += [position] * len(own)
    return tuple(spans), tuple(origin)


def _edges(record: Record, count: int) -> list[int]:
    """Where spans begin and end; fewer of them where one would lack an output throughout."""
    for fewer in range(count, 1, -1):
        edges = [int(edge) for edge in np.linspace(0, record.n_samples, fewer + 1)]
        if not any(np.isnan(record.outputs[first:last]).all(axis=0).any() for first, last in pairwise(edges)):
            return edges
    return [0, record.n_samples]


def floor_of_spans(floor: NoiseFloor, origin: Sequence[int]) -> NoiseFloor:
    """The floor of each span, which is that of its record.

    Args:
        floor: Of whole records.
        origin: Position of each span's record.
    """
    rows = list(origin)

    def of(values: FloatArray) -> FloatArray:
        return frozen_with_gaps(values[rows], name="floor")

    return NoiseFloor(
        variance=of(floor.variance),
        method=tuple(floor.method[row] for row in rows),
        reason=tuple(floor.reason[row] for row in rows),
        standard_error=of(floor.standard_error),
        random=of(floor.random),
        distortion=of(floor.distortion),
    )


def span_words(spans: Sequence[Record]) -> str:
    """What the reader must know of spans."""
    longest = max(span.n_samples for span in spans)
    return (
        "no simulation can follow this motion along a whole record, because it parts from its neighbours too fast "
        f"(chaos, or many impacts): the records were cut into spans of up to {longest} samples "
        f"({number(longest * spans[0].dt, 2)} s), each with an initial state of its own"
    )
