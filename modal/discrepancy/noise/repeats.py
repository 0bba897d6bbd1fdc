"""What differs between responses to the same input: the noise, and whatever else does not repeat; no model is needed.

The same input comes back in a second record, or after a period of the same record. The difference of the two responses
holds twice the variance of all that does not repeat. It begins with a transient, since the states at the start were not
the same; that part is left out: it is the model's to explain, not noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from modal.localisation.periods import input_period
from modal.simulation.tolerances import ROUNDING, UNLIKELY
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["Scatter", "exact_period", "period_scatter", "repeat_scatter", "repeated_records"]

_SAME_INPUT = 1e-6
"""Of an input's size: numbers that went through a text file agree as well as this."""
_SAME_PERIOD = 1e-7
"""Of the mean square: the response to what differs stays below a tenth of noise of 0.1 %."""
_FEWEST_ROWS = 64
"""Differences that must be left after the transient."""
_N_BLOCKS = 24
_LATEST = 18
"""Block by which a transient must have died out."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scatter:
    """What does not repeat.

    Attributes:
        variance: (n_outputs,) of one response [unit^2].
        standard_error: (n_outputs,) relative.
        memory: (n_outputs,) samples that are as sure as one of white noise; large for a narrow band.
        n_rows: differences behind it, after the transient.
        n_dropped: samples left out as transient.
    """

    variance: FloatArray
    standard_error: FloatArray
    memory: FloatArray
    n_rows: int
    n_dropped: int


def repeated_records(records: Sequence[Record]) -> tuple[tuple[int, ...], ...]:
    """Groups of records that had the same input, sample by sample, and are not copies of each other.

    Records of different lengths belong together when the shorter holds half of the longer at least; an input that never
    moves makes no repeats (free decays from different starts).

    Example:
        >>> u, e = np.sin(np.arange(100.0)), np.cos(np.arange(100.0) ** 2)
        >>> records = [Record(u, u + 0.1 * e, 0.1), Record(u, u - 0.1 * e, 0.1), Record(2 * u, 2 * u, 0.1)]
        >>> repeated_records(records)
        ((0, 1),)
    """
    groups: list[list[int]] = []
    for number, record in enumerate(records):
        for group in groups:
            if _same_input(records[group[0]], record) and not any(_copies(records[i], record) for i in group):
                group.append(number)
                break
        else:
            groups.append([number])
    return tuple(tuple(group) for group in groups if len(group) > 1)


def exact_period(record: Record) -> int | None:
    """Period [samples] at which the inputs repeat so well that the response to what differs is nothing beside noise.

    An input that was measured with noise of its own has a period (`periods.input_period`), but no exact one: what the
    inputs do not repeat the outputs need not.

    Example:
        >>> force = np.tile(np.random.default_rng(0).standard_normal(50), 3)
        >>> exact_period(Record(force, force, 0.1))
        50
        >>> measured = force + 0.01 * np.cos(np.arange(150.0) ** 2)
        >>> exact_period(Record(measured, force, 0.1)) is None
        True
    """
    period = input_period(record)
    if period is None:
        return None
    difference = record.inputs[period:] - record.inputs[:-period]
    largest = 2.0 * _SAME_PERIOD * record.inputs.var(axis=0)
    return period if bool((np.mean(difference**2, axis=0) <= largest).all()) else None


def repeat_scatter(responses: Sequence[FloatArray]) -> Scatter | None:
    """Scatter of responses to the same input; None where they never settle to the same response, or too few are left.

    Args:
        responses: (n_samples, n_outputs) each, the same input from the first sample on; NaN where missing.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> scatter = repeat_scatter([rng.standard_normal((2000, 1)) for _ in range(3)])
        >>> print(f"{scatter.variance[0]:.2f} {scatter.standard_error[0]:.3f}")
        1.01 0.022
    """
    n_rows = min(len(response) for response in responses)
    parts = np.stack([response[:n_rows] for response in responses])
    there = ~np.isnan(parts)
    counts = there.sum(axis=0)
    apart = np.where(there, parts - np.where(there, parts, 0.0).sum(axis=0) / np.maximum(counts, 1), 0.0)
    return _settled((apart**2).sum(axis=0), np.maximum(counts - 1, 0), memory=_memory(apart[0]))


def period_scatter(outputs: FloatArray, period: int) -> Scatter | None:
    """Scatter of one period against the next, for the whole record; None as for `repeat_scatter`.

    Args:
        outputs: (n_samples, n_outputs), NaN where missing.
        period: of the input [samples].

    Example:
        >>> noisy = np.tile(np.arange(200.0), 10)[:, np.newaxis] + np.random.default_rng(0).standard_normal((2000, 1))
        >>> print(f"{period_scatter(noisy, 200).variance[0]:.2f}")
        1.01
    """
    difference = outputs[period:] - outputs[:-period]
    there = ~np.isnan(difference)
    apart = np.where(there, difference, 0.0)
    # neighbouring differences share a period, so that n of them are as sure as 2 n / 3 independent ones
    shared = 1.5 if len(outputs) >= 3 * period else 1.0
    return _settled(0.5 * apart**2, there.astype(np.int_), memory=shared * _memory(apart))


def _memory(apart: FloatArray) -> FloatArray:
    """(n_outputs,) samples for which a mean square is as sure as for one sample of white noise, from the last third.

    The variance of the mean square of n Gaussian samples of spectrum S is 2 / n times mean(S^2) / mean(S)^2, and the
    mean square of a periodogram is twice S^2.
    """
    late = apart[-max(len(apart) // 3, 1) :]
    power = np.abs(np.fft.rfft(late, axis=0)[1:]) ** 2
    mean = power.mean(axis=0) if len(power) else np.zeros(apart.shape[1])
    spread = (power**2).mean(axis=0) / np.where(mean > 0.0, mean, 1.0) ** 2 if len(power) else mean
    return np.maximum(0.5 * spread, 1.0)


def _settled(squares: FloatArray, freedom: np.ndarray, *, memory: FloatArray) -> Scatter | None:
    """Mean square over the rows after the transient; freedom per row and output."""
    n_rows = len(squares)
    if n_rows < _FEWEST_ROWS:
        return None
    edges = np.linspace(0, n_rows, _N_BLOCKS + 1).astype(int)
    total = np.add.reduceat(squares, edges[:-1], axis=0)
    count = np.add.reduceat(freedom, edges[:-1], axis=0).astype(np.float64)
    start = _onset(total, count, memory)
    if start is None:
        return None
    first = int(edges[start])
    kept = freedom[first:].sum(axis=0)
    if n_rows - first < _FEWEST_ROWS or (kept < _FEWEST_ROWS).any():
        return None
    return Scatter(
        variance=squares[first:].sum(axis=0) / kept,
        standard_error=np.sqrt(2.0 * memory / kept),
        memory=memory,
        n_rows=int(n_rows - first),
        n_dropped=first,
    )


def _onset(total: FloatArray, count: FloatArray, memory: FloatArray) -> int | None:
    """First block after the transient: from there on no block stands out, and the end is not quieter than the start."""
    mean = total / np.maximum(count, 1.0)
    late = np.median(mean[_LATEST:], axis=0)
    freedom = np.maximum(count.min(axis=0) / memory, 1.0)
    limit = late * scipy.special.gammainccinv(freedom / 2.0, UNLIKELY) * 2.0 / freedom
    loud = np.flatnonzero((mean[:_LATEST] > limit).any(axis=1))
    start = 0 if loud.size == 0 else int(loud[-1]) + 1
    start += min(max(1, start // 2), _LATEST - start) if start else 0  # what is below the limit fades for a while yet
    third = (_N_BLOCKS - start) // 3
    before, after = (
        total[part].sum(axis=0) / np.maximum(count[part].sum(axis=0), 1.0)
        for part in (slice(start, start + third), slice(-third, None))
    )
    spread = np.sqrt(4.0 / (third * freedom))
    return None if (before > (1.0 + 3.0 * spread) * after).any() else start


def _same_input(one: Record, other: Record) -> bool:
    n_rows = min(one.n_samples, other.n_samples)
    if one.n_inputs == 0 or 2 * n_rows < max(one.n_samples, other.n_samples):
        return False
    a, b = one.inputs[:n_rows], other.inputs[:n_rows]
    if np.isnan(a).any() or np.isnan(b).any():
        return False
    moves = np.ptp(a, axis=0)
    return bool(
        moves.max() > 0.0
        and (np.abs(a - b).max(axis=0) <= _SAME_INPUT * np.maximum(moves, np.abs(a).max(axis=0))).all()
    )


def _copies(one: Record, other: Record) -> bool:
    n_rows = min(one.n_samples, other.n_samples)
    a, b = one.outputs[:n_rows], other.outputs[:n_rows]
    both = ~(np.isnan(a) | np.isnan(b))
    size = np.where(both, np.abs(a), 0.0).max(axis=0)
    return bool((np.where(both, np.abs(a - b), 0.0) <= ROUNDING * size).all())
