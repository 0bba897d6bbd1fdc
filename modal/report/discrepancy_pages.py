"""The pages of a diagnosis for people: the same sections in HTML (with pictures) and in Markdown (without)."""

import platform
from collections.abc import Mapping

import numpy as np

from modal.discrepancy.results import Diagnosis, Finding
from modal.report.pages import environment, hold_text, inline
from modal.report.picture import Picture
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import rows_of, stages_of
from modal.sections.discrepancy_values import (
    beside_text,
    closed_share,
    effect_text,
    effects_text,
    found_hypothesis,
    found_value,
    found_word,
    interval_text,
    signed_change,
    size_text,
    step_text,
    times_floor,
    times_text,
    value_text,
)
from modal.sections.provenance import Provenance, installed_version
from modal.wording.numbers import exact_percent
from modal.wording.statements import number
from okid.arrays import FloatArray

__all__ = ["diagnosis_html", "diagnosis_markdown", "equations_of"]

STATUS_WORDS = {"named": "named", "unresolved": "not settled", "none": "nothing missing"}
MOST_HYPOTHESES = 20
"""Listed in the page; the JSON file has all."""


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
        "next_sentences": words.next_sentences(diagnosis),
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
        "n_more_hypotheses": max(0, len(diagnosis.hypotheses) - MOST_HYPOTHESES),
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
            "effects": effects_text(one.effects),
            "found": one is found,
            "fit": times_text(times_floor(one.fit_level)),
            "held_out": times_text(times_floor(one.held_out_level)),
            "behind": _behind(best - one.log_likelihood),
        }
        for one in diagnosis.hypotheses[:MOST_HYPOTHESES]
    ]


def _behind(gap: float) -> str:
    """2 ln L behind the best; a dash where it is not known."""
    if not np.isfinite(gap):
        return "–"
    return f"{gap:.0f}" if gap > 0.0 else "best"


def _calibrated(diagnosis: Diagnosis) -> list[dict[str, object]]:
    rows = []
    for one in diagnosis.calibrated:
        change = signed_change(one)
        rows.append(
            {
                "name": one.name,
                "unit": one.unit,
                "nominal": beside_text(one.nominal, one.value, one.std),
                "value": value_text(one.value, one.std),
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
