"""Effects beside a model, each fitted in observer form: hardly any local minimum there, whatever the first values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, estimate, simulate_at
from modal.discrepancy.fitting.nodes import Node, Task
from modal.discrepancy.fitting.observer_form import observer_gain
from modal.discrepancy.selection.screening import Candidate
from modal.simulation import explained
from modal.simulation.assembly import Assembly, Unknowns
from modal.simulation.scheme import Budget, simulation_work
from modal.simulation.trajectory import SHARP
from okid.arrays import FloatArray

ESCAPED = 100.0
"""Call a motion escaped where the error is so many times that of no motion at all, in mean squares."""
STRENGTHS = (1.0, 0.5, 0.2)
"""Try these shares of a first guess of an effect's strength until the model can be simulated."""


def within_reach(
    assembly: Assembly,
    unknowns: Unknowns,
    task: Task,
    states: FloatArray,
    *,
    smoothing: float,
    gain: FloatArray | None = None,
) -> Estimate | None:
    """The model with its last effect at the largest share of its strength at which it can be simulated.

    Args:
        assembly: The model.
        unknowns: Values to start from.
        task: Records to fit.
        states: (n_times, n_all) near which the trajectory is sought.
        smoothing: Width of sharp laws, as a share of the motion's scale.
        gain: (n_all, n_outputs) of the observer form; free run unless given.

    Returns:
        The model along the records; None where it cannot be simulated at any share.
    """
    silent = float(np.sum((task.fit.drive.outputs * task.fit.weights) ** 2))
    escaped: Estimate | None = None
    for share in STRENGTHS if amplitudes(assembly) else STRENGTHS[:1]:
        tried = scaled(assembly, unknowns, share)
        start: Literal["far", "near"] = "far" if share == 1.0 else "near"
        found = simulate_at(assembly, tried, task.fit, states=states, gain=gain, smoothing=smoothing, start=start)
        if found is not None and found.squares <= ESCAPED * silent:
            return found
        escaped = found if escaped is None else escaped
    return escaped


def scaled(assembly: Assembly, unknowns: Unknowns, share: float) -> Unknowns:
    """The unknowns with the last effect's amplitudes at a share of theirs, what vanishes at infinity further out."""
    common = unknowns.common.copy()
    for index, neutral in amplitudes(assembly):
        common[index] = common[index] / share if np.isinf(neutral) else neutral + share * (common[index] - neutral)
    return Unknowns(common=common, local=unknowns.local)


def amplitudes(assembly: Assembly) -> list[tuple[int, float]]:
    """Where the strengths of the last effect stand among the common unknowns, and their neutral values.

    These are its amplitudes, and a shape at whose infinite value it vanishes (a limit, a length scale).
    """
    last = len(assembly.placements) - 1
    effect, begin = assembly.placements[last].effect, assembly.common_of(last).start
    return [
        (begin + position, effect.neutral[j])
        for position, j in enumerate(assembly.placements[last].common)
        if effect.parameters[j].role == "amplitude" or np.isinf(effect.neutral[j])
    ]


MOST_OBSERVED, MOVING_OBSERVED = 12, 0.01
"""End a fit in observer form after so many iterations, or when one gains less than the second share."""
BETTER = 0.9
"""Start from the given linear parameters where the first fit from them costs less than this share."""
SOFT, SOFTER = 0.03, 0.1
"""Smooth sharp laws in first fits to this width, as a share of the motion's scale; the wider one beside a linear
model."""
MUCH_WEAKER = 0.1
"""Try this share of an observer gain for what the whole one hides, and of a law's strength where no step leads on from
the whole."""
FIRST_WORK, BEHIND = 120.0, 3.0
"""Let a fit wait for the others after so many simulations, and end it where it costs so many times as much as the best
one: those that go astray take longest, and a good one was seen to take 25 to 180."""
CLEAR, MUCH_LESS = 0.05, 0.5
"""Where a fit leaves less than the first share of what is above the floor, fit another only if the screen promised at
least the second share of what it promised of that one."""
MOST_OF_IT = 0.1
"""Spend at most this share of what is left of the budget for these fits on the rest of one."""
HIDDEN = 1.5
"""Keep the laws that are there sharp where smoothing them multiplies the cost by more than this."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Begun:
    """A candidate's fit, and whether it came to its end."""

    candidate: Candidate
    fit: Estimate
    ended: bool


def observed_form(fitted: Estimate, task: Task) -> Estimate:
    """The model in observer form along the records; as it is where a correction is not needed or leads astray.

    A wrong sensor makes the correction worse than none: it pulls the states towards what the sensor says.
    """
    gain = observer_gain(fitted, task.fit)
    if gain is None:
        return fitted
    found = _again(fitted, task, gain, fitted.smoothing)
    return found if found is not None and found.cost < fitted.cost else fitted


def weaker_form(observed: Estimate, task: Task) -> Estimate | None:
    """The model with a tenth of its observer gain.

    None where it has no gain, or cannot be simulated so.
    """
    if observed.gain is None:
        return None
    return _again(observed, task, MUCH_WEAKER * observed.gain, observed.smoothing)


def _again(found: Estimate, task: Task, gain: FloatArray | None, smoothing: float) -> Estimate | None:
    """The same model about its own trajectory, with another gain or another smoothing."""
    return simulate_at(
        found.assembly, found.unknowns, task.fit, states=found.trajectory.states, gain=gain, smoothing=smoothing
    )


def observed_fits(
    node: Node, observed: Estimate, candidates: Sequence[Candidate], task: Task
) -> tuple[list[Estimate], list[Candidate]]:
    """Candidates fitted in observer form, from calibrated linear parameters or from those given.

    A calibration without the effect bends the linear parameters to take its place. Where it drove one onto its bound
    that is plain; else the first candidate is fitted both ways, and the better way is gone with the others too.

    Returns:
        Those that could be simulated, and for which the budget was enough; those that cannot lead any more as far as
        they came. Beside them the candidates that another one outdid before they were begun.
    """
    smoothing = _first_smoothing(node, observed, task)

    def begin(candidate: Candidate, linear: Literal["calibrated", "given"]) -> _Begun | None:
        return _begun(node, observed, candidate, task, linear=linear, smoothing=smoothing)

    budget = task.budget.stage()
    linear: Literal["calibrated", "given"] = "calibrated"
    if node.coarse.at_bounds[: node.coarse.assembly.n_linear].any():
        linear = "given"
    first = begin(candidates[0], linear)
    if linear == "calibrated" and not node.effects:
        other = begin(candidates[0], "given")
        if other is not None and (first is None or other.fit.cost < BETTER * first.fit.cost):
            first, linear = other, "given"
    race = [] if first is None else [first]
    left_out: list[Candidate] = []
    for candidate in candidates[1:]:
        if any(_outdone(candidate, one, observed) for one in race):
            left_out.append(candidate)
            continue
        if not budget.allows():
            break
        one = begin(candidate, linear)
        race += [] if one is None else [one]
    return _finished(race, task, budget), left_out


def _outdone(candidate: Candidate, leader: _Begun, observed: Estimate) -> bool:
    """Whether a fit explains so much that the candidate need not be fitted.

    Either the screen promised much less of the candidate, or it is the same law with another shape to start from.
    """
    clear = not explained(observed.level) and leader.fit.level - 1.0 <= CLEAR * (observed.level - 1.0)
    same = (candidate.key, candidate.where) == (leader.candidate.key, leader.candidate.where)
    return clear and (candidate.fall < MUCH_LESS * leader.candidate.fall or (same and explained(leader.fit.level)))


def _finished(race: Sequence[_Begun], task: Task, stage: Budget) -> list[Estimate]:
    """All as far as they came, and those fitted to their end that may still be the best."""
    done: list[Estimate] = []
    leader: _Begun | None = None
    for one in sorted(race, key=lambda one: one.fit.cost):
        reached = one.fit
        if not one.ended and (leader is None or _may_lead(one, leader)):
            left, budget = MOST_OBSERVED - reached.iterations, stage.part(MOST_OF_IT)
            reached = estimate(reached, task.fit, iterations=left, standstill=MOVING_OBSERVED, budget=budget)
        done.append(reached)
        if leader is None or reached.cost < leader.fit.cost:
            leader = replace(one, fit=reached)
    return done


def _may_lead(one: _Begun, leader: _Begun) -> bool:
    """Whether a fit is not far behind the best one, or promised as much while that explains too little."""
    if not explained(leader.fit.level) and one.candidate.fall >= MUCH_LESS * leader.candidate.fall:
        return True
    return one.fit.cost <= BEHIND * leader.fit.cost


def _first_smoothing(node: Node, observed: Estimate, task: Task) -> float:
    """How smooth sharp laws are in the first fits: as sharp as they are where smoothing would hide what is left."""
    if not node.effects:
        return SOFTER
    softened = _again(observed, task, observed.gain, SOFT)
    hidden = softened is None or softened.cost > HIDDEN * observed.cost
    return SHARP if hidden else SOFT


def _begun(
    node: Node,
    observed: Estimate,
    candidate: Candidate,
    task: Task,
    *,
    linear: Literal["calibrated", "given"],
    smoothing: float,
) -> _Begun | None:
    """A candidate's fit in observer form, to its end unless that takes long; None where it cannot be simulated."""
    assembly, unknowns = _with(node.coarse, candidate)
    if linear == "given":
        unknowns.common[: assembly.n_linear] = assembly.plant.nominal
    states = _widened(observed, candidate)
    budget = Budget(FIRST_WORK * simulation_work(task.fit.drive.n_times, assembly.plant.n_states))
    start = within_reach(assembly, unknowns, task, states, gain=observed.gain, smoothing=smoothing)
    if start is None:
        return None
    found = estimate(start, task.fit, iterations=MOST_OBSERVED, standstill=MOVING_OBSERVED, budget=budget)
    return _Begun(candidate=candidate, fit=found, ended=budget.left > 0.0)


def _with(start: Estimate, candidate: Candidate) -> tuple[Assembly, Unknowns]:
    assembly = replace(start.assembly, placements=(*start.assembly.placements, candidate.placement))
    common = np.concatenate([start.unknowns.common, candidate.common])
    memory = np.zeros((len(candidate.local), candidate.placement.n_memory))
    local = np.concatenate([start.unknowns.local, memory, candidate.local], axis=1)
    lower, upper = assembly.bounds()
    return assembly, Unknowns(common=np.clip(common, lower, upper), local=local)


def _widened(observed: Estimate, candidate: Candidate) -> FloatArray:
    states = observed.trajectory.states
    extra = getattr(candidate.placement.effect, "n_memory", 0)
    return np.concatenate([states, np.zeros((len(states), extra))], axis=1)
