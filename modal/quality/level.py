"""The level of a channel: a mean far from zero, and a size that changes within the record."""

from collections.abc import Sequence

import numpy as np

from modal.quality.channel import Channel, named, spoken, where_found
from modal.quality.findings import Finding
from okid.arrays import FloatArray

__all__ = ["block_levels", "is_steady", "level_findings", "offset_findings"]

LARGE_OFFSET = 10.0
"""Mean over standard deviation."""
N_BLOCKS = 10
CHANGED = 4.0
"""Median level on one side of the change over that on the other."""
APART = 2.0
"""Every block on one side is so many times as large as every block on the other: chance does not sort them."""
RING_DOWN = 1.3
"""Every block over the next one: the start from rest dies out."""
STEADY = 1.5
"""The same for every input and for its steps from sample to sample, so that neither its level nor its band changes."""
FEWEST_SAMPLES = 1000
FEWEST_BLOCKS = 2
"""With samples, on either side of a change."""


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
        if part.size < FEWEST_SAMPLES:
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
        part = [part for part in channel.parts if part.size >= FEWEST_SAMPLES][number]
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
