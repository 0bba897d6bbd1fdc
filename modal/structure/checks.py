"""What must hold of the parts of a structural model; each check raises one sentence that says what to change."""

from collections.abc import Sequence
from typing import Any, Literal, cast, get_args

import numpy as np
import numpy.typing as npt
import scipy

from modal.simulation.tolerances import ROUNDING
from okid.arrays import FloatArray, frozen, real_number
from okid.errors import InvalidDataError
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
        if lowest < -ROUNDING * n_dofs * max(abs(lowest), abs(largest)):
            raise InvalidDataError(
                f"{name} must be positive semidefinite, or the structure is unstable, but its lowest eigenvalue is "
                f"{lowest:.3g} beside {largest:.3g}; check its signs, or linearise about a stable position."
            )
    return M, C, K


def _symmetric(matrix: FloatArray, name: str) -> FloatArray:
    asymmetry, size = np.abs(matrix - matrix.T).max(), np.abs(matrix).max()
    if asymmetry > ROUNDING * size:
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
