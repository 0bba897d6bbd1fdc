"""Try every effect beside a model: screen, fit in observer form, let the promising ones run free, sharpen the best."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from modal.discrepancy.assembly import Assembly, Unknowns
from modal.discrepancy.estimation import Estimate, estimate, simulate_at
from modal.discrepancy.nodes import Node, Task, node_of, polished
from modal.discrepancy.observer import observer_gain
from modal.discrepancy.screen import Candidate, screen_candidates
from modal.discrepancy.settling import settled_stiffness
from modal.discrepancy.simpler_laws import has_limit
from modal.discrepancy.trajectory import SHARP
from okid.arrays import FloatArray

__all__ = ["ENOUGH", "expand"]

ENOUGH = 1.2
"""Held-out mean square, in units of the floor, below which no further effect is looked for without good cause."""

WORTH_A_TRY = 0.1
"""Beside a model that explains the data, effects are tried only where the screen promises a fall by this share."""

PLACES, SHAPES = 2, 2
LEAST_SHARE = 0.1
"""A candidate is followed while it takes away at least this share of what the best one takes away."""

CONVINCING, FEWEST = 0.5, 4
"""Where the best one takes away less than the first share, so many different effects are followed in any case."""

RUNS = 8
FINALISTS = 5
NEAR = 20.0
FIRST_ITERATIONS, LAST_ITERATIONS = 15, 6
STANDSTILL = {FIRST_ITERATIONS: 3e-4, LAST_ITERATIONS: 3e-3}
"""The most promising finalist and its close rivals are fitted longest; a fit ends when an iteration gains less than
this share."""
MOST_OBSERVED, MOVING_OBSERVED = 12, 0.01
BETTER = 0.9
"""The given linear parameters are the better start where the first fit from them costs less than this share."""
MOST_FREE, MOVING_FREE = 6, 0.03
"""First fits, in observer form and in free run, end when an iteration gains less than this share."""
POLISHED = 1.5
REACH, REACH_SHARP = 10.0, 2.0
"""Once a finalist explains the data, others are sharpened whose cost is within this factor of its own; the lower one
where the fits are sharp already."""
RIVAL = 1.5
"""Once a model explains the data, others are followed whose cost in observer form is within this factor of the best."""
NEARLY, RIVAL_SHARP = 1.5, 1.03
"""The same where the fits are sharp already: then a model that nearly explains the data is enough; costs compare."""

STRENGTHS = (1.0, 0.5, 0.2)
"""Shares of a first guess of an effect's strength that are tried until the model can be simulated."""
MUCH_WEAKER = 0.1
SOFT, SOFTER = 0.03, 0.1


def expand(node: Node, task: Task) -> list[Node]:
    """Models with one effect more."""
    observed = _observed(node.coarse, task)
    candidates = _promising(screen_candidates(observed, task.fit, task.catalogue))
    if not candidates:
        return []
    worth = max(candidate.fall for candidate in candidates)
    if node.held_out_level <= ENOUGH and worth < WORTH_A_TRY:
        return []
    observations = _observed_fits(node, observed, candidates, task)
    fitted = _worth([fit for fit in observations if fit is not None], observed)
    runs, found = _free_runs(_leading(fitted, RUNS), task, node)
    return _judged(_leading(runs, FINALISTS), task, found, reach=REACH_SHARP if node.effects else REACH)


def _judged(finalists: Sequence[Estimate], task: Task, known: Mapping[int, Node], *, reach: float) -> list[Node]:
    """Finalists sharpened and judged on held-out records; once one explains the data, only those in its reach.

    What needs a finer grid gets it where it is among the best, because it costs several times as much.
    """
    found: list[Node] = list(known.values())
    for fit in finalists:
        explaining = [node for node in found if node.held_out_level <= ENOUGH]
        far = explaining and fit.cost > reach * min(node.coarse.cost for node in explaining)
        if id(fit) not in known and not far:
            found.append(_finished(fit, finalists[0], task))
    lowest = min((node.coarse.cost for node in found), default=0.0)
    return [polished(node, task) if node.coarse.cost <= POLISHED * lowest else node for node in found]


def _finished(fit: Estimate, best: Estimate, task: Task) -> Node:
    """A free run sharpened, longest where it is close to the best one, and judged on the held-out records."""
    iterations = FIRST_ITERATIONS if fit.cost <= RIVAL * best.cost else LAST_ITERATIONS
    return node_of(_sharpened(fit, task, iterations=iterations), task)


def _observed(fitted: Estimate, task: Task) -> Estimate:
    """The model in observer form along the records; as it is where a correction is not needed or leads astray.

    A wrong sensor makes the correction worse than none: it pulls the states towards what the sensor says.
    """
    gain = observer_gain(fitted, task.fit, task.upsampling)
    if gain is None:
        return fitted
    found = simulate_at(
        fitted.assembly,
        fitted.unknowns,
        task.fit,
        states=fitted.trajectory.states,
        gain=gain,
        smoothing=fitted.smoothing,
    )
    return found if found is not None and found.cost < fitted.cost else fitted


def _promising(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best places of each effect, the best shapes of each place."""
    kept: list[Candidate] = []
    least = LEAST_SHARE * max((candidate.fall for candidate in candidates), default=0.0)
    few = FEWEST if candidates and candidates[0].fall < CONVINCING else 1
    for candidate in candidates:
        if candidate.fall < least and len({other.key for other in kept}) >= few:
            break
        same_effect = [other for other in kept if other.key == candidate.key]
        same_place = [other for other in same_effect if other.where == candidate.where]
        places = {other.where for other in same_effect}
        if len(same_place) < SHAPES and (candidate.where in places or len(places) < PLACES):
            kept.append(candidate)
    return kept


def _with(start: Estimate, candidate: Candidate) -> tuple[Assembly, Unknowns]:
    assembly = replace(start.assembly, placements=(*start.assembly.placements, candidate.placement))
    common = np.concatenate([start.unknowns.common, candidate.common])
    memory = np.zeros((len(candidate.local), candidate.placement.n_memory))
    local = np.concatenate([start.unknowns.local, memory, candidate.local], axis=1)
    lower, upper = assembly.bounds()
    return assembly, Unknowns(common=np.clip(common, lower, upper), local=local)


def _observed_fits(
    node: Node, observed: Estimate, candidates: Sequence[Candidate], task: Task
) -> list[Estimate | None]:
    """Each candidate fitted in observer form, from calibrated linear parameters or from those given.

    A calibration without the effect bends the linear parameters to take its place. Where it drove one onto its bound
    that is plain; else the first candidate is fitted both ways, and the better way is gone with the others too.
    """
    if node.coarse.at_bounds[: node.coarse.assembly.n_linear].any():
        return [_observed_fit(node, observed, candidate, task, linear="given") for candidate in candidates]
    first = _observed_fit(node, observed, candidates[0], task, linear="calibrated")
    linear: Literal["calibrated", "given"] = "calibrated"
    if not node.effects:
        other = _observed_fit(node, observed, candidates[0], task, linear="given")
        if other is not None and (first is None or other.cost < BETTER * first.cost):
            first, linear = other, "given"
    return [first, *(_observed_fit(node, observed, candidate, task, linear=linear) for candidate in candidates[1:])]


def _observed_fit(
    node: Node, observed: Estimate, candidate: Candidate, task: Task, *, linear: Literal["calibrated", "given"]
) -> Estimate | None:
    """Fit one candidate in observer form."""
    assembly, unknowns = _with(node.coarse, candidate)
    if linear == "given":
        unknowns.common[: assembly.n_linear] = assembly.plant.nominal
    states = _widened(observed, candidate)
    smoothing = SOFT if node.effects else SOFTER
    start = _within_reach(assembly, unknowns, task, states, gain=observed.gain, smoothing=smoothing)
    return None if start is None else estimate(start, task.fit, iterations=MOST_OBSERVED, standstill=MOVING_OBSERVED)


def _within_reach(
    assembly: Assembly,
    unknowns: Unknowns,
    task: Task,
    states: FloatArray,
    *,
    smoothing: float,
    gain: FloatArray | None = None,
) -> Estimate | None:
    """The model with its last effect as strong as it can be simulated: a first guess may let the motion escape."""
    for share in STRENGTHS if _amplitudes(assembly) else STRENGTHS[:1]:
        tried = _scaled(assembly, unknowns, share)
        start: Literal["far", "near"] = "far" if share == 1.0 else "near"
        found = simulate_at(assembly, tried, task.fit, states=states, gain=gain, smoothing=smoothing, start=start)
        if found is not None:
            return found
    return None


def _scaled(assembly: Assembly, unknowns: Unknowns, share: float) -> Unknowns:
    """The unknowns with the last effect's amplitudes at a share of theirs."""
    common = unknowns.common.copy()
    for index, neutral in _amplitudes(assembly):
        common[index] = neutral + share * (common[index] - neutral)
    return Unknowns(common=common, local=unknowns.local)


def _amplitudes(assembly: Assembly) -> list[tuple[int, float]]:
    """Where the amplitudes of the last effect stand among the common unknowns, and their neutral values."""
    last = len(assembly.placements) - 1
    effect, begin = assembly.placements[last].effect, assembly.common_of(last).start
    return [
        (begin + position, effect.neutral[j])
        for position, j in enumerate(assembly.placements[last].common)
        if effect.parameters[j].role == "amplitude"
    ]


def _softness(node: Node, softness: float) -> float:
    """Smoothing of a first fit: soft beside a linear model, sharp where an effect is there already that may need it."""
    return SHARP if node.effects else softness


def _free_runs(fits: Sequence[Estimate], task: Task, node: Node) -> tuple[list[Estimate], dict[int, Node]]:
    """Free runs, the most promising first; once one explains the data, only its close rivals are followed.

    Returns:
        The runs, and the models of those that were the best of all when they came, finished at once, by `id` of the
        run: most often the first one explains the data and spares the others.
    """
    rival = RIVAL_SHARP if node.effects else RIVAL
    runs: list[Estimate] = []
    finished: dict[int, Node] = {}
    for fit in fits:
        explained = any(one.held_out_level <= ENOUGH for one in finished.values())
        if (explained or _nearly(runs, node)) and fit.cost > rival * fits[0].cost:
            break
        run = _free_run(fit, task, _softness(node, SOFT))
        if run is None:
            continue
        if all(run.cost < other.cost for other in runs):
            finished[id(run)] = _finished(run, run, task)
        runs.append(run)
    return runs, finished


def _nearly(runs: Sequence[Estimate], node: Node) -> bool:
    return any(run.level <= (NEARLY if node.effects else ENOUGH) for run in runs)


def _free_run(fit: Estimate, task: Task, smoothing: float) -> Estimate | None:
    """Let a model that was fitted in observer form run free, and fit it a little.

    From a law that is far too hard (a brim, a stop) no step may lead anywhere; then it starts again much weaker.
    """
    found: Estimate | None = None
    for share in (1.0, MUCH_WEAKER) if _amplitudes(fit.assembly) else (1.0,):
        unknowns = _scaled(fit.assembly, fit.unknowns, share)
        start = _within_reach(fit.assembly, unknowns, task, fit.trajectory.states, smoothing=smoothing)
        run = None if start is None else estimate(start, task.fit, iterations=MOST_FREE, standstill=MOVING_FREE)
        if run is not None and (found is None or run.cost < found.cost):
            found = run
        if found is not None and found.iterations > 0:
            break
    return found


def _widened(observed: Estimate, candidate: Candidate) -> FloatArray:
    states = observed.trajectory.states
    extra = getattr(candidate.placement.effect, "n_memory", 0)
    return np.concatenate([states, np.zeros((len(states), extra))], axis=1)


def _worth(fits: Sequence[Estimate], observed: Estimate) -> list[Estimate]:
    """The fits that win a good share of what the best one wins over the model without the effect."""
    most = max((observed.cost - fit.cost for fit in fits), default=0.0)
    good = [fit for fit in fits if observed.cost - fit.cost >= LEAST_SHARE * most]
    return [fit for fit in good if not any(_is_limit(other, fit) and other.cost <= fit.cost for other in good)]


def _is_limit(simple: Estimate, rich: Estimate) -> bool:
    """Whether a fit's last effect is a limit of the other's at the same place.

    A richer law that does not even fit as well is followed through its limit: its own fit has gone astray.
    """
    one, other = simple.assembly.placements[-1], rich.assembly.placements[-1]
    return one.where == other.where and has_limit(other.effect.key, one.effect.key)


def _leading(fits: Sequence[Estimate], most: int) -> list[Estimate]:
    """The best fit of each effect at each place; of these the best ones, and of each family the best within reach."""
    ranked = sorted(fits, key=lambda fit: fit.cost)
    kept: list[Estimate] = []
    for fit in ranked:
        item = fit.assembly.placements[-1]
        twins = [other.assembly.placements[-1] for other in kept]
        if any(twin.effect.key == item.effect.key and twin.where == item.where for twin in twins):
            continue
        lone = all(twin.effect.family != item.effect.family for twin in twins)
        if (len(kept) < most or lone) and fit.cost <= NEAR * ranked[0].cost:
            kept.append(fit)
    return kept


def _sharpened(fit: Estimate, task: Task, *, iterations: int) -> Estimate:
    start = simulate_at(fit.assembly, fit.unknowns, task.fit, states=fit.trajectory.states, smoothing=SHARP)
    if start is None:
        return fit
    fitted = estimate(start, task.fit, iterations=iterations, standstill=STANDSTILL[iterations])
    settled = settled_stiffness(fitted)
    if settled is None:
        return fitted
    again = simulate_at(*settled, task.fit, states=fitted.trajectory.states, smoothing=SHARP)
    return fitted if again is None else estimate(again, task.fit, iterations=6)
