"""Effects beside a model, each fitted in observer form: hardly any local minimum there, whatever the first values."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from modal.discrepancy.assembly import Assembly, Unknowns
from modal.discrepancy.budget import Budget, simulation_work
from modal.discrepancy.estimation import Estimate, estimate, simulate_at
from modal.discrepancy.nodes import Node, Task
from modal.discrepancy.observer import observer_gain
from modal.discrepancy.screen import Candidate
from modal.discrepancy.trajectory import SHARP
from modal.discrepancy.within_reach import within_reach
from okid.arrays import FloatArray

__all__ = ["SOFT", "observed_fits", "observed_form", "weaker_form"]

MOST_OBSERVED, MOVING_OBSERVED = 12, 0.01
"""A fit in observer form ends after so many iterations, or when one gains less than the second share."""
BETTER = 0.9
"""The given linear parameters are the better start where the first fit from them costs less than this share."""
SOFT, SOFTER = 0.03, 0.1
"""Width of sharp laws in first fits, as a share of the motion's scale; the wider one beside a linear model."""
TENTH = 0.1
"""Share of the observer gain that shows what the whole one hides."""
FIRST_WORK, BEHIND = 40.0, 3.0
"""Simulations after which a fit ends that costs so many times as much as the best one: those that go astray take
longest, and a good one was seen to take eight to sixty."""
MOST_OF_IT = 0.1
"""Share of what is left of the budget for one model that the rest of a fit may take."""
HIDDEN = 1.5
"""Where smoothing the laws that are there multiplies the cost by more than this, it hides what a further one does."""


def observed_form(fitted: Estimate, task: Task) -> Estimate:
    """The model in observer form along the records; as it is where a correction is not needed or leads astray.

    A wrong sensor makes the correction worse than none: it pulls the states towards what the sensor says.

    Args:
        fitted: The model in free run.
        task: Records to fit.
    """
    gain = observer_gain(fitted, task.fit, task.upsampling)
    if gain is None:
        return fitted
    found = _again(fitted, task, gain, fitted.smoothing)
    return found if found is not None and found.cost < fitted.cost else fitted


def weaker_form(observed: Estimate, task: Task) -> Estimate | None:
    """The model with a tenth of its observer gain.

    Args:
        observed: The model in observer form.
        task: Records to fit.

    Returns:
        None where it has no gain, or cannot be simulated so.
    """
    if observed.gain is None:
        return None
    return _again(observed, task, TENTH * observed.gain, observed.smoothing)


def _again(found: Estimate, task: Task, gain: FloatArray | None, smoothing: float) -> Estimate | None:
    """The same model about its own trajectory, with another gain or another smoothing."""
    return simulate_at(
        found.assembly, found.unknowns, task.fit, states=found.trajectory.states, gain=gain, smoothing=smoothing
    )


def observed_fits(node: Node, observed: Estimate, candidates: Sequence[Candidate], task: Task) -> list[Estimate]:
    """Each candidate fitted in observer form, from calibrated linear parameters or from those given.

    A calibration without the effect bends the linear parameters to take its place. Where it drove one onto its bound
    that is plain; else the first candidate is fitted both ways, and the better way is gone with the others too.

    Args:
        node: The model without them.
        observed: The same in observer form.
        candidates: From `modal.discrepancy.screen`, best first.
        task: Records to fit.

    Returns:
        Those that could be simulated, and for which the budget was enough.
    """
    smoothing = _first_smoothing(node, observed, task)
    best = np.inf

    def fitted(candidate: Candidate, linear: Literal["calibrated", "given"]) -> Estimate | None:
        nonlocal best
        found = _observed_fit(node, observed, candidate, task, linear=linear, smoothing=smoothing, best=best)
        best = min(best, np.inf if found is None else found.cost)
        return found

    budget = task.budget.stage()
    others = itertools.takewhile(lambda _: budget.allows(), candidates[1:])
    if node.coarse.at_bounds[: node.coarse.assembly.n_linear].any():
        return _made([fitted(candidates[0], "given"), *(fitted(candidate, "given") for candidate in others)])
    first = fitted(candidates[0], "calibrated")
    linear: Literal["calibrated", "given"] = "calibrated"
    if not node.effects:
        other = fitted(candidates[0], "given")
        if other is not None and (first is None or other.cost < BETTER * first.cost):
            first, linear = other, "given"
    return _made([first, *(fitted(candidate, linear) for candidate in others)])


def _made(fits: Iterable[Estimate | None]) -> list[Estimate]:
    return [fit for fit in fits if fit is not None]


def _first_smoothing(node: Node, observed: Estimate, task: Task) -> float:
    """How smooth sharp laws are in the first fits: as sharp as they are where smoothing would hide what is left."""
    if not node.effects:
        return SOFTER
    softened = _again(observed, task, observed.gain, SOFT)
    hidden = softened is None or softened.cost > HIDDEN * observed.cost
    return SHARP if hidden else SOFT


def _observed_fit(
    node: Node,
    observed: Estimate,
    candidate: Candidate,
    task: Task,
    *,
    linear: Literal["calibrated", "given"],
    smoothing: float,
    best: float,
) -> Estimate | None:
    """Fit one candidate in observer form, to the end where it is not far behind the best of the others."""
    assembly, unknowns = _with(node.coarse, candidate)
    if linear == "given":
        unknowns.common[: assembly.n_linear] = assembly.plant.nominal
    states = _widened(observed, candidate)
    first = Budget(FIRST_WORK * simulation_work(task.fit.drive.n_times, assembly.plant.n_states))
    start = within_reach(assembly, unknowns, task, states, gain=observed.gain, smoothing=smoothing)
    if start is None:
        return None
    found = estimate(start, task.fit, iterations=MOST_OBSERVED, standstill=MOVING_OBSERVED, budget=first)
    if first.left > 0.0 or found.cost > BEHIND * best:
        return found
    left = MOST_OBSERVED - found.iterations
    return estimate(found, task.fit, iterations=left, standstill=MOVING_OBSERVED, budget=task.budget.part(MOST_OF_IT))


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
