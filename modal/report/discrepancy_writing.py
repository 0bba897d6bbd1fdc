"""The files of a diagnosis, all of them or none.

For people the same sections in HTML, with pictures and their words, and in Markdown; for programs JSON with every
number, CSV with one row a parameter.
"""

import csv
import io
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from modal import recording
from modal.discrepancy.results import Diagnosis, Finding, in_words
from modal.plots import discrepancy as plots
from modal.report.folder import FileSet, write_folder
from modal.report.machine import as_json, number_cell, record_document
from modal.report.pages import environment, hold_text, inline
from modal.report.pictures import Picture, drawn
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import (
    NAMED_WITHIN,
    Stage,
    beside_text,
    closed_share,
    effect_text,
    found_hypothesis,
    found_value,
    found_word,
    hypothesis_text,
    interval_text,
    level_lines,
    record_name,
    rows_of,
    signed_change,
    size_text,
    stages_of,
    step_text,
    times_floor,
    times_text,
    value_text,
    worst_outputs,
)
from modal.sections.discrepancy_words import diagnosis_headline, judge_diagnosis, next_steps, where_sentences
from modal.sections.validation import Provenance, installed_version
from modal.simulation.plant import MASS
from modal.wording.text import MOST_NAMED, NINETY_FIVE, csv_cell, exact_percent, number, shorten
from okid.arrays import FloatArray
from okid.errors import visible
from okid.readers.guard import Existing

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
    for place, finding in enumerate(diagnosis.findings, start=1):
        writer.writerows(_rows(place, finding, diagnosis.status))
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
class DiagnosisFiles(FileSet):
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
    model = words.model_name(diagnosis)
    write_folder(
        target,
        DiagnosisFiles.in_folder(target).names,
        lambda made: _write_all(diagnosis, DiagnosisFiles.in_folder(made, model=model), source),
        existing=existing,
        gone=("report.pdf",),
    )
    return DiagnosisFiles.in_folder(target, model=model)


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


STATUS_WORDS = {"named": "named", "unresolved": "not settled", "none": "nothing missing"}


class GapPageLimits:
    """How much the page of a diagnosis shows."""

    MOST_HYPOTHESES: Final = 20
    """Listed in the page; the JSON file has all."""
    MOST_OUTPUTS: Final = 6


def diagnosis_html(
    diagnosis: Diagnosis, provenance: Provenance, pictures: Mapping[str, Picture], *, model_file: str = ""
) -> str:
    """One page that needs nothing but itself; `model_file` is the name of the updated model beside it."""
    drawn = {name: inline(picture) for name, picture in pictures.items()}
    template = environment(html=True).get_template("discrepancy.html.j2")
    return template.render(**_context(diagnosis, provenance), pictures=drawn, model_file=model_file) + "\n"


def diagnosis_markdown(diagnosis: Diagnosis, provenance: Provenance) -> str:
    """The same words and tables as Markdown."""
    template = environment(html=False).get_template("discrepancy.md.j2")
    return template.render(**_context(diagnosis, provenance)) + "\n"


def equations_of(diagnosis: Diagnosis) -> str:
    """The equations of the updated model with numbers and units, "" where its type does not tell them."""
    tell = getattr(diagnosis.model, "equations", None)
    return str(tell()) if callable(tell) else ""


def _context(diagnosis: Diagnosis, provenance: Provenance) -> dict[str, object]:
    stages = stages_of(diagnosis)
    return {
        "title": _title(diagnosis),
        "headline": words.diagnosis_headline(diagnosis),
        "judgement": words.judge_diagnosis(diagnosis),
        "status_word": STATUS_WORDS[diagnosis.status],
        "diagnosis": diagnosis,
        "warnings": words.read_first(diagnosis),
        "findings": [_finding(number, one) for number, one in enumerate(diagnosis.findings, start=1)],
        "found_sentences": [words.finding_sentence(one) for one in diagnosis.findings[:MOST_NAMED]],
        "next_sentences": words.next_steps(diagnosis),
        "where_sentences": words.where_sentences(diagnosis),
        "limits_sentence": words.hidden_sentence(diagnosis),
        "stages": stages,
        "rows": [
            {"part": row.part, "name": row.name, "sizes": [times_text(size) for size in row.sizes]}
            for row in rows_of(stages)
        ],
        "gaps": _gaps(diagnosis),
        "steps": [
            {
                "name": step_text(step.name),
                "fit": times_text(times_floor(step.fit_level)),
                "held_out": times_text(times_floor(step.held_out_level)),
            }
            for step in diagnosis.steps
        ],
        "hypotheses": _hypotheses(diagnosis),
        "found_word": found_word(diagnosis),
        "n_more_hypotheses": max(0, len(diagnosis.hypotheses) - GapPageLimits.MOST_HYPOTHESES),
        "calibrated": _calibrated(diagnosis),
        "limits": [
            {
                "effect": effect_text(one.effect),
                "where": one.where,
                "parameter": one.parameter,
                "value": number(one.value),
                "unit": one.unit,
            }
            for one in diagnosis.detection_limits
        ],
        "floor_sentences": words.floor_sentences(diagnosis),
        "records": [_record(diagnosis, number) for number in range(len(diagnosis.fit) + len(diagnosis.held_out))],
        "first_size": times_text(times_floor(diagnosis.steps[0].held_out_level)),
        "last_size": times_text(times_floor(diagnosis.steps[-1].held_out_level)),
        "closed": exact_percent(closed_share(diagnosis.closed)),
        "equations": equations_of(diagnosis),
        "provenance": provenance,
        "version": installed_version(),
        "python_version": platform.python_version(),
        "numpy_version": np.__version__,
        "snippet": _snippet(diagnosis),
    }


def _title(diagnosis: Diagnosis) -> str:
    names = [record.name for record in diagnosis.held_out if record.name]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "") or "Unnamed records"


def _finding(number: int, finding: Finding) -> dict[str, object]:
    return {
        "number": number,
        "effect": words.capital(effect_text(finding.effect)),
        "key": finding.effect,
        "where": finding.where,
        "law": finding.law,
        "signature": words.as_sentence(finding.signature),
        "evidence": words.as_sentence(finding.evidence.words),
        "closed": exact_percent(closed_share(finding.evidence.closed)),
        "runner_up": words.runner_up_sentence(finding),
        "ambiguity": words.ambiguity_sentence(finding),
        "parameters": [
            {
                "name": one.name,
                "value": found_value(one),
                "interval": interval_text(one.value, one.std),
                "unit": one.unit,
                "meaning": one.meaning,
            }
            for one in finding.parameters
        ],
    }


def _gaps(diagnosis: Diagnosis) -> list[dict[str, object]]:
    """Root mean square of the held-out gap in the unit of each output, before and after, with the noise."""
    floor = np.sqrt(np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :])
    return [
        {
            "record": record.name or f"held-out record {i + 1}",
            "output": name,
            "unit": record.output_units[j],
            "before": size_text(float(diagnosis.gap_before[i, j])),
            "after": size_text(float(diagnosis.gap_after[i, j])),
            "floor": size_text(float(floor[i, j])),
            "times": times_text(float(diagnosis.gap_after[i, j] / floor[i, j])),
            "explained": _explained(record.outputs[:, j], float(diagnosis.gap_after[i, j])),
        }
        for i, record in enumerate(diagnosis.held_out)
        for j, name in enumerate(record.output_names)
    ]


def _explained(measured: FloatArray, left: float) -> str:
    variance = float(np.nanvar(measured))
    return exact_percent(1.0 - left**2 / variance) if variance > 0.0 else "–"


def _hypotheses(diagnosis: Diagnosis) -> list[dict[str, object]]:
    found = found_hypothesis(diagnosis)
    best = max((one.log_likelihood for one in diagnosis.hypotheses), default=0.0)
    return [
        {
            "effects": hypothesis_text(one),
            "found": one is found,
            "fit": times_text(times_floor(one.fit_level)),
            "held_out": times_text(times_floor(one.held_out_level)),
            "behind": _behind(best - one.log_likelihood),
        }
        for one in diagnosis.hypotheses[: GapPageLimits.MOST_HYPOTHESES]
    ]


def _behind(gap: float) -> str:
    """2 ln L behind the best; a dash where it is not known."""
    if not np.isfinite(gap):
        return "–"
    return f"{gap:.0f}" if gap > 0.0 else "best"


def _calibrated(diagnosis: Diagnosis) -> list[dict[str, object]]:
    rows = []
    for one in diagnosis.calibrated:
        given = one.name.startswith(MASS) and one.value == one.nominal
        change = np.nan if given else signed_change(one)
        rows.append(
            {
                "name": one.name,
                "unit": one.unit,
                "nominal": f"{one.nominal:.6g}" if given else beside_text(one.nominal, one.value, one.std),
                "value": "taken as given" if given else value_text(one.value, one.std),
                "change": f"{100.0 * change:+.2g} %" if np.isfinite(change) else "–",
                "at_bound": one.at_bound,
            }
        )
    return rows


def _record(diagnosis: Diagnosis, number: int) -> dict[str, object]:
    n_fit = len(diagnosis.fit)
    record = diagnosis.fit[number] if number < n_fit else diagnosis.held_out[number - n_fit]
    return {
        "name": record.name or f"record {number + 1}",
        "use": "fitted to" if number < n_fit else "held out",
        "n_samples": record.n_samples,
        "dt": record.dt,
        "hold": hold_text(record.input_hold),
    }


def _snippet(diagnosis: Diagnosis) -> str:
    """Python that goes on with the result."""
    effects = ", ".join(f"{one.effect!a} at {one.where!a}" for one in diagnosis.findings) or "no effect"
    return (
        "import modal\n\n"
        "result = modal.discrepancy.diagnose(model, fit=records, held_out=others)\n"
        f"result.model  # calibrated, with {effects}\n"
        "modal.simulate(result.model, others[0])\n"
        'modal.write_report(result, "report")'
    )


def draw_diagnosis(diagnosis: Diagnosis) -> dict[str, Picture]:
    """All pictures that the diagnosis has the numbers for, by name."""
    stages = stages_of(diagnosis)
    return {
        **_gap_pictures(stages),
        **_level_picture(diagnosis),
        **_step_pictures(diagnosis),
        **_law_pictures(diagnosis),
    }


def _gap_pictures(stages: Sequence[Stage]) -> dict[str, Picture]:
    if not stages:
        return {}
    first = stages[0].gap
    shown = worst_outputs(first, GapPageLimits.MOST_OUTPUTS)
    most = "output" if len(shown) == 1 else f"{len(shown)} outputs"
    which = "" if len(shown) == len(first.output_names) else f" Shown: the {most} with the largest gap."
    worst = int(np.argmax(np.nan_to_num(first.in_floors.mean(axis=1))))
    name = shorten(visible(record_name(first.measured[worst], worst)), 60)
    record = f" Held-out record {name!r}." if len(first.measured) > 1 else ""
    states = _states(stages)
    return {
        **_answer_pictures(stages, worst, record),
        "histories": drawn(
            plots.gap_histories(stages, record=worst, outputs=shown),
            "gap histories",
            f"Measured minus simulated: {states}; grey, the band of the noise.{record}{which}",
        ),
        "spectra": drawn(
            plots.gap_spectra(stages, outputs=shown),
            "gap spectra",
            f"Spectra of the gap over that of the measured output (blue), mean over the held-out records: {states}. A "
            f"model that lacks nothing leaves a gap on the dashed line, the noise floor.{which}",
        ),
        "before_after": drawn(
            plots.before_and_after(rows_of(stages), stages),
            "before and after",
            f"The held-out gap part by part, in times of the noise floor: {states}. Points on the dashed line are "
            "noise and no more.",
        ),
    }


def _answer_pictures(stages: Sequence[Stage], record: int, which: str) -> dict[str, Picture]:
    """The pictures "before" and "after", or "before" alone where one state of the model ran through."""
    first = stages[0].gap
    largest = int(np.argmax(np.nan_to_num(first.in_floors[record])))
    name = shorten(visible(first.output_names[largest]), 60)
    by = f"Before: {name} measured (wide, blue) and simulated by the model {stages[0].name} (red)"
    after = f"After: the same moment, simulated by the model {stages[-1].name} (green)."
    captions = (f"{by}, where the two are furthest apart.{which}", after)
    charts = plots.answer_charts(stages, record=record, output=largest)
    drawings = zip(("before", "after"), charts, captions, strict=False)
    return {name: drawn(chart, name, caption) for name, chart, caption in drawings}


def _level_picture(diagnosis: Diagnosis) -> dict[str, Picture]:
    lines = level_lines(diagnosis)
    if not lines:
        return {}
    words = (
        "Each mode of the best linear model of each level, from the measured records alone, bars 95 %. A spring that "
        "hardens raises the frequency with the level, dry friction lowers the damping ratio, drag raises it; a mode "
        "that stays where it is belongs to a linear structure. Modes that are not known well enough are left out."
    )
    if any(line.name.startswith("pole") for line in lines):
        words += " Of a pole of first order the corner frequency is drawn: the faster, the more it is damped."
    return {"levels": drawn(plots.modes_against_level(lines), "modes against level", words)}


def _step_pictures(diagnosis: Diagnosis) -> dict[str, Picture]:
    pictures = {}
    if len(diagnosis.steps) > 1:
        pictures["steps"] = drawn(
            plots.shrinking_gap(diagnosis.steps),
            "the gap step by step",
            "What is left after each step. The held-out records were used in no fit.",
        )
    if diagnosis.hypotheses:
        shown = min(len(diagnosis.hypotheses), plots.MOST_BARS)
        rest = "" if shown == len(diagnosis.hypotheses) else f" The best {shown} of {len(diagnosis.hypotheses)}."
        mark = f"Green: {found_word(diagnosis)}. " if found_hypothesis(diagnosis) else ""
        pictures["hypotheses"] = drawn(
            plots.hypothesis_bars(diagnosis.hypotheses, chosen=found_hypothesis(diagnosis)),
            "hypotheses",
            f"What each set of effects leaves on held-out data. {mark}An effect is named only within "
            f"{NAMED_WITHIN:.2f} times the noise floor ({NAMED_WITHIN**2:.2g} in mean squares).{rest}",
        )
    return pictures


def _law_pictures(diagnosis: Diagnosis) -> dict[str, Picture]:
    laws = diagnosis.laws[: GapPageLimits.MOST_OUTPUTS]
    if not laws:
        return {}
    parts = ["The law as found (green)"]
    if any(not law.loop_motion.size for law in laws):
        parts.append("with its 95 % band from the uncertainty of its parameters")
    if any(law.points_motion.size for law in laws):
        parts.append("over what the data ask for in bins of the motion, free of the law's form (blue, bars 95 %)")
    words = ", ".join(parts)
    loops = (
        " A law with memory is drawn as the loop along the loudest record; dashed, as it loads from rest."
        if any(x.loop_motion.size for x in laws)
        else ""
    )
    return {"laws": drawn(plots.draw_laws(laws), "laws", f"{words}.{loops}")}


def _states(stages: Sequence[Stage]) -> str:
    colours = {"before": "red", "linear": "amber", "after": "green"}
    return ", ".join(f"{stage.name} ({colours[stage.kind]})" for stage in stages)
