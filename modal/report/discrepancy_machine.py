"""A diagnosis for programs: JSON with every number, CSV with one row a parameter found."""

import csv
import io
import json

from modal.discrepancy.results import Diagnosis, Finding
from modal.report.machine import as_json, number_cell, record_document
from modal.sections.discrepancy_stages import rows_of, stages_of
from modal.sections.discrepancy_values import effects_text, times_floor
from modal.sections.discrepancy_words import diagnosis_headline, judge_diagnosis, next_sentences, where_sentences
from modal.sections.provenance import Provenance, installed_version
from modal.wording.names import csv_cell

__all__ = ["DIAGNOSIS_SCHEMA", "diagnosis_csv", "diagnosis_json"]

DIAGNOSIS_SCHEMA = "modal-report-discrepancy/1"
"""Name and version of the layout; the number rises when a reader of the old layout would go wrong."""

HEADER = (
    *("finding", "effect", "where", "parameter", "value", "std", "unit", "low_95", "high_95", "meaning", "law"),
    *("status", "closed", "log_likelihood", "margin", "runner_up", "runner_up_times_floor", "ambiguous_with"),
)


def diagnosis_json(diagnosis: Diagnosis, provenance: Provenance) -> str:
    """The whole diagnosis but its time histories, as JSON; a number that is not known is null."""
    judgement = judge_diagnosis(diagnosis)
    stages = stages_of(diagnosis)
    document = {
        "schema": DIAGNOSIS_SCHEMA,
        "version": installed_version(),
        "command": provenance.command,
        "sources": provenance.sources,
        "remarks": provenance.remarks,
        "status": diagnosis.status,
        "verdict": diagnosis_headline(diagnosis),
        "trust": judgement.trust,
        "words": judgement.reasons,
        "next": next_sentences(diagnosis),
        "where": where_sentences(diagnosis),
        "warnings": diagnosis.warnings,
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
        csv_cell(effects_text(other.effects)) if other else "",
        number_cell(times_floor(other.held_out_level)) if other else "",
        csv_cell(", ".join(finding.ambiguous_with)),
    ]
    rows: list[list[object]] = []
    for one in finding.parameters:
        ends = (one.value - 1.96 * one.std, one.value + 1.96 * one.std)
        row = [number, csv_cell(finding.effect), csv_cell(finding.where), csv_cell(one.name)]
        row += [number_cell(one.value), number_cell(one.std), csv_cell(one.unit)]
        row += [*(number_cell(end) for end in ends), csv_cell(one.meaning), *common]
        rows.append(row)
    return rows or [[number, csv_cell(finding.effect), csv_cell(finding.where), *[""] * 7, *common]]
