"""A law that jumps at zero, x / sqrt(x^2 + width^2), and the straight line that stands for it over a step.

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

from okid.arrays import TINY, FloatArray

__all__ = ["JumpLine", "jump", "jump_line"]

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
