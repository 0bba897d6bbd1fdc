"""A sensor's zero that moves between records: mounted anew, warmed up, balanced anew."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import ParameterKind, SensorEffect, Values
from okid.arrays import FloatArray

__all__ = ["RecordOffset"]


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
