"""The identified gain at work: innovations, and a filterpy filter that runs it.

    x(k+1) = A x(k) + B u(k) + K e(k),   e(k) = y(k) - C x(k) - D u(k)

K is the gain of the one-step PREDICTOR. A filter that first corrects and then predicts, as filterpy's does, uses
K_filter = A^(-1) K, with the same innovations. Conversely, the Riccati equation with Q = K R K', S = K R returns K
wherever A - K C is stable, and the stable gain with the same innovation spectrum where it is not.
"""

from typing import Any

import numpy as np

from era.realisation import Realisation
from era.simulation import predict
from okid.arrays import FloatArray
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record

__all__ = ["innovations", "kalman_filter"]

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
