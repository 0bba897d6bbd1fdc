"""Chains of masses as a state space in states that mean nothing, with the physical states in them known."""

import numpy as np
import scipy

from modal.structure.continuous_time import ContinuousSystem, in_modal_coordinates


class Chain:
    """A random chain of masses seen in random states, its force directions in them, and what the code is given."""

    def __init__(self, seed, n_dofs, sensors, pushed, *, gyroscopic=0.0, share=0.4):
        rng = np.random.default_rng(seed)
        self.masses = rng.uniform(0.7, 1.5, n_dofs)
        springs, dampers = rng.uniform(70.0, 150.0, n_dofs), rng.uniform(0.1, 0.4, n_dofs)
        differences = np.eye(n_dofs) - np.eye(n_dofs, k=-1)
        self.stiffness = differences.T @ np.diag(springs) @ differences
        self.damping = differences.T @ np.diag(dampers) @ differences
        self.damping[0, -1] += gyroscopic
        self.damping[-1, 0] -= gyroscopic
        inverse = np.diag(1 / self.masses)
        lower = -inverse @ np.hstack([self.stiffness, self.damping])
        A = np.vstack([np.hstack([np.zeros((n_dofs, n_dofs)), np.eye(n_dofs)]), lower])
        push = np.zeros((2 * n_dofs, 1))
        push[n_dofs + pushed] = share / self.masses[pushed]
        C = np.eye(2 * n_dofs)[list(sensors)]
        mix = rng.standard_normal((2 * n_dofs, 2 * n_dofs))
        back = np.linalg.inv(mix)
        given = ContinuousSystem(A=mix @ A @ back, B=mix @ push, C=C @ back, D=np.zeros((len(C), 1)))
        self.system = in_modal_coordinates(given, frequency_tolerance=0.1, damping_tolerance=0.5).system
        self.free = scipy.linalg.null_space(self.system.C)
        seen = [
            np.vstack([c @ np.linalg.matrix_power(a, k) for k in range(2 * n_dofs)])
            for a, c in ((self.system.A, self.system.C), (A, C))
        ]
        self.states = np.linalg.lstsq(seen[0], seen[1], rcond=None)[0]  # modal states by [x; v]

    @property
    def forces(self):
        return self.states[:, len(self.masses) :] / self.masses
