"""The files of a diagnosis: where they are, and writing all of them or none."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

from modal import recording
from modal.discrepancy.results import Diagnosis
from modal.report.discrepancy_machine import diagnosis_csv, diagnosis_json
from modal.report.discrepancy_pages import diagnosis_html, diagnosis_markdown
from modal.report.discrepancy_pictures import draw_diagnosis
from modal.report.folder import Existing, recording_written, refuse_names, write_folder
from modal.sections.provenance import Provenance
from modal.structure.plant_model import PlantModel
from modal.structure.structural_model import StructuralModel

__all__ = ["DiagnosisFiles", "refuse_existing_diagnosis", "write_diagnosis"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DiagnosisFiles:
    """Where the files of a report on a diagnosis are.

    Attributes:
        html: self-contained page.
        markdown: the same words and tables.
        json: every number but the time histories.
        csv: one row a parameter of each effect found.
        recording: Rerun recording (.rrd).
        model: the updated model, to go on with; None where a file cannot hold it (a model that is a function).
    """

    html: Path
    markdown: Path
    json: Path
    csv: Path
    recording: Path
    model: Path | None

    def __iter__(self) -> Iterator[Path]:
        return (path for field in fields(self) if (path := getattr(self, field.name)) is not None)

    @classmethod
    def in_folder(cls, folder: Path, *, model: str | None = "model.json") -> "DiagnosisFiles":
        """The names that a report has in a folder."""
        return cls(
            html=folder / "report.html",
            markdown=folder / "report.md",
            json=folder / "report.json",
            csv=folder / "findings.csv",
            recording=folder / "recording.rrd",
            model=folder / model if model else None,
        )


def write_diagnosis(
    diagnosis: Diagnosis,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
) -> DiagnosisFiles:
    """Write HTML, Markdown, JSON, CSV, the Rerun recording and the updated model, all of them or none.

    Args:
        diagnosis: of `modal.discrepancy.diagnose`.
        folder: made if it does not exist.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.
        provenance: command and sources, for the part on how to make the result again.

    Returns:
        The paths.

    Raises:
        InvalidDataError: a file of the report exists already, or the folder cannot be written.
    """
    target, source = Path(folder), provenance or Provenance()
    model = model_name(diagnosis)
    names = [path.name for path in DiagnosisFiles.in_folder(target)]
    write_folder(
        target,
        names,
        lambda made: _write_all(diagnosis, DiagnosisFiles.in_folder(made, model=model), source),
        existing=existing,
    )
    return DiagnosisFiles.in_folder(target, model=model)


def refuse_existing_diagnosis(folder: Path, existing: Existing) -> None:
    """Raise before any work is done when the report of a diagnosis could not be written.

    Raises:
        InvalidDataError: as in `write_diagnosis`.
    """
    refuse_names(folder, [path.name for path in DiagnosisFiles.in_folder(folder)], existing)


def model_name(diagnosis: Diagnosis) -> str | None:
    """The name of the file of the updated model, None where its type has none."""
    return "model.json" if isinstance(diagnosis.model, StructuralModel | PlantModel) else None


def _write_all(diagnosis: Diagnosis, files: DiagnosisFiles, provenance: Provenance) -> None:
    model = files.model.name if files.model else ""
    pages = {
        files.html: diagnosis_html(diagnosis, provenance, draw_diagnosis(diagnosis), model_file=model),
        files.markdown: diagnosis_markdown(diagnosis, provenance),
        files.json: diagnosis_json(diagnosis, provenance),
        files.csv: diagnosis_csv(diagnosis),
    }
    for path, text in pages.items():
        path.write_bytes(text.encode("utf-8"))
    with recording_written(files.recording):
        recording.save_recording(diagnosis, files.recording)
    if files.model:
        diagnosis.model.save(files.model)
