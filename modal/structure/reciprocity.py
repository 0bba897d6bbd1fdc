"""Whether a state space is that of a structure, and then the forces and displacements of its degrees of freedom.

In a structure M q'' + C q' + K q = b u with symmetric matrices a force at one place moves another as much as the same
force there moves this one (Maxwell 1864, Betti 1872). For the states x = [q; q'] that reads

    P A = A' P,    P = [[C, M], [M, 0]],    P A = [[-K, 0], [0, M]],

and in any other states T x it holds with T^-T P T^-1. In real modal form each block of A leaves two numbers of P open
(one for a real pole), so P follows from linear equations: forces move no displacement at once (N' P N = 0 with N the
directions that leave the measured displacements where they are), and P b is the displacement row of an output where
and along which an input pushes, if there is one: a driving point. The mass matrix must come out positive definite,
which at a driving point says that all modes answer with one sign.

What a wrong spring or damper does is then known up to one symmetric matrix each, and so is the direction of a force
along a sensor.

References:
    Ewins, Modal Testing, 2nd ed. 2000, sections 2.4 and 2.6 (reciprocity, driving points); Lancaster, Prells,
    Inverse problems for damped vibrating systems, J. Sound Vib. 283, 2005, https://doi.org/10.1016/j.jsv.2004.05.003
"""

from dataclasses import dataclass

import numpy as np
import scipy

from modal.simulation.tolerances import ROUNDING
from modal.structure.continuous_time import ContinuousSystem
from okid.arrays import FloatArray

__all__ = ["Structure", "reciprocal_structure"]

_LIKE = 1e-3
"""Defect of the equations, as a share of what tells one solution from the next: an error of a thousandth in a direction
or shape lies below the noise of any measured record."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Structure:
    """The undamped modes of the structure, unit modal masses, by rising frequency: q'' + C q' + K q = forces' part.

    Attributes:
        displacements: (n_modes, n_states) rows that give the modal displacements q.
        forces: (n_states, n_modes) directions in which a unit force on each mode changes the states at once.
        stiffness: (n_modes,) squares of the natural frequencies [rad^2/s^2], the diagonal of K.
        damping: (n_modes, n_modes) symmetric C [1/s].
    """

    displacements: FloatArray
    forces: FloatArray
    stiffness: FloatArray
    damping: FloatArray

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.stiffness)


def reciprocal_structure(system: ContinuousSystem, displacements: FloatArray, free: FloatArray) -> Structure | None:
    """The structure behind a state space.

    Args:
        system: In real modal form.
        displacements: (n_measured, n_states) rows of the measured displacements.
        free: (n_states, n_free) orthonormal directions that leave these where they are.

    Returns:
        The structure; None where the system is none, where the measured displacements are fewer than the modes by more
        than one, or where too little is measured to check it by (a single displacement of several modes; two modes
        without a driving point).

    Example:
        >>> A = np.array([[-0.2, 1.99], [-1.99, -0.2]])
        >>> mass_on_spring = ContinuousSystem(
        ...     A=A, B=np.array([[0.0], [1.0]]), C=np.array([[0.5, 0.0]]), D=np.zeros((1, 1))
        ... )
        >>> found = reciprocal_structure(mass_on_spring, mass_on_spring.C, np.array([[0.0], [1.0]]))
        >>> found.stiffness.round(4), found.damping.round(4)
        (array([4.0001]), array([[0.4]]))
    """
    n_states = len(system.A)
    n_modes = n_states // 2
    unseen = free.shape[1] - n_modes
    if n_states % 2 or unseen < 0 or unseen > 1 or (unseen == 1 and n_states - free.shape[1] < 2):
        return None
    basis = _metrics(system.A)
    if basis is None:
        return None
    for equations in _equations(system, displacements, free if unseen == 0 else None, basis):
        metric = _solution(equations, basis)
        structure = None if metric is None else _structure(system.A, metric, free, displacements)
        if structure is not None:
            return structure
    return None


def _metrics(A: FloatArray) -> FloatArray | None:
    """(n_states, n_states, n_states) a basis of the symmetric P with P A symmetric; None unless A is block diagonal."""
    n_states = len(A)
    found = np.zeros((n_states, n_states, n_states))
    row = 0
    while row < n_states:
        if row + 1 < n_states and A[row + 1, row] != 0:
            found[row, row, row], found[row, row + 1, row + 1] = 1.0, -1.0
            found[row + 1, row, row + 1] = found[row + 1, row + 1, row] = 1.0
            row += 2
        else:
            found[row, row, row] = 1.0
            row += 1
    product = found @ A
    apart = np.abs(product - np.swapaxes(product, 1, 2)).max(initial=0.0)
    return found if apart <= ROUNDING * np.abs(A).max() else None


def _equations(
    system: ContinuousSystem, displacements: FloatArray, free: FloatArray | None, basis: FloatArray
) -> list[FloatArray]:
    """Homogeneous equations in the numbers of P (and a factor): of each driving point, then of none.

    Without a driving point two modes would give three equations for four numbers: some P solves them for any system.
    One mode has one direction of force in any case.
    """
    n_states = len(basis)
    still = np.zeros((0, n_states))
    if free is not None:
        upper = np.triu_indices(free.shape[1])
        still = np.array([(free.T @ one @ free)[upper] for one in basis]).T
    found = []
    for push in system.B.T:
        for row in displacements:
            if push.any() and row.any():
                at_point = (basis @ (push / np.linalg.norm(push))).T
                at_point = np.column_stack([at_point, -row / np.linalg.norm(row)])
                found.append(np.vstack([at_point, np.column_stack([still, np.zeros(len(still))])]))
    if len(still) >= n_states or n_states == 2:  # else nothing would be left to check the one solution by
        found.append(still)
    return found


def _solution(equations: FloatArray, basis: FloatArray) -> FloatArray | None:
    """The one P that solves them; None where none or more than one does."""
    _, sizes, right = np.linalg.svd(equations)
    sizes = np.concatenate([sizes, np.zeros(len(right) - len(sizes))])
    if sizes[-1] > _LIKE * sizes[-2] or sizes[-2] <= ROUNDING * sizes[0]:
        return None
    return np.asarray(np.tensordot(right[-1, : len(basis)], basis, axes=(0, 0)))


def _structure(A: FloatArray, metric: FloatArray, free: FloatArray, displacements: FloatArray) -> Structure | None:
    """The structure of one P, whose sign is open; None where masses or stiffnesses would not be positive."""
    for signed in (metric, -metric):
        for forces in _force_directions(signed, free, displacements):
            mass = forces.T @ signed @ A @ forces
            sizes = np.linalg.eigvalsh((mass + mass.T) / 2)
            if sizes[0] > ROUNDING * sizes[-1]:
                unit = np.linalg.solve(np.linalg.cholesky((mass + mass.T) / 2), forces.T).T
                return _modes(A, signed, unit)
    return None


def _force_directions(metric: FloatArray, free: FloatArray, displacements: FloatArray) -> list[FloatArray]:
    """The directions of all forces: the free ones; with one displacement unseen a subspace of them, one of two.

    Forces along the sensors are P^-1 D' with D the displacement rows. What else is free is a plane in which P has one
    positive and one negative direction; the force that is missing lies where P is zero, on one of two lines, and of
    these on the one with a positive mass.
    """
    if free.shape[1] == len(metric) // 2:
        return [free]
    rows = displacements / np.linalg.norm(displacements, axis=1)[:, None]
    along = np.linalg.solve(metric, rows.T)
    along = along / np.linalg.norm(along, axis=0)
    if np.abs(along.T @ metric @ along).max() > _LIKE * np.abs(metric).max():
        return []
    rest = scipy.linalg.null_space(np.vstack([along.T, rows]))
    sizes, axes = np.linalg.eigh(rest.T @ metric @ rest)
    if not sizes[0] < 0.0 < sizes[-1]:
        return []
    low, high = axes[:, 0] / np.sqrt(-sizes[0]), axes[:, -1] / np.sqrt(sizes[-1])
    return [np.column_stack([along, rest @ (low + sense * high)]) for sense in (1.0, -1.0)]


def _modes(A: FloatArray, metric: FloatArray, forces: FloatArray) -> Structure | None:
    """Undamped modes of the structure whose forces act in these directions, on unit masses."""
    n_modes = forces.shape[1]
    rows = forces.T @ metric
    both = np.vstack([rows, rows @ A])
    scale = np.linalg.norm(both, axis=1)
    if np.linalg.cond(both / scale[:, None]) * ROUNDING > 1.0:
        return None
    matrices = -np.linalg.solve(both.T, (rows @ A @ A).T).T
    stiffness, damping = matrices[:, :n_modes], matrices[:, n_modes:]
    squares, shapes = np.linalg.eigh((stiffness + stiffness.T) / 2)
    if squares[0] <= ROUNDING * squares[-1]:
        return None
    modal = shapes.T @ damping @ shapes
    return Structure(
        displacements=shapes.T @ rows, forces=forces @ shapes, stiffness=squares, damping=(modal + modal.T) / 2
    )
