"""Faults that a look at single channels finds, and what the identification does about them before anything else.

A dead output is left out, spikes are left out sample by sample; what cannot be mended (clipping, few levels, a frozen
sensor) is said with its size. `modal.quality` says the same, and more, before a fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.preparation.amplitude import (
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


def mended(records: Sequence[Record]) -> Mended:
    """Leave out what is no measurement, and say so.

    Args:
        records: of one system.

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
        found, largest = spikes_of(channel, resolution, sharp)
        spiked = spike_findings(channel, resolution, sharp, len(kept)) if found else []
        if any(finding.level != "note" for finding in spiked):
            left_out = "left out" if channel.role == "output" else "an input must be whole, so they stay"
            told.setdefault("spikes", []).append(
                f"{channel.role.capitalize()} {named(channel.name)} has {len(found)} spike{'s' * (len(found) > 1)} "
                f"({percent(len(found) / channel.n_samples)} of the samples, up to {spoken(largest / channel.std)} "
                f"standard deviations off the curve through the neighbours): {left_out}."
            )
            if channel.role == "output":
                for number, k in found:
                    masks[number][k, channel.index] = True
        clipped = clipping_findings(channel, len(kept))
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
    warnings = []
    for what, sentences in told.items():
        warnings += sentences[:MOST_TOLD]
        if len(sentences) > MOST_TOLD:
            warnings.append(f"The same ({what}) is true of {counted(len(sentences) - MOST_TOLD)} more channels.")
    return Mended(records=kept, warnings=tuple(warnings))


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
