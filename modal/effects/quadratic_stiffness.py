"""Quadratic stiffness: a spring that is stiffer one way than the other, smoothly."""

from dataclasses import dataclass

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Values
from modal.effects.memoryless import cut_to_finite, memoryless

__all__ = ["QuadraticStiffness"]


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadraticStiffness(ForceEffect):
    """Quadratic stiffness f = k2 d^2.

    In the data: an even law, so a sine at f answers at 2 f and at zero frequency, even lines fill up, and the mean
    shifts against the sign of k2 with the square of the level; the relative gap grows in proportion to the level.

    Confused with: bilinear stiffness (also even, but its relative gap is the same at every level: two levels tell
    them apart; accelerometers miss the static shift, so never on the screen alone), and with a spring preloaded off
    the centre of a cubic law, of which it is one part.

    Parameters: k2 [force/length^2], of either sign (which way is stiffer).

    References:
        Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 2.3, doi 10.1002/9783527617586; the Silverbox needs it
        beside its cubic spring: Wigren, Schoukens, Three free data sets for development and benchmarking in nonlinear
        system identification, ECC 2013, doi 10.23919/ECC.2013.6669201.
    """

    key = "quadratic_stiffness"
    law = "f = k2 d^2"
    parameters = (ParameterKind(name="k2", meaning="quadratic stiffness", dimension=(1, -2, 0)),)
    neutral = (0.0,)
    family = "even stiffness"
    signature = "even lines, second harmonic, static shift that grows with the square of the level"
    reference = "Nayfeh, Mook 1979, doi 10.1002/9783527617586"

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        d = cut_to_finite(motion.displacement)
        square = d * d
        return memoryless(motion, values[0] * square, (square,), by_displacement=2.0 * values[0] * d)
