"""One candidate: fitted on the rows outside a fold, reduced to every model order by one SVD, run freely and scored.

The squared error of the run counts on the fold's rows only. Without inputs there is no free run to score: the one-step
prediction of the reduced model takes its place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.balanced import HankelDecomposition, decompose
from era.hankel import block_sizes
from era.realisation import Realisation
from modal.free_run import driven_by_outputs, filled, free_run, modal_form, one_step_predictor
from modal.stretches import folds_of, stretches_of
from okid.arrays import BoolArray, FloatArray
from okid.coefficients import ObserverCoefficients
from okid.gram import LagGram, lag_gram
from okid.markov import MarkovParameters
from okid.record import Record
from okid.recovery import recover_arrays, recover_system
from okid.regression import solve
from okid.rows import runs_of
from okid.scaling import ChannelScaling, channel_scaling

__all__ = ["Ground", "Trial", "hankel_limits", "hankel_shape", "make_trials", "markov_lags", "prepare_ground"]

LARGEST_PULSE = 1e4
"""A recovered pulse response (scaled channels) that grows beyond this has diverged and is not realised."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trial:
    """One candidate that was fitted and scored.

    Attributes:
        observer_order: of the observer.
        ridge: of its fit.
        model_order: of the reduced model.
        squared_errors: (n_folds, n_outputs) on held-out rows, scaled channels; nan for folds not run.
        block_errors: (n_blocks,) squared error of each held-out block relative to the power of all of them, mean over
            outputs: what two trials are compared by.
        error: relative held-out error, mean over outputs: 1 - fit.
    """

    observer_order: int
    ridge: float
    model_order: int
    squared_errors: FloatArray
    block_errors: FloatArray
    error: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Ground:
    """What every candidate is fitted to and scored on."""

    scaled: tuple[Record, ...]  # the stretches that are run freely, gaps bridged
    held_out: tuple[tuple[BoolArray, ...], ...]  # [fold][stretch] complete rows that count
    trained: tuple[tuple[BoolArray, ...], ...]  # [fold][stretch] complete rows that the initial state may look at
    blocks: tuple[tuple[list[tuple[int, int]], ...], ...]  # [fold][stretch] (first, one past last) row
    records: tuple[Record, ...]
    scaling: ChannelScaling
    folds: tuple[tuple[BoolArray, ...], ...]  # [fold][record] rows held out
    grams: dict[int, tuple[LagGram, ...]]  # training Gram of each fold, for each observer order so far
    power: FloatArray
    n_lags: int


def markov_lags(n_inputs: int, n_outputs: int) -> int:
    """Lags to recover: as many as keep the Hankel matrix of many channels at a size whose SVD takes milliseconds."""
    return int(np.clip(800 / np.sqrt(max(1, n_inputs) * n_outputs), 120, 400))


def prepare_ground(records: Sequence[Record]) -> Ground:
    """Folds, scaled channels and bridged gaps, once for all candidates; `records` are of one system, means removed."""
    scaling = channel_scaling(records)
    folds = folds_of(records)
    whole = tuple(scaled_record(record, scaling) for record in filled(records))
    if not records[0].n_inputs:
        whole = tuple(driven_by_outputs(record) for record in whole)
    stretches = stretches_of(records)
    scaled = tuple(whole[one.record].samples(one.first, one.last) for one in stretches)
    complete = [records[one.record].complete_rows()[one.first : one.last] for one in stretches]
    counted = tuple(tuple(one.held_out(fold) for one in stretches) for fold in folds)
    held_out = tuple(tuple(rows & there for rows, there in zip(fold, complete, strict=True)) for fold in counted)
    return Ground(
        scaled=scaled,
        held_out=held_out,
        trained=tuple(tuple(~rows & there for rows, there in zip(fold, complete, strict=True)) for fold in counted),
        blocks=tuple(tuple(runs_of(rows) for rows in fold) for fold in counted),
        records=tuple(records),
        scaling=scaling,
        folds=folds,
        grams={},
        power=np.array([_held_out_power(scaled, fold) for fold in held_out]),
        n_lags=markov_lags(records[0].n_inputs, records[0].n_outputs),
    )


def _training(ground: Ground, observer_order: int) -> tuple[LagGram, ...]:
    """Gram of the rows outside each fold, made once for each observer order.

    A Gram shared by all orders would drop the rows that only the largest cannot use, which a short record misses, and
    would save but a quarter of the work.
    """
    if observer_order not in ground.grams:
        whole = lag_gram(ground.records, observer_order, scaling=ground.scaling)
        ground.grams[observer_order] = tuple(
            whole - lag_gram(ground.records, observer_order, scaling=ground.scaling, rows=fold) for fold in ground.folds
        )
    return ground.grams[observer_order]


def scaled_record(record: Record, scaling: ChannelScaling) -> Record:
    """The record with every channel at zero mean and unit standard deviation."""
    return replace(
        record,
        inputs=(record.inputs - scaling.input_mean) / scaling.input_scale,
        outputs=(record.outputs - scaling.output_mean) / scaling.output_scale,
    )


def _held_out_power(scaled: Sequence[Record], fold: Sequence[BoolArray]) -> FloatArray:
    held = np.vstack([record.outputs[rows] for record, rows in zip(scaled, fold, strict=True)])
    power: FloatArray = np.square(held).sum(axis=0)
    return np.maximum(power, np.finfo(np.float64).tiny)


def make_trials(
    ground: Ground,
    observer_orders: Sequence[int],
    ridge: float,
    model_orders: Sequence[int],
    fold_indices: Sequence[int],
) -> list[Trial]:
    """Fit every observer order with one ridge and score all model orders."""
    errors: dict[tuple[int, int], list[FloatArray]] = {}
    for i in fold_indices:
        for p in observer_orders:
            coefficients = solve(_training(ground, p)[i], ridge)
            decomposition = decompose_coefficients(coefficients, ground.n_lags, ground.scaled[0].dt, max(model_orders))
            if decomposition is None:
                continue
            for n in model_orders:
                blocks = _block_errors(ground, decomposition, n, i)
                if blocks is not None:
                    errors.setdefault((p, n), []).append(blocks)
    power = ground.power[list(fold_indices)]
    return [_trial(p, ridge, n, blocks, power) for (p, n), blocks in errors.items() if len(blocks) == len(fold_indices)]


def _trial(
    observer_order: int, ridge: float, model_order: int, blocks: Sequence[FloatArray], power: FloatArray
) -> Trial:
    squared = np.array([errors.sum(axis=0) for errors in blocks])
    whole = power.sum(axis=0)
    return Trial(
        observer_order=observer_order,
        ridge=ridge,
        model_order=model_order,
        squared_errors=squared,
        block_errors=(np.concatenate(blocks) / whole).mean(axis=1),
        error=float(np.sqrt(squared.sum(axis=0) / whole).mean()),
    )


def decompose_coefficients(
    coefficients: ObserverCoefficients, n_lags: int, dt: float, max_order: int
) -> HankelDecomposition | None:
    """Markov parameters and SVD of an observer in scaled channels; None where the pulse response diverges."""
    arrays = (coefficients.feedthrough, coefficients.input_coefficients, coefficients.output_coefficients)
    gain: FloatArray | None = None
    with np.errstate(over="ignore", invalid="ignore"):
        if coefficients.feedthrough.shape[1]:
            system = recover_system(*arrays, n_lags)
        else:
            system, gain = recover_arrays(*arrays, n_lags)
    largest = np.abs(system if gain is None else gain).max()
    if not largest < LARGEST_PULSE:  # nan is not below either
        return None
    markov = MarkovParameters(system=system, gain=gain, dt=dt, observer_order=coefficients.order)
    return decompose(markov, max_order=min(max_order, *hankel_limits(markov)))


def corner(decomposition: HankelDecomposition, order: int) -> Realisation | None:
    """The model of one order without its Hankel factors, which a candidate does not need; None beyond the rank."""
    found = decomposition
    if order > min(found.rank, found.max_order):
        return None
    gain = None if found.K is None else found.K[:order]
    return Realisation(found.A[:order, :order], found.B[:order], found.C[:, :order], found.D, found.dt, K=gain)


def hankel_limits(markov: MarkovParameters) -> tuple[int, int]:
    """Rows and columns of the block Hankel matrix that `decompose` would make."""
    return hankel_shape(markov.n_lags, markov.n_inputs, markov.n_outputs)


def hankel_shape(n_lags: int, n_inputs: int, n_outputs: int) -> tuple[int, int]:
    """Rows and columns of the block Hankel matrix of so many lags; without inputs it is that of the gain.

    Example:
        >>> hankel_shape(9, 1, 2)
        (6, 6)
    """
    n_channels = n_inputs or n_outputs
    a, b = block_sizes(n_lags, n_outputs, n_channels, n_block_rows=None, n_block_columns=None)
    return a * n_outputs, b * n_channels


def _block_errors(ground: Ground, decomposition: HankelDecomposition, model_order: int, fold: int) -> FloatArray | None:
    """(n_blocks, n_outputs) squared error of the free run on the fold's blocks; None when the model cannot run."""
    realisation = corner(decomposition, model_order)
    if realisation is None:
        return None
    form = modal_form(realisation if realisation.n_inputs else one_step_predictor(realisation))
    if form is None:
        return None
    errors = []
    for record, trained, held_out, edges in zip(
        ground.scaled, ground.trained[fold], ground.held_out[fold], ground.blocks[fold], strict=True
    ):
        if edges:
            run = free_run(form, record, trained)
            squared = np.square(record.outputs - run.outputs) * held_out[:, np.newaxis]
            errors += [squared[first:last].sum(axis=0) for first, last in edges]
    return np.array(errors)
