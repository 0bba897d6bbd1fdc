"""A channel that was cut off at a level: too many samples stand at its greatest or least value.

Among the sixteen outermost values that occur, the outermost itself occurs five times as often as any of the others, and
the channel comes back to it several times from below all sixteen. The crest of a sine on a converter's grid occurs 2.4
times as often as the next level; a channel that settles comes once; one that rests there does so most of the time.
"""

from typing import Literal

import numpy as np

from modal.quality.channel import MOST_SPANS, Channel, named, where_found
from modal.quality.findings import Finding, Span
from modal.wording.numbers import percent
from okid.arrays import FloatArray
from okid.rows import runs_of

__all__ = ["clipping_findings"]

OUTERMOST = 16
MORE_OFTEN = 5
FEWEST_LEVELS = 32
"""A channel with fewer values than that is a switch or a coarse converter, not a clipped one."""
FEWEST_VISITS = 3
REST_SHARE = 0.5
"""Share of the samples from which the level is where the channel rests."""
BAD_SHARE = 1e-3
_SAME = 1e-9
"""Of the extent: values closer than this are one value, rounded differently."""


def clipping_findings(channel: Channel, n_records: int) -> list[Finding]:
    """Clipping at the upper, the lower or both ends."""
    if channel.std == 0.0:
        return []
    sides: list[tuple[Literal["above", "below"], float]] = [("above", 1.0), ("below", -1.0)]
    found = [(side, *hit) for side, sign in sides if (hit := _clipped(channel, sign)) is not None]
    if not found:
        return []
    spans = tuple(sorted(span for _, _, some in found for span in some))[:MOST_SPANS]
    share = sum(count for _, count, _ in found) / channel.n_samples
    levels = " and ".join(
        f"{channel.value(channel.largest if side == 'above' else channel.smallest)} "
        f"({percent(count / channel.n_samples)})"
        for side, count, _ in found
    )
    head = f"{channel.role} {named(channel.name)} stands at its limit {levels} of the samples"
    if channel.role == "output":
        rest = (
            ": it is clipped, by an amplifier or converter out of range; what lies beyond is lost and makes false "
            "harmonics: mark those samples as missing, or measure again with a larger range."
        )
    else:
        rest = (
            ": right if the source is limited there, but if a sensor or amplifier was out of range, the true input "
            "is not known; compare with the source."
        )
    return [
        Finding(
            level="note" if channel.role == "input" else "bad" if share >= BAD_SHARE else "doubtful",
            what="clipped",
            where=where_found(channel.name, spans, n_records),
            sentence=head + rest,
            channels=(channel.name,),
            spans=spans,
            share=share,
        )
    ]


def _clipped(channel: Channel, sign: float) -> tuple[int, list[Span]] | None:
    """Number of clipped samples and where, None where that end is not clipped."""
    values, counts = _outermost(channel, sign)
    if (
        values.size < OUTERMOST
        or counts[0] < MORE_OFTEN * counts[1:].max()
        or counts[0] > REST_SHARE * channel.n_samples
    ):
        return None
    if _n_levels(channel) < FEWEST_LEVELS:
        return None
    visits = 0
    spans: list[Span] = []
    for number, part in enumerate(channel.parts):
        height = sign * part
        at_limit = height >= values[0] - _SAME * channel.extent
        visits += _visits(at_limit, height < values[-1])
        spans += [channel.span(number, start, stop) for start, stop in runs_of(at_limit)[:MOST_SPANS]]
    return (int(counts[0]), spans[:MOST_SPANS]) if visits >= FEWEST_VISITS else None


def _outermost(channel: Channel, sign: float) -> tuple[FloatArray, np.ndarray]:
    """The outermost values that occur, the first the greatest of sign * x, and how often each does."""
    values, counts = np.empty(0), np.empty(0, dtype=np.int64)
    for part in channel.parts:
        for start in range(0, part.size, 1 << 18):
            height = sign * part[start : start + (1 << 18)]
            height = height[~np.isnan(height)]
            if values.size >= OUTERMOST:
                height = height[height >= values[-1]]
            more, times = np.unique(height, return_counts=True)
            values, counts = _merged(
                np.concatenate([values, more]), np.concatenate([counts, times]), _SAME * channel.extent
            )
    return values, counts


def _merged(values: FloatArray, counts: np.ndarray, same: float) -> tuple[FloatArray, np.ndarray]:
    """Greatest first, values that differ by rounding only taken together, the outermost sixteen kept."""
    order = np.argsort(values, kind="stable")[::-1]
    values, counts = values[order], counts[order]
    if values.size == 0:
        return values, counts
    firsts = np.concatenate([[True], -np.diff(values) > same])
    group = np.cumsum(firsts) - 1
    sums = np.bincount(group, weights=counts).astype(np.int64)
    return values[firsts][:OUTERMOST], sums[:OUTERMOST]


def _n_levels(channel: Channel) -> int:
    longest = max(channel.parts, key=len)[: 1 << 16]
    levels = np.unique(longest[~np.isnan(longest)])
    return 1 + int((np.diff(levels) > _SAME * channel.extent).sum())


def _visits(at_limit: np.ndarray, far: np.ndarray) -> int:
    """How often the limit is reached anew after the channel was far from it."""
    events = np.flatnonzero(at_limit | far)
    kinds = at_limit[events]
    return int((kinds[1:] & ~kinds[:-1]).sum()) + int(kinds.size > 0 and bool(kinds[0]))
