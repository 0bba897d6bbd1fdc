"""Fit a model whose first values may be far off: in free run, and by way of the observer form where that leaves a gap.

The free run of a lightly damped model whose frequency is off by more than the width of the resonance is out of step
with the record from the first beat on: the error hardly falls towards the right frequency, more damping lowers it, and
the fit creeps or stops on a bound. In observer form the measured outputs keep model and record in step, so that the fit
is contractive; from there the free run is near its minimum.

Where linear parameters sit on their bounds and leave a gap, the nominal values may be further off than was thought:
wider bounds are taken where they explain all of it, and only then, because an effect that is missing would use them.
"""

from dataclasses import replace

from modal.discrepancy.fitting.estimation import Estimate, Problem, estimate, simulate_at
from modal.discrepancy.fitting.nodes import Node, Task, node_of, polished
from modal.discrepancy.fitting.observer_form import observer_gain
from modal.simulation.assembly import Assembly
from modal.simulation.tolerances import AT_FLOOR

__all__ = ["calibrated_node", "fitted_either_way"]

WIDER = 4.0
"""Factor by which bounds are moved out."""


def calibrated_node(start: Estimate, task: Task) -> Node:
    """The linear parameters and the initial states fitted, and judged on the held-out records.

    Args:
        start: The model as it was given.
        task: Records and catalogue.

    Returns:
        The model; within wider bounds where these explain the records and those given do not.
    """
    found = polished(node_of(fitted_either_way(start, task.fit, iterations=12), task), task)
    if found.held_out_level <= AT_FLOOR or not found.coarse.at_bounds[: start.assembly.n_linear].any():
        return found
    wide = simulate_at(_widened(start.assembly), start.unknowns, task.fit, smoothing=start.smoothing)
    if wide is None:
        return found
    free = polished(node_of(fitted_either_way(wide, task.fit, iterations=12), task), task)
    return free if max(free.fit_level, free.held_out_level) <= AT_FLOOR else found


def _widened(assembly: Assembly) -> Assembly:
    """The model with bounds of its linear parameters that lie further out."""
    parameters = tuple(
        replace(one, lower=min(one.lower / WIDER, one.lower * WIDER), upper=max(one.upper / WIDER, one.upper * WIDER))
        for one in assembly.plant.parameters
    )
    return replace(assembly, plant=replace(assembly.plant, parameters=parameters))


def fitted_either_way(start: Estimate, problem: Problem, *, iterations: int) -> Estimate:
    """The better of the fit in free run and the one that begins in observer form.

    Args:
        start: The model to start from, in free run.
        problem: Records to fit.
        iterations: Largest number of iterations of a free run.
    """
    found = estimate(start, problem, iterations=iterations)
    if found.level <= AT_FLOOR:
        return found
    observed = _by_observer(start, problem, iterations)
    return found if observed is None or observed.cost >= found.cost else observed


def _by_observer(start: Estimate, problem: Problem, iterations: int) -> Estimate | None:
    steps = int(problem.drive.rows[1]) if len(problem.drive.rows) > 1 else 1
    gain = observer_gain(start, problem, steps)
    if gain is None:
        return None
    observed = simulate_at(
        start.assembly, start.unknowns, problem, states=start.trajectory.states, gain=gain, smoothing=start.smoothing
    )
    if observed is None:
        return None
    near = estimate(observed, problem, iterations=6)
    free = simulate_at(start.assembly, near.unknowns, problem, states=near.trajectory.states, smoothing=start.smoothing)
    return None if free is None else estimate(free, problem, iterations=iterations)
