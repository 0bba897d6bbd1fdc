"""Chains of masses with one extra force, integrated by the classical Runge-Kutta rule; nothing of the product is used.

All records of a set run side by side, so that one plain loop over time serves several levels. What a step does linearly
is one matrix, found by the rule itself from unit vectors.
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
    h, moves = dt / n_steps, np.kron(np.eye(2), direction).T  # of the element: how far, how fast

    def slope(state: np.ndarray, force: np.ndarray, extra: np.ndarray) -> np.ndarray:
        position, speed = state[:, :n_dofs], state[:, n_dofs:]
        push = -position @ stiffness - speed @ damping - extra[:, np.newaxis] * direction
        push[:, force_dof] += force
        return np.hstack([speed, push * gain])

    def step(state: np.ndarray, force: np.ndarray, extras: np.ndarray) -> np.ndarray:
        """How the element moves at each of the four stages, and the state at the end, where the extra forces are so."""
        a = slope(state, force, extras[:, 0])
        b = slope(second := state + 0.5 * h * a, force, extras[:, 1])
        c = slope(third := state + 0.5 * h * b, force, extras[:, 2])
        d = slope(fourth := state + h * c, force, extras[:, 3])
        end = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return np.hstack([*(one @ moves for one in (state, second, third, fourth)), end])

    # a step is linear in all but the extra forces, each of which needs the ones before it alone
    units = np.eye(2 * n_dofs + 5)
    by_all = step(units[:, : 2 * n_dofs], units[:, 2 * n_dofs], units[:, 2 * n_dofs + 1 :])
    by_state, by_force, by_extra = by_all[: 2 * n_dofs], by_all[2 * n_dofs], by_all[2 * n_dofs + 1 :]
    forced = np.swapaxes(inputs, 0, 1)[:, :, np.newaxis] * by_force
    x = np.zeros((n_records, 2 * n_dofs)) if start is None else np.array(start, dtype=float)
    result = np.empty((n_records, inputs.shape[1], n_dofs))
    for k, push in enumerate(forced):
        result[:, k] = x[:, :n_dofs]
        for i in range(n_steps):
            found, t = x @ by_state + push, k * dt + i * h
            if law is not no_force:
                for stage, (later, by_one) in enumerate(zip((0.0, 0.5, 0.5, 1.0), by_extra, strict=True)):
                    extra = law(found[:, 2 * stage], found[:, 2 * stage + 1], t + later * h)
                    found += extra[:, np.newaxis] * by_one
            x = found[:, 8:]
    return result
