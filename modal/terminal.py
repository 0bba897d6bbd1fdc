"""What the command prints: the mode table, what it means, and where the files are.

Names come from files: every cell is a `Text`, never markup, and shows control characters instead of obeying them.
"""

import math
import re
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from modal.examples.demo import ModeComparison
from modal.identification import Identification
from modal.mode import Mode
from modal.names import visible
from modal.numbering import numbered
from modal.report.words import damping_text, data_sentences, frequency_text, headline, hertz, judge
from modal.report.writing import ReportFiles

__all__ = ["listing", "plain", "show_comparison", "show_files", "show_result"]

MOST_NOISE = 5
"""Noise poles shown in the terminal; the report has all."""

_COLOURS = {"system": "green", "doubtful": "yellow", "noise": "bright_black"}
_TRUST = {"carried": "bold green", "with care": "bold yellow", "not carried": "bold red"}


def plain(text: str, style: str = "") -> Text:
    """Text that a terminal shows as it is."""
    return Text(visible(text), style=style)


def show_result(console: Console, result: Identification, *, remarks: Sequence[str] = ()) -> None:
    """Headline, mode table, fit and warnings in words."""
    judgement = judge(result)
    console.print()
    console.print(plain(headline(result), "bold"))
    console.print(_mode_table(result.modes.modes))
    hidden = sum(mode.verdict == "noise" for mode in result.modes) - MOST_NOISE
    if hidden > 0:
        poles = "pole" if hidden == 1 else "poles"
        console.print(plain(f"and {hidden} more noise {poles}, all in the report", "bright_black"))
    console.print()
    console.print(plain(f"{judgement.label}. ", _TRUST[judgement.trust]) + plain(" ".join(judgement.reasons)))
    listing(console, "Warnings", result.warnings, "yellow")
    listing(console, "Data", (*data_sentences(result), *remarks), "")


def show_comparison(console: Console, comparison: Sequence[ModeComparison]) -> None:
    """True and found modes of the demo side by side."""
    table = Table(title="Found against true", title_justify="left", title_style="bold", box=None, pad_edge=False)
    for heading in ("true [Hz]", "found [Hz]", "off by", "true damping", "found", "shape assurance"):
        table.add_column(heading, justify="right")
    table.add_column("verdict")
    for row in comparison:
        table.add_row(
            hertz(row.frequency),
            hertz(row.found_frequency) if math.isfinite(row.found_frequency) else "–",
            _number(100 * (row.found_frequency / row.frequency - 1), "{:+.3f} %"),
            f"{100 * row.damping_ratio:.2f} %",
            _number(100 * row.found_damping_ratio, "{:.2f} %"),
            _number(row.assurance, "{:.3f}"),
            plain(row.verdict or "not found", _COLOURS.get(row.verdict or "", "red")),
        )
    console.print()
    console.print(table)


def show_files(console: Console, files: ReportFiles) -> None:
    """Where the report is, one line a file, so that it can be opened by a click or a copy."""
    console.print()
    for path, what in zip(
        files,
        ("report to read", "the same as Markdown", "every number", "one row a pole", "to look at: rerun FILE"),
        strict=True,
    ):
        console.print(plain(str(path)) + plain(f"  {what}", "bright_black"), soft_wrap=True)


def _mode_table(modes: Sequence[Mode]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    table.add_column("", justify="right", no_wrap=True)
    table.add_column("Hz", justify="right", no_wrap=True)
    table.add_column("damping", justify="right", no_wrap=True)
    table.add_column("repeat.", justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    table.add_column("why", ratio=1)
    n_believed = sum(mode.verdict != "noise" for mode in modes)
    for number, mode in numbered(modes)[: n_believed + MOST_NOISE]:
        colour = _COLOURS[mode.verdict]
        table.add_row(
            plain(str(number), "bright_black"),
            plain(frequency_text(mode), f"bold {colour}" if mode.verdict == "system" else colour),
            plain(damping_text(mode), colour),
            plain(_number(mode.repeatability, "{:.2f}"), colour),
            plain(mode.verdict, colour),
            plain(
                mode.reason if mode.verdict != "noise" else _first_part(mode.reason),
                "" if mode.verdict == "system" else colour,
            ),
        )
    return table


def listing(console: Console, heading: str, sentences: Sequence[str], style: str) -> None:
    """A heading and its sentences, nothing where there is none."""
    if not sentences:
        return
    console.print()
    console.print(plain(heading, f"bold {style}".strip()))
    for sentence in sentences:
        console.print(plain(f"- {sentence}"))


def _first_part(reason: str) -> str:
    """The reason without its numbers, which the report has."""
    return re.split(r" \(|; ", reason, maxsplit=1)[0]


def _number(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else "–"
