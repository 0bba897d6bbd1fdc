"""A first model, good enough to judge the data by: one observer, one ridge, the order whose free run is nearest.

What is done to records before the search (filling gaps, taking off drift) is decided by what a model leaves of them.
This one costs a few hundredths of a second for each ten thousand samples, and no more orders than a search would are
run freely through no more rows; it is never the answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.balanced import decompose, realise_from
from modal.estimation.cross_validation import (
    FIRST_RIDGE,
    LARGEST_PULSE,
    WITHIN,
    hankel_limits,
    markov_lags,
    scaled_record,
    stretches_of,
)
from modal.estimation.free_run import ModalForm, filled, free_runs, modal_form, run_from_rest
from modal.modes.modal_mass import DERIVATIVES
from modal.modes.skew import MeasuredShapes, Skew, skew_of_shapes
from okid.arrays import FloatArray
from okid.gram import lag_gram
from okid.least_squares import solve
from okid.markov import MarkovParameters, recover_system
from okid.record import Record
from okid.scaling import channel_scaling

RIDGES = (FIRST_RIDGE, 10 * FIRST_RIDGE, 100 * FIRST_RIDGE)
"""Try a larger ridge where no model is stable with the smaller ones: to be unstable proves nothing about the system."""
ROUNDING = 1e-14
"""Take no sum of squares of a column of unit length for less: it is rounding."""
MODEL_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 32, 40)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QuickModel:
    """A stable model and how near its free run comes.

    Attributes:
        form: the model.
        error: root mean square of what its free run leaves of the measured samples that were looked at.
        forgets: whether every pole of every order tried dies out to 1 / e within the longest record; that of an
            integrator does not.
    """

    form: ModalForm
    error: float
    forgets: bool


def quick_model(records: Sequence[Record]) -> QuickModel | None:
    """The model of records without missing samples and with channels of like size; None where none is stable.

    Example:
        >>> force = np.random.default_rng(0).standard_normal(600)
        >>> quick_model([Record(force, np.convolve(force, [0.0, 1.0, 0.5])[:600], 0.01)]).error < 0.01
        True
    """
    for ridge in RIDGES:
        markov = observer_markov(records, ridge=ridge)
        model = None if markov is None else best_model(markov, records)
        if model is not None:
            return model
    return None


def left_alone_and_together(records: Sequence[Record], left: Sequence[FloatArray]) -> tuple[float, float]:
    """Shares of the outputs' power that a first model of each record alone leaves, and that the model of all does.

    Args:
        records: of one system with inputs.
        left: (n_samples, n_outputs) a record: what the free run of the model of all leaves.

    Returns:
        Both nan for one record, missing samples, and inputs of which not all move in each record.
    """
    alone = together = power = 0.0
    scaling = channel_scaling(records)
    for record, errors in zip(records, left, strict=True):
        scaled = scaled_record(record, scaling)
        whole = len(records) > 1 and record.n_inputs > 0 and bool(record.complete_rows().all())
        model = quick_model([scaled]) if whole else None
        if model is None:
            return float("nan"), float("nan")
        alone += model.error**2 * scaled.outputs.size
        together += float(np.square(errors / scaling.output_scale).sum())
        power += float(np.square(scaled.outputs).sum())
    return alone / power, together / power


def choose_skew(
    records: Sequence[Record], factor: int = 1, *, known: tuple[Sequence[Record], QuickModel | None] | None = None
) -> Skew:
    """How late outputs are against most others, as the shapes of a first model tell it beyond chance.

    Args:
        records: with inputs as they act.
        factor: by which they were decimated.
        known: the same with channels of like size, and their model, where those were made.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> poles = np.exp(np.array([-0.01 + 0.4j, -0.01 + 0.9j, -0.02 + 1.7j]))
        >>> force, shapes = rng.standard_normal(4000), np.array([[1.0, 0.9], [1.0, -0.7], [0.5, 0.8]])
        >>> lags = np.arange(400)[:, np.newaxis] - np.array([0.0, 0.5])
        >>> answers = [shapes[r] * np.exp(lags * np.log(pole)).imag * (lags > 0) for r, pole in enumerate(poles)]
        >>> outputs = np.column_stack([np.convolve(force, one)[:4000] for one in sum(answers).T])
        >>> record = Record(force, outputs + 0.01 * rng.standard_normal((4000, 2)), 1.0)
        >>> [round(late, 1) for late in choose_skew([record]).late]
        [0.0, 0.5]
    """
    scaling = channel_scaling(records)
    if records[0].n_outputs < 2 or not records[0].n_inputs or scaling.constant_outputs or scaling.constant_inputs:
        return Skew()
    if known is None:
        own = [scaled_record(record, scaling) for record in records]
        known = own, quick_model(own)
    scaled, model = known
    if model is None:
        return Skew()
    powers = [DERIVATIVES.get(unit) for unit in records[0].output_units]
    late = skew_of_shapes(measured_shapes(model.form, scaled, powers), same_kind=None not in powers)
    return Skew.of(late.tolist(), records[0], factor=factor)


def measured_shapes(form: ModalForm, records: Sequence[Record], powers: Sequence[int | None]) -> MeasuredShapes:
    """Shapes of the poles that ring, by least squares of the outputs over the motions of all poles and the inputs.

    Args:
        form: a stable model.
        records: that it is a model of; of long ones the stretches that a search would score.
        powers: (n_outputs,) derivative of motion that each output is; None where that is not known of all.
    """
    n_poles, ringing = form.poles.size, form.weights > 1.0
    eye = np.eye(n_poles, dtype=np.complex128)
    both = np.asarray(np.concatenate([eye, 1j * eye[ringing]]) / form.weights, dtype=np.complex128)
    motions = replace(form, shapes=both, feedthrough=np.zeros((both.shape[0], form.feedthrough.shape[1])))
    compared = [records[one.record].samples(one.first, one.last) for one in stretches_of(records)]
    rows = [
        np.column_stack([run_from_rest(motions, one.inputs), one.inputs, np.ones(one.n_samples), one.outputs])
        for one in filled(compared)
    ]
    whole = np.vstack([own[one.complete_rows()] for own, one in zip(rows, compared, strict=True)])
    size = np.maximum(np.linalg.norm(whole, axis=0), ROUNDING)
    n_outputs = records[0].n_outputs
    gram = (whole / size).T @ (whole / size)
    inverse = np.linalg.inv(gram[:-n_outputs, :-n_outputs] + ROUNDING * np.eye(len(gram) - n_outputs))
    found = inverse @ gram[:-n_outputs, -n_outputs:]
    left = np.diag(gram)[-n_outputs:] - np.einsum("ij,ij->j", found, gram[:-n_outputs, -n_outputs:])
    scale = size[-n_outputs:] / size[:-n_outputs, np.newaxis]
    variance = np.diag(inverse)[:, np.newaxis] * np.maximum(left, ROUNDING) / len(whole) * scale**2
    real, imaginary = np.flatnonzero(ringing), np.arange(n_poles, both.shape[0])
    angular = np.abs(np.angle(form.poles[ringing]))
    derived = np.ones((angular.size, n_outputs), dtype=complex)
    if None not in powers:
        derived = np.log(form.poles[ringing, np.newaxis]) ** np.array(powers)
    return MeasuredShapes(
        angular=angular,
        shapes=((found * scale)[real] + 1j * (found * scale)[imaginary]) / derived,
        variance=0.5 * (variance[real] + variance[imaginary]) / np.abs(derived) ** 2,
    )


def observer_order(records: Sequence[Record]) -> int:
    """The longest observer that the records carry and that a first look can afford."""
    n_channels = records[0].n_inputs + records[0].n_outputs
    rows = sum(record.n_samples for record in records) // 4  # rows an unknown, at least
    longest = max(record.n_samples for record in records)
    # longer memories do not decide what preparation asks
    return max(1, min(128, min(600, rows) // n_channels, longest // 4))


def observer_markov(records: Sequence[Record], *, ridge: float = FIRST_RIDGE) -> MarkovParameters | None:
    """Markov parameters of one observer; None where they diverge or too few rows are whole."""
    order = observer_order(records)
    scaling = channel_scaling(records)
    if scaling.constant_inputs or scaling.constant_outputs:
        return None
    gram = lag_gram(records, order, scaling=scaling)
    if gram.n_rows <= gram.matrix.shape[0]:
        return None
    fit = solve(gram, ridge)
    n_lags = markov_lags(records[0].n_inputs, records[0].n_outputs)
    with np.errstate(over="ignore", invalid="ignore"):
        pulse = recover_system(fit.feedthrough, fit.input_coefficients, fit.output_coefficients, n_lags)
    if not np.abs(pulse).max() < LARGEST_PULSE:  # nan is not below either
        return None
    size = scaling.output_scale[:, np.newaxis] / scaling.input_scale
    return MarkovParameters(system=pulse * size, dt=records[0].dt)


def best_model(markov: MarkovParameters, records: Sequence[Record]) -> QuickModel | None:
    """The smallest stable model whose free run is within 2 % of the nearest to the measured samples.

    Args:
        markov: without gain.
        records: whose outputs are compared with the free run; of long ones the stretches that a search would score.
    """
    decomposition = decompose(markov, max_order=min(max(MODEL_ORDERS), *hankel_limits(markov)))
    compared = [records[one.record].samples(one.first, one.last) for one in stretches_of(records)]
    n_measured = max(1, sum(int(np.isfinite(record.outputs).sum()) for record in compared))
    longest = max(record.n_samples for record in records)
    largest = min(decomposition.rank, decomposition.max_order)
    models = [realise_from(decomposition, order) for order in MODEL_ORDERS if order <= largest]
    radius = max((float(np.abs(np.linalg.eigvals(model.A)).max()) for model in models), default=0.0)
    tried = []
    for model in models:
        form = modal_form(model)
        if form is not None:
            runs = zip(compared, free_runs(form, compared), strict=True)
            squares = sum(float(np.nansum(np.square(record.outputs - run))) for record, run in runs)
            error = float(np.sqrt(squares / n_measured))
            tried.append(QuickModel(form=form, error=error, forgets=longest * (1.0 - radius) > 1.0))
    least = min((model.error for model in tried), default=np.inf)
    return next((model for model in tried if model.error <= WITHIN * least), None)
