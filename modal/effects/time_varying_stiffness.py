"""Time-varying stiffness: a spring that changes steadily while the record runs."""

from dataclasses import dataclass

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Values
from modal.effects.memoryless import memoryless

__all__ = ["TimeVaryingStiffness"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeVaryingStiffness(ForceEffect):
    """Time-varying stiffness f = rate t d, t since the start of each record.

    Warming, wear, a tank that empties: the linear stiffness is that at the start of each record.

    In the data: the gap grows while the record runs and is the same, in proportion, at every level; the resonance
    moves with the time and not with the level; no harmonics of a steady sine.

    Confused with: a wrong linear stiffness (that is its mean over the record: only the change within it tells), and,
    where each record is louder at its end, with any law that grows with the level.

    Parameters: rate [force/(length time)], of either sign.

    References:
        Poulimenos, Fassois, Parametric time-domain methods for non-stationary random vibration modelling and analysis,
        Mech. Syst. Signal Process. 20(4), 2006, doi 10.1016/j.ymssp.2005.10.003.
    """

    key = "time_varying_stiffness"
    law = "f = rate t d"
    parameters = (
        ParameterKind(name="rate", meaning="change of stiffness over time, from the start", dimension=(1, -1, -1)),
    )
    neutral = (0.0,)
    family = "drifting stiffness"
    signature = "the gap grows in time, in proportion the same at every level"
    reference = "Poulimenos, Fassois 2006, doi 10.1016/j.ymssp.2005.10.003"

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        swept = motion.time * motion.displacement
        return memoryless(motion, values[0] * swept, (swept,), by_displacement=values[0] * motion.time)
