"""How well a model repeats held-out rows when it sees the inputs alone: the score by which everything is chosen.

The run from rest is one pass of block products (`modal.estimation.modal_recursion`). The initial state and a constant level of
each output come from the training samples of the same run by least squares (`modal.estimation.initial_fit`); an initial state
fitted on the scored rows would favour models that are too large. Outputs may be missing sample by sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.realisation import Realisation
from modal.estimation.initial_fit import TrainingPattern, fit_initial_state
from modal.estimation.modal_recursion import ModalRecursion
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import runs_of

__all__ = [
    "FreeRun",
    "ModalForm",
    "driven_by_outputs",
    "filled",
    "free_run",
    "free_runs",
    "modal_form",
    "modal_form_of",
    "one_step_predictor",
    "run_from_rest",
]

LARGEST_EIGENVECTOR_CONDITION = 1e10
"""Frobenius norm of the eigenvectors times that of their inverse: at least the condition number in the 2-norm."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModalForm:
    """A stable model with the free responses of its poles, one of each conjugate pair.

    Attributes:
        poles: (n_poles,) discrete-time poles with imaginary part >= 0.
        weights: (n_poles,) 2 for a pair, 1 for a real pole: y = Re(shapes @ (weights * state)) + D u.
        shapes: (n_outputs, n_poles).
        participations: (n_poles, n_inputs), so that state(k+1) = poles * state(k) + participations @ u(k).
        feedthrough: (n_outputs, n_inputs) D.
    """

    poles: ComplexArray
    weights: FloatArray
    shapes: ComplexArray
    participations: ComplexArray
    feedthrough: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FreeRun:
    """A free run through one record.

    Attributes:
        outputs: (n_samples, n_outputs) simulated, the constant level included.
        level: (n_outputs,) constant that was added to each output.
        state: (n_poles,) modal state at the first sample.
    """

    outputs: FloatArray
    level: FloatArray
    state: ComplexArray


def modal_form(realisation: Realisation) -> ModalForm | None:
    """The model in modal form, or None when it is unstable or its eigenvectors are too close to dependent."""
    return modal_form_of(realisation.A, realisation.B, realisation.C, realisation.D)


def modal_form_of(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> ModalForm | None:
    """As `modal_form`, from the matrices: a search has hundreds of candidates, and checks none of their numbers."""
    poles, vectors = np.linalg.eig(A)
    if np.abs(poles).max(initial=0.0) >= 1.0:
        return None
    # Real coordinates, 2 Re v and -2 Im v for a pair: the two states of a pair cannot differ by rounding.
    upper, lower = poles.imag > 0.0, poles.imag < 0.0
    coordinates = np.where(upper, 2.0 * vectors.real, np.where(lower, 2.0 * vectors.imag, vectors.real))
    try:
        inverse = np.linalg.inv(coordinates)
    except np.linalg.LinAlgError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # of an inverse that is nothing but rounding
        condition = np.linalg.norm(coordinates) * np.linalg.norm(inverse)
    if not condition <= LARGEST_EIGENVECTOR_CONDITION:
        return None
    participations = (inverse @ B).astype(np.complex128)
    participations[upper] += 1j * participations[lower]  # LAPACK keeps pairs together, in the same order
    one_of_each = ~lower
    return ModalForm(
        poles=poles[one_of_each].astype(np.complex128),
        weights=np.where(upper[one_of_each], 2.0, 1.0),
        shapes=(C @ vectors[:, one_of_each]).astype(np.complex128),
        participations=participations[one_of_each],
        feedthrough=D,
    )


def free_run(model: ModalForm, record: Record, training: BoolArray) -> FreeRun:
    """Run the model through the whole record, its initial state and the outputs' level fitted to what trains.

    Args:
        model: from `modal_form`.
        record: no input missing (see `filled`).
        training: (n_samples,) rows or (n_samples, n_outputs) samples, True where the initial state may look: never
            at a sample that is missing or was filled.

    Example:
        >>> model = modal_form(Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
        >>> record = Record([0.0, 0.0, 1.0, 0.0], [11.0, 10.5, 10.25, 11.125], 0.1)  # starts at 1, rests at 10
        >>> run = free_run(model, record, np.ones(4, dtype=bool))
        >>> run.outputs.ravel().round(6).tolist(), run.level.round(6).tolist()
        ([11.0, 10.5, 10.25, 11.125], [10.0])
    """
    shapes = model.weights * model.shapes
    recursion = ModalRecursion.of(model.poles, model.participations, shapes, model.feedthrough)
    outputs = recursion.from_rest(record.inputs)
    left = record.outputs - outputs
    left[~training] = 0.0
    n_alive = recursion.n_alive(record.n_samples)
    state, level = fit_initial_state(
        model.poles,
        shapes,
        recursion.products(left[:n_alive]),
        left.sum(axis=0),
        patterns=_patterns(training, record.n_outputs),
        n_samples=record.n_samples,
    )
    outputs[:n_alive] += recursion.free_response(state, n_alive)
    outputs += level
    return FreeRun(outputs=outputs, level=level, state=state)


def free_runs(model: ModalForm, records: Sequence[Record]) -> list[FloatArray]:
    """(n_samples, n_outputs) run through each record, its start and level fitted to every sample that was measured.

    Example:
        >>> model = modal_form(Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
        >>> (run,) = free_runs(model, [Record([0.0, 0.0, 1.0, 0.0], [11.0, 10.5, np.nan, 11.125], 0.1)])
        >>> run.ravel().round(6).tolist()
        [11.0, 10.5, 10.25, 11.125]
    """
    return [free_run(model, record, ~np.isnan(record.outputs)).outputs for record in records]


def run_from_rest(model: ModalForm, inputs: FloatArray) -> FloatArray:
    """(n_samples, n_outputs) response to (n_samples, n_inputs) inputs, none missing."""
    shapes = model.weights * model.shapes
    return ModalRecursion.of(model.poles, model.participations, shapes, model.feedthrough).from_rest(inputs)


def _patterns(training: BoolArray, n_outputs: int) -> list[TrainingPattern]:
    """Outputs that train on the same rows, and the runs of these rows."""
    if training.ndim == 1 or training.all():
        rows = training if training.ndim == 1 else training[:, 0]
        return [(np.arange(n_outputs), runs_of(rows))]
    together: dict[bytes, list[int]] = {}
    for i, samples in enumerate(training.T):
        together.setdefault(np.packbits(samples).tobytes(), []).append(i)
    return [(np.array(outputs), runs_of(training[:, outputs[0]])) for outputs in together.values()]


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
