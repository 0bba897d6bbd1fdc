"""Hysteresis: laws with memory that depend on the way the displacement takes and not on its pace.

Over a straight stretch of the displacement such a law moves its state from z to z' (a `Leg`); a step that turns round
is two stretches, to the turning point and back. The peaks count, and samples miss them: at 30 samples a cycle by up to
0.5 % of the amplitude, which is several per cent of the stretch at which a link gives way that is moved ten times that
far. Displacement and velocity at both ends of a step tell the peak to fourth order in the step.

Bouc-Wen: over a straight stretch of the displacement, in units of the yield displacement and with the sign of the
motion taken out, the state s follows

    ds/dh = 1 - s^n  for s > 0 (loading),      ds/dh = 1  for s < 0 (unloading)

over the stretch h >= 0. Unloading is exact. Loading, s runs into 1 exponentially; q = -ln(1 - s) makes of it
dq/dh = g(q) = (1 - s^n) / (1 - s), which stays between 1 and n: smooth, never stiff, and s never leaves its bound.
Since g depends on q alone, every loading is a piece of one curve, that from s = 0: the stretch H(q; n) = int dq / g,
tabulated once for an exponent, takes q0 to the q1 with H(q1) = H(q0) + h, however long the stretch.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.effects.effect import (
    Force,
    ForceEffect,
    Memory,
    Motion,
    ParameterKind,
    Situation,
    Values,
    least_length,
    levels,
    positive_part,
)
from okid.arrays import BoolArray, FloatArray


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


STEP, REACH = 0.02, 20.0
"""Cut the table in q into such cells up to this end: beyond it g is n to the eighth digit. Between the nodes cubics
follow the curve to 1e-6 for n up to 10."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Flow:
    """The state after the stretch and its derivatives, (n_samples,) each.

    Attributes:
        value: State after the stretch, in units of the yield displacement.
        by_state: By the state before.
        by_stretch: By the stretch.
        by_exponent: By n.
    """

    value: FloatArray
    by_state: FloatArray
    by_stretch: FloatArray
    by_exponent: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Curve:
    """Loading from s = 0 for one exponent, cell by cell of q = 0, STEP, ..., REACH, in powers of the share of a cell.

    Attributes:
        stretch: H at the nodes.
        forward: (8, n_cells) coefficients of H over q, then of its derivative by n.
        backward: (4, n_cells) coefficients of q over H.
        last: Slopes of H and of its derivative by n beyond the last node.
    """

    stretch: FloatArray
    forward: FloatArray
    backward: FloatArray
    last: tuple[float, float]


def bouc_wen_flow(state: FloatArray, stretch: FloatArray, n: FloatArray) -> Flow:
    """The flow over `stretch` (n_samples,) >= 0 from `state` (n_samples,) in [-1, 1], for the exponent n >= 1.

    Example:
        >>> found = bouc_wen_flow(np.array([-0.5, 0.0]), np.array([0.3, 1.0]), np.array([2.0, 2.0]))
        >>> found.value.round(4)  # -0.5 + 0.3 and tanh(1)
        array([-0.2   ,  0.7616])
    """
    unloading = np.minimum(stretch, np.maximum(-state, 0.0))
    loading = stretch - unloading
    loads = stretch > unloading
    begun = np.clip(state, 0.0, 1.0 - np.exp(-SETTLED))
    start = -np.log1p(-begun)
    exponent = np.broadcast_to(n, start.shape)
    if exponent.size and (exponent == exponent[0]).all():
        q, by_n = _loaded(start, loading, float(exponent[0]))
    else:
        q, by_n = np.empty_like(start), np.empty_like(start)
        for one in np.unique(exponent):
            kind = exponent == one
            q[kind], by_n[kind] = _loaded(start[kind], loading[kind], float(one))
    left = np.minimum(np.exp(-q), BELOW_ONE)
    to_yield, from_start = (
        -np.expm1(exponent * np.log1p(-rest)) for rest in (left, np.minimum(1.0 - begun, BELOW_ONE))
    )  # 1 - s^n
    return Flow(
        value=np.where(loads, 1.0 - left, state + unloading),
        by_state=np.where(loads, to_yield / from_start, 1.0),
        by_stretch=np.where(loads | (state >= 0.0), to_yield, 1.0),
        by_exponent=np.where(loads, to_yield * by_n, 0.0),
    )


def _loaded(start: FloatArray, loading: FloatArray, n: float) -> tuple[FloatArray, FloatArray]:
    """State variable q after loading, and its derivative by n in units of g(q)."""
    curve = _curve(n)
    stretch, before = _at(curve, start)
    target = stretch + loading
    cell = np.clip(np.searchsorted(curve.stretch, target, side="right") - 1, 0, curve.backward.shape[1] - 1)
    share = np.minimum((target - curve.stretch[cell]) / (curve.stretch[1:] - curve.stretch[:-1])[cell], 1.0)
    beyond = np.maximum(target - curve.stretch[-1], 0.0) / curve.last[0]
    q = np.minimum(_cubic(curve.backward.take(cell, axis=1), share) + beyond, SETTLED)
    return q, before - _at(curve, q)[1]


def _at(curve: _Curve, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """H at q and its derivative by n."""
    inside = np.where(q >= 0.0, q, 0.0)  # a motion that has escaped is not a number, and stays so
    cell = np.minimum(inside / STEP, curve.forward.shape[1] - 1).astype(np.intp)
    share, beyond = np.minimum(q / STEP - cell, 1.0), np.maximum(q - REACH, 0.0)
    found = curve.forward.take(cell, axis=1)
    return (_cubic(found[:4], share) + beyond * curve.last[0], _cubic(found[4:], share) + beyond * curve.last[1])


@functools.lru_cache(maxsize=64)
def _curve(n: float) -> _Curve:
    nodes: FloatArray = STEP * np.arange(round(REACH / STEP) + 1, dtype=np.float64)
    # Gauss points integrate the first cell to 1e-7 for n below 2, the others to 1e-12
    points, weights = np.polynomial.legendre.leggauss(3)
    inside = nodes[:-1, None] + 0.5 * STEP * (1.0 + points)
    (slope, by_n), cells = _slope(nodes, n), [0.5 * STEP * values @ weights for values in _slope(inside, n)]
    stretch, stretch_by_n = (np.concatenate([[0.0], np.cumsum(cell)]) for cell in cells)
    width = np.diff(stretch)
    return _Curve(
        stretch=stretch,
        forward=np.concatenate(
            [
                _coefficients(stretch, STEP * slope[:-1], STEP * slope[1:]),
                _coefficients(stretch_by_n, STEP * by_n[:-1], STEP * by_n[1:]),
            ]
        ),
        backward=_coefficients(nodes, width / slope[:-1], width / slope[1:]),
        last=(float(slope[-1]), float(by_n[-1])),
    )


def _coefficients(values: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Cubics (4, n_cells) through the values at the nodes, with these slopes at both ends of each cell."""
    rise = np.diff(values)
    return np.stack([values[:-1], begin, 3.0 * rise - 2.0 * begin - end, begin + end - 2.0 * rise])


def _cubic(coefficients: FloatArray, share: FloatArray) -> FloatArray:
    a, b, c, d = coefficients
    return np.asarray(a + share * (b + share * (c + share * d)))


def _slope(q: FloatArray, n: float) -> tuple[FloatArray, FloatArray]:
    """1 / g(q) and its derivative by n."""
    left = np.exp(-q)
    log = np.log1p(-np.minimum(left, BELOW_ONE))
    whole = -np.expm1(n * log)
    return left / whole, left * np.exp(n * log) * log / whole**2


BELOW_ONE = 1.0 - float(np.finfo(float).epsneg)
"""Stop just below one, where the logarithm of what is left has no value."""
SHARPEST = 10.0
"""Hold n below this: beyond it the law is elastoplastic to the eye and n cannot be found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoucWenHysteresis(ForceEffect):
    """Bouc-Wen hysteresis f = a z, z' = v (1 - (1 + sign(v z)) / 2 |z / yield_displacement|^n).

    The state z follows the displacement while it turns back, and gives way as it nears +-yield_displacement, which it
    never passes: the smoother the smaller n; n to infinity is a spring a in series with a slider of force
    a yield_displacement. The law is independent of pace, so z moves with the displacement and the peaks between
    samples are found (see `turning_point`). A record begins at a z no larger than the
    motion there (`Assembly.largest_own`).

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
    limits = ("coulomb_friction",)
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
        shortest = least_length(before.displacement_scale)

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
    limits = ("gap_spring", "coulomb_friction")  # a link that seldom slips, and one that slips in most cycles
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
