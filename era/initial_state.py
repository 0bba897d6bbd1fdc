"""The state at the first sample of a record, by least squares on chosen rows.

    minimise over x0   sum over rows of |y(k) - y_forced(k) - C A^k x0|^2

Rows may be left out (held-out data, missing samples). A direction of the state whose free response lies almost wholly
on rows that are left out is not determined by the others, and a fit of it would only fit their noise; so energies
decide: the state is measured in coordinates in which the free response over the WHOLE record has unit energy in every
direction, and directions of which less than 1 % of that energy falls on the given rows stay at zero. What the rows do
not determine is thereby chosen so that the free response over the record has the least energy.
"""

import numpy as np

from era.realisation import Realisation
from era.simulation import check_channels, filled_inputs
from era.state_recursion import lifted, simulate_array
from okid.arrays import BoolArray, FloatArray
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record

__all__ = ["estimate_initial_state"]

LEAST_SHARE = 1e-2
"""Share of the energy of a direction's free response that must fall on the given rows."""
LARGEST_GROWTH = 1e6
"""Growth of an unstable pole after which rows say more about rounding than about the initial state."""
SMALLEST_ENERGY = 1e-13
"""Energy of a direction, relative to the largest in scaled coordinates, below which rounding hides it."""


def estimate_initial_state(realisation: Realisation, record: Record, *, rows: BoolArray | None = None) -> FloatArray:
    """State at the first sample from which the free run fits the record best on the given rows.

    Missing outputs are left out, and so is everything from the first missing input on, where the forced response is not
    known. Of an unstable model only the rows before its largest pole has grown a million times are used.

    Args:
        realisation: model; its channels and time step must be those of the record.
        record: inputs and outputs.
        rows: (n_samples,) True where outputs may be used; all unless given.

    Returns:
        (order,) initial state; of the least free energy where the rows do not determine it.

    Raises:
        InvalidDataError: other channels or another time step than the model, or `rows` of the wrong length.
        InsufficientDataError: no output sample is left to fit.

    Example:
        >>> model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01)
        >>> free_decay = Record([0.0] * 4, [4.0, 2.0, 1.0, 0.5], 0.01)
        >>> estimate_initial_state(model, free_decay).round(12)
        array([2.])
    """
    check_channels(realisation, record)
    model = realisation
    inputs, missing = filled_inputs(record)
    usable = _usable(record, rows, missing)
    if model.order == 0:
        return np.zeros(0)
    last = min(_horizon(model, record.n_samples), int(np.argmax(missing)) if missing.any() else record.n_samples)
    usable = usable[:last]
    if not usable.any():
        raise InsufficientDataError(
            f"the initial state needs at least one output sample, but none of the first {last} samples of the "
            f"{record.n_samples} is both given and present; give rows nearer to the start of the record."
        )
    outputs = np.where(usable, record.outputs[:last], 0.0)
    state = np.zeros(model.order)
    directions: FloatArray | None = None
    for _ in range(2):  # the second pass takes off the rounding error of the normal equations
        simulated = simulate_array(model.A, model.B, model.C, model.D, inputs[:last], initial_state=state)
        residual = np.where(usable, outputs - simulated, 0.0)
        if directions is None:
            gradient, whole, given = _normal_equations(model, residual, usable)
            directions = _inverse(whole, given)
        else:
            gradient = _gradient(model, residual)
        state = state + directions @ gradient
    return state


def _usable(record: Record, rows: BoolArray | None, missing: BoolArray) -> BoolArray:
    """(n_samples, n_outputs) True where an output sample may be fitted."""
    usable: BoolArray = ~np.isnan(record.outputs)
    if rows is not None:
        chosen = np.asarray(rows)
        if chosen.shape != (record.n_samples,) or chosen.dtype != np.bool_:
            raise InvalidDataError(
                f"rows must be {record.n_samples} truth values, one a sample, but has shape {chosen.shape} and type "
                f"{chosen.dtype}."
            )
        usable &= chosen[:, np.newaxis]
    usable[missing] = False
    return usable


def _horizon(model: Realisation, n_samples: int) -> int:
    """Rows that can be used of a model that may be unstable."""
    radius = float(np.abs(np.linalg.eigvals(model.A)).max())
    if radius <= 1.0:
        return n_samples
    growth = np.log(LARGEST_GROWTH) / np.log(radius)
    return int(min(n_samples, max(growth, 2 * model.order, 8)))


def _block_length(n_rows: int, n_outputs: int) -> int:
    """A power of two, no longer than the rows need: of an unstable model a higher power would overflow."""
    length: int = 1 << min(max(3, (1024 // n_outputs).bit_length()), (n_rows - 1).bit_length())
    return length


def _normal_equations(
    model: Realisation, residual: FloatArray, usable: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gradient, energy matrix over all rows, and energy matrix over the usable samples, of the free response."""
    order, n_outputs = model.order, model.n_outputs
    length = _block_length(residual.shape[0], n_outputs)
    block, power = lifted(model.A, model.C, length)
    start = np.eye(order)
    gradient, whole, given = np.zeros(order), np.zeros((order, order)), np.zeros((order, order))
    for first in range(0, residual.shape[0], length):
        errors = residual[first : first + length].ravel()
        used = usable[first : first + length].ravel()
        response = block[: errors.size] @ start
        energy = response.T @ response
        whole += energy
        if used.all():
            given += energy
        elif used.any():
            some = response[used]
            given += some.T @ some
        gradient += response.T @ errors
        if np.trace(energy) < 1e-32 * np.trace(whole):
            break
        start = power @ start
    return gradient, whole, given


def _gradient(model: Realisation, residual: FloatArray) -> FloatArray:
    """Sum over rows of (C A^k)' residual(k), by Horner's rule over blocks, last block first."""
    length = _block_length(*residual.shape)
    block, power = lifted(model.A, model.C, length)
    gradient = np.zeros(model.order)
    for first in reversed(range(0, residual.shape[0], length)):
        errors = residual[first : first + length].ravel()
        gradient = block[: errors.size].T @ errors + power.T @ gradient
    return gradient


def _inverse(whole: FloatArray, given: FloatArray) -> FloatArray:
    """Inverse of `given` on the directions that it holds enough of the energy of, zero on the others."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(whole), np.finfo(float).tiny))
    energies, vectors = np.linalg.eigh(whole * scale * scale[:, np.newaxis])
    kept = energies > SMALLEST_ENERGY * energies[-1]
    to_unit = scale[:, np.newaxis] * (vectors[:, kept] / np.sqrt(energies[kept]))
    shares, turn = np.linalg.eigh(to_unit.T @ given @ to_unit)
    seen = shares > LEAST_SHARE
    basis = to_unit @ turn[:, seen]
    result: FloatArray = (basis / shares[seen]) @ basis.T
    return result
