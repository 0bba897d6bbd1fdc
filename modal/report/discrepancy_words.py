"""What a diagnosis means, in plain words: each sentence comes from a rule, and says no more than the rule carries.

The report, the Markdown page, the recording and the terminal all take their words from here.
"""

import math
from collections.abc import Sequence

from modal.discrepancy.diagnosis import Diagnosis, Finding, Step
from modal.report.discrepancy_values import (
    CLOSE_COMPANY,
    NAMED_WITHIN,
    effect_text,
    effects_text,
    levels_in_words,
    listed,
    parameters_text,
    share_text,
    times_floor,
    times_text,
    value_text,
    with_unit,
)
from modal.report.words import Judgement

__all__ = [
    "ambiguity_sentence",
    "as_sentence",
    "bounds_sentence",
    "capital",
    "closed_sentence",
    "finding_sentence",
    "floor_sentences",
    "headline",
    "judge_diagnosis",
    "limits_sentence",
    "next_sentences",
    "read_first",
    "remaining_sentence",
    "runner_up_sentence",
    "where_sentences",
]

MOST_NAMED = 3
"""Linear parameters or limits named in one sentence; the tables have all."""


def headline(diagnosis: Diagnosis) -> str:
    """The result in one short sentence."""
    names = effects_text([(finding.effect, finding.where) for finding in diagnosis.findings])
    if diagnosis.status == "none":
        return "The simulation lacks no effect that these data could show."
    if not diagnosis.findings:
        return "Something is missing, but no effect of the catalogue explains it."
    if diagnosis.status == "named":
        return f"The simulation lacks {names}."
    return f"Not settled: the best guess is {names}."


def judge_diagnosis(diagnosis: Diagnosis) -> Judgement:
    """How far the result can be trusted: "not carried" exactly when it is unresolved; the command then exits with 1."""
    reasons = [remaining_sentence(diagnosis), closed_sentence(diagnosis)]
    reasons += [ambiguity_sentence(finding) for finding in diagnosis.findings]
    reasons += [bounds_sentence(diagnosis)]
    said = tuple(reason for reason in reasons if reason)
    if diagnosis.status == "unresolved":
        return Judgement(trust="not carried", label="Not proved", reasons=said)
    doubts = diagnosis.warnings or diagnosis.bounds_hit or any(one.ambiguous_with for one in diagnosis.findings)
    if diagnosis.status == "none":
        label = "Nothing missing" if not doubts else "Nothing missing, with care"
    else:
        label = "Proved on held-out data" if not doubts else "Proved on held-out data, with care"
    return Judgement(trust="with care" if doubts else "carried", label=label, reasons=said)


def remaining_sentence(diagnosis: Diagnosis) -> str:
    """How far the model is from the held-out data before, after calibration and after, in times of the floor."""
    effects = {0: "", 1: "with the effect"}.get(len(diagnosis.findings), "with the effects")
    parts = [_left(step, effects) for step in _milestones(diagnosis)]
    last = times_floor(diagnosis.steps[-1].held_out_level)
    verdict = ", which is noise" if last <= NAMED_WITHIN else ""
    return f"On held-out data the gap is, in times of the noise floor, {listed(parts)}{verdict}."


def closed_sentence(diagnosis: Diagnosis) -> str:
    """What calibration and effects took away; "" where there was no gap to close."""
    first = times_floor(diagnosis.steps[0].held_out_level)
    if not math.isfinite(diagnosis.closed) or first <= NAMED_WITHIN:
        return ""
    effects = "effect" if len(diagnosis.findings) == 1 else "effects"
    what = f"Calibration and the {effects} found" if diagnosis.findings else "Calibration alone"
    took = "takes" if not diagnosis.findings else "take"
    if diagnosis.closed <= 0.0:
        return f"{what} {took} nothing of it away."
    return f"{what} {took} away {share_text(diagnosis.closed)} of its mean square above the floor."


def finding_sentence(finding: Finding) -> str:
    """What was found, where, how large."""
    values = parameters_text(finding)
    return f"{capital(effect_text(finding.effect))} at {finding.where}: {finding.law}" + (
        f", {values}." if values else "."
    )


def runner_up_sentence(finding: Finding) -> str:
    """Which other hypothesis came nearest, and by how much the finding leads it."""
    if finding.runner_up is None:
        return "No other hypothesis could be fitted in its place."
    other = effects_text(finding.runner_up.effects)
    margin = finding.evidence.margin
    if not math.isfinite(margin):
        return f"Runner-up: {other}, which {levels_in_words(finding.runner_up)}."
    if margin < CLOSE_COMPANY:
        lead = f"2 ln L is {margin:.3g} apart, below {CLOSE_COMPANY:g}: too little to tell the two apart"
    else:
        lead = f"the finding leads by 2 ln L = {margin:.0f}"
    return f"Runner-up: {other}, which {levels_in_words(finding.runner_up)}; {lead}."


def ambiguity_sentence(finding: Finding) -> str:
    """What the finding cannot be told from; "" where there is nothing."""
    if not finding.ambiguous_with:
        return ""
    others = listed([effect_text(other) for other in finding.ambiguous_with]).replace(" and ", " or ")
    name = capital(effect_text(finding.effect))
    return f"{name} at {finding.where} cannot be told from {others} by structure, in these data."


def read_first(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The warnings, each as a sentence."""
    return tuple(as_sentence(text) for text in diagnosis.warnings if text.strip())


def bounds_sentence(diagnosis: Diagnosis) -> str:
    """Which linear parameters sit on a bound; "" where none does, or where a warning names them already."""
    hit = diagnosis.bounds_hit
    if not hit or any(all(name in warning for name in hit) for warning in diagnosis.warnings):
        return ""
    names = listed([*hit[:MOST_NAMED], *([f"{len(hit) - MOST_NAMED} more"] if len(hit) > MOST_NAMED else [])])
    verb, its = ("sits", "its") if len(hit) == 1 else ("sit", "their")
    return f"{capital(names)} {verb} on {its} bound: the model as given may be wrong there by more than it allows."


def limits_sentence(diagnosis: Diagnosis) -> str:
    """What the data could still hide where nothing was found; "" otherwise, or where that is not known."""
    limits = diagnosis.detection_limits
    if not limits or diagnosis.status != "none":
        return ""
    parts = [
        f"{effect_text(one.effect)} at {one.where} up to {one.parameter} = {with_unit(value_text(one.value), one)}"
        for one in limits[:MOST_NAMED]
    ]
    rest = f"; {len(limits) - MOST_NAMED} more stand in the table" if len(limits) > MOST_NAMED else ""
    return f"What the data could still hide: {'; '.join(parts)}{rest}."


def next_sentences(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What to do next: go on with the model where it is proved, and what to measure."""
    if diagnosis.status == "named":
        first = "Simulate with the updated model; it holds the effects with their values."
    elif diagnosis.status == "none":
        first = (
            "Go on with the calibrated model; where an effect matters to you, compare its size with what could hide."
        )
    elif diagnosis.findings:
        first = "Do not build on the named effect yet: measure first what would settle it."
    else:
        first = "Keep the model as it is: no effect explains enough to be added."
    return (first, *diagnosis.advice)


def where_sentences(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Where the two disagree before any effect is tried, as the location has it."""
    return tuple(getattr(diagnosis.location, "sentences", ()))


def floor_sentences(diagnosis: Diagnosis) -> tuple[str, ...]:
    """From what the noise floor of the held-out records was found, once for each different way."""
    floor, first = diagnosis.noise_floor, len(diagnosis.fit)
    ways: dict[str, list[str]] = {}
    for i, record in enumerate(diagnosis.held_out):
        text = f"{floor.method[first + i]} ({floor.reason[first + i].rstrip('.')})"
        ways.setdefault(text, []).append(record.name or f"held-out record {i + 1}")
    return tuple(f"Noise floor of {listed(names)}: {text}." for text, names in ways.items())


def _milestones(diagnosis: Diagnosis) -> Sequence[Step]:
    """The first step, the calibrated model and the last step, each once."""
    steps = diagnosis.steps
    inner = [step for step in steps[1:-1] if step.name == "calibrated"]
    return [steps[0], *inner, *steps[-1:]] if len(steps) > 1 else list(steps)


def _left(step: Step, effects: str) -> str:
    size = times_floor(step.held_out_level)
    plain = {"as given": "with the model as given", "calibrated": "after calibration"}
    name = plain.get(step.name, effects or step.name)
    return f"{times_text(size)} {name}" if math.isfinite(size) else f"unbounded {name}"


def capital(text: str) -> str:
    """The text as the start of a sentence."""
    return text[:1].upper() + text[1:]


def as_sentence(text: str) -> str:
    """The text with a capital and a full stop."""
    return capital(text.strip()).rstrip(".") + "."
