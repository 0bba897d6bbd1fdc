"""Slack in hysteresis: lost motion in series with a spring and a slider (a loose joint, a damper with backlash)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.effects.effect import Force, ForceEffect, Limit, Memory, Motion, ParameterKind, Situation, Values
from modal.effects.memoryless import levels, positive_part
from modal.effects.rate_independent import SHARES, Leg, advance_along, stop_operator
from okid.arrays import FloatArray

__all__ = ["SlackInHysteresis"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SlackInHysteresis(ForceEffect):
    """Play of half-width `slack`, a spring k and a slider that slips at k yield_displacement, all in series.

    One force runs through all three and none has mass. Off the slider's position the play takes up to +-slack at no
    force, then the spring stretches, up to +-yield_displacement, then the slider follows. With s the displacement
    from the slider, s moves with the displacement and stops at +-(slack + yield_displacement) (a stop operator),
    and the force is what is left of it beyond the slack:

        s' = clip(s + change of d, +-(slack + yield_displacement)),    f = k (s - clip(s, -slack, slack)).

    So on reversal the force falls to zero within yield_displacement and stays there for 2 slack: the dead zone acts on
    the stop's output. The stop of a play's output is another law: that play holds its end where it was left, as if by
    friction, and the force would stay at its top through the slack. Both steps are exact for a displacement that
    moves in a straight line; the peaks between samples are found (see `turning_point`). A record begins
    at an s no larger than the motion there (`Assembly.largest_own`). Contact
    and slip are smoothed over smoothing x displacement scale (`positive_part`, `stop_operator`).

    In the data: a loop with a flat at zero force, of the same width at every level; where the motion stays within the
    slack, nothing; odd lines.

    Confused with: Coulomb friction and Bouc-Wen hysteresis (no flat), freeplay (a flat but no loop: the spring never
    slips; a record that never slips cannot tell the yield displacement).

    Parameters: k [force/length], yield_displacement [length], slack [length, half of the lost motion]; none negative.

    References:
        Dead zones on the output of stops and plays: Kuhnen, Modeling, identification and compensation of complex
        hysteretic nonlinearities: a modified Prandtl-Ishlinskii approach, Eur. J. Control 9(4), 2003, doi
        10.3166/ejc.9.407-418. A slip-lock element in series with hysteresis: Baber, Noori, Random vibration of
        degrading, pinching systems, J. Eng. Mech. 111(8), 1985, doi 10.1061/(ASCE)0733-9399(1985)111:8(1010). Spring
        and slider: Iwan, A distributed-element model for hysteresis and its steady-state dynamic response, J. Appl.
        Mech. 33(4), 1966, doi 10.1115/1.3625199.
    """

    key = "slack_in_hysteresis"
    law = "f = k (s - clip(s, +-slack)), s = displacement from a slider that slips at |s| = slack + yield_displacement"
    parameters = (
        ParameterKind(name="k", meaning="stiffness of the link", dimension=(1, -1, 0), lower=0.0),
        ParameterKind(
            name="yield_displacement",
            meaning="stretch of the link at which it slips",
            dimension=(0, 1, 0),
            lower=0.0,
            role="shape",
        ),
        ParameterKind(name="slack", meaning="lost motion to either side", dimension=(0, 1, 0), lower=0.0, role="shape"),
    )
    neutral = (0.0, 1.0, 1.0)
    family = "hysteresis"
    signature = "loop with a flat at zero force, of the same width at every level; odd lines"
    reference = "Kuhnen 2003, doi 10.3166/ejc.9.407-418"
    limits = (
        # a link that seldom slips, and one that slips in most cycles
        Limit(law="gap_spring", values=lambda v: (0.0, v[0], v[2]), near=lambda v, size: v[1] + v[2] >= size),
        Limit(law="coulomb_friction", values=lambda v: (v[0] * v[1],), near=lambda v, size: v[1] + v[2] <= size),
    )
    n_memory = 1
    rate_independent = True
    has_corners = True

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """One start for each pair of a yield displacement and a slack."""
        lengths = levels(situation.motion.displacement, SHARES[:3])
        return tuple((1.0, length, slack) for length in lengths for slack in lengths)

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        k, _, slack = values
        s = motion.memory[:, 0]
        width = motion.smoothing * motion.displacement_scale
        above, slope_above = positive_part(s - slack, width)
        below, slope_below = positive_part(-s - slack, width)
        beyond, zeros = above - below, np.zeros_like(s)
        return Force(
            value=k * beyond,
            by_displacement=zeros,
            by_velocity=zeros,
            by_memory=(k * (slope_above + slope_below))[:, None],
            by_parameter=np.stack([beyond, zeros, k * (slope_below - slope_above)], axis=1),
        )

    def advance(self, values: Values, before: Motion, after: Motion, dt: float) -> Memory:
        """The displacement from the slider one sample on."""
        # One width for all samples: that of the quietest record, because a smoother stop would let it creep.
        width = float(np.min(before.smoothing)) * before.displacement_scale

        def move(state: FloatArray, stretch: FloatArray, spread: Sequence[FloatArray]) -> Leg:
            limit = np.maximum(spread[1], 0.0) + np.maximum(spread[2], 0.0)
            leg, by_limit = stop_operator(state, stretch, limit, width)
            return replace(leg, by_parameter=np.stack([np.zeros_like(limit), by_limit, by_limit], axis=1))

        return advance_along(move, values, before, after, dt)
