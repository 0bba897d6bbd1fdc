"""Free run and one-step prediction of a realisation over a record of any length.

Both return a `Record`, so simulated and measured data are the same kind of thing and either can be fed to any stage.

The state at the first sample of a record, by least squares on chosen rows.

    minimise over x0   sum over rows of |y(k) - y_forced(k) - C A^k x0|^2

Rows may be left out (held-out data, missing samples). A direction of the state whose free response lies almost wholly
on rows that are left out is not determined by the others, and a fit of it would only fit their noise; so energies
decide: the state is measured in coordinates in which the free response over the WHOLE record has unit energy in every
direction, and directions of which less than 1 % of that energy falls on the given rows stay at zero. What the rows do
not determine is thereby chosen so that the free response over the record has the least energy.
"""

from dataclasses import replace

import numpy as np

from era.realisation import Realisation
from era.state_recursion import checked_state, lifted, one_step, simulate_array
from okid.arrays import BoolArray, FloatArray, require
from okid.errors import InsufficientDataError, InvalidDataError, NumericalError
from okid.record import Record

FORGOTTEN = 1e-2
"""Part of a disturbance of the state below which its outputs count as known again after a gap in the inputs."""


def simulate(realisation: Realisation, record: Record, *, initial_state: FloatArray | None = None) -> Record:
    """Free run: the model sees the inputs only.

    Missing inputs: the free run goes on with straight lines across the gap, but its outputs are NaN from the first
    missing sample until the slowest pole has forgotten 99 % of the state that it had (to the end, for a pole on or
    outside the unit circle). Inputs after the record, at which a model with a lead looks, are missing ones. What the
    record's outputs hold does not matter.

    Args:
        realisation: model.
        record: inputs to be simulated; its channels and its time step must be those of the model.
        initial_state: (order,) state at the first sample; at rest unless given. `era.simulation` estimates it.

    Returns:
        The record with the simulated outputs in place of the measured ones.

    Raises:
        InvalidDataError: other channels or another time step than the model, or an initial state of the wrong size.
        NumericalError: the free run grows beyond what a number can hold.

    Example:
        >>> model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01)
        >>> simulate(model, Record([1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.01)).outputs.ravel()
        array([0., 2., 1.])
    """
    check_channels(realisation, record)
    inputs, missing = acting_inputs(realisation, record)
    model = realisation
    outputs = simulate_array(model.A, model.B, model.C, model.D, inputs, initial_state=initial_state)
    if not np.isfinite(outputs[-1]).all():
        first = int(np.argmin(np.isfinite(outputs).all(axis=1)))
        radius = spectral_radius(model.A)
        raise NumericalError(
            f"the free run of the model grows beyond all numbers at sample {first}: its largest pole has magnitude "
            f"{radius:.6g}; use a stable model (poles inside the unit circle) or a record of less than {first} samples."
        )
    if missing.any():
        outputs[unknown_after(missing, model.A)] = np.nan
    outputs.flags.writeable = False  # so that the record need not copy them
    return replace(record, outputs=outputs)


def predict(realisation: Realisation, record: Record, *, initial_state: FloatArray | None = None) -> Record:
    """One-step prediction with the gain K: the model sees the inputs, and the outputs up to the sample before.

        x(k+1) = A x(k) + B u(k) + K [y(k) - C x(k) - D u(k)]

    A missing output sample corrects nothing: its innovation counts as zero. Missing inputs are treated as in
    `simulate`, with the poles of A - K C, which forget faster.

    Args:
        realisation: model with a gain K.
        record: inputs and outputs; channels and time step must be those of the model.
        initial_state: (order,) state at the first sample; at rest unless given.

    Returns:
        The record with the predicted outputs in place of the measured ones.

    Raises:
        InvalidDataError: no gain, other channels or another time step, or an initial state of the wrong size.
        NumericalError: the prediction grows beyond what a number can hold.

    Example:
        >>> model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, K=[[0.1]])
        >>> predict(model, Record([1.0, 0.0, 0.0], [0.0, 2.5, 0.0], 0.01)).outputs.ravel()
        array([0. , 2. , 1.1])
    """
    check_channels(realisation, record)
    model = realisation
    if model.K is None:
        raise InvalidDataError(
            "one-step prediction needs a gain K and this realisation has none; realise Markov parameters with a "
            "gain, or estimate one with era.gain_from_innovations."
        )
    inputs, missing = acting_inputs(realisation, record)
    state = checked_state(model.order, initial_state)
    predicted, state = one_step(
        model.A, model.B, model.C, model.D, model.K, inputs=inputs, outputs=record.outputs, state=state
    )
    closed = model.A - model.K @ model.C
    if not (np.isfinite(predicted).all() and np.isfinite(state).all()):
        raise NumericalError(
            f"the one-step prediction grows beyond all numbers: the largest pole of A - K C has magnitude "
            f"{spectral_radius(closed):.6g}; use a gain for which it is below 1, for example "
            "era.gain_from_innovations."
        )
    if missing.any():
        predicted[unknown_after(missing, closed)] = np.nan
    predicted.flags.writeable = False  # so that the record need not copy them
    return replace(record, outputs=predicted)


def check_channels(realisation: Realisation, record: Record) -> None:
    """Raise InvalidDataError unless the record has the channels and the time step of the model."""
    require(realisation, Realisation, where="a simulation", made_by="era.realise or Realisation.from_control")
    require(record, Record, where="a simulation", made_by="okid.Record(inputs, outputs, dt)")
    model = realisation
    if (record.n_inputs, record.n_outputs) != (model.n_inputs, model.n_outputs):
        raise InvalidDataError(
            f"the model has {model.n_inputs} inputs and {model.n_outputs} outputs, but the record has "
            f"{record.n_inputs} inputs ({', '.join(record.input_names) or 'none'}) and {record.n_outputs} outputs "
            f"({', '.join(record.output_names)}); choose the model's channels with record.select."
        )
    if abs(record.dt - model.dt) > 1e-6 * model.dt:
        raise InvalidDataError(
            f"the model has a time step of {model.dt:.9g} s, but the record one of {record.dt:.9g} s; decimate the "
            "record or identify the model at its time step."
        )


def filled_inputs(record: Record) -> tuple[FloatArray, BoolArray]:
    """(n_samples, n_inputs) inputs with straight lines across the gaps, and (n_samples,) True where one was missing."""
    missing = np.isnan(record.inputs)
    if not missing.any():
        return record.inputs, np.zeros(record.n_samples, dtype=np.bool_)
    rows = np.asarray(missing.any(axis=1))
    filled = np.array(record.inputs)
    position = np.arange(record.n_samples)
    for column, gap in zip(filled.T, missing.T, strict=True):
        column[gap] = np.interp(position[gap], position[~gap], column[~gap])
    return filled, rows


def acting_inputs(realisation: Realisation, record: Record) -> tuple[FloatArray, BoolArray]:
    """As `filled_inputs`, each row where the model looks at it: the last `lead` rows repeat the last one, missing.

    Example:
        >>> early = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, lead=1)
        >>> acting_inputs(early, Record([1.0, 2.0, 3.0], [0.0, 0.0, 0.0], 0.01))[0].ravel().tolist()
        [2.0, 3.0, 3.0]
    """
    inputs, missing = filled_inputs(record)
    if not realisation.lead:
        return inputs, missing
    rows = np.arange(record.n_samples) + realisation.lead
    beyond = rows >= record.n_samples
    rows[beyond] = record.n_samples - 1
    return inputs[rows], missing[rows] | beyond


def spectral_radius(A: FloatArray) -> float:
    """The largest |pole|; 0 without states."""
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))


def unknown_after(missing: BoolArray, A: FloatArray) -> BoolArray:
    """Rows with a missing input, and after them until the state is known again.

    A gap in u(k) changes y(k) at once and the state from k + 1 on. A slow pole needs log(1 %) / log(magnitude) samples
    to forget it, a chain of delays as many as there are states.
    """
    n_samples, order, radius = missing.size, A.shape[0], spectral_radius(A)
    memory = order
    if radius >= 1.0:
        memory = n_samples
    elif radius > 0.0:
        memory = max(order, int(np.ceil(np.log(FORGOTTEN) / np.log(radius))))
    position = np.arange(n_samples)
    last = np.maximum.accumulate(np.where(missing, position, -n_samples - 1))
    unknown: BoolArray = position - last <= min(memory, n_samples)
    return unknown


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
    inputs, missing = acting_inputs(realisation, record)
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
