"""What the command prints: the mode table, what it means, and where the files are.

Names come from files: every cell is a `Text`, never markup, and shows control characters instead of obeying them.
"""

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from modal.acceptance.check import LimitOutcome
from modal.examples.demo import ModeComparison
from modal.identification.result import Identification
from modal.identification.trust import damping_text, frequency_text, trust_of
from modal.modes.mode import Mode
from modal.modes.numbering import numbered
from modal.report.kept_result import LARGEST_KEPT
from modal.report.writing import ReportFiles
from modal.sections.words import data_sentences, modes_headline
from modal.wording.names import shorten, visible
from modal.wording.numbers import hertz

__all__ = ["listing", "plain", "show_comparison", "show_files", "show_limits", "show_result"]

LONGEST_NAME = 80
"""Letters of the name of a limit, which is a stranger's text."""

MOST_NOISE = 5
"""Noise poles shown in the terminal; the report has all."""

_COLOURS = {"system": "green", "doubtful": "yellow", "noise": "bright_black"}
_STATES = {"met": "green", "not met": "bold red", "cannot be told": "yellow"}
_TRUST = {"carried": "bold green", "with care": "bold yellow", "not carried": "bold red"}


def plain(text: str, style: str = "") -> Text:
    """Text that a terminal shows as it is."""
    return Text(visible(text), style=style)


def show_result(
    console: Console, result: Identification, *, remarks: Sequence[str] = (), limits: Sequence[LimitOutcome] = ()
) -> None:
    """Headline, mode table, limits of acceptance, fit and warnings in words."""
    judgement = trust_of(result)
    console.print()
    console.print(plain(modes_headline(result), "bold"))
    console.print(_mode_table(result.modes.modes))
    hidden = sum(mode.verdict == "noise" for mode in result.modes) - MOST_NOISE
    if hidden > 0:
        poles = "pole" if hidden == 1 else "poles"
        console.print(plain(f"and {hidden} more noise {poles}, all in the report", "bright_black"))
    console.print()
    console.print(plain(f"{judgement.label}. ", _TRUST[judgement.trust]) + plain(" ".join(judgement.reasons)))
    show_limits(console, limits)
    listing(console, "Warnings", result.warnings, "yellow")
    listing(console, "Data", (*data_sentences(result), *remarks), "")


def show_limits(console: Console, limits: Sequence[LimitOutcome]) -> None:
    """One line a limit of the test file, the outcome first."""
    if not limits:
        return
    n_met = sum(outcome.met for outcome in limits)
    console.print()
    console.print(plain(f"Acceptance: {n_met} of {len(limits)} limits met", "bold"))
    table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    table.add_column("", ratio=1)
    for outcome in limits:
        table.add_row(plain(outcome.state, _STATES[outcome.state]), plain(_limit_text(outcome)))
    console.print(table)


def _limit_text(outcome: LimitOutcome) -> str:
    text = f"{shorten(outcome.what, LONGEST_NAME)}: wanted {outcome.required}; found {outcome.found}"
    return f"{text} ({outcome.reason})" if outcome.reason else text


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


def show_files(console: Console, files: ReportFiles, *, pdf: Path | None = None) -> None:
    """Where the report is, one line a file, so that it can be opened by a click or a copy."""
    console.print()
    meanings = (
        (files.html, "report to read"),
        (pdf, "the same on paper"),
        (files.markdown, "the same as Markdown"),
        (files.json, "every number"),
        (files.csv, "one row a pole"),
        (files.uff55, "the modes for other programs"),
        (files.result, "the result itself, for modal.load, diff and view"),
        (files.recording, f"to look at: modal-report view {shlex.quote(str(files.recording.parent))}"),
    )
    for path, meaning in meanings:
        if path is not None:
            console.print(plain(str(path)) + plain(f"  {meaning}", "bright_black"), soft_wrap=True)
    if files.result is None:
        sentence = f"The result itself is above {LARGEST_KEPT >> 20} MiB and was not kept; diff reads report.json."
        console.print(plain(sentence, "bright_black"))


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
