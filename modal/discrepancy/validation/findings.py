"""The effects found, with parameters, evidence and what they cannot be told from."""

import numpy as np

from modal.discrepancy.fitting.nodes import Node, Task, log_likelihood_gain
from modal.discrepancy.results import Evidence, Finding, Hypothesis, Parameter
from modal.discrepancy.selection.decision import CLOSE_COMPANY, Decision
from modal.effects.ambiguity import Circumstance, ambiguous_with
from modal.effects.effect_units import parameter_units
from modal.simulation.plant import Plant
from modal.wording.statements import times_floor_text
from okid.arrays import FloatArray

__all__ = ["even_rivals", "findings_of", "hypothesis_of"]


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

    Args:
        decision: The decision.
        i: Number of the effect in the chosen model.

    Returns:
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
