"""Where the motion turns round between two samples.

A law with memory depends on the peaks that it has seen. Samples miss them: at 30 samples a cycle by up to 0.5 % of the
amplitude, which is several per cent of the stretch at which a link gives way that is moved ten times that far.
Displacement and velocity at both ends of a step tell the peak to fourth order in the step.
"""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Motion
from okid.arrays import BoolArray, FloatArray

__all__ = ["Turning", "turning_point"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Turning:
    """The displacement at which each step turns round, and its derivatives; that of the start where it does not.

    Attributes:
        turns: (n,) whether the step turns round.
        value: (n,) displacement there.
        by_displacement_before: (n,).
        by_velocity_before: (n,).
        by_displacement_after: (n,).
        by_velocity_after: (n,).
    """

    turns: BoolArray
    value: FloatArray
    by_displacement_before: FloatArray
    by_velocity_before: FloatArray
    by_displacement_after: FloatArray
    by_velocity_after: FloatArray


def turning_point(before: Motion, after: Motion, dt: float) -> Turning:
    """The peak between two samples, where the velocity changes its sign.

    With a velocity linear over the step it vanishes at the share s = v0 / (v0 - v1), and the parabolas from both ends
    have their peaks at d0 + dt v0^2 / (2 (v0 - v1)) and d1 + dt v1^2 / (2 (v0 - v1)); the peak is taken between
    them, weighted by how near each end is, (1 - s) and s. Where displacement and velocity contradict each other, so
    that this is no peak, and at a port without velocity, the step is a straight line.

    Args:
        before: Motion at the start of each step.
        after: Motion at its end.
        dt: Step [s].

    Returns:
        The turning point of each step.
    """
    d0, v0, d1, v1 = before.displacement, before.velocity, after.displacement, after.velocity
    opposed = (np.sign(v0) * np.sign(v1)) < 0.0
    change = np.where(opposed, v0 - v1, 1.0)
    share, rest = np.where(opposed, v0, 0.0) / change, np.where(opposed, -v1, 1.0) / change
    from_start = d0 + 0.5 * dt * share * share * change
    from_end = d1 + 0.5 * dt * rest * rest * change
    value = rest * from_start + share * from_end
    turns = opposed & ((value - d0) * np.sign(v0) > 0.0) & ((value - d1) * np.sign(v0) > 0.0)
    share, rest = np.where(turns, share, 0.0), np.where(turns, rest, 1.0)
    apart = np.where(turns, from_end - from_start, 0.0) / change
    return Turning(
        turns=turns,
        value=np.where(turns, value, d0),
        by_displacement_before=rest,
        by_velocity_before=rest * apart + dt * share * (rest * (1.0 - 0.5 * share) - 0.5 * rest * rest),
        by_displacement_after=share,
        by_velocity_after=share * apart - dt * rest * (share * (1.0 - 0.5 * rest) - 0.5 * share * share),
    )
