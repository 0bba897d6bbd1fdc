"""Rest before a blow: the level that a struck structure rests at, and rows of rest in front of its record.

An observer drops as many rows at a record's start as it looks back, and with them a blow that falls there. But a
structure that rests until it is struck has rested before the record began too: rows of rest may stand in front of it,
and then the blow is seen, nothing that it does looks late, and no initial state can take the place of its answer.
They hold no measurement, so whoever counts rows leaves them out.

A decay is the same with a blow that nobody measured. Free motion from an unknown state x(0) is the answer from
rest to a unit pulse one sample before the record, with x(0) as that input's participation,

    x(k+1) = A x(k) + B u(k),   u(-1) = 1,   x(-1) = 0:   x(0) = B

so poles and shapes are common to all records, and each has an amplitude of its own for every mode. An impulse test is
Markov parameters already, and all that holds for a struck structure holds for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from modal.estimation.cross_validation import scaled_record
from modal.modes.mode import Choice
from modal.preparation.delay import MOST_LEAD, lead_of
from modal.preparation.kind import acting_rows, acts, variance, widened
from modal.preparation.quick_model import quick_model
from okid.arrays import TINY, BoolArray, FloatArray
from okid.record import Record
from okid.rows import runs_of
from okid.scaling import channel_scaling

ENOUGH = 20
"""Take the level from the rows before the first blow where there are so many, else from the end of the record."""
NO_QUIETER = 2.0
"""Believe in rest where the rows before the blow move no more than this many times what the quietest part does, or than
so few rows of its noise do by chance,"""
NEGLIGIBLE = 0.01
"""or no more than this share of what the blow makes, a ten-thousandth of its power,"""
CHANCE = 1e-3
"""and, where there are enough of them to ask, not less like white noise than this often by chance."""
N_LAGS = 5
"""Lags of that test, which is asked of more rows than these."""
LONGEST = 256
"""Put no more rows in front: no observer that is tried looks back further."""
RELEASED = Choice(
    what="release",
    value="one a record",
    reason="free motion from an unknown state is the answer to a unit pulse one sample before the record, from rest: "
    "poles and shapes are common, what each record starts from is its own",
)
RINGING = Choice(
    what="force window",
    value="not used",
    reason="the inputs ring before the blows, as behind a filter that looks ahead, and the outputs tell of it",
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rested:
    """Records with rest in front of them.

    Attributes:
        records: about the level at which they rest.
        n_rest: rows in front of each that were not measured.
        at_rest: (n_records, n_inputs) variances of what a force window took from the inputs.
        looks_ahead: whether the outputs tell of blows to come, which ring before they fall.
        choices: what was done and why.
    """

    records: tuple[Record, ...]
    n_rest: tuple[int, ...]
    at_rest: FloatArray
    looks_ahead: bool
    choices: tuple[Choice, ...]


def released(records: Sequence[Record], starts: Sequence[int] = ()) -> tuple[Record, ...]:
    """Decays as answers to a release: one row more in front, at rest, in which the record's own input is 1.

    Args:
        records: without inputs, each of which rings down.
        starts: row of each from which it does; the first unless given.

    Example:
        >>> (ringing,) = released([Record([], 0.9 ** np.arange(200.0), 0.01)])
        >>> ringing.inputs[:3].ravel().tolist(), ringing.outputs[:2].ravel().round(3).tolist()
        ([1.0, 0.0, 0.0], [0.0, 1.0])
    """
    if starts:
        records = [record.samples(start) for record, start in zip(records, starts, strict=True)]
    each = [variance(record.outputs, axis=0) for record in records]
    whole = np.maximum(np.sum(each, axis=0), np.finfo(float).tiny)
    order = np.argsort([-float((own / whole).sum()) for own in each], kind="stable")
    strongest = sorted(order[:4].tolist())  # the others keep a state of their own to start from
    names = tuple(f"release of record {number + 1}" for number in strongest)
    made = []
    for number, record in enumerate(records):
        if number not in strongest:
            inputs, outputs = np.zeros((record.n_samples, len(names))), record.outputs
        else:
            inputs = np.zeros((record.n_samples + 1, len(names)))
            inputs[0, strongest.index(number)] = 1.0
            held = np.isfinite(record.outputs).any(axis=0)
            outputs = np.vstack([np.where(held, _level(record, 0), np.nan), record.outputs])
        made.append(replace(record, inputs=inputs, outputs=outputs, input_names=names, input_units=("",) * len(names)))
    return tuple(made)


def _level(record: Record, first: int) -> FloatArray:
    """(n_outputs,) at rest: mean of the rows before row `first`, or of the record's last half.

    There it may still ring: a Hann window lets next to nothing of a vibration into the mean.
    """
    last = record.n_samples
    quiet = slice(0, first) if ENOUGH <= first < last else slice(last // 2, last)
    values = record.outputs[quiet]
    weights = np.ones(first) if ENOUGH <= first < last else np.hanning(len(values) + 2)[1:-1]
    shares = np.where(np.isfinite(values), weights[:, np.newaxis], 0.0)
    level: FloatArray = (np.nan_to_num(values) * shares).sum(axis=0) / np.maximum(shares.sum(axis=0), TINY)
    return level


def _about_rest(record: Record, first: int) -> Record:
    """The record less what its inputs and outputs are at rest."""
    inputs = record.inputs - np.median(record.inputs, axis=0)
    return replace(record, inputs=inputs, outputs=record.outputs - _level(record, first))


def with_rest(records: Sequence[Record]) -> Rested:
    """Rows of rest in front of each record that begins at rest; records about their level.

    Example:
        >>> blow = np.r_[0.0, 1.0, np.zeros(198)]
        >>> found = with_rest([Record(blow, np.convolve(blow, 0.9 ** np.arange(200))[:200], 0.01)])
        >>> found.n_rest, found.choices[0].value
        ((33,), 'used')
    """
    starts = [first for first, _ in acts(records)]
    centred = tuple(_about_rest(record, first) for record, first in zip(records, starts, strict=True))
    n_channels = records[0].n_inputs + records[0].n_outputs
    n_samples = sum(record.n_samples for record in records)
    length = max(1, min(LONGEST, n_samples // (3 * n_channels), 1600 // n_channels))
    above = _above_rest(centred)
    begun = [_begun(rows, first) for rows, first in zip(above, starts, strict=True)]
    resting = [_rests(record, first) for record, first in zip(centred, begun, strict=True)]
    padded = tuple(
        after_rest(record, length) if rests else record for record, rests in zip(centred, resting, strict=True)
    )
    whole = padded
    before = min(row for row, _ in acts(padded))
    looks_ahead = _rings_before(padded) and lead_of(padded, before) > 0
    window: tuple[Choice, ...] = (RINGING,)
    if not looks_ahead:
        padded, window = _without_noise_of_rest(padded, above)
    if all(resting):
        value, reason = "used", "no row before the first blow moves more than the quietest part of its record"
    elif any(resting):
        value, reason = "used in part", f"{resting.count(False)} of {len(resting)} records move before their first blow"
    else:
        value, reason = "not used", "the outputs move before the first blow, so they start from an unknown state"
    return Rested(
        records=padded,
        n_rest=tuple(length * rests for rests in resting),
        looks_ahead=looks_ahead,
        at_rest=np.array([_noise_left_out(*both) for both in zip(whole, padded, strict=True)]),
        choices=(Choice(what="rest before the blow", value=value, reason=reason), *window),
    )


def _without_noise_of_rest(
    records: tuple[Record, ...], above: Sequence[BoolArray]
) -> tuple[tuple[Record, ...], tuple[Choice, ...]]:
    """Inputs that are zero but in their events, where a first model explains no less so: the force window.

    A structure that nothing strikes feels no force, so what the sensor of a force shows there is its own noise. A model
    that runs on it answers to it at every resonance, and long after the blow that is all it leaves. A shaker in between
    its bursts goes on holding the structure, though, and that force is real: it explains more.
    """
    windows = [np.pad(own, ((one.n_samples - len(own), 0), (0, 0))) for own, one in zip(above, records, strict=True)]
    window = tuple(
        replace(record, inputs=np.where(own, record.inputs, 0.0)) for own, record in zip(windows, records, strict=True)
    )
    share = sum(
        int((own.inputs != record.inputs).any(axis=1).sum()) for own, record in zip(window, records, strict=True)
    )
    if not share:
        return records, ()
    scaling = channel_scaling(records)
    full, short = (quick_model([scaled_record(record, scaling) for record in each]) for each in (records, window))
    if full is not None and (short is None or short.error > full.error):
        words = "a first model explains more with what the inputs show between the blows"
        return records, (Choice(what="force window", value="not used", reason=words),)
    words = "between the blows the inputs show noise of their sensors: a first model explains no less without it"
    return window, (Choice(what="force window", value="used", reason=words),)


def _above_rest(records: Sequence[Record]) -> list[BoolArray]:
    """(n_samples, n_inputs) a record: blows, and what stands above what the input shows there far from them.

    A hundredth of a blow may be a hundred times the noise of its sensor: a filter rings on, and what it rings is force.
    """
    beyond = scipy.special.chdtri(1.0, CHANCE / sum(record.n_samples for record in records))
    found = [widened(acting) for acting in acting_rows(records)]
    for above, record in zip(found, records, strict=True):
        squares = np.square(np.nan_to_num(record.inputs))
        n_above = -1
        while above.sum() > n_above:
            n_above = int(above.sum())
            noise = np.where(above, 0.0, squares).sum(axis=0) / np.maximum(1, (~above).sum(axis=0))
            above |= squares > beyond * noise  # noqa: PLW2901
    return found


def _begun(above: BoolArray, first: int) -> int:
    """The row where what acts in row `first` has begun; `first` where that is as far back as the record reaches."""
    quiet = np.flatnonzero(~above[:first].any(axis=1))
    return int(quiet[-1]) + 1 if quiet.size else first


def _rings_before(records: Sequence[Record]) -> bool:
    """Whether inputs move more shortly before a blow than far from all: a filter that looks ahead rings there.

    The ratio of their powers, each record's over that far from its blows, is F-distributed where the noise is white.
    """
    near: list[FloatArray] = []
    far: list[FloatArray] = []
    for record, acting in zip(records, acting_rows(records), strict=True):
        for values, own, wide in zip(record.inputs.T, acting.T, widened(acting).T, strict=True):
            blows = runs_of(wide) if own.any() else []
            close = np.zeros(len(own), dtype=np.bool_)
            shortly, before = np.zeros_like(close), -2 * MOST_LEAD
            for first, last in blows:
                if first >= before + 2 * MOST_LEAD:  # else what came before rings still
                    shortly[max(0, first - MOST_LEAD) : first] = True
                close[max(0, first - MOST_LEAD) : last + MOST_LEAD] = True
                before = last
            rest = np.nan_to_num(values[~close])
            noise = float(np.sqrt(np.square(rest).mean())) if rest.any() else 1.0
            near.append(np.nan_to_num(values[shortly]) / noise)
            far.append(rest / noise)
    powers, counts = [], []
    for rows in (near, far):
        values = np.concatenate(rows) if rows else np.zeros(0)
        powers.append(float(np.square(values).sum()))
        counts.append(int(np.count_nonzero(values)))  # neither a gap nor rest put in front tells anything
    if not all(counts):
        return False
    ratio = powers[0] / counts[0] / (powers[1] / counts[1])
    return bool(scipy.special.fdtrc(*counts, ratio) < CHANCE)


def _noise_left_out(record: Record, window: Record) -> FloatArray:
    """(n_inputs,) mean squares of what the inputs showed where the force window made them zero."""
    left_out = record.inputs - window.inputs
    power: FloatArray = np.square(left_out).sum(axis=0) / np.maximum(1, (left_out != 0.0).sum(axis=0))
    return power


def _rests(record: Record, first: int) -> bool:
    """Whether the outputs are at rest before row `first`; a blow in the first row leaves nothing to ask."""
    before = record.outputs[:first]
    if first == record.n_samples:  # never struck: it moves by itself
        return False
    if first == 0 or not np.isfinite(before).any():
        return True
    n_rows = max(1, record.n_samples // 10)  # the quietest tenth
    parts = record.outputs[: n_rows * (record.n_samples // n_rows)].reshape(-1, n_rows, record.n_outputs)
    there = np.isfinite(parts).any(axis=1)
    floor = np.sqrt(np.where(there, variance(parts, axis=1), np.inf).min(axis=0))
    n_before = np.maximum(np.isfinite(before).sum(axis=0), 1)
    by_chance = np.sqrt(scipy.special.chdtri(n_before, CHANCE / record.n_outputs) / n_before)  # of few rows
    least = np.maximum(
        np.maximum(NO_QUIETER, by_chance) * floor, NEGLIGIBLE * np.sqrt(variance(record.outputs, axis=0))
    )
    if (np.sqrt(np.nansum(np.square(before), axis=0) / n_before) > least).any():
        return False
    return first <= N_LAGS or _looks_white(before)


def _looks_white(values: FloatArray) -> bool:
    """Box and Pierce: the first autocorrelations of each column, together, are no greater than those of chance."""
    values = values[:, np.isfinite(values).any(axis=0)]  # the others are measured later
    centred = np.nan_to_num(values - np.nanmean(values, axis=0))
    power = np.square(centred).sum(axis=0)
    if not power.any():
        return True
    kept = centred[:, power > 0.0]
    power = power[power > 0.0]
    lags = range(1, N_LAGS + 1)
    statistic = len(kept) * sum(float(np.square((kept[j:] * kept[:-j]).sum(axis=0) / power).sum()) for j in lags)
    return bool(statistic <= scipy.special.chdtri(N_LAGS * power.size, CHANCE))


def after_rest(record: Record, length: int) -> Record:
    """With so many rows of rest in front, in which nothing acts and nothing moves."""
    return replace(
        record,
        inputs=np.vstack([np.zeros((length, record.n_inputs)), record.inputs]),
        outputs=np.vstack([np.zeros((length, record.n_outputs)), record.outputs]),
    )
