"""Single samples that lie far off the curve through their neighbours.

Each sample is compared with the cubic through its two neighbours on either side. A spike is off by six times what is
usual nearby, and with it taken out the neighbours lie as they usually do: a hit, a step or the start of a ringing
stays rough.
"""

from collections.abc import Sequence

import numpy as np

from modal.quality.channel import MOST_SPANS, Channel, named, spoken, where_found
from modal.quality.findings import Finding, Level
from modal.wording.numbers import percent
from okid.arrays import BoolArray, FloatArray

__all__ = ["sharp_samples", "spike_findings"]

TIMES_USUAL = 6.0
"""A normal variable is as far off once in 5e8 samples, and the largest of three blocks is taken for usual."""
LEAST_SIZE = 0.1
"""Of the channel's standard deviation: a smaller spike moves nothing."""
LEFT_OVER = 0.2
"""Of a spike, or a third of the limit: how well its neighbours must lie once it is taken out."""
BLOCK = 64
CROWDED, SPARSE = (0.75, 1.1503493803760079), (0.5, 0.6744897501960817)
"""Quantiles of a block that tell what is usual, and what they are for the modulus of a normal variable: the higher one
where steps or hits may fill a third of the block and are no spikes, the lower one where they are what is looked for."""
BAD_SHARE = 1e-3
_REACH = 2


def spike_findings(channel: Channel, resolution: float, hits: Sequence[BoolArray], n_records: int) -> list[Finding]:
    """Spikes of one channel.

    Args:
        channel: the channel.
        resolution: distance of neighbouring levels, nan where there is no grid.
        hits: (n_samples,) a record, True where an input moves sharply: an output's answer to it is no spike.
        n_records: number of records.
    """
    if channel.std == 0.0:
        return []
    found: list[tuple[int, int]] = []
    largest = 0.0
    for number, part in enumerate(channel.parts):
        off = _off_curve(part)
        for k in _sharp(part, off, channel, resolution):
            if channel.role == "output" and hits[number][max(0, k - _REACH) : k + _REACH + 1].any():
                continue
            if channel.role == "input" and not _moves_nearby(part, k, channel):
                continue
            found.append((number, k))
            largest = max(largest, abs(float(off[k])))
    if not found:
        return []
    spans = tuple(channel.span(number, k, k + 1) for number, k in found[:MOST_SPANS])
    share = len(found) / channel.n_samples
    what = "one sample" if len(found) == 1 else f"{len(found)} single samples ({percent(share)})"
    lies = "lies" if len(found) == 1 else "lie"
    return [
        Finding(
            level=_level(channel, share, largest),
            what="spikes",
            where=where_found(channel.name, spans, n_records),
            sentence=f"{channel.role} {named(channel.name)}: {what} {lies} up to {spoken(largest / channel.std)} "
            f"standard deviations off the curve through the neighbours (first at {spans[0][1]:.6g} s): electrical "
            "spikes or lost bits, look at cables and grounding; mark them as missing (empty cells).",
            channels=(channel.name,),
            spans=spans,
            share=share,
        )
    ]


def _level(channel: Channel, share: float, largest: float) -> Level:
    if share >= BAD_SHARE and channel.role == "output":
        return "bad"
    return "doubtful" if share >= BAD_SHARE or largest >= channel.std else "note"


def sharp_samples(channel: Channel, resolution: float) -> tuple[BoolArray, ...]:
    """(n_samples,) a record, True where the channel is off the curve through its neighbours, spike or not."""
    masks = []
    for part in channel.parts:
        off = np.abs(_off_curve(part))
        limit = _limit(off, channel, resolution, SPARSE)
        masks.append(np.asarray(off > limit, dtype=np.bool_))
    return tuple(masks)


def _off_curve(part: FloatArray) -> FloatArray:
    """Each sample less the cubic through two neighbours on either side; 0 at the ends, nan beside missing ones."""
    off = np.zeros(part.size)
    if part.size > 4:
        near, far = part[1:-3] + part[3:-1], part[:-4] + part[4:]
        off[2:-2] = part[2:-2] - (4.0 * near - far) / 6.0
    return off


def _limit(off: FloatArray, channel: Channel, resolution: float, usual_is: tuple[float, float]) -> FloatArray:
    """How far a sample may be off: six times what is usual in its block and the two beside it.

    Samples of which nothing is known take no part in what is usual; the blocks are of the others.
    """
    known = ~np.isnan(off)
    if not known.all():
        limit = np.full(off.size, np.inf)
        limit[known] = _limit(off[known], channel, resolution, usual_is)
        return limit
    n_blocks = off.size // BLOCK
    floor = max(LEAST_SIZE * channel.std, 4.0 * resolution if np.isfinite(resolution) else 0.0)
    if n_blocks == 0:
        return np.full(off.size, np.inf)
    quantile, normal = usual_is
    place_of = int(quantile * BLOCK)
    blocks = np.abs(off[: n_blocks * BLOCK]).reshape(n_blocks, BLOCK)
    usual = np.partition(blocks, place_of, axis=1)[:, place_of] / normal
    padded = np.concatenate([usual[:1], usual, usual[-1:]])
    usual = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    every = np.repeat(usual, BLOCK)
    every = np.concatenate([every, np.full(off.size - every.size, usual[-1])])
    return np.asarray(np.maximum(TIMES_USUAL * every, floor), dtype=np.float64)


def _sharp(part: FloatArray, off: FloatArray, channel: Channel, resolution: float) -> list[int]:
    """Samples that are far off while their neighbours are not once they are taken out."""
    size = np.abs(off)
    limit = _limit(off, channel, resolution, CROWDED)
    candidates = np.flatnonzero(size > limit)
    found = []
    for k in candidates[:100_000].tolist():
        nearby = part[max(0, k - 2 * _REACH) : k + 2 * _REACH + 1].copy()
        middle = min(k, 2 * _REACH)
        nearby[middle] -= off[k]
        left = _off_curve(nearby)
        peak = size[k] >= np.nanmax(size[max(0, k - _REACH) : k + _REACH + 1])
        if (
            peak
            and _same_either_side(part, k, size[k])
            and np.nanmax(np.abs(left)) <= max(LEFT_OVER * size[k], limit[k] / 3.0)
        ):
            found.append(k)
    return found


def _same_either_side(part: FloatArray, k: int, size: float) -> bool:
    """Whether the channel goes on after the sample where it was before it: a step does not."""
    if k < 3 or k + 3 >= part.size:
        return True
    across = part[k + 1] - part[k - 1]
    beside = 0.5 * (part[k + 3] - part[k + 1] + part[k - 1] - part[k - 3])
    return not abs(across - beside) > 0.5 * size


def _moves_nearby(part: FloatArray, k: int, channel: Channel) -> bool:
    """Whether an input moves around the sample most of the time: a single pulse out of rest is a hit, not a spike."""
    nearby = np.concatenate([part[max(0, k - BLOCK) : max(0, k - 1)], part[k + 2 : k + BLOCK]])
    low, high = np.nanquantile(nearby, [0.25, 0.75])
    return bool(high - low > LEAST_SIZE * channel.std)
