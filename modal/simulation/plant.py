"""The linear plant with ports that every kind of model reduces to.

    x' = A x + B u + E w        y = C x + D u + G w

A port is a place where a force can act. An effect gives the force `w` from the motion at its port; nothing else of the
model is nonlinear. Where masses stand on the left-hand side, the rows above are M x' = F [x; u; w] and
y = H [x; u; w] + R x'; M, F and H are affine in the linear parameters that may be wrong (stiffness and damping of each
element, a mass, or the real modal form of a state space).

A mass is taken as right until it is released: then it is a linear parameter like the others.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from okid.arrays import FloatArray, frozen


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LinearParameter:
    """One number of the linear model that may be wrong.

    Attributes:
        name: What it is, in words ("stiffness of element_1").
        unit: Its unit.
        nominal: Value in the model as it was given.
        deviation: Standard deviation of the weak prior about the nominal value, in `unit`.
        lower: Hard lower bound, in `unit`.
        upper: Hard upper bound, in `unit`.
    """

    name: str
    unit: str
    nominal: float
    deviation: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Mass:
    """A mass that is taken as right until it is released.

    Attributes:
        parameter: As it is once it is released.
        system: Derivative of `Plant.system` by it, of the shape of `Plant.system[0]`.
        inertia: (n_states, n_states) derivative of `Plant.inertia` by it.
    """

    parameter: LinearParameter
    system: FloatArray
    inertia: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Port:
    """A place where a force can act.

    Attributes:
        name: Name of the place ("element_1", "dof_0", "output_0", "output_0-output_1").
        displacement: Row over [x; u] (n_states + n_inputs,) that gives the (relative) displacement; None where there
            is none, as at a rotary shaft.
        velocity: Row over [x; u] that gives the (relative) velocity; None for a flow.
        columns: Columns of E and G in which a force at the port enters: one where its direction is known, several
            that span the possible directions otherwise.
        stiffness: Linear stiffness at the port in `force_unit`/`length_unit`, where it is known.
        mass: Mass at the port (its moving end), where it is known.
        length_unit: Unit of the displacement.
        force_unit: Unit of the force.
        accepts: What kinds of effect can act here: "motion" (any law of the motion at the port), "force" (only what
            does not depend on it: constant and periodic forces), "mass" (a mass can be hung on it), "flow".
    """

    name: str
    displacement: FloatArray | None
    velocity: FloatArray | None
    columns: tuple[int, ...]
    stiffness: float | None = None
    mass: float | None = None
    length_unit: str = "m"
    force_unit: str = "N"
    accepts: frozenset[str] = frozenset({"motion", "force", "mass"})


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlantMatrices:
    """The matrices of the plant for one value of the linear parameters.

    Attributes:
        A: (n_states, n_states) [1/s].
        B: (n_states, n_inputs).
        E: (n_states, n_forces).
        C: (n_outputs, n_states).
        D: (n_outputs, n_inputs).
        G: (n_outputs, n_forces).
    """

    A: FloatArray
    B: FloatArray
    E: FloatArray
    C: FloatArray
    D: FloatArray
    G: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plant:
    """A linear model with ports, affine in its uncertain parameters.

    Attributes:
        system: (1 + n_parameters, n_states + n_outputs, n_states + n_inputs + n_forces): the constant part of
            [[A, B, E], [C, D, G]] (of F over H where there is an inertia) and its derivative by each linear parameter.
        n_states: Number of states; 0 for a plant without dynamics (imposed motion in, force out).
        n_inputs: Number of inputs.
        parameters: The linear parameters, in the order of `system[1:]`.
        ports: The places where an effect can act.
        input_names: Names of the inputs (also the places of input effects).
        output_names: Names of the outputs (also the places of sensor effects).
        input_units: Units of the inputs.
        output_units: Units of the outputs.
        inertia: (1 + n_parameters, n_states, n_states): M and its derivative by each linear parameter; None for the
            identity.
        rates: (n_outputs, n_states) R, what the outputs read of x'; None for nothing.
        masses: Those that are taken as right.
    """

    system: FloatArray
    n_states: int
    n_inputs: int
    parameters: tuple[LinearParameter, ...]
    ports: tuple[Port, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    inertia: FloatArray | None = None
    rates: FloatArray | None = None
    masses: tuple[Mass, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "system", frozen(self.system, name="system of the plant"))

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return int(self.system.shape[1]) - self.n_states

    @property
    def n_forces(self) -> int:
        """Number of columns of E."""
        return int(self.system.shape[2]) - self.n_states - self.n_inputs

    @property
    def nominal(self) -> FloatArray:
        """Nominal linear parameters (n_parameters,)."""
        return np.array([parameter.nominal for parameter in self.parameters])

    def port(self, name: str) -> Port:
        """The port of that name.

        Raises:
            KeyError: If there is none.
        """
        for port in self.ports:
            if port.name == name:
                return port
        raise KeyError(name)


def split_matrices(plant: Plant, matrix: FloatArray) -> PlantMatrices:
    """The blocks of one matrix of the shape of `plant.system[0]`."""
    n, m = plant.n_states, plant.n_inputs
    return PlantMatrices(
        A=matrix[:n, :n],
        B=matrix[:n, n : n + m],
        E=matrix[:n, n + m :],
        C=matrix[n:, :n],
        D=matrix[n:, n : n + m],
        G=matrix[n:, n + m :],
    )


def plant_matrices(plant: Plant, linear: FloatArray) -> PlantMatrices:
    """The matrices at the linear parameters `linear` (n_parameters,)."""
    whole = plant.system[0] + np.tensordot(linear, plant.system[1:], axes=(0, 0))
    if plant.inertia is not None:
        n = plant.n_states
        inertia = plant.inertia[0] + np.tensordot(linear, plant.inertia[1:], axes=(0, 0))
        whole[:n] = np.linalg.solve(inertia, whole[:n])
        if plant.rates is not None:
            whole[n:] += plant.rates @ whole[:n]
    return split_matrices(plant, whole)


MASS = "mass of "
"""Begin the name of a mass with these words."""


def released_masses(plant: Plant) -> tuple[str, ...]:
    """Names of the masses among the linear parameters."""
    return tuple(one.name for one in plant.parameters if one.name.startswith(MASS))


def with_masses(plant: Plant, names: Collection[str]) -> Plant:
    """The plant with just these of its masses among its linear parameters, after all others."""
    if plant.inertia is None:
        return plant
    first = len(plant.parameters) - len(released_masses(plant))
    free = [
        Mass(parameter=one, system=system, inertia=inertia)
        for one, system, inertia in zip(plant.parameters, plant.system[1:], plant.inertia[1:], strict=True)
    ][first:]
    every = sorted((*free, *plant.masses), key=lambda one: int(np.flatnonzero(one.inertia.any(axis=0))[0]))
    chosen = [one for one in every if one.parameter.name in names]
    system = np.concatenate([plant.system[: 1 + first], *(one.system[np.newaxis] for one in chosen)])
    inertia = np.concatenate([plant.inertia[: 1 + first], *(one.inertia[np.newaxis] for one in chosen)])
    for changed, sign in ((free, 1.0), (chosen, -1.0)):
        for one in changed:
            system[0] += sign * one.parameter.nominal * one.system
            inertia[0] += sign * one.parameter.nominal * one.inertia
    return replace(
        plant,
        system=system,
        inertia=inertia,
        parameters=(*plant.parameters[:first], *(one.parameter for one in chosen)),
        masses=tuple(one for one in every if one not in chosen),
    )


def with_wider_masses(plant: Plant, factor: float) -> Plant:
    """The plant whose masses, released or held, may be off by so many times the factor that they may now.

    A mass m stays between m - d (1 - 1/f) and m + d (f - 1), where d is as much of it as the mass matrix can do without
    before it is no longer positive definite: f grows, d stays.

    Example:
        >>> from modal.structure.structural_model import StructuralModel
        >>> from modal.structure.structural_plant import structural_plant
        >>> model = StructuralModel.chain([2.0, 1.0], [8.0, 8.0], [0.1, 0.1], force_dofs=0, sensor_dofs=0)
        >>> mass, _ = with_wider_masses(structural_plant(model), 2.0).masses
        >>> round(float(mass.parameter.lower), 4), round(float(mass.parameter.upper), 4)
        (0.7692, 5.2)
    """

    def wider(one: LinearParameter) -> LinearParameter:
        down, up = one.nominal - one.lower, one.upper - one.nominal
        if not one.name.startswith(MASS) or not 0.0 < down < up:
            return one
        f, d = factor * up / down, min(up * down / (up - down), one.nominal)
        return replace(one, lower=one.nominal - d * (1.0 - 1.0 / f), upper=one.nominal + d * (f - 1.0))

    return replace(
        plant,
        parameters=tuple(wider(one) for one in plant.parameters),
        masses=tuple(replace(one, parameter=wider(one.parameter)) for one in plant.masses),
    )
