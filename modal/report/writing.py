"""All files of a report or none: they are made in a folder of their own beside the target and moved when complete."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

from modal.identification import Identification
from modal.names import shorten
from modal.report.machine import csv_text, json_text
from modal.report.pages import html_text, markdown_text
from modal.report.pictures import draw_pictures
from modal.report.provenance import Provenance
from okid.arguments import require
from okid.errors import InvalidDataError

__all__ = ["ReportFiles", "refuse_existing", "write_report"]

LONGEST_PATH = 200
"""Letters of a path in a sentence."""

Existing = Literal["refuse", "replace"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReportFiles:
    """Where the files of a report are.

    Attributes:
        html: self-contained page.
        markdown: the same words and tables.
        json: every number but the time histories.
        csv: one row a mode.
        recording: Rerun recording (.rrd).
    """

    html: Path
    markdown: Path
    json: Path
    csv: Path
    recording: Path

    def __iter__(self) -> Iterator[Path]:
        return (getattr(self, field.name) for field in fields(self))

    @classmethod
    def in_folder(cls, folder: Path) -> "ReportFiles":
        """The names that a report has in a folder."""
        return cls(
            html=folder / "report.html",
            markdown=folder / "report.md",
            json=folder / "report.json",
            csv=folder / "modes.csv",
            recording=folder / "recording.rrd",
        )


def write_report(
    result: Identification,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
) -> ReportFiles:
    """Write HTML, Markdown, JSON, CSV and the Rerun recording of a result into a folder, all of them or none.

    Nothing in the files depends on when or where they were written: the same result gives the same bytes.

    Args:
        result: of `modal.identify`.
        folder: made if it does not exist.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.
        provenance: command and sources, for the part on how to make the result again.

    Returns:
        The paths.

    Raises:
        InvalidDataError: a file of the report exists already, or the folder cannot be written.
    """
    require(result, Identification, where="write_report", made_by="modal.identify")
    target = Path(folder)
    refuse_existing(target, existing)
    provenance = provenance or Provenance()
    made = _make_parents(target)
    temporary: Path | None = None
    try:
        temporary = Path(tempfile.mkdtemp(prefix=".modal-report-", dir=target.parent))
        _write_all(result, ReportFiles.in_folder(temporary), provenance)
        _move(temporary, target)
    except BaseException as error:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        for parent in made:
            with contextlib.suppress(OSError):
                parent.rmdir()
        if isinstance(error, OSError):
            raise _cannot_write(target, error) from error
        raise
    return ReportFiles.in_folder(target)


def refuse_existing(folder: Path, existing: Existing) -> None:
    """Raise before any work is done when the report could not be written.

    Raises:
        InvalidDataError: as in `write_report`.
    """
    try:
        nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        there = [path.name for path in ReportFiles.in_folder(folder) if path.exists()]
    except OSError as error:  # a name that is too long, a folder that may not be looked into
        raise _cannot_write(folder, error) from error
    if not nearest.is_dir():
        raise InvalidDataError(
            f"{_named(folder)} cannot be a folder, because {str(nearest)!r} is a file; choose another folder for the "
            "report."
        )
    if there and existing == "refuse":
        raise InvalidDataError(
            f"{_named(folder)} already holds {', '.join(there)}; choose another folder, or replace them (--overwrite, "
            'in Python existing="replace").'
        )
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InvalidDataError(
            f"{_named(folder)} cannot be written (no right to write in {str(nearest)!r}); choose another folder for "
            "the report."
        )


def _named(folder: Path) -> str:
    return repr(shorten(str(folder), LONGEST_PATH))


def _write_all(result: Identification, files: ReportFiles, provenance: Provenance) -> None:
    from modal.recording import save_recording

    pages = {
        files.html: html_text(result, provenance, draw_pictures(result)),
        files.markdown: markdown_text(result, provenance),
        files.json: json_text(result, provenance),
        files.csv: csv_text(result),
    }
    for path, text in pages.items():
        path.write_bytes(text.encode("utf-8"))
    save_recording(result, files.recording)


def _make_parents(target: Path) -> list[Path]:
    """Make the folders above the target; return those made, the innermost first."""
    missing = [parent for parent in target.absolute().parents if not parent.exists()]
    try:
        target.absolute().parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_write(target, error) from error
    return missing


def _move(temporary: Path, target: Path) -> None:
    """One rename for a new folder; file by file, each at once, into one that exists."""
    if not target.exists():
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o777 & ~mask)
        temporary.rename(target)
        return
    for path in sorted(temporary.iterdir()):
        path.replace(target / path.name)
    temporary.rmdir()


def _cannot_write(target: Path, error: OSError) -> InvalidDataError:
    return InvalidDataError(
        f"{_named(target)} cannot be written ({error.strerror or error}); choose another folder for the report."
    )
