"""An outflow that goes with a power of the level: the square root of a free outlet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Situation, Values
from modal.effects.memoryless import SHORTEST, cut_to_finite, memoryless
from okid.arrays import FloatArray

__all__ = ["PowerLawFlow"]

EXPONENTS = (0.5, 1.5, 2.0)
"""Start from these powers: a free outlet, a weir, and a turbulent inflow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerLawFlow(ForceEffect):
    """Outflow by a power of the level, in place of a linear outflow.

    Signature: at low level the tank empties faster than a line through the mean says (exponent below 1), at high level
    slower; the time constant depends on the level.

    Law: with h the level,

        q = coefficient |h|^exponent sign(h) - linear h

    which is the flow by the power of the level less a linear outflow that the model has and the tank does not. The
    flow at one level, the power and what is taken back are three numbers, so that the law is the same in every unit and
    on every record. Where the linear outflow of the model is a parameter itself, only its difference to `linear` can be
    told. The corner at h = 0 is rounded, so that the slope stays finite: |h| becomes sqrt(h^2 + (smoothing scale)^2).

    Parameters: coefficient [flow, at a level of 1], not negative; exponent [-], 0.05 to 3; linear [flow / level], not
    negative.

    Confused with: an overflow, where the level is high most of the time (both let out more or less at the top: the
    overflow is sharp); a wrong linear outflow, where the level hardly moves about its mean. Levels from nearly empty to
    nearly full separate them.

    References:
        M. Schoukens, J. P. Noël, Three benchmarks addressing open challenges in nonlinear system identification,
        IFAC-PapersOnLine 50(1), 2017, 446-451, doi 10.1016/j.ifacol.2017.08.071 (cascaded tanks: Bernoulli's square
        root).
    """

    key = "power_law_flow"
    law = "q = coefficient |h|^exponent sign(h) - linear h"
    parameters = (
        ParameterKind(name="coefficient", meaning="flow at a level of 1", dimension=(1, 0, 0), lower=0.0),
        ParameterKind(
            name="exponent", meaning="power of the level", dimension=(0, 0, 0), lower=0.05, upper=3.0, role="shape"
        ),
        ParameterKind(
            name="linear", meaning="linear outflow that it replaces", dimension=(1, -1, 0), lower=0.0, role="shape"
        ),
    )
    neutral = (0.0, 0.5, 0.0)
    family = "flow"
    signature = "time constant changes with the level"
    reference = "Schoukens, Noël, IFAC-PapersOnLine 50(1), 2017, doi 10.1016/j.ifacol.2017.08.071"
    acts_at = "flow"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Square root, three halves, square; each less the line that comes nearest to it over the levels met."""
        return tuple((1.0, power, _nearest_line(situation.motion.displacement, power)) for power in EXPONENTS)

    def screen_columns(self, values: Values, motion: Motion) -> FloatArray:
        """The whole flow at the exponent and line in `values`: both grow together."""
        return self.force(values, motion).value[:, None]

    def from_screen(self, values: Values, weights: Sequence[float] | FloatArray) -> tuple[float, ...]:
        """Coefficient and line `weights[0]` times as large, not negative."""
        size = max(float(weights[0]), 0.0)
        return (size * float(values[0]), float(values[1]), size * float(values[2]))

    def force(self, values: Values, motion: Motion) -> Force:
        """The flow and its derivatives, rounded where the level is zero."""
        coefficient, exponent, linear = values
        h = cut_to_finite(motion.displacement)
        scale = motion.displacement_scale if motion.displacement_scale > 0.0 else 1.0
        size = np.hypot(h, np.maximum(motion.smoothing, SHORTEST) * scale)
        factor = size ** (exponent - 1.0)
        power = h * factor
        by_level = factor * (1.0 + (exponent - 1.0) * (h / size) ** 2)
        return memoryless(
            motion,
            coefficient * power - linear * h,
            (power, coefficient * power * np.log(size), -h),
            by_displacement=coefficient * by_level - linear,
        )


def _nearest_line(level: FloatArray, exponent: float) -> float:
    """Slope of the line through the origin that comes nearest to the power of the levels."""
    h = np.abs(cut_to_finite(level))
    square = float(h @ h)
    return float(h @ h**exponent) / square if square > 0.0 else 1.0
