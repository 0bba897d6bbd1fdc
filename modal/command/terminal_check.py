"""What `modal-report check` prints: one row a channel, then the findings, the worst first."""

import math
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from modal.command.terminal import listing, plain
from modal.quality.findings import LEVELS, ChannelQuality, DataQuality, Finding
from modal.wording.names import shorten
from modal.wording.numbers import whole_percent
from okid.record import Record

__all__ = ["show_quality"]

_COLOURS = {"bad": "red", "doubtful": "yellow", "note": "bright_black", "good": "green"}
_HEADINGS = {"bad": "Bad", "doubtful": "Doubtful", "note": "Good to know"}
_WHAT_WIDTH = 17
"""Letters of the longest key of a finding, so that all sentences begin in one column."""
LONGEST_NAME = 28
WIDE = 100
"""Letters a line from which the table has room for the extremes of each channel."""
MOST_CHANNELS = 40
"""Rows of the table; of more channels the ones without a finding are left out first."""


def show_quality(
    console: Console, quality: DataQuality, records: Sequence[Record], *, remarks: Sequence[str] = ()
) -> None:
    """Verdict, table of the channels, findings in words.

    Args:
        console: to print on.
        quality: of the records.
        records: as they were read.
        remarks: on what was done to their units.
    """
    console.print()
    console.print(plain(quality.verdict, f"bold {_COLOURS[quality.level]}"))
    console.print(plain(_size(records), "bright_black"))
    console.print()
    shown = _shown(quality.channels)
    console.print(_table(shown, width=console.width))
    hidden = len(quality.channels) - len(shown)
    if hidden:
        console.print(plain(f"and {hidden} more channel{'s' * (hidden > 1)} without a fault", "bright_black"))
    for level in LEVELS:
        _findings(console, level, [finding for finding in quality.findings if finding.level == level])
    listing(console, "Units", remarks, "")


def _size(records: Sequence[Record]) -> str:
    first = records[0]
    n_samples = sum(record.n_samples for record in records)
    several = f"{len(records)} records, " if len(records) > 1 else ""
    return (
        f"{several}{n_samples} samples every {first.dt:.6g} s ({first.sampling_frequency:.6g} Hz, "
        f"{n_samples * first.dt:.6g} "
        f"s), {first.n_inputs} input{'s' * (first.n_inputs != 1)}, {first.n_outputs} "
        f"output{'s' * (first.n_outputs != 1)}"
    )


def _shown(channels: Sequence[ChannelQuality]) -> list[ChannelQuality]:
    if len(channels) <= MOST_CHANNELS:
        return list(channels)
    worst_first = sorted(channels, key=lambda channel: (channel.level == "good", not channel.findings))
    kept = {channel.name for channel in worst_first[:MOST_CHANNELS]}
    return [channel for channel in channels if channel.name in kept]


def _table(channels: Sequence[ChannelQuality], *, width: int) -> Table:
    """One row a channel; on a narrow screen without its extremes, so that what was found in it has room."""
    extremes = ("least", "greatest") if width >= WIDE else ()
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    table.add_column("channel", no_wrap=True)
    table.add_column("", no_wrap=True)
    for heading in ("mean", "std", *extremes):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("SNR >=", justify="right", no_wrap=True)
    table.add_column("explained", justify="right", no_wrap=True)
    table.add_column("found", ratio=1)
    for channel in channels:
        numbers = channel.statistics
        values = (numbers.mean, numbers.std, *((numbers.smallest, numbers.largest) if extremes else ()))
        table.add_row(
            plain(shorten(channel.name, LONGEST_NAME)),
            plain(channel.role, "bright_black"),
            *(plain(_number(x)) for x in values),
            plain(shorten(channel.unit, 12), "bright_black"),
            plain(_number(numbers.signal_to_noise, "{:.0f} dB")),
            plain(whole_percent(numbers.explained)),
            _what(channel),
        )
    return table


def _what(channel: ChannelQuality) -> Text:
    """The keys of the findings, or "good"."""
    serious = [finding for finding in channel.findings if finding.level != "note"] or list(channel.findings)
    words = ", ".join(dict.fromkeys(finding.what for finding in serious))
    return plain(words or "good", _COLOURS[channel.level] if channel.level != "good" or not words else "bright_black")


def _findings(console: Console, level: str, findings: Sequence[Finding]) -> None:
    if not findings:
        return
    console.print()
    console.print(plain(_HEADINGS[level], f"bold {_COLOURS[level]}"))
    rows = Table.grid(padding=(0, 2, 0, 0), expand=True)
    rows.add_column(no_wrap=True, width=_WHAT_WIDTH)
    rows.add_column(ratio=1)
    for finding in findings:
        rows.add_row(plain(finding.what, _COLOURS[level]), plain(finding.sentence))
    console.print(rows)


def _number(value: float, form: str = "{:.3g}") -> str:
    return form.format(value) if math.isfinite(value) else "–"
