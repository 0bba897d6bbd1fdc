"""One run of `modal-report diff`: read two results, compare them, write what was asked for, then print it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console

from modal.command.terminal_comparison import show_comparison_files, show_difference
from modal.comparison.changes import Comparison, compare_results
from modal.comparison.source import read_result
from modal.report.comparison import refuse_existing_comparison, write_comparison

__all__ = ["DiffJob", "carry_out_diff"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DiffJob:
    """What to compare.

    Attributes:
        before: folder or file of the first result.
        after: of the second.
        folder: for the pages; None: print only.
        existing: "refuse" to touch pages that are there, or "replace" them.
    """

    before: Path
    after: Path
    folder: Path | None
    existing: Literal["refuse", "replace"]


def carry_out_diff(job: DiffJob) -> Comparison:
    """Read, compare, write, print.

    Raises:
        UnreadableFileError: one of the two is no result.
        InvalidDataError: the folder cannot be written.
    """
    if job.folder is not None:
        refuse_existing_comparison(job.folder, job.existing)
    comparison = compare_results(read_result(job.before), read_result(job.after))
    files = None if job.folder is None else write_comparison(comparison, job.folder, existing=job.existing)
    console = Console(highlight=False)
    show_difference(console, comparison)
    if files is not None:
        show_comparison_files(console, files)
    return comparison
