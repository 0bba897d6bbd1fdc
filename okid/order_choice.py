"""Observer order and ridge, chosen together by the free run on held-out rows.

On measured multi-output records the unregularised regression is nearly rank-deficient: its one-step error looks
perfect, yet the Markov parameters grow without bound. What tells is the error of the observer's own difference
equation, run freely over rows that it was not fitted to.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from okid.arrays import BoolArray, FloatArray
from okid.errors import InsufficientDataError
from okid.folds import interleaved_folds
from okid.free_run import FreeRuns, held_out_errors, prepare_free_runs
from okid.gram import LagGram, lag_gram
from okid.record import Record
from okid.regression import solve_nested
from okid.rows import runs_of
from okid.scaling import ChannelScaling

__all__ = ["ORDERS", "RIDGES", "ObserverChoice", "choose_observer"]

ORDERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
RIDGES = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 3e-2, 1e-1, 3e-1)

LEAST_ROWS = 0.25
"""Share of the lowest order's rows that gaps must leave an order for it to be tried."""
_AS_GOOD = 1.02
"""A lower order is taken when its squared error is within this factor of the least."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObserverChoice:
    """What was chosen, and on which evidence.

    Attributes:
        order: observer order.
        ridge: relative to the unit diagonal.
        orders: tried.
        ridges: tried.
        errors: (n_orders, n_ridges) held-out squared error over that of predicting the mean; infinite where it
            diverged.
    """

    order: int
    ridge: float
    orders: tuple[int, ...]
    ridges: tuple[float, ...]
    errors: FloatArray


def choose_observer(
    records: Sequence[Record],
    scaling: ChannelScaling,
    *,
    orders: Sequence[int] = ORDERS,
    ridges: Sequence[float] = RIDGES,
    n_folds: int = 3,
) -> ObserverChoice:
    """Score every order with every ridge by the free run on interleaved folds.

    Args:
        records: of one system.
        scaling: mean and size of every channel.
        orders: to try; those with more than half as many unknowns as training rows are left out, and those that
            missing samples leave less than a quarter of the lowest order's rows.
        ridges: to try.
        n_folds: number of folds.

    Returns:
        The least error; among orders that do as well within 2 %, the lowest.

    Raises:
        InsufficientDataError: no order can be fitted and scored, or every candidate diverges.
    """
    folds = interleaved_folds(records, n_folds=n_folds)
    tried = _feasible(records, orders)
    whole = lag_gram(records, tried[-1], scaling=scaling)
    runs = prepare_free_runs(records, scaling, tried[-1])
    if runs is None:
        raise InsufficientDataError(
            f"choosing an observer needs {tried[-1] + 1} consecutive samples without a gap, which no record has; "
            f"give the order and the ridge, or fill the gaps."
        )
    errors = np.zeros((len(tried), len(ridges)))
    energy = 0.0
    for held_out in folds:
        training = whole - lag_gram(records, tried[-1], scaling=scaling, rows=held_out)
        fold_errors, fold_energy = _score_fold(training, tried, ridges, runs, held_out)
        errors += fold_errors
        energy += fold_energy
    errors /= max(energy, np.finfo(np.float64).tiny)
    best = float(errors.min())
    if not np.isfinite(best):
        raise InsufficientDataError(
            f"the free run of every observer of order {tried[0]} to {tried[-1]} diverges on held-out rows; the inputs "
            "do not explain the outputs as a stable linear system. Check the channels, or give the order and the "
            "ridge."
        )
    row = int(np.flatnonzero(errors.min(axis=1) <= _AS_GOOD * best)[0])
    column = int(errors[row].argmin())
    errors.flags.writeable = False
    return ObserverChoice(
        order=tried[row], ridge=float(ridges[column]), orders=tried, ridges=tuple(ridges), errors=errors
    )


def _score_fold(
    training: LagGram, orders: Sequence[int], ridges: Sequence[float], runs: FreeRuns, held_out: Sequence[BoolArray]
) -> tuple[FloatArray, float]:
    errors, energy = np.empty((len(orders), len(ridges))), 0.0
    for column, ridge in enumerate(ridges):
        for row, observer in enumerate(solve_nested(training, orders, ridge)):
            errors[row, column], energy = held_out_errors(observer, runs, held_out)
    return errors, energy


def _feasible(records: Sequence[Record], orders: Sequence[int]) -> tuple[int, ...]:
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    longest = max(record.n_samples for record in records)
    runs = [stop - start for record in records for start, stop in runs_of(record.complete_rows())]

    def rows(order: int) -> int:
        return sum(max(0, length - order) for length in runs)

    # All orders are fitted to the rows of the largest: one that scattered gaps leave few rows would spoil the others.
    least = LEAST_ROWS * rows(min(orders))

    def feasible(order: int) -> bool:
        enough = 2 * (n_inputs + order * (n_inputs + n_outputs)) <= 0.7 * rows(order)
        return enough and 4 * order <= longest and rows(order) >= least

    tried = tuple(sorted({int(order) for order in orders if feasible(order)}))
    if not tried:
        total, n_complete = sum(record.n_samples for record in records), sum(runs)
        have = f"{total} samples" if n_complete == total else f"{n_complete} complete samples of {total}"
        raise InsufficientDataError(
            f"choosing an observer order needs twice as many training rows as unknowns, but {have} are too few even "
            f"for order {min(orders)} with {n_inputs} inputs and {n_outputs} outputs; give a longer record or fewer "
            "channels."
        )
    return tried
