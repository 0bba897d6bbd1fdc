"""The automatic choice of observer order, ridge and model order, by what a free run makes of held-out rows.

One-step error cannot choose: on measured structures it looks perfect where the recovered Markov parameters diverge.
Each candidate (observer order, ridge) is fitted on the rows outside a fold, reduced to every model order by one SVD,
and run freely through the whole record; its squared error counts on the fold's rows only. Without inputs there is no
free run to score: the one-step prediction of the reduced model takes its place.

The search is coarse to fine: every candidate on one fold and a few model orders, then the most promising on all folds
and all model orders, then their neighbours, until no neighbour is better (so a grid that ends too early extends).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from era.balanced import HankelDecomposition, decompose
from era.hankel import block_sizes
from era.realisation import Realisation
from modal.free_run import driven_by_outputs, filled, free_run, modal_form, one_step_predictor, run_edges
from okid.arrays import BoolArray, FloatArray
from okid.coefficients import ObserverCoefficients
from okid.errors import InsufficientDataError
from okid.folds import interleaved_folds
from okid.gram import LagGram, lag_gram
from okid.markov import MarkovParameters
from okid.record import Record
from okid.recovery import recover_arrays, recover_system
from okid.regression import solve
from okid.scaling import ChannelScaling, channel_scaling

__all__ = ["Search", "SearchLimits", "Trial", "markov_lags", "search"]

OBSERVER_ORDERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
RIDGES = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
MODEL_ORDERS = (*range(1, 13), 14, 16, 18, 20, 24, 28, 32, 36, 40, 48, 56, 64)
COARSE_MODEL_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 40, 64)
FINALISTS = 6
ROUNDS = 4
SHORT = 4000
"""Samples up to which a fold is too short to scout alone, and all of them are cheap."""
LARGEST_PULSE = 1e4
"""A recovered pulse response (scaled channels) that grows beyond this has diverged and is not realised."""
WITHIN = 1.02
"""Largest ratio to the best error of a smaller model that may stand in for it."""
ROUND_OFF = 1e-14
"""Relative squared errors below this are equal: noise-free data."""


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
class SearchLimits:
    """Candidates that may be tried; a single value is a choice that the caller made."""

    observer_orders: tuple[int, ...]
    ridges: tuple[float, ...]
    model_orders: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Search:
    """Every trial on all folds, and the one that was chosen.

    Attributes:
        trials: on all folds, best first.
        chosen: the trial taken.
        power: (n_folds, n_outputs) squares of the held-out outputs about their mean, scaled channels.
        limits: what was allowed.
    """

    trials: tuple[Trial, ...]
    chosen: Trial
    power: FloatArray
    limits: SearchLimits


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Ground:
    """What every candidate is fitted to and scored on."""

    scaled: tuple[Record, ...]  # gaps bridged
    held_out: tuple[tuple[BoolArray, ...], ...]  # [fold][record] complete rows
    trained: tuple[tuple[BoolArray, ...], ...]  # [fold][record] complete rows
    blocks: tuple[
        tuple[npt.NDArray[np.int64], ...], ...
    ]  # [fold][record] first and one past the last row of each block
    records: tuple[Record, ...]
    scaling: ChannelScaling
    folds: tuple[tuple[BoolArray, ...], ...]  # [fold][record] rows held out
    grams: dict[int, tuple[LagGram, ...]]  # training Gram of each fold, for each observer order so far
    power: FloatArray
    n_lags: int


def search(
    records: Sequence[Record],
    *,
    observer_order: int | None = None,
    ridge: float | None = None,
    model_order: int | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Search:
    """Choose observer order, ridge and model order together; a given one is kept.

    Args:
        records: of one system, means removed.
        observer_order: the caller's choice, None to choose.
        ridge: likewise.
        model_order: likewise.
        progress: called with the share done.
    """
    limits = search_limits(records, observer_order=observer_order, ridge=ridge, model_order=model_order)
    ground = _ground(records)
    every_fold = tuple(range(len(ground.folds)))
    n_samples = sum(record.n_samples for record in records)
    scouted = every_fold if n_samples <= SHORT else every_fold[:1]
    coarse_orders = tuple(n for n in limits.model_orders if n in COARSE_MODEL_ORDERS) or limits.model_orders
    scout: list[Trial] = []
    for i, candidate in enumerate(limits.ridges):
        scout += _trials(ground, limits.observer_orders, candidate, coarse_orders, scouted)
        progress(0.5 * (i + 1) / len(limits.ridges))
    finalists = _best_observers(scout, FINALISTS)
    tried: dict[tuple[int, float], list[Trial]] = {}
    for step in range(ROUNDS):
        tried |= _grouped(ground, finalists, coarse_orders, every_fold)
        progress(0.5 + 0.4 * (step + 1) / ROUNDS)
        finalists = _untried_neighbours([t for row in tried.values() for t in row], limits, set(tried))
        if not finalists:
            break
    best = _best_observers([t for row in tried.values() for t in row], 2)
    tried |= _grouped(ground, best, limits.model_orders, every_fold)
    trials = sorted((t for row in tried.values() for t in row), key=lambda t: (t.error, t.model_order))
    progress(1.0)
    return Search(trials=tuple(trials), chosen=_chosen(trials), power=ground.power, limits=limits)


def _grouped(
    ground: _Ground,
    observers: Sequence[tuple[int, float]],
    model_orders: Sequence[int],
    fold_indices: Sequence[int],
) -> dict[tuple[int, float], list[Trial]]:
    """Trials of each (observer order, ridge), also of those that gave none."""
    tried: dict[tuple[int, float], list[Trial]] = {observer: [] for observer in observers}
    for ridge in sorted({ridge for _, ridge in observers}):
        orders = tuple(sorted(p for p, other in observers if other == ridge))
        for trial in _trials(ground, orders, ridge, model_orders, fold_indices):
            tried[trial.observer_order, ridge].append(trial)
    return tried


def search_limits(
    records: Sequence[Record], *, observer_order: int | None, ridge: float | None, model_order: int | None
) -> SearchLimits:
    """The grid that the records can carry: an observer needs several rows an unknown, and a Gram that fits a cache."""
    n_channels = records[0].n_inputs + records[0].n_outputs
    n_samples = sum(record.n_samples for record in records)
    shortest = min(record.n_samples for record in records)
    largest = max(1, min(256, n_samples // (3 * n_channels), 1600 // n_channels, shortest // 4))
    doubling = [p for p in OBSERVER_ORDERS if p <= largest]
    if largest >= 1.4 * doubling[-1]:
        doubling.append(largest)
    return SearchLimits(
        observer_orders=tuple(doubling) if observer_order is None else (observer_order,),
        ridges=RIDGES if ridge is None else (ridge,),
        model_orders=MODEL_ORDERS if model_order is None else (model_order,),
    )


def markov_lags(n_inputs: int, n_outputs: int) -> int:
    """Lags to recover: as many as keep the Hankel matrix of many channels at a size whose SVD takes milliseconds."""
    return int(np.clip(800 / np.sqrt(max(1, n_inputs) * n_outputs), 120, 400))


def _ground(records: Sequence[Record]) -> _Ground:
    scaling = channel_scaling(records)
    folds = interleaved_folds(records)
    scaled = tuple(scaled_record(record, scaling) for record in filled(records))
    if not records[0].n_inputs:
        scaled = tuple(driven_by_outputs(record) for record in scaled)
    complete = [record.complete_rows() for record in records]
    held_out = tuple(tuple(rows & there for rows, there in zip(fold, complete, strict=True)) for fold in folds)
    trained = tuple(tuple(~rows & there for rows, there in zip(fold, complete, strict=True)) for fold in folds)
    return _Ground(
        scaled=scaled,
        held_out=held_out,
        trained=trained,
        blocks=tuple(tuple(run_edges(rows) for rows in fold) for fold in folds),
        records=tuple(records),
        scaling=scaling,
        folds=folds,
        grams={},
        power=np.array([_held_out_power(scaled, fold) for fold in held_out]),
        n_lags=markov_lags(records[0].n_inputs, records[0].n_outputs),
    )


def _training(ground: _Ground, observer_order: int) -> tuple[LagGram, ...]:
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


def _trials(
    ground: _Ground,
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
    n_channels = markov.n_inputs or markov.n_outputs
    a, b = block_sizes(markov.n_lags, markov.n_outputs, n_channels, n_block_rows=None, n_block_columns=None)
    return a * markov.n_outputs, b * n_channels


def _block_errors(
    ground: _Ground, decomposition: HankelDecomposition, model_order: int, fold: int
) -> FloatArray | None:
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
        if edges.size:
            run = free_run(form, record, trained)
            squared = np.square(record.outputs - run.outputs) * held_out[:, np.newaxis]
            errors += [squared[first:last].sum(axis=0) for first, last in edges]
    return np.array(errors)


def _best_observers(trials: Sequence[Trial], count: int) -> list[tuple[int, float]]:
    """The (observer order, ridge) pairs whose best trial is best."""
    best: dict[tuple[int, float], float] = {}
    for trial in trials:
        key = (trial.observer_order, trial.ridge)
        best[key] = min(best.get(key, np.inf), trial.error)
    return sorted(best, key=lambda key: best[key])[:count]


def _untried_neighbours(
    trials: Sequence[Trial], limits: SearchLimits, tried: set[tuple[int, float]]
) -> list[tuple[int, float]]:
    """Observer orders half an octave and ridges half a decade around the best so far."""
    if not trials:
        return []
    best = min(trials, key=lambda trial: trial.error)
    orders, ridges = {best.observer_order}, {best.ridge}
    if len(limits.observer_orders) > 1:
        around = (round(best.observer_order / 1.4), round(best.observer_order * 1.4))
        orders |= {p for p in around if 1 <= p <= max(limits.observer_orders)}
    if len(limits.ridges) > 1 and best.ridge > 0.0:
        ridges |= {float(f"{ridge:.1g}") for ridge in (best.ridge / 3.0, best.ridge * 3.0) if ridge <= 1.0}
    return [(p, ridge) for p in sorted(orders) for ridge in sorted(ridges) if (p, ridge) not in tried]


def _chosen(trials: Sequence[Trial]) -> Trial:
    """The smallest model order that is within 2 % of the best error and not significantly worse.

    Significant is one standard error of the differences from block to block (Breiman, Friedman, Olshen, Stone,
    Classification and Regression Trees, 1984, section 3.4.3): a weak mode that helps in every block is kept.
    """
    if not trials:
        raise InsufficientDataError(
            "no observer order and ridge gave a stable model on any fold of the data; give a longer record, or choose "
            "observer_order, ridge and order by hand to see how the fit fails."
        )
    good = [trial for trial in trials if _as_good(trial, trials[0])]
    return min(good, key=lambda trial: (trial.model_order, trial.error))


def _as_good(trial: Trial, best: Trial) -> bool:
    worse = trial.block_errors - best.block_errors
    spread = float(np.sqrt(worse.size) * worse.std(ddof=1)) if worse.size > 1 else 0.0
    significantly = float(worse.sum()) > spread + ROUND_OFF
    return not significantly and trial.error <= WITHIN * best.error + np.sqrt(ROUND_OFF)
