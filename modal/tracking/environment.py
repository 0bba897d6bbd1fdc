"""What measured causes explain of the frequencies: a regression whose form is chosen on held-out months.

ln f of each mode is a level and a polynomial of each cause as the structure feels it: part at once, part through a
body that follows within hours or days (an exponential mean). Part, time constant and degree are one choice for all
modes: that of the least error on months that were not fitted to.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from okid.arrays import FloatArray

__all__ = ["Environment", "explain", "held_out_months"]

DEGREES = (0, 1, 2, 3, 4)
"""Try polynomials of a cause up to this degree; 0 leaves the cause out."""
TIME_CONSTANTS = tuple(3600.0 * hours for hours in (3, 6, 12, 24, 48, 96))
"""Try these [s] for the body that follows slowly, from a thin deck to a massive pier,"""
SLOW_PARTS = (0.25, 0.5, 0.75, 1.0)
"""and these parts of the cause that are felt through it."""
FIRST_DEGREE = 3
"""Choose part and time constant with this degree, then the degree."""
MONTH = 30.44 * 86400.0
FEWEST_FOLDS = 5
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
    """(n_records,) number of the fold: a month, or a fifth of a shorter table.

    Args:
        times: (n_records,) rising.
        clock: times are seconds, not numbers of records.
    """
    span = float(np.ptp(times)) or 1.0
    n_folds = max(FEWEST_FOLDS, round(span / MONTH)) if clock else FEWEST_FOLDS
    folds: np.ndarray = np.minimum((n_folds * (times - times[0]) / (span * (1.0 + 1e-9))).astype(np.intp), n_folds - 1)
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
    chosen = dict.fromkeys(causes, _Felt())
    for _ in range(ROUNDS if len(causes) > 1 else 1):
        for name in causes:

            def error(felt: _Felt, name: str = name) -> float:
                terms = _terms(causes, {**chosen, name: felt}, times)[0]
                return float(np.nansum(_held_out_error(values, terms, folds)))

            slow = [_Felt(FIRST_DEGREE, part, tau) for part, tau in product(SLOW_PARTS, TIME_CONSTANTS) if clock]
            best = min([_Felt(FIRST_DEGREE), *slow], key=error)
            chosen[name] = min([replace(best, degree=degree) for degree in DEGREES], key=error)
    terms, names = _terms(causes, chosen, times)
    alone = _held_out_error(values, terms[:, :0], folds)
    with np.errstate(invalid="ignore", divide="ignore"):
        explained = 1.0 - _held_out_error(values, terms, folds) / alone
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
        how = [f"degree {felt.degree}"] * (felt.degree > 1)
        how += [f"{100 * felt.part:.0f} % felt within {felt.constant / 3600.0:.0f} h"] * (felt.part > 0)
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


def _held_out_error(values: FloatArray, terms: FloatArray, folds: np.ndarray) -> FloatArray:
    """(n_modes,) mean squared error on held-out months, each mode in units of its own variance."""
    design = np.hstack([np.ones((terms.shape[0], 1)), terms])
    edges = np.append(np.flatnonzero(np.diff(folds, prepend=-1)), folds.size)
    errors = np.full(values.shape[1], np.nan)
    for mode, column in enumerate(values.T):
        there = ~np.isnan(column)
        if there.sum() < 2 * design.shape[1]:
            continue
        y = np.where(there, column - column[there].mean(), 0.0)
        whole = np.column_stack([design * there[:, np.newaxis], y])
        grams = np.array([whole[first:last].T @ whole[first:last] for first, last in pairwise(edges)])
        squared = 0.0
        for own, rest in zip(grams, grams.sum(axis=0) - grams, strict=True):
            coefficients = np.linalg.lstsq(rest[:-1, :-1], rest[:-1, -1], rcond=1e-12)[0]
            change = np.append(-coefficients, 1.0)
            squared += float(change @ own @ change)
        errors[mode] = squared / max(float(y @ y), np.finfo(np.float64).tiny)
    return errors
