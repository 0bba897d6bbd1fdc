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
import numpy.typing as npt
import scipy

from modal.discrepancy.fitting.estimation import FAR_ABOVE, Estimate, estimate, simulate_at
from modal.discrepancy.fitting.nodes import Node, Task, counts, node_of
from modal.discrepancy.fitting.observed_fits import CLEAR
from modal.discrepancy.noise.spectral import log_chi_square_tail
from modal.discrepancy.selection.beam import expand
from modal.discrepancy.selection.lack_of_fit import lack_of_fit, what_is_left
from modal.effects.smooth_law import N_POINTS, SmoothLaw
from modal.simulation import UNLIKELY, explained
from modal.simulation.assembly import Unknowns
from modal.simulation.scheme import Budget
from okid.arrays import ROUNDED, TINY, FloatArray

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


def split_at_rest(fitted: Estimate, spread: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """How far a smooth law and the linear part of its motion may be moved against each other.

    The records know the sum of the two. What tells them apart is the slope of the curve at rest, which hangs on how
    smooth the curve is taken to be: a law like |v|^1.5 is steeper next to rest than any spline, and the linear part
    takes up the slope. How much hangs on it is seen without the points next to rest: with x the law's forces and J x
    their jumps of the third derivative at these points, the constraint J x = 0 makes one cubic of those on both sides
    of each, and with all else free the unknowns of covariance C move by

        move = -C J' (J C J')^-1 J x        lack = x' J' (J C J')^-1 J x,  chi-square of as many degrees as rows of J

    A law that is smooth over its points moves by no more than its chance. Where chance does not make the lack of the
    pair next to rest, closer points would move the split again. With a the move by the pair after it and b that by the
    pair next to rest, if b is at most half of a the moves are seen to converge, and the sum of all that follow,
    b r / (1 - r) with r = b / a, is counted: next to nothing of a strong sinh. Of a law without a curvature at rest the
    moves hardly fall: then nothing says where the split ends, and what both pairs move is counted.

    Args:
        fitted: The model.
        spread: (n, n) covariance of all unknowns.

    Returns:
        (n_common,) the moves of the linear parts and of the laws' own forces, 0 for all others; and the names of the
        linear parts beside laws with moves that do not converge.

    References:
        Wald, Tests of statistical hypotheses concerning several parameters when the number of observations is large,
        Trans. Amer. Math. Soc. 54, 1943, https://doi.org/10.1090/S0002-9947-1943-0012401-3
    """
    assembly, common = fitted.assembly, fitted.unknowns.common
    moves, unresolved = np.zeros(assembly.n_common), []
    for i, item in enumerate(assembly.placements):
        if not isinstance(item.effect, SmoothLaw):
            continue
        law, start = item.effect, assembly.common_of(i).start
        name, own = law.linear_name(item.where), np.arange(start, start + len(item.common))
        linear = next((j for j, one in enumerate(assembly.plant.parameters) if one.name == name), None)
        if linear is None:
            continue
        first, likely = _without(law.bends(common[own], 1), own, common, spread)
        both, _ = (first, likely) if likely else _without(law.bends(common[own], 2), own, common, spread)
        last, before = (float(abs(one[linear])) for one in (first, both - first))
        size = np.abs(first)
        if not likely and 2.0 * last <= before:
            size *= last / max(before - last, TINY)
        elif not likely:
            size = np.maximum(size, np.abs(both))
            unresolved.append(name)
        moves[[linear, *own]] = size[[linear, *own]]
    return moves, tuple(unresolved)


def _without(
    bends: FloatArray, own: npt.NDArray[np.intp], common: FloatArray, spread: FloatArray
) -> tuple[FloatArray, bool]:
    """(n_common,) the step to the best model without some bends of a law, and whether chance may have made these."""
    if not len(bends):
        return np.zeros(len(common)), True
    crossed = bends @ spread[own]
    size = np.sqrt(np.maximum(np.einsum("nj,nj->n", crossed[:, own], bends), TINY))
    inverse = scipy.linalg.pinvh(crossed[:, own] @ bends.T / np.outer(size, size), rtol=ROUNDED)
    found = bends @ common[own] / size
    lack = float(found @ inverse @ found)
    step = -(crossed / size[:, np.newaxis]).T @ (inverse @ found)
    return step[: len(common)], log_chi_square_tail(lack, len(bends)) > np.log(UNLIKELY)


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
