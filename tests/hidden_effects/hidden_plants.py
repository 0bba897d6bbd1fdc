"""True plants: chains of masses, motors and tanks, with places where a hidden effect can act and sensors of any kind.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass

import numpy as np
from hidden_integrator import HiddenPlant

__all__ = ["Absorber", "TrueChain", "TrueRotor", "chain_matrices", "chain_plant", "outputs_of", "rotor_plant"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Absorber:
    """A mass on a spring and a damper, hung on one degree of freedom: a mode that the model misses."""

    dof: int
    mass: float
    frequency: float
    damping_ratio: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrueChain:
    """Element e joins degree of freedom e - 1 and e, element 0 the ground. SI units."""

    masses: np.ndarray
    stiffnesses: np.ndarray
    dampings: np.ndarray
    force_dofs: tuple[int, ...]
    sensor_dofs: tuple[int, ...]
    sensor_kind: str

    @property
    def n_dofs(self):
        return len(self.masses)

    @property
    def natural_frequencies(self):
        """(n_dofs,) [rad/s], rising."""
        mass, _, stiffness = chain_matrices(self)
        return np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrueRotor:
    """J v' = kt u - b v, v measured: the speed of a motor or the level of a tank (which may overflow)."""

    J: float
    b: float
    kt: float
    limit: float | None = None


def chain_matrices(chain, absorber=None):
    """Mass, damping and stiffness matrix; the absorber's degree of freedom is the last."""
    n = len(chain.masses)
    size = n + (absorber is not None)
    mass, damping, stiffness = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    mass[np.arange(n), np.arange(n)] = chain.masses
    for e in range(n):
        row = place_row(f"element_{e}", size)
        stiffness += chain.stiffnesses[e] * np.outer(row, row)
        damping += chain.dampings[e] * np.outer(row, row)
    if absorber is not None:
        row = np.zeros(size)
        row[n], row[absorber.dof] = 1.0, -1.0
        omega = 2 * np.pi * absorber.frequency
        mass[n, n] = absorber.mass
        stiffness += absorber.mass * omega**2 * np.outer(row, row)
        damping += 2 * absorber.damping_ratio * absorber.mass * omega * np.outer(row, row)
    return mass, damping, stiffness


def place_row(place, n_dofs):
    """(n_dofs,) relative displacement at "element_e", displacement at "dof_i"; by its transpose the force enters."""
    sort, number = place.split("_")
    row, index = np.zeros(n_dofs), int(number)
    row[index] = 1.0
    if sort == "element" and index > 0:
        row[index - 1] = -1.0
    return row


def chain_plant(chain, places, absorber=None):
    """State (x, x'): the plant, and the output rows C, D, G of y = C x + D u + G w."""
    mass, damping, stiffness = chain_matrices(chain, absorber)
    size = len(mass)
    rows = np.array([place_row(place, size) for place in places]).reshape(len(places), size)
    lower = np.hstack([-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)])
    A = np.vstack([np.hstack([np.zeros((size, size)), np.eye(size)]), lower])
    force = np.linalg.solve(mass, np.eye(size)[:, list(chain.force_dofs)])
    push = -np.linalg.solve(mass, rows.T)
    plant = HiddenPlant(
        A=A,
        B=np.vstack([np.zeros_like(force), force]),
        E=np.vstack([np.zeros_like(push), push]),
        displacement=np.hstack([rows, np.zeros_like(rows)]),
        velocity=np.hstack([np.zeros_like(rows), rows]),
    )
    sensors = list(chain.sensor_dofs)
    if chain.sensor_kind == "acceleration":
        return plant, (lower[sensors], force[sensors], push[sensors])
    C = np.eye(2 * size)[[dof + size * (chain.sensor_kind == "velocity") for dof in sensors]]
    return plant, (C, np.zeros((len(sensors), force.shape[1])), np.zeros((len(sensors), len(places))))


def rotor_plant(rotor, n_places):
    """State v; every place is the rotor itself."""
    plant = HiddenPlant(
        A=np.array([[-rotor.b / rotor.J]]),
        B=np.array([[rotor.kt / rotor.J]]),
        E=np.full((1, n_places), -1.0 / rotor.J),
        displacement=np.zeros((n_places, 1)),
        velocity=np.ones((n_places, 1)),
        limit=None if rotor.limit is None else (0, rotor.limit),
    )
    return plant, (np.eye(1), np.zeros((1, 1)), np.zeros((1, n_places)))


def outputs_of(run, rows, inputs):
    """(n_records, n_samples, n_outputs); `inputs` as they reach the plant."""
    C, D, G = rows
    return run.states @ C.T + inputs @ D.T + run.forces @ G.T
