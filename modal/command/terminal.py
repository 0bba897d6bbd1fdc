"""What the commands print: the mode table, what it means, where the files are, and how long the work will still take.

Names come from files: every cell is a `Text`, never markup, and shows control characters instead of obeying them.
"""

import codecs
import contextlib
import io
import math
import os
import re
import shlex
import sys
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, Task, TaskProgressColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from modal.acceptance.check import LimitOutcome
from modal.command.stopping import Requests
from modal.examples.demo import ModeComparison
from modal.identification.result import Identification
from modal.identification.words import (
    damping_sentence,
    damping_text,
    doubtful_sentence,
    frequency_text,
    mass_text,
    shown_frequency,
)
from modal.modes.mode import Mode, numbered
from modal.quality import DataQuality
from modal.recording.live import live_recording
from modal.report.writing import ReportFiles
from modal.sections.words import data_sentences, judgement_of, modes_headline, next_sentences, remark_of
from modal.wording.text import MOST_NAMED, clipped, hertz, ranges, shorten
from okid.errors import visible


class Shown:
    """How much a terminal shows, and from when on."""

    MOST_NOISE: Final = MOST_NAMED
    """Name so many noise poles; the report has all."""
    MOST_LINES: Final = 25
    """Let the answer of up to six modes fill so many lines, those of a window, and what is longer is in the report."""
    MODES: Final = 6
    """Give each mode beyond these a line more."""
    FILES: Final = 4
    """Keep so many of them for `show_files`."""
    LEAST_SHARE: Final = 0.05
    """Say nothing of the time left before this share of the work: the start says little about the rest."""
    LONG: Final = 60.0
    """Say beforehand what work may take that may last longer [s]."""
    LEAST_SECONDS: Final = 1.5
    """Say nothing of it before this time either."""


_COLOURS = {"system": "green", "doubtful": "yellow", "noise": "bright_black"}
_STATES = {"met": "green", "not met": "bold red", "cannot be told": "yellow"}
_TRUST = {"carried": "bold green", "with care": "bold yellow", "not carried": "bold red"}


_IN_ASCII = {"–": "-", "—": "-", "−": "-", "→": "->", "…": "...", "·": "*", "×": "x", "≤": "<=", "≥": ">=", "°": "deg"}
_IN_ASCII |= {
    "ß": "ss",
    "µ": "u",
    "μ": "u",
    "ζ": "zeta",
    "σ": "sigma",
    "±": "+-",
    "²": "^2",
    "³": "^3",
    "\N{BULLET}": "*",
}


def plain_streams() -> None:
    """Write what a terminal's or a pipe's encoding lacks in plain letters, and never as an exception."""
    codecs.register_error("plain", _in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")


def _in_ascii(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = error.object[error.start : error.end]
    parts = (_IN_ASCII.get(letter) or _letters(letter) for letter in found)
    return "".join(parts), error.end


def _letters(letter: str) -> str:
    """The letters of a sign without its accents; a line or block of a drawing is a dash, and anything else "?"."""
    if unicodedata.category(letter) == "So":
        return "-"
    return unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode() or "?"


class Screen(Console):
    """A terminal or a pipe; where its reader leaves, the work goes on, and the exit status says how it ended."""

    def on_broken_pipe(self) -> None:
        """Print no more."""
        self.quiet = True
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())


def plain(text: str, style: str = "") -> Text:
    """Text that a terminal shows as it is."""
    return Text(visible(text), style=style)


def show_result(
    console: Console,
    result: Identification,
    *,
    remarks: Sequence[str] = (),
    limits: Sequence[LimitOutcome] = (),
    quality: DataQuality | None = None,
) -> None:
    """Headline, how sure, what to do, mode table and doubts, limits of acceptance, warnings as far as there is room."""
    judgement = judgement_of(result, quality)
    in_table = (damping_sentence(result), doubtful_sentence(result))
    reasons = " ".join(reason for reason in judgement.reasons if reason not in in_table)
    head = [
        plain(modes_headline(result), "bold"),
        plain(f"{judgement.label}. ", _TRUST[judgement.trust]) + plain(reasons),
        plain("Next: ", "bold") + plain(" ".join(next_sentences(result, quality))),
    ]
    believed = [(number, mode) for number, mode in numbered(result.modes.modes) if mode.verdict != "noise"]
    below = _below_the_table(result, believed)
    for text in head:
        console.print(text)
    console.print()
    if believed:
        console.print(_mode_table(believed))
    for text in below:
        console.print(text)
    show_limits(console, limits)
    used = sum(len(text.wrap(console, console.width)) for text in (*head, *below))
    said = (*data_sentences(result), *remarks)
    most = Shown.MOST_LINES + max(0, len(believed) - Shown.MODES)
    fixed = Shown.FILES + 1 + bool(believed) + len(believed) + 2  # files, a blank, the table, a blank and a heading
    _in_room(console, result.warnings, said, most - fixed - used)


def _below_the_table(result: Identification, believed: Sequence[tuple[int, Mode]]) -> list[Text]:
    """What is said of modes besides their numbers: one sentence a doubt with the modes that it is of, masses, noise."""
    of_reason: dict[tuple[str, str], list[int]] = {}
    for number, mode in believed:
        if remark := _first_part(remark_of(mode)):
            of_reason.setdefault((remark, mode.verdict), []).append(number)
    lines = [
        plain(f"{ranges(numbers)}: ", "bright_black")
        + plain(f"{remark}.", "" if verdict == "system" else _COLOURS[verdict])
        for (remark, verdict), numbers in of_reason.items()
    ]
    weighed = [f"{number}: {mass_text(mode)}" for number, mode in believed if math.isfinite(mode.modal_mass)]
    if weighed:
        lines.append(plain("Modal mass [kg]: ", "bold") + plain(", ".join(weighed)))
    noise = [hertz(shown_frequency(mode)) for mode in result.modes if mode.verdict == "noise"]
    if noise:
        named = f"{', '.join(noise[: Shown.MOST_NOISE])} Hz"
        more = f", {len(noise) - Shown.MOST_NOISE} more" * (len(noise) > Shown.MOST_NOISE)
        poles = "one pole" if len(noise) == 1 else f"{len(noise)} poles"
        lines.append(plain(f"Taken for noise: {poles} ({named}{more}); see the report.", "bright_black"))
    return lines


def _in_room(console: Console, warnings: Sequence[str], remarks: Sequence[str], room: int) -> None:
    """Warnings and remarks whole where they fit, else the beginning of each, and the report has the rest.

    Each sentence gets as many lines as any other and one at least, so that none is lost for the length of another;
    remarks for which there is no line are counted.
    """
    kept = max(room - len(warnings), 1)
    many = len(remarks) > kept
    if many:
        remarks = [*remarks[: kept - 1], f"{len(remarks) - kept + 1} {'more ' * (kept > 1)}remarks"]
    items = [plain(f"- {sentence}") for sentence in (*warnings, *remarks)]
    lengths = [len(item.wrap(console, console.width)) for item in items]
    most = max(lengths, default=1)
    while most > 1 and sum(min(length, most) for length in lengths) > room:
        most -= 1
    cut = many or most < max(lengths, default=1)
    if items:
        heading = "Warnings and data" if warnings and remarks else "Warnings" if warnings else "Data"
        console.print()
        console.print(plain(heading, "bold yellow" if warnings else "bold") + plain(", whole in the report" * cut))
    for item in items:
        lines = item.wrap(console, console.width)
        whole = " ".join(line.plain.rstrip() for line in lines[:most])
        console.print(item if len(lines) <= most else plain(clipped(whole, len(whole))))


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
    text = f"{shorten(outcome.what, 80)}: wanted {outcome.required}; found {outcome.found}"
    return f"{text} ({outcome.reason})" if outcome.reason else text


def show_comparison(console: Console, comparison: Sequence[ModeComparison]) -> None:
    """True and found modes of the demo side by side."""
    table = Table(box=None, pad_edge=False, header_style="bright_black")
    for heading in ("true [Hz]", "found [Hz]", "off by", "true damping", "found", "MAC"):
        table.add_column(heading, justify="right")
    table.add_column("verdict")
    for row in comparison:
        table.add_row(
            hertz(row.frequency),
            hertz(row.found_frequency) if math.isfinite(row.found_frequency) else "–",
            number_text(100 * (row.found_frequency / row.frequency - 1), "{:+.3f} %"),
            f"{100 * row.damping_ratio:.2f} %",
            number_text(100 * row.found_damping_ratio, "{:.2f} %"),
            number_text(row.assurance, "{:.3f}"),
            plain(row.verdict or "not found", _COLOURS.get(row.verdict or "", "red")),
        )
    console.print()
    console.print(table)


def show_files(console: Console, files: ReportFiles, *, pdf: Path | None = None) -> None:
    """Where the report is, one line a file, so that it can be opened by a click or a copy."""
    others = (files.markdown, files.json, files.csv, files.uff55, files.result)
    show_paths(
        console,
        (files.html, "the report"),
        (pdf, "the same on paper"),
        (files.recording, f"to look at: modal-report view {shlex.quote(str(files.recording.parent))}"),
        (files.recording.parent, f"also {', '.join(path.name for path in others)}"),
    )


def show_paths(console: Console, *meanings: tuple[Path | None, str]) -> None:
    """A line for each file that there is, with what it is for."""
    console.print()
    for path, meaning in meanings:
        if path is not None:
            console.print(plain(str(path)) + plain(f"  {meaning}", "bright_black"), soft_wrap=True)


def _mode_table(shown: Sequence[tuple[int, Mode]]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    table.add_column("", justify="right", no_wrap=True)
    table.add_column("Hz", justify="right", no_wrap=True)
    table.add_column("damping", justify="right", no_wrap=True)
    table.add_column("reappears", justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for number, mode in shown:
        colour = _COLOURS[mode.verdict]
        table.add_row(
            plain(str(number), "bright_black"),
            plain(frequency_text(mode), f"bold {colour}" if mode.verdict == "system" else colour),
            plain(damping_text(mode), colour),
            plain(number_text(mode.repeatability, "{:.2f}"), colour),
            plain(mode.verdict, colour),
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
    """The reason without its numbers, which the report has, and without what the column of damping says."""
    first = re.split(r" \(|; ", reason, maxsplit=1)[0]
    return "" if first.startswith("damping not resolved") else first


def number_text(value: float, form: str) -> str:
    """The value in this form, a dash where it is none."""
    return form.format(value) if math.isfinite(value) else "–"


@contextlib.contextmanager
def live_view(*, wanted: bool, tell: Callable[[str], None]) -> Iterator[Any]:
    """The stream to a viewer for the time of the work; None where none was asked for, or can be had."""
    with live_recording(tell=tell) if wanted else contextlib.nullcontext() as recording:
        yield recording


Progress = Callable[[str, float], None]
"""Called with what is being done and the share of all work that is behind."""


@contextlib.contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on stderr that is gone when the work is done; nothing where stderr is not a terminal.

    Each step that it is told of is a place to stop at: there a KeyboardInterrupt answers a request.
    """
    console = Screen(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), _TimeLeft())
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=1.0)

        def tell(what: str, share: float) -> None:
            Requests.check()
            bar.update(task, description=what, completed=max(share, bar.tasks[0].completed))

        yield tell


def say_beforehand(n_samples: int, n_channels: int, seconds: tuple[float, float], n_bytes: float) -> None:
    """One line on stderr, with or without a terminal, of what a long piece of work will take; nothing of a short one.

    Args:
        n_samples: of all records.
        n_channels: of each.
        seconds: CPU seconds, least and most.
        n_bytes: of memory, most.
    """
    least, most = (math.ceil(bound / 60.0) for bound in seconds)
    if seconds[1] < Shown.LONG:
        return
    time = f"{least} to {most}" if 1 < least < most else f"up to {most}" if least < most else f"{most}"
    memory = f"{n_bytes / 2**30:.1f} GiB of memory"
    text = f"{n_samples} samples of {n_channels} channels: expect {time} min of one processor and up to {memory}."
    Screen(stderr=True, highlight=False).print(plain(text), soft_wrap=True)


def time_left_text(share: float, elapsed: float) -> str:
    """How long the rest will take if it goes on as it went, roughly; "" while that would be a guess.

    Args:
        share: of all work that is behind.
        elapsed: [s] since the start.

    Example:
        >>> time_left_text(0.25, 20.0), time_left_text(0.5, 200.0), time_left_text(0.01, 9.0)
        ('about 60 s left', 'about 3 min left', '')
    """
    if not (Shown.LEAST_SHARE <= share < 1.0 and elapsed >= Shown.LEAST_SECONDS):
        return ""
    left = elapsed * (1.0 - share) / share
    if left < 90:
        step = 1 if left < 10 else 5
        return f"about {max(1, step * math.ceil(left / step))} s left"
    if left < 5400:
        return f"about {round(left / 60)} min left"
    return f"about {left / 3600:.1f} h left"


class _TimeLeft(ProgressColumn):
    """What `time_left_text` says of a task."""

    def render(self, task: Task) -> Text:
        return Text(time_left_text(task.completed / (task.total or 1.0), task.elapsed or 0.0), style="bright_black")
