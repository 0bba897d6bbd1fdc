"""Laws of a level: an outflow with a power of it, and a brim that it cannot rise above."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.effects.effect import (
    SHORTEST,
    WALL,
    Force,
    ForceEffect,
    Motion,
    ParameterKind,
    Situation,
    StepForce,
    StepValue,
    Values,
    cut_to_finite,
    memoryless,
    positive_part,
    share_of_end,
)
from okid.arrays import FloatArray

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


QUANTILES = (0.95, 0.9, 0.8, 0.65)
"""Start from brims that these shares of the samples stay below."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Overflow(ForceEffect):
    """An outflow that begins where the level exceeds a limit.

    Signature: the measured level is flat at the top, near one value, where the simulated level goes on rising; below
    the brim the simulation is right.

    Law: `q = rate max(h - limit, 0)`, with a large rate; a parabola over limit +- smoothing x scale rounds the corner,
    over less where the rate is large for a step of the simulation: what the level does within a step is then as smooth
    as with a soft brim, and the level at which a full tank stands is not blurred.

    Parameters: rate [flow / level], not negative; limit [level]. Of a brim as hard as a wall any large rate does: only
    the limit is known then, and a rate that no step of the simulation can tell from a wall's is held there.

    Confused with: the saturation of the pump (the loss then follows the drive, not the level); the saturation of the
    level sensor (the level downstream is then right); a power-law outflow, where the level only just reaches the brim.

    References:
        M. Schoukens, J. P. Noël, Three benchmarks addressing open challenges in nonlinear system identification,
        IFAC-PapersOnLine 50(1), 2017, 446-451, doi 10.1016/j.ifacol.2017.08.071 (cascaded tanks: overflow).
    """

    key = "overflow"
    law = "q = rate max(h - limit, 0)"
    parameters = (
        ParameterKind(name="rate", meaning="flow by level above the limit", dimension=(1, -1, 0), lower=0.0),
        ParameterKind(name="limit", meaning="level at which it begins", dimension=(0, 1, 0), role="shape"),
    )
    neutral = (0.0, 0.0)
    family = "flow"
    signature = "level flat at the top"
    reference = "Schoukens, Noël, IFAC-PapersOnLine 50(1), 2017, doi 10.1016/j.ifacol.2017.08.071"
    acts_at = "flow"
    is_brim = True

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """High quantiles of the level."""
        level = situation.motion.displacement
        if level.size == 0:
            return ()
        limits = sorted({float(limit) for limit in np.quantile(level, QUANTILES)}, reverse=True)
        return tuple((1.0, limit) for limit in limits)

    def force(self, values: Values, motion: Motion) -> Force:
        """The overflow and its derivatives: a ramp with a corner of finite width."""
        (rate, softer), limit = _told(values[0], motion), values[1]
        hardness = 1.0 + rate * motion.step_compliance
        width = motion.smoothing * motion.displacement_scale / hardness
        ramp, slope = positive_part(motion.displacement - limit, width)
        narrower = -width * motion.step_compliance / hardness * slope * (1.0 - slope)
        by_rate = softer * (ramp + rate * narrower)
        return memoryless(motion, rate * ramp, (by_rate, -rate * slope), by_displacement=rate * slope)

    def step_force(self, values: Values, before: Motion, after: Motion) -> StepForce | None:
        """The line over each step, with more of its end the harder the brim: the level neither rings nor escapes."""
        if before.step_compliance <= 0.0:
            return None
        rate, softer = _told(values[0], before)
        share, stiffer = share_of_end(rate * before.step_compliance)
        start, end = self.force(values, before), self.force(values, after)
        of_start, of_end = 2.0 - 2.0 * share, 2.0 * share - 1.0
        by_parameter = np.expand_dims(of_start, -1) * start.by_parameter + np.expand_dims(of_end, -1) * end.by_parameter
        by_parameter[:, 0] += 2.0 * stiffer * softer * before.step_compliance * (end.value - start.value)
        return StepForce(
            start=StepValue(
                value=of_start * start.value + of_end * end.value,
                by_before=of_start * start.by_displacement,
                by_after=of_end * end.by_displacement,
                by_parameter=by_parameter,
            ),
            end=StepValue(
                value=end.value,
                by_before=np.zeros_like(end.value),
                by_after=end.by_displacement,
                by_parameter=end.by_parameter,
            ),
            reads="displacement",
        )


def _told(rate: float | FloatArray, motion: Motion) -> tuple[float | FloatArray, float | FloatArray]:
    """The rate as far as a step can tell it from that of a wall, and its slope: 1 / rate plus that of a wall."""
    share = 1.0 / (1.0 + rate * motion.step_compliance / WALL)
    return rate * share, share**2
