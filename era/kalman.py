"""The identified gain at work: innovations, a filterpy filter that runs it, and its estimate for a model that has none.

    x(k+1) = A x(k) + B u(k) + K e(k),   e(k) = y(k) - C x(k) - D u(k)

K is the gain of the one-step PREDICTOR. A filter that first corrects and then predicts, as filterpy's does, uses
K_filter = A^(-1) K, with the same innovations. Conversely, the Riccati equation with Q = K R K', S = K R returns K
wherever A - K C is stable, and the stable gain with the same innovation spectrum where it is not.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from era.initial_state import estimate_initial_state
from era.realisation import Realisation
from era.simulation import check_channels, predict, simulate
from era.state_recursion import lifted
from okid.arrays import FloatArray
from okid.errors import InsufficientDataError, InvalidDataError, NumericalError
from okid.observer import fit_observer
from okid.record import Record
from okid.recovery import recover_markov

__all__ = ["gain_from_innovations", "innovations", "kalman_filter", "stabilised_gain"]

LARGEST_CONDITION = 1e12
"""Condition number of A beyond which A^(-1) K is rounding error."""
ROWS_PER_PARAMETER = 5
LONGEST_NOISE_MODEL = 40


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
            "estimate one with era.kalman.gain_from_innovations."
        )
    if model.order == 0:
        raise InvalidDataError("a Kalman filter needs at least one state, but this model is a pure feedthrough.")
    condition = np.linalg.cond(model.A)
    if not condition < LARGEST_CONDITION:
        raise NumericalError(
            f"the filter gain A^-1 K needs an invertible A, but its condition number is {condition:.3g} (a delay or "
            "deadbeat pole); use era.kalman.innovations, which needs no inverse."
        )
    result = KalmanFilter(dim_x=model.order, dim_z=model.n_outputs, dim_u=model.n_inputs)
    result.x = np.zeros(model.order)
    result.F, result.H = np.array(model.A), np.array(model.C)
    result.B = np.array(model.B) if model.n_inputs else None
    result.K = np.linalg.solve(model.A, model.K)
    return result


def gain_from_innovations(
    realisation: Realisation, records: Record | Sequence[Record], *, noise_order: int | None = None
) -> FloatArray:
    """Gain K for the given A, B, C, D, from what their free run leaves of the records.

    What the free run leaves is noise through the same poles: v = C (zI - A)^(-1) K e + e. A long autoregression of v
    (an observer fit without inputs) gives the Markov parameters of the gain, least squares on the model's own
    observability matrix the gain, and a Riccati equation makes it stable if it is not. The gain is zero where it
    predicts no better than the free run does. Needed after a model was reduced or refined: the gain found before is
    not that of the new model.

    Args:
        realisation: model; its own K, if any, is not looked at.
        records: one or several of the model's channels and time step.
        noise_order: of the autoregression; as long as the records allow, up to 40, unless given.

    Returns:
        (order, n_outputs) gain in the units of the records.

    Raises:
        InvalidDataError: other channels or another time step than the model.
        InsufficientDataError: records too short for an autoregression of the noise.

    References:
        Vicario, Phan, Betti, Longman, "Output-only observer/Kalman filter identification (O3KID)", Structural Control
        and Health Monitoring 22(5), 2015, 847-872, doi 10.1002/stc.1719.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> e, x, y = rng.standard_normal(4000), 0.0, np.empty(4000)
        >>> for k in range(4000):
        ...     y[k], x = x + e[k], 0.9 * x + 0.3 * e[k]
        >>> model = Realisation([[0.9]], np.empty((1, 0)), [[1.0]], np.empty((1, 0)), 0.01)
        >>> bool(abs(gain_from_innovations(model, Record([], y, 0.01))[0, 0] - 0.3) < 0.05)
        True
    """
    model = realisation
    several = [records] if isinstance(records, Record) else list(records)
    for record in several:
        check_channels(model, record)
    none = np.zeros((model.order, model.n_outputs))
    if model.order == 0:
        return none
    starts = [estimate_initial_state(model, record) for record in several]
    noise = [_left_over(model, record, start) for record, start in zip(several, starts, strict=True)]
    if _at_rounding(noise, several):
        return none
    order = _noise_order(model, several) if noise_order is None else noise_order
    markov = recover_markov(fit_observer(noise, order=order, ridge=1e-6), n_lags=2 * order)
    if markov.gain is None:  # pragma: no cover  # an observer always has one
        return none
    size = markov.output_scale
    scaled = (markov.gain[1:] * (size / size[:, np.newaxis])).reshape(-1, model.n_outputs)
    observability = _observability(model.A, model.C / size[:, np.newaxis], 2 * order)
    gain: FloatArray = np.asarray(np.linalg.lstsq(observability, scaled, rcond=None)[0] / size, dtype=np.float64)
    e = np.vstack([part.outputs for part in noise])
    e = e[~np.isnan(e).any(axis=1)]
    gain = stabilised_gain(model, gain, np.atleast_2d(np.cov(e, rowvar=False)))
    better = _logarithmic_size(model, gain, several, starts) < _logarithmic_size(model, none, several, starts)
    return gain if better else none


def stabilised_gain(realisation: Realisation, gain: FloatArray, innovation_covariance: FloatArray) -> FloatArray:
    """The gain itself where A - K C is stable; else the stable one of the same innovation spectrum, or zero if none is.

    Args:
        realisation: A and C.
        gain: (order, n_outputs).
        innovation_covariance: (n_outputs, n_outputs) of the innovations that the gain gives.

    Example:
        >>> model = Realisation([[0.9]], np.empty((1, 0)), [[1.0]], np.empty((1, 0)), 0.01)
        >>> stabilised_gain(model, np.array([[2.9]]), np.eye(1)).round(9)
        array([[1.4]])
    """
    A, C = realisation.A, realisation.C
    if np.abs(np.linalg.eigvals(A - gain @ C)).max(initial=0.0) < 1.0:
        return gain
    R = innovation_covariance
    S = gain @ R
    Q = S @ gain.T
    try:
        P = scipy.linalg.solve_discrete_are(A.T, C.T, (Q + Q.T) / 2, (R + R.T) / 2, s=S)
        stable = np.asarray(np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T, dtype=np.float64)
    except (np.linalg.LinAlgError, ValueError):  # no stabilising solution, or R singular
        return np.zeros_like(gain)
    if not np.isfinite(stable).all() or np.abs(np.linalg.eigvals(A - stable @ C)).max() >= 1.0:
        return np.zeros_like(gain)
    return stable


def _left_over(model: Realisation, record: Record, start: FloatArray) -> Record:
    """A record without inputs of what the free run leaves of the outputs."""
    outputs = record.outputs - simulate(model, record, initial_state=start).outputs
    return replace(record, inputs=np.empty((record.n_samples, 0)), outputs=outputs, input_names=(), input_units=())


def _at_rounding(noise: Sequence[Record], records: Sequence[Record]) -> bool:
    """Whether some output is explained to rounding, so that there is no noise to learn from."""
    left = np.sqrt(np.nanmean(np.vstack([part.outputs for part in noise]) ** 2, axis=0))
    size = np.sqrt(np.nanmean(np.vstack([record.outputs for record in records]) ** 2, axis=0))
    return bool((left <= 1e-9 * size).any())


def _noise_order(model: Realisation, records: Sequence[Record]) -> int:
    """Order of the autoregression that leaves `ROWS_PER_PARAMETER` samples for each of its unknowns."""
    n_samples = sum(record.n_samples for record in records)
    allowed = int((n_samples / ROWS_PER_PARAMETER - 1) / model.n_outputs)
    shortest = min(record.n_samples for record in records) // 3
    order = min(allowed, shortest, LONGEST_NOISE_MODEL)
    if order * model.n_outputs < model.order or order < 1:
        raise InsufficientDataError(
            f"the gain of a model of order {model.order} with {model.n_outputs} outputs needs a noise model of order "
            f"{-(-model.order // model.n_outputs)} and {ROWS_PER_PARAMETER} samples for each of its unknowns, but "
            f"the records have {n_samples} samples, enough for order {max(order, 0)}; give more data or keep K = None."
        )
    return order


def _observability(A: FloatArray, C: FloatArray, n_blocks: int) -> FloatArray:
    length = 1 << (n_blocks - 1).bit_length()
    return lifted(A, C, length)[0][: n_blocks * C.shape[0]]


def _logarithmic_size(
    model: Realisation, gain: FloatArray, records: Sequence[Record], starts: Sequence[FloatArray]
) -> float:
    """Logarithm of the determinant of the innovation covariance that a gain gives; infinite when it diverges."""
    with_gain = replace(model, K=gain)
    try:
        e = np.vstack(
            [innovations(with_gain, record, initial_state=start) for record, start in zip(records, starts, strict=True)]
        )
    except NumericalError:
        return float(np.inf)
    e = e[~np.isnan(e).any(axis=1)]
    return float(np.linalg.slogdet(e.T @ e / len(e))[1]) if len(e) else float(np.inf)
