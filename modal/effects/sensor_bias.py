"""A sensor reads an offset that may drift."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import ParameterKind, SensorEffect, Values
from okid.arrays import FloatArray

__all__ = ["SensorBias"]


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
