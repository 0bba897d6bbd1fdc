"""A sensor reads too much or too little."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import ParameterKind, SensorEffect, Values
from okid.arrays import FloatArray

__all__ = ["SensorGain"]


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
