"""Chains of masses with one extra force, integrated by the classical Runge-Kutta rule; nothing of the product is used.

All records of a set run side by side, so that one plain loop over time serves several levels.
"""

from collections.abc import Callable, Sequence

import numpy as np
from systems import chain_matrices

Law = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""(displacement, velocity) between the ends of an element, each (n_records,), and the time -> force opposing motion."""


def no_force(d: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    return np.zeros_like(d)


def run_chain(
    masses: Sequence[float],
    stiffnesses: Sequence[float],
    dampings: Sequence[float],
    inputs: np.ndarray,
    dt: float,
    *,
    force_dof: int = 0,
    law: Law = no_force,
    element: int = 0,
    n_steps: int = 4,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """(n_records, n_samples, n_dofs) displacements; `inputs` (n_records, n_samples) held between samples.

    `law` acts in `element`, between mass element - 1 (element 0: the ground) and mass element.
    """
    _, damping, stiffness = chain_matrices(masses, stiffnesses, dampings)
    n_dofs, n_records = len(masses), len(inputs)
    gain = 1.0 / np.asarray(masses, dtype=float)
    direction = np.zeros(n_dofs)
    direction[element] = 1.0
    if element > 0:
        direction[element - 1] = -1.0
    h = dt / n_steps
    x = np.zeros((n_records, 2 * n_dofs)) if start is None else np.array(start, dtype=float)
    result = np.empty((n_records, inputs.shape[1], n_dofs))

    def slope(state: np.ndarray, force: np.ndarray, t: float) -> np.ndarray:
        position, speed = state[:, :n_dofs], state[:, n_dofs:]
        extra = law(position @ direction, speed @ direction, t)
        push = -position @ stiffness - speed @ damping - extra[:, np.newaxis] * direction
        push[:, force_dof] += force
        return np.hstack([speed, push * gain])

    for k in range(inputs.shape[1]):
        result[:, k] = x[:, :n_dofs]
        for i in range(n_steps):
            t = k * dt + i * h
            a = slope(x, inputs[:, k], t)
            b = slope(x + 0.5 * h * a, inputs[:, k], t + 0.5 * h)
            c = slope(x + 0.5 * h * b, inputs[:, k], t + 0.5 * h)
            d = slope(x + h * c, inputs[:, k], t + h)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return result
