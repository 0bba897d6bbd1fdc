"""The identified gain at work: innovations, and a filterpy filter that runs it.

    x(k+1) = A x(k) + B u(k) + K e(k),   e(k) = y(k) - C x(k) - D u(k)

K is the gain of the one-step PREDICTOR. A filter that first corrects and then predicts, as filterpy's does, uses
K_filter = A^(-1) K, with the same innovations. Conversely, the Riccati equation with Q = K R K', S = K R returns K
wherever A - K C is stable, and the stable gain with the same innovation spectrum where it is not.

Are the innovations of a model on a record white, and free of the inputs? Then its gain predicts all that can be.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from era.innovation_form import left_over, settled
from era.realisation import Realisation
from era.simulation import check_channels, predict
from okid.arrays import FloatArray, whole_number
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record
from okid.residuals import NOT_WHITE, WHITENESS_LAGS, ResidualCheck, centred, residual_check
from okid.rows import as_records

__all__ = ["check_innovations", "innovations", "kalman_filter"]

LARGEST_CONDITION = 1e12
"""Condition number of A beyond which A^(-1) K is rounding error."""


def innovations(realisation: Realisation, record: Record, *, initial_state: FloatArray | None = None) -> FloatArray:
    """(n_samples, n_outputs) measured less predicted outputs; NaN where an output is missing or not known.

    Args:
        realisation: model with a gain.
        record: of the model's channels and time step.
        initial_state: (order,) state at the first sample; at rest unless given.

    Raises:
        InvalidDataError: as `era.simulation.predict`.

    Example:
        >>> model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, K=[[0.1]])
        >>> innovations(model, Record([1.0, 0.0, 0.0], [0.0, 2.5, 0.0], 0.01)).ravel()
        array([ 0. ,  0.5, -1.1])
    """
    return record.outputs - predict(realisation, record, initial_state=initial_state).outputs


def kalman_filter(realisation: Realisation) -> Any:
    """A `filterpy.kalman.KalmanFilter` set to run the identified gain in steady state.

    For each sample call `update_steadystate(y - D @ u)`, whose innovation is then in its attribute `y`, and
    `predict_steadystate(u)`: filterpy knows no D, and x and u must both stay one-dimensional.

    Args:
        realisation: model with a gain.

    Raises:
        InvalidDataError: no gain.
        NumericalError: A is singular (a delay or deadbeat pole), so that no filter gain A^(-1) K exists.

    Example:
        >>> filter_ = kalman_filter(Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, K=[[0.1]]))
        >>> filter_.update_steadystate(np.array([1.0]))
        >>> filter_.predict_steadystate(np.array([0.0]))
        >>> filter_.x
        array([0.1])
    """
    from filterpy.kalman import KalmanFilter

    model = realisation
    if model.K is None:
        raise InvalidDataError(
            "a Kalman filter needs a gain K and this realisation has none; realise Markov parameters with a gain, or "
            "estimate one with era.gain_from_innovations."
        )
    if model.order == 0:
        raise InvalidDataError("a Kalman filter needs at least one state, but this model is a pure feedthrough.")
    condition = np.linalg.cond(model.A)
    if not condition < LARGEST_CONDITION:
        raise NumericalError(
            f"the filter gain A^-1 K needs an invertible A, but its condition number is {condition:.3g} (a delay or "
            "deadbeat pole); use era.innovations, which needs no inverse."
        )
    result = KalmanFilter(dim_x=model.order, dim_z=model.n_outputs, dim_u=model.n_inputs)
    result.x = np.zeros(model.order)
    result.F, result.H = np.array(model.A), np.array(model.C)
    result.B = np.array(model.B) if model.n_inputs else None
    result.K = np.linalg.solve(model.A, model.K)
    return result


def check_innovations(
    realisation: Realisation, records: Record | Sequence[Record], *, n_lags: int | None = None
) -> ResidualCheck:
    """Test the innovations of a model with a gain for whiteness and for what the inputs still explain.

    The state that each record starts from and a constant in each output are estimated and taken off. Whiteness is
    Hosking's statistic over n_outputs^2 n_lags degrees of freedom, less order times n_outputs when there is a gain, for
    these numbers were fitted. Inputs up to n_lags samples old are correlated with the innovations.

    Args:
        realisation: model with a gain (zeros for one that knows measurement noise only).
        records: one or several of the model's channels and time step, best not those that the gain was fitted to.
        n_lags: L; unless given 20 more than the fitted numbers take up, as far as there are two rows for each.

    Raises:
        InvalidDataError: no gain, other channels or another time step, or too few lags for the numbers fitted.
        InsufficientDataError: fewer complete rows than twice the lags.

    References:
        Hosking, Journal of the American Statistical Association 75(371), 1980, 602-608,
        doi 10.1080/01621459.1980.10477520.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> e, x, y = rng.standard_normal(3000), 0.0, np.empty(3000)
        >>> for k in range(3000):
        ...     y[k], x = x + e[k], 0.9 * x + 0.3 * e[k]
        >>> none = np.empty((1, 0))
        >>> right = Realisation([[0.9]], none, [[1.0]], none, 0.01, K=[[0.3]])
        >>> half = Realisation([[0.9]], none, [[1.0]], none, 0.01, K=[[0.15]])
        >>> [check_innovations(model, Record([], y, 0.01)).whiteness_ratio < 2 for model in (right, half)]
        [True, False]
    """
    model, several = realisation, as_records(records)
    for record in several:
        check_channels(model, record)
    if model.K is None:
        raise InvalidDataError(
            "innovations need a gain K and this realisation has none; estimate one with era.gain_from_innovations, or "
            "give zeros for a model of measurement noise only."
        )
    size = _sizes(several)
    C, K, weight = model.C / size[:, np.newaxis], model.K * size, np.eye(model.n_outputs)
    found = []
    for record in several:
        part, _ = left_over(model, record)
        scaled = type(part)(values=part.values / size, state=part.state)
        _, e = settled(model.A, C, K, scaled, weight)
        found.append(np.where(np.isnan(part.values), np.nan, e))
    errors = centred(found)
    fitted = model.order * model.n_outputs if model.K.any() else 0
    least = fitted // model.n_outputs**2 + 1
    lags = (
        max(least, min(least + WHITENESS_LAGS, errors.n_rows // 2))
        if n_lags is None
        else whole_number(n_lags, name="n_lags (n_outputs^2 n_lags above the numbers of the gain)", least=least)
    )
    return residual_check(
        errors,
        [record.inputs for record in several],
        n_lags=lags,
        n_fitted=fitted,
        first_lag=0,
        what="the innovations of at least one output are",
        words=lambda ratio, p_value, input_ratio: _messages(ratio, p_value, input_ratio, lags),
    )


def _sizes(records: Sequence[Record]) -> np.ndarray:
    """(n_outputs,) standard deviations over all records; 1 for an output that never moves."""
    values = np.vstack([record.outputs for record in records])
    there = ~np.isnan(values)
    count = np.maximum(there.sum(axis=0), 1)
    mean = np.where(there, values, 0.0).sum(axis=0) / count
    size = np.sqrt((np.where(there, values - mean, 0.0) ** 2).sum(axis=0) / count)
    return np.where(size > 0.0, size, 1.0)


def _messages(ratio: float, p_value: float, input_ratio: float, lags: int) -> tuple[str, ...]:
    found = []
    if ratio > NOT_WHITE:
        found.append(
            f"the innovations are not white: statistic over degrees of freedom {ratio:.2f} at {lags} lags (white: 1); "
            "the past holds more than the gain uses: the noise has dynamics that are not the model's, or the gain "
            "is not that of these data."
        )
    elif p_value < 0.05:
        found.append(
            f"the innovations are nearly white: statistic over degrees of freedom {ratio:.2f} (1 is white), p-value "
            f"{p_value:.2g}."
        )
    else:
        found.append(
            f"the innovations are white: statistic over degrees of freedom {ratio:.2f}, p-value {p_value:.2g}."
        )
    if input_ratio > NOT_WHITE:
        found.append(
            f"inputs up to {lags} samples old still explain part of the innovations (ratio {input_ratio:.2f}, 1 is "
            "none): the model misses dynamics from the inputs, or the system is not linear."
        )
    return tuple(found)
