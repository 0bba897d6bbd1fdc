"""A model with an effect less, or a simpler law, or one law in the place of two, fitted again: whether it needs it all.

A link that never slips is a gap spring, one that slips at once is dry friction: limits of a richer law, which are
fitted before it. What came later (another mass, a second effect) was added to the richer law alone: then its limit must
be tried there too.

A calibration may take up a gain: where any linear force inside a state space is free (`internal_changes`), a wrong gain
of a sensor or an input is hardly more than another set of such forces, and both explain the records. The model as given
tells them apart, because with the gain it stays where it was.

An effect is none in many ways: a brim without a flow over it, a limit that no level reaches. Its distance from none is
not that of one parameter from its neutral value, but what it does to the outputs. With delta the outputs with it less
those without it, in deviations of the noise, and J what all else in the model could do instead,

    z^2 = delta' (I - J (J' J + prior)^-1 J') delta

For an effect in proportion to one parameter this is the parameter over its standard deviation (Wald's test), however
the parameters are chosen; z^2 is what 2 ln L would lose at first order. The effect's own shapes count as what could be
done instead, its amplitudes do not; of an effect that has none (a delay, a drive's limit) nothing of its own does.

What the data do not fix of a law that explains them leaves one of its limits, which explains them as well. A length, a
time or a frequency whose deviation is as large as itself may be any. Two limits are reached otherwise:

A hung mass acts on its place by m w^2 / (1 - (w / w0)^2), so what the records tell of its frequency f0 is 1 / f0^2,
the give of its spring; that is 2 / f0 times as uncertain as f0, and at 0 the mass is fixed rigidly. No more of it is
seen where f0 lies above 99.9 % of the power of each input and output, or above half the sampling frequency: any mass
does the same.

A gain is none at one. Beside other masses the gain of the only input is the scale of all masses, stiffnesses and
dampings, those too that are held: what is said of them beforehand, relative deviations s_j, fixes the scale to
(sum of 1 / s_j^2)^(-1/2) and no better.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import (
    Estimate,
    Problem,
    covariance,
    estimate,
    held_unknowns,
    score_equations,
    sensitivity_of,
    simulate_at,
    weights_along,
)
from modal.discrepancy.fitting.nodes import (
    ITERATIONS,
    SMALLEST_GAIN,
    Node,
    Task,
    fitted_either_way,
    grid_error,
    node_of,
    polished,
)
from modal.effects.ambiguity import Circumstance
from modal.effects.catalogue import CATALOGUE, effect_name
from modal.effects.effect import ForceEffect, ParameterKind
from modal.simulation import SLIGHT, SURE, explained
from modal.simulation.assembly import Assembly, EffectPlacement, Unknowns, place_effect
from modal.simulation.plant import Plant
from modal.simulation.trajectory import SHARP, Sensitivity
from modal.structure.reciprocity import INTERNAL_FORCE
from modal.wording.text import number, quantity
from okid.arrays import TINY, FloatArray
from okid.record import Record

ROUGH, CLEARLY = 0.02, (100.0, 30.0, 10.0)
"""Fit a model without an effect that it needs, and judge it, only as far as its cost, after every four iterations,
stays within these factors of the whole model's; an iteration that gains less than the first share ends the four."""


def dropped(fitted: Estimate, placement: int) -> tuple[Assembly, Unknowns]:
    """The model without one of its effects, all else as it is."""
    assembly = fitted.assembly
    kept = [i for i in range(len(assembly.placements)) if i != placement]
    smaller = replace(assembly, placements=tuple(assembly.placements[i] for i in kept))
    common = np.delete(fitted.unknowns.common, np.r_[assembly.common_of(placement)])
    local = np.delete(fitted.unknowns.local, np.r_[assembly.own_of(placement)], axis=1)
    return smaller, Unknowns(common=common, local=local)


def run_without(fitted: Estimate, placement: int, problem: Problem, *, smoothing: float) -> Estimate | None:
    """The model run without one of its effects, all else as it is.

    None where the motion escapes.
    """
    smaller, unknowns = dropped(fitted, placement)
    return simulate_at(smaller, unknowns, problem, states=_other_states(fitted, placement), smoothing=smoothing)


def _other_states(fitted: Estimate, placement: int) -> FloatArray:
    """The trajectory without the states of one effect: the smaller model's is sought from there."""
    return np.delete(fitted.trajectory.states, np.r_[fitted.assembly.memory_of(placement)], axis=1)


def without(node: Node, placement: int, task: Task) -> Node:
    """The model refitted without one of its effects."""
    return _compared(run_without(node.coarse, placement, task.fit, smoothing=SHARP), node, task)


def merged(node: Node, task: Task) -> Node | None:
    """The model refitted with a law and a limit of it at one place as one law; None where there are no two such.

    What is one law was found in two steps, the limit first: amplitudes of one name add up to the richer law's.
    """
    fitted = node.coarse
    items = fitted.assembly.placements
    for i, rich in enumerate(items):
        for j, simple in enumerate(items):
            if i == j or not is_limit((simple.effect.key, simple.where), (rich.effect.key, rich.where)):
                continue
            assembly, unknowns = dropped(fitted, j)
            here, there = assembly.common_of(i - (j < i)).start, fitted.assembly.common_of(j).start
            of_rich, of_simple = _amplitudes(rich), _amplitudes(simple)
            shared = of_rich.keys() & of_simple.keys()
            for name in shared:
                unknowns.common[here + of_rich[name]] += fitted.unknowns.common[there + of_simple[name]]
            if shared:
                states = _other_states(fitted, j)
                start = simulate_at(assembly, unknowns, task.fit, states=states, smoothing=fitted.smoothing)
                found = _compared(start, node, task)
                return None if found.held_out is None else found
    return None


def at_limits(node: Node, task: Task) -> list[Node]:
    """A model refitted with one law at a limit of it, whose amplitudes are the law's own."""
    fitted, found = node.coarse, list[Node]()
    for i, item in enumerate(fitted.assembly.placements):
        span, rich = fitted.assembly.common_of(i), _amplitudes(item)
        for key in item.effect.limits:
            if (key, item.where) in node.effects or key not in task.catalogue:
                continue
            simple = replace(item, effect=task.catalogue[key], held=())
            if any(kind.name not in rich for kind in simple.effect.parameters):
                continue
            places = [span.start + rich[kind.name] for kind in simple.effect.parameters]
            others = fitted.unknowns.common[span.start + len(item.common) :]
            common = np.concatenate([fitted.unknowns.common[: span.start], fitted.unknowns.common[places], others])
            items = fitted.assembly.placements
            assembly = replace(fitted.assembly, placements=(*items[:i], simple, *items[i + 1 :]))
            local = np.delete(fitted.unknowns.local, np.r_[fitted.assembly.own_of(i)], axis=1)
            start = simulate_at(
                assembly,
                Unknowns(common=common, local=local),
                task.fit,
                states=_other_states(fitted, i),
                smoothing=fitted.smoothing,
            )
            found.append(_compared(start, node, task))
    return found


def undriven_models(node: Node, task: Task) -> list[Node]:
    """A model that explains the data, refitted with a law whose own states no motion drives in the place of its own.

    Each record begins with own states as it likes, the held-out ones too, so what these do by themselves proves
    nothing of the law that is said to drive them.
    """
    fitted, found = node.coarse, list[Node]()
    for i, item in enumerate(fitted.assembly.placements if explained(node.held_out_level) else ()):
        span = fitted.assembly.common_of(i)
        values = fitted.unknowns.common[span]
        limit = item.effect.undriven(values) if isinstance(item.effect, ForceEffect) else None
        if limit is None:
            continue
        effect, kept, factor = limit
        common = np.concatenate(
            [fitted.unknowns.common[: span.start], kept, fitted.unknowns.common[span.start + len(item.common) :]]
        )
        local = fitted.unknowns.local.copy()
        local[:, fitted.assembly.own_of(i)] *= factor
        items = fitted.assembly.placements
        assembly = replace(
            fitted.assembly, placements=(*items[:i], replace(item, effect=effect, held=()), *items[i + 1 :])
        )
        start = simulate_at(assembly, Unknowns(common=common, local=local), task.fit, smoothing=fitted.smoothing)
        if start is not None:
            found.append(node_of(estimate(start, task.fit, iterations=ITERATIONS), task))
    return found


def _amplitudes(item: EffectPlacement) -> dict[str, int]:
    """Where each amplitude of an effect stands among its common unknowns."""
    kinds = item.effect.parameters
    return {kinds[k].name: at for at, k in enumerate(item.common) if kinds[k].role == "amplitude"}


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
        others[_own(current.assembly, i, problem.drive.n_records)] = False
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


def _own(assembly: Assembly, placement: int, n_records: int) -> list[int]:
    """Where the amplitudes of an effect stand, or all that it has where it has none."""
    item, begin = assembly.placements[placement], assembly.common_of(placement).start
    places = {j: [begin + position] for position, j in enumerate(item.common)}
    first = assembly.n_common + assembly.local_of(placement).start
    for position, j in enumerate(item.local):
        places[j] = [first + position + record * assembly.n_local for record in range(n_records)]
    kinds = item.effect.parameters
    found = [at for j in places if kinds[j].role == "amplitude" for at in places[j]]
    return found or [begin + position for position in range(len(item.common))]


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


T = TypeVar("T")
Law = tuple[str, str]
"""An effect's key and its place."""


def has_limit(law: str, simpler: str) -> bool:
    """Whether a law turns into a simpler one."""
    return law in CATALOGUE and simpler in CATALOGUE[law].limits


def is_limit(simple: Law, rich: Law) -> bool:
    """Whether a law is a limit of another one at the same place."""
    return simple[1] == rich[1] and has_limit(rich[0], simple[0])


def simple_first(items: Sequence[T], law: Callable[[T], Law], near: Callable[[T, T], bool]) -> list[T]:
    """The items in their order, but a limit of a richer law before that law where it is `near`: does nearly as well.

    It is quick to fit, and where it explains the data the richer one need not be followed far.
    """
    ordered: list[T] = []
    for item in items:
        richer = [i for i, other in enumerate(ordered) if is_limit(law(item), law(other)) and near(item, other)]
        ordered.insert(min(richer, default=len(ordered)), item)
    return ordered


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
    if alone is None or not explained(node.fit_level, node.held_out_level):
        return None
    if alone.cost - node.coarse.cost <= SMALLEST_GAIN:
        return None
    start = run_without(node.coarse, len(assembly.placements) - 1, task.fit, smoothing=SHARP)
    other = alone if start is None else _settled(start, task)
    rival = other if other.cost < alone.cost else alone
    return AbsorbedGain(node=node, without=node_of(rival, task), fall=rival.cost - node.coarse.cost)


def _settled(start: Estimate, task: Task) -> Estimate:
    """Fitted until an iteration gains less than 1: the valley of the internal forces is long and flat."""
    return estimate(start, task.fit, iterations=60, standstill=1.0 / max(start.cost, 1.0))


GAINS = frozenset({"input_gain", "sensor_gain"})
HARDLY_ANY = 1e-3
"""Take a band to end where no more than this share of the power of a channel lies above it."""


def undetermined(
    best: Node, root: Node, task: Task, fits: Sequence[Record], circumstances: Collection[Circumstance]
) -> list[str]:
    """Why parameters of a law that the data do not fix make it no firm name: the law is one of its limits."""
    grid = grid_error(best)
    spread = np.hypot(np.sqrt(np.maximum(np.diag(covariance(best.coarse, task.fit))[: grid.size], 0.0)), grid)
    assembly, reasons = best.coarse.assembly, []
    scale = _scale_deviation(assembly.plant) if "other_masses" in circumstances else 0.0
    highest = highest_frequency(fits)
    for i, item in enumerate(assembly.placements[len(root.effects) :], start=len(root.effects)):
        span = assembly.common_of(i)
        for j, value, deviation in zip(item.common, best.fitted.unknowns.common[span], spread[span], strict=False):
            kind, size = item.effect.parameters[j], float(value)
            what = "frequency" if _hangs(item, kind) else kind.meaning
            of = f"the {what} of {effect_name(item.effect.key)} at {item.where}"
            if item.effect.key in GAINS:
                open_by = float(np.hypot(deviation, scale * size if item.effect.key == "input_gain" else 0.0))
                if SLIGHT <= abs(size - 1.0) <= SURE * open_by:
                    reasons.append(
                        f"{of} is not determined ({number(size)} +- {number(open_by)}): none at all, a gain of one, "
                        "explains the data as well"
                    )
            elif _hangs(item, kind) and size > highest:
                reasons.append(
                    f"{of} ({quantity(size, 'Hz')}) lies above 99.9 % of the power of every input and output "
                    f"({quantity(highest, 'Hz')}): one of its limits explains the data as well: a mass"
                )
            elif _is_open(item, kind, size, float(deviation)):
                limit = ": a mass" if _hangs(item, kind) else ""
                reasons.append(
                    f"{of} is not determined ({number(size)} +- {number(deviation)}): one of its limits explains the "
                    f"data as well{limit}"
                )
    return reasons


def _is_open(item: EffectPlacement, kind: ParameterKind, value: float, deviation: float) -> bool:
    """Whether a length, a time or a frequency may be none, or infinite where a mass hangs by it."""
    if kind.role != "shape" or not any(kind.dimension):
        return False
    if _hangs(item, kind):
        return not value > 2.0 * SURE * deviation
    return not abs(value) > deviation  # nor is a zero at a bound


def _hangs(item: EffectPlacement, kind: ParameterKind) -> bool:
    """Whether a parameter is the frequency of a mass that hangs on a spring."""
    return item.effect.key == "missing_mode" and kind.name == "frequency"


def highest_frequency(records: Sequence[Record]) -> float:
    """The frequency below which all but a thousandth of the power lies of each input and output, in Hz.

    Example:
        >>> t = 0.01 * np.arange(400.0)
        >>> waves = [Record(np.sin(20 * np.pi * t), np.sin(f * np.pi * t), 0.01) for f in (10, 40)]
        >>> highest_frequency(waves[:1]), highest_frequency(waves)
        (10.0, 20.0)
        >>> gaps = np.where(np.arange(400) % 37, 9.81 + 0.1 * np.sin(10 * np.pi * t), np.nan)
        >>> highest_frequency([Record(np.sin(20 * np.pi * t), gaps, 0.01)])
        10.0
    """
    found = 0.0
    for record in records:
        signals = np.hstack([record.inputs, record.outputs])
        rows, known = np.arange(len(signals)), [np.flatnonzero(np.isfinite(one)) for one in signals.T]
        lines = [np.interp(rows, at, one[at]) for one, at in zip(signals.T, known, strict=True) if at.size]
        whole = np.array(lines).T  # straight over gaps: zeros there would move at all frequencies
        power = np.abs(np.fft.rfft(whole - whole.mean(axis=0), axis=0)) ** 2
        for one in np.cumsum(power, axis=0).T:
            line = int(np.searchsorted(one, (1.0 - HARDLY_ANY) * one[-1])) if one[-1] > 0.0 else 0
            found = max(found, line / (record.n_samples * record.dt))
    return found


def _scale_deviation(plant: Plant) -> float:
    """How well the scale of a model is known beforehand, as a share of it."""
    every = [*plant.parameters, *(one.parameter for one in plant.masses)]
    return float(np.sum([(one.nominal / one.deviation) ** 2 for one in every if one.deviation > 0.0]) ** -0.5)


PLAUSIBLE_GAIN = (0.3, 3.0)
"""Doubt a gain beyond these: a unit is wrong (a thousand, g, degrees)."""
HARDLY_FOLLOWS = 0.03
"""Call a channel dead or another one where its gain is below this size."""


def doubted_gains(best: Node, root: Node) -> list[str]:
    """Why a gain far from one, a wrong unit, or one that hardly differs from one, is not firm."""
    reasons = []
    for item, i in zip(
        best.coarse.assembly.placements[len(root.effects) :], range(len(root.effects), len(best.effects)), strict=True
    ):
        if item.effect.key in GAINS:
            gain = float(best.coarse.unknowns.common[best.coarse.assembly.common_of(i).start])
            if not PLAUSIBLE_GAIN[0] <= gain <= PLAUSIBLE_GAIN[1]:
                reasons.append(doubted_gain(gain, item.where))
            elif abs(gain - 1.0) < SLIGHT:
                reasons.append(
                    f"a gain of {number(gain, 4)} at {item.where} is within a hundredth of one, which no gauge is sure "
                    "of and errors of a simulation look like"
                )
    return reasons


def doubted_gain(gain: float, where: str) -> str:
    """What a gain far from one looks like; a thousandth may be a unit or a dead channel, so both are named."""
    words = f"a gain of {number(gain)} at {where} looks like"
    if abs(gain) < HARDLY_FOLLOWS:
        return f"{words} a dead or wrong channel, or a wrong unit: check the wiring and the units of the records"
    if PLAUSIBLE_GAIN[0] <= -gain <= PLAUSIBLE_GAIN[1]:
        return f"{words} a turned direction: check the sign of the channel"
    return f"{words} a wrong unit: check the units of the records"
