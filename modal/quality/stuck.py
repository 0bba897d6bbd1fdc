"""A channel that never moves, that freezes for a while, or that repeats every value.

A frozen sample is told from a body at rest by how it begins and ends: a body comes to rest smoothly, a frozen channel
stops within one sample and jumps when it comes back. It is told from a coarse converter on a slow motion by its length:
ten times that of any other run of equal values nearby (the flat top of a sine is 4.8 times as long as its neighbours).
"""

from collections.abc import Sequence

import numpy as np

from modal.quality.channel import MOST_SPANS, Channel, named, spoken, where_found
from modal.quality.findings import Finding
from modal.wording.numbers import percent
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["constant_findings", "repeat_findings", "stuck_findings"]

LONGER = 10
"""Times as long as any run of equal values in the neighbourhood."""
NEIGHBOURHOOD = 8
"""Lengths of the run that are looked at before and after it."""
MOST_RUNS = 50
SUDDEN = 0.3
"""Of the median step nearby: a run that begins and ends with less is rest."""
BAD_SHARE = 0.01
REPEATED = 0.9


def constant_findings(channel: Channel, n_records: int) -> list[Finding]:
    """The channel never moves by more than its last digit."""
    if channel.std > 0.0:
        return []
    return [
        Finding(
            level="bad",
            what="constant",
            where=where_found(channel.name, (), n_records),
            sentence=f"{channel.role} {named(channel.name)} never moves (always {channel.value(channel.mean)}): it is "
            "dead, unplugged or not recorded; leave it out.",
            channels=(channel.name,),
            share=1.0,
        )
    ]


def repeat_findings(channel: Channel, n_records: int) -> list[Finding]:
    """Every value stands two or more times in a row: the sensor is slower than the recorder."""
    if channel.role == "input" or channel.std == 0.0:
        return []
    lengths = np.concatenate([_runs(part)[1][1:-1] for part in channel.parts])
    if lengths.size < 100:
        return []
    times = int(np.median(lengths))
    share = float((lengths == times).mean())
    if times < 2 or share < REPEATED:
        return []
    return [
        Finding(
            level="doubtful",
            what="repeated samples",
            where=where_found(channel.name, (), n_records),
            sentence=f"output {named(channel.name)} holds each value for {times} samples: it was taken at "
            f"{spoken(1 / (times * channel.dt))} Hz only and held in between, which looks like a delay and an "
            f"attenuation; keep every {times}th row of the record.",
            channels=(channel.name,),
            share=share,
        )
    ]


def stuck_findings(channel: Channel, records: Sequence[Record], resolution: float) -> list[Finding]:
    """Runs of equal values in a channel that moves before and after.

    Args:
        channel: the channel.
        records: all channels: where all of them rest, nothing is stuck.
        resolution: distance of neighbouring levels, nan where the values are on no grid.
    """
    if channel.std == 0.0:
        return []
    found = []
    for number, part in enumerate(channel.parts):
        for start, stop in _long_runs(part):
            if channel.role == "input":
                by_design = _is_rest_value(channel, part, start)
            else:
                by_design = _all_rest(records[number], channel, start, stop)
            if not by_design and _is_sudden(part, start, stop, resolution, rough=channel.role == "input"):
                found.append((number, start, stop))
    if not found:
        return []
    at_limit = all(float(channel.parts[n][a]) in {channel.smallest, channel.largest} for n, a, _ in found)
    spans = tuple(channel.span(*run) for run in found[:MOST_SPANS])
    n_stuck = sum(stop - start for _, start, stop in found)
    share = n_stuck / channel.n_samples
    first = found[0]
    value = channel.value(float(channel.parts[first[0]][first[1]]))
    many = f"{len(found)} times, first " if len(found) > 1 else ""
    return [
        Finding(
            level="bad" if share >= BAD_SHARE and channel.role == "output" else "doubtful",
            what="stuck",
            where=where_found(channel.name, spans, len(records)),
            sentence=f"{channel.role} {named(channel.name)} freezes {many}at {value} from {spans[0][1]:.6g} to "
            f"{spans[0][2]:.6g} s, {percent(share)} of its samples in all: "
            + (
                "that is its limit, so it ran out of range or dropped to a rail; mark those samples as missing "
                "(empty cells)."
                if at_limit
                else "it stops and comes back within one sample, so samples were lost or the sensor dropped out; "
                "mark them as missing (empty cells), or cut the record there."
            ),
            channels=(channel.name,),
            spans=spans,
            share=share,
        )
    ]


def _runs(part: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """First sample and length of every run of equal values; a missing sample is a run of its own."""
    edges = np.concatenate([[0], np.flatnonzero(part[1:] != part[:-1]) + 1, [part.size]])
    return edges[:-1], np.diff(edges)


def _long_runs(part: FloatArray) -> list[tuple[int, int]]:
    starts, lengths = _runs(part)
    if starts.size < 3:
        return []
    longest = np.argsort(lengths, kind="stable")[::-1][:MOST_RUNS]
    found = []
    for i in sorted(longest.tolist()):
        start, length = int(starts[i]), int(lengths[i])
        if length < LONGER:
            continue
        low = int(np.searchsorted(starts, start - NEIGHBOURHOOD * length, side="right")) - 1
        high = int(np.searchsorted(starts, start + (1 + NEIGHBOURHOOD) * length))
        others = np.concatenate([lengths[max(0, low) : i], lengths[i + 1 : high]])
        if others.size >= LONGER and length >= LONGER * others.max():
            found.append((start, start + length))
    return found


def _is_rest_value(channel: Channel, part: FloatArray, start: int) -> bool:
    """Whether an input may stand there by design: where it begins or ends, at zero, or at its limits."""
    value = float(part[start])
    return value in {0.0, float(part[0]), float(part[-1]), channel.smallest, channel.largest}


def _all_rest(record: Record, channel: Channel, start: int, stop: int) -> bool:
    """Whether every other channel stands still as well for most of the time."""
    window = slice(start, min(stop, start + 10_000))
    outputs = np.delete(record.outputs[window], channel.index, axis=1)
    others = np.concatenate([record.inputs[window], outputs], axis=1)
    return bool(others.shape[1] > 0 and (others[1:] == others[:-1]).all(axis=1).mean() > 0.5)


def _is_sudden(part: FloatArray, start: int, stop: int, resolution: float, *, rough: bool) -> bool:
    """Whether the channel stops or comes back within one sample, as nothing that has mass does."""
    reach = NEIGHBOURHOOD * (stop - start)
    before, after = part[max(0, start - reach) : start + 1], part[stop - 1 : stop + reach]
    steps = np.abs(np.concatenate([np.diff(before), np.diff(after[1:])]))
    steps = steps[steps > 0.0]
    if steps.size < LONGER:
        return False
    ends = [abs(float(part[start] - part[start - 1]))] if start > 0 else []
    ends += [abs(float(part[stop] - part[stop - 1]))] if stop < part.size else []
    jump = max((end for end in ends if np.isfinite(end)), default=0.0)
    if rough:  # a made-up input has corners by design: only one that is rough all the time can be said to freeze
        bends = np.abs(np.concatenate([np.diff(before, 2), np.diff(after[1:], 2)]))
        if np.nanmedian(bends) < SUDDEN * np.median(steps):
            return False
    return bool(jump > SUDDEN * np.median(steps) and not jump <= 3.0 * resolution)
