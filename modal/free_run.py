"""How well a model repeats held-out rows when it sees the inputs alone: the score by which everything is chosen.

The run from rest is one pass of block products. The initial state and a constant level of each output come from the
training rows of the same run, by least squares whose sums have a closed form in the poles; an initial state fitted on
the scored rows would favour models that are too large.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from era.realisation import Realisation
from era.state_recursion import simulate_array
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import runs_of

__all__ = [
    "FreeRun",
    "ModalForm",
    "driven_by_outputs",
    "filled",
    "free_run",
    "modal_form",
    "one_step_predictor",
]

LARGEST_EIGENVECTOR_CONDITION = 1e10
STATE_REGULARISATION = 1e-9
"""Of each free response's energy over the whole record: keeps a response that no training row shows from growing."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalForm:
    """A stable model with the free responses of its poles, one of each conjugate pair.

    Attributes:
        poles: (n_poles,) discrete-time poles with imaginary part >= 0.
        weights: (n_poles,) 2 for a pair, 1 for a real pole: y = Re(shapes @ (weights * state)) + D u.
        shapes: (n_outputs, n_poles).
        realisation: the same model as it was given.
    """

    poles: ComplexArray
    weights: FloatArray
    shapes: ComplexArray
    realisation: Realisation


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FreeRun:
    """A free run through one record.

    Attributes:
        outputs: (n_samples, n_outputs) simulated, the constant level included.
        level: (n_outputs,) constant that was added to each output.
    """

    outputs: FloatArray
    level: FloatArray


def modal_form(realisation: Realisation) -> ModalForm | None:
    """The model in modal form, or None when it is unstable or its eigenvectors are too close to dependent."""
    poles, vectors = np.linalg.eig(realisation.A)
    if poles.size and (np.abs(poles).max() >= 1.0 or np.linalg.cond(vectors) > LARGEST_EIGENVECTOR_CONDITION):
        return None
    one_of_each = poles.imag >= 0.0
    return ModalForm(
        poles=poles[one_of_each].astype(np.complex128),
        weights=np.where(poles[one_of_each].imag > 0.0, 2.0, 1.0),
        shapes=(realisation.C @ vectors)[:, one_of_each].astype(np.complex128),
        realisation=realisation,
    )


def free_run(model: ModalForm, record: Record, training_rows: BoolArray) -> FreeRun:
    """Run the model through the whole record, its initial state and the outputs' level fitted to `training_rows`.

    Args:
        model: from `modal_form`.
        record: without NaN (see `filled`).
        training_rows: (n_samples,) True where the initial state may look: never a row that was filled.

    Example:
        >>> model = modal_form(Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
        >>> record = Record([0.0, 0.0, 1.0, 0.0], [11.0, 10.5, 10.25, 11.125], 0.1)  # starts at 1, rests at 10
        >>> run = free_run(model, record, np.ones(4, dtype=bool))
        >>> run.outputs.ravel().round(6).tolist(), run.level.round(6).tolist()
        ([11.0, 10.5, 10.25, 11.125], [10.0])
    """
    system = model.realisation
    outputs = np.array(simulate_array(system.A, system.B, system.C, system.D, record.inputs))
    remainder = record.outputs - outputs
    remainder[~training_rows] = 0.0
    state, level, powers = _fit_initial_state(model, remainder, training_rows)
    outputs[: powers.shape[0]] += (powers @ ((model.weights * state)[:, np.newaxis] * model.shapes.T)).real
    return FreeRun(outputs=outputs + level, level=level)


def filled(records: Sequence[Record]) -> tuple[Record, ...]:
    """Gaps bridged by straight lines, for simulation only: no row of a gap is ever fitted or scored.

    Example:
        >>> filled([Record([], [1.0, np.nan, 3.0], 0.1)])[0].outputs.ravel().tolist()
        [1.0, 2.0, 3.0]
    """
    return tuple(
        record
        if record.complete_rows().all()
        else replace(record, inputs=_bridged(record.inputs), outputs=_bridged(record.outputs))
        for record in records
    )


def _bridged(values: FloatArray) -> FloatArray:
    bridged = np.array(values)
    rows = np.arange(values.shape[0])
    for channel in bridged.T:
        there = ~np.isnan(channel)
        channel[:] = np.interp(rows, rows[there], channel[there])
    return bridged


def one_step_predictor(realisation: Realisation) -> Realisation:
    """The predictor as a system driven by [inputs, measured outputs]: x+ = (A - K C) x + (B - K D) u + K y.

    Raises:
        ValueError: the realisation has no gain.
    """
    if realisation.K is None:
        raise ValueError("a one-step predictor needs the gain K.")
    A, B, C, D, K = realisation.A, realisation.B, realisation.C, realisation.D, realisation.K
    n_outputs = C.shape[0]
    return Realisation(
        A - K @ C, np.hstack([B - K @ D, K]), C, np.hstack([D, np.zeros((n_outputs, n_outputs))]), realisation.dt
    )


def driven_by_outputs(record: Record) -> Record:
    """The record with its outputs among its inputs, for `one_step_predictor`; gaps are bridged."""
    twin = replace(
        record,
        inputs=np.hstack([record.inputs, record.outputs]),
        input_names=(*record.input_names, *(f"past of {name}" for name in record.output_names)),
        input_units=(*record.input_units, *record.output_units),
    )
    return filled([twin])[0]


def _fit_initial_state(
    model: ModalForm, remainder: FloatArray, rows: BoolArray
) -> tuple[ComplexArray, FloatArray, ComplexArray]:
    """Least squares of what the inputs do not explain on the free responses and a constant.

    With x = a + j b per pole the response is Re(w c lambda^k x), so every sum over rows and outputs follows from the
    two sums of lambda_i^k lambda_j^k and conj(lambda_i)^k lambda_j^k over the rows.
    """
    n_poles, n_outputs = model.poles.size, remainder.shape[1]
    powers = _powers(model.poles, remainder.shape[0])
    shapes = model.weights * model.shapes
    edges = np.array(runs_of(rows), dtype=np.int64).reshape(-1, 2)
    plain = _sums(model.poles, model.poles, edges) * (shapes.T @ shapes)
    conjugate = _sums(model.poles.conj(), model.poles, edges) * (shapes.conj().T @ shapes)
    to_level = _sums(model.poles, np.ones(1), edges) * shapes.T  # (n_poles, n_outputs)
    right = (powers.T @ remainder[: powers.shape[0]] * shapes.T).sum(axis=1)
    level_rows = max(1, int(rows.sum()))

    size = 2 * n_poles + n_outputs
    matrix = np.zeros((size, size))
    a, b, c = slice(0, n_poles), slice(n_poles, 2 * n_poles), slice(2 * n_poles, size)
    matrix[a, a] = 0.5 * (conjugate.real + plain.real)
    matrix[b, b] = 0.5 * (conjugate.real - plain.real)
    matrix[a, b] = -0.5 * (conjugate.imag + plain.imag)
    matrix[b, a] = matrix[a, b].T
    matrix[a, c], matrix[b, c] = to_level.real, -to_level.imag
    matrix[c, a], matrix[c, b] = to_level.real.T, -to_level.imag.T
    matrix[c, c] = level_rows * np.eye(n_outputs)
    vector = np.concatenate([right.real, -right.imag, remainder.sum(axis=0)])

    whole = np.array([[0, remainder.shape[0]]])
    energy = 0.5 * _sums(model.poles.conj(), model.poles, whole).diagonal().real * (np.abs(shapes) ** 2).sum(axis=0)
    scale = np.concatenate([energy, energy, np.full(n_outputs, float(level_rows))])
    scale = np.sqrt(np.where(scale > 0.0, scale, 1.0))
    scaled = matrix / np.outer(scale, scale)
    scaled[np.diag_indices(size)] += STATE_REGULARISATION
    solution = scipy.linalg.lstsq(scaled, vector / scale, cond=1e-13, check_finite=False)[0] / scale
    return solution[a] + 1j * solution[b], solution[c], powers


def _sums(left: ComplexArray, right: npt.NDArray[np.inexact], edges: npt.NDArray[np.int64]) -> ComplexArray:
    """(n_left, n_right) sum over the runs' rows k of left_i^k right_j^k, by the geometric series of each run."""
    ratio = np.outer(left, right)
    first, last = edges[:, 0], edges[:, 1]
    starts = (left[:, np.newaxis] ** first) @ (right[:, np.newaxis] ** first).T
    ends = starts - (left[:, np.newaxis] ** last) @ (right[:, np.newaxis] ** last).T
    # a ratio of 1 (an integrator): every term of the series is 1
    one = np.abs(1.0 - ratio) < 1e-12
    return np.where(one, float((last - first).sum()), ends / np.where(one, 1.0, 1.0 - ratio))


def _powers(poles: ComplexArray, n_samples: int) -> ComplexArray:
    """(n_rows, n_poles) lambda^k for k = 0, 1, ... until the slowest has died out, by doubling."""
    slowest = float(np.abs(poles).max(initial=0.0))
    n_rows = n_samples
    if slowest < 1.0 - 1e-12:
        n_rows = min(n_samples, 2 + int(np.ceil(np.log(1e-12) / np.log(max(slowest, 1e-300)))))
    powers = np.empty((n_rows, poles.size), dtype=np.complex128)
    powers[:1] = 1.0
    done, step = 1, poles.astype(np.complex128)
    while done < n_rows:
        take = min(done, n_rows - done)
        powers[done : done + take] = powers[:take] * step
        done, step = done + take, step * step
    return powers
