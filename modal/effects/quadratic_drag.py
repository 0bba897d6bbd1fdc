"""Quadratic drag: a force against the motion that grows with the square of the velocity."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Values
from modal.effects.memoryless import cut_to_finite, memoryless

__all__ = ["QuadraticDrag"]


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadraticDrag(ForceEffect):
    """Quadratic drag f = c2 v |v|.

    In the data: an odd law in the velocity; damping rises with the level (equivalent damping 8 c2 velocity amplitude
    / (3 pi)), the relative gap grows in proportion to the level, free decays start steep and end slow; a propeller
    speeds up less than its linear model at high input.

    Confused with: Coulomb friction at one weak level (its damping falls with the level), and with viscous damping:
    about a mean speed v0 the law is linear, 2 c2 |v0| (v - v0), and only motion on both sides of it, or several
    speeds, tells.

    Parameters: c2 [force time^2/length^2], not negative.

    References:
        Morison, O'Brien, Johnson, Schaaf, The force exerted by surface waves on piles, J. Petroleum Technology 2(5),
        1950, doi 10.2118/950149-G; Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 3.3, doi
        10.1002/9783527617586.
    """

    key = "quadratic_drag"
    law = "f = c2 v |v|"
    parameters = (ParameterKind(name="c2", meaning="drag coefficient", dimension=(1, -2, 2), lower=0.0),)
    neutral = (0.0,)
    family = "damping"
    signature = "odd lines; damping rises with the level"
    reference = "Morison et al. 1950, doi 10.2118/950149-G"
    needs = frozenset({"velocity"})

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        v = cut_to_finite(motion.velocity)
        speed = np.abs(v)
        square = v * speed
        return memoryless(motion, values[0] * square, (square,), by_velocity=2.0 * values[0] * speed)
