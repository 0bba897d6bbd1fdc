"""Laws of the velocity: dry friction, friction that holds with more than it slides with, and drag.

Friction jumps at rest: sign(v) is smoothed to v / sqrt(v^2 + width^2), for which a straight line stands over a step.
Where the velocity reverses or sticks inside a step, neither end of the step knows when. Two paths from v0 to v1 tell.

A straight one, right while the law is resolved: mean and first moment of the law follow from its integrals

    F(v) = sqrt(v^2 + e^2)        S(v) = (v sqrt(v^2 + e^2) + e^2 asinh(v / e)) / 2
    mean = (F1 - F0) / (v1 - v0)  moment = (F1 + F0) / (2 (v1 - v0)) - (S1 - S0) / (v1 - v0)^2

The moment is int (s - 1/2) f ds over the step's share s.

That of a constant load, right where friction changes the velocity by c = mobility x size within the step, far more than
the law's width. Between a start v0 > 0 and an end v1 = -b < 0 friction is +1 up to the reversal at the share t and -1
from then on, and the load that leads there gives

    2 c t^2 - (v0 + b + 2 c) t + v0 = 0        mean = 2 t - 1        moment = -t (1 - t)

For an end v1 > 0 the law is 1 all the while, and between the two, at v1 = 0, the mass sticks and the law is whatever
holds it: the mean rises over the law's width as in an implicit Euler step, so that a sticking mass stays where it is.
On a straight path it would ring about zero for ever (mean of the ends: a trapezoidal rule on a stiff law).

The line from mean - 6 moment to mean + 6 moment has both: impulse and displacement of the step are right.
"""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import (
    Force,
    ForceEffect,
    Motion,
    ParameterKind,
    Situation,
    StepForce,
    StepValue,
    Values,
    cut_to_finite,
    least_length,
    levels,
    memoryless,
)
from okid.arrays import TINY, FloatArray

NEAR = 0.02
"""Take a series where the velocity rises by less than this share of its size and the quotients would lose digits: where
the two meet they agree to 2e-9, because a step that ends there must not hop from one to the other."""

RESOLVED = 2.8
"""Count both paths alike at this change of velocity by the law within a step, in widths: the greatest at which no
change makes a sticking mass ring."""

STUCK = 4.0
"""Let a mass that is slower than so many widths stick at the start of a step: there the smoothed sign is 0.97."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JumpLine:
    """The line over each step, and what to add to the law at its start.

    Each is (4, n): the value, then its slopes by the velocity at the start of the step, by that at its end, and by the
    change of velocity that the law makes in a step.

    Attributes:
        start: At the start of the step.
        end: At its end.
        lift: What to add to the law at the start of the step for its value at that moment: while a mass sticks, the
            law at a time is the mean over the step before, and half of the rise to the next one is missing.
    """

    start: FloatArray
    end: FloatArray
    lift: FloatArray


def jump_line(
    before: FloatArray, after: FloatArray, width: float | FloatArray, *, change: float | FloatArray = 0.0
) -> JumpLine:
    """The line that stands for the law over each step.

    Args:
        before: (n,) velocity at the start of each step.
        after: (n,) at its end.
        width: Where the law bends, in the unit of the velocity, one for all or (n,); more than 0.
        change: Velocity that the law takes away in a step, one for all or (n,); at least 0.

    Returns:
        The line and its slopes.

    Example:
        >>> line = jump_line(np.array([1.0]), np.array([-3.0]), 1e-9)
        >>> (0.5 * (line.start + line.end))[0].round(6)  # a quarter of the step forwards, three back
        array([-0.5])
        >>> line = jump_line(np.array([0.1]), np.array([0.0]), 1e-9, change=10.0)  # stops, and sticks without a load
        >>> (0.5 * (line.start + line.end))[0].round(2)
        array([0.])
    """
    path = np.concatenate([_straight(before, after, width), np.zeros((2, 1, len(before)))], axis=1)
    lift = np.zeros((4, len(before)))
    size = np.asarray(change, dtype=float) + np.zeros_like(before)
    if np.any(size > 0.0):
        bend = (RESOLVED * np.asarray(width)) ** 2
        share, share_by_change = size**2 / (size**2 + bend), 2.0 * size * bend / (size**2 + bend) ** 2
        apart = _under_load(before, after, width, size) - path
        path = path + share * apart
        path[:, 3] += share_by_change * apart[:, 0]
        rise = _rise_of_stuck(before, after, width)
        lift[:3], lift[3] = share * rise, share_by_change * rise[0]
    mean, moment = path
    return JumpLine(start=mean - 6.0 * moment, end=mean + 6.0 * moment, lift=lift)


def jump(x: FloatArray, width: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """The smoothed sign of x and its slope.

    Args:
        x: (n,).
        width: Where it bends, in the unit of x, one for all or (n,); 0: the sign itself, with slope 0.

    Returns:
        Value and slope, (n,) each.

    Example:
        >>> jump(np.array([-3.0, 0.0, 3.0]), 0.0)[0]
        array([-1.,  0.,  1.])
        >>> jump(np.array([0.0, 4.0]), 3.0)[0]
        array([0. , 0.8])
    """
    if not np.any(np.asarray(width) > 0.0):
        return np.sign(x), np.zeros_like(x)
    size = np.maximum(np.hypot(x, width), TINY)
    value = x / size
    return value, (1.0 - value) * (1.0 + value) / size


def _straight(before: FloatArray, after: FloatArray, width: float | FloatArray) -> FloatArray:
    """Mean and moment on a straight path, (2, 3, n): each with its slopes by the velocity before and after."""
    rise = after - before
    middle = 0.5 * (before + after)
    near = np.abs(rise) <= NEAR * np.hypot(middle, width)
    series = _series(middle, rise, width)
    rise = np.where(near, 1.0, rise)
    F0, F1 = np.hypot(before, width), np.hypot(after, width)
    value_before, value_after = before / np.maximum(F0, TINY), after / np.maximum(F1, TINY)
    S0 = 0.5 * (before * F0 + width**2 * np.arcsinh(before / width))
    S1 = 0.5 * (after * F1 + width**2 * np.arcsinh(after / width))
    half, area = (F1 + F0) / 2.0, (S1 - S0) / rise
    mean, moment = (F1 - F0) / rise, (half - area) / rise
    exact = [
        [mean, (mean - value_before) / rise, (value_after - mean) / rise],
        [
            moment,
            (value_before / 2.0 + (half + F0 - 2.0 * area) / rise) / rise,
            (value_after / 2.0 - (half + F1 - 2.0 * area) / rise) / rise,
        ],
    ]
    return np.where(near, series, exact)


def _series(middle: FloatArray, rise: FloatArray, width: float | FloatArray) -> list[list[FloatArray]]:
    """The same over a small rise."""
    size = np.maximum(np.hypot(middle, width), TINY)
    x, w, r = middle / size, np.square(width / size), rise / size  # f = x, and its derivatives in units of the size
    xx, rr = x * x, r * r
    f1, f2, f3 = w, -3.0 * w * x, w * (12.0 * xx - 3.0 * w)
    f4 = w * x * (45.0 * w - 60.0 * xx)
    mean = x + rr * (f2 / 24.0 + f4 * rr / 1920.0)
    mean_middle, mean_rise = (f1 + f3 * rr / 24.0) / size, r * (f2 / 12.0 + f4 * rr / 480.0) / size
    moment = r * (f1 / 12.0 + f3 * rr / 480.0)
    moment_middle, moment_rise = r * (f2 / 12.0 + f4 * rr / 480.0) / size, (f1 / 12.0 + f3 * rr / 160.0) / size
    return [
        [mean, 0.5 * mean_middle - mean_rise, 0.5 * mean_middle + mean_rise],
        [moment, 0.5 * moment_middle - moment_rise, 0.5 * moment_middle + moment_rise],
    ]


def _under_load(before: FloatArray, after: FloatArray, width: float | FloatArray, change: FloatArray) -> FloatArray:
    """Mean and moment under a constant load, (2, 4, n): as on a straight path, with the slope by the change.

    `ahead`: velocity at the end in the direction of the start.
    """
    direction = np.where(before < 0.0, -1.0, 1.0)
    start, ahead = np.abs(before), direction * after
    sign, slope = jump(ahead, width)
    forward, forward_by = 0.5 * (1.0 + sign), 0.5 * slope
    back, back_by = 0.5 * (np.hypot(ahead, width) - ahead), 0.5 * (sign - 1.0)
    total = start + back + 2.0 * change
    root = np.sqrt(np.maximum((start - 2.0 * change) ** 2 + back**2 + 2.0 * back * (start + 2.0 * change), TINY))
    t = 2.0 * start / (total + root)
    t_start, t_back, t_change = (1.0 - t) / root, -t / root, -2.0 * t * (1.0 - t) / root
    behind, lever = 1.0 - forward, 1.0 - 2.0 * t
    return np.array(
        [
            [
                direction * (2.0 * forward * (1.0 - t) + 2.0 * t - 1.0),
                2.0 * behind * t_start,
                2.0 * forward_by * (1.0 - t) + 2.0 * behind * t_back * back_by,
                direction * 2.0 * behind * t_change,
            ],
            [
                -direction * behind * t * (1.0 - t),
                -behind * lever * t_start,
                forward_by * t * (1.0 - t) - behind * lever * t_back * back_by,
                -direction * behind * lever * t_change,
            ],
        ]
    )


def _rise_of_stuck(before: FloatArray, after: FloatArray, width: float | FloatArray) -> FloatArray:
    """Half of the law's rise over the step where the mass sticks at its start, and its slopes, (3, n)."""
    sign_before, slope_before = jump(before, width)
    sign_after, slope_after = jump(after, width)
    reach = np.square(before / (STUCK * np.asarray(width)))
    stuck = 1.0 / (1.0 + reach**2)
    stuck_by = -4.0 * stuck**2 * reach * before / (STUCK * np.asarray(width)) ** 2
    rise = 0.5 * (sign_after - sign_before)
    return np.array([stuck * rise, stuck_by * rise - 0.5 * stuck * slope_before, 0.5 * stuck * slope_after])


@dataclass(frozen=True, slots=True, kw_only=True)
class CoulombFriction(ForceEffect):
    """Coulomb (dry) friction f = Fc sign(v).

    Smoothed to Fc v / sqrt(v^2 + width^2) with width = smoothing x velocity scale (see `jump`).

    In the data: an odd law in the velocity; damping falls with the level (a force that stays Fc while all others
    grow: equivalent damping 4 Fc / (pi velocity amplitude)), free decays end on a straight line rather than an
    exponential, flat tops where the motion sticks; the loop of force over displacement is a rectangle of area
    4 Fc amplitude.

    Confused with: quadratic drag (its relative gap rises with the level, that of friction falls: one weak level alone
    can hardly tell), viscous damping at one level, a constant force where the velocity never reverses, and an
    elastoplastic link (which gives way elastically before it slips).

    Parameters: Fc [force], not negative.

    References:
        Feeny, Liang, A decrement method for the simultaneous estimation of Coulomb and viscous friction, J. Sound Vib.
        195(1), 1996, doi 10.1006/jsvi.1996.0411; Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models,
        analysis tools and compensation methods for the control of machines with friction, Automatica 30(7), 1994,
        doi 10.1016/0005-1098(94)90209-7.
    """

    key = "coulomb_friction"
    law = "f = Fc sign(v)"
    parameters = (ParameterKind(name="Fc", meaning="friction force", dimension=(1, 0, 0), lower=0.0),)
    neutral = (0.0,)
    family = "damping"
    signature = "odd lines; damping falls with the level"
    reference = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    needs = frozenset({"velocity"})

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        sign, slope = jump(motion.velocity, motion.smoothing * motion.velocity_scale)
        return memoryless(motion, values[0] * sign, (sign,), by_velocity=values[0] * slope)

    def step_force(self, values: Values, before: Motion, after: Motion) -> StepForce | None:
        """The line over each step with the force's own mean and moment: a reversal counts from when it happens."""
        width = before.smoothing * before.velocity_scale
        if not np.all(np.asarray(width) > 0.0):
            return None
        size, mobility = values[0], before.mobility
        line = jump_line(before.velocity, after.velocity, width, change=size * mobility)

        def part(line: FloatArray) -> StepValue:
            return StepValue(
                value=size * line[0],
                by_before=size * line[1],
                by_after=size * line[2],
                by_parameter=(line[0] + size * mobility * line[3])[:, None],
            )

        return StepForce(start=part(line.start), end=part(line.end), lift=part(line.lift))


SHARES = (0.1, 0.3, 0.6)
"""Start from the speeds below which the mass moves for these shares of the time: below the least friction is breakaway
only, above the greatest it never falls to the end."""
_POINTS, _WEIGHTS = (part.copy() for part in np.polynomial.legendre.leggauss(4))
_POINTS, _WEIGHTS = 0.5 * (_POINTS + 1.0), 0.5 * _WEIGHTS


@dataclass(frozen=True, slots=True, kw_only=True)
class StribeckFriction(ForceEffect):
    """Dry friction with a breakaway force above the sliding one.

    In the data: as dry friction, but a mass that stops needs more to break loose than to go on; at low levels stick and
    slip, a damping that is negative where friction falls.

    Law: `f = (Fc + excess exp(-(v / stribeck_velocity)^2)) sign(v)`. Parameters: Fc [force] while sliding, excess
    [force] of the breakaway force over it, stribeck_velocity [velocity] at which it is down to 37 %; none negative.

    Confused with: Coulomb friction, its limit without an excess; where the velocity never comes near rest the excess
    does not show.

    References:
        Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation methods for the
        control of machines with friction, Automatica 30(7), 1994, doi 10.1016/0005-1098(94)90209-7 (equation 4).
    """

    key = "stribeck_friction"
    law = "f = (Fc + excess exp(-(v / stribeck_velocity)^2)) sign(v)"
    parameters = (
        ParameterKind(name="Fc", meaning="friction force while sliding", dimension=(1, 0, 0), lower=0.0),
        ParameterKind(name="excess", meaning="breakaway force less that", dimension=(1, 0, 0), lower=0.0),
        ParameterKind(
            name="stribeck_velocity",
            meaning="speed at which the excess is down to 37 %",
            dimension=(0, 1, -1),
            lower=0.0,
            role="shape",
        ),
    )
    neutral = (0.0, 0.0, 1.0)
    family = "friction"
    signature = "odd lines; damping falls with the level, stick and slip at low ones"
    reference = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    needs = frozenset({"velocity"})
    limits = ("coulomb_friction",)

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Speeds below which the mass moves for a part of the time."""
        return tuple((1.0, 1.0, speed) for speed in levels(situation.motion.velocity, SHARES))

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        sign, slope = jump(motion.velocity, motion.smoothing * motion.velocity_scale)
        fallen, by_speed, by_width = _fallen(motion.velocity, values[2], motion.velocity_scale)
        return memoryless(
            motion,
            (values[0] + values[1]) * sign - values[1] * fallen,
            (sign, sign - fallen, -values[1] * by_width),
            by_velocity=(values[0] + values[1]) * slope - values[1] * by_speed,
        )

    def step_force(self, values: Values, before: Motion, after: Motion) -> StepForce | None:
        """The line of dry friction of the breakaway size, less that of what the force falls by along the step."""
        width = before.smoothing * before.velocity_scale
        if not np.all(np.asarray(width) > 0.0):
            return None
        size, mobility, excess = values[0] + values[1], before.mobility, values[1]
        line = jump_line(before.velocity, after.velocity, width, change=size * mobility)
        ahead = _POINTS[:, None]
        speeds = (1.0 - ahead) * before.velocity + ahead * after.velocity
        fallen, by_speed, by_width = _fallen(speeds, values[2], before.velocity_scale)

        def part(line: FloatArray, weights_of: FloatArray) -> StepValue:
            weights = weights_of[:, None]
            by_size = line[0] + size * mobility * line[3]
            drop = np.sum(weights * fallen, axis=0)
            by_drop = -excess * np.sum(weights * by_width, axis=0)
            return StepValue(
                value=size * line[0] - excess * drop,
                by_before=size * line[1] - excess * np.sum(weights * (1.0 - ahead) * by_speed, axis=0),
                by_after=size * line[2] - excess * np.sum(weights * ahead * by_speed, axis=0),
                by_parameter=np.stack([by_size, by_size - drop, by_drop], axis=1),
            )

        tilt = 6.0 * (_POINTS - 0.5)
        return StepForce(
            start=part(line.start, _WEIGHTS * (1.0 - tilt)),
            end=part(line.end, _WEIGHTS * (1.0 + tilt)),
            lift=part(line.lift, 0.0 * tilt),
        )


def _fallen(velocity: FloatArray, speed: float | FloatArray, scale: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What friction falls by, sign(v) (1 - exp(-(v / speed)^2)), and its slopes by velocity and speed."""
    width = np.maximum(speed, least_length(scale))
    x = cut_to_finite(velocity) / width
    left = np.exp(-np.square(x))
    by_x = 2.0 * np.abs(x) * left
    return np.sign(x) * -np.expm1(-np.square(x)), by_x / width, -x * by_x / width


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadraticDrag(ForceEffect):
    """Quadratic drag f = c2 v |v|.

    In the data: an odd law in the velocity; damping rises with the level (equivalent damping 8 c2 velocity amplitude
    / (3 pi)), the relative gap grows in proportion to the level, free decays start steep and end slow; a propeller
    speeds up less than its linear model at high input.

    Confused with: Coulomb friction at one weak level (its damping falls with the level), and with viscous damping:
    about a mean speed v0 the law is linear, 2 c2 |v0| (v - v0), and only motion on both sides of it, or several
    speeds, tells.

    Parameters: c2 [force time^2/length^2], not negative.

    References:
        Morison, O'Brien, Johnson, Schaaf, The force exerted by surface waves on piles, J. Petroleum Technology 2(5),
        1950, doi 10.2118/950149-G; Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 3.3, doi
        10.1002/9783527617586.
    """

    key = "quadratic_drag"
    law = "f = c2 v |v|"
    parameters = (ParameterKind(name="c2", meaning="drag coefficient", dimension=(1, -2, 2), lower=0.0),)
    neutral = (0.0,)
    family = "damping"
    signature = "odd lines; damping rises with the level"
    reference = "Morison et al. 1950, doi 10.2118/950149-G"
    needs = frozenset({"velocity"})

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        v = cut_to_finite(motion.velocity)
        speed = np.abs(v)
        square = v * speed
        return memoryless(motion, values[0] * square, (square,), by_velocity=2.0 * values[0] * speed)
