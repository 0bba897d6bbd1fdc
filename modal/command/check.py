"""`modal-report check`: the quality of the data, without an identification; the worst findings come first."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from modal.command.options import Dt, Hold, Inputs, Outputs, Records, Traceback, examples, faults, name_list
from modal.command.run import FileSource, own_warnings, refuse_sources, sizes
from modal.command.terminal import Screen, listing, number_text, plain, progress_bar, say_beforehand
from modal.preparation.channel import LEVELS, Finding
from modal.quality.check import ChannelQuality, DataQuality, check_quality, expected_check
from modal.quality.inputs import choices_beforehand
from modal.wording.text import shorten, whole_percent
from okid.errors import InvalidDataError
from okid.readers.guard import complete_file
from okid.record import Record

_COLOURS = {"bad": "red", "doubtful": "yellow", "note": "bright_black", "good": "green"}
_HEADINGS = {"bad": "Bad", "doubtful": "Doubtful", "note": "Good to know"}


class TableSize:
    """How much of a check a terminal shows."""

    LEAST_FOUND: Final = 18
    """Keep so many letters for a channel and for what was found in it, so that both fit into 80."""
    MOST_CHANNELS: Final = 40
    """Show so many channels; of more, those without a finding are left out first."""


def show_quality(
    console: Console, quality: DataQuality, records: Sequence[Record], *, remarks: Sequence[str] = ()
) -> None:
    """Verdict, table of the channels, findings in words."""
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
        _findings(console, level, quality.findings)
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
    if len(channels) <= TableSize.MOST_CHANNELS:
        return list(channels)
    worst_first = sorted(channels, key=lambda channel: (channel.level == "good", not channel.findings))
    kept = {channel.name for channel in worst_first[: TableSize.MOST_CHANNELS]}
    return [channel for channel in channels if channel.name in kept]


def _table(channels: Sequence[ChannelQuality], *, width: int) -> Table:
    """One row a channel, first what was found; on a narrow screen without the mean and the extremes."""
    wide = width >= 100
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    table.add_column("channel", no_wrap=True)
    table.add_column("found", ratio=1, min_width=TableSize.LEAST_FOUND)
    table.add_column("", no_wrap=True)
    for heading in ("mean", "std", "least", "greatest") if wide else ("std",):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("SNR >=", justify="right", no_wrap=True)
    table.add_column("explained", justify="right", no_wrap=True)
    for channel in channels:
        numbers = channel.statistics
        values = (numbers.mean, numbers.std, numbers.smallest, numbers.largest) if wide else (numbers.std,)
        table.add_row(
            plain(shorten(channel.name, 28 if wide else TableSize.LEAST_FOUND)),
            _what(channel),
            plain(channel.role, "bright_black"),
            *(plain(number_text(x, "{:.3g}")) for x in values),
            plain(shorten(channel.unit, 12 if wide else 7), "bright_black"),
            plain(number_text(numbers.signal_to_noise, "{:.0f} dB")),
            plain(whole_percent(numbers.explained)),
        )
    return table


def _what(channel: ChannelQuality) -> Text:
    """The keys of the findings, or "good"."""
    serious = [finding for finding in channel.findings if finding.level != "note"] or list(channel.findings)
    words = ", ".join(dict.fromkeys(finding.what for finding in serious))
    return plain(words or "good", _COLOURS[channel.level] if channel.level != "good" or not words else "bright_black")


def _findings(console: Console, level: str, findings: Sequence[Finding]) -> None:
    """Those of one level; all sentences begin in one column, whatever their level."""
    width = max((len(finding.what) for finding in findings), default=0)
    findings = [finding for finding in findings if finding.level == level]
    if not findings:
        return
    console.print()
    console.print(plain(_HEADINGS[level], f"bold {_COLOURS[level]}"))
    rows = Table.grid(padding=(0, 2, 0, 0), expand=True)
    rows.add_column(no_wrap=True, width=width)
    rows.add_column(ratio=1)
    for finding in findings:
        rows.add_row(plain(finding.what, _COLOURS[level]), plain(finding.sentence))
    console.print(rows)


def carry_out_check(source: FileSource, json: Path | None) -> DataQuality:
    """Read, check, write, print what was found; the file is complete before a word is printed.

    Args:
        source: files, channels, time step.
        json: file for the numbers and findings; None writes none. One that is there is replaced.

    Raises:
        InvalidDataError: files that cannot be read or do not belong together, or numbers that could not be written, or
            not without losing a measured file.
    """
    if json is not None:
        refuse_sources([json], source.files)
    with progress_bar() as tell, own_warnings() as heard:
        tell("reading", 0.0)
        records, remarks = source.read()
        say_beforehand(*sizes(records), *expected_check(records))
        tell("looking at the data", 0.5)
        quality = check_quality(records, choices=choices_beforehand(records))
        if json is not None:
            _write(json, quality_json(quality, records))
    show_quality(Screen(highlight=False), quality, records, remarks=(*remarks, *heard))
    return quality


def quality_json(quality: DataQuality, records: Sequence[Record]) -> str:
    """Everything that was found as JSON; what is not known is null. The same records give the same bytes."""
    document = {
        "level": quality.level,
        "verdict": quality.verdict,
        "records": [
            {"name": record.name, "samples": record.n_samples, "dt": record.dt, "start_time": record.start_time}
            for record in records
        ],
        "findings": [_finding(finding) for finding in quality.findings],
        "channels": [_channel(channel) for channel in quality.channels],
    }
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _finding(finding: Finding) -> dict[str, object]:
    return {
        "level": finding.level,
        "what": finding.what,
        "where": finding.where,
        "sentence": finding.sentence,
        "channels": list(finding.channels),
        "spans": [{"record": record, "from": start, "to": stop} for record, start, stop in finding.spans],
        "share": _known(finding.share),
    }


def _channel(channel: ChannelQuality) -> dict[str, object]:
    numbers = {name: _known(value) for name, value in asdict(channel.statistics).items()}
    return {"name": channel.name, "role": channel.role, "unit": channel.unit, "level": channel.level, **numbers}


def _known(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _write(path: Path, text: str) -> None:
    """The whole file or none of it."""
    try:
        with complete_file(path) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InvalidDataError(f"{path} could not be written ({error.strerror}); choose another place.") from error


EXAMPLES = examples(
    "before anything else: check test.csv --inputs force",
    "several records: check day1.mat day2.mat --inputs f1,f2 --dt 0.001",
    "for another program: check test.csv --inputs force --json quality.json",
)


def check(
    files: Records,
    *,
    inputs: Inputs = None,
    outputs: Outputs = None,
    dt: Dt = None,
    hold: Hold = "band_limited",
    numbers: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the findings and their numbers into a file (replaced)."),
    ] = None,
    traceback: Traceback = False,
) -> None:
    """Look at the data of FILES only: clipping, dropouts, hum, coherence and whatever else would spoil a result.

    It takes seconds. Exit status: 0 nothing bad; 1 a finding that spoils a
    result; 2 wrong use or unreadable input.
    """
    with faults(show=traceback):
        source = FileSource(
            files=files, inputs=name_list(inputs, "inputs"), outputs=name_list(outputs, "outputs"), dt=dt, hold=hold
        )
        quality = carry_out_check(source, numbers)
        raise typer.Exit(1 if quality.level == "bad" else 0)
