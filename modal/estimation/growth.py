"""Weak modes that a refined model leaves over: found in its error, added, refined together with the others.

An observer of the whole record sees a mode that is far below the others only with the noise of the reduction on top;
the error of a refined model holds that mode and the noise, and nothing else. OKID and ERA on the inputs and the error
give its pole, and the refinement of all poles together decides, on held-out rows, whether it stays.
"""

from dataclasses import replace

import numpy as np

from era.realisation import Realisation
from modal.estimation.cross_validation import corner, decompose_coefficients
from modal.estimation.modal_states import ModalParameters, free_runs
from modal.estimation.output_error import NONE, OutputError, Step, evaluate
from modal.estimation.starting import starting_parameters
from okid.arrays import FloatArray
from okid.errors import IdentificationError
from okid.gram import lag_gram
from okid.least_squares import solve
from okid.record import Record
from okid.scaling import channel_scaling

__all__ = ["errors_of", "with_weak_mode"]

CANDIDATE_ORDER = 8
"""States of the model of the error: the strongest of its poles is taken."""
LONGEST_OBSERVER = 64
ROWS_AN_UNKNOWN = 8
"""Rows for each unknown of that observer."""
RIDGE = 1e-4
"""Of the observer of the error, which is nearly all noise."""
LARGEST_POLE = 0.9999
N_LAGS = 200


def with_weak_mode(step: Step, data: OutputError, *, held_out: int = NONE) -> Step | None:
    """The model with the strongest mode of its error added, not refined yet; None where there is none to add.

    Args:
        step: a refined model.
        data: that it was fitted to.
        held_out: rows with this label are not looked at.
    """
    errors = errors_of(step, data, held_out=held_out)
    records = tuple(replace(record, outputs=error) for record, error in zip(data.records, errors, strict=True))
    found = _model_of_error(records)
    if found is None:
        return None
    left = OutputError(records=tuple(_filled(record) for record in records), rows=data.rows, blocks=data.blocks)
    candidates = starting_parameters(found, left, held_out=held_out)
    if candidates is None:
        return None
    parameters = candidates.parameters
    vibrating = np.flatnonzero(parameters.is_pair & (np.abs(parameters.poles) < LARGEST_POLE))
    alone = [_chosen(parameters, i) for i in vibrating.tolist()]
    if not alone:
        return None
    best = min(alone, key=lambda one: evaluate(one, left, held_out=held_out).error)
    return evaluate(_joined(step.parameters, best), data, held_out=held_out)


def errors_of(step: Step, data: OutputError, *, held_out: int = NONE) -> list[FloatArray]:
    """(n_samples, n_outputs) a record: errors of the free run, NaN on rows that do not count."""
    errors = []
    runs = free_runs(step.parameters, step.linear.coefficients, data.records)
    for index, (record, run, rows) in enumerate(zip(data.records, runs, data.rows, strict=True)):
        error = record.outputs - run
        error[~rows] = np.nan
        for block in data.blocks:
            if block.record == index and block.label == held_out:
                error[block.first : block.last] = np.nan
        errors.append(error)
    return errors


def _model_of_error(records: tuple[Record, ...]) -> Realisation | None:
    scaling = channel_scaling(records)
    n_channels = records[0].n_inputs + records[0].n_outputs
    n_samples = sum(record.n_samples for record in records)
    longest = max(1, min(LONGEST_OBSERVER, n_samples // (ROWS_AN_UNKNOWN * n_channels)))
    try:
        gram = lag_gram(records, longest, scaling=scaling)
        coefficients = solve(gram, RIDGE)
    except IdentificationError:
        return None
    found = decompose_coefficients(coefficients, N_LAGS, records[0].dt, CANDIDATE_ORDER)
    if found is None:
        return None
    order = min(CANDIDATE_ORDER, found.rank, found.max_order)
    model = corner(found, order)
    while model is not None and np.abs(np.linalg.eigvals(model.A)).max(initial=0.0) >= 1.0:
        order -= 1
        model = corner(found, order) if order > 0 else None
    if model is None:
        return None
    out = scaling.output_scale[:, np.newaxis]
    return Realisation(
        model.A, model.B / scaling.input_scale, model.C * out, model.D * out / scaling.input_scale, model.dt
    )


def _filled(record: Record) -> Record:
    """Zeros where an error does not count: these rows are in no sum."""
    return replace(record, outputs=np.nan_to_num(record.outputs))


def _chosen(parameters: ModalParameters, index: int) -> ModalParameters:
    one = slice(index, index + 1)
    return ModalParameters(
        poles=parameters.poles[one],
        is_pair=parameters.is_pair[one],
        inputs=parameters.inputs[one],
        states=parameters.states[:, one],
    )


def _joined(first: ModalParameters, second: ModalParameters) -> ModalParameters:
    return ModalParameters(
        poles=np.concatenate([first.poles, second.poles]),
        is_pair=np.concatenate([first.is_pair, second.is_pair]),
        inputs=np.vstack([first.inputs, second.inputs]),
        states=np.hstack([first.states, second.states]),
    )
