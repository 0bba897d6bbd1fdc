"""The pages of a diagnosis in words and tables, as Markdown."""

import numpy as np

from modal.discrepancy.results import Diagnosis, Finding
from modal.recording.discrepancy.discrepancy_plan import DiscrepancyPlan
from modal.recording.names import cell
from modal.recording.words import UNKNOWN, bullets, table
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import rows_of
from modal.sections.discrepancy_values import (
    effect_text,
    found_value,
    interval_text,
    size_text,
    step_text,
    times_floor,
    times_text,
)

__all__ = ["gap_text", "law_text", "step_document", "verdict_text"]

MOST_ROWS = 40


def verdict_text(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> str:
    """The verdict, the numbers found, before and after, what it cannot be told from, and what to do next."""
    judgement = words.judge_diagnosis(diagnosis)
    parts = [f"### {cell(words.diagnosis_headline(diagnosis))}", f"**{judgement.label}.**"]
    parts += [f"**Read this:** {cell(warning)}" for warning in words.read_first(diagnosis)]
    if diagnosis.findings:
        parts.append(_parameters(diagnosis.findings))
    parts.append(_before_after(plan))
    runners_up = [words.runner_up_sentence(finding) for finding in diagnosis.findings if finding.runner_up]
    parts += bullets(judgement.reasons, runners_up)
    parts += ["**Next**", *bullets(words.next_sentences(diagnosis))]
    limits = words.hidden_sentence(diagnosis)
    return "\n\n".join([*parts, *([cell(limits)] if limits else [])])


def law_text(diagnosis: Diagnosis) -> str:
    """Every finding with its law, its signature and what speaks for it; then where the two disagree."""
    parts = []
    for number, finding in enumerate(diagnosis.findings, start=1):
        name = f"{words.capital(effect_text(finding.effect))} at {finding.where}"
        parts += [f"### {number}. {cell(name)}", f"Law: **{cell(finding.law)}** (`{cell(finding.effect)}`)"]
        parts += bullets(
            [
                f"How it shows: {words.as_sentence(finding.signature)}",
                words.as_sentence(finding.evidence.words),
                words.runner_up_sentence(finding),
            ]
        )
    where = words.where_sentences(diagnosis)
    if where:
        parts += ["### Where they disagree, before any effect was tried", *bullets(where)]
    return "\n\n".join(parts) or "No effect was found."


def gap_text(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> str:
    """The gap part by part and output by output, and from what the noise floor was found."""
    floor = np.sqrt(np.asarray(diagnosis.noise_floor.variance)[len(diagnosis.fit) :])
    rows = [
        [
            cell(record.name or f"held-out record {i + 1}", 40),
            cell(name, 28),
            size_text(float(diagnosis.gap_before[i, j])),
            f"**{size_text(float(diagnosis.gap_after[i, j]))}**",
            size_text(float(floor[i, j])),
            cell(record.output_units[j], 12) if record.output_units[j] else UNKNOWN,
        ]
        for i, record in enumerate(diagnosis.held_out)
        for j, name in enumerate(record.output_names)
    ]
    parts = ["### Held-out gap, root mean square"]
    parts.append(table(["record", "output", "as given", "updated model", "noise", "unit"], rows[:MOST_ROWS]))
    if plan.stages:
        heads = ["by", "part", *(stage.name for stage in plan.stages)]
        sizes = [[row.part, cell(row.name, 40), *map(times_text, row.sizes)] for row in rows_of(plan.stages)]
        parts += ["### The same in times of the noise floor", table(heads, sizes[:MOST_ROWS])]
    return "\n\n".join([*parts, *bullets(words.floor_sentences(diagnosis))])


def step_document(diagnosis: Diagnosis, number: int) -> str:
    """One step: what it added, and what is left after it and after each of the others."""
    step = diagnosis.steps[number]
    rows = [
        [
            f"**{cell(step_text(one.name))}**" if k == number else cell(step_text(one.name)),
            times_text(times_floor(one.fit_level)),
            times_text(times_floor(one.held_out_level)),
        ]
        for k, one in enumerate(diagnosis.steps)
    ]
    left = times_text(times_floor(step.held_out_level))
    return "\n\n".join(
        [
            f"### Step {number} of {len(diagnosis.steps) - 1}: {cell(step_text(step.name))}",
            f"On held-out data **{left}** times the noise floor are left (1 is noise and no more).",
            table(["step", "fitted to", "held out"], rows),
            "Play the timeline `step` (or `time`): the gap shrinks.",
        ]
    )


def _parameters(findings: tuple[Finding, ...]) -> str:
    rows = [
        [
            cell(effect_text(finding.effect)),
            cell(finding.where, 28),
            cell(one.name),
            f"**{found_value(one)}**",
            cell(one.unit, 16) if one.unit else UNKNOWN,
            interval_text(one.value, one.std),
        ]
        for finding in findings
        for one in finding.parameters
    ]
    return table(["effect", "place", "", "value ± std", "unit", "95 %"], rows)


def _before_after(plan: DiscrepancyPlan) -> str:
    """The gap by output, in times of the noise floor."""
    rows = [[cell(row.name, 28), *map(times_text, row.sizes)] for row in rows_of(plan.stages) if row.part == "output"]
    heads = ["output, × noise", *(stage.name for stage in plan.stages)]
    return table(heads, rows[:MOST_ROWS]) if rows else "The model as given does not run through the held-out records."
