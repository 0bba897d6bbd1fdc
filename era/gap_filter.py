"""The steady-state filter over complete samples, the time-varying one where samples are missing.

The innovation form is a state-space model whose noises belong together: Q = K R K', R, S = K R. Its Kalman filter with
state covariance P and the rows a that are there,

    L = (A P Ca' + K R_a) (Ca P Ca' + Raa)^-1,  x+ = A x + B u + L e_a,  P+ = A P A' + K R K' - L (Ca P Ca' + Raa) L'

has P = 0 and L = K as long as nothing is missing: the steady state. A missing sample makes P grow, and complete samples
bring it back to zero as fast as A - K C forgets.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from era.innovation_form import information, inverse
from era.kalman import kalman_filter
from era.realisation import Realisation
from era.state_recursion import free_run
from okid.arrays import FloatArray
from okid.rows import runs_of

__all__ = ["Filtered", "SteadyRun", "by_filterpy", "by_recursion", "filtered"]

SteadyRun = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Inputs, complete outputs and state at the first sample to one-step predictions and the state after the last."""
NEGLIGIBLE = 1e-9
"""Energy of all later prediction errors by the state's covariance, over one sample's noise, below which it is zero."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Filtered:
    """A pass through a record.

    Attributes:
        predicted: (n_samples, n_outputs) one step ahead.
        corrections: (n_samples, order) L e, what each sample adds to the state.
        spreads: (n_samples, n_outputs) diagonal of M P(k) M' for the M that was asked for.
    """

    predicted: FloatArray
    corrections: FloatArray
    spreads: FloatArray


def filtered(
    model: Realisation,
    gain: FloatArray,
    noise: FloatArray,
    inputs: FloatArray,
    outputs: FloatArray,
    *,
    state: FloatArray,
    covariance: FloatArray,
    projection: FloatArray,
    steady: SteadyRun,
) -> Filtered:
    """Run the filter through a record.

    Args:
        model: A, B, C, D.
        gain: (order, n_outputs) K.
        noise: (n_outputs, n_outputs) R.
        inputs: (n_samples, n_inputs), finite.
        outputs: (n_samples, n_outputs), NaN where missing.
        state: (order,) at the first sample.
        covariance: (order, order) of the state at the first sample.
        projection: (n_outputs, order) M.
        steady: how to run where the covariance is zero and nothing is missing.
    """
    n_samples = outputs.shape[0]
    there = ~np.isnan(outputs)
    ends = np.zeros(n_samples, dtype=np.intp)
    for start, stop in runs_of(np.asarray(there.all(axis=1))):
        ends[start:stop] = stop
    A, C, P = model.A, model.C, np.array(covariance)
    forgotten = information(A, C, gain, inverse(noise), length=n_samples)
    predicted, spreads = np.empty_like(outputs, subok=False), np.zeros(outputs.shape)
    corrections = np.empty((n_samples, model.order))
    driven = gain @ noise @ gain.T
    k = 0
    while k < n_samples:
        if ends[k] and not P.any():
            rows = slice(k, int(ends[k]))
            predicted[rows], state = steady(inputs[rows], outputs[rows], state)
            corrections[rows] = (outputs[rows] - predicted[rows]) @ gain.T
            k = rows.stop
            continue
        spreads[k] = ((projection @ P) * projection).sum(axis=1)
        seen = there[k]
        predicted[k] = C @ state + model.D @ inputs[k]
        visible = P @ C[seen].T
        size = C[seen] @ visible + noise[np.ix_(seen, seen)]
        L = (A @ visible + gain @ noise[:, seen]) @ inverse(size)
        corrections[k] = L @ (outputs[k, seen] - predicted[k, seen])
        state = A @ state + model.B @ inputs[k] + corrections[k]
        P = A @ P @ A.T + driven - L @ size @ L.T
        P = 0.5 * (P + P.T)
        if seen.all() and float((P * forgotten).sum()) < NEGLIGIBLE:
            P = np.zeros_like(P)
        k += 1
    return Filtered(predicted=predicted, corrections=corrections, spreads=spreads)


def by_recursion(model: Realisation, gain: FloatArray) -> SteadyRun:
    """The innovation recursion, in blocks; needs no inverse of A."""
    A, B = model.A - gain @ model.C, np.hstack([model.B - gain @ model.D, gain])
    D = np.hstack([model.D, np.zeros((model.n_outputs, model.n_outputs))])

    def run(inputs: FloatArray, outputs: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        return free_run(A, B, model.C, D, np.hstack([inputs, outputs]), state=state)

    return run


def by_filterpy(model: Realisation) -> SteadyRun:
    """The steady-state filter of filterpy, a sample at a time.

    Raises:
        InvalidDataError: no gain, or no state.
        NumericalError: A is singular.
    """
    filter_ = kalman_filter(model)

    def run(inputs: FloatArray, outputs: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        filter_.x = np.array(state)
        predicted = np.empty_like(outputs, subok=False)
        for k, y in enumerate(outputs):
            filter_.update_steadystate(y - model.D @ inputs[k])
            predicted[k] = y - filter_.y
            filter_.predict_steadystate(inputs[k] if model.n_inputs else None)
        return predicted, np.asarray(filter_.x, dtype=np.float64)

    return run
