"""Mean and first moment of the smoothed sign over a step whose velocity moves in a straight line from v0 to v1.

They follow from the law's first and second integrals

    F(v) = sqrt(v^2 + e^2)        S(v) = (v sqrt(v^2 + e^2) + e^2 asinh(v / e)) / 2
    mean = (F1 - F0) / (v1 - v0)  moment = (F1 + F0) / (2 (v1 - v0)) - (S1 - S0) / (v1 - v0)^2

The moment is int (s - 1/2) f ds over the step's share s.
"""

from dataclasses import dataclass

import numpy as np

from okid.arrays import TINY, FloatArray

__all__ = ["PathMoments", "straight_path"]

NEAR = 0.02
"""Rise of the velocity, as a share of its size, below which the quotients would lose digits and a series takes their
place: where the two meet they agree to 2e-9, because a step that ends there must not hop from one to the other."""


@dataclass(frozen=True, slots=True, eq=False)
class PathMoments:
    """Mean and moment of a law over each step, and their slopes by the velocity before and after, (n,) each."""

    mean: FloatArray
    mean_by_before: FloatArray
    mean_by_after: FloatArray
    moment: FloatArray
    moment_by_before: FloatArray
    moment_by_after: FloatArray

    @property
    def parts(self) -> tuple[FloatArray, ...]:
        """All six, in the order above."""
        return (
            self.mean,
            self.mean_by_before,
            self.mean_by_after,
            self.moment,
            self.moment_by_before,
            self.moment_by_after,
        )


def straight_path(before: FloatArray, after: FloatArray, width: float | FloatArray) -> PathMoments:
    """Mean and moment of x / sqrt(x^2 + width^2) over each step.

    Args:
        before: (n,) velocity at the start of each step.
        after: (n,) at its end.
        width: Where the law bends, in the unit of the velocity, one for all or (n,); more than 0.

    Returns:
        Mean, moment and their slopes.

    Example:
        >>> straight_path(np.array([1.0]), np.array([-3.0]), 1e-9).mean.round(6)
        array([-0.5])
    """
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
    exact = (
        mean,
        (mean - value_before) / rise,
        (value_after - mean) / rise,
        moment,
        (value_before / 2.0 + (half + F0 - 2.0 * area) / rise) / rise,
        (value_after / 2.0 - (half + F1 - 2.0 * area) / rise) / rise,
    )
    return PathMoments(*(np.where(near, close, far) for close, far in zip(series, exact, strict=True)))


def _series(middle: FloatArray, rise: FloatArray, width: float | FloatArray) -> tuple[FloatArray, ...]:
    """Mean and moment over a small rise, each followed by its slopes by the velocity before and after."""
    size = np.maximum(np.hypot(middle, width), TINY)
    x, w, r = middle / size, np.square(width / size), rise / size  # f = x, and its derivatives in units of the size
    xx, rr = x * x, r * r
    f1, f2, f3 = w, -3.0 * w * x, w * (12.0 * xx - 3.0 * w)
    f4 = w * x * (45.0 * w - 60.0 * xx)
    mean = x + rr * (f2 / 24.0 + f4 * rr / 1920.0)
    mean_middle, mean_rise = (f1 + f3 * rr / 24.0) / size, r * (f2 / 12.0 + f4 * rr / 480.0) / size
    moment = r * (f1 / 12.0 + f3 * rr / 480.0)
    moment_middle, moment_rise = r * (f2 / 12.0 + f4 * rr / 480.0) / size, (f1 / 12.0 + f3 * rr / 160.0) / size
    return (
        mean,
        0.5 * mean_middle - mean_rise,
        0.5 * mean_middle + mean_rise,
        moment,
        0.5 * moment_middle - moment_rise,
        0.5 * moment_middle + moment_rise,
    )
