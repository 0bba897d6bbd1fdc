"""The Bouc-Wen state over a straight stretch of the displacement.

In units of the yield displacement, with the sign of the motion taken out, the state s follows

    ds/dh = 1 - s^n  for s > 0 (loading),      ds/dh = 1  for s < 0 (unloading)

over the stretch h >= 0. Unloading is exact. Loading, s runs into 1 exponentially; q = -ln(1 - s) makes of it
dq/dh = g(q) = (1 - s^n) / (1 - s), which stays between 1 and n: smooth, never stiff, and s never leaves its bound.
It is integrated by Runge-Kutta steps that grow with h (s settles as it goes), and the derivative by n beside it.
"""

from dataclasses import dataclass

import numpy as np

from okid.arrays import FloatArray

__all__ = ["Flow", "bouc_wen_flow"]

MOST_STEPS = 10
"""Runge-Kutta steps of a long stretch: the state is then right to 4e-5 for n up to 10 and to 2e-6 for n up to 3,
however long the stretch."""
SHORT, FEW_STEPS = 0.25, 4
"""A stretch up to this share of the yield displacement needs no more than this number of steps."""
GROWTH = 1.5
"""Power of the number of a step to which the steps reach."""
SETTLED = 36.0
"""q from which s is 1 to the last digit; no stretch needs to be longer."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Flow:
    """The state after the stretch and its derivatives, (n_samples,) each.

    Attributes:
        value: State after the stretch, in units of the yield displacement.
        by_state: By the state before.
        by_stretch: By the stretch.
        by_exponent: By n.
    """

    value: FloatArray
    by_state: FloatArray
    by_stretch: FloatArray
    by_exponent: FloatArray


def bouc_wen_flow(state: FloatArray, stretch: FloatArray, n: FloatArray) -> Flow:
    """The flow over `stretch` (n_samples,) >= 0 from `state` (n_samples,) in [-1, 1], for the exponent n >= 1.

    Example:
        >>> found = bouc_wen_flow(np.array([-0.5, 0.0]), np.array([0.3, 1.0]), np.array([2.0, 2.0]))
        >>> found.value.round(4)  # -0.5 + 0.3 and tanh(1)
        array([-0.2   ,  0.7616])
    """
    unloading = np.minimum(stretch, np.maximum(-state, 0.0))
    loading = np.minimum(stretch - unloading, SETTLED)
    start = -np.log1p(-np.clip(state, 0.0, 1.0 - np.exp(-SETTLED)))
    loads = stretch > unloading
    q, by_n = start.copy(), np.zeros_like(start)
    exponent = np.broadcast_to(n, start.shape)
    for n_steps, kind in ((FEW_STEPS, loads & (loading <= SHORT)), (MOST_STEPS, loads & (loading > SHORT))):
        q[kind], by_n[kind] = _loaded(start[kind], loading[kind], exponent[kind], n_steps)
    left, rate = np.exp(-q), _rate(q, n)[0]
    return Flow(
        value=np.where(loads, -np.expm1(-q), state + unloading),
        by_state=np.where(loads, np.exp(start - q) * rate / _rate(start, n)[0], 1.0),
        by_stretch=np.where(loads | (state >= 0.0), left * rate, 1.0),
        by_exponent=np.where(loads, left * by_n, 0.0),
    )


def _loaded(start: FloatArray, loading: FloatArray, n: FloatArray, n_steps: int) -> tuple[FloatArray, FloatArray]:
    """State variable q after loading and its derivative by n."""
    q, by_n = start, np.zeros_like(start)
    for share in np.diff((np.arange(n_steps + 1) / n_steps) ** GROWTH):
        q, by_n = _runge_kutta(q, by_n, loading * share, n)
    return q, by_n


def _rate(q: FloatArray, n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """g(q) and its derivatives by q and n."""
    left = np.exp(-np.minimum(q, SETTLED))
    log = np.log1p(-np.minimum(left, 1.0 - 1e-16))
    rate = -np.expm1(n * log) / left
    power = np.exp(n * log)
    return rate, rate - n * np.exp((n - 1.0) * log), -power * log / left


def _runge_kutta(q: FloatArray, by_n: FloatArray, step: FloatArray, n: FloatArray) -> tuple[FloatArray, FloatArray]:
    q_slope, n_slope = np.zeros_like(q), np.zeros_like(q)
    q_sum, n_sum = np.zeros_like(q), np.zeros_like(q)
    for share, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        rate, by_q, by_exponent = _rate(q + share * step * q_slope, n)
        n_slope = by_q * (by_n + share * step * n_slope) + by_exponent
        q_slope = rate
        q_sum, n_sum = q_sum + weight * q_slope, n_sum + weight * n_slope
    return q + step / 6.0 * q_sum, by_n + step / 6.0 * n_sum
