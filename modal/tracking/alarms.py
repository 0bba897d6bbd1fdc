"""Did the structure change? Steps of all modes together that neither the causes nor chance explain.

The records are summed up in blocks (a day each, longer ones where neighbours still resemble each other), so that what
is left in one block says nothing of the next. In each mode the regression on the causes is fitted with a step
at a time tau; the steps of all modes together are tested by Hotelling's T^2 = t' R^-1 t, as two results are
(`modal.comparison`), with t the steps over their deviations and R the correlation of what is left between modes. The
time of the largest T^2 is a change if chance makes one so large nowhere in the table (Bonferroni over all tau) with the
level of the table; it is fitted with the rest, and the next is looked for. The alarm stands where the change was beyond
chance for the first time: at the end of the first block that the blocks since the change suffice for.

The regression: ln f of each mode is a level and a polynomial of each cause as the structure feels it, part at once,
part through a body that follows within hours or days (an exponential mean). Part, time constant and degree are one
choice for all modes: that of the least error on months that were not fitted to, and of the degrees that these cannot
tell from the best one the largest. A term too few leaves a bend that looks like a step; one too many only widens the
deviations of the steps.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Final

import numpy as np

from modal.comparison.shifts import chance_together
from okid.arrays import ROUNDED, BoolArray, FloatArray
from okid.readers.clock import DAY, HOUR


class Causes:
    """What is tried of a cause that a frequency follows."""

    DEGREES: Final = (0, 1, 2, 3, 4)
    """Try polynomials of a cause up to this degree; 0 leaves the cause out."""
    TIME_CONSTANTS: Final = tuple(float(HOUR * hours) for hours in (3, 6, 12, 24, 48, 96))
    """Try these [s] for the body that follows slowly, from a thin deck to a massive pier,"""
    SLOW_PARTS: Final = (0.25, 0.5, 0.75, 1.0)
    """and these parts of the cause that are felt through it."""
    FIRST_DEGREE: Final = 3
    """Choose part and time constant with this degree, then the degree."""


USUAL = 1.4826
"""Standard deviation over the median of the size, of normal errors."""
MONTH = 30.44 * DAY
FEWEST_FOLDS = 5
FEWEST_A_TERM = 2
"""Fit terms to a mode that was found in so many records for each of them; to others none."""
ROUNDS = 2
"""Choose each cause's terms anew, given those of the others, so many times."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Environment:
    """The terms of the regression.

    Attributes:
        terms: (n_records, n_terms), without the level.
        names: what they are, for a reader.
        explained: (n_modes,) share of the variance of ln f that they explain on held-out months; nan without terms.
    """

    terms: FloatArray
    names: tuple[str, ...]
    explained: FloatArray


def held_out_months(times: FloatArray, *, clock: bool) -> np.ndarray:
    """(n_records,) number of the fold: a month, or a fifth of a shorter table."""
    span = float(np.ptp(times)) or 1.0
    n_folds = max(FEWEST_FOLDS, round(span / MONTH)) if clock else FEWEST_FOLDS
    folds: np.ndarray = np.minimum(
        (n_folds * (times - times[0]) / (span * (1.0 + ROUNDED))).astype(np.intp), n_folds - 1
    )
    return folds


def explain(values: FloatArray, causes: Mapping[str, FloatArray], times: FloatArray, *, clock: bool) -> Environment:
    """Choose the terms for all modes together.

    Args:
        values: (n_records, n_modes) ln f, nan where a mode was not found.
        causes: by name, (n_records,) each.
        times: (n_records,) rising.
        clock: times are seconds: only then can a body be slow.
    """
    folds = held_out_months(times, clock=clock)
    compared = _fitted_by_all(values, n_causes=len(causes))
    chosen = dict.fromkeys(causes, _Felt())
    for _ in range(ROUNDS if len(causes) > 1 else 1):
        for name in causes:

            def errors(felt: _Felt, name: str = name) -> FloatArray:
                return _held_out_errors(compared, _terms(causes, {**chosen, name: felt}, times)[0], folds)

            slow = [
                _Felt(Causes.FIRST_DEGREE, part, tau)
                for part, tau in product(Causes.SLOW_PARTS, Causes.TIME_CONSTANTS)
                if clock
            ]
            forms = [_Felt(Causes.FIRST_DEGREE), *slow]
            of_forms = [errors(felt) for felt in forms]
            best = forms[int(np.argmin([np.nansum(own) for own in of_forms]))]
            of_degrees = [errors(replace(best, degree=n)) for n in Causes.DEGREES]
            chosen[name] = replace(best, degree=_degree(of_degrees, forms=of_forms))
    terms, names = _terms(causes, chosen, times)
    alone = _held_out_errors(values, terms[:, :0], folds).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        explained = 1.0 - _held_out_errors(values, terms, folds).sum(axis=0) / alone
    return Environment(terms=terms, names=names, explained=explained if names else np.full(values.shape[1], np.nan))


@dataclass(frozen=True, slots=True)
class _Felt:
    """How a cause is felt: degree of the polynomial, part that is felt slowly, time constant [s]."""

    degree: int = 0
    part: float = 0.0
    constant: float = 0.0


def _terms(
    causes: Mapping[str, FloatArray], chosen: Mapping[str, _Felt], times: FloatArray
) -> tuple[FloatArray, tuple[str, ...]]:
    columns, names = [np.empty((times.size, 0))], []
    for name, cause in causes.items():
        felt = chosen[name]
        if not felt.degree:
            continue
        slow = _followed_slowly(cause, times, felt.constant) if felt.part else cause
        columns.append(_polynomials((1.0 - felt.part) * cause + felt.part * slow, felt.degree))
        how = [f"polynomial of degree {felt.degree}"] * (felt.degree > 1)
        how += [f"{100 * felt.part:.0f} % felt within {felt.constant / HOUR:.0f} h"] * (felt.part > 0)
        names.append(f"{name} ({', '.join(how)})" if how else name)
    return np.hstack(columns), tuple(names)


def _polynomials(cause: FloatArray, degree: int) -> FloatArray:
    low, high = float(cause.min()), float(cause.max())
    place = 2.0 * (cause - low) / (high - low) - 1.0 if high > low else np.zeros(cause.size)
    return np.asarray(np.polynomial.legendre.legvander(place, degree)[:, 1:], dtype=np.float64)


def _followed_slowly(cause: FloatArray, times: FloatArray, constant: float) -> FloatArray:
    """Exponential mean of the past, whatever the steps of the time."""
    slow = np.empty(cause.size)
    slow[0] = state = float(cause[0])
    keep = np.exp(-np.diff(times) / constant).tolist()
    for k, (share, value) in enumerate(zip(keep, cause[1:].tolist(), strict=True), start=1):
        slow[k] = state = share * state + (1.0 - share) * value
    return slow


def _fitted_by_all(values: FloatArray, *, n_causes: int) -> FloatArray:
    """(n_records, n_compared) of the modes that move, and were found often enough for the most terms that are tried.

    A mode that only few terms can be fitted to would make many look better, by no error of its own where they are.
    """
    n_found = (~np.isnan(values)).sum(axis=0)
    found = values[:, n_found >= FEWEST_A_TERM * (1 + max(Causes.DEGREES) * n_causes)]
    return np.asarray(found[:, np.nanmax(found, axis=0) > np.nanmin(found, axis=0)], dtype=np.float64)


def _degree(errors: Sequence[FloatArray], *, forms: Sequence[FloatArray]) -> int:
    """The largest degree that held-out months cannot tell from the best one; 0 where they cannot tell it from none.

    What nothing has to do with the modes lowers the error of held-out months by chance, too, and takes with it a part
    of every change that it resembles. The more forms are tried, the lower is the least error: against none each month
    is foretold by the form that the other months choose, so that none is chosen by what it is judged on.

    Args:
        errors: of each degree from 0, (n_folds, n_modes).
        forms: likewise, of each part and time constant.
    """
    best = int(np.argmin([np.nansum(own) for own in errors]))
    size = errors[best].sum(axis=0)  # each mode against what is left of it: weak terms show in the surest modes

    def alike(first: FloatArray, second: FloatArray) -> bool:
        """Not larger by the deviation of the sum."""
        worse = np.nansum((first - second) / size, axis=1)
        return bool(worse.sum() < math.sqrt(worse.size) * worse.std(ddof=1))

    if not best or alike(errors[0], _chosen_by_others([*errors[1:], *forms])):
        return 0
    return next((degree for degree in range(len(errors) - 1, best, -1) if alike(errors[degree], errors[best])), best)


def _chosen_by_others(tried: Sequence[FloatArray]) -> FloatArray:
    """(n_folds, n_modes) errors on each fold of that which is best on the others."""
    every = np.array(tried)
    of_folds = np.nansum(every, axis=2)
    others = of_folds.sum(axis=1, keepdims=True) - of_folds
    best: FloatArray = every[others.argmin(axis=0), np.arange(every.shape[1])]
    return best


def _held_out_errors(values: FloatArray, terms: FloatArray, folds: np.ndarray) -> FloatArray:
    """(n_folds, n_modes) squared errors on each held-out month, as shares of the sum of squares of the mode."""
    design = np.hstack([np.ones((terms.shape[0], 1)), terms])
    edges = np.append(np.flatnonzero(np.diff(folds, prepend=-1)), folds.size)
    errors = np.full((edges.size - 1, values.shape[1]), np.nan)
    for mode, column in enumerate(values.T):
        there = ~np.isnan(column)
        if there.sum() < FEWEST_A_TERM * design.shape[1]:
            continue
        y = np.where(there, column - column[there].mean(), 0.0)
        whole = np.column_stack([design * there[:, np.newaxis], y])
        grams = np.array([whole[first:last].T @ whole[first:last] for first, last in pairwise(edges)])
        size = max(float(y @ y), np.finfo(np.float64).tiny)
        for fold, (own, rest) in enumerate(zip(grams, grams.sum(axis=0) - grams, strict=True)):
            coefficients = np.linalg.lstsq(rest[:-1, :-1], rest[:-1, -1], rcond=1e-12)[0]
            change = np.append(-coefficients, 1.0)
            errors[fold, mode] = float(change @ own @ change) / size
    return errors


LEVEL = 0.0025
"""Raise a false alarm with at most this chance a month: one in 400 quiet months."""


class Blocks:
    """How records are summed up in blocks, and changes sought between them."""

    FEWEST_DAYS: Final = 20
    FEWEST_BLOCKS: Final = 20
    """Sum records up in blocks of a day where there are so many days, and never in fewer blocks than this."""
    MOST_CHANGES: Final = 12
    EDGE: Final = 7
    """Look for a change with at least so many blocks on either side: a week, longer than most weather."""


ALIKE = 1.645
"""Take blocks as alike beyond chance where their correlation is above this over sqrt(n): the 5 % quantile."""
NEIGHBOURS = 12
"""Compare a frequency with so many on either side to see that it is none of the mode,"""
OUTLIER = 5.0
"""and leave it out where it is so many deviations away."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LevelChange:
    """A step of the modes that is beyond chance.

    Attributes:
        since: index of the first record after it.
        noticed: index of the record with which it was beyond chance.
        steps: (n_modes,) of ln f; nan where a mode says nothing.
        deviations: (n_modes,) of the steps.
        p_value: over all times of the table.
    """

    since: int
    noticed: int
    steps: FloatArray
    deviations: FloatArray
    p_value: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Blocks:
    """Sums over blocks of records.

    Attributes:
        first: (n_blocks + 1,) first record of each, one past the last at the end.
        counts: (n_blocks, n_modes) records in which the mode was found.
        means: (n_blocks, n_modes) of ln f.
        terms: (n_modes, n_blocks, n_terms) of the regression, over the records that have the mode; level first.
    """

    first: np.ndarray
    counts: FloatArray
    means: FloatArray
    terms: FloatArray


def find_changes(
    values: FloatArray, terms: FloatArray, times: FloatArray, *, clock: bool
) -> tuple[tuple[LevelChange, ...], FloatArray]:
    """Every step beyond chance, by time, none where there are too few records to tell; and what is left.

    That is (n_records, n_modes) ln f less the terms and the first level, all of the one fit that gives the steps.

    Args:
        values: (n_records, n_modes) ln f, nan where a mode was not found.
        terms: (n_records, n_terms) of the regression, without the level.
        times: (n_records,) rising.
        clock: times are seconds; else they count records, and the table stands for a month.
    """
    months = max(1.0, float(np.ptp(times)) / MONTH) if clock else 1.0
    level = LEVEL * months
    kept = np.where(_outliers(values), np.nan, values)
    edges = _edges(times, clock=clock)
    blocks, changes = _summed(kept, terms, np.arange(times.size + 1)), list[LevelChange]()
    while edges.size > Blocks.FEWEST_BLOCKS:
        blocks = _summed(kept, terms, edges)
        changes = _changes(blocks, level)
        if edges.size <= 2 * Blocks.FEWEST_BLOCKS or not _alike(_left(blocks, changes)):
            break
        edges = np.append(edges[:-1:2], edges[-1])
    return tuple(sorted(changes, key=lambda change: change.since)), _off_the_fit(values, terms, blocks, changes)


def _off_the_fit(values: FloatArray, terms: FloatArray, blocks: _Blocks, changes: Sequence[LevelChange]) -> FloatArray:
    first, n_blocks = blocks.first, blocks.first.size - 1
    steps = [_after(blocks, int(np.searchsorted(first, change.since)), n_blocks) for change in changes]
    left = values.copy()
    for mode, (counts, means, own) in enumerate(zip(blocks.counts.T, blocks.means.T, blocks.terms, strict=True)):
        there = counts > 0.0
        weights, level = np.sqrt(counts[there]), means[there].mean()
        design = np.column_stack([own, *steps])[there] * weights[:, np.newaxis]
        fitted = np.linalg.lstsq(design, weights * (means[there] - level), rcond=1e-10)[0]
        left[:, mode] -= level + fitted[0] + terms @ fitted[1 : own.shape[1]]
    return left


def enough_records(times: FloatArray, *, clock: bool) -> bool:
    """Whether there are so many records that `find_changes` could have told a change."""
    return bool(_edges(times, clock=clock).size > Blocks.FEWEST_BLOCKS)


def _outliers(values: FloatArray) -> BoolArray:
    """Frequencies far from those before and after: a jump that stays is none."""
    far = np.zeros(values.shape, dtype=np.bool_)
    for mode, column in enumerate(values.T):
        there = np.flatnonzero(~np.isnan(column))
        if there.size <= 2 * NEIGHBOURS + 1:
            continue
        padded = np.pad(column[there], NEIGHBOURS, mode="reflect")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
        away = np.abs(column[there] - np.median(windows, axis=1))
        far[there[away > OUTLIER * USUAL * np.median(away)], mode] = True
    return far


def _edges(times: FloatArray, *, clock: bool) -> np.ndarray:
    """First record of each block, and one past the last."""
    span = float(np.ptp(times))
    if clock and span >= Blocks.FEWEST_DAYS * DAY:
        day = np.floor((times - times[0]) / DAY).astype(np.intp)
        return np.append(np.unique(day, return_index=True)[1], times.size)
    n_blocks = min(2 * Blocks.FEWEST_BLOCKS, times.size // 2)
    return np.unique(np.linspace(0, times.size, n_blocks + 1).round().astype(np.intp))


def _summed(values: FloatArray, terms: FloatArray, edges: np.ndarray) -> _Blocks:
    there = ~np.isnan(values)
    design = np.hstack([np.ones((terms.shape[0], 1)), terms])
    counts = np.add.reduceat(there.astype(np.float64), edges[:-1], axis=0)
    safe = np.maximum(counts, 1.0)
    means = np.add.reduceat(np.where(there, values, 0.0), edges[:-1], axis=0) / safe
    return _Blocks(
        first=edges,
        counts=counts,
        means=means,
        terms=np.array(
            [
                np.add.reduceat(design * own[:, np.newaxis], edges[:-1], axis=0) / safe[:, [mode]]
                for mode, own in enumerate(there.T)
            ]
        ),
    )


def _changes(blocks: _Blocks, level: float) -> list[LevelChange]:
    """Steps beyond chance, the surest first."""
    found: list[tuple[int, float]] = []
    while len(found) < Blocks.MOST_CHANGES:
        taus, statistics = _scan(blocks, [tau for tau, _ in found])
        if not taus.size:
            break
        best = int(np.nanargmin(statistics))
        p_value = min(1.0, float(statistics[best]) * taus.size)
        if not p_value < level:
            break
        found.append((int(taus[best]), p_value))
    taus_found = sorted(tau for tau, _ in found)
    n_taus = blocks.first.size - 2 * Blocks.EDGE
    changes = []
    for tau, p_value in found:
        others = [other for other in taus_found if other != tau]
        steps, deviations, _, _ = _steps(_cleared(blocks, others), _after(blocks, tau, blocks.first.size - 1))
        until = min([other for other in others if other > tau], default=blocks.first.size - 1)
        noticed = next(
            (
                end
                for end in range(tau + 1, until)
                if _joint(_cleared(blocks, [*others, end]), _after(blocks, tau, end)) * n_taus < level
            ),
            until,
        )
        changes.append(
            LevelChange(
                since=int(blocks.first[tau]),
                noticed=int(blocks.first[noticed]) - 1,
                steps=steps,
                deviations=deviations,
                p_value=p_value,
            )
        )
    return changes


def _after(blocks: _Blocks, first: int, last: int) -> FloatArray:
    """(n_blocks,) 1 from a block on, 0 again from another one on."""
    step = np.zeros(blocks.first.size - 1)
    step[first:last] = 1.0
    return step


def _scan(blocks: _Blocks, known: Sequence[int]) -> tuple[np.ndarray, FloatArray]:
    """Places where another step may stand, and the chance of one so large at each."""
    n_blocks = blocks.first.size - 1
    taken = np.array(known, dtype=np.intp)
    taus = np.array(
        [
            tau
            for tau in range(Blocks.EDGE, n_blocks - Blocks.EDGE + 1)
            if not (np.abs(taken - tau) < Blocks.EDGE).any()
        ],
        dtype=np.intp,
    )
    cleared = _cleared(blocks, known)
    return taus, np.array([_joint(cleared, _after(blocks, int(tau), n_blocks)) for tau in taus])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Cleared:
    """One mode in the blocks that have it, level, causes and known steps taken off.

    Attributes:
        there: (n_blocks,) blocks that have it.
        weights: (n_there,) root of the number of records.
        basis: (n_there, n_basis) orthonormal columns of what was taken off.
        left: (n_there,) of the weighted means.
    """

    there: BoolArray
    weights: FloatArray
    basis: FloatArray
    left: FloatArray


def _cleared(blocks: _Blocks, known: Sequence[int]) -> list[_Cleared]:
    n_blocks = blocks.first.size - 1
    others = np.array([_after(blocks, tau, n_blocks) for tau in known]).reshape(len(known), n_blocks).T
    cleared = []
    for counts, means, terms in zip(blocks.counts.T, blocks.means.T, blocks.terms, strict=True):
        there = counts > 0.0
        weights = np.sqrt(counts[there])
        basis = _orthonormal(weights[:, np.newaxis] * np.hstack([terms[there], others[there]]))
        y = weights * (means[there] - (means[there].mean() if there.any() else 0.0))
        cleared.append(_Cleared(there=there, weights=weights, basis=basis, left=y - basis @ (basis.T @ y)))
    return cleared


def _joint(cleared: Sequence[_Cleared], step: FloatArray) -> float:
    """Chance of steps so large in all modes together."""
    steps, deviations, left, freedom = _steps(cleared, step)
    told = np.flatnonzero(np.isfinite(deviations))
    if not told.size:
        return 1.0
    least = float(freedom[told].min())
    told = told[: max(1, int(least) - 1)]
    t = steps[told] / deviations[told]
    filled = np.nan_to_num(left[:, told])
    size = np.linalg.norm(filled, axis=0)
    correlation = filled.T @ filled / np.outer(size, size)
    return chance_together(t, correlation, least)


def _steps(cleared: Sequence[_Cleared], step: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of each mode: its step, the deviation of it, (n_blocks, n_modes) what is left in weighted blocks, its freedom."""
    steps, deviations = np.full(len(cleared), np.nan), np.full(len(cleared), np.nan)
    left, freedom = np.full((step.size, len(cleared)), np.nan), np.zeros(len(cleared))
    for mode, one in enumerate(cleared):
        s = one.weights * step[one.there]
        s_left = s - one.basis @ (one.basis.T @ s)
        power = float(s_left @ s_left)
        free = s.size - one.basis.shape[1] - 1
        if free < 2 or power <= ROUNDED * float(s @ s):
            continue
        steps[mode] = float(s_left @ one.left) / power
        rest = one.left - steps[mode] * s_left
        deviations[mode] = math.sqrt(float(rest @ rest) / free / power) or np.nan
        left[one.there, mode], freedom[mode] = rest, free
    return steps, deviations, left, freedom


def _orthonormal(design: FloatArray) -> FloatArray:
    if not design.shape[0]:
        return design[:, :0]
    size = np.linalg.norm(design, axis=0)
    u, values, _ = np.linalg.svd(design / np.where(size > 0.0, size, 1.0), full_matrices=False)
    kept: FloatArray = u[:, values > 1e-10 * values[0]]
    return kept


def _left(blocks: _Blocks, changes: Sequence[LevelChange]) -> FloatArray:
    """What is left in blocks by the changes and by the largest step besides them, which may be one or chance."""
    known = [int(np.searchsorted(blocks.first, change.since)) for change in changes]
    taus, statistics = _scan(blocks, known)
    tau = int(taus[np.argmin(statistics)]) if taus.size else blocks.first.size // 2
    return _steps(_cleared(blocks, known), _after(blocks, tau, blocks.first.size - 1))[2]


def _alike(left: FloatArray) -> bool:
    """Whether neighbouring blocks resemble each other beyond chance, over all modes."""
    shares = []
    for column in left.T:
        there = ~np.isnan(column[1:]) & ~np.isnan(column[:-1])
        power = float(np.nansum(np.square(column)))
        if there.any() and power > 0.0:
            shares.append(float((column[1:] * column[:-1])[there].sum()) / power)
    return bool(shares) and float(np.mean(shares)) > ALIKE / math.sqrt(left.shape[0])
