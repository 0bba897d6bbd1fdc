"""The drive cannot exceed a limit: an amplifier, valve or motor at its end."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import InputEffect, ParameterKind, Situation, Values
from okid.arrays import FloatArray

__all__ = ["InputSaturation"]

SHARES = (0.9, 0.7, 0.5, 0.3)
"""Start from these shares of the largest drive of all records: of a random drive (largest about 3.5 standard
deviations) they clip from one sample in 600 to one in three."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InputSaturation(InputEffect):
    """The drive clipped at plus and minus a limit.

    Signature: nothing at low level; above a level the output stays behind the simulation, most where the drive is
    highest; odd harmonics of the drive.

    Law: `u' = min(max(u, -limit), limit)`, taken at both ends of each step. Parameters: limit [input], not
    negative.

    Confused with: an input gain below 1, where every record is far above the limit or only one level was measured;
    Coulomb friction or drag at the driven place. One level below the limit separates it from a gain, and the loss in
    saturation follows the drive alone, not the motion.

    References:
        K. J. Åström, R. M. Murray, Feedback Systems, 2nd ed., 2021 (saturation of actuators and its describing
        function).

    Example:
        >>> u = np.array([-3.0, 0.5, 2.0])
        >>> InputSaturation().apply([1.0], u, u, 0.01)[0]
        array([-1. ,  0.5,  1. ])
    """

    key = "input_saturation"
    law = "u' = min(max(u, -limit), limit)"
    parameters = (
        ParameterKind(
            name="limit", meaning="largest drive of either sign", dimension=(1, 0, 0), lower=0.0, role="shape"
        ),
    )
    neutral = (np.inf,)
    family = "input gain"
    signature = "nothing at low level, output stays behind at high level"
    reference = "Åström, Murray, Feedback Systems, 2nd ed., 2021"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Shares of the largest drive; none for a drive that is zero."""
        peak = float(np.max(np.abs(situation.motion.displacement), initial=0.0))
        return tuple((share * peak,) for share in SHARES) if peak > 0.0 else ()

    def apply(self, values: Values, start: FloatArray, end: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002 - clipping needs no time
        """Start and end of each step, clipped."""
        limit = abs(float(values[0]))
        return np.clip(start, -limit, limit), np.clip(end, -limit, limit)

    def by_parameter(
        self,
        values: Values,
        sample: FloatArray,
        start: FloatArray,
        end: FloatArray,
        dt: float,  # noqa: ARG002 - clipping needs no time
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The sign of the drive where it is clipped, 0 elsewhere."""
        limit = abs(float(values[0]))

        def sign(drive: FloatArray) -> FloatArray:
            return np.where(np.abs(drive) > limit, np.sign(drive), 0.0)[np.newaxis]

        return sign(start), sign(end), sign(sample)
