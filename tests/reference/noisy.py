"""Systems with process and measurement noise, with the exact predictor gain and innovation covariance; no product code.

Everything stands in units in which each output's measurement noise has the standard deviation `measured`.
"""

from dataclasses import dataclass

import numpy as np
import scipy
import systems
from systems import TruthSystem, random_system


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NoisySystem:
    """x+ = A x + B u + w, y = C x + D u + v, with the Riccati gain K of its one-step predictor and Re = C P C' + R."""

    system: TruthSystem
    K: np.ndarray
    covariance: np.ndarray
    process: float
    measured: float

    @property
    def information(self) -> np.ndarray:
        """(order, order) W = sum of Abar'^l C' Re^-1 C Abar^l, so that the covariance of K is W^-1 (x) Re^-1 / N."""
        closed = self.system.A - self.K @ self.system.C
        weight = self.system.C.T @ np.linalg.solve(self.covariance, self.system.C)
        return scipy.linalg.solve_discrete_lyapunov(closed.T, weight)


def noisy_system(rng, *, n_modes=2, n_inputs=2, n_outputs=2, process=0.2, measured=0.7):
    system = random_system(rng, n_modes=n_modes, n_inputs=n_inputs, n_outputs=n_outputs, weak_mode=None)
    R = measured**2 * np.eye(n_outputs)
    P = scipy.linalg.solve_discrete_are(system.A.T, system.C.T, process**2 * np.eye(system.order), R)
    covariance = system.C @ P @ system.C.T + R
    K = np.linalg.solve(covariance, (system.A @ P @ system.C.T).T).T
    return NoisySystem(system=system, K=K, covariance=covariance, process=process, measured=measured)


def noisy_data(rng, noisy, n_samples, *, initial_state=None):
    """Inputs and outputs from a plain loop."""
    system = noisy.system
    u = rng.standard_normal((n_samples, system.n_inputs))
    w = noisy.process * rng.standard_normal((n_samples, system.order))
    y = systems.simulate(system, u, initial_state=initial_state, process_noise=w)
    return u, y + noisy.measured * rng.standard_normal(y.shape)
