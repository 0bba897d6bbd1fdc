"""From the observer form to the free run by smaller and smaller gains, where the way in one step is lost.

With hard laws and little damping the free run of a model that is slightly off is out of step with the record after a
few impacts, and no step of a fit leads back. A weaker correction asks for a little more of the model each time: the
right one follows all the way, while what is left of a wrong one grows from gain to gain and soon ends the attempt.
"""

from modal.discrepancy.estimation import Estimate, Problem, estimate, simulate_at
from okid.arrays import FloatArray

__all__ = ["LOST", "graded_run"]

GRADES = (0.5, 0.25, 0.12, 0.06, 0.03, 0.015, 0.007)
"""Shares of the gain, the free run after them."""
ITERATIONS, MOVING = 3, 0.03
"""Each is fitted by so many iterations at most, or until one gains less than the second share."""
LOST = 10.0
"""A model whose cost has grown by this factor since the full gain is not followed on."""


def graded_run(fit: Estimate, problem: Problem, *, smoothing: float) -> Estimate | None:
    """The model near its free run, fitted gain by gain.

    Args:
        fit: Fitted in observer form.
        problem: The records it was fitted to.
        smoothing: Width of sharp laws, as a share of the motion's scale.

    Returns:
        The model in free run, not fitted yet; None where it is lost on the way, or there is no gain to begin with.

    References:
        Allgower, Georg, Introduction to Numerical Continuation Methods, 2003,
        https://doi.org/10.1137/1.9780898719154
    """
    if fit.gain is None:
        return None
    current = fit
    for share in GRADES:
        start = _at(current, problem, share * fit.gain, smoothing)
        if start is None:
            return None
        current = estimate(start, problem, iterations=ITERATIONS, standstill=MOVING)
        if current.cost > LOST * fit.cost:
            return None
    return _at(current, problem, None, smoothing)


def _at(current: Estimate, problem: Problem, gain: FloatArray | None, smoothing: float) -> Estimate | None:
    return simulate_at(
        current.assembly,
        current.unknowns,
        problem,
        states=current.trajectory.states,
        gain=gain,
        smoothing=smoothing,
        start="near",
    )
