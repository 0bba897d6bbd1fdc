"""Decide what is missing: named, unresolved or none, from the models that the search has fitted.

`named` needs three things: within 1.5 of the noise floor on held-out data; every effect of the model earns its place
(without it the held-out mean square rises by a tenth and the likelihood falls); and a lead over every model with
another effect or place, other than those that by structure cannot be told apart. Anything less is a best guess.

Where any linear force inside a state space is free (`internal_changes`), a wrong gain of a sensor or an input is hardly
more than another set of such forces: both explain the records. The model as given tells them apart, because with the
gain it stays where it was.

An effect is none in many ways: a brim without a flow over it, or a limit that no level reaches, at whatever rate. Its
distance from none cannot be that of one parameter from its neutral value. What counts is what the effect does to the
outputs. With delta the outputs with it less those without it, in deviations of the noise, and J what all else in the
model could do instead,

    z^2 = delta' (I - J (J' J + prior)^-1 J') delta

For an effect in proportion to one parameter this is the parameter over its standard deviation (Wald's test); it is the
same however the parameters are chosen; and z^2 is what 2 ln L would lose at first order without the effect. The
effect's own shapes count as what could be done instead, its amplitudes do not; of an effect that has no amplitude (a
delay, the limit of a drive) nothing of its own does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import (
    FAR_ABOVE,
    Estimate,
    Problem,
    estimate,
    score_equations,
    sensitivity_of,
    simulate_at,
    weights_along,
)
from modal.discrepancy.fitting.nodes import (
    SMALLEST_FALL,
    SMALLEST_GAIN,
    Node,
    Task,
    counts,
    fitted_either_way,
    log_likelihood_gain,
    node_of,
)
from modal.discrepancy.selection.smaller_models import has_limit, run_without, with_limits, with_twins, without
from modal.effects.ambiguity import Circumstance, ambiguous_with
from modal.effects.catalogue import CATALOGUE, effects_at
from modal.simulation.assembly import Assembly, Unknowns, place_effect
from modal.simulation.drive import IndexArray
from modal.simulation.sensitivity import Sensitivity
from modal.simulation.tolerances import NEAR_FLOOR, SURE
from modal.simulation.trajectory import SHARP
from modal.structure.reciprocity import INTERNAL_FORCE
from modal.wording.numbers import number, times_floor_text
from okid.arrays import TINY, FloatArray

__all__ = ["AbsorbedGain", "Decision", "absorbed_gain", "covariance", "decide_nodes", "held_unknowns", "sureness"]

ITERATIONS, LONGEST = 20, 60
"""End the fit that finds a gain after the first, and one to its end after the second number of iterations."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AbsorbedGain:
    """A gain that explains a calibration.

    Attributes:
        node: The calibrated model with it.
        without: The same without it, calibrated anew.
        fall: By how much the cost of the first is lower, the priors of the calibration included, as 2 ln L.
    """

    node: Node
    without: Node
    fall: float


def absorbed_gain(root: Node, task: Task) -> AbsorbedGain | None:
    """The one gain that explains the calibration of a model, where there is one.

    The best one; None where no internal force is free, or no gain is worth 30.
    """
    plant = root.coarse.assembly.plant
    if not any(one.name.startswith(INTERNAL_FORCE) for one in plant.parameters):
        return None
    if _moved(root) <= SMALLEST_GAIN:  # no gain saves more than the calibration has cost
        return None
    alone = _alone(root, task)
    channels = {"input_gain": plant.input_names, "sensor_gain": plant.output_names}
    found: AbsorbedGain | None = None
    for key, names in channels.items():
        for where in names if task.catalogue.get(key) is CATALOGUE[key] else ():
            one = None if (key, where) in root.effects else _with_gain(root, alone, key, where, task)
            if one is not None and one.fall > (SMALLEST_GAIN if found is None else found.fall):
                found = one
    return found


def _moved(root: Node) -> float:
    """What the calibration costs by the priors of the linear parameters."""
    assembly = root.coarse.assembly
    centre, deviation = assembly.prior()
    moved = (root.coarse.unknowns.common - centre)[: assembly.n_linear] / deviation[: assembly.n_linear]
    return float(np.sum(moved**2))


def _alone(root: Node, task: Task) -> Estimate | None:
    """The calibration as it is, fitted to its end by the noise floor of now."""
    coarse = root.coarse
    start = simulate_at(coarse.assembly, coarse.unknowns, task.fit, states=coarse.trajectory.states)
    return None if start is None else _settled(start, task)


def _with_gain(root: Node, alone: Estimate | None, key: str, where: str, task: Task) -> AbsorbedGain | None:
    """The model with a gain, from the linear parameters as given; None where it does not explain the data or save 30.

    The calibration without it is fitted from there as well, and the better way counts.
    """
    before = root.coarse.assembly
    effect = CATALOGUE[key]
    assembly = replace(before, placements=(*before.placements, place_effect(before.plant, effect, where)))
    common = np.concatenate([before.plant.nominal, root.coarse.unknowns.common[before.n_linear :], effect.neutral])
    unknowns = Unknowns(common=common, local=root.coarse.unknowns.local)
    start = simulate_at(assembly, unknowns, task.fit, states=root.coarse.trajectory.states)
    if start is None:
        return None
    node = node_of(_settled(fitted_either_way(start, task.fit, iterations=ITERATIONS), task), task)
    if alone is None or max(node.fit_level, node.held_out_level) > NEAR_FLOOR:
        return None
    if alone.cost - node.coarse.cost <= SMALLEST_GAIN:
        return None
    start = run_without(node.coarse, len(assembly.placements) - 1, task.fit, smoothing=SHARP)
    other = alone if start is None else _settled(start, task)
    rival = other if other.cost < alone.cost else alone
    return AbsorbedGain(node=node, without=node_of(rival, task), fall=rival.cost - node.coarse.cost)


def _settled(start: Estimate, task: Task) -> Estimate:
    """Fitted until an iteration gains less than 1: the valley of the internal forces is long and flat."""
    return estimate(start, task.fit, iterations=LONGEST, standstill=1.0 / max(start.cost, 1.0))


def covariance(current: Estimate, problem: Problem) -> FloatArray:
    """Covariance of all unknowns at the estimate, scaled by the residual where that is above the floor.

    What is held, or sits on a hard bound, has none: the others' is that given the bound.
    """
    gram, _ = score_equations(current, problem, sensitivity_of(current, problem))
    held = held_unknowns(current)
    gram[held, :] = 0.0
    gram[:, held] = 0.0
    scale = np.sqrt(np.maximum(np.diag(gram), TINY))
    inverse = scipy.linalg.pinvh(gram / np.outer(scale, scale)) / np.outer(scale, scale)
    inverse[held, :] = 0.0
    inverse[:, held] = 0.0
    return np.asarray(inverse * max(1.0, current.level))


def held_unknowns(current: Estimate) -> IndexArray:
    """Which common unknowns are held, or sit on a hard bound."""
    lower, upper = current.assembly.bounds()
    return np.flatnonzero((lower == upper) | current.at_bounds)


def sureness(node: Node, task: Task) -> list[float]:
    """How many deviations each effect of a model is from none.

    One number for each effect; infinite where the model without it escapes.
    """
    current, problem = node.coarse, task.fit
    slopes = sensitivity_of(current, problem)
    gram, _ = score_equations(current, problem, slopes)
    held = held_unknowns(current)
    found = []
    for i in range(len(current.assembly.placements)):
        change = _change(current, problem, i)
        if change is None:
            found.append(np.inf)
            continue
        others = np.ones(len(gram), dtype=bool)
        others[held] = False
        others[_own(current.assembly, i)] = False
        seen = _against(problem, current, slopes, change)[others]
        left = float(np.sum(change**2)) - float(seen @ _solved(gram[np.ix_(others, others)], seen))
        found.append(float(np.sqrt(max(left, 0.0) / max(1.0, current.level))))
    return found


def _change(current: Estimate, problem: Problem, placement: int) -> FloatArray | None:
    """(n_rows, n_outputs) what an effect does to the outputs, all else as it is, in deviations of the noise."""
    off = run_without(current, placement, problem, smoothing=current.smoothing)
    if off is None:
        return None
    change = (current.trajectory.outputs - off.trajectory.outputs) * weights_along(problem, current.trajectory)
    return change if np.isfinite(np.sum(change**2)) else None


def _own(assembly: Assembly, placement: int) -> list[int]:
    """Where the amplitudes of an effect stand, or all that it has where it has none."""
    item, begin = assembly.placements[placement], assembly.common_of(placement).start
    roles = [item.effect.parameters[j].role for j in item.common]
    found = [begin + position for position, role in enumerate(roles) if role == "amplitude"]
    return found or [begin + position for position in range(len(roles))]


def _against(problem: Problem, current: Estimate, slopes: Sensitivity, change: FloatArray) -> FloatArray:
    """What each unknown's effect on the outputs has in common with a change, in the order of the normal equations."""
    drive, weights = problem.drive, weights_along(problem, current.trajectory)
    found = [np.sum(slopes.common * weights * change, axis=(1, 2))]
    for record in range(drive.n_records):
        rows = drive.rows_of(record)
        found.append(np.sum(slopes.local[:, rows] * weights[rows] * change[rows], axis=(1, 2)))
    return np.concatenate(found)


def _solved(gram: FloatArray, right: FloatArray) -> FloatArray:
    scale = np.sqrt(np.maximum(np.diag(gram), TINY))
    return np.asarray(scipy.linalg.pinvh(gram / np.outer(scale, scale)) @ (right / scale) / scale)


MOST_ON_FIT = 2.0
"""Name nothing firmly above this level on the records to fit: they hold levels that the held-out ones may lack."""

MOST_FIRM = 2
"""Name at most so many effects together without doubt: combinations of more were never proved."""

SAME = 1.05
"""Rank models by the likelihood of all records where their held-out mean squares differ by less than this."""

CLOSE_COMPANY = SMALLEST_GAIN
"""Call a lead in 2 ln L below this no lead."""
CLEAR_RISE = 3.0
"""Keep an effect without which the held-out mean square rises by this factor, however uncertain its size."""
LEAST_SURE = 5.0
"""Drop an effect nearer to none than so many standard deviations: 2 ln L of 30 is five and a half."""
SHARP_SHARE = 0.05
"""Count a parameter as found at its known value within three deviations of it, where these are below this share of
it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Decision:
    """What was decided.

    Attributes:
        status: "named", "unresolved" or "none".
        node: The model chosen (the calibrated linear model for "none").
        runners: For each effect of it, the best other model without that effect at that place, None if there is none.
        margins: 2 ln L by which the chosen model leads each runner-up.
        reasons: Why it is not firm, in words; empty for "named" and "none".
    """

    status: Literal["named", "unresolved", "none"]
    node: Node
    runners: tuple[Node | None, ...]
    margins: tuple[float, ...]
    reasons: tuple[str, ...]


def decide_nodes(
    nodes: Sequence[Node], task: Task, *, circumstances: frozenset[Circumstance] = frozenset()
) -> Decision:
    """Choose among the models that the search has fitted, the first being the linear one."""
    root = nodes[0]
    earned = [node for node in nodes if node is root or counts(root, node, task)]
    best = _best(earned, root, task)
    if best is root:
        return _nothing(root, task)
    best = _pruned(best, root, task)
    equals = [node for node in earned if len(node.effects) == len(best.effects)]
    equals = [node for node in equals if node.held_out_level <= max(SAME * best.held_out_level, 1.0)]
    if len(equals) > 1 and best.held_out_level <= FAR_ABOVE:
        best = max(
            [best, *equals], key=lambda node: log_likelihood_gain(root, node, task) - _cost_of_freedom(node, task)
        )
    if best is root:
        return _nothing(root, task)
    richer, best = best, _simplest(best, root, task)
    runners, margins, reasons = [], [], []
    twins = [best, *(with_twins(best, task, nodes) if best.held_out_level <= NEAR_FLOOR else [])]
    others = [*nodes, richer, *twins]
    best = max(twins, key=lambda node: log_likelihood_gain(root, node, task))
    for effect in best.effects:
        rivals = [node for node in others if node is not root and _rivals(node, best, effect, task)]
        runner = _strongest(rivals, root, task)
        margin = np.inf if runner is None else log_likelihood_gain(runner, best, task)
        runners.append(runner)
        margins.append(float(margin))
        if runner is not None and margin < CLOSE_COMPANY and not _ambiguous(effect, runner, circumstances):
            named = effects_at(runner.effects)
            how = f"nearly as well (2 ln L lower by {margin:.0f} only)" if margin >= 0.0 else "no worse"
            reasons.append(f"{named} explains the data {how}")
    if best.held_out_level > NEAR_FLOOR:
        reasons.append(
            f"the held-out gap is still {times_floor_text(best.held_out_level)} times the noise floor (limit "
            f"{times_floor_text(NEAR_FLOOR)})"
        )
    reasons += _unproved(best, root) + _untried(best, task, most=len(best.effects) - len(root.effects))
    return Decision(
        status="unresolved" if reasons else "named",
        node=best,
        runners=tuple(runners),
        margins=tuple(margins),
        reasons=tuple(reasons),
    )


def _unproved(best: Node, root: Node) -> list[str]:
    """Why a model that explains the held-out records is still not firm."""
    reasons = []
    if best.held_out_level <= NEAR_FLOOR and best.fit_level > MOST_ON_FIT:
        reasons.append(
            f"on the records to fit the gap is still {times_floor_text(best.fit_level)} times the noise floor (limit "
            f"{times_floor_text(MOST_ON_FIT)})"
        )
    found = len(best.effects) - len(root.effects)
    if found > MOST_FIRM:
        reasons.append(
            f"{found} effects at once fit many a law that is none of them: {MOST_FIRM} at most are named firmly"
        )
    return reasons


def _untried(best: Node, task: Task, *, most: float) -> list[str]:
    """Whether models with no more effects were left untried, or any where the best does not explain the data."""
    explained = best.held_out_level <= NEAR_FLOOR
    if not task.budget.spent or (explained and task.budget.untried > most):
        return []
    words = (
        "the search was ended before every effect was tried, because it cost as much as it may: what is missing may "
        "not be in the catalogue, or the motion is hard to follow; try fewer effects, or a part of the records"
    )
    return [words]


def _nothing(root: Node, task: Task) -> Decision:
    """No effect is found: nothing is missing where the linear model explains the data, and else what is stays open."""
    if root.held_out_level <= NEAR_FLOOR and root.fit_level <= NEAR_FLOOR:
        absorbed = absorbed_gain(root, task)
        if absorbed is not None:
            return _absorbed(root, absorbed)
        return Decision(status="none", node=root, runners=(), margins=(), reasons=())
    tried = "no effect that was tried" if task.budget.spent else "no effect of the catalogue"
    reasons = (f"{tried} brings the held-out error down by a tenth", *_untried(root, task, most=np.inf))
    return Decision(status="unresolved", node=root, runners=(), margins=(), reasons=reasons)


def _absorbed(root: Node, found: AbsorbedGain) -> Decision:
    """A gain that only the model as given shows: never firm, because the records do not tell."""
    reason = (
        "the calibration explains the records as well without it, by internal forces further from the model as given "
        f"(2 ln L lower by {number(found.fall, 2)} with their prior); check the gain, or give a model whose structure "
        "is known (M, C and K)"
    )
    before = len(root.effects)
    return Decision(
        status="unresolved",
        node=found.node,
        runners=(*(None,) * before, found.without),
        margins=(*(float("inf"),) * before, found.fall),
        reasons=(reason,),
    )


def _best(nodes: Sequence[Node], root: Node, task: Task) -> Node:
    """The model with the fewest effects that explains the data; among its equals the most likely one.

    Far above the floor what is left is no noise, and the likelihood counts it as if it were: there the held-out error
    alone decides among those with the fewest effects.
    """
    lowest = min(node.held_out_level for node in nodes)
    if not np.isfinite(lowest):
        return root
    enough = max(SAME * lowest, 1.0)
    good = [node for node in nodes if node.held_out_level <= enough]
    within = [node for node in nodes if node.held_out_level <= min(NEAR_FLOOR, (1.0 + SMALLEST_FALL) * enough)]
    fewest = min(len(node.effects) for node in (within or good))
    equals = [node for node in (within or good) if len(node.effects) == fewest]
    if lowest > FAR_ABOVE:
        return min(equals, key=lambda node: node.held_out_level)
    return max(equals, key=lambda node: log_likelihood_gain(root, node, task) - _cost_of_freedom(node, task))


def _cost_of_freedom(node: Node, task: Task) -> float:
    """ln(n) a free parameter (Schwarz 1978); one that is found at the value known beforehand is not free."""
    assembly, problem = node.coarse.assembly, task.fit
    n_values = int(problem.drive.present.sum() + task.held_out.drive.present.sum())
    free = 0
    for i, item in enumerate(assembly.placements):
        free += len(item.common) + item.n_directions - len(item.held)
        known = item.effect.known_values("" if item.port is None else item.port.length_unit)
        if any(value is not None for value in known):
            free -= _found_as_known(node, i, known, problem)
    return free * float(np.log(n_values))


def _found_as_known(node: Node, i: int, known: Sequence[float | None], problem: Problem) -> int:
    """How many parameters of an effect came out at their known values, and sharply so."""
    item, span = node.coarse.assembly.placements[i], node.coarse.assembly.common_of(i)
    spread = np.sqrt(np.maximum(np.diag(covariance(node.coarse, problem)), 0.0))[span]
    values = node.coarse.unknowns.common[span]
    return sum(
        abs(value - wanted) <= SURE * deviation and deviation <= SHARP_SHARE * abs(wanted)
        for j, value, deviation in zip(item.common, values, spread, strict=False)
        if (wanted := known[j]) is not None
    )


def _strongest(nodes: Sequence[Node], root: Node, task: Task) -> Node | None:
    return max(nodes, key=lambda node: log_likelihood_gain(root, node, task), default=None)


def _pruned(best: Node, root: Node, task: Task) -> Node:
    """The model without effects that it does not need."""
    while len(best.effects) > 1:
        sure = sureness(best, task)
        smaller = [without(best, i, task) for i in range(len(best.effects))]
        needless = [
            node for node, z in zip(smaller, sure, strict=True) if not counts(node, best, task) or _weak(node, best, z)
        ]
        if not needless:
            return best
        best = min(needless, key=lambda node: node.held_out_level)
    return best if best is root or counts(root, best, task) else root


def _simplest(best: Node, root: Node, task: Task) -> Node:
    """The model, or one with a limit of a law in its place that does as well on held-out records."""
    if best.held_out_level > NEAR_FLOOR:
        return best
    most = min(SAME * best.held_out_level, NEAR_FLOOR)
    enough = [one for one in with_limits(best, task) if one.held_out_level <= most and counts(root, one, task)]
    return min(enough, key=lambda node: node.held_out_level, default=best)


def _rivals(node: Node, best: Node, effect: tuple[str, str], task: Task) -> bool:
    """Whether a model explains the data without an effect of the best one.

    A richer law of which the effect is a limit always fits about as well; it is a rival where it clearly fits better.
    """
    if effect in node.effects or not np.isfinite(node.held_out_level):
        return False
    contains = any(where == effect[1] and has_limit(key, effect[0]) for key, where in node.effects)
    return not contains or log_likelihood_gain(best, node, task) > CLOSE_COMPANY


def _weak(smaller: Node, best: Node, z: float) -> bool:
    """Whether an effect may be none by what it changes in the outputs, and the held-out error does not clearly need it.

    The size of a hard limit (a brim, a stop) is hardly known where anything large will do: only the error tells.
    """
    return z < LEAST_SURE and smaller.held_out_level < CLEAR_RISE * best.held_out_level


def _ambiguous(effect: tuple[str, str], runner: Node, circumstances: frozenset[Circumstance]) -> bool:
    others = {key for row in ambiguous_with(effect[0], circumstances=circumstances) for key in row.others(effect[0])}
    return any(key in others for key, _ in runner.effects)
