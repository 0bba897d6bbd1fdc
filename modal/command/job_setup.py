"""What a run of the command needs besides the records, and what would stop it: looked at before the work begins."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from modal.acceptance.test_file import read_specification
from modal.geometry.file import read_geometry
from modal.report.folder import refuse_names
from modal.report.pdf import NoBrowserError, find_browser
from modal.report.writing import refuse_existing
from modal.wording.names import shorten, visible
from okid.errors import InvalidDataError
from okid.record import Record

if TYPE_CHECKING:
    from modal.acceptance.test_file import Specification
    from modal.command.job import Job
    from modal.geometry.sensors import Geometry
    from modal.report import ReportFiles

__all__ = ["clear_stale", "prepare", "refuse_other_report", "refuse_pdf", "refuse_sources", "unknown_sensors"]


def prepare(job: "Job") -> "tuple[Specification | None, Geometry | None]":
    """What the test file says and the geometry, once all is refused that can be before the work begins.

    Args:
        job: what to do.

    Raises:
        InvalidDataError: a report that could not be written, or a test file or geometry that is none.
        NoBrowserError: a PDF was asked for, and nothing prints it.
    """
    refuse_existing(job.folder, job.existing)
    if job.pdf is not None:
        refuse_pdf(job.pdf, job.existing)
    specification = None
    if job.test is not None:
        specification = read_specification(job.test)
    if job.geometry is not None:
        return specification, read_geometry(job.geometry)
    return specification, None if specification is None else specification.geometry


def refuse_pdf(pdf: Path, existing: Literal["refuse", "replace"]) -> None:
    """Raise before any work is done when a report could not be printed.

    Args:
        pdf: file that would be written.
        existing: "refuse" to touch one that is there, or "replace" it.

    Raises:
        InvalidDataError: the file exists already, or its folder cannot be written.
        NoBrowserError: there is no browser that prints.
    """
    refuse_names(pdf.parent, [pdf.name], existing)
    if find_browser() is None:
        raise NoBrowserError(
            "--pdf prints with Chromium, Chrome or Edge, and none is installed here; leave it out and print "
            "report.html by hand."
        )


def refuse_sources(written: Iterable[Path], sources: Iterable[Path]) -> None:
    """Raise where a file that would be written is one that is read: replacing it would lose what was measured.

    Args:
        written: files that would be written.
        sources: files that are read.

    Raises:
        InvalidDataError: the first such file.

    Example:
        >>> refuse_sources([Path("report/report.html")], [Path("test.csv")])
    """
    targets = list(written)
    for source in sources:
        for target in targets:
            if target.exists() and source.exists() and target.samefile(source):
                raise InvalidDataError(
                    f"{shorten(visible(str(target)), 200)!r} would replace a file that is read; choose another place."
                )


def refuse_other_report(folder: Path, mark: str) -> None:
    """Raise where a folder holds a report of the other kind: replaced in part, it would be two reports in one.

    Args:
        folder: for the report.
        mark: name of a file that only the other kind of report has.

    Raises:
        InvalidDataError: it is there, beside a report.json.
    """
    if (folder / mark).is_file() and (folder / "report.json").is_file():
        raise InvalidDataError(
            f"{shorten(visible(str(folder)), 200)!r} holds a report of another kind ({mark}); choose another folder."
        )


def clear_stale(job: "Job", files: "ReportFiles") -> None:
    """Take away what an earlier, replaced report left and this one does not have: it would pass for part of this one.

    A printed report goes in any case: stopped while it prints the new one, the old one must not stand beside the rest.

    Args:
        job: with the folder, and whether its files may be replaced.
        files: that were written.
    """
    if job.existing == "replace":
        (job.folder / "report.pdf").unlink(missing_ok=True)
        if files.result is None:
            (job.folder / "result.npz").unlink(missing_ok=True)


def unknown_sensors(specification: "Specification | None", records: Sequence[Record]) -> tuple[str, ...]:
    """A sentence on sensors whose channel no record has: a misspelt name would otherwise be lost in silence."""
    if specification is None:
        return ()
    known = {name for record in records for name in (*record.input_names, *record.output_names)}
    missing = [shorten(visible(note.channel), 60) for note in specification.sensors if note.channel not in known]
    if not missing:
        return ()
    named = ", ".join(map(repr, missing[:5])) + " and more" * (len(missing) > 5)
    return (f"the test file describes {named}, which the records as read do not have; check its channel names.",)
