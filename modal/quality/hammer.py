"""Hammer tests: double hits, where the force spectrum ends, and whether the response has died out at the end."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from modal.quality.channel import MOST_SPANS, Channel, named, spoken, where_found
from modal.quality.findings import Finding, Span
from modal.wording.numbers import percent
from okid.arrays import FloatArray
from okid.rows import runs_of

__all__ = ["hit_findings", "hits_of", "is_hammer", "ring_findings"]

QUIET = 0.05
"""Of the largest force: a hammer is quieter than this ..."""
QUIET_SHARE = 0.95
"""... for this share of the time, and the channel carries no noise of that size."""
ONE_SIDED = 0.3
"""Of the largest force: a hammer pushes and does not pull; what swings to both sides is a burst or an earthquake."""
HIT = 0.1
"""Of the largest force: what counts as a hit."""
DOUBLE = 20.0
"""Widths of a hit within which the next one is a double hit."""
FALLEN = 0.01
"""Of the largest density of the force: 20 dB down, the modes above are hardly driven."""
RINGING = 0.1
"""Of the largest level of the response that is left at the end."""
N_BLOCKS = 50


def is_hammer(channel: Channel) -> bool:
    """Whether an input is at rest but for short pulses, each of them many samples apart."""
    if channel.role == "output" or channel.std == 0.0:
        return False
    rest = _rest(channel)
    up, down = channel.largest - rest, rest - channel.smallest
    largest = max(up, down)
    if min(up, down) > ONE_SIDED * largest:
        return False
    quiet = sum(int((np.abs(part - rest) < QUIET * largest).sum()) for part in channel.parts)
    if quiet < QUIET_SHARE * (channel.n_samples - channel.n_missing):
        return False
    hits = hits_of(channel)
    return 0 < sum(len(some) for some in hits) <= max(1, channel.n_samples // 100)


def hits_of(channel: Channel) -> tuple[list[tuple[int, int]], ...]:
    """(start, stop) of each hit, a record; parts of one pulse that are closer than their width are one hit."""
    rest = _rest(channel)
    largest = max(channel.largest - rest, rest - channel.smallest)
    found = []
    for part in channel.parts:
        hits: list[tuple[int, int]] = []
        for start, stop in runs_of(np.abs(part - rest) > HIT * largest):
            if hits and start - hits[-1][1] < max(2, hits[-1][1] - hits[-1][0]):
                hits[-1] = (hits[-1][0], stop)
            else:
                hits.append((start, stop))
        found.append(hits)
    return tuple(found)


def hit_findings(channel: Channel, frequencies: FloatArray, density: FloatArray, n_records: int) -> list[Finding]:
    """Double hits, and the end of the force spectrum.

    Args:
        channel: a hammer.
        frequencies: (n_frequencies,) [Hz]; empty where no spectrum could be made.
        density: (n_frequencies,) of this channel.
        n_records: number of records.
    """
    found: list[Finding] = []
    doubles: list[Span] = []
    gap = 0.0
    for number, hits in enumerate(hits_of(channel)):
        for (start, stop), (again, end) in pairwise(hits):
            if again - start < DOUBLE * max(2, stop - start, end - again):
                doubles.append(channel.span(number, start, end))
                gap = gap or (again - start) * channel.dt
    if doubles:
        found.append(
            Finding(
                level="note",
                what="double hit",
                where=where_found(channel.name, doubles, n_records),
                sentence=f"hammer {named(channel.name)} struck twice {len(doubles)} time{'s' * (len(doubles) > 1)}, "
                f"first at {doubles[0][1]:.6g} s with {spoken(gap)} s between: the force spectrum then has dips every "
                f"{spoken(1 / gap)} Hz, which spoil quotients of spectra; the identification uses the force as it was "
                "and stands it.",
                channels=(channel.name,),
                spans=tuple(doubles[:MOST_SPANS]),
            )
        )
    if frequencies.size > 8:
        fallen = np.flatnonzero(density[1:] < FALLEN * density[1:].max())
        if fallen.size and frequencies[1 + fallen[0]] < 0.9 * frequencies[-1]:
            found.append(
                Finding(
                    level="note",
                    what="force spectrum",
                    where=named(channel.name),
                    sentence=f"the force spectrum of hammer {named(channel.name)} falls below a hundredth (-20 dB) of "
                    f"its largest density at {spoken(float(frequencies[1 + fallen[0]]))} Hz: modes above are hardly "
                    "driven; a harder tip reaches further.",
                    channels=(channel.name,),
                )
            )
    return found


def ring_findings(
    channel: Channel, hammers: Sequence[tuple[list[tuple[int, int]], ...]], n_records: int
) -> list[Finding]:
    """An output that still rings when the record ends.

    Args:
        channel: an output.
        hammers: hits of each hammer.
        n_records: number of records.
    """
    if channel.role == "input" or channel.std == 0.0 or not hammers:
        return []
    worst = 0.0
    for number, part in enumerate(channel.parts):
        last = max((hits[number][-1][1] for hits in hammers if hits[number]), default=None)
        if last is None or part.size - last < 2 * N_BLOCKS:
            continue
        size = (part.size - last) // N_BLOCKS
        blocks = part[part.size - N_BLOCKS * size :].reshape(N_BLOCKS, size) - channel.mean
        there = ~np.isnan(blocks)
        levels = np.sqrt(np.where(there, blocks**2, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1))
        worst = max(worst, float(levels[-2:].mean() / max(levels.max(), np.finfo(float).tiny)))
    if worst <= RINGING:
        return []
    return [
        Finding(
            level="note",
            what="still ringing",
            where=where_found(channel.name, (), n_records),
            sentence=f"output {named(channel.name)} still rings at {percent(worst)} of its largest level when the "
            "record ends: spectra of it leak, and an exponential window would add damping that has to be taken off "
            "again; the identification works in time and needs no window, but a longer record makes damping sharper.",
            channels=(channel.name,),
            share=worst,
        )
    ]


def _rest(channel: Channel) -> float:
    """Where the hammer rests: the median of the longest record."""
    return float(np.nanmedian(max(channel.parts, key=len)[: 1 << 20]))
