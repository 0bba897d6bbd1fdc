"""Which pole of a record continues which mode: frequency and shape together, over all modes at once.

    cost = min(|d ln f| / (6 s), 1) / 2 + |d ln f| / 0.3 + (1 - assurance) / 0.5 + doubt

with d ln f from the last frequencies of the mode and s the usual change from one record to the next, which the table
itself tells. What follows 0.3 and 0.5 is the cost of `modal.comparison` between two results, by which a frequency may
jump where the shape stays; the first term lets the nearer of two modes of one shape win. A pair is worth no more than
1; what has no partner begins a mode, and a mode without a partner waits for the next record. Poles of a record are
assigned together, so two modes that cross keep their shapes and do not swap.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import scipy

from modal.comparison.shifts import DOUBT, POLE_SCALE, SHAPE_SCALE, TOO_FAR
from okid.arrays import BoolArray, ComplexArray, FloatArray

__all__ = ["followed"]

IndexArray = npt.NDArray[np.intp]

FAR = 6.0
"""Count a change of this many usual ones as one that chance does not make."""
USUAL = 1.4826
"""Standard deviation over the median of the size, of normal errors."""
SHAPE_MEMORY, FREQUENCY_MEMORY = 0.1, 0.4
"""Let a new record count so much in what is remembered of a mode: ten records of its shape, the last few of its
frequency, which temperature moves within hours."""
FORGOTTEN = 48
"""Drop a mode that was seen fewer than three times and not in so many records."""
LEAST_SHARE = 0.01
"""Call no mode what is in less than this share of the records."""
LEAST_DENSITY = 0.25
"""Nor what is in less than this share of the records between its first and its last."""
LEAST_COUNT = 3
UNKNOWN_SHAPE = 0.25
"""Take this loss of assurance where fewer than two outputs are shared: such a mode jumps by chance only."""


@dataclass(slots=True, eq=False)
class _Followed:
    """What is remembered of the modes so far, one entry each."""

    number: IndexArray
    frequency: FloatArray
    shape: ComplexArray
    last: IndexArray
    count: IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class _Poles:
    """Of one record, or of all: ln f, shapes with zero for what is not known, what is known, doubts."""

    log_frequency: FloatArray
    unit: ComplexArray
    known: BoolArray
    doubtful: BoolArray

    def rows(self, chosen: "IndexArray | slice") -> "_Poles":
        """Some of them."""
        return _Poles(self.log_frequency[chosen], self.unit[chosen], self.known[chosen], self.doubtful[chosen])


def followed(record: IndexArray, frequency: FloatArray, shapes: ComplexArray, doubtful: BoolArray) -> IndexArray:
    """(n_rows,) number of the mode that each pole belongs to, from 0 by frequency; -1 for none.

    Args:
        record: (n_rows,) number of the record in the order of time, not falling.
        frequency: (n_rows,) [Hz].
        shapes: (n_rows, n_outputs), nan where a record lacks the output.
        doubtful: (n_rows,) poles of less certainty.

    Example:
        >>> followed(np.array([0, 0, 1, 1, 2, 2]), np.array([1.0, 2.0, 1.01, 2.0, 1.0, 2.01]),
        ...        np.array([[1, 1], [1, -1], [1, 1], [1, -1], [1, 1], [1, -1]]), np.zeros(6, bool)).tolist()
        [0, 1, 0, 1, 0, 1]
    """
    known = ~np.isnan(shapes)
    poles = _Poles(np.log(frequency), np.where(known, shapes, 0.0), known, doubtful)
    edges = np.searchsorted(record, np.arange(record.max(initial=-1) + 2))
    usual = _usual_change(edges, poles)
    n_outputs = shapes.shape[1]
    empty = np.empty(0, dtype=np.intp)
    active = _Followed(
        number=empty,
        frequency=np.empty(0),
        shape=np.empty((0, n_outputs), dtype=np.complex128),
        last=empty,
        count=empty,
    )
    owner = np.full(record.size, -1, dtype=np.intp)
    n_modes = 0
    for k, (first, last) in enumerate(pairwise(edges)):
        rows = np.arange(first, last)
        here = poles.rows(rows)
        own = _assigned(active, here, usual)
        new = np.flatnonzero(own < 0)
        seen = np.flatnonzero(own >= 0)
        _remember(active, own[seen], here.rows(seen), k)
        owner[rows[seen]] = active.number[own[seen]]
        owner[rows[new]] = n_modes + np.arange(new.size)
        kept = (active.count >= LEAST_COUNT) | (k - active.last < FORGOTTEN)
        active = _Followed(
            number=np.append(active.number[kept], owner[rows[new]]),
            frequency=np.append(active.frequency[kept], here.log_frequency[new]),
            shape=np.concatenate([active.shape[kept], _normalised(here.unit[new])]),
            last=np.append(active.last[kept], np.full(new.size, k)),
            count=np.append(active.count[kept], np.ones(new.size, dtype=np.intp)),
        )
        n_modes += new.size
    return _numbered(owner, record, frequency, n_modes)


def _normalised(shapes: ComplexArray) -> ComplexArray:
    size = np.linalg.norm(shapes, axis=1, keepdims=True)
    return shapes / np.where(size > 0.0, size, 1.0)


def _loss(first: ComplexArray, second: ComplexArray, known: BoolArray) -> FloatArray:
    """(n_first, n_second) 1 - assurance over the outputs that the second has."""
    powers = (np.abs(first) ** 2 @ known.T) * (np.abs(second) ** 2).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = np.abs(first.conj() @ second.T) ** 2 / powers
    compared = (np.abs(first) > 0.0).astype(np.float64) @ known.T >= 2
    return np.where(compared & np.isfinite(alike), 1.0 - alike, UNKNOWN_SHAPE)


def _usual_change(edges: IndexArray, poles: _Poles) -> float:
    """Standard deviation of the change from a record to the next, among poles that choose each other."""
    changes = []
    for first, middle, last in zip(edges[:-2], edges[1:-1], edges[2:], strict=True):
        if middle in (first, last):
            continue
        one, other = poles.rows(slice(first, middle)), poles.rows(slice(middle, last))
        distance = np.abs(np.subtract.outer(one.log_frequency, other.log_frequency))
        cost = distance / POLE_SCALE + _loss(one.unit, other.unit, other.known) / SHAPE_SCALE
        best, back = cost.argmin(axis=1), cost.argmin(axis=0)
        mutual = np.flatnonzero(back[best] == np.arange(best.size))
        changes.append(distance[mutual, best[mutual]])
    middle_change = float(np.median(np.concatenate(changes))) if changes else 0.0
    return max(USUAL * middle_change, np.finfo(np.float64).eps)


def _assigned(active: _Followed, poles: _Poles, usual: float) -> IndexArray:
    """(n_rows,) index of the active mode that each pole continues, -1 for none."""
    own = np.full(poles.log_frequency.size, -1, dtype=np.intp)
    if not (active.number.size and own.size):
        return own
    distance = np.abs(np.subtract.outer(active.frequency, poles.log_frequency))
    cost = 0.5 * np.minimum(distance / (FAR * usual), 1.0) + distance / POLE_SCALE
    cost += _loss(active.shape, poles.unit, poles.known) / SHAPE_SCALE + DOUBT * poles.doubtful
    # a mode that was seen once only is a worse partner than one that is known
    cost += DOUBT * (active.count < LEAST_COUNT)[:, np.newaxis]
    capped = np.minimum(cost, TOO_FAR)
    for i, j in zip(*scipy.optimize.linear_sum_assignment(capped), strict=True):
        if capped[i, j] < TOO_FAR:
            own[j] = i
    return own


def _remember(active: _Followed, own: IndexArray, poles: _Poles, k: int) -> None:
    active.last[own] = k
    active.count[own] += 1
    share = np.maximum(FREQUENCY_MEMORY, 1.0 / active.count[own])
    active.frequency[own] += share * (poles.log_frequency - active.frequency[own])
    new = _normalised(poles.unit)
    old = active.shape[own]
    phase = np.einsum("ij,ij->i", new.conj(), old)
    new = new * (np.where(phase == 0, 1.0, phase) / np.where(phase == 0, 1.0, np.abs(phase)))[:, np.newaxis]
    part = np.maximum(SHAPE_MEMORY, 1.0 / active.count[own])[:, np.newaxis]
    active.shape[own] = np.where(poles.known, (1.0 - part) * old + part * new, old)


def _numbered(owner: IndexArray, record: IndexArray, frequency: FloatArray, n_modes: int) -> IndexArray:
    """The modes that last, numbered by their median frequency."""
    n_records = int(record.max(initial=-1)) + 1
    least = max(min(LEAST_COUNT, n_records), LEAST_SHARE * n_records)
    count = np.bincount(owner, minlength=n_modes)
    begins, ends = np.full(n_modes, n_records), np.full(n_modes, -1)
    np.minimum.at(begins, owner, record)
    np.maximum.at(ends, owner, record)
    lasting = np.flatnonzero((count >= least) & (count >= LEAST_DENSITY * (ends - begins + 1)))
    medians = [float(np.median(frequency[owner == number])) for number in lasting]
    final = np.full(n_modes, -1, dtype=np.intp)
    final[lasting[np.argsort(medians, kind="stable")]] = np.arange(lasting.size)
    numbered: IndexArray = final[owner]
    return numbered
