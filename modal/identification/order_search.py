"""The automatic choice of observer order, ridge and model order, by what a free run makes of held-out rows.

One-step error cannot choose: on measured structures it looks perfect where the recovered Markov parameters diverge.
Each candidate (observer order, ridge) is fitted on the rows outside a fold, reduced to every model order by one SVD,
and run freely through the whole record; its squared error counts on the fold's rows only. Without inputs there is no
free run to score: the one-step prediction of the reduced model takes its place.

The search is coarse to fine. A scout looks at a coarse grid on one fold; the most promising candidates go on to all
folds; the neighbours of the best are scouted and, where they are promising too, go on as well, until no neighbour is
better (so a grid that ends too early extends). Model orders are coarse until two observers are left, and go on beyond
the grid as long as the largest one is by far the best.

Which trial is taken is decided here too, of those without refinement and of those with it
(`modal.identification.refined_search`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from modal.estimation.cross_validation import WITHIN, Folds, Ground, Trial, hankel_shape, make_trials, prepare_ground
from modal.preparation.steps import checked_parts
from okid.arrays import BoolArray, FloatArray, real_number, whole_number
from okid.display import Displayed
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record
from okid.rows import as_records, check_enough_rows

OBSERVER_ORDERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
RIDGES = (0.0, 1e-5, 1e-3, 1e-1)
MODEL_ORDERS = (*range(1, 13), 14, 16, 18, 20, 24, 28, 32, 36, 40, 48, 56, 64)
FURTHER_ORDERS = (72, 80, 92, 104, 120, 136, 156, 180, 206, 236, 270)
"""Try these, each 15 % more than the last, only where the largest order so far is by far the best: every second one
first."""
LEAST_ROWS = 0.75
"""Share of the samples that an observer order must leave as rows; a short record among long ones does not limit it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class SearchLimits(Displayed):
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


RIDGE_RATIOS = (10.0, 3.0, 3.0, 3.0)
"""Between the ridges of neighbours, in each round of the search."""
COARSE_MODEL_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 40)
SEMIFINALISTS = 9
"""Observers that a scout sends to a second fold."""
FINALISTS = 4
NEIGHBOURS = 2
"""Neighbours of the best that are run on all folds, of those that a scout finds better."""
NEAR = 1.1
"""Ratio to the best error of an observer from which on a coarse model order is not refined."""
SHORT = 4000
"""Samples up to which a fold is too short to scout alone, and all of them are cheap."""
ROUND_OFF = 1e-14
"""Relative squared errors below this are equal: noise-free data."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Search(Displayed):
    """Every trial on all folds, and the one that was chosen.

    Attributes:
        trials: on all folds, best first.
        chosen: the trial taken.
        power: (n_folds, n_outputs) squares of the held-out outputs about their mean, scaled channels.
        limits: what was allowed.
        ground: what the trials were fitted to and scored on, for a caller who goes on with what is computed there.
    """

    trials: tuple[Trial, ...]
    chosen: Trial
    power: FloatArray
    limits: SearchLimits
    ground: Ground


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OrderChoice(Displayed):
    """The orders by which records are fitted, and on which evidence.

    Attributes:
        observer_order: for `okid.fit_observer`.
        ridge: for `okid.fit_observer`.
        n_lags: for `okid.recover_markov`: as many as the candidates were realised from.
        order: number of states, for `era.realise`.
        evidence: every trial that was scored on all folds.
    """

    observer_order: int
    ridge: float
    n_lags: int
    order: int
    evidence: Search

    def __repr__(self) -> str:
        return (
            f"OrderChoice(observer_order={self.observer_order}, ridge={self.ridge:.3g}, n_lags={self.n_lags}, "
            f"order={self.order}, best of {len(self.evidence.trials)} models)"
        )


def choose_orders(
    records: Record | Sequence[Record],
    *,
    observer_order: int | Literal["auto"] = "auto",
    ridge: float | Literal["auto"] = "auto",
    order: int | Literal["auto"] = "auto",
    folds: Folds = "blocks",
    measured: Sequence[BoolArray] = (),
    progress: Callable[[float], None] = lambda _: None,
) -> OrderChoice:
    """Choose observer order, ridge and model order together, by the error of a free run on held-out rows.

    This is the choice that `modal.identify` makes of the records as it has prepared them, before it refines.

    Args:
        records: one `Record` or several of one system; where an input is missing, what follows starts a record.
        observer_order: number of past samples that the observer uses, or "auto".
        ridge: relative to the unit diagonal of the Gram matrix of the scaled channels, or "auto".
        order: number of states, or "auto".
        folds: "blocks" of rows are held out, or every third of the "rows" (where a few blows drive the records).
        measured: (n_samples, n_outputs) a record, False where a sample was filled, which scores nothing.
        progress: called with the share done.

    Raises:
        InvalidDataError: records that do not belong together, `measured` of other shapes, or an argument outside its
            range.
        InsufficientDataError: a channel that never moves, records that are too short, or no stable candidate.

    Example:
        >>> import numpy as np, era, okid
        >>> rng = np.random.default_rng(0)
        >>> force = rng.standard_normal(1000)
        >>> tip = np.convolve(force, 0.9 ** np.arange(100))[:1000]
        >>> record = Record(force, tip + 0.01 * rng.standard_normal(1000), 0.01)
        >>> choice = choose_orders(record)
        >>> observer = okid.fit_observer(record, order=choice.observer_order, ridge=choice.ridge)
        >>> model = era.realise(okid.recover_markov(observer, n_lags=choice.n_lags), order=choice.order)
        >>> model.A.round(3).ravel().tolist()
        [0.9]
    """
    given = given_orders(observer_order, ridge, order)
    parts = checked_parts(as_records(records))
    if measured and [one.outputs.shape for one in parts] != [own.shape for own in measured]:
        raise InvalidDataError(
            f"measured must say of each output sample of each record whether it was measured, {len(parts)} arrays of "
            f"{', '.join(str(one.outputs.shape) for one in parts)}, but holds {len(measured)} of "
            f"{', '.join(str(own.shape) for own in measured)}; give them in the order of the records, whose inputs "
            "must not be missing."
        )
    found = search(
        parts,
        observer_order=given[0],
        ridge=given[1],
        model_order=given[2],
        folds=folds,
        measured=measured,
        progress=progress,
    )
    return OrderChoice(
        observer_order=found.chosen.observer_order,
        ridge=found.chosen.ridge,
        n_lags=found.ground.n_lags,
        order=found.chosen.model_order,
        evidence=found,
    )


def given_orders(
    observer_order: int | Literal["auto"], ridge: float | Literal["auto"], order: int | Literal["auto"]
) -> tuple[int | None, float | None, int | None]:
    """The three as numbers, None for "auto".

    Raises:
        InvalidDataError: one outside its range.
    """
    if ridge != "auto" and not 0.0 <= real_number(ridge) < float("inf"):
        raise InvalidDataError(f'ridge must be "auto" or a number of at least 0, but is {ridge!r}.')
    return (
        _whole_or_none(observer_order, "observer_order"),
        None if ridge == "auto" else float(ridge),
        _whole_or_none(order, "order"),
    )


def _whole_or_none(value: int | Literal["auto"], name: str) -> int | None:
    return None if value == "auto" else whole_number(value, name=name, least=1, otherwise='or "auto"')


def search(
    records: Sequence[Record],
    *,
    observer_order: int | None = None,
    ridge: float | None = None,
    model_order: int | None = None,
    folds: Folds = "blocks",
    measured: Sequence[BoolArray] = (),
    progress: Callable[[float], None] = lambda _: None,
) -> Search:
    """Choose observer order, ridge and model order together; a given one is kept.

    Args:
        records: of one system, no input missing.
        observer_order: the caller's choice, None to choose.
        ridge: likewise.
        model_order: likewise.
        folds: which rows are held out.
        measured: as for `choose_orders`.
        progress: called with the share done.

    Raises:
        InsufficientDataError: the records are too short for the observer order that was given, or no candidate gave a
            stable model.
    """
    limits = search_limits(records, observer_order=observer_order, ridge=ridge, model_order=model_order)
    ground = prepare_ground(records, folds, measured=measured)
    if model_order is not None:
        _check_model_order(model_order, ground)
    every_fold = tuple(range(len(ground.folds)))
    n_samples = sum(record.n_samples for record in records)
    scouted = every_fold if n_samples <= SHORT else every_fold[:1]
    coarse = tuple(n for n in limits.model_orders if n in COARSE_MODEL_ORDERS) or limits.model_orders
    scout: list[Trial] = []
    for i, candidate in enumerate(limits.ridges):
        scout += make_trials(ground, limits.observer_orders, candidate, coarse, scouted)
        progress(0.5 * (i + 1) / len(limits.ridges))
    semifinal = scouted if scouted == every_fold else every_fold[:2]
    if semifinal != scouted:
        scout = _trials(ground, _best_observers(scout, SEMIFINALISTS), coarse, semifinal)
    finer = limits.model_orders
    if model_order is None and records[0].n_inputs:  # without inputs the innovation form has its own
        coarse, scout = _with_larger(ground, coarse, scout, semifinal)
        finer += tuple(n for n in FURTHER_ORDERS if n < coarse[-1])
    tried = _finals(ground, scout, coarse, every_fold)
    seen = {(p, ridge) for p in limits.observer_orders for ridge in limits.ridges}
    for i, ratio in enumerate(RIDGE_RATIOS):
        progress(0.5 + 0.4 * (i + 1) / len(RIDGE_RATIOS))
        around = untried_neighbours(tried, limits, seen, ratio)
        if not around:
            break
        seen |= set(around)
        tried += _neighbours(ground, around, min(tried, key=_by_error), coarse, (scouted, every_fold))
    if not tried:
        raise InsufficientDataError(_nothing_stable(limits))
    for observer in _best_observers(tried, 2):
        own = _trials(ground, [observer], coarse, every_fold)
        own += _trials(ground, [observer], _worth_trying(own, finer), every_fold)
        tried = [trial for trial in tried if (trial.observer_order, trial.ridge) != observer] + own
    progress(1.0)
    tried.sort(key=_by_error)
    return Search(trials=tuple(tried), chosen=_chosen(tried), power=ground.power, limits=limits, ground=ground)


def _by_error(trial: Trial) -> tuple[float, int]:
    return trial.error, trial.model_order


def _check_model_order(model_order: int, ground: Ground) -> None:
    first = ground.records[0]
    largest = min(hankel_shape(ground.n_lags, first.n_inputs, first.n_outputs))
    if model_order > largest:
        raise InsufficientDataError(
            f"model order {model_order} was asked for, but the block Hankel matrix of {ground.n_lags} lags allows at "
            f"most {largest}; use order <= {largest}."
        )


def _trials(
    ground: Ground,
    observers: Sequence[tuple[int, float]],
    model_orders: Sequence[int],
    fold_indices: Sequence[int],
) -> list[Trial]:
    return [trial for p, ridge in observers for trial in make_trials(ground, [p], ridge, model_orders, fold_indices)]


def _with_larger(
    ground: Ground, coarse: tuple[int, ...], scout: list[Trial], folds: Sequence[int]
) -> tuple[tuple[int, ...], list[Trial]]:
    """Coarse orders and their trials, with larger ones of the best observers as long as the largest is by far the best.

    By more than two models may differ that count as equal: of noise, and of what no model explains, more states explain
    a little more at every size.
    """
    first = ground.records[0]
    most = min(hankel_shape(ground.n_lags, first.n_inputs, first.n_outputs))
    for n in (MODEL_ORDERS[-1], *FURTHER_ORDERS[1::2]):
        largest = [trial.error for trial in scout if trial.model_order == coarse[-1]]
        smaller = [trial.error for trial in scout if trial.model_order < coarse[-1]]
        if n > most or not largest or WITHIN * min(largest) + ROUND_OFF**0.5 >= min(smaller, default=np.inf):
            break
        coarse = (*coarse, n)
        scout = scout + _trials(ground, _best_observers(scout, SEMIFINALISTS), [n], folds)
    return coarse, scout


def _finals(
    ground: Ground, scout: Sequence[Trial], model_orders: Sequence[int], every_fold: Sequence[int]
) -> list[Trial]:
    """Trials, on every fold, of the best `FINALISTS` observers that are stable on all of them, and of one more.

    That one gave the smallest of the models as good as the best: where many observers do equally well, chance ranks
    them.
    """
    least = min((trial.error for trial in scout), default=0.0)
    good = [trial for trial in scout if trial.error <= WITHIN * least + ROUND_OFF**0.5]
    good.sort(key=lambda trial: (trial.model_order, trial.observer_order, trial.error))
    by_size = list(dict.fromkeys((trial.observer_order, trial.ridge) for trial in good))
    smallest = _first_stable(ground, by_size, 1, model_orders, every_fold)
    taken = {(trial.observer_order, trial.ridge) for trial in smallest}
    others = [observer for observer in _best_observers(scout, len(scout)) if observer not in taken]
    return smallest + _first_stable(ground, others, FINALISTS, model_orders, every_fold)


def _first_stable(
    ground: Ground,
    ranked: Sequence[tuple[int, float]],
    count: int,
    model_orders: Sequence[int],
    every_fold: Sequence[int],
) -> list[Trial]:
    """Trials of the first so many observers that are stable on every fold."""
    found: list[Trial] = []
    for observer in ranked:
        own = _trials(ground, [observer], model_orders, every_fold)
        found += own
        count -= bool(own)
        if count == 0:
            break
    return found


def _neighbours(
    ground: Ground,
    around: Sequence[tuple[int, float]],
    best: Trial,
    coarse: Sequence[int],
    folds: tuple[Sequence[int], Sequence[int]],
) -> list[Trial]:
    """Trials, on every fold, of the neighbours that a scout finds better than the best so far.

    Args:
        ground: of all trials.
        around: (observer order, ridge) of the neighbours.
        best: trial so far; the model orders next to its own are run.
        coarse: model orders.
        folds: those of the scout, and all.
    """
    scouted, every_fold = folds
    place = int(np.searchsorted(coarse, best.model_order))
    near = coarse[max(0, place - 1) : place + 2]
    (mark,) = make_trials(ground, [best.observer_order], best.ridge, [best.model_order], scouted)
    scout = _trials(ground, around, near, scouted)
    promising = _best_observers([trial for trial in scout if trial.error <= WITHIN * mark.error], NEIGHBOURS)
    return _trials(ground, promising, near, every_fold)


def _worth_trying(trials: Sequence[Trial], model_orders: Sequence[int]) -> list[int]:
    """Model orders not tried yet between the coarse ones that frame all that come near the best of one observer."""
    best = min(trials, key=_by_error)
    near = [trial.model_order for trial in trials if trial.error <= NEAR * best.error + ROUND_OFF**0.5]
    below = max((trial.model_order for trial in trials if trial.model_order < min(near)), default=0)
    above = min((trial.model_order for trial in trials if trial.model_order > best.model_order), default=np.inf)
    done = {trial.model_order for trial in trials}
    return [n for n in model_orders if below < n < above and n not in done]


def _best_observers(trials: Sequence[Trial], count: int) -> list[tuple[int, float]]:
    """The (observer order, ridge) pairs whose best trial is best."""
    best: dict[tuple[int, float], float] = {}
    for trial in trials:
        key = (trial.observer_order, trial.ridge)
        best[key] = min(best.get(key, np.inf), trial.error)
    return sorted(best, key=lambda key: best[key])[:count]


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
    good = [trial for trial in trials if as_good(trial, trials[0])]
    return min(good, key=lambda trial: (trial.model_order, trial.error))


def as_good(trial: Trial, best: Trial) -> bool:
    """Within 2 % of the best, and not significantly worse."""
    return not significantly_worse(trial, best) and trial.error <= WITHIN * best.error + ROUND_OFF**0.5


def significantly_worse(trial: Trial, other: Trial) -> bool:
    """By more than one standard error of the differences from block to block."""
    worse = trial.block_errors - other.block_errors
    spread = float(np.sqrt(worse.size) * worse.std(ddof=1)) if worse.size > 1 else 0.0
    return float(worse.sum()) > spread + ROUND_OFF


MOST_STEPS = 8
"""Steps after which nearly all refinements stand still; a trial with so many means: until it stands still."""


def chosen_refined(trials: Sequence[Trial], share: Callable[[int], float] = lambda _order: 0.0) -> Trial:
    """The smallest order that is as good as the best; of its refinements the longest that is as good as its best.

    A refinement that may run until it stands still without harm has no early stop to be explained, and its covariance
    is that of the least-squares estimate. No other estimate beats it by more than estimating costs it, so a smaller
    loss on held-out rows is chance and says nothing against it.

    Args:
        trials: by rising error.
        share: of the squared error that estimating a model of an order adds.
    """
    good = [trial for trial in trials if as_good(trial, trials[0])]
    smallest = min(trial.model_order for trial in good)
    best = next(trial for trial in good if trial.model_order == smallest)
    most = best.error * np.sqrt(1.0 + share(smallest))
    whole = [trial for trial in trials if trial.model_order == smallest and trial.refinement_steps == MOST_STEPS]
    longer = [
        trial
        for trial in whole
        if (trial.observer_order, trial.ridge) == (best.observer_order, best.ridge)
        and as_good(trial, best)
        and trial in good
    ]
    longer += [trial for trial in whole if trial.error <= most]
    return longer[0] if longer else best


def estimation_share(ground: Ground, order: int) -> float:
    """Share of the squared error that estimating adds: numbers of a model of this order over values of a fold."""
    n_inputs, n_outputs = ground.scaled[0].n_inputs, ground.scaled[0].n_outputs
    values = n_outputs * sum(int(rows.sum()) for fold in ground.trained for rows in fold) / len(ground.trained)
    return (order * (n_inputs + n_outputs) + n_inputs * n_outputs) / max(1.0, values)
