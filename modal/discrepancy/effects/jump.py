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
"""Rise of the velocity, as a share of its size, below which the quotients would lose digits and a series takes their
place: where the two meet they agree to 1e-9, because a step that ends there must not hop from one to the other."""


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
    series = _series(middle, rise, width)
    rise = np.where(near, 1.0, rise)
    value_before, _ = jump(before, width)
    value_after, _ = jump(after, width)
    F0, F1 = np.hypot(before, width), np.hypot(after, width)
    S0 = 0.5 * (before * F0 + width**2 * np.arcsinh(before / width))
    S1 = 0.5 * (after * F1 + width**2 * np.arcsinh(after / width))
    half, area = (F1 + F0) / 2.0, (S1 - S0) / rise
    mean, moment = (F1 - F0) / rise, (half - area) / rise
    exact = (
        mean,
        (mean - value_before) / rise,
        (value_after - mean) / rise,
        moment,
        (value_before / 2.0 + (half + F0 - 2.0 * area) / rise) / rise,
        (value_after / 2.0 - (half + F1 - 2.0 * area) / rise) / rise,
    )
    mean, mean_before, mean_after, moment, moment_before, moment_after = (
        np.where(near, close, far) for close, far in zip(series, exact, strict=True)
    )
    return JumpLine(
        start=mean - 6.0 * moment,
        end=mean + 6.0 * moment,
        start_by_before=mean_before - 6.0 * moment_before,
        start_by_after=mean_after - 6.0 * moment_after,
        end_by_before=mean_before + 6.0 * moment_before,
        end_by_after=mean_after + 6.0 * moment_after,
    )


def _series(middle: FloatArray, rise: FloatArray, width: float | FloatArray) -> tuple[FloatArray, ...]:
    """Mean and moment over a small rise, each followed by its slopes by the velocity before and after."""
    size, bend = np.maximum(np.hypot(middle, width), 1e-300), np.square(width)
    x, w = middle / size, bend / size**2  # f = x, and its derivatives in units of the size
    f1, f2, f3 = w / size, -3.0 * w * x / size**2, w * (12.0 * x**2 - 3.0 * w) / size**3
    f4 = w * x * (45.0 * w - 60.0 * x**2) / size**4
    mean = x + f2 * rise**2 / 24.0 + f4 * rise**4 / 1920.0
    mean_middle, mean_rise = f1 + f3 * rise**2 / 24.0, f2 * rise / 12.0 + f4 * rise**3 / 480.0
    moment = f1 * rise / 12.0 + f3 * rise**3 / 480.0
    moment_middle, moment_rise = f2 * rise / 12.0 + f4 * rise**3 / 480.0, f1 / 12.0 + f3 * rise**2 / 160.0
    return (
        mean,
        0.5 * mean_middle - mean_rise,
        0.5 * mean_middle + mean_rise,
        moment,
        0.5 * moment_middle - moment_rise,
        0.5 * moment_middle + moment_rise,
    )
