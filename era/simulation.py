"""Free run and one-step prediction of a realisation over a record of any length.

Both return a `Record`, so simulated and measured data are the same kind of thing and either can be fed to any stage.
"""

from dataclasses import replace

import numpy as np

from era.innovation_run import one_step
from era.realisation import Realisation
from era.state_recursion import checked_state, simulate_array
from okid.arguments import require
from okid.arrays import BoolArray, FloatArray
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record

__all__ = ["check_channels", "filled_inputs", "predict", "simulate", "simulate_array", "unknown_after"]

FORGOTTEN = 1e-2
"""Part of a disturbance of the state below which its outputs count as known again after a gap in the inputs."""


def simulate(realisation: Realisation, record: Record, *, initial_state: FloatArray | None = None) -> Record:
    """Free run: the model sees the inputs only.

    Missing inputs: the free run goes on with straight lines across the gap, but its outputs are NaN from the first
    missing sample until the slowest pole has forgotten 99 % of the state that it had (to the end, for a pole on or
    outside the unit circle). What the record's outputs hold does not matter.

    Args:
        realisation: model.
        record: inputs to be simulated; its channels and its time step must be those of the model.
        initial_state: (order,) state at the first sample; at rest unless given. `era.initial_state` estimates it.

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
    inputs, missing = filled_inputs(record)
    model = realisation
    outputs = simulate_array(model.A, model.B, model.C, model.D, inputs, initial_state=initial_state)
    if not np.isfinite(outputs[-1]).all():
        first = int(np.argmin(np.isfinite(outputs).all(axis=1)))
        radius = _spectral_radius(model.A)
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
    inputs, missing = filled_inputs(record)
    state = checked_state(model.order, initial_state)
    predicted, state = one_step(
        model.A, model.B, model.C, model.D, model.K, inputs=inputs, outputs=record.outputs, state=state
    )
    closed = model.A - model.K @ model.C
    if not (np.isfinite(predicted).all() and np.isfinite(state).all()):
        raise NumericalError(
            f"the one-step prediction grows beyond all numbers: the largest pole of A - K C has magnitude "
            f"{_spectral_radius(closed):.6g}; use a gain for which it is below 1, for example "
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


def _spectral_radius(A: FloatArray) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))


def unknown_after(missing: BoolArray, A: FloatArray) -> BoolArray:
    """Rows with a missing input, and after them until the state is known again.

    A gap in u(k) changes y(k) at once and the state from k + 1 on. A slow pole needs log(1 %) / log(magnitude) samples
    to forget it, a chain of delays as many as there are states.
    """
    n_samples, order, radius = missing.size, A.shape[0], _spectral_radius(A)
    memory = order
    if radius >= 1.0:
        memory = n_samples
    elif radius > 0.0:
        memory = max(order, int(np.ceil(np.log(FORGOTTEN) / np.log(radius))))
    position = np.arange(n_samples)
    last = np.maximum.accumulate(np.where(missing, position, -n_samples - 1))
    unknown: BoolArray = position - last <= min(memory, n_samples)
    return unknown
