"""The innovation form run over an array forwards, and its adjoint backwards: the two passes behind a gain.

    forwards    e(k) = v(k) - C x(k),  x(k+1) = A x(k) + K e(k)
    backwards   s(k-1) = Abar' s(k) + C' W e(k),  Abar = A - K C,  s(last) = 0

The forward run forecasts v from its own past; where a sample is missing the state is not corrected by it, e counts as
zero. s(k) says how much the sum of e' W e falls for a push of the state at k + 1.
"""

import numpy as np

from era.state_recursion import free_run
from okid.arrays import FloatArray
from okid.rows import runs_of

__all__ = ["backward_states", "finite_gramian", "innovation_run"]

SHORTEST_BLOCK = 200
"""Complete rows in a row from which blocks of products are faster than a step at a time."""


def innovation_run(
    A: FloatArray, C: FloatArray, K: FloatArray, values: FloatArray, *, state: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Innovations of a series, zero where a sample is missing, and the state after it.

    Args:
        A: (order, order).
        C: (n_outputs, order).
        K: (order, n_outputs).
        values: (n_samples, n_outputs), NaN where missing.
        state: (order,) at the first sample.

    Returns:
        (n_samples, n_outputs) innovations, (order,) state; infinite or NaN where A - K C makes them grow without bound.

    Example:
        >>> one = np.ones((1, 1))
        >>> e, x = innovation_run(0.5 * one, one, 0.1 * one, np.array([[1.0], [np.nan], [1.0]]), state=np.zeros(1))
        >>> e.ravel(), x.round(4)
        (array([1.  , 0.  , 0.95]), array([0.12]))
    """
    there = ~np.isnan(values)
    innovations = np.zeros_like(values, subok=False)
    feedthrough = np.eye(C.shape[0])
    done = 0
    with np.errstate(over="ignore", invalid="ignore"):
        for start, stop in runs_of(np.asarray(there.all(axis=1))):
            if stop - start < min(SHORTEST_BLOCK, values.shape[0]):
                continue
            innovations[done:start], state = _sample_by_sample(A, C, K, values[done:start], state)
            innovations[start:stop], state = free_run(A - K @ C, K, -C, feedthrough, values[start:stop], state=state)
            done = stop
        innovations[done:], state = _sample_by_sample(A, C, K, values[done:], state)
    return innovations, state


def backward_states(A: FloatArray, C: FloatArray, K: FloatArray, weighted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The adjoint of `innovation_run`.

    Args:
        A: (order, order).
        C: (n_outputs, order).
        K: (order, n_outputs).
        weighted: (n_samples, n_outputs) W e(k).

    Returns:
        (n_samples, order) s(k), and (order,) s(-1), the slope with respect to the state at the first sample.

    Example:
        >>> one = np.ones((1, 1))
        >>> s, first = backward_states(0.5 * one, one, 0.0 * one, np.array([[1.0], [2.0], [4.0]]))
        >>> s.ravel(), first
        (array([4., 4., 0.]), array([3.]))
    """
    order = A.shape[0]
    reversed_time = np.ascontiguousarray(weighted[::-1])
    none = np.zeros((order, C.shape[0]))
    with np.errstate(over="ignore", invalid="ignore"):
        states, first = free_run((A - K @ C).T, C.T, np.eye(order), none, reversed_time, state=np.zeros(order))
    return states[::-1], first


def finite_gramian(A: FloatArray, weight: FloatArray, length: int) -> FloatArray:
    """Sum over l = 0 ... length - 1 of A'^l W A^l, by doubling.

    Args:
        A: (order, order).
        weight: (order, order) W, symmetric.
        length: number of terms.

    Example:
        >>> finite_gramian(np.array([[0.5]]), np.array([[1.0]]), 3)
        array([[1.3125]])
    """
    total, power = np.zeros_like(weight), np.eye(A.shape[0])
    part, step = weight, A
    while length:
        if length & 1:
            total, power = part + step.T @ total @ step, power @ step
        length >>= 1
        part, step = part + step.T @ part @ step, step @ step
    return 0.5 * (total + total.T)


def _sample_by_sample(
    A: FloatArray, C: FloatArray, K: FloatArray, values: FloatArray, state: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """As `innovation_run`, for a few rows or rows with gaps."""
    there = ~np.isnan(values)
    closed, pushes = A - K @ C, np.where(there, values, 0.0) @ K.T
    states = np.empty((values.shape[0], A.shape[0]))
    complete = np.asarray(there.all(axis=1))
    for k in range(values.shape[0]):
        states[k] = state
        if complete[k]:
            state = closed @ state + pushes[k]
        else:
            state = A @ state + K @ np.where(there[k], values[k] - C @ state, 0.0)
    return np.where(there, values - states @ C.T, 0.0), state
