"""After the fit: is what the observer leaves over white, and free of the input?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import FloatArray, row_chunks
from okid.errors import InsufficientDataError, InvalidDataError
from okid.observer import ObserverFit
from okid.record import Record
from okid.rows import as_records, complete_rows
from okid.scalars import whole_number

__all__ = ["ResidualCheck", "check_residuals", "one_step_residuals"]

_ROUND_OFF = 1e-8
"""Residual relative to its output below which it is the rounding of the data, not noise."""
_NOT_WHITE = 2.0
"""Statistic over degrees of freedom from which the residual is called coloured."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResidualCheck:
    """Hosking's portmanteau test of the residuals and their correlation with past inputs.

    Attributes:
        autocorrelation: (n_lags + 1, n_outputs) of each output's residual, lag 0 is 1.
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


def one_step_residuals(observer: ObserverFit, record: Record) -> FloatArray:
    """e(k) = y(k) - D u(k) - sum_i [alpha_i u(k-i) + beta_i y(k-i)] - offset, in output units.

    Args:
        observer: fitted to this record or another of the same system.
        record: with the observer's channels.

    Returns:
        (n_samples, n_outputs); NaN where a sample of the row or of the `order` before it is missing, so in the first
        `order` rows.

    Raises:
        InvalidDataError: other numbers of channels than the observer's.

    Example:
        >>> from okid.observer import fit_observer
        >>> u = np.random.default_rng(3).standard_normal(200)
        >>> record = Record(u, 2.0 * u, 0.1)
        >>> bool(np.nanmax(np.abs(one_step_residuals(fit_observer(record, order=1), record))) < 1e-12)
        True
    """
    have, want = (record.n_inputs, record.n_outputs), (observer.n_inputs, observer.n_outputs)
    if have != want:
        raise InvalidDataError(
            f"the record must have the observer's channels, {want[0]} inputs and {want[1]} outputs, but has {have[0]} "
            f"and {have[1]}; select them with record.select."
        )
    order = observer.order
    residual = np.full((record.n_samples, record.n_outputs), np.nan)
    for rows in row_chunks(record.n_samples, record.n_inputs + record.n_outputs):
        start, stop = max(rows.start, order), rows.stop
        if start >= stop:
            continue
        # A NaN anywhere in the sums makes the row NaN, which is what is wanted.
        part = record.outputs[start:stop] - observer.offset
        part -= record.inputs[start:stop] @ observer.feedthrough.T
        for lag in range(1, order + 1):
            part -= record.inputs[start - lag : stop - lag] @ observer.input_coefficients[lag - 1].T
            part -= record.outputs[start - lag : stop - lag] @ observer.output_coefficients[lag - 1].T
        residual[start:stop] = part
    return residual


def check_residuals(
    observer: ObserverFit, records: Record | Sequence[Record], *, n_lags: int | None = None
) -> ResidualCheck:
    """Test the one-step residual for whiteness and for what the inputs still explain.

    Whiteness: Q = N^2 sum_{l=1..L} tr(C_l' C_0^-1 C_l C_0^-1) / (N - l), against q^2 (L - p) degrees of freedom.
    The test reliably rejects too short an observer; with a right one it is somewhat over-sized (33 % rejected at 5 % in
    a measured case), so the ratio of statistic to degrees of freedom says more than the p-value. Cross-correlation: the
    same sum over inputs at lags p+1 ... L (lags up to p are orthogonal by construction).

    Args:
        observer: to be judged.
        records: one record or several of one system, best not those that it was fitted to.
        n_lags: L, above the observer order; unless given the order plus at least 20, as far as there are two residuals
            for each.

    Raises:
        InvalidDataError: n_lags not above the observer order.
        InsufficientDataError: fewer rows than twice the lags.

    References:
        Hosking, "The multivariate portmanteau statistic", Journal of the American Statistical Association 75(371),
        1980, 602-608, doi 10.1080/01621459.1980.10477520.

    Example:
        >>> from okid.observer import fit_observer
        >>> rng = np.random.default_rng(5)
        >>> u, e = rng.standard_normal((2, 3000))
        >>> y = np.zeros(3000)
        >>> for k in range(1, 3000):
        ...     y[k] = 0.8 * y[k - 1] + u[k - 1] + e[k]
        >>> record = Record(u, y, 0.1)
        >>> check_residuals(fit_observer(record, order=1), record).whiteness_ratio < 1.5
        True
    """
    several = as_records(records)
    order, q = observer.order, observer.n_outputs
    residuals = [one_step_residuals(observer, record) / observer.output_scale for record in several]
    there = [complete_rows(residual) for residual in residuals]
    n_rows = sum(int(mask.sum()) for mask in there)
    if n_lags is None:
        lags = max(order + 1, min(order + max(20, order // 2), n_rows // 2))
    else:
        lags = whole_number(n_lags, name=f"n_lags (above the observer order {order})", least=order + 1)
    if n_rows < 2 * lags:
        raise InsufficientDataError(
            f"testing {lags} lags needs at least {2 * lags} residuals, but {n_rows} are left; use fewer lags or more "
            "data."
        )
    mean = sum(residual[mask].sum(axis=0) for residual, mask in zip(residuals, there, strict=True)) / n_rows
    clean = [
        np.where(mask[:, np.newaxis], residual - mean, 0.0) for residual, mask in zip(residuals, there, strict=True)
    ]
    covariances = np.array([_lagged(clean, clean, lag) for lag in range(lags + 1)]) / n_rows
    variance = covariances[0].diagonal()
    limit = 1.96 / np.sqrt(n_rows)
    with np.errstate(invalid="ignore", divide="ignore"):
        autocorrelation = np.diagonal(covariances, axis1=1, axis2=2) / variance
    if not (np.sqrt(variance) > _ROUND_OFF).all():
        return ResidualCheck(
            autocorrelation=_closed(np.nan_to_num(autocorrelation)),
            whiteness_ratio=np.nan,
            whiteness_p_value=np.nan,
            input_correlation_ratio=np.nan,
            confidence_limit=float(limit),
            messages=("the residual of at least one output is at the level of rounding: there is nothing to test.",),
        )
    whiten = _inverse_root(covariances[0])
    freedom = q * q * (lags - order)
    statistic = sum(
        n_rows**2 / (n_rows - lag) * float(np.sum((whiten @ covariances[lag] @ whiten.T) ** 2))
        for lag in range(1, lags + 1)
    )
    ratio = statistic / freedom
    p_value = float(scipy.special.gammaincc(0.5 * freedom, 0.5 * statistic))
    input_ratio = _input_ratio(several, clean, n_rows, whiten, order=order, lags=lags)
    return ResidualCheck(
        autocorrelation=_closed(autocorrelation),
        whiteness_ratio=float(ratio),
        whiteness_p_value=p_value,
        input_correlation_ratio=input_ratio,
        confidence_limit=float(limit),
        messages=_messages(ratio, p_value, input_ratio, lags, order),
    )


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


def _input_ratio(
    records: Sequence[Record],
    residuals: Sequence[FloatArray],
    n_rows: int,
    whiten: FloatArray,
    *,
    order: int,
    lags: int,
) -> float:
    if records[0].n_inputs == 0:
        return float("nan")
    there = [complete_rows(record.inputs) for record in records]
    count = sum(int(mask.sum()) for mask in there)
    mean = sum(record.inputs[mask].sum(axis=0) for record, mask in zip(records, there, strict=True)) / count
    inputs = [
        np.where(mask[:, np.newaxis], record.inputs - mean, 0.0) for record, mask in zip(records, there, strict=True)
    ]
    whiten_inputs = _inverse_root(_lagged(inputs, inputs, 0) / count)
    statistic = sum(
        n_rows * float(np.sum((whiten @ _lagged(residuals, inputs, lag) @ whiten_inputs.T / n_rows) ** 2))
        for lag in range(order + 1, lags + 1)
    )
    return statistic / (whiten.shape[0] * whiten_inputs.shape[0] * (lags - order))


def _messages(ratio: float, p_value: float, input_ratio: float, lags: int, order: int) -> tuple[str, ...]:
    found = []
    if ratio > _NOT_WHITE:
        found.append(
            f"the residual is not white: statistic over degrees of freedom {ratio:.2f} at {lags} lags (1 is white), "
            f"so the observer of order {order} leaves dynamics of the noise out; a higher order helps if the record "
            "is long enough."
        )
    elif p_value < 0.05:
        found.append(
            f"the residual is nearly white: statistic over degrees of freedom {ratio:.2f} (1 is white); its p-value "
            f"{p_value:.2g} is weak evidence, since the test rejects too often for a truncated observer."
        )
    else:
        found.append(f"the residual is white: statistic over degrees of freedom {ratio:.2f}, p-value {p_value:.2g}.")
    if input_ratio > _NOT_WHITE:
        found.append(
            f"inputs more than {order} samples old still explain part of the residual (ratio {input_ratio:.2f}, 1 is "
            "none): the observer order is too low, or the system is not linear."
        )
    return tuple(found)


def _closed(array: FloatArray) -> FloatArray:
    array = np.array(array)
    array.flags.writeable = False
    return array
