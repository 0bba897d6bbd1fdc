"""A linear model of a structure or a machine: mass, damping and stiffness, where it is driven and where it is measured.

    M x'' + C x' + K x + effects = F u - M iota a

x are the degrees of freedom, u forces that are applied to them, a base accelerations; x is then the motion relative to
the base. A shaft is the same with angles and moments, a first-order plant the same with K = 0 and a velocity sensor.
Units are the user's as long as they fit together: the defaults are N, m, kg, s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

import numpy as np
import numpy.typing as npt
import scipy

from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.simulation.plant import plant_matrices
from modal.structure.model_file import KeptModel
from modal.structure.placed import PlacedEffect, equations_of_structure, placed_effect
from modal.structure.structural_plant import (
    Element,
    chain_elements,
    coupled_elements,
    named_elements,
    place_name,
    structural_plant,
)
from okid.arrays import ROUNDED, ComplexArray, FloatArray, frozen, real_number
from okid.display import first_names
from okid.errors import InvalidDataError
from okid.readers.guard import MEMORY_SHARE, memory_budget
from okid.record import check_names, labels

SensorKind = Literal["displacement", "velocity", "acceleration"]
"""What a sensor reads of the motion of the degrees of freedom."""

RIGID = 1e-7
"""Call a pole below this share of the largest rigid-body motion: a double pole at zero comes out at the root of the
rounding."""


def checked_matrices(
    mass: npt.ArrayLike, damping: npt.ArrayLike, stiffness: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """M, C, K as read-only arrays.

    Raises:
        InvalidDataError: They are not square, of one size and symmetric, M is not positive definite, or C or K is
            indefinite, so that the structure would be unstable.
    """
    M = frozen(mass, name="mass", shape=(None, None))
    n_dofs = len(M)
    if n_dofs == 0:
        raise InvalidDataError("a structural model needs at least one degree of freedom, but mass is empty.")
    M = frozen(M, name="mass", shape=(n_dofs, n_dofs))
    C = frozen(damping, name="damping", shape=(n_dofs, n_dofs))
    K = frozen(stiffness, name="stiffness", shape=(n_dofs, n_dofs))
    M, C, K = (_symmetric(matrix, name) for matrix, name in ((M, "mass"), (C, "damping"), (K, "stiffness")))
    values = scipy.linalg.eigvalsh(M)
    lowest, largest = values[0], values[-1]
    if not lowest > 1e-14 * largest:
        raise InvalidDataError(
            f"mass must be positive definite, but its eigenvalues reach from {lowest:.3g} to {largest:.3g}; give every "
            "degree of freedom a mass, or condense those that have none."
        )
    for matrix, name in ((K, "stiffness"), (C, "damping")):
        values = scipy.linalg.eigvalsh(matrix)
        lowest, largest = values[0], values[-1]
        if lowest < -ROUNDED * n_dofs * max(abs(lowest), abs(largest)):
            raise InvalidDataError(
                f"{name} must be positive semidefinite, or the structure is unstable, but its lowest eigenvalue is "
                f"{lowest:.3g} beside {largest:.3g}; check its signs, or linearise about a stable position."
            )
    return M, C, K


def _symmetric(matrix: FloatArray, name: str) -> FloatArray:
    asymmetry, size = np.abs(matrix - matrix.T).max(), np.abs(matrix).max()
    if asymmetry > ROUNDED * size:
        row, column = np.unravel_index(np.abs(matrix - matrix.T).argmax(), matrix.shape)
        raise InvalidDataError(
            f"{name} must be symmetric, but entry ({row}, {column}) is {matrix[row, column]:.6g} and ({column}, {row}) "
            f"is {matrix[column, row]:.6g}; take (matrix + matrix.T) / 2 if that is what was meant."
        )
    return frozen((matrix + matrix.T) / 2, name=name)


def check_base_motion(base_motion: npt.ArrayLike, force_map: FloatArray) -> FloatArray:
    """The influence vectors of the base accelerations.

    Raises:
        InvalidDataError: Not of the shape of `force_map`, or an input that is both a force and a base acceleration.
    """
    base = frozen(base_motion, name="base_motion", shape=(len(force_map), force_map.shape[1]))
    both = np.flatnonzero(base.any(axis=0) & force_map.any(axis=0))
    if both.size:
        raise InvalidDataError(
            f"an input is either a force or a base acceleration, but input {both[0]} has a column in force_map and in "
            "base_motion; set one of them to zero."
        )
    return base


def sensor_kinds(given: "str | Sequence[str]", n_outputs: int) -> "tuple[SensorKind, ...]":
    """One sensor kind an output.

    Raises:
        InvalidDataError: A word that is none, or not one an output.
    """
    words = (given,) * n_outputs if isinstance(given, str) else tuple(given)
    unknown = [word for word in words if word not in get_args(SensorKind)]
    if unknown:
        raise InvalidDataError(f"sensor_kind must be {' or '.join(get_args(SensorKind))}, but is {unknown[0]!r}.")
    if len(words) != n_outputs or n_outputs == 0:
        raise InvalidDataError(
            f"{len(words)} sensor kinds were given for {n_outputs} outputs; give one word for all, or one an output, "
            "and at least one output."
        )
    return cast("tuple[SensorKind, ...]", words)


def matched_names(
    input_names: Sequence[str], output_names: Sequence[str], *, n_inputs: int, n_outputs: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of inputs and outputs, unique together.

    Raises:
        InvalidDataError: Not one a channel, or one that stands twice.
    """
    inputs = labels(input_names, n_inputs, "input", named=True)
    outputs = labels(output_names, n_outputs, "output", named=True)
    check_names(inputs + outputs)
    return inputs, outputs


def default_units(
    input_units: Sequence[str],
    output_units: Sequence[str],
    *,
    base: tuple[bool, ...],
    kinds: "Sequence[SensorKind]",
    length_unit: str,
    force_unit: str,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Units of inputs and outputs: those given, else by what each channel is."""
    by_kind = {"displacement": length_unit, "velocity": f"{length_unit}/s", "acceleration": f"{length_unit}/s^2"}
    inputs = labels(input_units, len(base), "input", named=False)
    outputs = labels(output_units, len(kinds), "output", named=False)
    if not input_units:
        inputs = tuple(by_kind["acceleration"] if is_base else force_unit for is_base in base)
    if not output_units:
        outputs = tuple(by_kind[kind] for kind in kinds)
    return inputs, outputs


def tolerance(value: Any, *, name: str) -> float:
    """A relative standard deviation.

    Raises:
        InvalidDataError: Not a positive finite number.
    """
    number = real_number(value)
    if not (np.isfinite(number) and number > 0):
        raise InvalidDataError(f"{name} must be a positive relative deviation such as 0.1, but is {value!r}.")
    return number


def as_column(values: npt.ArrayLike, *, name: str, length: int | None = None) -> FloatArray:
    """Numbers of a chain, one a mass; a single number for one mass.

    Raises:
        InvalidDataError: Not numbers, or not as many as there are masses.
    """
    column = frozen(np.atleast_1d(np.asarray(values, dtype=object)), name=name, shape=(None,))
    if length is not None and len(column) != length:
        raise InvalidDataError(
            f"a chain needs one entry of {name} a mass, but has {length} masses and {len(column)} {name}; 0 stands for "
            "no spring or no damper."
        )
    return column


def map_of_dofs(dofs: int | Sequence[int], n_dofs: int, *, name: str) -> FloatArray:
    """(n_channels, n_dofs) with a one at the DOF of each channel.

    Raises:
        InvalidDataError: A DOF that is not there.
    """
    chosen = [dofs] if isinstance(dofs, int | np.integer) else list(dofs)
    for dof in chosen:
        number = real_number(dof)
        if not (number.is_integer() and 0 <= number < n_dofs):
            raise InvalidDataError(f"{name} must be DOF numbers from 0 to {n_dofs - 1}, but holds {dof!r}.")
    return np.eye(n_dofs)[[int(dof) for dof in chosen]].reshape(len(chosen), n_dofs)


_COUPLINGS: Any = None
"""Default of `elements`: those that stand in the matrices."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StructuralModel(KeptModel):
    """Mass, damping and stiffness with inputs, sensors, and effects that were added.

    Args:
        mass: (n_dofs, n_dofs) symmetric, positive definite.
        damping: (n_dofs, n_dofs) symmetric, positive semidefinite.
        stiffness: (n_dofs, n_dofs) symmetric, positive semidefinite; singular where the structure is free.
        force_map: (n_dofs, n_inputs) forces on the DOFs for a unit of each input; zeros for a base acceleration.
        sensor_map: (n_outputs, n_dofs) what each output reads of the DOFs.
        sensor_kind: "displacement", "velocity" or "acceleration": one word, or one an output.
        elements: `Element`s or pairs (start, end), end None for the ground: where springs and dampers act, and so where
            an effect may be. By default every coupling in K and C.
        base_motion: (n_dofs, n_inputs) displacement of the DOFs for a unit displacement of the base, zero columns for
            inputs that are forces. Inputs with such a column are base accelerations: displacement and velocity sensors
            then read the motion relative to the base, acceleration sensors the absolute one.
        input_names: One an input; "input_0", ... unless given.
        output_names: One an output; "output_0", ... unless given.
        input_units: One an input; unless given, the force unit or, for a base acceleration, length unit / s^2.
        output_units: One an output; unless given, by sensor kind.
        length_unit: Unit of a displacement ("rad" for a shaft).
        force_unit: Unit of a force ("N m" for a shaft).
        stiffness_tolerance: Relative standard deviation of the weak prior on each stiffness; the calibrated value stays
            within a factor 1 + 3 stiffness_tolerance of the nominal one.
        damping_tolerance: Likewise for each damping. Where the damping of a spring is 0, the standard deviation is 2 %
            of its critical damping, and the calibrated value lies between 0 and three of them.
        mass_tolerance: Likewise for each mass, where the records tell that it is wrong; 0 for masses that are right.
            Unless given 0.1, and 0 for a single DOF, of which a wrong mass and a wrong gain are the same number.
        effects: That were added by `with_effect`.

    Raises:
        InvalidDataError: Matrices that do not fit together or belong to no passive structure, unknown sensor kinds,
            elements that do not exist.

    Example:
        >>> model = StructuralModel.chain([1.0, 1.0], [400.0, 400.0], [0.4, 0.4], force_dofs=[1], sensor_dofs=[0, 1])
        >>> model
        StructuralModel(2 DOFs, inputs ['input_0'], outputs ['output_0', 'output_1'], elements ['element_0',
            'element_1'])
        >>> model.natural_frequencies.round(3)
        array([1.967, 5.15 ])
    """

    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    _: KW_ONLY
    force_map: FloatArray
    sensor_map: FloatArray
    sensor_kind: tuple[SensorKind, ...]
    elements: tuple[Element, ...] = _COUPLINGS
    base_motion: FloatArray | None = None
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    input_units: tuple[str, ...] = ()
    output_units: tuple[str, ...] = ()
    length_unit: str = "m"
    force_unit: str = "N"
    stiffness_tolerance: float = 0.1
    damping_tolerance: float = 0.5
    mass_tolerance: float | None = None
    effects: tuple["PlacedEffect", ...] = ()

    if TYPE_CHECKING:  # what the fields are made from; at run time the constructor is the dataclass's own

        def __init__(
            self,
            mass: npt.ArrayLike,
            damping: npt.ArrayLike,
            stiffness: npt.ArrayLike,
            *,
            force_map: npt.ArrayLike,
            sensor_map: npt.ArrayLike,
            sensor_kind: SensorKind | Sequence[SensorKind],
            elements: Sequence[Element | tuple[int, int | None]] | None = None,
            base_motion: npt.ArrayLike | None = None,
            input_names: Sequence[str] = (),
            output_names: Sequence[str] = (),
            input_units: Sequence[str] = (),
            output_units: Sequence[str] = (),
            length_unit: str = "m",
            force_unit: str = "N",
            stiffness_tolerance: float = 0.1,
            damping_tolerance: float = 0.5,
            mass_tolerance: float | None = None,
            effects: Sequence["PlacedEffect"] = (),
        ) -> None: ...

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        matrices = checked_matrices(self.mass, self.damping, self.stiffness)
        for name, matrix in zip(("mass", "damping", "stiffness"), matrices, strict=True):
            set_(self, name, matrix)
        n_dofs, (_, damping, stiffness) = len(self.mass), matrices
        set_(self, "force_map", frozen(self.force_map, name="force_map", shape=(n_dofs, None)))
        set_(self, "sensor_map", frozen(self.sensor_map, name="sensor_map", shape=(None, n_dofs)))
        set_(self, "sensor_kind", sensor_kinds(self.sensor_kind, len(self.sensor_map)))
        if self.base_motion is not None:
            set_(self, "base_motion", check_base_motion(self.base_motion, self.force_map))
        derived = coupled_elements(stiffness, damping) if self.elements is _COUPLINGS else self.elements
        set_(self, "elements", named_elements(derived, stiffness, damping))
        names = matched_names(self.input_names, self.output_names, n_inputs=self.n_inputs, n_outputs=self.n_outputs)
        units = default_units(
            self.input_units,
            self.output_units,
            base=self._base_inputs(),
            kinds=self.sensor_kind,
            length_unit=self.length_unit,
            force_unit=self.force_unit,
        )
        channels = ("input_names", "output_names", "input_units", "output_units")
        for name, words in zip(channels, (*names, *units), strict=True):
            set_(self, name, words)
        for name in ("stiffness_tolerance", "damping_tolerance"):
            set_(self, name, tolerance(getattr(self, name), name=name))
        if self.mass_tolerance is not None and self.mass_tolerance != 0:
            set_(self, "mass_tolerance", tolerance(self.mass_tolerance, name="mass_tolerance"))
        set_(self, "effects", tuple(self.effects))

    def __repr__(self) -> str:
        effects = f", with {', '.join(f'{one.effect} at {one.where}' for one in self.effects)}" if self.effects else ""
        return (
            f"StructuralModel({self.n_dofs} DOFs, inputs {first_names(self.input_names)}, "
            f"outputs {first_names(self.output_names)}, "
            f"elements {first_names([one.name for one in self.elements])}{effects})"
        )

    @classmethod
    def chain(
        cls,
        masses: npt.ArrayLike,
        stiffnesses: npt.ArrayLike,
        dampings: npt.ArrayLike,
        *,
        force_dofs: int | Sequence[int],
        sensor_dofs: int | Sequence[int],
        sensor_kind: SensorKind | Sequence[SensorKind] = "displacement",
        base_motion: npt.ArrayLike | None = None,
        input_names: Sequence[str] = (),
        output_names: Sequence[str] = (),
        input_units: Sequence[str] = (),
        output_units: Sequence[str] = (),
        length_unit: str = "m",
        force_unit: str = "N",
        stiffness_tolerance: float = 0.1,
        damping_tolerance: float = 0.5,
        mass_tolerance: float | None = None,
    ) -> "StructuralModel":
        """A chain of masses: "element_0" joins mass 0 and the ground, "element_e" mass e - 1 and mass e.

        Args:
            masses: (n_dofs,); a number for one mass.
            stiffnesses: (n_dofs,) of the elements; 0 where there is no spring.
            dampings: (n_dofs,) of the elements.
            force_dofs: DOF that each input drives by a force; () for none.
            sensor_dofs: DOF that each output reads.
            sensor_kind: As in the class.
            base_motion: As in the class, (n_dofs, n_inputs); its inputs stand after those of `force_dofs`, so its
                first columns are zero.
            input_names: As in the class.
            output_names: As in the class.
            input_units: As in the class.
            output_units: As in the class.
            length_unit: As in the class.
            force_unit: As in the class.
            stiffness_tolerance: As in the class.
            damping_tolerance: As in the class.
            mass_tolerance: As in the class.

        Raises:
            InvalidDataError: Not one stiffness and one damping a mass, a DOF that is not there, matrices beyond the
                memory, or what the class refuses.
        """
        m = as_column(masses, name="masses")
        k = as_column(stiffnesses, name="stiffnesses", length=len(m))
        c = as_column(dampings, name="dampings", length=len(m))
        # square matrices at a time: measured 11.0
        need, (budget, whose) = 12 * m.itemsize * float(len(m)) ** 2, memory_budget()
        if need > MEMORY_SHARE * budget:
            raise InvalidDataError(
                f"the matrices of {len(m)} masses need about {need / 2**30:.1f} GiB, more than {MEMORY_SHARE:.0%} of "
                f"the {budget / 2**30:.1f} GiB that {whose}; reduce the model to the masses that move in the measured "
                "band."
            )
        join = np.eye(len(m)) - np.diag(np.ones(len(m) - 1), -1)  # row e: x[e] - x[e-1]
        force_map = map_of_dofs(force_dofs, len(m), name="force_dofs").T
        if base_motion is not None:
            base_motion = frozen(base_motion, name="base_motion", shape=(len(m), None))
            n_more = base_motion.shape[1] - force_map.shape[1]
            force_map = np.hstack([force_map, np.zeros((len(m), max(n_more, 0)))])
        return cls(
            np.diag(m),
            join.T @ np.diag(c) @ join,
            join.T @ np.diag(k) @ join,
            force_map=force_map,
            sensor_map=map_of_dofs(sensor_dofs, len(m), name="sensor_dofs"),
            sensor_kind=sensor_kind,
            elements=chain_elements(k, c),
            base_motion=base_motion,
            input_names=tuple(input_names),
            output_names=tuple(output_names),
            input_units=tuple(input_units),
            output_units=tuple(output_units),
            length_unit=length_unit,
            force_unit=force_unit,
            stiffness_tolerance=stiffness_tolerance,
            damping_tolerance=damping_tolerance,
            mass_tolerance=mass_tolerance,
        )

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom."""
        return len(self.mass)

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return int(self.force_map.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.sensor_map)

    @property
    def natural_frequencies(self) -> FloatArray:
        """(n_modes,) |pole| / 2 pi [Hz] of the linear part, rising; see `damping_ratios`."""
        return np.abs(self._poles()) / (2 * np.pi)

    @property
    def damping_ratios(self) -> FloatArray:
        """(n_modes,) of the linear part, in the order of `natural_frequencies`.

        One entry for each oscillatory pair of poles, one (of ratio 1) for each real pole; none for rigid-body motion.
        """
        poles = self._poles()
        return -poles.real / np.abs(poles)

    def with_effect(self, effect: "str | Effect", where: str, **values: float | Sequence[float]) -> "StructuralModel":
        """The model with one more effect of the catalogue.

        Args:
            effect: Key in `modal.discrepancy.CATALOGUE`, or an effect of your own.
            where: Name of an element, "dof_i", of an input or of an output, as the effect asks for.
            **values: All parameters of the effect by name, in the units of the place; of a parameter that each record
                has a value of its own of (the phase of a disturbance), a number or one a record.

        Raises:
            InvalidDataError: No such effect or place, a parameter that is missing, unknown or out of its bounds.
        """
        added = placed_effect(structural_plant(self), effect, place_name(self, where), values)
        return replace(self, effects=(*self.effects, added))

    def equations(self, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> str:
        """The equations of motion with numbers and units, effects of the catalogue included, in plain text."""
        return equations_of_structure(self, catalogue=catalogue)

    def _poles(self) -> ComplexArray:
        """Poles [1/s] of the linear part by rising size, one of each pair, without those of rigid-body motion."""
        plant = structural_plant(self)
        poles = np.linalg.eigvals(plant_matrices(plant, plant.nominal).A).astype(np.complex128)
        poles = poles[(poles.imag >= 0) & (np.abs(poles) > RIGID * np.abs(poles).max(initial=0.0))]
        ordered: ComplexArray = poles[np.argsort(np.abs(poles), kind="stable")]
        return ordered

    def _base_inputs(self) -> tuple[bool, ...]:
        """Whether each input is a base acceleration."""
        if self.base_motion is None:
            return (False,) * self.n_inputs
        return tuple(bool(column.any()) for column in self.base_motion.T)
