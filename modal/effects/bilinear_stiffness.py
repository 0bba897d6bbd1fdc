"""Bilinear stiffness: a spring that is stiffer one way than the other, with a corner at rest."""

from dataclasses import dataclass

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Values
from modal.effects.memoryless import memoryless, positive_part

__all__ = ["BilinearStiffness"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BilinearStiffness(ForceEffect):
    """Bilinear stiffness f = kb max(d, 0).

    Its corner is smoothed to a parabola of half-width smoothing x displacement scale. A breathing crack, a prestress
    that is lost, a one-sided support: the spring has one stiffness closed and another open.

    In the data: even lines and a static shift, and the same relative gap at every level: the law is homogeneous in the
    amplitude, so twice the force gives exactly twice the response; the resonance lies between those of the two
    springs, 2 f1 f2 / (f1 + f2), at every level.

    Confused with: quadratic stiffness (its relative gap grows with the level: two levels tell them apart;
    accelerometers miss the static shift, so never on the screen alone), and with kb / 2 of wrong linear stiffness, of
    which only the even part frees it.

    Parameters: kb [force/length], of either sign (which way is stiffer).

    References:
        Chu, Shen, Analysis of forced bilinear oscillators and the application to cracked beam dynamics, AIAA J. 30(10),
        1992, doi 10.2514/3.11271.
    """

    key = "bilinear_stiffness"
    law = "f = kb max(d, 0)"
    parameters = (ParameterKind(name="kb", meaning="stiffness on the positive side", dimension=(1, -1, 0)),)
    neutral = (0.0,)
    family = "even stiffness"
    has_corners = True
    signature = "even lines, static shift; the same relative gap at every level"
    reference = "Chu, Shen 1992, doi 10.2514/3.11271"

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        positive, slope = positive_part(motion.displacement, motion.smoothing * motion.displacement_scale)
        return memoryless(motion, values[0] * positive, (positive,), by_displacement=values[0] * slope)
