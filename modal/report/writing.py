"""The files of a report: where they are, and writing all of them or none."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import overload

from modal.discrepancy.diagnosis import Diagnosis
from modal.identification import Identification
from modal.report.discrepancy_writing import DiagnosisFiles, write_diagnosis
from modal.report.folder import Existing, refuse_names, write_folder
from modal.report.machine import csv_text, json_text
from modal.report.pages import html_text, markdown_text
from modal.report.pictures import draw_pictures
from modal.report.provenance import Provenance
from okid.arguments import require

__all__ = ["DiagnosisFiles", "ReportFiles", "refuse_existing", "write_report"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReportFiles:
    """Where the files of a report on an identification are.

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


@overload
def write_report(
    result: Identification,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
) -> ReportFiles: ...


@overload
def write_report(
    result: Diagnosis,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
) -> DiagnosisFiles: ...


def write_report(
    result: Identification | Diagnosis,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
) -> ReportFiles | DiagnosisFiles:
    """Write HTML, Markdown, JSON, CSV and the Rerun recording of a result into a folder, all of them or none.

    Of a diagnosis the updated model is written too, so that one can go on with it. Nothing in the files depends on when
    or where they were written: the same result gives the same bytes.

    Args:
        result: of `modal.identify`, or of `modal.discrepancy.diagnose`.
        folder: made if it does not exist.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.
        provenance: command and sources, for the part on how to make the result again.

    Returns:
        The paths.

    Raises:
        InvalidDataError: a file of the report exists already, or the folder cannot be written.
    """
    if isinstance(result, Diagnosis):
        return write_diagnosis(result, folder, existing=existing, provenance=provenance)
    require(result, Identification, where="write_report", made_by="modal.identify")
    target, source = Path(folder), provenance or Provenance()
    names = [path.name for path in ReportFiles.in_folder(target)]
    write_folder(target, names, lambda made: _write_all(result, ReportFiles.in_folder(made), source), existing=existing)
    return ReportFiles.in_folder(target)


def refuse_existing(folder: Path, existing: Existing) -> None:
    """Raise before any work is done when the report of an identification could not be written.

    Raises:
        InvalidDataError: as in `write_report`.
    """
    refuse_names(folder, [path.name for path in ReportFiles.in_folder(folder)], existing)


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
