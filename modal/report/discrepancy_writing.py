"""The files of a diagnosis, all of them or none; for programs JSON with every number, CSV with one row a parameter."""

import csv
import io
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

from modal import recording
from modal.discrepancy.results import Diagnosis, Finding, in_words
from modal.report.discrepancy_pages import diagnosis_html, diagnosis_markdown, draw_diagnosis
from modal.report.folder import Existing, refuse_names, write_folder
from modal.report.machine import as_json, number_cell, record_document
from modal.sections.discrepancy_stages import rows_of, stages_of
from modal.sections.discrepancy_values import hypothesis_text, times_floor
from modal.sections.discrepancy_words import diagnosis_headline, judge_diagnosis, next_steps, where_sentences
from modal.sections.provenance import Provenance, installed_version
from modal.structure.plant_model import PlantModel
from modal.structure.structural_model import StructuralModel
from modal.wording.text import NINETY_FIVE, csv_cell

DIAGNOSIS_SCHEMA = "modal-report-discrepancy/1"
"""Name and version of the layout; the number rises when a reader of the old layout would go wrong."""

HEADER = (
    *("finding", "effect", "where", "parameter", "value", "std", "unit", "low_95", "high_95", "meaning", "law"),
    *("status", "closed", "log_likelihood", "margin", "runner_up", "runner_up_times_floor", "ambiguous_with"),
)


def diagnosis_json(diagnosis: Diagnosis, provenance: Provenance) -> str:
    """The whole diagnosis but its time histories, as JSON; a number that is not known is null."""
    told = in_words(diagnosis)
    judgement = judge_diagnosis(told)
    stages = stages_of(diagnosis)
    document = {
        "schema": DIAGNOSIS_SCHEMA,
        "version": installed_version(),
        "command": provenance.command,
        "sources": provenance.sources,
        "remarks": provenance.remarks,
        "status": diagnosis.status,
        "verdict": diagnosis_headline(told),
        "trust": judgement.trust,
        "words": judgement.reasons,
        "next": next_steps(told),
        "where": where_sentences(diagnosis),
        "warnings": told.warnings,
        "findings": diagnosis.findings,
        "gap_before": diagnosis.gap_before,
        "gap_after": diagnosis.gap_after,
        "closed": diagnosis.closed,
        "times_floor": {
            "stages": [stage.name for stage in stages],
            "parts": rows_of(stages),
        },
        "steps": [
            {"name": step.name, "fit_level": step.fit_level, "held_out_level": step.held_out_level}
            for step in diagnosis.steps
        ],
        "hypotheses": diagnosis.hypotheses,
        "laws": diagnosis.laws,
        "calibrated": diagnosis.calibrated,
        "bounds_hit": diagnosis.bounds_hit,
        "detection_limits": diagnosis.detection_limits,
        "noise_floor": diagnosis.noise_floor,
        "location": diagnosis.location,
        "fit": [record_document(record) for record in diagnosis.fit],
        "held_out": [record_document(record) for record in diagnosis.held_out],
    }
    return json.dumps(as_json(document), allow_nan=False, indent=1) + "\n"


def diagnosis_csv(diagnosis: Diagnosis) -> str:
    """One row a parameter of each finding, and the header alone where nothing was found."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(HEADER)
    for number, finding in enumerate(diagnosis.findings, start=1):
        writer.writerows(_rows(number, finding, diagnosis.status))
    return file.getvalue()


def _rows(number: int, finding: Finding, status: str) -> list[list[object]]:
    evidence, other = finding.evidence, finding.runner_up
    common = [
        csv_cell(finding.law),
        status,
        *(number_cell(value) for value in (evidence.closed, evidence.log_likelihood, evidence.margin)),
        csv_cell(hypothesis_text(other)) if other else "",
        number_cell(times_floor(other.held_out_level)) if other else "",
        csv_cell(", ".join(finding.ambiguous_with)),
    ]
    rows: list[list[object]] = []
    for one in finding.parameters:
        ends = (one.value - NINETY_FIVE * one.std, one.value + NINETY_FIVE * one.std)
        row = [number, csv_cell(finding.effect), csv_cell(finding.where), csv_cell(one.name)]
        row += [number_cell(one.value), number_cell(one.std), csv_cell(one.unit)]
        row += [*(number_cell(end) for end in ends), csv_cell(one.meaning), *common]
        rows.append(row)
    return rows or [[number, csv_cell(finding.effect), csv_cell(finding.where), *[""] * 7, *common]]


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
        gone=("report.pdf",),
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
    told = in_words(diagnosis)
    pages = {
        files.html: diagnosis_html(told, provenance, draw_diagnosis(told), model_file=model),
        files.markdown: diagnosis_markdown(told, provenance),
        files.json: diagnosis_json(diagnosis, provenance),
        files.csv: diagnosis_csv(diagnosis),
    }
    for path, text in pages.items():
        path.write_bytes(text.encode("utf-8"))
    recording.save_recording(diagnosis, files.recording)
    if files.model:
        diagnosis.model.save(files.model)
