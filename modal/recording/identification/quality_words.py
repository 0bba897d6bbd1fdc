"""The quality of the data in words, as Markdown: the verdict, what was found, one row a channel."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from modal.quality.findings import DataQuality
from modal.recording.names import cell
from modal.recording.words import UNKNOWN, bullets, table
from okid.record import Record

__all__ = ["quality_text"]

LISTED_CHANNELS: Final = 40
LISTED_FINDINGS: Final = 20


def quality_text(quality: DataQuality, records: Sequence[Record]) -> str:
    """What the data are good for, before any model.

    Args:
        quality: of the records.
        records: the same.
    """
    first = records[0]
    n_samples = sum(record.n_samples for record in records)
    seconds = sum(record.n_samples * record.dt for record in records)
    of = f"{len(records)} records, " if len(records) > 1 else ""
    extent = (
        f"{of}{n_samples} samples at {first.sampling_frequency:.6g} Hz, {seconds:.4g} s in all; "
        f"{_count(first.n_inputs, 'input')}, {_count(first.n_outputs, 'output')}."
    )
    parts = [f"### {cell(quality.verdict)}", extent]
    found = quality.findings[:LISTED_FINDINGS]
    lines = [
        f"{k}. **{one.level}**, {cell(one.where, 80)}: {cell(one.sentence)}" for k, one in enumerate(found, start=1)
    ]
    parts.append("\n".join(lines))
    left = len(quality.findings) - len(found)
    if left:
        parts += bullets([f"{_count(left, 'finding')} more; all are stored."])
    head = ["channel", "unit", "deviation", "largest", "over noise", "explained", "data"]
    rows = [
        [
            cell(one.name, 24),
            cell(one.unit, 12) if one.unit else UNKNOWN,
            _figures(one.statistics.std),
            _figures(max(abs(one.statistics.smallest), abs(one.statistics.largest))),
            f"{one.statistics.signal_to_noise:.0f} dB" if np.isfinite(one.statistics.signal_to_noise) else UNKNOWN,
            f"{100 * one.statistics.explained:.1f} %" if np.isfinite(one.statistics.explained) else UNKNOWN,
            one.level if one.level == "good" else f"**{one.level}**",
        ]
        for one in quality.channels[:LISTED_CHANNELS]
    ]
    parts.append(table(head, rows))
    if first.n_inputs:
        parts.append(
            "Over noise: power of the channel over that of broadband noise, at least. Explained: share of an output's "
            "power that the inputs explain by a linear law (coherence)."
        )
    return "\n\n".join(part for part in parts if part)


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _figures(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else UNKNOWN
