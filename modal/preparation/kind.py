"""What kind of record is it? Judged at the door, from the data alone, and said as a choice with its reason.

    driven     inputs move throughout
    transient  inputs act in short events, and the structure rings
    decay      no input; each record starts far above its end, or does so once it is struck or let go
    ambient    no input; what is not measured drives it throughout
    response   frequency responses, not records in time

Each kind has its own folds and its own evidence, so a record of another kind would be told untrue things: a block of a
struck record holds no force, and a decay has no innovations.

All rows are looked at, for a blow takes few of them, but some million values at a time: a record may be larger than the
memory.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from modal.modes.mode import Choice
from okid.arrays import BoolArray, FloatArray, row_chunks
from okid.errors import InvalidDataError
from okid.record import Record
from okid.rows import runs_of

RecordKind = Literal["driven", "transient", "decay", "ambient", "response"]
"""What a call of `modal.identify` is given."""
GivenKind = Literal["auto", "driven", "transient", "decay", "ambient", "response"]
"""What the caller may say of it."""

MOST_POWER = 0.99
"""Ask in how few rows an input has this share of its power."""
EVENTS = 0.1
"""Take inputs for events where these rows are fewer than one in ten: a fold, of blocks of a tenth, may hold none,"""
STEADY = 0.15
"""and for moving throughout where they are more than this; in between it is undecided."""
MOST_EXCESS = 0.8
"""See events where the rows above all that rest shows by chance hold this part of what rest does not explain."""
REST = 0.01
"""Call it no rest between two of these rows where they are no more than this share of the record apart."""
NORMAL_MEDIAN = 0.4549
"""Divide the median square of what rests by this to have its variance: the median of chi-square with one degree."""
MIDDLE_ROWS, TOGETHER = 1_000_000, 1000
"""Take the median of so many rows of a longer record, so many at a time, spread evenly: a thousandth of a deviation."""
N_PARTS = 10
"""Compare the power of so many parts of a record without inputs."""
FAR_ABOVE = 100.0
"""See events where their rows have on average so many times the power of rest, and a decay where the first part of a
record has so many times the power of its last three: 20 dB,"""
ABOVE = 10.0
"""or this many where the power never rises again by more than chance; stationary motion has neither."""
ROUND_OFF = 1e-12
"""Take no end for quieter than this share of the greatest power: an encoder at rest has none."""
FINE_PARTS = 60
"""Look in so many parts for the blow or the release before which a record without inputs rests."""
LEAVES_REST = 0.01
"""See the first row that leaves rest where an output is this share of its furthest away, as where an input acts,"""
DEVIATIONS = 6.0
"""and so many standard deviations: chance has one in a thousand million."""
MOST_COLUMNS, MOST_STARTS, MOST_OUTPUTS, MOST_STATES = 60, 1500, 6, 40
"""Foretell a third of a record from so many samples of the one before, so often, for so many independent outputs and as
so many states at most;"""
GOLDEN = 0.6180339887498949
"""spread those samples by this ratio, which repeats no distance,"""
NO_WORSE = 1.5
"""and call it foretold where the error has no more than so many times the power of that one sample ahead,"""
MOST_LEFT = 0.05
"""no more than this share of the record's power (few rows of a single mode foretell themselves by chance),"""
MOST_UNTOLD = 0.5
"""and of that of what is foretold: what has gone by is quiet, and nothing foretold it,"""
FALLS = 0.63
"""and see it die away where no more than this share of its power, two decibels less, is left over the record: a
machine's does not."""
RISE = 2.0
"""Call it a rise where a part has so many times the power of the one before it, above that of the record's end."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class KindFound:
    """The kind of all records of a call.

    Attributes:
        kind: what they are treated as.
        choice: the same with its reason.
        warnings: a sentence where the data do not decide it, else nothing.
        starts: row of each record at which its free motion begins, where it rests before; empty where all begin with
            the record.
    """

    kind: RecordKind
    choice: Choice
    warnings: tuple[str, ...] = ()
    starts: tuple[int, ...] = ()


def given_kind(kind: str) -> GivenKind:
    """The word that the caller gave.

    Raises:
        InvalidDataError: it is no kind.
    """
    for known in get_args(GivenKind):
        if kind == known:
            return known
    raise InvalidDataError(f"kind must be one of {', '.join(get_args(GivenKind))}, but is {kind!r}.")


def find_kind(records: Sequence[Record], given: GivenKind = "auto") -> KindFound:
    """The kind of the records, one for all of them.

    Raises:
        InvalidDataError: a kind that these records cannot have, or records without inputs of which some ring down and
            others move throughout.

    Example:
        >>> blow = np.zeros(500)
        >>> blow[40:44] = [0.5, 1.0, 1.0, 0.5]
        >>> find_kind([Record(blow, np.convolve(blow, 0.9 ** np.arange(100))[:500], 0.01)]).kind
        'transient'
    """
    has_inputs = records[0].n_inputs > 0
    if given != "auto":
        _check_given(given, has_inputs=has_inputs)
        starts = tuple(_free_from(record.outputs) for record in records) if given == "decay" else ()
        found = _found(given, "given as an argument", starts=starts)
        return replace(found, warnings=_contradicted(records, given))
    return _by_inputs(records) if has_inputs else _by_outputs(records)


def _contradicted(records: Sequence[Record], given: GivenKind) -> tuple[str, ...]:
    """A sentence where the data decide for another kind than the caller gave."""
    try:
        told = find_kind(records)
    except InvalidDataError:  # they are of several kinds
        return ()
    if told.warnings or told.kind == given:
        return ()
    sentence = (
        f'kind="{given}" was given, but the data say "{told.kind}": {told.choice.reason}. Folds, evidence and words '
        f'are those of "{given}" records and may be untrue of these; leave kind out unless you know better.'
    )
    return (sentence,)


def _check_given(given: GivenKind, *, has_inputs: bool) -> None:
    if given == "response":
        raise InvalidDataError(
            'kind="response" is for frequency responses, but records in time were given; leave it out, or give an '
            "okid.FrequencyResponse."
        )
    if has_inputs != (given in ("driven", "transient")):
        have, need = ("inputs", "none") if has_inputs else ("no input", "one")
        raise InvalidDataError(
            f'kind="{given}" was given for records with {have}, but it needs {need}; '
            + ("leave the inputs out with record.select(inputs=[])." if has_inputs else "name the inputs of the file.")
        )


def _by_inputs(records: Sequence[Record]) -> KindFound:
    shares = [_active_share([record.inputs[:, j] for record in records]) for j in range(records[0].n_inputs)]
    widest = int(np.argmax(shares))
    share, name = shares[widest], records[0].input_names[widest]
    whose = "the input" if len(shares) == 1 else f"input {name!r}"
    words = (
        f"{100 * MOST_POWER:g} % of the power of {whose} lies in {100 * share:.2g} % of the rows"
        if share < 1.0
        else f"{whose} has no rest that stands out from its motion"
    )
    if share <= EVENTS:
        return _found("transient", f"{words}: it acts in short events, and the structure rings")
    if share >= STEADY:
        return _found("driven", f"{words}: it moves throughout")
    return _undecided("driven", words, "transient")


def acts(records: Sequence[Record]) -> tuple[tuple[int, int], ...]:
    """Row of each record before which every input rests, beyond chance and one per cent of its peak; that after which.

    A record in which none acts is rest to its end: (n_samples, 0).
    """
    rows = [np.flatnonzero(own) for own in acting_in(records)]
    return tuple(
        (int(own[0]), int(own[-1]) + 1) if own.size else (record.n_samples, 0)
        for own, record in zip(rows, records, strict=True)
    )


def acting_rows(records: Sequence[Record]) -> list[BoolArray]:
    """(n_samples, n_inputs) a record: rows in which an input is away from rest, beyond chance and 1 % of its peak."""
    found: list[list[BoolArray]] = [[] for _ in records]
    for j in range(records[0].n_inputs):
        each = [np.nan_to_num(np.square(one.inputs[:, j] - np.nanmedian(one.inputs[:, j]))) for one in records]
        squares = np.concatenate(each)
        moved = np.concatenate([own for own in each if own.any()] or [np.zeros(1)])  # not of blows elsewhere
        chance = scipy.special.chdtri(1.0, 1e-3 / squares.size) * float(np.median(moved)) / NORMAL_MEDIAN
        level = max(chance, 1e-4 * float(squares.max()))
        for columns, own in zip(found, each, strict=True):
            columns.append(own > level)
    return [
        np.reshape(np.array(columns, dtype=np.bool_), (len(columns), record.n_samples)).T
        for columns, record in zip(found, records, strict=True)
    ]


def widened(rows: BoolArray) -> BoolArray:
    """Each run of rows by its own length on either side, which lets the ends of a blow in.

    Example:
        >>> widened(np.array([[0, 0, 0, 1, 1, 0, 0, 0]], dtype=bool).T).ravel().astype(int).tolist()
        [0, 1, 1, 1, 1, 1, 1, 0]
    """
    wider = rows.copy()
    for own, column in zip(wider.T, rows.T, strict=True):
        for first, last in runs_of(column):
            own[max(0, 2 * first - last) : 2 * last - first] = True
    return wider


def acting_in(records: Sequence[Record]) -> list[BoolArray]:
    """(n_samples,) a record: rows in which any input is away from rest."""
    return [np.asarray(rows.any(axis=1)) for rows in acting_rows(records)]


def _active_share(columns: Sequence[FloatArray]) -> float:
    """Share of the rows that hold most of an input's power above what it has at rest; 1 where rest is not seen.

    Rows between two of them count too where they are few: a force that swings passes through zero without a rest. A row
    without a number tells neither rest nor motion, nor does a record in which another input strikes.
    """
    each = [_Squares(values) for values in columns]
    each = [own for own in each if own.moves]
    if not each:
        return 1.0
    rest = float(np.median(np.concatenate([own.some() for own in each]))) / NORMAL_MEDIAN
    n_rows = sum(own.n_rows for own in each)
    excess = sum(float(part.sum()) for own in each for part in own.chunks()) - n_rows * rest
    far = rest * scipy.special.chdtri(1.0, 1.0 / n_rows)
    above = np.sort(np.concatenate([part[part > far] for own in each for part in own.chunks()]))[::-1]
    held = np.cumsum(above - rest)
    if above.size == 0 or held[-1] <= max(MOST_EXCESS * excess, FAR_ABOVE * above.size * rest):
        return 1.0
    least = above[min(above.size - 1, int(np.searchsorted(held, MOST_POWER * excess)))]
    return sum(_acting(own, least) for own in each) / n_rows


class _Squares:
    """Squares of an input about its median, of what is there, chunk by chunk."""

    def __init__(self, values: FloatArray) -> None:
        self._values = values
        parts = [part for part in self._measured(values) if part.size]
        self.n_rows = sum(part.size for part in parts)
        self.moves = bool(parts) and max(part.max() for part in parts) > min(part.min() for part in parts)
        self._middle = float(np.median(self._spread())) if self.moves else 0.0

    def chunks(self) -> Iterator[FloatArray]:
        for part in self._measured(self._values):
            yield np.square(part - self._middle)

    def some(self) -> FloatArray:
        """Of rows all over the record."""
        return np.asarray(np.square(self._spread() - self._middle), dtype=np.float64)

    def _spread(self) -> FloatArray:
        n_rows, parts = self._values.size, list(range(0, self._values.size, TOGETHER))
        if n_rows > MIDDLE_ROWS:
            parts = np.linspace(0, n_rows - TOGETHER, MIDDLE_ROWS // TOGETHER).astype(int).tolist()
        found = np.concatenate([self._values[first : first + TOGETHER] for first in parts])
        return found[np.isfinite(found)]

    @staticmethod
    def _measured(values: FloatArray) -> Iterator[FloatArray]:
        for rows in row_chunks(values.size, 1):
            part = values[rows]
            yield part[np.isfinite(part)]


def _acting(squares: _Squares, least: float) -> int:
    """Number of the rows that have so much, short rests between them included."""
    found, n_before = [], 0
    for part in squares.chunks():
        found.append(n_before + np.flatnonzero(part >= least))
        n_before += part.size
    places = np.concatenate(found)
    steps = np.diff(places)
    return int(steps[steps <= max(1.0, REST * n_before)].sum()) + int(places.size > 0)


def _by_outputs(records: Sequence[Record]) -> KindFound:
    starts = tuple(_free_from(record.outputs) for record in records)
    free = [one.outputs[k:] for one, k in zip(records, starts, strict=True)]
    ratios = [_fall(outputs)[0] for outputs in free]
    least, greatest = min(ratios), max(ratios)
    decays = [rings_down(outputs) for outputs in free]
    struck = any(starts)
    words = f"the outputs start with {least:.3g} times the power that they end with"
    words = words if least > 0.0 else "the outputs move no more at their start than later"
    onward = [True if one else rings_on(outputs) for one, outputs in zip(decays, free, strict=True)]
    if not all(decays) and True in onward and False not in onward:  # too few rows to ask say nothing
        words = "each third foretells the next as well as a row the next row, at less power"
        return _found("decay", f"{words}, and there is no input: it rings down undisturbed", starts=starts)
    if all(decays):
        words = f"after a blow or a release that was not measured, {words}" if struck else words
        return _found("decay", f"{words}, and there is no input: they ring down", starts=starts)
    if greatest < ABOVE:
        return _found("ambient", f"{words}, and there is no input: what drives them is not measured")
    if any(decays) and least < ABOVE:
        which = ", ".join(str(i) for i, one in enumerate(decays) if one)
        raise InvalidDataError(
            f"records without inputs must be of one kind, but of {len(records)} those with numbers {which} ring down "
            "and others move throughout; identify them apart."
        )
    return _undecided("ambient", words, "decay")


def _free_from(outputs: FloatArray) -> int:
    """Row at which free motion begins where a record rests before it is struck or let go; 0 where it begins with it.

    A blow takes as long to end as it took to its peak, and what is let go is free from the start; either way the motion
    is free once twice the time from the first row that leaves rest to the furthest has passed. A spike leaves nothing.
    """
    n_rows = len(outputs) // FINE_PARTS
    if n_rows < 2:
        return 0
    power = np.array([variance(outputs[k : k + n_rows], axis=0) for k in range(0, n_rows * FINE_PARTS, n_rows)])
    each = power / np.maximum(power.max(axis=0), np.finfo(float).tiny)
    # an output that shows little of this motion hides no other
    before = [each[: max(0, k - 1), j].max(initial=0.0) for j, k in enumerate(each.argmax(axis=0).tolist())]
    tells: BoolArray = (np.array(before) > 0.0) & (np.array(before) * FAR_ABOVE <= 1.0)
    levels = (each[:, tells] if tells.any() else each).mean(axis=1)
    strongest = int(levels.argmax())
    # the part before the strongest may hold the first rows of the motion
    quiet = levels[: max(0, strongest - 1)]
    if not quiet.size or quiet.max() * FAR_ABOVE > levels[strongest]:
        return 0
    rest = outputs[: n_rows * quiet.size]
    near = outputs[n_rows * quiet.size : n_rows * (strongest + 1)]
    level = _means(rest)
    away = np.abs(np.nan_to_num(near - level))
    size = np.maximum(away.max(axis=0), np.finfo(float).tiny)
    first = int(
        (away > np.maximum(LEAVES_REST * size, DEVIATIONS * np.sqrt(variance(rest, axis=0)))).any(axis=1).argmax()
    )
    furthest = int((away / size).max(axis=1).argmax())
    return n_rows * quiet.size + first + 2 * max(0, furthest - first) + 1


def variance(values: FloatArray, *, axis: int) -> FloatArray:
    """About the mean along an axis of what is there; 0 where nothing is."""
    rows = np.moveaxis(values, axis, 0)
    return _mean_squares(rows, _means(rows))


def _means(values: "FloatArray | _Sums") -> FloatArray:
    """Along the first axis, of what is there; 0 where nothing is."""
    sums = sum(np.nansum(values[rows], axis=0) for rows in _chunks(values))
    return np.asarray(sums / np.maximum(_counts(values), 1))


def _mean_squares(values: "FloatArray | _Sums", level: FloatArray) -> FloatArray:
    """Along the first axis, about a level, of what is there; 0 where nothing is."""
    squares = sum(np.square(np.nan_to_num(values[rows] - level)).sum(axis=0) for rows in _chunks(values))
    return np.asarray(squares / np.maximum(_counts(values), 1))


def _counts(values: "FloatArray | _Sums") -> FloatArray:
    """Along the first axis, how often something is there."""
    return np.asarray(sum(np.isfinite(values[rows]).sum(axis=0) for rows in _chunks(values)), dtype=np.float64)


def _chunks(values: "FloatArray | _Sums") -> Iterator[slice]:
    return row_chunks(len(values), values[:1].size)


def rings_down(outputs: FloatArray) -> bool:
    """Whether what starts here ends far below its start, or never rises on its way down."""
    ratio, fall = _fall(outputs)
    return ratio >= FAR_ABOVE or (ratio >= ABOVE and fall)


def rings_on(outputs: FloatArray) -> bool | None:
    """Whether what a record starts with foretells all of it, and dies away; None of too few rows to ask.

    A sum of modes that nothing drives is foretold over any time: y(t + h) is linear in samples before t, with errors
    that are those of one row ahead, and states that are powers of h. What is driven is forgotten: what leads from the
    first third of a record to the second does not lead from there to the last. A machine's sinusoids are foretold, too,
    but do not die away.

    Example:
        >>> time = np.arange(600.0)
        >>> rung = np.exp(-0.002 * time) * np.cos(0.3 * time) + 0.01 * np.random.default_rng(0).standard_normal(600)
        >>> rings_on(rung[:, np.newaxis]), rings_on(np.cos(0.3 * time)[:, np.newaxis])
        (True, False)
    """
    values = _Sums.independent(outputs)
    n_rows, n_outputs = len(values), values[:1].size
    third, span = n_rows // 3, n_rows // 6
    n_lags = min(span, max(2, min(MOST_COLUMNS, n_rows // 12) // max(1, n_outputs)))
    starts = np.unique(np.linspace(span, third - 1, MOST_STARTS).astype(int)) if span else np.zeros(0, dtype=int)
    if not span or n_outputs == 0 or starts.size < 2 * n_lags * n_outputs:
        return None
    spread = np.unique((span * (GOLDEN * np.arange(n_lags) % 1.0)).astype(int))  # of no period; 0 is the first

    def before(rows: NDArray[np.intp], lags: NDArray[np.intp]) -> FloatArray:
        return np.hstack([values[rows - lag] for lag in lags])

    pairs = [  # windows and what follows them, a third of the record ahead and a row ahead
        [(before(rows, lags), values[rows + ahead]) for rows in (starts, starts + third)]
        for lags, ahead in ((spread, third), (spread, 1), (np.arange(n_lags), 1))
    ]
    there = np.isfinite(np.hstack([each for pair in pairs for part in pair for each in part])).all(axis=1)
    if there.sum() < 2 * n_lags * n_outputs:
        return None
    left, *at_once = (_foretold([(windows[there], wanted[there]) for windows, wanted in pair]) for pair in pairs)
    power = np.mean([np.square(wanted[there]).mean() for _, wanted in pairs[0]])
    if left[0] > min(MOST_LEFT, NO_WORSE * min(error for error, _ in at_once), MOST_UNTOLD * float(power)):
        return False
    first, second = (windows[there] for windows, _ in pairs[0])
    axes = np.linalg.svd(first, full_matrices=False)[2][: left[1]].T
    states = first @ axes
    onward, vectors = np.linalg.eig(np.linalg.lstsq(states, second @ axes, rcond=None)[0].T)
    each = np.linalg.lstsq(vectors, states.T.astype(np.complex128), rcond=None)[0]
    powers = np.square(np.abs(each)).mean(axis=1) * np.square(np.linalg.norm(vectors, axis=0))
    return bool((powers * np.abs(onward) ** 6).sum() < FALLS * powers.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Sums of the outputs that move, about their means, made of the rows that are asked for.

    Attributes:
        outputs: (n_samples, n_outputs).
        moving: (n_moving,) indices of outputs.
        level: (n_moving,) their means.
        size: (n_moving,) their standard deviations.
        axes: (n_moving, n_sums) of the outputs in units of these; None where each is one.
    """

    outputs: FloatArray
    moving: NDArray[np.intp]
    level: FloatArray
    size: FloatArray
    axes: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.outputs)

    def __getitem__(self, rows: slice | NDArray[np.intp]) -> FloatArray:
        values = (self.outputs[rows][:, self.moving] - self.level) / self.size
        return np.asarray(values if self.axes is None else values @ self.axes, dtype=np.float64)

    @classmethod
    def independent(cls, outputs: FloatArray) -> "_Sums":
        """At most `MOST_OUTPUTS` of size 1, those that move most."""
        level = _means(outputs)
        size = np.sqrt(_mean_squares(outputs, level))
        moving = np.flatnonzero(size > 0)
        each = cls(outputs, moving, level[moving], size[moving])
        if moving.size <= MOST_OUTPUTS:
            return each
        products = np.zeros((moving.size, moving.size))
        for rows in _chunks(each):
            whole = each[rows]
            whole = whole[np.isfinite(whole).all(axis=1)]
            products += whole.T @ whole
        several = replace(each, axes=np.linalg.eigh(products)[1][:, -MOST_OUTPUTS:])
        sizes = np.sqrt(_mean_squares(several, _means(several)))
        return replace(several, axes=several.axes / sizes)


def _foretold(parts: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[float, int]:
    """Least mean square that the linear map of either part leaves of the other, and of how many states that is."""
    n_states = np.arange(2, min(MOST_STATES, parts[0][0].shape[1], len(parts[0][0]) // 2) + 1, 2)
    left = np.zeros(n_states.size)
    for (own, answer), (other, wanted) in (parts, parts[::-1]):
        spans, sizes, axes = np.linalg.svd(own, full_matrices=False)
        states = other @ axes.T / np.maximum(sizes, np.finfo(float).eps * sizes[0])
        answers = spans.T @ answer
        left += [np.square(wanted - states[:, :n] @ answers[:n]).sum() for n in n_states.tolist()]
    best = int(left.argmin())
    return float(left[best]) / (2 * parts[0][1].size), int(n_states[best])


def _fall(outputs: FloatArray) -> tuple[float, bool]:
    """Power of the first part over that of the last three, 0 where a later part has more; and whether it never rises.

    Every output counts in units of its own power at the end, so that one that shows nothing hides no other. A part in
    which an output has no sample says nothing, and is left out.
    """
    n_rows = len(outputs) // N_PARTS
    if n_rows < 1:
        return 0.0, False
    parts = [outputs[k : k + n_rows] for k in range(0, n_rows * N_PARTS, n_rows)]
    counts = np.array([_counts(part) for part in parts])
    shown = counts.any(axis=0)
    told = [k for k, count in enumerate(counts) if count[shown].all()]
    if len(told) <= 3:
        return 0.0, False
    # the level at which the motion ends
    last = counts[told[-3:]]
    level = sum(_means(parts[k]) * counts[k] for k in told[-3:]) / np.maximum(last.sum(axis=0), 1)
    power = np.array([_mean_squares(parts[k], level) for k in told])[:, shown]  # (n_parts, n_outputs)
    end = np.maximum(power[-3:].mean(axis=0), ROUND_OFF * power.max(axis=0) + np.finfo(float).tiny)
    levels = (power / end).mean(axis=1)
    if levels.argmax() > 0:
        return 0.0, False
    return float(levels[0]), bool((levels[1:] - 1.0 <= RISE * levels[:-1]).all())


def _found(kind: RecordKind, reason: str, *, starts: tuple[int, ...] = ()) -> KindFound:
    kept = starts if any(starts) else ()
    return KindFound(kind=kind, choice=Choice(what="record kind", value=kind, reason=reason), starts=kept)


def _undecided(kind: RecordKind, words: str, other: RecordKind) -> KindFound:
    found = _found(kind, f'{words}, which does not decide between "{kind}" and "{other}"')
    sentence = f'The record kind is not certain: {words}; it is treated as {kind}. Give kind="{other}" if it is that.'
    return KindFound(kind=kind, choice=found.choice, warnings=(sentence,))
