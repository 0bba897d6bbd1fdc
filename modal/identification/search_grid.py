"""The candidates of the automatic choice: the coarse grid that the records can carry, and the neighbours of a trial."""

from collections.abc import Sequence
from dataclasses import dataclass

from modal.estimation.trials import Trial
from okid.record import Record
from okid.rows import check_enough_rows

__all__ = ["SearchLimits", "search_limits", "untried_neighbours"]

OBSERVER_ORDERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
RIDGES = (0.0, 1e-5, 1e-3, 1e-1)
MODEL_ORDERS = (*range(1, 13), 14, 16, 18, 20, 24, 28, 32, 36, 40, 48, 56, 64)
LEAST_ROWS = 0.75
"""Share of the samples that an observer order must leave as rows; a short record among long ones does not limit it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SearchLimits:
    """Candidates that may be tried; a single value is a choice that the caller made."""

    observer_orders: tuple[int, ...]
    ridges: tuple[float, ...]
    model_orders: tuple[int, ...]


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


def untried_neighbours(
    trials: Sequence[Trial], limits: SearchLimits, seen: set[tuple[int, float]], ratio: float
) -> list[tuple[int, float]]:
    """Observer orders half an octave and ridges a ratio around the best so far."""
    if not trials:
        return []
    best = min(trials, key=lambda trial: trial.error)
    orders, ridges = {best.observer_order}, {best.ridge}
    if len(limits.observer_orders) > 1:
        around = (round(best.observer_order / 1.4), round(best.observer_order * 1.4))
        orders |= {p for p in around if 1 <= p <= max(limits.observer_orders)}
    if len(limits.ridges) > 1 and best.ridge > 0.0:
        ridges |= {float(f"{ridge:.1g}") for ridge in (best.ridge / ratio, best.ridge * ratio) if ridge <= 1.0}
    return [(p, ridge) for p in sorted(orders) for ridge in sorted(ridges) if (p, ridge) not in seen]
