"""Beam search for the set of effects that a model lacks.

From a model each effect is screened at each place in observer form, the promising ones are fitted in observer form
(contractive: hardly any local minimum), then in free run, and judged on held-out records. Three distinct models are
carried on, because the best single effect may be a wrong one that stands in for two. A step counts only where the
held-out mean square falls by a tenth and the likelihood gains: with many samples a criterion on the likelihood alone
finds an effect in nearly every record without one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.discrepancy.assembly import Assembly, Unknowns
from modal.discrepancy.effects.effect import Effect, jumps
from modal.discrepancy.estimation import Estimate, Problem, estimate, simulate_at
from modal.discrepancy.observer import observer_gain
from modal.discrepancy.screen import Candidate, screen_candidates
from modal.discrepancy.settling import settled_stiffness
from modal.discrepancy.trajectory import SHARP
from okid.arrays import FloatArray

__all__ = ["Node", "Task", "calibrated_node", "expand", "node_of", "on_other_floor", "search", "without"]

ENOUGH = 1.2
"""Held-out mean square, in units of the floor, below which no further effect is looked for without good cause."""

SMALLEST_FALL = 0.1
SMALLEST_GAIN = 30.0
"""A step counts when the held-out mean square falls by a tenth and 2 ln L gains more than 30: over 32 cases without an
effect none fell by a tenth, while 69 % gained more than 30."""

BEAM = 3
MOST_EFFECTS = 4
PLACES, SHAPES = 2, 2
LEAST_SHARE = 0.1
"""A candidate is followed while it takes away at least this share of what the best one takes away."""
RUNS = 8
FINALISTS = 5
NEAR = 20.0
RIVAL = 3.0
"""Once a model explains the data, others are followed whose cost in observer form is within this factor of the best."""
STRENGTHS = (1.0, 0.5, 0.2)
"""Shares of a first guess of an effect's strength that are tried until the model can be simulated."""
SOFT, SOFTER = 0.03, 0.1
SHARPER = SHARP / 5.0
FINE_ENOUGH = 1.05
FINER = 4
"""Steps of the fine grid per step of the coarse one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Task:
    """What the search works on.

    Attributes:
        fit: The records to fit.
        held_out: The held-out records.
        upsampling: Steps of the simulation per sample.
        catalogue: The effects to try.
        report: Called with a sentence and the share done.
        fine_fit: The records to fit with four times as many steps, for laws that jump.
        fine_held_out: The held-out records likewise.
    """

    fit: Problem
    held_out: Problem
    upsampling: int
    catalogue: Mapping[str, Effect]
    report: Callable[[str, float], None]
    fine_fit: Problem
    fine_held_out: Problem


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Node:
    """A model with some effects, fitted.

    Attributes:
        fitted: The estimate on the records to fit, in free run.
        held_out: The same model on the held-out records, only their own unknowns fitted; None where it escapes.
        coarse: The estimate on the grid on which the search goes on.
    """

    fitted: Estimate
    held_out: Estimate | None
    coarse: Estimate

    @property
    def effects(self) -> tuple[tuple[str, str], ...]:
        """(effect, place) of each effect."""
        return tuple((item.effect.key, item.where) for item in self.fitted.assembly.placements)

    @property
    def fit_level(self) -> float:
        """Mean square of the residual on the records to fit, in units of the floor."""
        return self.fitted.level

    @property
    def held_out_level(self) -> float:
        """Likewise on the held-out records; infinite where the model escapes."""
        return np.inf if self.held_out is None else self.held_out.level


def log_likelihood_gain(before: Node, after: Node, task: Task) -> float:
    """2 ln L that `after` gains over `before` on all records, each record and output with its own noise variance."""
    if before.held_out is None or after.held_out is None:
        return np.inf if after.held_out is not None else -np.inf
    return _gain(before.fitted, after.fitted, task.fit) + _gain(before.held_out, after.held_out, task.held_out)


def _gain(before: Estimate, after: Estimate, problem: Problem) -> float:
    """The variance that is left but never below the floor: a fit below the floor is chance, not merit."""
    drive = problem.drive
    count = np.array([drive.present[drive.rows_of(record)].sum(axis=0) for record in range(drive.n_records)])
    ratio = np.maximum(before.mean_square, 0.5) / np.maximum(after.mean_square, 0.5)
    return float(np.nansum(count * np.log(ratio)))


def node_of(coarse: Estimate, task: Task) -> Node:
    """Judge a fitted model on the held-out records; one with a law that jumps on a finer grid, sharper."""
    fitted, held_out = coarse, task.held_out
    if coarse.level > FINE_ENOUGH and any(jumps(item.effect) for item in coarse.assembly.placements):
        finer = _finer(coarse, task)
        if finer is not None:
            fitted, held_out = finer, task.fine_held_out
    assembly = fitted.assembly
    n_records = held_out.drive.n_records
    local = np.zeros((n_records, assembly.n_local))
    for i in range(len(assembly.placements)):
        own = assembly.local_of(i)
        local[:, own] = np.mean(fitted.unknowns.local[:, own], axis=0)
    unknowns = Unknowns(common=fitted.unknowns.common, local=local)
    start = simulate_at(assembly, unknowns, held_out, smoothing=fitted.smoothing)
    if start is None:
        return Node(fitted=fitted, held_out=None, coarse=coarse)
    return Node(fitted=fitted, held_out=estimate(start, held_out, iterations=8), coarse=coarse)


def on_other_floor(node: Node, fit_ratio: FloatArray, held_out_ratio: FloatArray) -> Node:
    """The node with its residuals in units of another floor, `ratio` times smaller (n_records, n_outputs)."""

    def scaled(one: Estimate, ratio: FloatArray) -> Estimate:
        return replace(one, mean_square=one.mean_square * ratio)

    return Node(
        fitted=scaled(node.fitted, fit_ratio),
        held_out=None if node.held_out is None else scaled(node.held_out, held_out_ratio),
        coarse=scaled(node.coarse, fit_ratio),
    )


def _finer(coarse: Estimate, task: Task) -> Estimate | None:
    """The fit with four times as many steps and a fifth of the smoothing, from the coarse trajectory on."""
    fine, before = task.fine_fit.drive, task.fit.drive
    states = np.concatenate(
        [
            _between(coarse.trajectory.states[before.times_of(r)], fine.firsts[r + 1] - fine.firsts[r])
            for r in range(fine.n_records)
        ]
    )
    start = simulate_at(coarse.assembly, coarse.unknowns, task.fine_fit, states=states, smoothing=SHARPER)
    return None if start is None else estimate(start, task.fine_fit, iterations=6)


def _between(states: FloatArray, n_times: int) -> FloatArray:
    at = np.linspace(0.0, len(states) - 1.0, n_times)
    columns = [np.interp(at, np.arange(len(states)), column) for column in states.T]
    return np.array(columns).reshape(-1, n_times).T  # a plant without dynamics has none


def calibrated_node(start: Estimate, task: Task, *, iterations: int = 12) -> Node:
    """Fit the linear parameters and the initial states."""
    return node_of(estimate(start, task.fit, iterations=iterations), task)


def search(root: Node, task: Task, known: Sequence[Node] = ()) -> tuple[Node, ...]:
    """All models worth a look, from the calibrated one on.

    Args:
        root: The calibrated linear model.
        task: Records, catalogue.
        known: Models that an earlier search found, to go on from.

    Returns:
        Every model judged on held-out records, in the order found.
    """
    everything = list(known) if known else [root]
    front = _distinct([node for node in known if counts(root, node, task)]) or [root]
    for depth in range(max(len(node.effects) for node in front) - len(root.effects), MOST_EFFECTS):
        if min(node.held_out_level for node in front) <= ENOUGH and depth > 0:
            break
        children: list[Node] = []
        for position, node in enumerate(front):
            share = (depth + position / len(front)) / MOST_EFFECTS
            task.report(f"looking for effect {depth + 1} beside {_named(node)}", share)
            found = expand(node, task)
            everything += found
            children += [child for child in found if counts(node, child, task)]
        if not children:
            break
        front = _distinct(children)
    return tuple(everything)


def counts(parent: Node, child: Node, task: Task) -> bool:
    """Whether a step is one: the held-out mean square falls by a tenth and the likelihood gains."""
    if not np.isfinite(child.held_out_level):
        return False
    falls = child.held_out_level <= (1.0 - SMALLEST_FALL) * parent.held_out_level
    return falls and log_likelihood_gain(parent, child, task) > SMALLEST_GAIN


def _named(node: Node) -> str:
    return ", ".join(f"{effect} at {where}" for effect, where in node.effects) or "the linear model"


def _distinct(children: Sequence[Node]) -> list[Node]:
    kept: list[Node] = []
    for child in sorted(children, key=lambda node: node.held_out_level):
        if all(set(child.effects) != set(other.effects) for other in kept):
            kept.append(child)
    return kept[:BEAM]


def expand(node: Node, task: Task) -> list[Node]:
    """Models with one effect more."""
    observed = _observed(node.coarse, task)
    candidates = _promising(screen_candidates(observed, task.fit, task.catalogue))
    if not candidates:
        return []
    worth = max(candidate.fall for candidate in candidates)
    if node.held_out_level <= ENOUGH and worth < SMALLEST_FALL:
        return []
    observations = [_observed_fit(node, observed, candidate, task) for candidate in candidates]
    fitted = _worth([fit for fit in observations if fit is not None], observed)
    finalists = _leading(_free_runs(_leading(fitted, RUNS), task), FINALISTS)
    return [node_of(_sharpened(fit, task), task) for fit in finalists]


def _observed(fitted: Estimate, task: Task) -> Estimate:
    """The model in observer form along the records; as it is where it needs no correction."""
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
    return fitted if found is None else found


def _promising(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best places of each effect, the best shapes of each place."""
    kept: list[Candidate] = []
    least = LEAST_SHARE * max((candidate.fall for candidate in candidates), default=0.0)
    for candidate in candidates:
        if candidate.fall < least:
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


def _observed_fit(node: Node, observed: Estimate, candidate: Candidate, task: Task) -> Estimate | None:
    """Fit one candidate in observer form."""
    assembly, unknowns = _with(node.coarse, candidate)
    if node.coarse.at_bounds[: assembly.n_linear].any():
        unknowns.common[: assembly.n_linear] = assembly.plant.nominal
    states = _widened(observed, candidate)
    start = _within_reach(assembly, unknowns, task, states, gain=observed.gain, smoothing=SOFTER)
    return None if start is None else estimate(start, task.fit, iterations=3)


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
    last = len(assembly.placements) - 1
    effect, begin = assembly.placements[last].effect, assembly.common_of(last).start
    strengths = [
        (begin + position, effect.neutral[j])
        for position, j in enumerate(assembly.placements[last].common)
        if effect.parameters[j].role == "amplitude"
    ]
    for share in STRENGTHS if strengths else STRENGTHS[:1]:
        common = unknowns.common.copy()
        for index, neutral in strengths:
            common[index] = neutral + share * (common[index] - neutral)
        tried = Unknowns(common=common, local=unknowns.local)
        found = simulate_at(assembly, tried, task.fit, states=states, gain=gain, smoothing=smoothing, start="near")
        if found is not None:
            return found
    return None


def _free_runs(fits: Sequence[Estimate], task: Task) -> list[Estimate]:
    """Free runs, the most promising first; once one explains the data, only its close rivals are followed."""
    found: list[Estimate] = []
    for fit in fits:
        explained = any(run.level <= ENOUGH for run in found)
        if explained and fit.cost > RIVAL * fits[0].cost:
            break
        run = _free_run(fit, task)
        found += [] if run is None else [run]
    return found


def _free_run(fit: Estimate, task: Task) -> Estimate | None:
    """Let a model that was fitted in observer form run free, and fit it a little."""
    start = _within_reach(fit.assembly, fit.unknowns, task, fit.trajectory.states, smoothing=SOFT)
    return None if start is None else estimate(start, task.fit, iterations=3)


def _widened(observed: Estimate, candidate: Candidate) -> FloatArray:
    states = observed.trajectory.states
    extra = getattr(candidate.placement.effect, "n_memory", 0)
    return np.concatenate([states, np.zeros((len(states), extra))], axis=1)


def _worth(fits: Sequence[Estimate], observed: Estimate) -> list[Estimate]:
    """The fits that win a good share of what the best one wins over the model without the effect."""
    most = max((observed.cost - fit.cost for fit in fits), default=0.0)
    return [fit for fit in fits if observed.cost - fit.cost >= LEAST_SHARE * most]


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


def _sharpened(fit: Estimate, task: Task) -> Estimate:
    start = simulate_at(fit.assembly, fit.unknowns, task.fit, states=fit.trajectory.states, smoothing=SHARP)
    if start is None:
        return fit
    fitted = estimate(start, task.fit, iterations=12, standstill=1e-3)
    settled = settled_stiffness(fitted)
    if settled is None:
        return fitted
    again = simulate_at(*settled, task.fit, states=fitted.trajectory.states, smoothing=SHARP)
    return fitted if again is None else estimate(again, task.fit, iterations=6)


def without(node: Node, placement: int, task: Task) -> Node:
    """The model refitted without one of its effects."""
    fitted = node.coarse
    assembly = fitted.assembly
    kept = [i for i in range(len(assembly.placements)) if i != placement]
    smaller = replace(assembly, placements=tuple(assembly.placements[i] for i in kept))
    common = np.delete(fitted.unknowns.common, np.r_[assembly.common_of(placement)])
    local = np.delete(fitted.unknowns.local, np.r_[assembly.own_of(placement)], axis=1)
    start = simulate_at(smaller, Unknowns(common=common, local=local), task.fit, smoothing=SHARP)
    if start is None:
        return Node(fitted=fitted, held_out=None, coarse=fitted)
    return node_of(estimate(start, task.fit, iterations=8), task)
