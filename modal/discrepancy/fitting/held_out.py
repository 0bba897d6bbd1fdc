"""A fitted model along held-out records: the common values stay, only what each record has for itself is sought."""

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, estimate, simulate_at
from modal.discrepancy.fitting.graded import LOST, LostMotion, graded_run
from modal.discrepancy.fitting.observer_form import observer_gain
from modal.simulation.assembly import Unknowns, assemble
from okid.arrays import FloatArray

__all__ = ["judged", "rested"]

NEARLY = 2.0
"""Level below which the fit explains the records, so that the held-out ones must be explained as well."""
DOUBTFUL = (1.1, 100.0)
"""A held-out error above the fit's by a factor between these may come from a bad initial state: it is sought again."""
MATTER = 0.8
"""Initial states matter where they lower the cost of the plant without its effects to less than this share."""
WEAKER = (1.0, 0.3, 0.1)
"""Shares of an observer's gain: the whole one, of the linear plant, may make a hard spring unstable."""


def judged(fitted: Estimate, held_out: Problem, begun: Estimate | None = None) -> Estimate | None:
    """The model along the held-out records; only initial states and what else each record has for itself is fitted.

    Args:
        fitted: The model.
        held_out: The held-out records.
        begun: A like model along them, from whose initial states to start.

    Returns:
        The estimate; None where the model escapes.
    """
    assembly = fitted.assembly
    n_records = held_out.drive.n_records
    local = np.zeros((n_records, assembly.n_local))
    for i in range(len(assembly.placements)):
        own = assembly.local_of(i)
        local[:, own] = np.mean(fitted.unknowns.local[:, own], axis=0)
    n_states = assembly.plant.n_states
    begin = _first_states(fitted, held_out) if begun is None else begun.unknowns.local[:, :n_states]
    local[:, :n_states] = begin
    unknowns = Unknowns(common=fitted.unknowns.common, local=local)
    start = simulate_at(assembly, unknowns, held_out, smoothing=fitted.smoothing)
    found = None if start is None else estimate(start, held_out, iterations=8)
    if found is not None and _doubtful(found, fitted):
        rest = rested(found, held_out)
        found = found if rest is found else estimate(rest, held_out, iterations=8)
    if found is not None and _doubtful(found, fitted):
        again = _by_observer(found, held_out)
        if again is not None and again.cost < found.cost:
            return again
    return found


def rested(start: Estimate, problem: Problem) -> Estimate:
    """The same model begun at rest where that is nearer to the records.

    Initial states that made up for a missing law do not find back from under friction, which holds a mass anywhere.

    Args:
        start: A model in free run.
        problem: Its records.

    Returns:
        That one, or the given one.
    """
    local = start.unknowns.local.copy()
    local[:, : start.assembly.plant.n_states] = 0.0
    rest = Unknowns(common=start.unknowns.common, local=local)
    states = start.trajectory.states
    found = simulate_at(start.assembly, rest, problem, states=states, smoothing=start.smoothing)
    return start if found is None or found.cost >= start.cost else found


def _first_states(fitted: Estimate, held_out: Problem) -> FloatArray:
    """Initial states to start from: those of the plant without its effects where they matter, else rest.

    A mass that is held by friction at rest would stay there whatever its initial state is changed by.
    """
    plant = fitted.assembly.plant
    rest = np.zeros((held_out.drive.n_records, plant.n_states))
    if not fitted.assembly.placements:
        return rest
    linear = Unknowns(common=fitted.unknowns.common[: fitted.assembly.n_linear], local=rest)
    resting = simulate_at(assemble(plant), linear, held_out)
    begun = None if resting is None else estimate(resting, held_out, iterations=2)
    if resting is None or begun is None or begun.cost > MATTER * resting.cost:
        return rest
    return begun.unknowns.local


def _doubtful(held_out: Estimate, fitted: Estimate) -> bool:
    """Whether the held-out records' initial states may be in another basin: surely where the fit is at the floor."""
    level = max(fitted.level, 1.0)
    most = np.inf if level <= NEARLY else DOUBTFUL[1] * level
    return DOUBTFUL[0] * level < held_out.level < most


def _by_observer(found: Estimate, held_out: Problem) -> Estimate | None:
    """The initial states once more, found in observer form first.

    Under play, stops or a hard spring a free run from rest may stay in another basin.
    """
    steps = int(held_out.drive.rows[1]) if len(held_out.drive.rows) > 1 else 1
    gain = observer_gain(found, held_out, steps)
    if gain is None:
        return None
    smoothing = found.smoothing
    states = found.trajectory.states
    corrected = (
        simulate_at(
            found.assembly,
            found.unknowns,
            held_out,
            states=states,
            gain=share * gain,
            smoothing=smoothing,
            start="near",
        )
        for share in WEAKER
    )
    seen = next((one for one in corrected if one is not None), None)
    if seen is None:
        return None
    seen = estimate(seen, held_out, iterations=4)
    local = seen.trajectory.states[list(held_out.drive.firsts[:-1])]
    unknowns = Unknowns(common=found.unknowns.common, local=seen.unknowns.local.copy())
    unknowns.local[:, list(found.assembly.initial)] = local
    start = simulate_at(
        found.assembly, unknowns, held_out, states=seen.trajectory.states, smoothing=smoothing, start="near"
    )
    free = None if start is None else estimate(start, held_out, iterations=8)
    if free is not None and free.cost <= LOST * seen.cost:
        return free
    try:
        graded = graded_run(seen, held_out, smoothing=smoothing)
    except LostMotion:
        return free
    return free if graded is None else estimate(graded, held_out, iterations=8)
