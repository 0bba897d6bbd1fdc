"""The files of a report, all of them or none, with the result itself beside them to be loaded and compared again."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, overload

from modal import recording
from modal.comparison.shifts import PART, summary_of
from modal.discrepancy.results import Diagnosis
from modal.identification.result import Identification, write_parts
from modal.report.discrepancy_writing import DiagnosisFiles, write_diagnosis
from modal.report.folder import Existing, refuse_names, write_folder
from modal.report.machine import csv_text, json_text, schema_text
from modal.report.pages import html_text, markdown_text
from modal.report.pictures import Setting, draw_pictures, setting_of
from modal.report.uff55 import uff55_text
from modal.sections.provenance import Provenance
from okid.arrays import require
from okid.errors import InvalidDataError

if TYPE_CHECKING:
    from modal.acceptance.test_file import Specification
    from modal.geometry.sensors import Geometry
    from modal.quality import DataQuality

LARGEST_KEPT = 1 << 27
"""Keep the result whole up to so many bytes of arrays: 128 MiB, a record of 8 channels and 700 000 samples with its two
simulations. Above, its file holds the summary that a comparison needs; the rest can be made again from the records."""


def keep_result(result: Identification, path: Path, *, files: Sequence[str] = ()) -> Path:
    """Write the summary for a comparison, and with it the result unless it would be larger than `LARGEST_KEPT`.

    Args:
        result: of `modal.identify`.
        path: of a file that is not there.
        files: SHA-256 of each measured file.

    Raises:
        InvalidDataError: the file exists or cannot be written.
    """
    return write_parts({PART: summary_of(result, files=files), "result": result}, path, most=LARGEST_KEPT)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReportFiles:
    """Where the files of a report on an identification are.

    Attributes:
        html: self-contained page.
        markdown: the same words and tables.
        json: the numbers, without time histories and the largest arrays.
        schema: JSON schema of that file.
        csv: one row a mode.
        uff55: modes of the system as universal file datasets 55, for other tools.
        result: the result itself, for `modal.load` and `modal-report diff`; where it would be very large, the summary.
        recording: Rerun recording (.rrd).
    """

    html: Path
    markdown: Path
    json: Path
    schema: Path
    csv: Path
    uff55: Path
    result: Path
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
            schema=folder / "report.schema.json",
            csv=folder / "modes.csv",
            uff55=folder / "modes.uff",
            result=folder / "result.npz",
            recording=folder / "recording.rrd",
        )


@overload
def write_report(
    result: Identification,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
    geometry: "Geometry | None" = None,
    specification: "Specification | None" = None,
    quality: "DataQuality | None" = None,
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
    geometry: "Geometry | None" = None,
    specification: "Specification | None" = None,
    quality: "DataQuality | None" = None,
) -> ReportFiles | DiagnosisFiles:
    """Write HTML, Markdown, JSON, CSV, UFF 55 and the Rerun recording of a result into a folder, all of them or none.

    Of a diagnosis the updated model is written too, so that one can go on with it. Nothing in the files depends on when
    or where they were written: the same result gives the same bytes.

    Args:
        result: of `modal.identify`, or of `modal.discrepancy.diagnose`.
        folder: made if it does not exist.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.
        provenance: command and sources, for the part on how to make the result again.
        geometry: of the structure, for the shapes of an identification; that of the specification unless given.
        specification: what the test file says: article, sensors, limits of acceptance.
        quality: of the records as they were read (`modal.quality.check_quality`); the records as used are looked at
            unless given.

    Returns:
        The paths.

    Raises:
        InvalidDataError: a file of the report exists already, the folder cannot be written, the geometry has no place
            for any output, or a geometry, a specification or a quality was given with a diagnosis.
    """
    if isinstance(result, Diagnosis):
        if geometry is not None or specification is not None or quality is not None:
            raise InvalidDataError(
                "a report on a diagnosis has no part for a geometry, a specification or the quality of the data; leave "
                "them out."
            )
        return write_diagnosis(result, folder, existing=existing, provenance=provenance)
    require(result, Identification, where="write_report", made_by="modal.identify")
    target, source = Path(folder), provenance or Provenance()
    files = ReportFiles.in_folder(target)
    refuse_names(target, [path.name for path in files], existing)
    setting = setting_of(result, geometry=geometry, specification=specification, quality=quality)
    write_folder(
        target,
        [path.name for path in files],
        lambda made: _write_all(result, ReportFiles.in_folder(made), source, setting),
        existing=existing,
        gone=("report.pdf",),
    )
    return files


def refuse_existing(folder: Path, existing: Existing) -> None:
    """Raise before any work is done when the report of an identification could not be written.

    Raises:
        InvalidDataError: as in `write_report`.
    """
    refuse_names(folder, [path.name for path in ReportFiles.in_folder(folder)], existing)


def _write_all(result: Identification, files: ReportFiles, provenance: Provenance, setting: Setting) -> None:
    measured = [file.sha256 for file in provenance.files if file.name in provenance.sources]
    keep_result(result, files.result, files=measured)
    beside = _beside(files)
    pages = {
        files.html: html_text(result, provenance, draw_pictures(result, setting), setting, beside=beside),
        files.markdown: markdown_text(result, provenance, setting, beside=beside),
        files.json: json_text(result, provenance, specification=setting.specification),
        files.schema: schema_text(),
        files.csv: csv_text(result),
        files.uff55: uff55_text(result, setting.geometry),
    }
    for path, text in pages.items():
        path.write_bytes(text.encode("utf-8"))
    recording.save_recording(result, files.recording, geometry=setting.geometry, quality=setting.quality)


def _beside(files: ReportFiles) -> str:
    """The other files of the report, for the last words of the page."""
    return (
        f"{files.markdown.name} (the same words), {files.json.name} (the numbers; {files.schema.name} says how it is "
        f"laid out), {files.csv.name} (one row a pole), {files.uff55.name} (the modes for other tools), "
        f"{files.result.name} (the result itself, or its summary where it is above {LARGEST_KEPT >> 20} MiB, for "
        f"modal.load and modal-report diff), and {files.recording.name} (modal-report view with this folder opens it)"
    )
