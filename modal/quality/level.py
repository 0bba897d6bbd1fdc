"""The level of a channel: a mean far from zero, a size that changes within the record, slow drift that no input causes.

Drift is decided as the identification does (`modal.preparation.drift`), but with the pulse response of an observer in
the place of a model: what the inputs do is taken off, once with a response fitted to the records as they are and once
with one fitted to records without slow motion; then slow functions of time must predict held-out blocks of the rest
clearly better.
"""

from collections.abc import Sequence

import numpy as np

from modal.preparation.channel import (
    FEWEST_ROWS,
    FITTED_ROWS,
    MOSTLY,
    NOTABLE,
    Channel,
    Finding,
    named,
    spoken,
    where_found,
)
from modal.preparation.drift import (
    CANDIDATES,
    LEAST_GAIN,
    SAMPLES_PER_FUNCTION,
    SIGNIFICANT,
    SLOW_INPUTS,
    held_out_squares,
    is_significant,
    slow_functions,
    slow_motion,
    without_drift,
)
from modal.quality.coherence import best_pulse, predicted_outputs
from modal.wording.numbers import percent
from okid.arrays import FloatArray
from okid.errors import IdentificationError
from okid.record import Record

__all__ = ["block_levels", "drift_findings", "is_steady", "level_findings", "offset_findings"]

LARGE_OFFSET = 10.0
"""Speak of a mean of so many standard deviations."""

N_BLOCKS = 10
"""Compare the levels of so many blocks of a record."""

CHANGED = 4.0
"""Say that the level changed where the median of one side is so many times that of the other."""

APART = 2.0
"""Ask that every block of one side be so many times as large as every one of the other: chance does not sort them."""

RING_DOWN = 1.3
"""Take levels for a start that dies out where every block is so many times the next one."""

STEADY = 1.5
"""Call an input steady whose blocks, and those of its steps, differ by less: neither its level nor its band changes."""

FEWEST_BLOCKS = 2
"""Ask for so many blocks with samples on either side of a change."""


def offset_findings(channel: Channel, n_records: int) -> list[Finding]:
    """A mean of many times the motion."""
    if channel.role == "input" or channel.std == 0.0 or abs(channel.mean) < LARGE_OFFSET * channel.std:
        return []
    ratio = abs(channel.mean) / channel.std
    return [
        Finding(
            level="note",
            what="offset",
            where=where_found(channel.name, (), n_records),
            sentence=f"output {named(channel.name)} stands at {channel.value(channel.mean)}, {spoken(ratio)} times as "
            "far from zero as it moves: the mean is taken off before the fit, but most of the sensor's range serves "
            "the offset; couple it AC or zero it.",
            channels=(channel.name,),
        )
    ]


def is_steady(channel: Channel) -> bool:
    """Whether neither the mean nor the level of an input nor that of its steps from sample to sample changes."""
    for part in channel.parts:
        size = part.size // N_BLOCKS
        if size:
            away = part[: N_BLOCKS * size].reshape(N_BLOCKS, size) - channel.mean
            n_there = np.maximum((~np.isnan(away)).sum(axis=1), 1)  # a block without a sample tells nothing
            if not np.abs(np.nansum(away, axis=1) / n_there).max() <= channel.std:
                return False
    steps = tuple(np.diff(part) for part in channel.parts)
    return all(_spread(levels) <= STEADY for levels in (*block_levels(channel.parts), *block_levels(steps)))


def block_levels(parts: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """(10,) root mean square about each block's mean, a record of some length; nan for a block without a sample.

    Args:
        parts: (n_samples,) a record.
    """
    levels = []
    for part in parts:
        if part.size < FEWEST_ROWS:
            continue
        size = part.size // N_BLOCKS
        blocks = part[: N_BLOCKS * size].reshape(N_BLOCKS, size)
        there = ~np.isnan(blocks)
        count = np.where(there.any(axis=1), there.sum(axis=1), np.nan)
        mean = np.where(there, blocks, 0.0).sum(axis=1) / count
        squares = np.square(np.where(there, blocks - mean[:, np.newaxis], 0.0))
        levels.append(np.sqrt(squares.sum(axis=1) / count))
    return tuple(levels)


def level_findings(channel: Channel, inputs_steady: Sequence[bool], n_records: int) -> list[Finding]:
    """An output whose level changes several times while every input's does not.

    Args:
        channel: an output.
        inputs_steady: whether each input is steady.
        n_records: number of records.
    """
    if channel.role == "input" or channel.std == 0.0 or not inputs_steady or not all(inputs_steady):
        return []
    for number, levels in enumerate(block_levels(channel.parts)):
        change = _change(levels)
        if change is None:
            continue
        cut, before, after = change
        part = [part for part in channel.parts if part.size >= FEWEST_ROWS][number]
        time = cut * (part.size // N_BLOCKS) * channel.dt
        ratio = max(before, after) / max(min(before, after), np.finfo(float).tiny)
        word, times = ("larger" if after > before else "smaller"), spoken(ratio) if ratio < 1e6 else "many"
        return [
            Finding(
                level="doubtful",
                what="level changes",
                where=where_found(channel.name, (), n_records),
                sentence=f"output {named(channel.name)} is {times} times {word} from about {spoken(time)} s after the "
                "start, while the inputs keep their level: a sensor that came loose, a range that was switched, or a "
                "structure that changed; look there and cut the record.",
                channels=(channel.name,),
            )
        ]
    return []


def _change(levels: FloatArray) -> tuple[int, float, float] | None:
    """Block from which all levels differ from all before, with the medians of both sides; None if there is none.

    The first block, which holds the start from rest, is left out; two blocks at least lie on either side.
    """
    for cut in range(3, levels.size - 1):
        before, after = (part[~np.isnan(part)] for part in (levels[1:cut], levels[cut:]))
        if min(before.size, after.size) < FEWEST_BLOCKS:
            continue
        medians = float(np.median(before)), float(np.median(after))
        apart = max(float(after.min()) - APART * float(before.max()), float(before.min()) - APART * float(after.max()))
        rings_down = bool((levels[:cut] > RING_DOWN * levels[1 : cut + 1]).all())
        if apart > 0.0 and not rings_down and max(medians) > CHANGED * min(medians):
            return cut, *medians
    return None


def _spread(levels: FloatArray) -> float:
    known = levels[~np.isnan(levels)]
    return float(known.max() / known.min()) if known.size and known.min() > 0.0 else np.inf


def drift_findings(records: Sequence[Record]) -> list[Finding]:
    """Outputs that drift, by the longest record thinned to 6000 rows; none where an input is missing somewhere.

    Args:
        records: of one system.
    """
    longest = max(records, key=lambda record: record.n_samples)
    if longest.n_inputs == 0 or longest.n_samples < FEWEST_ROWS or np.isnan(longest.inputs).any():
        return []
    slow = np.flatnonzero(_slow_shares(longest) > NOTABLE)
    if slow.size == 0:
        return []
    try:
        thinned = longest.decimated(max(1, -(-longest.n_samples // FITTED_ROWS)))
    except IdentificationError:
        return []
    if np.isnan(thinned.outputs).all(axis=0).any() or _slow_inputs(thinned) > SLOW_INPUTS:
        return []
    shares = {int(i): _drift_share(thinned.select(outputs=[int(i)])) for i in slow}
    which = sorted((i for i in shares if shares[i] > NOTABLE), key=lambda i: -shares[i])
    if not which:
        return []
    names = tuple(longest.output_names[i] for i in which)
    share = shares[which[0]]
    return [
        Finding(
            level="doubtful" if share > MOSTLY else "note",
            what="drift",
            where=named(names),
            sentence=f"output{'s' * (len(names) > 1)} {named(names)} drift{'s' * (len(names) == 1)} slowly in a way "
            f"that no input explains ({'up to ' * (len(names) > 1)}{percent(share)} of the power): temperature, a "
            "charge amplifier or an integrated signal; the identification takes drift off, motion that slow cannot "
            "be identified.",
            channels=names,
            share=share,
        )
    ]


def _slow_shares(record: Record) -> FloatArray:
    """(n_outputs,) share of an output's power that all slow functions can take, over block means."""
    shares = np.zeros(record.n_outputs)
    size = -(-record.n_samples // FEWEST_ROWS)
    n_blocks = record.n_samples // size
    functions = np.linalg.qr(slow_functions(n_blocks, CANDIDATES[-1]))[0][:, 1:]
    for i in range(record.n_outputs):
        values = record.outputs[: n_blocks * size, i]
        there = ~np.isnan(values)
        if not there.any():
            continue
        blocks = np.where(there, values - values[there].mean(), 0.0).reshape(n_blocks, size).mean(axis=1)
        taken = float(np.sum((functions.T @ blocks) ** 2)) / n_blocks
        shares[i] = taken / max(float(values[there].var()), np.finfo(float).tiny)
    return shares


def _slow_inputs(record: Record) -> float:
    """Largest power of an input in the slow functions, relative to that of white noise of the same size."""
    functions = np.linalg.qr(slow_functions(record.n_samples, CANDIDATES[-1]))[0][:, 1:]
    inputs = record.inputs - record.inputs.mean(axis=0)
    slow = np.sum((functions.T @ inputs) ** 2, axis=0) / functions.shape[1]
    return float((slow / np.maximum(inputs.var(axis=0), np.finfo(float).tiny)).max())


def _drift_share(record: Record) -> float:
    """Share of one output's power that drifts; 0 where no drift is proved."""
    most = [n for n in CANDIDATES if n <= record.n_samples // SAMPLES_PER_FUNCTION]
    there = ~np.isnan(record.outputs[:, 0])
    if not there.all():
        record = record.samples(*_longest_run(there))
        most = [n for n in most if n <= record.n_samples // SAMPLES_PER_FUNCTION]
    if record.n_samples < FEWEST_ROWS or len(most) < 2:
        return 0.0
    plain = without_drift(record, 0)
    own, freed = best_pulse(plain), best_pulse(without_drift(record, most[-1]))
    if freed is None or not freed[1].min() >= -MOSTLY:  # it adds more than it explains: nothing is known
        return 0.0
    settled = record.n_samples // 10  # the answer to what came before the record has died out, about
    left = (plain.outputs - predicted_outputs(freed[0], plain.inputs))[settled:]
    errors = {n: held_out_squares(slow_motion([left]), n) for n in most}
    best = min(most, key=lambda n: float(errors[n].sum()))
    without = errors[0]
    if own is not None:
        missed = (plain.outputs - predicted_outputs(own[0], plain.inputs))[settled:]
        explained = held_out_squares(slow_motion([missed]), 0)
        without = explained if explained.sum() < without.sum() else without
    gain = without - errors[best]
    if best == 0 or not is_significant(gain, SIGNIFICANT) or gain.sum() < LEAST_GAIN * without.sum():
        return 0.0
    moved = [held_out_squares(slow_motion([plain.outputs[settled:]]), n).sum() for n in (0, best)]
    if gain.sum() < MOSTLY * (moved[0] - moved[1]):  # the rest is what the pulse response missed
        return 0.0
    functions = slow_functions(len(left), best)
    fitted = functions @ np.linalg.lstsq(functions, left, rcond=None)[0]
    return min(1.0, float(fitted.var() / plain.outputs[settled:].var()))


def _longest_run(there: np.ndarray) -> tuple[int, int]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    starts, stops = edges[::2], edges[1::2]
    i = int((stops - starts).argmax())
    return int(starts[i]), int(stops[i])
