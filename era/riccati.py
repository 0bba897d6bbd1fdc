"""Gains from noise covariances by the Riccati equation, and a stable gain for one that is not."""

import numpy as np
import scipy

from era.realisation import Realisation
from okid.arrays import FloatArray

__all__ = ["riccati_gain", "stabilised_gain"]


def stabilised_gain(realisation: Realisation, gain: FloatArray, innovation_covariance: FloatArray) -> FloatArray:
    """The gain itself where A - K C is stable; else the stable one of the same innovation spectrum, or zero if none is.

    Args:
        realisation: A and C.
        gain: (order, n_outputs).
        innovation_covariance: (n_outputs, n_outputs) of the innovations that the gain gives.

    Example:
        >>> model = Realisation([[0.9]], np.empty((1, 0)), [[1.0]], np.empty((1, 0)), 0.01)
        >>> stabilised_gain(model, np.array([[2.9]]), np.eye(1)).round(9)
        array([[1.4]])
    """
    A, C = realisation.A, realisation.C
    if np.abs(np.linalg.eigvals(A - gain @ C)).max(initial=0.0) < 1.0:
        return gain
    S = gain @ innovation_covariance
    return riccati_gain(A, C, S @ gain.T, innovation_covariance, S)


def riccati_gain(A: FloatArray, C: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray) -> FloatArray:
    """Predictor gain (A P C' + S) (C P C' + R)^-1; zero where no solution P is stabilising.

    Args:
        A: (order, order).
        C: (n_outputs, order).
        Q: (order, order) covariance of the process noise.
        R: (n_outputs, n_outputs) covariance of the measurement noise.
        S: (order, n_outputs) covariance between the two.

    Example:
        >>> one = np.ones((1, 1))
        >>> riccati_gain(0.5 * one, one, 0.01 * one, one, 0.1 * one).round(6)
        array([[0.1]])
    """
    nothing = np.zeros_like(S)
    try:
        P = scipy.linalg.solve_discrete_are(A.T, C.T, (Q + Q.T) / 2, (R + R.T) / 2, s=S)
        stable = np.asarray(np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T, dtype=np.float64)
    except (np.linalg.LinAlgError, ValueError):  # no stabilising solution, or R singular
        return nothing
    if not np.isfinite(stable).all() or np.abs(np.linalg.eigvals(A - stable @ C)).max() >= 1.0:
        return nothing
    return stable
