"""A model with an effect less, or with a simpler law in its place, fitted again: whether it needs what it has."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, estimate, simulate_at
from modal.discrepancy.fitting.nodes import Node, Task, node_of, polished
from modal.simulation.assembly import Assembly, EffectPlacement, Unknowns
from modal.simulation.trajectory import SHARP
from okid.arrays import FloatArray

__all__ = ["dropped", "instead", "run_without", "without"]

SOFT = 0.03
"""Width of a sharp law in the first fit, as a share of the motion's scale."""
ROUGH, CLEARLY = 0.02, (100.0, 30.0, 10.0)
"""Without an effect that it needs, a model is fitted, and then judged, only as far as its cost, after every four
iterations, stays within these factors of the whole model's; an iteration that gains less than the first share ends the
four."""


def dropped(fitted: Estimate, placement: int) -> tuple[Assembly, Unknowns]:
    """The model without one of its effects, all else as it is.

    Args:
        fitted: The model.
        placement: Which effect, by its position.
    """
    assembly = fitted.assembly
    kept = [i for i in range(len(assembly.placements)) if i != placement]
    smaller = replace(assembly, placements=tuple(assembly.placements[i] for i in kept))
    common = np.delete(fitted.unknowns.common, np.r_[assembly.common_of(placement)])
    local = np.delete(fitted.unknowns.local, np.r_[assembly.own_of(placement)], axis=1)
    return smaller, Unknowns(common=common, local=local)


def run_without(fitted: Estimate, placement: int, problem: Problem, *, smoothing: float) -> Estimate | None:
    """The model run without one of its effects, all else as it is.

    Args:
        fitted: The model.
        placement: Which effect, by its position.
        problem: Its records.
        smoothing: Width of sharp laws, as a share of the motion's scale.

    Returns:
        None where the motion escapes.
    """
    smaller, unknowns = dropped(fitted, placement)
    return simulate_at(smaller, unknowns, problem, states=_other_states(fitted, placement), smoothing=smoothing)


def _other_states(fitted: Estimate, placement: int) -> FloatArray:
    """The trajectory without the states of one effect: the smaller model's is sought from there."""
    return np.delete(fitted.trajectory.states, np.r_[fitted.assembly.memory_of(placement)], axis=1)


def without(node: Node, placement: int, task: Task) -> Node:
    """The model refitted without one of its effects.

    Args:
        node: The model.
        placement: Which effect, by its position.
        task: Records.
    """
    return _compared(run_without(node.coarse, placement, task.fit, smoothing=SHARP), node, task)


def instead(node: Node, placement: int, law: EffectPlacement, values: Sequence[float], task: Task) -> Node:
    """The model refitted with another law at the place of one of its effects, from these values.

    The law has no states and no values of a record of its own. It is fitted softened first, because a sharp law along a
    motion that it does not fit is hard to simulate.

    Args:
        node: The model.
        placement: Which effect, by its position.
        law: What stands there instead.
        values: Of its common parameters.
        task: Records.
    """
    fitted = node.coarse
    assembly = fitted.assembly
    items = list(assembly.placements)
    items[placement] = law
    own, span = assembly.own_of(placement), assembly.common_of(placement)
    directions = fitted.unknowns.common[span][len(assembly.placements[placement].common) :]
    common = np.concatenate(
        [fitted.unknowns.common[: span.start], values, directions, fitted.unknowns.common[span.stop :]]
    )
    local = np.delete(fitted.unknowns.local, np.r_[own], axis=1)
    changed, unknowns = replace(assembly, placements=tuple(items)), Unknowns(common=common, local=local)
    states = _other_states(fitted, placement)
    start = simulate_at(changed, unknowns, task.fit, states=states, smoothing=SOFT, start="near")
    if start is None:
        return _compared(None, node, task)
    soft = estimate(start, task.fit, iterations=4, standstill=ROUGH)
    whole = simulate_at(
        assembly, fitted.unknowns, task.fit, states=fitted.trajectory.states, smoothing=SOFT, start="near"
    )
    if whole is not None and soft.cost > CLEARLY[0] * max(whole.cost, fitted.cost):
        return _compared(None, node, task)
    sharp = simulate_at(changed, soft.unknowns, task.fit, states=soft.trajectory.states, smoothing=SHARP)
    return _compared(sharp, node, task)


def _compared(start: Estimate | None, node: Node, task: Task) -> Node:
    """A smaller model, fitted and judged only as far as it stays near the whole one."""
    if start is None:
        return Node(fitted=node.coarse, held_out=None, coarse=node.coarse)
    rough = start
    for far in CLEARLY:
        rough = estimate(rough, task.fit, iterations=4, standstill=ROUGH)
        if rough.cost > far * node.coarse.cost:
            return Node(fitted=rough, held_out=None, coarse=rough)
    return polished(node_of(estimate(rough, task.fit, iterations=12), task, node.held_out), task)
