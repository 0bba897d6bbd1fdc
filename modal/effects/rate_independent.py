"""Laws with memory that depend on the way the displacement takes and not on its pace.

Over a straight stretch of the displacement such a law moves its state from z to z' (a `Leg`); a step that turns round
is two stretches, to the turning point and back. The peaks count, and samples miss them: at 30 samples a cycle by up to
0.5 % of the amplitude, which is several per cent of the stretch at which a link gives way that is moved ten times that
far. Displacement and velocity at both ends of a step tell the peak to fourth order in the step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Memory, Motion, Values
from okid.arrays import BoolArray, FloatArray

__all__ = ["Leg", "Turning", "advance_along", "stop_operator", "turning_point"]


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


SETTLED = -float(np.log(np.finfo(float).eps))
"""Stop an exponential approach after so many of its lengths: then its limit is reached to the last digit."""

SHARES = (0.1, 0.3, 0.6, 0.9)
"""Start from lengths at which a law gives way that these shares of the motion stay below."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Leg:
    """The state after a straight stretch of the displacement, and its derivatives.

    Attributes:
        value: (n,).
        by_state: (n,) by the state before.
        by_stretch: (n,) by the change of the displacement.
        by_parameter: (n, n_parameters).
    """

    value: FloatArray
    by_state: FloatArray
    by_stretch: FloatArray
    by_parameter: FloatArray


def stop_operator(
    state: FloatArray, stretch: FloatArray, limit: FloatArray, width: float = 0.0
) -> tuple[Leg, FloatArray]:
    """The stop operator, clip(state + stretch, -limit, limit): a spring in series with a slider.

    Its counterpart, the displacement less the state, is the play operator of half-width `limit`. With a width the
    slider begins to slip that much before the limit, and the state runs into it exponentially, ds/dd = (limit - s) /
    width; turning back, the spring is a spring. Either way the flow is exact over any stretch, however it is split,
    and never produces energy.

    Args:
        state: (n,) stretch of the spring before; beyond the limit it is brought back to it.
        stretch: (n,) change of the displacement.
        limit: (n,) largest stretch of the spring, not negative.
        width: How far before the limit the slider begins to slip; 0: not at all.

    Returns:
        The leg, without parameters, and the derivative (n,) by `limit`.

    Example:
        >>> leg, by_limit = stop_operator(np.array([0.0, 0.5, 0.5]), np.array([0.2, 0.9, -2.0]), np.ones(3))
        >>> leg.value, leg.by_state, by_limit
        (array([ 0.2,  1. , -1. ]), array([1., 0., 0.]), array([ 0.,  1., -1.]))

    References:
        Brokate, Sprekels, Hysteresis and Phase Transitions, Springer 1996, section 2.1, doi 10.1007/978-1-4612-4048-8.
    """
    way = np.where(stretch >= 0.0, 1.0, -1.0)
    outside = np.abs(state) > limit
    start = way * np.clip(state, -limit, limit)
    free = start + np.abs(stretch)
    knee = np.minimum(width, limit)
    onset = np.maximum(start, limit - knee)
    slips = free > onset
    unit = np.where(knee > 0.0, knee, 1.0)
    passed = np.clip(free - onset, 0.0, SETTLED * unit) / unit
    left = np.where(slips, np.where(knee > 0.0, np.exp(-passed), 0.0), 1.0)
    share = np.where(slips, (limit - onset) / unit, 1.0)
    capped = np.where(knee < width, share * passed * left, 0.0)
    by_limit = np.where(slips, way * (1.0 - left - capped), 0.0) + np.where(outside, np.sign(state) * left, 0.0)
    leg = Leg(
        value=way * np.where(slips, limit - (limit - onset) * left, free),
        by_state=np.where(outside, 0.0, left),
        by_stretch=share * left,
        by_parameter=np.zeros((len(state), 0)),
    )
    return leg, by_limit


def advance_along(
    move: Callable[[FloatArray, FloatArray, Sequence[FloatArray]], Leg],
    values: Values,
    before: Motion,
    after: Motion,
    dt: float,
) -> Memory:
    """The one state of a rate-independent law, one sample on.

    Args:
        move: The law: from state (n,), change of the displacement (n,) and values (each (n,)) to the leg.
        values: Values of the effect's parameters.
        before: Motion at the start of each step, with the state in `memory`.
        after: Motion at its end.
        dt: Step [s].

    Returns:
        The state and its derivatives.
    """
    turning = turning_point(before, after, dt)
    state = before.memory[:, 0]
    spread = [np.broadcast_to(np.asarray(value, dtype=np.float64), state.shape) for value in values]
    to_turn = turning.value - before.displacement
    at_turn, by_state, by_stretch = state.copy(), np.ones_like(state), np.zeros_like(state)
    by_parameter = np.zeros((len(state), len(spread)))
    turned = np.flatnonzero(turning.turns)
    if turned.size:
        leg = move(state[turned], to_turn[turned], [value[turned] for value in spread])
        at_turn[turned], by_state[turned], by_stretch[turned] = leg.value, leg.by_state, leg.by_stretch
        by_parameter[turned] = leg.by_parameter
    last = move(at_turn, after.displacement - turning.value, spread)
    by_turn = last.by_state * by_stretch - last.by_stretch
    by_start = by_turn * turning.by_displacement_before - last.by_state * by_stretch
    return Memory(
        value=last.value[:, None],
        by_memory=(last.by_state * by_state)[:, None, None],
        by_displacement_before=by_start[:, None],
        by_velocity_before=(by_turn * turning.by_velocity_before)[:, None],
        by_displacement_after=(by_turn * turning.by_displacement_after + last.by_stretch)[:, None],
        by_velocity_after=(by_turn * turning.by_velocity_after)[:, None],
        by_parameter=(last.by_parameter + last.by_state[:, None] * by_parameter)[:, None, :],
    )
