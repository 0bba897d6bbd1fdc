"""A force that never changes: weight, a preload, a steady wind."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Values
from modal.effects.memoryless import memoryless

__all__ = ["ConstantForce"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantForce(ForceEffect):
    """A constant force at a place.

    Signature: a gap at zero frequency, of the same absolute size at every level, at one place. An accelerometer does
    not see it but for the transient at the start.

    Law: `f = offset` (opposes positive motion where it is positive). Parameters: offset [force].

    Confused with: the bias of a sensor where one displacement is measured; Coulomb friction where the velocity never
    reverses; the static shift of quadratic stiffness, which grows with the square of the level. A second output, a run
    in the other direction and a second level separate them.

    References:
        K. Worden, G. R. Tomlinson, Nonlinearity in Structural Dynamics, 2001 (a static preload),
        doi 10.1201/9781420033823
    """

    key = "constant_force"
    law = "f = offset"
    parameters = (
        ParameterKind(name="offset", meaning="constant force, positive against positive motion", dimension=(1, 0, 0)),
    )
    neutral = (0.0,)
    family = "offset"
    signature = "zero frequency, same absolute size at every level, at one place"
    reference = "Worden, Tomlinson, Nonlinearity in Structural Dynamics, 2001"
    needs = frozenset()
    acts_at = "force"

    def force(self, values: Values, motion: Motion) -> Force:
        """The offset at every sample; no motion changes it."""
        one = np.ones_like(motion.displacement)
        return memoryless(motion, values[0] * one, (one,))
