"""The observer form of a model that is still wrong, and the way to the free run by smaller and smaller gains.

A free run of a wrong model drifts away from the measured motion, and a law evaluated along it is the law of another
motion. A Kalman gain that lays what is missing to random port forces keeps the states near the true ones, whatever is
missing; the fit in this form has hardly any local minima. The nearer the model, the smaller the forces and the gain.

With hard laws and little damping the free run of a model that is slightly off is out of step with the record after a
few impacts, and no step of a fit leads back. A weaker correction asks for a little more of the model each time: the
right one follows all the way, while what is left of a wrong one grows from gain to gain and soon ends the attempt.
"""

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import Estimate, Problem, estimate, simulate_at
from okid.arrays import ROUNDED, TINY, FloatArray


def observer_gain(current: Estimate, problem: Problem) -> FloatArray | None:
    """The steady Kalman gain for forces at the ports that would explain what the model leaves.

    The forces are white between samples, all ports alike, of the size at which the model's outputs would have the
    residual's mean square above the floor; the measurement noise is the floor.

    Returns:
        L (n_states, n_outputs) for one step of the simulation, or None where no gain is needed (no residual above the
        floor), none exists, the motion escapes or the plant has no states.

    References:
        Anderson, Moore, Optimal Filtering, 1979 (correlated process and measurement noise, section 5.4).
    """
    scheme, upsampling = current.scheme, problem.upsampling
    n = len(scheme.Ad)
    floor = np.exp(np.mean(np.log(problem.floor), axis=0))
    excess = np.nanmean(np.maximum(current.mean_square - 1.0, 0.0), axis=0) * floor
    if n == 0 or scheme.E0.shape[1] == 0 or not np.any(excess > 1e-3 * floor):
        return None
    if not np.all(excess * ROUNDED**2 < floor):  # it escapes: beside what it leaves the noise is rounded off
        return None
    A, E = _sampled(scheme.Ad, scheme.E0 + scheme.E1, upsampling)
    unit = E / np.maximum(np.linalg.norm(E, axis=0), TINY)
    G = scheme.G / np.maximum(np.linalg.norm(E, axis=0), TINY)
    try:
        spread = scipy.linalg.solve_discrete_lyapunov(_damped(A), unit @ unit.T)
        response = np.diag(scheme.C @ spread @ scheme.C.T + G @ G.T)
        size = float(np.median(excess / np.maximum(response, TINY)))
        R = np.diag(floor) + size * (G @ G.T)
        P = scipy.linalg.solve_discrete_are(_damped(A).T, scheme.C.T, size * unit @ unit.T, R, s=size * unit @ G.T)
        innovation = scheme.C @ P @ scheme.C.T + R
        gain = np.linalg.solve(innovation, (A @ P @ scheme.C.T + size * unit @ G.T).T).T
        back = np.linalg.solve(np.linalg.matrix_power(scheme.Ad, upsampling - 1), gain)
    except (np.linalg.LinAlgError, ValueError):
        return None
    stable = np.abs(np.linalg.eigvals(A - gain @ scheme.C)).max() < 1.0
    return np.asarray(back) if stable and np.isfinite(back).all() else None


def _sampled(Ad: FloatArray, E: FloatArray, upsampling: int) -> tuple[FloatArray, FloatArray]:
    A, total, power = np.linalg.matrix_power(Ad, upsampling), np.zeros_like(E), np.eye(len(Ad))
    for _ in range(upsampling):
        total = total + power @ E
        power = Ad @ power
    return A, total


def _damped(A: FloatArray) -> FloatArray:
    """A with a spectral radius below one, so that an integrator's spread is finite."""
    radius = float(np.abs(np.linalg.eigvals(A)).max())
    return A if radius < 1.0 - 1e-6 else A * (1.0 - 1e-6) / radius


SHRINK, GENTLEST, LEAST = 0.5, 0.8, 0.2
"""Leave this share of the gain from one fit to the next: at first, the largest one once that led nowhere, and the
least."""
SMALLEST = 0.003
"""Try the free run from this share of the first gain on."""
ITERATIONS, MOVING = 3, 0.03
"""Fit each by so many iterations at most, or until one gains less than the second share."""
ENOUGH, MISSED, FAR_OFF = 2.0, 0.03, 1000.0
HARDLY_ANY = 0.05
"""Call a motion lost where with hardly any of the gain the level is below the first or the model misses less than the
second share of the outputs, root mean square, and no free run is found or its cost is so many times as large."""
LOST = 10.0
"""Follow no model whose cost has grown by this factor since the full gain."""


class LostMotion(Exception):  # noqa: N818 - no error: the search begins again on shorter records
    """A model explains the records down to the smallest gain, and its free run cannot be followed."""


def graded_run(fit: Estimate, problem: Problem, *, smoothing: float) -> Estimate | None:
    """The model near its free run, fitted gain by gain.

    Returns:
        The model in free run, not fitted yet; None where it is lost on the way, or there is no gain to begin with.

    Raises:
        LostMotion: The model explains the records down to the smallest gain, but not in free run.

    References:
        Allgower, Georg, Introduction to Numerical Continuation Methods, 2003,
        https://doi.org/10.1137/1.9780898719154
    """
    if fit.gain is None:
        return None
    current, shrink = fit, SHRINK
    while _size(current.gain) > SMALLEST * _size(fit.gain):
        start = _at(current, problem, _weaker(current, problem, shrink), smoothing)
        if start is None:
            shrink = float(np.sqrt(shrink))
            if shrink > GENTLEST:
                _check_lost(current, fit, problem)
                return None
            continue
        current = estimate(start, problem, iterations=ITERATIONS, standstill=MOVING)
        if current.cost > LOST * fit.cost:
            return None
    free = _at(current, problem, None, smoothing)
    if free is not None and free.cost <= FAR_OFF * current.cost:
        return free
    _check_lost(current, fit, problem)
    return None


def _weaker(current: Estimate, problem: Problem, shrink: float) -> FloatArray:
    """A share of the gain, or the gain for what the model leaves by now, not less than a fifth in size."""
    gain = np.asarray(current.gain)
    if shrink != SHRINK:
        return shrink * gain
    wanted = observer_gain(current, problem)
    if wanted is None or _size(wanted) > shrink * _size(gain):
        return shrink * gain
    return wanted * max(LEAST * _size(gain) / _size(wanted), 1.0)


def _check_lost(current: Estimate, fit: Estimate, problem: Problem) -> None:
    """A motion is lost where hardly any correction keeps the model with the records, and none does not."""
    explained = current.level <= ENOUGH or _hardly_missed(current, problem)
    if explained and _size(current.gain) <= HARDLY_ANY * _size(fit.gain):
        raise LostMotion


def _hardly_missed(current: Estimate, problem: Problem) -> bool:
    """Whether the model misses little of the motion in each output of each record, or no more than noise."""
    drive = problem.drive
    for record in range(drive.n_records):
        rows = drive.rows_of(record)
        moved = np.var(drive.outputs[rows], axis=0, where=drive.present[rows])
        level = current.mean_square[record]
        if np.any((level > ENOUGH) & (level * problem.floor[record] > MISSED**2 * moved)):
            return False
    return True


def _size(gain: FloatArray | None) -> float:
    return 0.0 if gain is None else float(np.abs(gain).max())


def _at(current: Estimate, problem: Problem, gain: FloatArray | None, smoothing: float) -> Estimate | None:
    return simulate_at(
        current.assembly,
        current.unknowns,
        problem,
        states=current.trajectory.states,
        gain=gain,
        smoothing=smoothing,
        start="far" if gain is None else "near",
    )
