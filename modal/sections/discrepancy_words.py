"""The plain words for what a diagnosis means.

Each sentence comes from a rule and says no more than the rule carries. The report, the Markdown page, the recording and
the terminal all take their words from here.
"""

import math
from collections.abc import Sequence

import numpy as np

from modal.discrepancy.results import (
    EVEN,
    Diagnosis,
    Finding,
    Step,
    changed_masses,
    masses_text,
    other_masses,
    unexplained_outputs,
)
from modal.discrepancy.validation.summary import wrong_units
from modal.effects.ambiguity import AMBIGUOUS
from modal.effects.catalogue import one_of
from modal.identification.words import Judgement
from modal.sections.discrepancy_stages import (
    closed_share,
    effect_text,
    effects_text,
    hypothesis_text,
    levels_in_words,
    parameters_text,
    times_floor,
    times_text,
    value_with_unit,
)
from modal.simulation import explained
from modal.structure.given import PlantModel
from modal.structure.structural_model import StructuralModel
from modal.wording.text import MOST_NAMED, exact_percent, listed, number, percent

COULD_HIDE = "What the data could still hide: "
UPPER_LIMIT = 0.3
"""Relative deviation of a floor's variance above which it is rather an upper limit, as `NoiseFloor` has it."""


def diagnosis_headline(diagnosis: Diagnosis) -> str:
    """The result in one short sentence."""
    found = [(finding.effect, finding.where) for finding in diagnosis.findings]
    names = effects_text(found) if found else other_masses(diagnosis)
    blind = unexplained_outputs(diagnosis)
    if diagnosis.status == "none" and _all(blind, diagnosis):
        return f"These data tell nothing of the simulation: it explains nothing of {_few(blind)}."
    if diagnosis.status == "none" and blind:
        return f"The simulation lacks no effect that these data could show, but explains nothing of {_few(blind)}."
    if diagnosis.status == "none":
        why = f": {names} explains them" if other_masses(diagnosis) else ""
        return f"The simulation lacks no effect that these data could show{why}."
    if not names:
        return "Something is left that no effect that was tried explains."
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
    if diagnosis.status == "none" and _all(unexplained_outputs(diagnosis), diagnosis):
        return Judgement(trust="with care", label="Nothing explained", reasons=said)
    if diagnosis.status == "none":
        label = "Nothing missing" if not doubts else "Nothing missing, with care"
    else:
        label = "Proved on held-out data" if not doubts else "Proved on held-out data, with care"
    return Judgement(trust="with care" if doubts else "carried", label=label, reasons=said)


def remaining_sentence(diagnosis: Diagnosis) -> str:
    """How far the model is from the held-out data before, after calibration and after, in times of the floor."""
    masses = masses_text(changed_masses(diagnosis)) if not diagnosis.findings else ""
    effects = {0: masses and f"with {masses}", 1: "with the effect"}.get(len(diagnosis.findings), "with the effects")
    parts = [_left(step, effects) for step in _milestones(diagnosis)]
    verdict = ", which is noise" if explained(diagnosis.steps[-1].held_out_level) else ""
    return f"On held-out data the gap is, in times of the noise floor, {listed(parts)}{verdict}."


def closed_sentence(diagnosis: Diagnosis) -> str:
    """What calibration and effects took away; "" where there was no gap to close."""
    first = times_floor(diagnosis.steps[0].held_out_level)
    if not math.isfinite(diagnosis.closed) or explained(diagnosis.steps[0].held_out_level):
        return ""
    whole = exact_percent(closed_share(diagnosis.closed))
    if not diagnosis.findings:
        alone = f"Calibration with {masses}" if (masses := other_masses(diagnosis)) else "Calibration alone"
        taken = "nothing of it" if diagnosis.closed <= 0.0 else f"{whole} of what was above the noise"
        return f"{alone} takes away {taken}."
    effects = "effect" if len(diagnosis.findings) == 1 else "effects"
    if diagnosis.closed <= 0.0:
        return f"Calibration and the {effects} found take away nothing of it."
    calibrated = [times_floor(step.held_out_level) for step in _milestones(diagnosis)[1:-1]]
    if not calibrated or not math.isfinite(first):
        return f"Calibration and the {effects} found take away {whole} of what was above the noise."
    # a gap of L times the floor stands root(L^2 - 1) above it
    left = max(calibrated[0] ** 2 - 1.0, 0.0) / (first**2 - 1.0)
    alone = exact_percent(closed_share(1.0 - left)) if left < 1.0 else "nothing"
    return f"Calibration alone takes away {alone} of what was above the noise; with the {effects} found it is {whole}."


def finding_sentence(finding: Finding) -> str:
    """What was found, where, how large."""
    values = parameters_text(finding)
    return f"{capital(effect_text(finding.effect))} at {finding.where}: {finding.law}" + (
        f", {values}." if values else "."
    )


def runner_up_sentence(finding: Finding) -> str:
    """Which other hypothesis came nearest, and by how much the finding leads it."""
    if finding.runner_up is None:
        return "No other hypothesis was worth a fit in its place."
    other = hypothesis_text(finding.runner_up)
    margin = finding.evidence.margin
    if not math.isfinite(margin):
        return f"Runner-up: {other}, which {levels_in_words(finding.runner_up)}."
    if margin < EVEN:
        lead = f"2 ln L is {margin:.3g} apart, below {EVEN:g}: too little to tell the two apart"
    else:
        lead = f"the finding leads by 2 ln L = {margin:.0f}"
    return f"Runner-up: {other}, which {levels_in_words(finding.runner_up)}; {lead}."


def ambiguity_sentence(finding: Finding) -> str:
    """What the finding cannot be told from; "" where there is nothing."""
    if not finding.ambiguous_with:
        return ""
    name = f"{capital(effect_text(finding.effect))} at {finding.where}"
    by_level = _of_one_level(finding)
    others = [other for other in finding.ambiguous_with if other not in by_level]
    said = []
    if others:
        said.append(f"{name} cannot be told from {one_of(others)} in these data.")
    if by_level:
        led = finding.evidence.margin >= EVEN and finding.runner_up is not None
        fits = ", although it fits these better" if led else ""
        said.append(f"{name} is easily taken for {one_of(by_level)} in records of one level{fits}.")
    return " ".join(said)


def _of_one_level(finding: Finding) -> list[str]:
    """Of what it may be taken for, that which a second level would tell from it."""
    rows = [row for row in AMBIGUOUS if finding.effect in row.effects and row.circumstance == "one_level"]
    return [other for other in finding.ambiguous_with if any(other in row.others(finding.effect) for row in rows)]


def read_first(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The warnings, each as a sentence."""
    return tuple(as_sentence(text) for text in diagnosis.warnings if text.strip())


def bounds_sentence(diagnosis: Diagnosis) -> str:
    """Which linear parameters sit on a bound; "" where none does, or where a warning names them already."""
    hit = diagnosis.bounds_hit
    if not hit or any(all(name in warning for name in hit) for warning in diagnosis.warnings):
        return ""
    verb, its = ("sits", "its") if len(hit) == 1 else ("sit", "their")
    return f"{capital(_few(hit))} {verb} on {its} bound: the model as given may be wrong there by more than it allows."


def hidden_sentence(diagnosis: Diagnosis) -> str:
    """What the data could still hide where nothing was found; "" otherwise, or where that is not known or vain."""
    limits = diagnosis.detection_limits
    if not limits or diagnosis.status != "none" or _all(unexplained_outputs(diagnosis), diagnosis):
        return ""
    parts = [
        f"{effect_text(one.effect)} at {one.where} up to {one.parameter} = {value_with_unit(number(one.value), one)}"
        for one in limits[:MOST_NAMED]
    ]
    rest = f"; {len(limits) - MOST_NAMED} more stand in the table" if len(limits) > MOST_NAMED else ""
    return f"{COULD_HIDE}{'; '.join(parts)}{rest}."


def model_name(diagnosis: Diagnosis) -> str | None:
    """The name of the file of the updated model, None where its type has none."""
    return "model.json" if isinstance(diagnosis.model, StructuralModel | PlantModel) else None


def next_steps(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What to do next: go on with the model where it is proved, and what to measure."""
    if units := wrong_units(diagnosis):
        first = f"Look at the units of {listed([one.where for one, _ in units])} first, in the file and in the model."
    elif diagnosis.status == "named":
        file = f" ({name})" if (name := model_name(diagnosis)) else ""
        first = f"Simulate with the updated model{file}: it holds the effects with their values."
    elif diagnosis.status == "none" and _all(unexplained_outputs(diagnosis), diagnosis):
        first = "Check channels, sensors and the strength of the input first: so far nothing was compared but noise."
    elif diagnosis.status == "none":
        first = (
            "Go on with the calibrated model; where an effect matters to you, compare its size with what could hide."
        )
    elif diagnosis.findings:
        first = "Do not build on the named effect yet: measure first what would settle it."
    elif masses := other_masses(diagnosis):
        first = f"Check the model's masses first: with {masses} it explains the records."
    else:
        first = "Add no effect to the model: none that was tried explains enough."
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


def floor_summary(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The same in short, for the terminal: the way, and how sure it is."""
    floor, first = diagnosis.noise_floor, len(diagnosis.fit)
    errors = np.asarray(floor.standard_error)[first:]
    ways: dict[str, list[int]] = {}
    for i in range(len(diagnosis.held_out)):
        ways.setdefault(floor.method[first + i], []).append(i)
    said = []
    for way, which in ways.items():
        names = listed([diagnosis.held_out[i].name or f"held-out record {i + 1}" for i in which])
        known = errors[which][np.isfinite(errors[which])]
        sure = f", known to about {percent(0.5 * float(known.max()))}" if known.size else ""  # rms: half of a variance
        limit = ", rather an upper limit" if known.size and known.max() > UPPER_LIMIT else ""
        said.append(f"Noise floor of {names}: {way}{sure}{limit}.")
    return tuple(said)


def _all(outputs: Sequence[str], diagnosis: Diagnosis) -> bool:
    return len(outputs) == diagnosis.held_out[0].n_outputs


def _few(names: Sequence[str]) -> str:
    return listed([*names[:MOST_NAMED], *([f"{len(names) - MOST_NAMED} more"] if len(names) > MOST_NAMED else [])])


def _milestones(diagnosis: Diagnosis) -> Sequence[Step]:
    """The first step, the calibrated model and the last step, each once."""
    steps = diagnosis.steps
    inner = [step for step in steps[1:-1] if step.name == "calibrated"]
    return [steps[0], *inner, *steps[-1:]] if len(steps) > 1 else list(steps)


def _left(step: Step, effects: str) -> str:
    size = times_floor(step.held_out_level)
    plain = {"as given": "with the model as given", "calibrated": "after calibration"}
    name = plain.get(step.name, effects or f"with another {step.name}")
    return f"{times_text(size)} {name}" if math.isfinite(size) else f"unbounded {name}"


def capital(text: str) -> str:
    """The text as the start of a sentence."""
    return text[:1].upper() + text[1:]


def as_sentence(text: str) -> str:
    """The text with a capital and a full stop."""
    return capital(text.strip()).rstrip(".") + "."
