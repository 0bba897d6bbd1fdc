"""What a sensor does to what it measures: gain, an offset that may drift, a zero of each record, a lag."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from modal.effects.effect import Force, Memory, Motion, ParameterKind, SensorEffect, Situation, Values
from modal.effects.inputs import lag_starts, lagged
from okid.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorGain(SensorEffect):
    """One output times a factor; 1 is no effect, and the derivative by the gain is the output itself.

    Signature: one channel is the simulated one times a factor, at every frequency and level; the other channels are
    right.

    Law: `y' = gain y`. Parameters: gain [-], the factor itself.

    Confused with: with one degree of freedom the gain of the input and the scale of the mass, damping and stiffness
    together (they are one number). A second output separates them: its gap is zero where the sensor is to blame.

    References:
        D. J. Ewins, Modal Testing: Theory, Practice and Application, 2nd ed., 2000 (calibration by the ratio of
        two outputs).

    Example:
        >>> SensorGain().gain([0.9])
        0.9
    """

    key = "sensor_gain"
    law = "y' = gain y"
    parameters = (ParameterKind(name="gain", meaning="factor on the output, 1 for none", dimension=(0, 0, 0)),)
    neutral = (1.0,)
    family = "sensor gain"
    signature = "flat ratio in one channel, same at every level"
    reference = "Ewins, Modal Testing, 2nd ed., 2000"
    like_a_mass = True

    def gain(self, values: Values) -> float | FloatArray:
        """The factor."""
        return values[0]

    def by_parameter(self, values: Values, output: FloatArray, time: FloatArray) -> FloatArray:  # noqa: ARG002 - linear
        """The true output, (n, 1)."""
        return np.asarray(output)[:, np.newaxis]


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorBias(SensorEffect):
    """An offset and a drift on one output.

    Signature: a gap at zero frequency in one output, of the same absolute size at every level; the drift grows in time
    from the start of each record.

    Law: `y' = y + offset + slope t`. Parameters: offset [output], slope [output / s].

    Confused with: a constant force, where one displacement is measured (a static force moves several outputs in the
    proportions of the flexibility; a bias moves one). A second output separates them, and an accelerometer's offset can
    be nothing but bias.

    References:
        J. S. Bendat, A. G. Piersol, Random Data, 4th ed., 2010 (offsets and linear trends of transducers),
        doi 10.1002/9781118032428

    Example:
        >>> SensorBias().offset([2.0, 0.5], np.array([0.0, 1.0, 4.0]))
        array([2. , 2.5, 4. ])
    """

    key = "sensor_bias"
    law = "y' = y + offset + slope t"
    parameters = (
        ParameterKind(name="offset", meaning="what is added at the start of a record", dimension=(1, 0, 0)),
        ParameterKind(name="slope", meaning="drift of the offset in time", dimension=(1, 0, -1)),
    )
    neutral = (0.0, 0.0)
    family = "offset"
    signature = "zero frequency in one channel, same absolute size at every level"
    reference = "Bendat, Piersol, Random Data, 4th ed., 2010"

    def offset(self, values: Values, time: FloatArray) -> FloatArray:
        """The offset and the drift, (n,)."""
        return values[0] + values[1] * time

    def by_parameter(self, values: Values, output: FloatArray, time: FloatArray) -> FloatArray:  # noqa: ARG002 - linear in both
        """Ones and the time, (n, 2)."""
        return np.stack([np.ones_like(time), time], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOffset(SensorEffect):
    """An offset of one output that each record has for itself.

    Signature: a gap at zero frequency in one output, constant along each record, another one in each.

    Law: `y' = y + offset`, with an offset of its own in each record. Parameters: offset [output].

    Confused with: a bias or a constant force, which are the same in all records and so need fewer numbers; a hysteretic
    link that never gives way, where its slip at the start were free in each record.

    References:
        J. S. Bendat, A. G. Piersol, Random Data, 4th ed., 2010 (zero shifts of transducers),
        doi 10.1002/9781118032428

    Example:
        >>> RecordOffset().offset([2.0], np.array([0.0, 1.0]))
        array([2., 2.])
    """

    key = "record_offset"
    law = "y' = y + offset, another one in each record"
    parameters = (ParameterKind(name="offset", meaning="what is added to a record", dimension=(1, 0, 0), local=True),)
    neutral = (0.0,)
    family = "offset of a record"
    signature = "zero frequency in one channel, another size in each record"
    reference = "Bendat, Piersol, Random Data, 4th ed., 2010"
    contains = ("sensor_bias", "constant_force")

    def offset(self, values: Values, time: FloatArray) -> FloatArray:
        """The offset, (n,)."""
        return values[0] + np.zeros_like(time)

    def by_parameter(self, values: Values, output: FloatArray, time: FloatArray) -> FloatArray:  # noqa: ARG002 - linear
        """Ones, (n, 1)."""
        return np.ones((len(time), 1))


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
        """As of every lag."""
        return lag_starts(situation)

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
