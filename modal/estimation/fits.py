"""Free runs and one-step predictions of the final model, and the fits that say how good they are."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.realisation import Realisation
from modal.estimation.cross_validation import Trial, scaled_model
from modal.estimation.free_run import (
    ModalForm,
    can_be_foretold,
    driven_by_outputs,
    filled,
    free_run,
    modal_form,
    one_step_predictor,
)
from modal.modes.mode import Fit
from okid.arrays import BoolArray, FloatArray
from okid.errors import NumericalError
from okid.record import Record
from okid.scaling import channel_scaling


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModelRuns:
    """What the final model makes of each record.

    Attributes:
        records: the records with the level at which the model rests taken off the outputs.
        simulated: free runs (without inputs: one-step predictions).
        predicted: one-step predictions; the free runs where the model has no usable gain or the record hardly a row.
    """

    records: tuple[Record, ...]
    simulated: tuple[Record, ...]
    predicted: tuple[Record, ...]

    @property
    def left(self) -> list[FloatArray]:
        """(n_samples, n_outputs) a record: what the free runs leave; NaN where an output is missing."""
        return [real.outputs - run.outputs for real, run in zip(self.records, self.simulated, strict=True)]


def _predictor_form(model: Realisation) -> ModalForm | None:
    """The predictor in modal form; a pole that only the rounding of a double one puts on the unit circle is set inside.

    Zeros of a steep filter, the same at every output, are such poles: a double one is known to half of the digits.
    """
    predictor = one_step_predictor(model)
    radius, rounding = np.abs(np.linalg.eigvals(predictor.A)).max(initial=0.0), np.sqrt(np.finfo(np.float64).eps)
    if 1.0 <= radius <= 1.0 + rounding:
        predictor = replace(predictor, A=predictor.A * ((1.0 - rounding) / radius))
    return modal_form(predictor)


def model_runs(realisation: Realisation, records: Sequence[Record]) -> ModelRuns:
    """Run the model through every record, initial state and level fitted to all of its rows.

    Channels are brought to unit standard deviation first, so that no unit outweighs another in that fit.

    Raises:
        NumericalError: the model cannot run freely: it is unstable, or its eigenvectors are nearly dependent.
    """
    scaling = channel_scaling(records)
    model = scaled_model(realisation, scaling)
    # None, too, where it is unstable, or deadbeat (noise-free data) and so without independent eigenvectors
    predictor = None if model.K is None else _predictor_form(model)
    runner = modal_form(model) if records[0].n_inputs else predictor
    if runner is None:
        raise NumericalError(
            f"a free run needs a stable model with independent eigenvectors, which this one of order "
            f"{realisation.order} is not; choose another order."
        )
    levelled, simulated, predicted = [], [], []
    for record, whole in zip(records, filled(records), strict=True):
        unit = replace(whole, inputs=whole.inputs / scaling.input_scale, outputs=whole.outputs / scaling.output_scale)
        there = record.complete_rows()
        free, level = _run(runner, unit, there)
        one_step = free
        if record.n_inputs and predictor is not None and can_be_foretold(record):
            one_step, _ = _run(predictor, replace(unit, outputs=unit.outputs - level), there)
            one_step = one_step + level
        levelled.append(replace(record, outputs=record.outputs - level * scaling.output_scale))
        simulated.append(replace(record, outputs=(free - level) * scaling.output_scale))
        predicted.append(replace(record, outputs=(one_step - level) * scaling.output_scale))
    return ModelRuns(records=tuple(levelled), simulated=tuple(simulated), predicted=tuple(predicted))


def fit_of(measured: Sequence[Record], modelled: Sequence[Record]) -> FloatArray:
    """(n_outputs,) 1 - |y - y_model| / |y - mean(y)| over all rows of all records; nan for an output that never moves.

    Example:
        >>> record = Record([], [0.0, 1.0, 2.0], 1.0)
        >>> fit_of([record], [record])
        array([1.])
    """
    error = np.zeros(measured[0].n_outputs)
    power = np.zeros(measured[0].n_outputs)
    for truth, model in zip(measured, modelled, strict=True):
        error += np.nansum(np.square(truth.outputs - model.outputs), axis=0)
        power += np.nansum(np.square(truth.outputs - np.nanmean(truth.outputs, axis=0)), axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        fit: FloatArray = 1.0 - np.sqrt(error / power)
    return fit


def measure_fit(chosen: Trial, power: FloatArray, runs: ModelRuns) -> Fit:
    """All fits of the chosen model; `power` is that of the outputs on the rows that its folds hold out."""
    squared = chosen.squared_errors
    return Fit(
        cross_validated=1.0 - np.sqrt(squared.sum(axis=0) / power.sum(axis=0)),
        folds=(1.0 - np.sqrt(squared / power)).mean(axis=1),
        whole=fit_of(runs.records, runs.simulated),
        one_step=fit_of(runs.records, runs.predicted),
    )


def mean_fit(fits: Sequence[Fit], outputs: Sequence[Sequence[int]], n_outputs: int) -> Fit:
    """Fits of each output, the mean over those that have it.

    Args:
        fits: each of some outputs.
        outputs: which of `n_outputs` those are.
        n_outputs: in all.
    """

    def mean(name: str) -> FloatArray:
        total, count = np.zeros(n_outputs), np.zeros(n_outputs)
        for one, seen in zip(fits, outputs, strict=True):
            total[list(seen)] += getattr(one, name)
            count[list(seen)] += 1
        return total / count

    return Fit(
        cross_validated=mean("cross_validated"),
        folds=np.concatenate([one.folds for one in fits]),
        whole=mean("whole"),
        one_step=mean("one_step"),
    )


def _run(model: ModalForm, record: Record, rows: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Outputs and level of a run."""
    if model.feedthrough.shape[1] != record.n_inputs:
        record = driven_by_outputs(record)
    run = free_run(model, record, rows)
    return run.outputs, run.level
