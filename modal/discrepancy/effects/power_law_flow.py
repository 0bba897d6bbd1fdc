"""An outflow that goes with a power of the level: the square root of a free outlet."""

from dataclasses import dataclass

import numpy as np

from modal.discrepancy.effects.effect import Force, ForceEffect, Motion, ParameterKind, Situation, Values
from modal.discrepancy.effects.memoryless import memoryless
from modal.discrepancy.effects.smoothing import within_reach

__all__ = ["PowerLawFlow"]

EXPONENTS = (0.5, 1.5, 2.0)
"""A free outlet, a weir, and a turbulent inflow."""
CORNER = 1e-12
"""Least rounding of the corner at zero level, as a share of the scale: the slope |h|^(exponent - 1) stays finite."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerLawFlow(ForceEffect):
    """Outflow by a power of the level, less the linear outflow that it replaces.

    Signature: at low level the tank empties faster than a line through the mean says (exponent below 1), at high level
    slower; the time constant depends on the level.

    Law: with h the level and h_s its standard deviation over the records,

        q = coefficient (h_s (|h| / h_s)^exponent sign(h) - h)

    which is what a flow by the power of the level has beyond one in proportion to it; the linear outflow stays a
    parameter of the model. The corner at h = 0 is rounded: |h| becomes sqrt(h^2 + (smoothing h_s)^2).

    Parameters: coefficient [flow / level], not negative; exponent [-], 0.05 to 3.

    Confused with: an overflow, where the level is high most of the time (both let out more or less at the top: the
    overflow is sharp); a wrong linear outflow, where the level hardly moves about its mean. Levels from nearly empty to
    nearly full separate them.

    References:
        M. Schoukens, J. P. Noël, Three benchmarks addressing open challenges in nonlinear system identification,
        IFAC-PapersOnLine 50(1), 2017, 446-451, doi 10.1016/j.ifacol.2017.08.071 (cascaded tanks: Bernoulli's square
        root).
    """

    key = "power_law_flow"
    law = "q = coefficient (h_s |h / h_s|^exponent sign(h) - h)"
    parameters = (
        ParameterKind(name="coefficient", meaning="flow by level at the level h_s", dimension=(1, -1, 0), lower=0.0),
        ParameterKind(
            name="exponent", meaning="power of the level", dimension=(0, 0, 0), lower=0.05, upper=3.0, role="shape"
        ),
    )
    neutral = (0.0, 0.5)
    family = "flow"
    signature = "time constant changes with the level"
    reference = "Schoukens, Noël, IFAC-PapersOnLine 50(1), 2017, doi 10.1016/j.ifacol.2017.08.071"
    needs = frozenset({"displacement"})
    acts_at = "flow"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:  # noqa: ARG002 - powers have no scale
        """Square root, three halves, square."""
        return tuple((1.0, exponent) for exponent in EXPONENTS)

    def force(self, values: Values, motion: Motion) -> Force:
        """The flow and its derivatives, rounded where the level is zero."""
        coefficient, exponent = values
        scale = motion.displacement_scale if motion.displacement_scale > 0.0 else 1.0
        x = within_reach(motion.displacement / scale)
        size = np.hypot(x, np.maximum(motion.smoothing, CORNER))
        factor = size ** (exponent - 1.0)
        power = x * factor
        by_level = factor * (1.0 + (exponent - 1.0) * (x / size) ** 2)
        excess = scale * (power - x)
        by_exponent = coefficient * scale * power * np.log(size)
        slope = coefficient * (by_level - 1.0)
        return memoryless(motion, coefficient * excess, (excess, by_exponent), by_displacement=slope)
