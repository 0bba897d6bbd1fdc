"""Fit a model whose first values may be far off: in free run, and by way of the observer form where that leaves a gap.

The free run of a lightly damped model whose frequency is off by more than the width of the resonance is out of step
with the record from the first beat on: the error hardly falls towards the right frequency, more damping lowers it, and
the fit creeps or stops on a bound. In observer form the measured outputs keep model and record in step, so that the fit
is contractive; from there the free run is near its minimum.
"""

from modal.discrepancy.estimation import Estimate, Problem, estimate, simulate_at
from modal.discrepancy.nodes import Node, Task, node_of, polished
from modal.discrepancy.observer import observer_gain

__all__ = ["calibrated_node", "fitted_either_way"]

EXPLAINED = 1.2
"""Mean square of the residual, in units of the floor, above which a fit in free run may be a false minimum."""


def calibrated_node(start: Estimate, task: Task) -> Node:
    """The linear parameters and the initial states fitted, and judged on the held-out records.

    Args:
        start: The model as it was given.
        task: Records and catalogue.
    """
    return polished(node_of(fitted_either_way(start, task.fit, iterations=12), task), task)


def fitted_either_way(start: Estimate, problem: Problem, *, iterations: int) -> Estimate:
    """The better of the fit in free run and the one that begins in observer form.

    Args:
        start: The model to start from, in free run.
        problem: Records to fit.
        iterations: Largest number of iterations of a free run.
    """
    found = estimate(start, problem, iterations=iterations)
    if found.level <= EXPLAINED:
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
