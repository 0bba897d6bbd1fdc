"""A level that cannot rise above the brim: what comes in beyond it runs off."""

from dataclasses import dataclass

import numpy as np

from modal.discrepancy.effects.effect import Force, ForceEffect, Motion, ParameterKind, Situation, Values
from modal.discrepancy.effects.memoryless import memoryless
from modal.discrepancy.effects.smoothing import positive_part

__all__ = ["Overflow"]

QUANTILES = (0.95, 0.9, 0.8, 0.65)
"""Shares of the samples below the brims to start from."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Overflow(ForceEffect):
    """An outflow that begins where the level exceeds a limit.

    Signature: the measured level is flat at the top, near one value, where the simulated level goes on rising; below
    the brim the simulation is right.

    Law: `q = rate max(h - limit, 0)`, with a large rate; a parabola over limit +- smoothing x scale rounds the corner.

    Parameters: rate [flow / level], not negative; limit [level].

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
    needs = frozenset({"displacement"})
    acts_at = "flow"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """High quantiles of the level."""
        level = situation.motion.displacement
        if level.size == 0:
            return ()
        limits = sorted({float(limit) for limit in np.quantile(level, QUANTILES)}, reverse=True)
        return tuple((1.0, limit) for limit in limits)

    def force(self, values: Values, motion: Motion) -> Force:
        """The overflow and its derivatives: a ramp with a corner of finite width."""
        rate, limit = values
        ramp, slope = positive_part(motion.displacement - limit, motion.smoothing * motion.displacement_scale)
        return memoryless(motion, rate * ramp, (ramp, -rate * slope), by_displacement=rate * slope)
