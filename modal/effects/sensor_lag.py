"""A sensor follows what it measures late: a thermocouple, a filter in the amplifier, a soft mount."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from modal.effects.actuator_lag import COUNTS, lagged
from modal.effects.effect import Force, Memory, Motion, ParameterKind, SensorEffect, Situation, Values
from okid.arrays import FloatArray

__all__ = ["SensorLag"]

SHORTEST = 1e-3
"""Count a lag as no less than this share of a step: below it the sensor has followed within the step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorLag(SensorEffect):
    """An output behind a first-order lag.

    Signature: the phase of one output lags and its magnitude falls as frequency rises, alike at every level; the other
    outputs are right.

    Law: `tau y'' + y' = y`: the sensor shows y', the output y through 1 / (tau s + 1), from a state of its own at the
    start of each record. Between samples the output is taken as a straight line. Parameters: tau [s], not negative.

    Confused with: a delay; with one input and one output a lag of the actuator, which in a linear structure is the
    same.

    References:
        K. J. Åström, R. M. Murray, Feedback Systems, 2nd ed., 2021 (first-order lag), https://fbswiki.org
    """

    key = "sensor_lag"
    law = "tau dy'/dt + y' = y"
    parameters = (ParameterKind(name="tau", meaning="lag of the sensor", dimension=(0, 0, 1), lower=0.0, role="shape"),)
    neutral = (0.0,)
    family = "lag of a sensor"
    signature = "phase lags and magnitude falls with frequency in one channel, same at every level"
    reference = "Åström, Murray, Feedback Systems, 2nd ed., 2021"
    n_memory = 1

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Lags that double, up to a hundredth of the longest record."""
        return tuple((count * situation.dt,) for count in COUNTS if count * situation.dt <= 0.01 * situation.longest)

    def screen_columns(self, values: Values, output: FloatArray, time: FloatArray) -> FloatArray:
        """What the lag takes from the output, (n, 1)."""
        firsts = np.append(np.flatnonzero(time == 0.0), len(time))
        late = [self.changed(values, output[a:b], time[a:b]) for a, b in pairwise(firsts)]
        return (np.concatenate(late) - output)[:, np.newaxis]

    def changed(self, values: Values, output: FloatArray, time: FloatArray) -> FloatArray:
        """The output of one record behind the lag, from its first value on."""
        if len(time) < 2:
            return output
        left, by_start, by_end = _step(float(values[0]), float(time[1] - time[0]))[0]
        return lagged(float(output[0]), left, by_start * output[:-1] + by_end * output[1:])

    def force(self, values: Values, motion: Motion) -> Force:
        """What the sensor shows less what it should."""
        z, ones = motion.memory[:, 0], np.ones_like(motion.displacement)
        return Force(
            value=z - motion.displacement,
            by_displacement=-ones,
            by_velocity=0.0 * ones,
            by_memory=ones[:, np.newaxis],
            by_parameter=np.zeros((len(ones), len(values))),
        )

    def advance(self, values: Values, before: Motion, after: Motion, dt: float) -> Memory:
        """What the sensor shows one step on."""
        step, slope = _step(float(values[0]), dt)
        seen = np.stack([before.memory[:, 0], before.displacement, after.displacement])
        ones = np.ones((seen.shape[1], 1))
        return Memory(
            value=(step @ seen)[:, np.newaxis],
            by_memory=step[0] * ones[:, :, np.newaxis],
            by_displacement_before=step[1] * ones,
            by_velocity_before=0.0 * ones,
            by_displacement_after=step[2] * ones,
            by_velocity_after=0.0 * ones,
            by_parameter=(slope @ seen)[:, np.newaxis, np.newaxis],
        )


def _step(tau: float, dt: float) -> tuple[FloatArray, FloatArray]:
    """(3,) shares of state, start and end of the output in the state one step on, and their slopes by tau."""
    held = max(tau, SHORTEST * dt)
    r = dt / held
    left, gone = math.exp(-r), -math.expm1(-r)
    by_end, by_end_slope = 1.0 - gone / r, (gone / r - left) / r
    slope = np.array([-left, left - by_end_slope, by_end_slope]) * (-r / held)  # by r, then by tau
    return np.array([left, gone - by_end, by_end]), slope
