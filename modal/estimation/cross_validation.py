"""What every candidate is fitted to and scored on, and what the fits made so far can give again.

A candidate is fitted on the rows outside a fold: the Gram matrix of these rows serves all ridges of an observer order,
the decomposition of its Hankel matrix all model orders.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from era.balanced import HankelDecomposition, decompose
from era.hankel import block_sizes
from era.realisation import Realisation
from modal.estimation.free_run import driven_by_outputs, filled
from modal.estimation.stretches import folds_of, stretches_of
from okid.arrays import BoolArray, FloatArray
from okid.coefficients import ObserverCoefficients
from okid.gram import LagGram, lag_gram
from okid.least_squares import solve
from okid.markov import MarkovParameters
from okid.record import Record
from okid.recovery import recover_arrays, recover_system
from okid.rows import runs_of
from okid.scaling import ChannelScaling, channel_scaling

__all__ = [
    "LARGEST_PULSE",
    "Ground",
    "corner",
    "decompose_coefficients",
    "hankel_limits",
    "hankel_shape",
    "markov_lags",
    "prepare_ground",
    "scaled_record",
    "training_decomposition",
    "training_gram",
]

LARGEST_PULSE = 1e4
"""A recovered pulse response (scaled channels) that grows beyond this has diverged and is not realised."""


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
    power: FloatArray
    n_lags: int
    # what was computed so far, so that a search may ask for the same again
    grams: dict[tuple[int, int], LagGram]  # [observer order, fold]
    decompositions: dict[tuple[int, float, int], tuple[int, HankelDecomposition] | None]  # [observer, ridge, fold]
    scores: dict[tuple[int, float, int, int], FloatArray | None]  # [observer, ridge, model order, fold] block errors


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
        power=np.array([_held_out_power(scaled, fold) for fold in held_out]),
        n_lags=markov_lags(records[0].n_inputs, records[0].n_outputs),
        grams={},
        decompositions={},
        scores={},
    )


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


def training_gram(ground: Ground, observer_order: int, fold: int) -> LagGram:
    """Gram of the rows outside a fold, made once for each observer order.

    A Gram shared by all orders would drop the rows that only the largest cannot use, which a short record misses, and
    would save but a quarter of the work.
    """
    if (observer_order, fold) not in ground.grams:
        rows = [~held_out for held_out in ground.folds[fold]]
        ground.grams[observer_order, fold] = lag_gram(ground.records, observer_order, scaling=ground.scaling, rows=rows)
    return ground.grams[observer_order, fold]


def training_decomposition(
    ground: Ground, observer_order: int, ridge: float, fold: int, max_order: int
) -> HankelDecomposition | None:
    """Observer of the rows outside a fold, decomposed for models up to `max_order`, made once.

    None where its pulse response diverges.
    """
    observer = observer_order, ridge, fold
    found = ground.decompositions.get(observer)
    if observer not in ground.decompositions or (found is not None and found[0] < max_order):
        coefficients = solve(training_gram(ground, observer_order, fold), ridge)
        made = decompose_coefficients(coefficients, ground.n_lags, ground.scaled[0].dt, max_order)
        found = None if made is None else (max_order, made)
        ground.decompositions[observer] = found
    return None if found is None else found[1]


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
