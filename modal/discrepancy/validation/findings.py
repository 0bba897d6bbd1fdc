"""The effects found with their evidence, what they cannot be told from, what would tell, and what could still hide."""

from collections.abc import Sequence

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate
from modal.discrepancy.fitting.nodes import SMALLEST_FALL, SMALLEST_GAIN, Node, Task, log_likelihood_gain
from modal.discrepancy.results import DetectionLimit, Evidence, Finding, Hypothesis, Parameter
from modal.discrepancy.selection.decision import CLOSE_COMPANY, Decision
from modal.discrepancy.selection.screening import Candidate, screen_candidates
from modal.discrepancy.setup import SAME_LEVEL
from modal.effects.ambiguity import Circumstance, ambiguous_with
from modal.effects.catalogue import effect_name, one_of, parameter_units
from modal.simulation.plant import Plant
from modal.wording.numbers import times_floor_text
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["advise", "circumstances_of", "detection_limits", "even_rivals", "findings_of", "hypothesis_of"]


def hypothesis_of(node: Node, root: Node, task: Task) -> Hypothesis:
    """A fitted set of effects, as the diagnosis shows it."""
    return Hypothesis(
        effects=node.effects,
        fit_level=node.fit_level,
        held_out_level=node.held_out_level,
        log_likelihood=0.0 if node is root else log_likelihood_gain(root, node, task),
    )


def findings_of(
    decision: Decision,
    root: Node,
    task: Task,
    plant: Plant,
    *,
    deviations: FloatArray,
    circumstances: frozenset[Circumstance],
) -> tuple[Finding, ...]:
    """What was found.

    Args:
        decision: The decision.
        root: The calibrated linear model.
        task: Records and catalogue.
        plant: The plant.
        deviations: (n_common,) standard deviations of the common unknowns.
        circumstances: For the table of ambiguities.

    Returns:
        One finding an effect that the root does not have.
    """
    found = []
    for i in range(len(root.effects), len(decision.node.effects)):
        runner, margin = decision.runners[i], decision.margins[i]
        item = decision.node.fitted.assembly.placements[i]
        found.append(
            Finding(
                effect=item.effect.key,
                where=item.where,
                parameters=_parameters(decision.node, plant, deviations, i),
                law=item.effect.law,
                signature=item.effect.signature,
                evidence=_evidence(decision, root, task, margin),
                runner_up=None if runner is None else hypothesis_of(runner, root, task),
                ambiguous_with=_others(item.effect.key, circumstances, even_rivals(decision, i)),
            )
        )
    return tuple(found)


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


def even_rivals(decision: Decision, i: int) -> tuple[str, ...]:
    """Keys of the effects that explain the data as well as effect number i of the chosen model.

    Those of the runner-up that the chosen model lacks, where its lead is no lead; else none.
    """
    runner = decision.runners[i]
    if runner is None or decision.margins[i] >= CLOSE_COMPANY:
        return ()
    return tuple(dict.fromkeys(key for key, where in runner.effects if (key, where) not in decision.node.effects))


def _evidence(decision: Decision, root: Node, task: Task, margin: float) -> Evidence:
    node = decision.node
    gain = log_likelihood_gain(root, node, task)
    before, after = max(root.held_out_level - 1.0, 1e-12), max(node.held_out_level - 1.0, 0.0)
    closed = 1.0 - after / before if np.isfinite(before) else 1.0
    also = ", with the other effects" if len(node.effects) - len(root.effects) > 1 else ""
    levels = " to ".join(times_floor_text(level) for level in (root.held_out_level, node.held_out_level))
    words = f"the held-out gap falls from {levels} times the noise floor{also}"
    return Evidence(closed=float(np.clip(closed, -np.inf, 1.0)), log_likelihood=gain, margin=margin, words=words)


def _others(effect: str, circumstances: frozenset[Circumstance], even: tuple[str, ...]) -> tuple[str, ...]:
    rows = ambiguous_with(effect, circumstances=circumstances, even_with=even)
    return tuple(dict.fromkeys(other for row in rows for other in row.others(effect)))


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


def circumstances_of(plant: Plant, fits: Sequence[Record], root: Node) -> frozenset[Circumstance]:
    """What holds of the plant and its records, for the table of ambiguities."""
    found: set[Circumstance] = set()
    if plant.n_states <= 2 and plant.n_outputs == 1 and plant.n_inputs <= 1:
        found.add("one_dof")
    per_mass = [port for port in plant.ports if port.mass is not None and port.force_unit == f"{port.length_unit}/s^2"]
    if per_mass and "one_dof" not in found:
        found.add("unknown_masses")  # forces are counted per effective mass
    if plant.n_outputs == 1:
        found.add("one_output")
    sizes = [float(np.sqrt(np.nansum(np.nanvar(r.inputs if r.n_inputs else r.outputs, axis=0)))) for r in fits]
    if min(sizes) <= 0.0 or max(sizes) / min(sizes) < SAME_LEVEL:
        found.add("one_level")
    n = plant.n_states
    states = root.coarse.trajectory.states[:, :n]
    drive = root.coarse.trajectory.drive
    speeds = [
        states @ port.velocity[:n] + drive.sample @ port.velocity[n:]
        for port in plant.ports
        if port.velocity is not None
    ]
    if speeds and all(min(-speed.min(), speed.max()) < 0.01 * np.abs(speed).max() for speed in speeds):
        found.add("one_way")
    return frozenset(found)


def advise(decision: Decision, fits: Sequence[Record], circumstances: frozenset[Circumstance]) -> tuple[str, ...]:
    """What to measure next."""
    words: list[str] = []
    by_level = False
    for i, ((effect, where), runner) in enumerate(zip(decision.node.effects, decision.runners, strict=False)):
        rows = ambiguous_with(effect, circumstances=circumstances, even_with=even_rivals(decision, i))
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
