"""After the fit: is what the observer leaves over white, and free of the input?

Hosking's portmanteau statistic of errors e with lagged covariances C_l, and its kin for the inputs,

    Q = N^2 sum_{l=1..L} tr(C_l' C_0^-1 C_l C_0^-1) / (N - l),   Q_u = N sum_l |C_0^(-1/2) C_l(e, u) C_0(u)^(-1/2)|^2

each over its degrees of freedom: 1 for errors that are white and free of the inputs. The ratio says more than the
p-value, which rejects too often for models that are truncated or were fitted to the same data.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import FloatArray, row_chunks, whole_number
from okid.display import Displayed
from okid.errors import InsufficientDataError, InvalidDataError
from okid.observer import ObserverFit
from okid.record import Record
from okid.rows import as_records, complete_rows, usable_rows

NOT_WHITE = 2.0
"""Statistic over degrees of freedom from which errors are called coloured."""
UNLIKELY_WHITE = 0.05
"""Call errors nearly white, not white, below this p-value."""
WHITENESS_LAGS = 20
"""Test so many lags beyond those that the fitted numbers take up."""
ROUND_OFF = 1e-8
"""Error relative to its output below which it is the rounding of the data, not noise."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ResidualCheck(Displayed):
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
    """Errors less their mean, zero in rows that miss one."""

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


def residual_check(
    errors: CentredErrors,
    inputs: Sequence[FloatArray],
    *,
    n_lags: int,
    n_fitted: int,
    first_lag: int,
    what: str,
    words: Callable[[float, float, float], tuple[str, ...]],
) -> ResidualCheck:
    """Both tests of one-step errors, and what they say.

    Args:
        errors: in units of their outputs.
        inputs: (n_samples, n_inputs) a record, NaN where missing.
        n_lags: of both tests.
        n_fitted: see `whiteness`.
        first_lag: smallest lag at which the inputs are asked.
        what: begins the sentence on errors that are nothing but rounding.
        words: messages from whiteness ratio, p-value and input correlation ratio.

    Raises:
        InsufficientDataError: fewer complete rows than twice the lags.
    """
    if errors.n_rows < 2 * n_lags:
        raise InsufficientDataError(
            f"testing {n_lags} lags needs at least {2 * n_lags} residuals, but {errors.n_rows} are left; use fewer "
            "lags or more data."
        )
    white = whiteness(errors, n_lags=n_lags, n_fitted=n_fitted)
    input_ratio = np.nan
    messages: tuple[str, ...] = (f"{what} at the level of rounding: there is nothing to test.",)
    if white.inverse_root is not None:
        input_ratio = input_correlation(errors, white.inverse_root, inputs, first_lag=first_lag, last_lag=n_lags)
        messages = words(white.ratio, white.p_value, input_ratio)
    return ResidualCheck(
        autocorrelation=white.autocorrelation,
        whiteness_ratio=white.ratio,
        whiteness_p_value=white.p_value,
        input_correlation_ratio=input_ratio,
        confidence_limit=white.confidence_limit,
        messages=messages,
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


def whiteness_of_each(errors: Sequence[FloatArray], *, n_lags: int) -> float:
    """`whiteness(...).ratio` of each output by itself, for those that are not measured in the same rows.

    Args:
        errors: (n_samples, n_outputs) a record in units of their outputs, NaN where not known.
        n_lags: L; those at which an output has no pairs of samples are left out.

    Returns:
        The sum of squared autocorrelations, each over its variance, over their number; nan where an output's errors are
        rounding, or no two samples are so near.

    Example:
        >>> noise = np.random.default_rng(2).standard_normal((3000, 2))
        >>> noise[::2, 0] = np.nan
        >>> 0.7 < whiteness_of_each([noise], n_lags=20) < 1.4
        True
        >>> whiteness_of_each([noise + np.nan_to_num(np.roll(noise, 2, axis=0))], n_lags=20) > 10.0
        True
    """
    statistic, freedom = 0.0, 0
    for i in range(errors[0].shape[1]):
        there = [np.isfinite(one[:, i]) for one in errors]
        count = sum(int(own.sum()) for own in there)
        mean = sum(float(one[own, i].sum()) for one, own in zip(errors, there, strict=True)) / max(1, count)
        parts = [np.where(own, one[:, i] - mean, 0.0) for one, own in zip(errors, there, strict=True)]
        variance = sum(float(one @ one) for one in parts) / max(1, count)
        if not np.sqrt(variance) > ROUND_OFF:
            return float("nan")
        for lag in range(1, n_lags + 1):
            pairs = sum(int(np.count_nonzero(own[lag:] & own[:-lag])) for own in there)
            if pairs > n_lags:
                product = sum(float(one[lag:] @ one[:-lag]) for one in parts)
                statistic, freedom = statistic + product**2 / (pairs * variance**2), freedom + 1
    return statistic / freedom if freedom else float("nan")


def input_correlation_of_each(errors: Sequence[FloatArray], inputs: Sequence[FloatArray], *, last_lag: int) -> float:
    """`input_correlation` of each output by itself, the mean of those that are no rounding.

    Args:
        errors: (n_samples, n_outputs) a record in units of their outputs, nearly white, NaN where not known.
        inputs: (n_samples, n_inputs) a record.
        last_lag: largest lag.

    Example:
        >>> rng = np.random.default_rng(4)
        >>> force, noise = rng.standard_normal((3000, 1)), rng.standard_normal((3000, 2))
        >>> noise[::2, 0] = np.nan
        >>> input_correlation_of_each([noise], [force], last_lag=20) < 1.6
        True
        >>> input_correlation_of_each([noise + np.roll(force, 3)], [force], last_lag=20) > 10.0
        True
    """
    ratios = []
    for i in range(errors[0].shape[1]):
        one = centred([error[:, [i]] for error in errors])
        size = np.sqrt(sum(float(np.square(part).sum()) for part in one.records) / max(1, one.n_rows))
        if size > ROUND_OFF and one.n_rows > 2 * last_lag:
            ratios.append(input_correlation(one, np.array([[1.0 / size]]), inputs, first_lag=0, last_lag=last_lag))
    return float(np.mean(ratios)) if ratios else float("nan")


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


def one_step_residuals(observer: ObserverFit, record: Record) -> FloatArray:
    """e(k) = y(k) - D u(k) - sum_i [alpha_i u(k-i) + beta_i y(k-i)] - offset, in output units.

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
    order, n_channels = observer.order, observer.n_inputs + observer.n_outputs
    # the matrix of their coefficients stays in cache
    length = max(1, min(order // 2, 1_000_000 // (2 * order * n_channels * observer.n_outputs)))
    predictor = _block_predictor(observer, length)
    residual = np.full((record.n_samples, record.n_outputs), np.nan)
    for rows in row_chunks(record.n_samples, n_channels):
        start, stop = max(rows.start, order), rows.stop
        if start >= stop:
            continue
        n_blocks = -(-(stop - start) // length)
        block = np.zeros((order + n_blocks * length, n_channels))
        seen = block[: order + stop - start]
        seen[:, : observer.n_inputs] = record.inputs[start - order : stop]
        seen[:, observer.n_inputs :] = record.outputs[start - order : stop]
        complete = complete_rows(seen)
        seen[~complete] = 0.0
        windows = np.lib.stride_tricks.sliding_window_view(block, order + length, axis=0)[::length]
        predicted = windows.transpose(0, 2, 1).reshape(n_blocks, -1) @ predictor
        part = record.outputs[start:stop] - observer.offset
        part -= predicted.reshape(n_blocks * length, -1)[: stop - start]
        part[~usable_rows(complete, order)[order:]] = np.nan
        residual[start:stop] = part
    return residual


def _block_predictor(observer: ObserverFit, length: int) -> FloatArray:
    """((order + length) n_channels, length n_outputs): a block's outputs from its samples and the `order` before it."""
    order, n_inputs, n_outputs = observer.order, observer.n_inputs, observer.n_outputs
    coefficients = np.zeros((order + 1, n_inputs + n_outputs, n_outputs))  # oldest sample first
    coefficients[order, :n_inputs] = observer.feedthrough.T
    coefficients[:order, :n_inputs] = observer.input_coefficients[::-1].transpose(0, 2, 1)
    coefficients[:order, n_inputs:] = observer.output_coefficients[::-1].transpose(0, 2, 1)
    predictor = np.zeros((order + length, n_inputs + n_outputs, length, n_outputs))
    for row in range(length):
        predictor[row : row + order + 1, :, row] = coefficients
    return predictor.reshape((order + length) * (n_inputs + n_outputs), length * n_outputs)


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
    order = observer.order
    errors = centred([one_step_residuals(observer, record) / observer.output_scale for record in several])
    if n_lags is None:
        lags = max(order + 1, min(order + max(WHITENESS_LAGS, order // 2), errors.n_rows // 2))
    else:
        lags = whole_number(n_lags, name=f"n_lags (above the observer order {order})", least=order + 1)
    return residual_check(
        errors,
        [record.inputs for record in several],
        n_lags=lags,
        n_fitted=order * observer.n_outputs**2,
        first_lag=order + 1,
        what="the residual of at least one output is",
        words=lambda ratio, p_value, input_ratio: _messages(ratio, p_value, input_ratio, lags, order),
    )


def _messages(ratio: float, p_value: float, input_ratio: float, lags: int, order: int) -> tuple[str, ...]:
    found = []
    if ratio > NOT_WHITE:
        found.append(
            f"the residual is not white: statistic over degrees of freedom {ratio:.2f} at {lags} lags (1 is white), "
            f"so the observer of order {order} leaves dynamics of the noise out; a higher order helps if the record "
            "is long enough."
        )
    elif p_value < UNLIKELY_WHITE:
        found.append(
            f"the residual is nearly white: statistic over degrees of freedom {ratio:.2f} (1 is white); its p-value "
            f"{p_value:.2g} is weak evidence, since the test rejects too often for a truncated observer."
        )
    else:
        found.append(f"the residual is white: statistic over degrees of freedom {ratio:.2f}, p-value {p_value:.2g}.")
    if input_ratio > NOT_WHITE:
        found.append(
            f"inputs more than {order} samples old still explain part of the residual (ratio {input_ratio:.2f}, 1 is "
            "none): the observer order is too low, or the system is not linear."
        )
    return tuple(found)
