"""A law that jumps at zero, x / sqrt(x^2 + width^2), and the straight line that stands for it over a step.

Where the velocity reverses inside a step, neither end of the step knows when. With v moving in a straight line from v0
to v1, the mean and the first moment of the law over the step follow from its first and second integrals

    F(v) = sqrt(v^2 + e^2)        S(v) = (v sqrt(v^2 + e^2) + e^2 asinh(v / e)) / 2
    mean = (F1 - F0) / (v1 - v0)  moment = (F1 + F0) / (2 (v1 - v0)) - (S1 - S0) / (v1 - v0)^2

and the line from mean - 6 moment to mean + 6 moment has both: impulse and displacement of the step are right.
"""

from dataclasses import dataclass

import numpy as np

from okid.arrays import FloatArray

__all__ = ["JumpLine", "jump", "jump_line"]

NEAR = 0.02
"""Rise of the velocity, as a share of its size, below which the law is straight enough over the step and the
quotients would lose digits."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JumpLine:
    """The line over each step and its slopes, (n,) each.

    Attributes:
        start: Value at the start of the step.
        end: Value at its end.
        start_by_before: Slope of `start` by the velocity at the start of the step.
        start_by_after: Slope of `start` by the velocity at its end.
        end_by_before: Slope of `end` by the velocity at the start of the step.
        end_by_after: Slope of `end` by the velocity at its end.
    """

    start: FloatArray
    end: FloatArray
    start_by_before: FloatArray
    start_by_after: FloatArray
    end_by_before: FloatArray
    end_by_after: FloatArray


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
    size = np.maximum(np.hypot(x, width), 1e-300)
    value = x / size
    return value, (1.0 - value) * (1.0 + value) / size


def jump_line(before: FloatArray, after: FloatArray, width: float | FloatArray) -> JumpLine:
    """The line that stands for the law over each step.

    Args:
        before: (n,) velocity at the start of each step.
        after: (n,) at its end.
        width: Where the law bends, in the unit of the velocity, one for all or (n,); more than 0.

    Returns:
        The line and its slopes.

    Example:
        >>> line = jump_line(np.array([1.0]), np.array([-3.0]), 1e-9)
        >>> (0.5 * (line.start + line.end)).round(6)  # a quarter of the step forwards, three back
        array([-0.5])
    """
    rise = after - before
    middle = 0.5 * (before + after)
    near = np.abs(rise) <= NEAR * np.hypot(middle, width)
    rise = np.where(near, 1.0, rise)
    value_before, _ = jump(before, width)
    value_after, _ = jump(after, width)
    value_middle, slope_middle = jump(middle, width)
    F0, F1 = np.hypot(before, width), np.hypot(after, width)
    S0 = 0.5 * (before * F0 + width**2 * np.arcsinh(before / width))
    S1 = 0.5 * (after * F1 + width**2 * np.arcsinh(after / width))
    mean = np.where(near, value_middle, (F1 - F0) / rise)
    mean_before = np.where(near, 0.5 * slope_middle, (mean - value_before) / rise)
    mean_after = np.where(near, 0.5 * slope_middle, (value_after - mean) / rise)
    half, area = (F1 + F0) / 2.0, (S1 - S0) / rise
    moment = np.where(near, slope_middle * (after - before) / 12.0, (half - area) / rise)
    moment_before = np.where(near, -slope_middle / 12.0, (value_before / 2.0 + (half + F0 - 2.0 * area) / rise) / rise)
    moment_after = np.where(near, slope_middle / 12.0, (value_after / 2.0 - (half + F1 - 2.0 * area) / rise) / rise)
    return JumpLine(
        start=mean - 6.0 * moment,
        end=mean + 6.0 * moment,
        start_by_before=mean_before - 6.0 * moment_before,
        start_by_after=mean_after - 6.0 * moment_after,
        end_by_before=mean_before + 6.0 * moment_before,
        end_by_after=mean_after + 6.0 * moment_after,
    )
