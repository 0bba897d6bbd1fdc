"""Gap spring: one stiffness within a gap, another beyond it (stops, freeplay, backlash)."""

from dataclasses import dataclass

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Situation, Values
from modal.effects.memoryless import levels, memoryless, positive_part

__all__ = ["GapSpring"]

SHARES = (0.2, 0.5, 0.8, 0.95)
"""Start from gaps that these shares of the motion stay within."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GapSpring(ForceEffect):
    """Spring with a symmetric gap: f = k_in d + (k_out - k_in) r(d), r(d) = max(d - gap, 0) - max(-d - gap, 0).

    r is the part of the displacement beyond the gap, with its sign: (|d| - gap) sign(d) outside, 0 inside. Each corner
    is smoothed to a parabola of half-width smoothing x displacement scale, which leaves the law odd at every gap.

    In the data: an odd law. Stops (k_out above k_in): nothing below contact, a resonance that rises from one level on,
    peaks of force cut sharp. Freeplay (k_in far below k_out): a soft, ill-defined resonance at low level that
    stiffens as the level rises; free runs may be chaotic.

    Confused with: cubic stiffness (one level beyond contact and one below tell them apart). A gap that is never reached
    leaves a linear spring, a wrong stiffness; k_in is also a change of the linear stiffness at the place, so where
    that is free too only k_out - k_in and the gap are determined.

    Parameters: k_in [force/length] within the gap, beside the linear stiffness at the place and so negative for
    freeplay in a model that was too stiff there; k_out [force/length] beyond it, not negative; gap [length], not
    negative.

    References:
        Shaw, Holmes, A periodically forced piecewise linear oscillator, J. Sound Vib. 90(1), 1983, doi
        10.1016/0022-460X(83)90407-8.
    """

    key = "gap_spring"
    law = "f = k_in d within the gap, k_in d + (k_out - k_in)(|d| - gap) sign(d) beyond it"
    parameters = (
        ParameterKind(name="k_in", meaning="stiffness within the gap, beside the linear one", dimension=(1, -1, 0)),
        ParameterKind(
            name="k_out", meaning="stiffness beyond the gap, beside the linear one", dimension=(1, -1, 0), lower=0.0
        ),
        ParameterKind(
            name="gap", meaning="displacement at contact, either way", dimension=(0, 1, 0), lower=0.0, role="shape"
        ),
    )
    neutral = (0.0, 0.0, 1.0)
    family = "odd stiffness"
    has_corners = True
    beside_stiffness = ("k_in", "k_out")
    signature = "odd lines; stops: nothing below one level; freeplay: soft at low level, stiff at high"
    reference = "Shaw, Holmes 1983, doi 10.1016/0022-460X(83)90407-8"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """One start for each gap that a share of the motion stays within."""
        return tuple((1.0, 1.0, gap) for gap in levels(situation.motion.displacement, SHARES))

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        k_in, k_out, gap = values
        d = motion.displacement
        width = motion.smoothing * motion.displacement_scale
        above, slope_above = positive_part(d - gap, width)
        below, slope_below = positive_part(-d - gap, width)
        beyond = above - below
        return memoryless(
            motion,
            k_in * (d - beyond) + k_out * beyond,
            (d - beyond, beyond, (k_out - k_in) * (slope_below - slope_above)),
            by_displacement=k_in + (k_out - k_in) * (slope_above + slope_below),
        )
