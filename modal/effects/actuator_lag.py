"""The drive follows its command late: a coil's inductance, a valve, a filter in the output stage.

Over a step the input goes straight from a to b. The lagging drive z obeys tau z' = u - z: with r = dt / tau and the
time s in steps,

    z(s) = a + (b - a) (s - 1/r) + c exp(-r s),     c = z(0) - a + (b - a) / r

It is replaced by the straight line with its mean and its first moment over the step, as a delayed drive is, so that the
state at the end of the step is right but for (dt x pole)^2 of what is not straight in it.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from modal.effects.effect import InputEffect, ParameterKind, Situation, Values
from okid.arrays import FloatArray

__all__ = ["ActuatorLag", "lagged"]

COUNTS = (0.3, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Start from these lags, in steps: each doubles the phase of the one before."""
FADED = math.log(1e3)
"""Count what a drive was before its record as gone after so many lags: a thousandth of it is left."""
STEEPEST = 1e-6
"""Take a lag below this share of a step for none: the response to a step is over within it."""


def lagged(first: float, share: float, forcing: FloatArray) -> FloatArray:
    """The z of z[k+1] = share z[k] + forcing[k], (n + 1,), from z[0] = first.

    Example:
        >>> lagged(1.0, 0.5, np.array([0.0, 1.0]))
        array([1.  , 0.5 , 1.25])
    """
    band = np.ones((2, len(forcing) + 1))
    band[1] = -share
    found, _ = scipy.linalg.lapack.dtbtrs(band, np.concatenate([[first], forcing]), uplo="L", diag="U")
    return np.asarray(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class ActuatorLag(InputEffect):
    """The drive behind a first-order lag.

    Signature: the phase of every output lags and its magnitude falls as frequency rises, alike at every level and in
    every output that this input drives.

    Law: `tau u'' + u' = u`: the drive u' is the command u through 1 / (tau s + 1). Parameters: tau [s], not negative.
    What the drive was before a record is not known: what a record shows within seven lags of its start is not judged,
    unless it starts without any drive.

    Confused with: a delay, whose phase goes on in proportion to frequency and which leaves the magnitude; with one
    input and one output a lag of the sensor, which in a linear structure is the same.

    References:
        K. J. Åström, R. M. Murray, Feedback Systems, 2nd ed., 2021 (first-order lag), https://fbswiki.org

    Example:
        >>> u = np.array([0.0, 1.0, 1.0, 1.0])
        >>> ActuatorLag().at_samples([1.0], u, u, u, 1.0).round(3)
        array([0.   , 0.   , 0.632, 0.865])
    """

    key = "actuator_lag"
    law = "tau du'/dt + u' = u"
    parameters = (ParameterKind(name="tau", meaning="lag of the drive", dimension=(0, 0, 1), lower=0.0, role="shape"),)
    neutral = (0.0,)
    family = "lag"
    signature = "phase lags and magnitude falls with frequency, same at every level"
    reference = "Åström, Murray, Feedback Systems, 2nd ed., 2021"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Lags that double, up to a hundredth of the longest record."""
        return tuple((count * situation.dt,) for count in COUNTS if count * situation.dt <= 0.01 * situation.longest)

    def apply(self, values: Values, start: FloatArray, end: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """Start and end of the line with the lagging drive's mean and first moment over each step."""
        z = self.at_samples(values, start, start, end, dt)
        if not _lags(values, dt):
            return start, end
        r = dt / float(values[0])
        rest = z - start + (end - start) / r
        gone = -math.expm1(-r)
        area, lever = gone / r, (gone - r * math.exp(-r)) / r**2 - 0.5 * gone / r
        mean = start + (end - start) * (0.5 - 1.0 / r) + area * rest
        moment = (end - start) / 12.0 + lever * rest
        return mean - 6.0 * moment, mean + 6.0 * moment

    def at_samples(
        self, values: Values, sample: FloatArray, start: FloatArray, end: FloatArray, dt: float
    ) -> FloatArray:
        """The lagging drive at each time, from the first value of the command on."""
        if not _lags(values, dt) or start.size == 0:
            return sample
        r = dt / float(values[0])
        left = math.exp(-r)
        by_end = 1.0 + math.expm1(-r) / r
        return lagged(float(start[0]), left, ((1.0 - left - by_end) * start + by_end * end)[:-1])

    def unheard(self, values: Values, dt: float) -> tuple[int, int]:
        """As many times at the start as the drive before it takes to fade."""
        return math.ceil(FADED * float(values[0]) / dt), 0


def _lags(values: Values, dt: float) -> bool:
    return float(values[0]) > STEEPEST * dt
