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

__all__ = ["backward_states", "finite_gramian", "innovation_run", "one_step"]

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
    B, D, none = (np.empty((rows, 0)) for rows in (A.shape[0], C.shape[0], values.shape[0]))
    predicted, state = one_step(A, B, C, D, K, inputs=none, outputs=values, state=state)
    return np.where(np.isnan(values), 0.0, values - predicted), state


def one_step(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    K: FloatArray,
    *,
    inputs: FloatArray,
    outputs: FloatArray,
    state: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """One-step prediction: x(k+1) = A x + B u + K e, e = y - C x - D u, zero where an output is missing.

    Args:
        A: (order, order).
        B: (order, n_inputs).
        C: (n_outputs, order).
        D: (n_outputs, n_inputs).
        K: (order, n_outputs).
        inputs: (n_samples, n_inputs), none missing.
        outputs: (n_samples, n_outputs), NaN where missing.
        state: (order,) at the first sample.

    Returns:
        (n_samples, n_outputs) C x + D u at every sample, (order,) state after the last; infinite or NaN where A - K C
        makes them grow without bound.

    Example:
        >>> one = np.ones((1, 1))
        >>> outputs = np.array([[0.0], [2.5], [0.0]])
        >>> model = 0.5 * one, one, 2 * one, 0 * one, 0.1 * one
        >>> one_step(*model, inputs=np.eye(3, 1), outputs=outputs, state=np.zeros(1))[0].ravel()
        array([0. , 2. , 1.1])
    """
    predicted = np.empty_like(outputs, subok=False)
    closed, feed, through = A - K @ C, np.hstack([B - K @ D, K]), np.hstack([D, np.zeros((C.shape[0],) * 2)])
    done = 0
    with np.errstate(over="ignore", invalid="ignore"):
        for start, stop in [*runs_of(np.asarray(~np.isnan(outputs).any(axis=1))), (outputs.shape[0],) * 2]:
            if start < stop < start + min(SHORTEST_BLOCK, outputs.shape[0]):
                continue
            rows = slice(done, start)
            predicted[rows], state = _sample_by_sample((A, B, C, D, K), inputs[rows], outputs[rows], state)
            both = np.hstack([inputs[start:stop], outputs[start:stop]])
            predicted[start:stop], state = free_run(closed, feed, C, through, both, state=state)
            done = stop
    return predicted, state


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
    model: tuple[FloatArray, ...], inputs: FloatArray, outputs: FloatArray, state: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """As `one_step`, for a few rows or rows with gaps."""
    A, B, C, D, K = model
    forced = inputs @ D.T
    values, drive = outputs - forced, inputs @ B.T
    there = ~np.isnan(values)
    closed, pushes = A - K @ C, drive + np.where(there, values, 0.0) @ K.T
    states = np.empty((values.shape[0], A.shape[0]))
    complete = np.asarray(there.all(axis=1))
    for k in range(values.shape[0]):
        states[k] = state
        if complete[k]:
            state = closed @ state + pushes[k]
        else:
            state = A @ state + drive[k] + K @ np.where(there[k], values[k] - C @ state, 0.0)
    return states @ C.T + forced, state
