"""`modal-report diff`: what changed between two results; one row a mode, what is lost or new, what else differs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from modal.command.options import Overwrite, Traceback, examples, faults, folder_path
from modal.command.terminal import Screen, listing, plain, show_paths
from modal.comparison import words
from modal.comparison.changes import Comparison, Difference, ModePair, compare_results
from modal.comparison.shifts import Shift, read_result
from modal.report.comparison import ComparisonFiles, write_comparison
from modal.report.folder import refuse_names
from modal.wording.text import hertz
from okid.readers.guard import Existing

_ORDER = ("beyond chance", "perhaps chance", "within its interval", "not known")
_COLOURS = {
    "beyond chance": "bold red",
    "perhaps chance": "yellow",
    "within its interval": "green",
    "not known": "bright_black",
}


def show_difference(console: Console, comparison: Comparison) -> None:
    """All of a comparison that a terminal has room for."""
    before, after = comparison.before.name, comparison.after.name
    console.print()
    console.print(plain(f"{before} → {after}", "bright_black"))
    console.print(plain(words.comparison_headline(comparison), "bold"))
    if comparison.pairs:
        console.print()
        console.print(_table(comparison.pairs))
    lost = [words.unmatched_sentence(one, present=before, absent=after) for one in comparison.lost]
    new = [words.unmatched_sentence(one, present=after, absent=before) for one in comparison.new]
    listing(console, "Lost", lost, "yellow")
    listing(console, "New", new, "yellow")
    listing(console, "Differs as well", [_difference(one) for one in comparison.differences], "")
    listing(console, "Read with care", words.caution_sentences(comparison), "yellow")
    console.print()
    console.print(plain(words.how_sentence(comparison), "bright_black"))


def _table(pairs: Sequence[ModePair]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    for heading in ("", "Hz before", "after", "frequency", "damping ratio", "MAC"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("")
    for pair in pairs:
        worst = min(pair.shifts, key=lambda shift: _ORDER.index(shift.verdict))
        table.add_row(
            plain(str(pair.number_before), "bright_black"),
            plain(hertz(pair.before.frequency)),
            plain(hertz(pair.after.frequency)),
            plain(words.percent_text(pair.frequency), _COLOURS[pair.frequency.verdict]),
            plain(words.percent_text(pair.damping), _COLOURS[pair.damping.verdict]),
            plain(words.assurance_text(pair.shape), _COLOURS[pair.shape.verdict]),
            plain(_meaning(pair, worst), _COLOURS[worst.verdict]),
        )
    return table


def _meaning(pair: ModePair, worst: Shift) -> str:
    """What stands out most of a mode; where nothing does, that."""
    if worst.verdict in ("within its interval", "not known"):
        return words.verdict_change(pair) or ("no change" if worst.verdict != "not known" else "not known")
    same = [shift.what for shift in pair.shifts if shift.verdict == worst.verdict]
    parts = (f"{' and '.join(same)} {worst.verdict}", words.verdict_change(pair))
    return "; ".join(part for part in parts if part)


def _difference(one: Difference) -> str:
    return f"{one.what}: {one.before or 'not there'} → {one.after or 'not there'}"


EXAMPLES = examples(
    "two results: diff before after",
    "with a page to keep: diff before after -o change",
    "saved results: diff monday.npz tuesday.npz",
)

_RESULT = "Folder that run wrote, or a saved result (.npz)."


def diff(
    before: Annotated[Path, typer.Argument(metavar="A", help=_RESULT)],
    after: Annotated[Path, typer.Argument(metavar="B", help="The same of the second result.")],
    *,
    folder: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FOLDER",
            parser=folder_path,
            help="Write the comparison as HTML, Markdown and JSON too.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    traceback: Traceback = False,
) -> None:
    """Say what changed from result A to result B: modes matched, shifts against their intervals, modes lost and new.

    Exit status: 0 compared, whatever was found; 1 compared, but a result
    has no mode of the system or is not reliable; 2 wrong use or
    unreadable input.
    """
    with faults(show=traceback):
        existing: Existing = "replace" if overwrite else "refuse"
        if folder is not None:
            refuse_names(folder, ComparisonFiles.in_folder(folder).names, existing)
        comparison = compare_results(read_result(before), read_result(after))
        files = None if folder is None else write_comparison(comparison, folder, existing=existing)
        console = Screen(highlight=False)
        show_difference(console, comparison)
        if files is not None:
            pages = ((files.html, "to read"), (files.markdown, "the same as Markdown"), (files.json, "every number"))
            show_paths(console, *pages)
        sides = (comparison.before, comparison.after)
        carried = all(
            side.trust != "not carried" and any(mode.verdict == "system" for mode in side.modes) for side in sides
        )
        raise typer.Exit(0 if carried else 1)
