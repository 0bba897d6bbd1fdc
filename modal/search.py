"""The automatic choice of observer order, ridge and model order, by what a free run makes of held-out rows.

One-step error cannot choose: on measured structures it looks perfect where the recovered Markov parameters diverge.
Each candidate (observer order, ridge) is fitted on the rows outside a fold, reduced to every model order by one SVD,
and run freely through the whole record; its squared error counts on the fold's rows only. Without inputs there is no
free run to score: the one-step prediction of the reduced model takes its place.

The search is coarse to fine: every candidate on one fold and a few model orders, then the most promising on all folds
and all model orders, then their neighbours, until no neighbour is better (so a grid that ends too early extends).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from modal.trials import Ground, Trial, hankel_shape, make_trials, prepare_ground
from okid.arrays import FloatArray
from okid.errors import InsufficientDataError
from okid.record import Record
from okid.rows import check_enough_rows

__all__ = ["Search", "SearchLimits", "search", "search_limits"]

OBSERVER_ORDERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
RIDGES = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
MODEL_ORDERS = (*range(1, 13), 14, 16, 18, 20, 24, 28, 32, 36, 40, 48, 56, 64)
COARSE_MODEL_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 40, 64)
FINALISTS = 6
ROUNDS = 4
SHORT = 4000
"""Samples up to which a fold is too short to scout alone, and all of them are cheap."""
LEAST_ROWS = 0.75
"""Share of the samples that an observer order must leave as rows; a short record among long ones does not limit it."""
WITHIN = 1.02
"""Largest ratio to the best error of a smaller model that may stand in for it."""
ROUND_OFF = 1e-14
"""Relative squared errors below this are equal: noise-free data."""


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

    Raises:
        InsufficientDataError: the records are too short for the observer order that was given, or no candidate gave a
            stable model.
    """
    limits = search_limits(records, observer_order=observer_order, ridge=ridge, model_order=model_order)
    ground = prepare_ground(records)
    if model_order is not None:
        _check_model_order(model_order, ground)
    every_fold = tuple(range(len(ground.folds)))
    n_samples = sum(record.n_samples for record in records)
    scouted = every_fold if n_samples <= SHORT else every_fold[:1]
    coarse_orders = tuple(n for n in limits.model_orders if n in COARSE_MODEL_ORDERS) or limits.model_orders
    scout: list[Trial] = []
    for i, candidate in enumerate(limits.ridges):
        scout += make_trials(ground, limits.observer_orders, candidate, coarse_orders, scouted)
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
    if not trials:
        raise InsufficientDataError(_nothing_stable(limits))
    progress(1.0)
    return Search(trials=tuple(trials), chosen=_chosen(trials), power=ground.power, limits=limits)


def _check_model_order(model_order: int, ground: Ground) -> None:
    first = ground.records[0]
    largest = min(hankel_shape(ground.n_lags, first.n_inputs, first.n_outputs))
    if model_order > largest:
        raise InsufficientDataError(
            f"model order {model_order} was asked for, but the block Hankel matrix of {ground.n_lags} lags allows at "
            f"most {largest}; use order <= {largest}."
        )


def _grouped(
    ground: Ground,
    observers: Sequence[tuple[int, float]],
    model_orders: Sequence[int],
    fold_indices: Sequence[int],
) -> dict[tuple[int, float], list[Trial]]:
    """Trials of each (observer order, ridge), also of those that gave none."""
    tried: dict[tuple[int, float], list[Trial]] = {observer: [] for observer in observers}
    for ridge in sorted({ridge for _, ridge in observers}):
        orders = tuple(sorted(p for p, other in observers if other == ridge))
        for trial in make_trials(ground, orders, ridge, model_orders, fold_indices):
            tried[trial.observer_order, ridge].append(trial)
    return tried


def search_limits(
    records: Sequence[Record], *, observer_order: int | None, ridge: float | None, model_order: int | None
) -> SearchLimits:
    """The grid that the records can carry: an observer needs several rows an unknown, and a Gram that fits a cache."""
    n_channels = records[0].n_inputs + records[0].n_outputs
    n_samples = sum(record.n_samples for record in records)
    if observer_order is not None:
        check_enough_rows(records, observer_order)
    largest = max(1, min(256, n_samples // (3 * n_channels), 1600 // n_channels))
    while largest > 1 and sum(max(0, record.n_samples - largest) for record in records) < LEAST_ROWS * n_samples:
        largest -= 1
    doubling = [p for p in OBSERVER_ORDERS if p <= largest]
    if largest >= 1.4 * doubling[-1]:
        doubling.append(largest)
    return SearchLimits(
        observer_orders=tuple(doubling) if observer_order is None else (observer_order,),
        ridges=RIDGES if ridge is None else (ridge,),
        model_orders=MODEL_ORDERS if model_order is None else (model_order,),
    )


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


def _nothing_stable(limits: SearchLimits) -> str:
    tried = (
        f"observer order {limits.observer_orders[0]}"
        if len(limits.observer_orders) == 1
        else f"observer orders 1 to {max(limits.observer_orders)}",
        f"ridge {limits.ridges[0]:g}" if len(limits.ridges) == 1 else "any ridge",
        f"model order {limits.model_orders[0]}" if len(limits.model_orders) == 1 else "any model order",
    )
    given = 1 in (len(limits.observer_orders), len(limits.ridges), len(limits.model_orders))
    remedy = (
        'leave observer_order, ridge and order at "auto", or add a ridge (1e-3)' if given else "give a longer record"
    )
    return f"no model from {', '.join(tried)} was stable on every fold of the data; {remedy}."


def _chosen(trials: Sequence[Trial]) -> Trial:
    """The smallest model order that is within 2 % of the best error and not significantly worse.

    Significant is one standard error of the differences from block to block (Breiman, Friedman, Olshen, Stone,
    Classification and Regression Trees, 1984, section 3.4.3): a weak mode that helps in every block is kept.
    """
    good = [trial for trial in trials if _as_good(trial, trials[0])]
    return min(good, key=lambda trial: (trial.model_order, trial.error))


def _as_good(trial: Trial, best: Trial) -> bool:
    worse = trial.block_errors - best.block_errors
    spread = float(np.sqrt(worse.size) * worse.std(ddof=1)) if worse.size > 1 else 0.0
    significantly = float(worse.sum()) > spread + ROUND_OFF
    return not significantly and trial.error <= WITHIN * best.error + ROUND_OFF**0.5
