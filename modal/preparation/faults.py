"""Faults that a look at single channels finds, and what the identification does about them before anything else.

A dead output is left out, spikes are left out sample by sample, and so is what is clipped where measured inputs tell
what lay beyond the limit; what cannot be mended (few levels, a frozen sensor) is said with its size. `modal.quality`
says the same, and more, before a fit.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.preparation.amplitude import (
    clipped_samples,
    clipping_findings,
    constant_findings,
    resolution_findings,
    resolution_of,
    stuck_findings,
)
from modal.preparation.channel import LEVELS, Channel, Finding, channels_of, named, spoken
from modal.preparation.samples import sharp_samples, spike_findings, spikes_of
from modal.wording.numbers import counted, percent
from okid.arrays import BoolArray
from okid.record import Record
from okid.rows import as_records
from okid.scaling import channel_scaling

__all__ = ["Mended", "mended", "spoiled_channels"]


MOST_TOLD = 4
"""Tell the same fault of so many channels, and count the others."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Mended:
    """Records without dead outputs, spikes missing.

    Attributes:
        records: the very records that came where nothing is wrong.
        warnings: a sentence for each fault.
    """

    records: tuple[Record, ...]
    warnings: tuple[str, ...]


def mended(records: Sequence[Record], *, driven: bool = False) -> Mended:
    """Leave out what is no measurement, and say so.

    Args:
        records: of one system.
        driven: by inputs that were measured throughout: a free run bridges what is clipped. A blow or a decay has all
            that it says at its peaks, and without inputs peaks are predicted by others that are clipped.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> tip = np.convolve(rng.standard_normal(4000), [1.0, 1.6, 1.5, 0.8])[:4000]
        >>> found = mended([Record([], np.column_stack([tip, np.ones(4000)]), 0.01, output_names=["tip", "root"])])
        >>> found.records[0].output_names, found.warnings
        (('tip',), ("Output 'root' never moves (always 1): it is dead, unplugged or not recorded; left out.",))
    """
    kept, dead = _living(records)
    told: dict[str, list[str]] = {"dead": dead}
    masks = [np.zeros(record.outputs.shape, dtype=np.bool_) for record in kept]
    for channel, resolution, sharp in _looked(kept):
        spiked, gone = _spikes(channel, resolution, sharp, kept)
        if spiked:
            told.setdefault("spikes", []).append(spiked)
        left_out = driven and channel.role == "output"
        clipped = clipping_findings(channel, len(kept), left_out=left_out)
        if clipped and left_out:
            gone = [one | more for one, more in zip(gone, clipped_samples(channel), strict=True)]
        if channel.role == "output":
            for mask, own in zip(masks, gone, strict=True):
                mask[:, channel.index] = own
        more = [*clipped, *resolution_findings(channel, resolution, len(kept))]
        more += [] if clipped else stuck_findings(channel, kept, resolution)
        for f in more:
            if f.level != "note":
                told.setdefault(f.what, []).append(f"{f.sentence[0].upper()}{f.sentence[1:]}")
    if any(mask.any() for mask in masks):
        kept = tuple(
            replace(record, outputs=np.where(mask, np.nan, record.outputs)) if mask.any() else record
            for record, mask in zip(kept, masks, strict=True)
        )
    return Mended(records=kept, warnings=tuple(_told(told)))


def _told(faults: Mapping[str, Sequence[str]]) -> Iterator[str]:
    for what, sentences in faults.items():
        yield from sentences[:MOST_TOLD]
        if len(sentences) > MOST_TOLD:
            yield f"The same ({what}) is true of {counted(len(sentences) - MOST_TOLD)} more channels."


def _spikes(
    channel: Channel, resolution: float, sharp: Sequence[BoolArray], records: Sequence[Record]
) -> tuple[str, list[BoolArray]]:
    """A sentence on the spikes of a channel, and where they are; nothing where they are not worth one."""
    found, largest = spikes_of(channel, resolution, sharp)
    spiked = spike_findings(channel, resolution, sharp, len(records)) if found else []
    masks = [np.zeros(record.n_samples, dtype=np.bool_) for record in records]
    if all(finding.level == "note" for finding in spiked):
        return "", masks
    for number, k in found:
        masks[number][k] = True
    fate = "left out" if channel.role == "output" else "an input must be whole, so they stay"
    sentence = (
        f"{channel.role.capitalize()} {named(channel.name)} has {len(found)} spike{'s' * (len(found) > 1)} "
        f"({percent(len(found) / channel.n_samples)} of the samples, up to {spoken(largest / channel.std)} "
        f"standard deviations off the curve through the neighbours): {fate}."
    )
    return sentence, masks


def spoiled_channels(records: Record | Sequence[Record]) -> tuple[Finding, ...]:
    """What `modal.check_quality` finds of dead, clipped and spiked channels, without the price of spectra.

    Args:
        records: one record or several of one system.
    """
    several = as_records(records)
    n = len(several)
    findings: list[Finding] = []
    for channel, resolution, sharp in _looked(several):
        findings += [*constant_findings(channel, n), *clipping_findings(channel, n)]
        findings += spike_findings(channel, resolution, sharp, n)
    return tuple(sorted(findings, key=lambda finding: LEVELS.index(finding.level)))


def _looked(records: Sequence[Record]) -> Iterator[tuple[Channel, float, tuple[BoolArray, ...]]]:
    """Each channel with its resolution and where the inputs before it move sharply."""
    sharp = tuple(np.zeros(record.n_samples, dtype=np.bool_) for record in records)
    for channel in channels_of(records, channel_scaling(records)):
        resolution = resolution_of(channel)
        yield channel, resolution, sharp
        if channel.role == "input":
            own = sharp_samples(channel, resolution)
            sharp = tuple(mask | more for mask, more in zip(sharp, own, strict=True))


def _living(records: Sequence[Record]) -> tuple[tuple[Record, ...], list[str]]:
    """The records without outputs that stand at one value in all of them, as long as one output moves."""
    first = records[0]
    low = np.min([np.fmin.reduce(record.outputs, axis=0) for record in records], axis=0)
    high = np.max([np.fmax.reduce(record.outputs, axis=0) for record in records], axis=0)
    moves = ~(low == high)
    if moves.all() or not moves.any():
        return tuple(records), []
    words = [
        f"Output {named(first.output_names[i])} never moves (always {low[i]:.6g}): it is dead, unplugged or not "
        "recorded; left out."
        for i in np.flatnonzero(~moves)
    ]
    return tuple(record.select(outputs=np.flatnonzero(moves).tolist()) for record in records), words
