"""The effects found with their evidence, what they cannot be told from, what would tell, and what could still hide."""

from collections.abc import Sequence

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate
from modal.discrepancy.fitting.nodes import SMALLEST_FALL, SMALLEST_GAIN, Node, Task, log_likelihood_gain
from modal.discrepancy.results import DetectionLimit, Evidence, Finding, Hypothesis, LawCurve, Parameter
from modal.discrepancy.selection.decision import Decision
from modal.discrepancy.selection.screening import Candidate, screen_candidates
from modal.effects.ambiguity import Circumstance, ambiguous_with
from modal.effects.catalogue import effect_name, one_of, parameter_units
from modal.effects.effect import ForceEffect, is_form_free
from modal.simulation.plant import Plant
from modal.wording.numbers import times_floor_text
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["advise", "detection_limits", "findings_of", "hypothesis_of"]


def hypothesis_of(node: Node, root: Node, task: Task) -> Hypothesis:
    """A fitted set of effects, as the diagnosis shows it."""
    return Hypothesis(
        effects=node.effects,
        fit_level=node.fit_level,
        held_out_level=node.held_out_level,
        log_likelihood=0.0 if node is root else log_likelihood_gain(root, node, task),
        masses=node.masses,
    )


def findings_of(
    decision: Decision,
    root: Node,
    task: Task,
    plant: Plant,
    *,
    deviations: FloatArray,
    circumstances: frozenset[Circumstance],
    laws: Sequence[LawCurve] = (),
) -> tuple[Finding, ...]:
    """What was found.

    Args:
        decision: The decision.
        root: The calibrated linear model.
        task: Records and catalogue.
        plant: The plant.
        deviations: (n_common,) standard deviations of the common unknowns.
        circumstances: For the table of ambiguities.
        laws: Of all effects of the model, where one has an unknown form.

    Returns:
        One finding an effect that the root does not have.
    """
    found = []
    for i in range(len(root.effects), len(decision.node.effects)):
        runner, margin = decision.runners[i], decision.margins[i]
        item = decision.node.fitted.assembly.placements[i]
        curve = laws[i] if laws and is_form_free(item.effect) else None
        found.append(
            Finding(
                effect=item.effect.key,
                where=item.where,
                parameters=_parameters(decision.node, plant, deviations, i),
                law=item.effect.law if curve is None else _form(curve),
                signature=item.effect.signature,
                evidence=_evidence(decision, root, task, margin),
                runner_up=None if runner is None else hypothesis_of(runner, root, task),
                ambiguous_with=_others(item.effect.key, circumstances, _even(decision, i)),
                curve=curve,
            )
        )
    return tuple(found)


def _form(curve: LawCurve) -> str:
    """A law of unknown form in words, by what it does at both ends of its motion."""
    ends = [float(np.sign(curve.motion[k] * curve.force[k])) for k in (0, -1)]
    opposed = {2.0: "hardening ", -2.0: "softening "} if curve.against == "displacement" else {2.0: "rising "}
    form = opposed.get(sum(ends), "")
    return f"f = a smooth {form}law of the {curve.against} at {curve.where}, through points"


def _parameters(node: Node, plant: Plant, deviations: FloatArray, i: int) -> tuple[Parameter, ...]:
    assembly = node.fitted.assembly
    item = assembly.placements[i]
    values = node.fitted.unknowns.values(assembly, i)
    spread = dict(zip(item.common, deviations[assembly.common_of(i)], strict=False))
    units = parameter_units(plant, item.effect, item.where)
    return tuple(
        Parameter(
            name=kind.name,
            value=float(np.mean(value)),
            std=float(spread.get(j, np.nan)),
            unit=unit,
            meaning=kind.meaning + (" (mean over the records)" if kind.local else ""),
        )
        for j, (kind, value, unit) in enumerate(zip(item.effect.parameters, values, units, strict=True))
    )


def _evidence(decision: Decision, root: Node, task: Task, margin: float) -> Evidence:
    node = decision.node
    gain = log_likelihood_gain(root, node, task)
    before, after = max(root.held_out_level - 1.0, 1e-12), max(node.held_out_level - 1.0, 0.0)
    closed = 1.0 - after / before if np.isfinite(before) else 1.0
    also = ", with the other effects" if len(node.effects) - len(root.effects) > 1 else ""
    levels = " to ".join(times_floor_text(level) for level in (root.held_out_level, node.held_out_level))
    words = f"the held-out gap falls from {levels} times the noise floor{also}"
    return Evidence(closed=float(np.clip(closed, -np.inf, 1.0)), log_likelihood=gain, margin=margin, words=words)


def _even(decision: Decision, i: int) -> tuple[str, ...]:
    """Keys of the effects that explain the data as well as effect number i of the chosen model.

    Two laws of one motion at one place are one law: any other of the same shape would do.
    """
    placements = decision.node.fitted.assembly.placements
    item = placements[i]
    found = [key for key, _ in decision.even[i]] if decision.even else []
    if isinstance(item.effect, ForceEffect) and not item.effect.n_memory:
        like = [
            other
            for other in placements
            if other.where == item.where
            and isinstance(other.effect, ForceEffect)
            and other.effect.needs == item.effect.needs
        ]
        free = {frozenset({"displacement"}): "smooth_stiffness", frozenset({"velocity"}): "smooth_damping"}
        found += [free[item.effect.needs]] if len(like) > 1 and item.effect.needs in free else []
    return tuple(dict.fromkeys(found))


def _others(effect: str, circumstances: frozenset[Circumstance], even: tuple[str, ...]) -> tuple[str, ...]:
    """What an effect cannot be told from, by the evidence and by the table, nor what is like these from anything else.

    A sensor's zero is like a constant force, and that like friction where the motion never reverses.
    """
    rows = ambiguous_with(effect, circumstances=circumstances, even_with=even)
    every = dict.fromkeys([*even, *(other for row in rows for other in row.others(effect))])
    for other in list(every):
        every |= dict.fromkeys(
            key for row in ambiguous_with(other, circumstances=circumstances) for key in row.others(other)
        )
    return tuple(other for other in every if other != effect)


def detection_limits(current: Estimate, task: Task, plant: Plant) -> tuple[DetectionLimit, ...]:
    """The size of each effect at each place below which it would not count, beside the model as found.

    What counts takes away a tenth of what is left, and 30 of 2 ln L: of the two the larger amplitude. An effect with a
    shape (a gap, a frequency) is hidden best at its least visible shape; the limit is the largest over the shapes that
    the screen tries. Effects without an amplitude (a delay) are left out.

    One limit for each effect and place, in the order of the catalogue.
    """
    candidates = screen_candidates(current, task.fit, task.catalogue, signs="free")
    largest: dict[tuple[str, str], Candidate] = {}
    for candidate in candidates:
        known = largest.get((candidate.key, candidate.where))
        if np.isfinite(candidate.deviation) and (known is None or candidate.deviation > known.deviation):
            largest[candidate.key, candidate.where] = candidate
    n_values = int(task.fit.drive.present.sum())
    deviations = np.sqrt(max(SMALLEST_GAIN, SMALLEST_FALL * n_values))
    found = []
    for key, effect in task.catalogue.items():
        amplitudes = [j for j, kind in enumerate(effect.parameters) if kind.role == "amplitude"]
        for (other, where), candidate in largest.items():
            if other != key or not amplitudes:
                continue
            first = amplitudes[0]
            found.append(
                DetectionLimit(
                    effect=key,
                    where=where,
                    parameter=effect.parameters[first].name,
                    value=float(deviations * candidate.deviation),
                    unit=parameter_units(plant, effect, where)[first],
                )
            )
    return tuple(found)


def advise(decision: Decision, fits: Sequence[Record], circumstances: frozenset[Circumstance]) -> tuple[str, ...]:
    """What to measure next."""
    words: list[str] = []
    by_level = False
    for i, ((effect, where), runner) in enumerate(zip(decision.node.effects, decision.runners, strict=False)):
        rows = ambiguous_with(effect, circumstances=circumstances, even_with=_even(decision, i))
        by_level |= any(row.circumstance == "one_level" for row in rows)
        words += [_apart(effect, where, row.others(effect), row.separates) for row in rows]
        if runner is not None and decision.status == "unresolved":
            rest = [row for row in ambiguous_with(effect, circumstances=_ANY_RECORDS) if row not in rows]
            near = sorted({key for key, _ in runner.effects} - {key for key, _ in decision.node.effects})
            words += [
                _apart(effect, where, (key,), row.separates) for key in near for row in rest if key in row.effects
            ]
    if "one_level" in circumstances and not by_level:
        words.append("Measure at a second level, two or three times as strong: most effects are told apart by level.")
    if decision.status == "unresolved" and not decision.node.effects:
        words.append(
            "Nothing in the catalogue explains the gap: measure at more places, look at the time windows and bands in "
            "which it is greatest, or register an effect of your own."
        )
    if decision.status == "none":
        highest = max(fits, key=lambda record: float(np.nanvar(record.inputs)) if record.n_inputs else 0.0)
        words.append(
            f"A stronger level than that of {highest.name or 'the loudest record'} would show effects that these data "
            "hide."
        )
    return tuple(dict.fromkeys(words))


def _apart(effect: str, where: str, others: Sequence[str], separates: str) -> str:
    return f"To tell {effect_name(effect)} at {where} from {one_of(others)} you need {separates}."


_ANY_RECORDS: frozenset[Circumstance] = frozenset({"one_level", "one_way", "small_motion", "large_motion"})
"""What other records would change; the plant stays what it is."""
