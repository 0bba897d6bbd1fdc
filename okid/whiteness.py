"""Is a series of one-step errors white, and free of the input? The arithmetic behind the residual tests.

Hosking's portmanteau statistic of errors e with lagged covariances C_l, and its kin for the inputs,

    Q = N^2 sum_{l=1..L} tr(C_l' C_0^-1 C_l C_0^-1) / (N - l),   Q_u = N sum_l |C_0^(-1/2) C_l(e, u) C_0(u)^(-1/2)|^2

each over its degrees of freedom: 1 for errors that are white and free of the inputs. The ratio says more than the
p-value, which rejects too often for models that are truncated or were fitted to the same data.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import FloatArray
from okid.errors import InsufficientDataError
from okid.rows import complete_rows

__all__ = [
    "NOT_WHITE",
    "CentredErrors",
    "ResidualCheck",
    "Whiteness",
    "centred",
    "check_enough_for_lags",
    "input_correlation",
    "whiteness",
]

NOT_WHITE = 2.0
"""Statistic over degrees of freedom from which errors are called coloured."""
ROUND_OFF = 1e-8
"""Error relative to its output below which it is the rounding of the data, not noise."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResidualCheck:
    """Hosking's portmanteau test of one-step errors and their correlation with past inputs.

    Attributes:
        autocorrelation: (n_lags + 1, n_outputs) of each output's error, lag 0 is 1.
        whiteness_ratio: statistic over its degrees of freedom; 1 is white, above about 2 is not.
        whiteness_p_value: of the chi-square test; weak evidence by itself when the ratio is near 1.
        input_correlation_ratio: the same for the cross-correlation with the inputs; nan without inputs.
        confidence_limit: 95 % limit of one autocorrelation.
        messages: the findings in words.
    """

    autocorrelation: FloatArray
    whiteness_ratio: float
    whiteness_p_value: float
    input_correlation_ratio: float
    confidence_limit: float
    messages: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CentredErrors:
    """Errors less their mean, zero in rows that miss one.

    Attributes:
        records: (n_samples, n_outputs) a record.
        n_rows: complete rows.
    """

    records: tuple[FloatArray, ...]
    n_rows: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Whiteness:
    """The portmanteau statistic.

    Attributes:
        autocorrelation: (n_lags + 1, n_outputs), read-only.
        ratio: statistic over degrees of freedom; nan where an output's errors are rounding.
        p_value: of the chi-square test; nan likewise.
        inverse_root: (n_kept, n_outputs) W with W C_0 W' = I; None where an output's errors are rounding.
        confidence_limit: 95 % limit of one autocorrelation.
    """

    autocorrelation: FloatArray
    ratio: float
    p_value: float
    inverse_root: FloatArray | None
    confidence_limit: float


def centred(errors: Sequence[FloatArray]) -> CentredErrors:
    """Errors of all records less their common mean; what is missing becomes zero.

    Args:
        errors: (n_samples, n_outputs) a record, NaN where not known.

    Example:
        >>> centred([np.array([[1.0], [np.nan], [3.0]])]).records[0].ravel()
        array([-1.,  0.,  1.])
    """
    there = [complete_rows(part) for part in errors]
    n_rows = sum(int(mask.sum()) for mask in there)
    total = np.sum([part[mask].sum(axis=0) for part, mask in zip(errors, there, strict=True)], axis=0)
    mean = total / max(n_rows, 1)
    records = tuple(np.where(mask[:, np.newaxis], part - mean, 0.0) for part, mask in zip(errors, there, strict=True))
    return CentredErrors(records=records, n_rows=n_rows)


def check_enough_for_lags(errors: CentredErrors, n_lags: int) -> None:
    """Refuse to test more lags than half the errors.

    Raises:
        InsufficientDataError: fewer complete rows than twice the lags.
    """
    if errors.n_rows < 2 * n_lags:
        raise InsufficientDataError(
            f"testing {n_lags} lags needs at least {2 * n_lags} residuals, but {errors.n_rows} are left; use fewer "
            "lags or more data."
        )


def whiteness(errors: CentredErrors, *, n_lags: int, n_fitted: int) -> Whiteness:
    """Hosking's statistic over its degrees of freedom, n_outputs^2 n_lags less the numbers that were fitted.

    Args:
        errors: in units of their outputs, so that rounding can be told.
        n_lags: L.
        n_fitted: numbers of the model of the noise that were fitted to these or like data, below n_outputs^2 n_lags.

    References:
        Hosking, "The multivariate portmanteau statistic", Journal of the American Statistical Association 75(371),
        1980, 602-608, doi 10.1080/01621459.1980.10477520.
    """
    n_rows = errors.n_rows
    covariances = np.array([_lagged(errors.records, errors.records, lag) for lag in range(n_lags + 1)]) / n_rows
    variance = covariances[0].diagonal()
    limit = float(1.96 / np.sqrt(n_rows))
    with np.errstate(invalid="ignore", divide="ignore"):
        autocorrelation = np.diagonal(covariances, axis1=1, axis2=2) / variance
    if not np.isfinite(covariances).all() or not (np.sqrt(variance) > ROUND_OFF).all():
        return Whiteness(
            autocorrelation=_closed(np.nan_to_num(autocorrelation)),
            ratio=np.nan,
            p_value=np.nan,
            inverse_root=None,
            confidence_limit=limit,
        )
    root = _inverse_root(covariances[0])
    freedom = variance.size**2 * n_lags - n_fitted
    statistic = sum(
        n_rows**2 / (n_rows - lag) * float(np.sum((root @ covariances[lag] @ root.T) ** 2))
        for lag in range(1, n_lags + 1)
    )
    return Whiteness(
        autocorrelation=_closed(autocorrelation),
        ratio=statistic / freedom,
        p_value=float(scipy.special.gammaincc(0.5 * freedom, 0.5 * statistic)),
        inverse_root=root,
        confidence_limit=limit,
    )


def input_correlation(
    errors: CentredErrors, inverse_root: FloatArray, inputs: Sequence[FloatArray], *, first_lag: int, last_lag: int
) -> float:
    """Statistic of the correlation of errors with inputs `first_lag` ... `last_lag` samples old, over its freedom.

    Args:
        errors: as tested for whiteness.
        inverse_root: of their covariance.
        inputs: (n_samples, n_inputs) a record, NaN where missing.
        first_lag: smallest lag.
        last_lag: largest lag.

    Returns:
        1 on average when inputs explain nothing; nan without inputs.
    """
    if inputs[0].shape[1] == 0:
        return float("nan")
    given = centred(inputs)
    root = _inverse_root(_lagged(given.records, given.records, 0) / given.n_rows)
    lags = range(first_lag, last_lag + 1)
    statistic = sum(
        errors.n_rows
        * float(np.sum((inverse_root @ _lagged(errors.records, given.records, lag) @ root.T / errors.n_rows) ** 2))
        for lag in lags
    )
    freedom = inverse_root.shape[0] * root.shape[0] * len(lags)
    return statistic / freedom if freedom else float("nan")


def _lagged(ahead: Sequence[FloatArray], behind: Sequence[FloatArray], lag: int) -> FloatArray:
    """Sum over records of a(k) b(k - lag)'."""
    total = np.zeros((ahead[0].shape[1], behind[0].shape[1]))
    for a, b in zip(ahead, behind, strict=True):
        total += a[lag:].T @ b[: max(0, b.shape[0] - lag)]
    return total


def _inverse_root(covariance: FloatArray) -> FloatArray:
    """W with W C W' = I; directions without variance are left out."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * values[-1]
    root: FloatArray = vectors[:, kept].T / np.sqrt(values[kept])[:, np.newaxis]
    return root


def _closed(array: FloatArray) -> FloatArray:
    array = np.array(array)
    array.flags.writeable = False
    return array
