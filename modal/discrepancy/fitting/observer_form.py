"""The observer form of a model that is still wrong: a Kalman gain that lays what is missing to random port forces.

A free run of a wrong model drifts away from the measured motion, and a law evaluated along it is the law of another
motion. Corrected by the measured outputs, the states stay near the true ones, whatever is missing; the fit in this form
has hardly any local minima. The nearer the model, the smaller the forces and the gain: the form turns into the free
run.
"""

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import Estimate, Problem
from okid.arrays import TINY, FloatArray

__all__ = ["observer_gain"]


def observer_gain(current: Estimate, problem: Problem, upsampling: int) -> FloatArray | None:
    """The steady Kalman gain for forces at the ports that would explain what the model leaves.

    The forces are white between samples, all ports alike, of the size at which the model's outputs would have the
    residual's mean square above the floor; the measurement noise is the floor.

    Args:
        current: A model in free run.
        problem: The records it is compared with.
        upsampling: Steps of the simulation per sample.

    Returns:
        L (n_states, n_outputs) for one step of the simulation, or None where no gain is needed (no residual above the
        floor), none exists or the plant has no states.

    References:
        Anderson, Moore, Optimal Filtering, 1979 (correlated process and measurement noise, section 5.4).
    """
    scheme = current.scheme
    n = len(scheme.Ad)
    floor = np.exp(np.mean(np.log(problem.floor), axis=0))
    excess = np.nanmean(np.maximum(current.mean_square - 1.0, 0.0), axis=0) * floor
    if n == 0 or scheme.E0.shape[1] == 0 or not np.any(excess > 1e-3 * floor):
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
