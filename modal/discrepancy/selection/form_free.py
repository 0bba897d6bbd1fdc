"""Laws of unknown form where no law with a name is enough: the curve is the answer, or stands beside a sharp law.

Form first, name second: a law with a name passes the test of what it leaves, or a smooth law of the displacement or the
velocity is fitted at every place that the screen shows, by 9 points, then 15, then 25 where it still leaves something
of its own motion. Where one alone does not do, it is tried beside the law that was best (dry friction with a smooth law
of the velocity is a friction that falls with speed).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import cast

import numpy as np

from modal.discrepancy.fitting.estimation import FAR_ABOVE, estimate, simulate_at
from modal.discrepancy.fitting.nodes import Node, Task, counts, node_of
from modal.discrepancy.fitting.observed_fits import CLEAR
from modal.discrepancy.selection.beam import expand
from modal.discrepancy.selection.lack_of_fit import lack_of_fit, what_is_left
from modal.effects.smooth_law import N_POINTS, SmoothLaw
from modal.simulation.assembly import Unknowns
from modal.simulation.scheme import Budget
from modal.simulation.tolerances import explained
from okid.arrays import FloatArray

MOST_WORK = 5e7
"""End the search for curves beside one model after so much work, about ten CPU seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveSearch:
    """`curves_beside`, once beside each model: the decision asks again where the search has found nothing.

    Attributes:
        done: Model and what was found, by the model's `id`.
    """

    done: dict[int, tuple[Node, list[Node]]] = field(default_factory=dict)

    def __call__(self, parent: Node, root: Node, task: Task) -> list[Node]:
        """Models with a law of unknown form more, as the first time."""
        if id(parent) not in self.done:
            self.done[id(parent)] = parent, curves_beside(parent, root, task)
        return self.done[id(parent)][1]


def curves_beside(parent: Node, root: Node, task: Task) -> list[Node]:
    """Models with a law of unknown form more that leave nothing but noise, and count as any other effect must.

    Its many points take up some of whatever is left, an unmeasured force too.

    Args:
        parent: The model that it stands beside.
        root: The calibrated model.
        task: Records, and the laws of unknown form.
    """
    budget = Budget(MOST_WORK)
    if not budget.allows():  # the CPU time is spent
        return []
    near_enough = max(FAR_ABOVE, 1.0 + CLEAR * (root.fit_level - 1.0))  # for more points to do
    reached = min(task.reached, near_enough)  # in observer form it comes nearer than in free run
    found = expand(parent, replace(task, catalogue=task.form_free, budget=budget, reached=reached))
    found = [one for one in found if one.held_out is not None and len(one.effects) > len(parent.effects)]
    ranked = sorted(found, key=lambda node: node.held_out_level)  # other masses are no law
    near = [node for node in ranked if explained(node.held_out_level)] or [
        node for node in ranked[:1] if node.fit_level <= near_enough
    ]
    each = (next((one for one in chain([node], _finer(node, task)) if _passes(one, root, task)), None) for node in near)
    return [node for node in each if node is not None and counts(parent, node, task)]


def unsettled(node: Node, task: Task, motion: FloatArray) -> FloatArray:
    """How far the last law of a model, of unknown form, moves with more points: what too few cannot follow.

    Between two points it is the largest that counts: that both curves cross somewhere says nothing for the law there.

    Args:
        node: The model.
        task: What it was fitted to.
        motion: (n,) where.

    Returns:
        (n,) size of the change, the linear part of the same motion counted in; 0 where it has the most points.
    """
    finer = next(_finer(node, task), None)
    if finer is None:
        return np.zeros_like(motion)
    forces, intervals = [], np.zeros(0, dtype=int)
    for fitted in (finer.coarse, node.coarse):
        *others, item = fitted.assembly.placements
        span = fitted.assembly.common_of(len(others))
        law, values = cast("SmoothLaw", item.effect), fitted.unknowns.common[span]
        linear = law.linear_name(item.where)
        slope = sum(
            fitted.unknowns.common[j] for j, one in enumerate(fitted.assembly.plant.parameters) if one.name == linear
        )
        forces.append(law.curve(values[: len(item.common)], motion) + slope * motion)
        intervals = law.intervals(values[: len(item.common)], motion)
    largest = np.zeros(intervals.max(initial=0) + 1)
    np.maximum.at(largest, intervals, np.abs(forces[1] - forces[0]))
    return np.asarray(largest[intervals])


def _passes(node: Node, root: Node, task: Task) -> bool:
    """Whether a model explains the data and leaves nothing of its own motion, nor much else."""
    if not explained(node.fit_level, node.held_out_level):
        return False
    return not what_is_left(lack_of_fit(node, task, known=len(root.effects)), node, root)[0]


def _finer(node: Node, task: Task) -> Iterator[Node]:
    """The same with more and more points."""
    for n_points in N_POINTS[1:]:
        fitted = node.coarse
        *others, item = fitted.assembly.placements
        if not isinstance(item.effect, SmoothLaw):
            return
        if n_points <= item.effect.n_points:
            continue
        span = fitted.assembly.common_of(len(others))
        kept = span.start + len(item.common)
        law, values = item.effect.refined(fitted.unknowns.common[span.start : kept], n_points)
        assembly = replace(fitted.assembly, placements=(*others, replace(item, effect=law)))
        common = [*fitted.unknowns.common[: span.start], *values, *fitted.unknowns.common[kept:]]
        unknowns = Unknowns(common=np.array(common), local=fitted.unknowns.local)
        start = simulate_at(
            assembly, unknowns, task.fit, states=fitted.trajectory.states, smoothing=fitted.smoothing, start="near"
        )
        if start is None:
            return
        node = node_of(estimate(start, task.fit, iterations=12), task, node.held_out)
        yield node
