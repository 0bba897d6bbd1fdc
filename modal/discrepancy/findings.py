"""The effects found, with parameters, evidence and what they cannot be told from."""

from collections.abc import Sequence

import numpy as np

from modal.discrepancy.ambiguity import Circumstance, ambiguous_with
from modal.discrepancy.decision import Decision
from modal.discrepancy.diagnosis import Evidence, Finding, Hypothesis, Parameter
from modal.discrepancy.effect_units import parameter_units
from modal.discrepancy.nodes import Node, Task, log_likelihood_gain
from modal.discrepancy.plant import Plant
from okid.arrays import FloatArray

__all__ = ["findings_of", "hypothesis_of"]


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
                evidence=_evidence(decision, root, task, i, margin),
                runner_up=None if runner is None else hypothesis_of(runner, root, task),
                ambiguous_with=_others(item.effect.key, circumstances),
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


def _evidence(decision: Decision, root: Node, task: Task, i: int, margin: float) -> Evidence:
    node = decision.node
    gain = log_likelihood_gain(root, node, task)
    before, after = max(root.held_out_level - 1.0, 1e-12), max(node.held_out_level - 1.0, 0.0)
    closed = 1.0 - after / before if np.isfinite(before) else 1.0
    lead = "no other hypothesis comes near" if not np.isfinite(margin) else _lead(margin)
    also = " (with the other effects)" if len(node.effects) - len(root.effects) > 1 else ""
    words = (
        f"the held-out mean square falls from {root.held_out_level:.4g} to {node.held_out_level:.3g} times the noise "
        f"floor{also}; {lead}"
    )
    del i
    return Evidence(closed=float(np.clip(closed, -np.inf, 1.0)), log_likelihood=gain, margin=margin, words=words)


def _lead(margin: float) -> str:
    if margin >= 0.0:
        return f"it leads the next by 2 ln L = {margin:.0f}"
    return f"another hypothesis is more likely by 2 ln L = {-margin:.0f}"


def _others(effect: str, circumstances: frozenset[Circumstance]) -> tuple[str, ...]:
    rows: Sequence[str] = [
        other for row in ambiguous_with(effect, circumstances=circumstances) for other in row.others(effect)
    ]
    return tuple(dict.fromkeys(rows))
