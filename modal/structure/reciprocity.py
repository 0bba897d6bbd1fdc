"""What stands behind a state space: the motion of its outputs, the structure if it is one, and what may be wrong in it.

In a structure M q'' + C q' + K q = b u with symmetric matrices a force at one place moves another as much as the same
force there moves this one (Maxwell 1864, Betti 1872). For the states x = [q; q'] that reads

    P A = A' P,    P = [[C, M], [M, 0]],    P A = [[-K, 0], [0, M]],

and in any other states T x it holds with T^-T P T^-1. In real modal form each block of A leaves two numbers of P open
(one for a real pole), so P follows from linear equations: forces move no displacement at once (N' P N = 0 with N the
directions that leave the measured displacements where they are), and P b is the displacement row of an output where
and along which an input pushes, if there is one: a driving point. The mass matrix must come out positive definite,
which at a driving point says that all modes answer with one sign.

What a wrong spring or damper does is then known up to one symmetric matrix each: in coordinates of the undamped modes
one number a mode and one a pair of modes. So is the direction of a force along a sensor. Without the symmetry any
linear force inside the structure may be wrong: it moves no displacement at once either, so A becomes A + N F with F
free. Poles and shapes change together; changing the poles alone would leave a gap of several per cent of a response
whose shapes are wrong by as much. But then a wrong gain of a sensor is a change of the plant as well: in y' = g y it
multiplies a row of K by g and divides a column by it. So is a gain of an input, but for its driven place.

References:
    Ewins, Modal Testing, 2nd ed. 2000, sections 2.4 and 2.6 (reciprocity, driving points); Lancaster, Prells,
    Inverse problems for damped vibrating systems, J. Sound Vib. 283, 2005, https://doi.org/10.1016/j.jsv.2004.05.003
"""

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Literal

import numpy as np
import scipy

from modal.simulation import UNDAMPED_DEVIATION
from modal.simulation.plant import LinearParameter
from modal.structure.continuous_time import UNDAMPED, ContinuousSystem
from modal.structure.structural_model import RIGID, SensorKind
from okid.arrays import ROUNDED, TINY, FloatArray
from okid.errors import InvalidDataError

_LIKE = 1e-3
"""Refuse equations that miss by more than this share of what tells one solution from the next: an error of a thousandth
in a direction or shape lies below the noise of any measured record."""


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
    return found if apart <= ROUNDED * np.abs(A).max() else None


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
    if sizes[-1] > _LIKE * sizes[-2] or sizes[-2] <= ROUNDED * sizes[0]:
        return None
    return np.asarray(np.tensordot(right[-1, : len(basis)], basis, axes=(0, 0)))


def _structure(A: FloatArray, metric: FloatArray, free: FloatArray, displacements: FloatArray) -> Structure | None:
    """The structure of one P, whose sign is open; None where masses or stiffnesses would not be positive."""
    for signed in (metric, -metric):
        for forces in _force_directions(signed, free, displacements):
            mass = forces.T @ signed @ A @ forces
            sizes = np.linalg.eigvalsh((mass + mass.T) / 2)
            if sizes[0] > ROUNDED * sizes[-1]:
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
    if np.linalg.cond(both / scale[:, None]) * ROUNDED > 1.0:
        return None
    matrices = -np.linalg.solve(both.T, (rows @ A @ A).T).T
    stiffness, damping = matrices[:, :n_modes], matrices[:, n_modes:]
    squares, shapes = np.linalg.eigh((stiffness + stiffness.T) / 2)
    if squares[0] <= ROUNDED * squares[-1]:
        return None
    modal = shapes.T @ damping @ shapes
    return Structure(
        displacements=shapes.T @ rows, forces=forces @ shapes, stiffness=squares, damping=(modal + modal.T) / 2
    )


_AT_ONCE = 0.5
"""Let an input move a displacement at once when it calls up more than this share of its largest velocity at infinite
frequency: a structure gives 0, a first-order plant 1."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OutputMotion:
    """The motion that an output shows.

    Attributes:
        nature: "mechanical": it has a displacement that no force moves at once; "shaft": it has a velocity only;
            "flow": a displacement (level) that a flow moves at once.
        displacement: Row over [x; u], None for a shaft.
        velocity: Row over [x; u], None for a flow.
        driven: (n_states,) what a force changes at once: the velocity's row over x, of a flow the displacement's.
        direct: (n_states,) how a direction of the states enters the output at once: `driven` for an accelerometer.
        unit: Unit of its displacement.
    """

    nature: Literal["mechanical", "shaft", "flow"]
    displacement: FloatArray | None
    velocity: FloatArray | None
    driven: FloatArray
    direct: FloatArray
    unit: str

    @property
    def force_unit(self) -> str:
        """Unit of a force per effective mass, or of a flow per area."""
        return f"{self.unit}/s" if self.nature == "flow" else f"{self.unit}/s^2"

    def less(self, other: "OutputMotion") -> "OutputMotion":
        """The difference to another output of the same nature."""
        return replace(
            self,
            displacement=_difference(self.displacement, other.displacement),
            velocity=_difference(self.velocity, other.velocity),
            driven=self.driven - other.driven,
            direct=self.direct - other.direct,
        )


def motion_of_outputs(
    system: ContinuousSystem, kinds: tuple[SensorKind, ...], units: tuple[str, ...]
) -> tuple[OutputMotion, ...]:
    """The motion that each output shows.

    Args:
        system: In a form in which the poles stand on the diagonal or near it.
        kinds: Sensor kind of each output.
        units: Unit of each output, "" where it is not known (then SI).

    Raises:
        InvalidDataError: An accelerometer on a system with an integrator that its reading does not show.
    """
    return tuple(_motion(system, output, kind, units[output]) for output, kind in enumerate(kinds))


def _motion(system: ContinuousSystem, output: int, kind: SensorKind, unit: str) -> OutputMotion:
    A, B, row, direct = system.A, system.B, system.C[output], system.D[output]
    none = np.zeros_like(direct)
    if kind == "displacement":
        displacement, velocity = np.concatenate([row, direct]), np.concatenate([row @ A, row @ B])
        held: FloatArray | None = row
    elif kind == "velocity":
        held = _antiderivative(system, row, direct)
        velocity = np.concatenate([row, direct])
        displacement = velocity if held is None else np.concatenate([held, none])
    else:
        rate = _antiderivative(system, row, direct)
        if rate is None:
            raise InvalidDataError(
                f"an integrator needs its displacement or velocity measured, but output {output} is an acceleration of "
                "a model with a pole at 0; measure one of them, or give the model as StructuralModel."
            )
        held = _antiderivative(system, rate, none)
        velocity = np.concatenate([rate, none])
        displacement = velocity if held is None else np.concatenate([held, none])
    n_states = len(A)
    length = _length_unit(unit, kind)
    mechanical = held is not None and n_states > 1 and not _moved_at_once(system, held)
    if not mechanical and kind == "displacement":
        return OutputMotion(
            nature="flow", displacement=displacement, velocity=None, driven=row, direct=np.zeros(n_states), unit=length
        )
    driven = velocity[:n_states]
    return OutputMotion(
        nature="mechanical" if mechanical else "shaft",
        displacement=displacement if mechanical else None,
        velocity=velocity,
        driven=driven,
        direct=driven if kind == "acceleration" else np.zeros(n_states),
        unit=length,
    )


def _antiderivative(system: ContinuousSystem, row: FloatArray, direct: FloatArray) -> FloatArray | None:
    """The row r with d/dt (r x) = row x + direct u; None where an integrator leaves it open."""
    poles = np.abs(np.linalg.eigvals(system.A))
    if poles.min() > ROUNDED * poles.max():
        return np.asarray(np.linalg.solve(system.A.T, row))
    # r A = row alone leaves r open along what the integrator holds; what the inputs do settles it where it can
    both = np.hstack([system.A, system.B])
    wanted = np.concatenate([row, direct])
    scale = np.maximum(np.linalg.norm(both, axis=0), TINY)
    found, _, rank, _ = np.linalg.lstsq((both / scale).T, wanted / scale, rcond=1e-12)
    misfit = np.abs(found @ both - wanted) / scale
    if rank < len(system.A) or misfit.max() > 1e-6 * np.abs(wanted / scale).max():
        return None
    return np.asarray(found)


def _moved_at_once(system: ContinuousSystem, row: FloatArray) -> bool:
    """Whether the inputs move row x at once, as they move a level, and not through its velocity."""
    size = np.linalg.norm(system.B, axis=0)
    at_once = np.divide(row @ system.B, size, out=np.zeros_like(size), where=size > 0)
    poles = np.abs(np.linalg.eigvals(system.A))
    poles = poles[poles > ROUNDED * poles.max()]
    if poles.size == 0 or not size.any():
        return False
    span = np.geomspace(poles.min() / 10, poles.max() * 10, 400)
    angular = np.unique(np.concatenate([span, *(poles * factor for factor in (0.98, 1.0, 1.02))]))
    moved = ContinuousSystem(A=system.A, B=system.B, C=row[None], D=np.zeros((1, len(size)))).response(angular)
    velocity = angular[:, None] * np.abs(moved[:, 0])
    velocity = np.divide(velocity, size, out=np.zeros_like(velocity), where=size > 0)
    return bool(np.linalg.norm(at_once) > _AT_ONCE * np.linalg.norm(velocity.max(axis=0)))


def _difference(first: FloatArray | None, second: FloatArray | None) -> FloatArray | None:
    return None if first is None or second is None else first - second


def _length_unit(unit: str, kind: SensorKind) -> str:
    """The unit of the displacement behind a reading; SI where the reading's unit is not known."""
    suffixes: dict[SensorKind, tuple[str, ...]] = {
        "displacement": ("",),
        "velocity": ("/s",),
        "acceleration": ("/s^2", "/s**2", "/s2", "/s²"),
    }
    if not unit:
        return "m"
    for suffix in suffixes[kind]:
        if unit.endswith(suffix):
            return unit.removesuffix(suffix)
    return f"{unit} s" if kind == "velocity" else f"{unit} s^2"


INTERNAL_FORCE = "internal force"
"""How the names of these parameters begin."""

MOST = 80
"""Calibrate the poles alone where there would be more entries than so many."""

REACH = 10.0
"""Bound an entry of F, and a mode's damping, often no more than a guess, to so many deviations of the prior."""

FIRM_REACH = 3.0
"""Bound the other entries of a symmetric change to so many: beside the diagonal three are about what leaves a damping
matrix positive, sqrt(C_aa C_bb)."""

Changes = tuple[tuple[LinearParameter, ...], FloatArray]
"""Linear parameters, and the derivative (n_parameters, n_states + n_outputs, n_states) of [A; C] by each."""


def internal_changes(
    A: FloatArray, free: FloatArray, motions: tuple[OutputMotion, ...], *, tolerance: float
) -> Changes | None:
    """The entries of F, each zero in the model as given.

    Args:
        A: (n_states, n_states) in real modal form.
        free: (n_states, n_free) directions that leave the measured displacements where they are.
        motions: What the outputs show.
        tolerance: Standard deviation of the prior, as a share of the linear forces that the model has.

    Returns:
        The parameters; None for plants that are no structure, have rigid-body motion, or need more than 80 entries.
    """
    n_states, n_free = free.shape
    if n_states < 2 or n_states * n_free > MOST or any(one.nature != "mechanical" for one in motions):
        return None
    poles = np.abs(np.linalg.eigvals(A))
    if poles.min() <= RIGID * poles.max():  # rigid-body motion: a spring to nowhere would be added
        return None
    direct = np.array([one.direct for one in motions])
    parameters, slopes = [], []
    for a in range(n_free):
        scale = tolerance * float(np.linalg.norm(free[:, a] @ A)) / np.sqrt(2.0)
        column = np.concatenate([free[:, a], direct @ free[:, a]])
        for b in range(n_states):
            change = np.zeros((len(column), n_states))
            change[:, b] = column
            slopes.append(change)
            parameters.append(
                LinearParameter(
                    name=f"{INTERNAL_FORCE} {a + 1} by modal state {b + 1}",
                    unit="1/s",
                    nominal=0.0,
                    deviation=scale,
                    lower=-REACH * scale,
                    upper=REACH * scale,
                )
            )
    return tuple(parameters), np.array(slopes)


def symmetric_changes(
    A: FloatArray,
    structure: Structure,
    motions: tuple[OutputMotion, ...],
    *,
    frequency_tolerance: float,
    damping_tolerance: float,
) -> Changes | None:
    """The entries of the modal stiffness and damping matrices.

    The prior is that of a change whose entries, in units in which the matrix is one, are independent with a deviation
    smaller by sqrt(2) beside the diagonal: the one such prior that is the same in any coordinates of the modes.

    Args:
        A: (n_states, n_states) of the state space.
        structure: The structure behind it.
        motions: What the outputs show.
        frequency_tolerance: Standard deviation of the prior on a natural frequency, as a share of it.
        damping_tolerance: Relative standard deviation of the prior on a modal damping.

    Returns:
        The parameters; None where they would be more than 80.
    """
    n_modes = structure.n_modes
    if n_modes * (n_modes + 1) > MOST:
        return None
    natural = np.sqrt(structure.stiffness)
    damped = np.diag(structure.damping)
    damping = np.where(damped > 2 * UNDAMPED * natural, damping_tolerance * damped, 2 * UNDAMPED_DEVIATION * natural)
    direct = np.array([one.direct for one in motions]) @ structure.forces
    entering = np.vstack([structure.forces, direct])
    kinds = (
        (
            "stiffness",
            "1/s^2",
            np.diag(structure.stiffness),
            2 * frequency_tolerance * structure.stiffness,
            FIRM_REACH,
            0,
        ),
        ("damping", "1/s", structure.damping, damping, REACH, 1),
    )
    parameters, slopes = [], []
    for word, unit, matrix, spread, reach, power in kinds:
        rows = structure.displacements @ np.linalg.matrix_power(A, power)
        for a, b in combinations_with_replacement(range(n_modes), 2):
            change = np.outer(entering[:, a], rows[b])
            slopes.append(-change if a == b else -(change + np.outer(entering[:, b], rows[a])))
            where = f"of mode {a + 1} ({natural[a] / (2 * np.pi):.4g} Hz)"
            centre = float(matrix[a, b])
            deviation = float(np.sqrt(spread[a] * spread[b]) * (1.0 if a == b else np.sqrt(0.5)))
            margin = (reach if a == b else FIRM_REACH) * deviation
            parameters.append(
                LinearParameter(
                    name=f"{word} {where}" if a == b else f"{word} between modes {a + 1} and {b + 1}",
                    unit=unit,
                    nominal=centre,
                    deviation=deviation,
                    # what stands on the diagonal is never negative
                    lower=min(max(centre - margin, 0.0 if a == b else -np.inf), centre),
                    upper=centre + margin,
                )
            )
    return tuple(parameters), np.array(slopes)
