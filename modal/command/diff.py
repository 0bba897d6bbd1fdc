"""`modal-report diff`: what changed between two results."""

from pathlib import Path
from typing import Annotated

import typer

from modal.command.diff_job import DiffJob, carry_out_diff
from modal.command.options import Overwrite, Traceback, examples, faults

__all__ = ["EXAMPLES", "diff"]

EXAMPLES = examples(
    "two results: diff before after",
    "with a page to keep: diff before after -o change",
    "saved results or JSON: diff monday.npz tuesday/report.json",
)

_RESULT = "Folder that run wrote, its report.json, or a saved result (.npz)."


def diff(
    before: Annotated[Path, typer.Argument(metavar="A", help=_RESULT)],
    after: Annotated[Path, typer.Argument(metavar="B", help="The same of the second result.")],
    *,
    folder: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FOLDER", help="Write the comparison as HTML, Markdown and JSON too."),
    ] = None,
    overwrite: Overwrite = False,
    traceback: Traceback = False,
) -> None:
    """Say what changed from result A to result B: modes matched, shifts against their intervals, modes lost and new.

    Exit status: 0 compared, whatever was found; 1 compared, but a result
    has no mode of the system or its data do not carry it; 2 wrong use or
    unreadable input.
    """
    with faults(show=traceback):
        job = DiffJob(before=before, after=after, folder=folder, existing="replace" if overwrite else "refuse")
        comparison = carry_out_diff(job)
        sides = (comparison.before, comparison.after)
        carried = all(
            side.trust != "not carried" and any(mode.verdict == "system" for mode in side.modes) for side in sides
        )
        raise typer.Exit(0 if carried else 1)
