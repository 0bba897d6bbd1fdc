"""The drive is stronger or weaker than the record says."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import InputEffect, ParameterKind, Values
from okid.arrays import FloatArray

__all__ = ["InputGain"]


@dataclass(frozen=True, slots=True, kw_only=True)
class InputGain(InputEffect):
    """The drive times a factor; 1 is no effect, and the derivative by the gain is the drive itself.

    Signature: the output is the simulated one times a factor, the same at every frequency, level and output that this
    input drives.

    Law: `u' = gain u`. Parameters: gain [-], the factor itself.

    Confused with: with one degree of freedom the gain of the sensor and the scale of the mass, damping and stiffness
    together (they are one number); a saturation seen at one level only. Several outputs separate it from the gain of a
    sensor, several inputs from the scale of the mass, several levels from a saturation.

    References:
        K. Worden, G. R. Tomlinson, Nonlinearity in Structural Dynamics, 2001 (homogeneity: a gain keeps it, so that no
        level tells it from a linear model), doi 10.1201/9781420033823

    Example:
        >>> InputGain().apply([0.5], np.array([2.0]), np.array([4.0]), 0.01)
        (array([1.]), array([2.]))
    """

    key = "input_gain"
    law = "u' = gain u"
    parameters = (ParameterKind(name="gain", meaning="factor on the drive, 1 for none", dimension=(0, 0, 0)),)
    neutral = (1.0,)
    family = "input gain"
    signature = "flat ratio at every frequency and level"
    reference = "Worden, Tomlinson, Nonlinearity in Structural Dynamics, 2001"
    like_a_mass = True

    def apply(self, values: Values, start: FloatArray, end: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002 - a gain needs no time
        """Start and end of each step times the gain."""
        gain = float(values[0])
        return gain * start, gain * end

    def by_parameter(
        self,
        values: Values,  # noqa: ARG002 - linear
        sample: FloatArray,
        start: FloatArray,
        end: FloatArray,
        dt: float,  # noqa: ARG002 - a gain needs no time
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The drive itself."""
        return start[np.newaxis], end[np.newaxis], sample[np.newaxis]
