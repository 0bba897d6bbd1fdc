"""Bouc-Wen hysteresis: a spring that gives way smoothly and keeps what it gave."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.effects.bouc_wen_flow import bouc_wen_flow
from modal.effects.effect import Force, ForceEffect, Memory, Motion, ParameterKind, Situation, Values
from modal.effects.levels import levels
from modal.effects.rate_independent import Leg, advance_along
from okid.arrays import FloatArray

__all__ = ["BoucWenHysteresis"]

SHARES = (0.1, 0.3, 0.6, 0.9)
"""Shares of the motion that stay below the yield displacements to start from."""
SHARPEST = 10.0
"""Greatest n: beyond it the law is elastoplastic to the eye and n cannot be found."""
SHORTEST = 1e-12
"""Least yield displacement, as a share of the displacement scale: a friction that gives way at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoucWenHysteresis(ForceEffect):
    """Bouc-Wen hysteresis f = a z, z' = v (1 - (1 + sign(v z)) / 2 |z / yield_displacement|^n).

    The state z follows the displacement while it turns back, and gives way as it nears +-yield_displacement, which it
    never passes: the smoother the smaller n; n to infinity is a spring a in series with a slider of force
    a yield_displacement. The law is independent of pace, so z moves with the displacement and the peaks between
    samples are found (see `turning_point`). It starts at z = 0 unless told otherwise.

    In the data: a loop of force over displacement whose area is damping; the resonance falls with the level (the
    spring a is lost) and the damping first rises, then falls; odd lines.

    Confused with: Coulomb friction (yield_displacement far below the motion: only small motion shows the spring before
    slip), a linear spring (far above it), slack_in_hysteresis (its loop has a flat at zero force).

    Parameters: a [force/length], not negative; yield_displacement [length], not negative; n [-], 1 to 10. The record
    must pass the yield displacement, or only a is determined, as a wrong stiffness.

    References:
        Wen, Method for random vibration of hysteretic systems, J. Eng. Mech. Div. 102(2), 1976, doi
        10.1061/JMCEA3.0002106, with beta = gamma = 1 / (2 yield_displacement^n), which never produces energy: Ismail,
        Ikhouane, Rodellar, The hysteresis Bouc-Wen model, a survey, Arch. Comput. Methods Eng. 16, 2009, doi
        10.1007/s11831-009-9031-8.
    """

    key = "bouc_wen_hysteresis"
    law = "f = a z, z' = v (1 - (1 + sign(v z))/2 |z/yield_displacement|^n)"
    parameters = (
        ParameterKind(name="a", meaning="stiffness before yield", dimension=(1, -1, 0), lower=0.0),
        ParameterKind(
            name="yield_displacement", meaning="bound of the state", dimension=(0, 1, 0), lower=0.0, role="shape"
        ),
        ParameterKind(
            name="n", meaning="sharpness of the knee", dimension=(0, 0, 0), lower=1.0, upper=SHARPEST, role="shape"
        ),
    )
    neutral = (0.0, 1.0, 2.0)
    family = "hysteresis"
    signature = "loop; softens with the level, damping rises then falls; odd lines"
    reference = "Wen 1976, doi 10.1061/JMCEA3.0002106"
    n_memory = 1
    rate_independent = True

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """One start for each yield displacement that a share of the motion stays below."""
        return tuple((1.0, length, 2.0) for length in levels(situation.motion.displacement, SHARES))

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        z = motion.memory[:, 0]
        zeros = np.zeros_like(z)
        return Force(
            value=values[0] * z,
            by_displacement=zeros,
            by_velocity=zeros,
            by_memory=(values[0] + zeros)[:, None],
            by_parameter=np.stack([z, zeros, zeros], axis=1),
        )

    def advance(self, values: Values, before: Motion, after: Motion, dt: float) -> Memory:
        """The state z one sample on."""
        shortest = max(SHORTEST * before.displacement_scale, 1e-200)

        def move(state: FloatArray, stretch: FloatArray, spread: Sequence[FloatArray]) -> Leg:
            return _move(state, stretch, np.maximum(spread[1], shortest), np.clip(spread[2], 1.0, SHARPEST))

        return advance_along(move, values, before, after, dt)


def _move(state: FloatArray, stretch: FloatArray, limit: FloatArray, n: FloatArray) -> Leg:
    forward = np.where(stretch >= 0.0, 1.0, -1.0)
    from_bound = np.clip(state / limit, -1.0, 1.0)  # a Newton step may have left the bound
    length = np.abs(stretch) / limit
    flow = bouc_wen_flow(forward * from_bound, length, n)
    by_limit = forward * (flow.value - length * flow.by_stretch) - from_bound * flow.by_state
    inside = np.abs(state) <= limit
    return Leg(
        value=forward * limit * flow.value,
        by_state=np.where(inside, flow.by_state, 0.0),
        by_stretch=flow.by_stretch,
        by_parameter=np.stack(
            [
                np.zeros_like(limit),
                by_limit + np.where(inside, 0.0, from_bound * flow.by_state),
                forward * limit * flow.by_exponent,
            ],
            axis=1,
        ),
    )
