"""Does the gap grow, or shrink, in time within the records?

The logarithm of the gap's mean square in each window is fitted by a level for each record, and by a slope, a curvature
and the logarithm of the output's mean square in the window, which all records share: what the output explains is the
excitation's. Only what goes on after the first quarter is growth: a gap that starts from equal states takes the memory
of the structure to build up. A gap that is smallest in the middle is what a parameter that drifts leaves after it was
fitted as a constant.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from modal.localisation.gap_tables import WindowTable
from modal.simulation.tolerances import UNLIKELY
from okid.arrays import FloatArray

__all__ = ["TimeDirection", "TimeTrend", "time_trend"]

TimeDirection = Literal["grows", "falls", "both ends", "steady"]

TIME_FACTOR = 2.0
"""Ratio of mean squares along a record below which nothing is said of it."""
FEWEST_WINDOWS = 6
BUILD_UP = 0.25
"""Share of a record that a gap may take to build up from equal states."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TimeTrend:
    """The gap against time within the records, all outputs together.

    Attributes:
        direction: "grows", "falls", "both ends" (smallest in the middle) or "steady".
        end_ratio: mean square of the gap in the last window over that in the first, for the same output.
        middle_ratio: mean square at the two ends over that in the middle, for the same output.
    """

    direction: TimeDirection
    end_ratio: float
    middle_ratio: float


def time_trend(windows: WindowTable) -> TimeTrend | None:
    """Whether the gap grows within the records; None with fewer than six windows or where one has no gap.

    Args:
        windows: mean squares of gap and output by window.
    """
    gap, output = _pooled(windows)
    n_windows = gap.shape[1]
    if n_windows < FEWEST_WINDOWS or not ((gap > 0.0) & (output > 0.0)).all():
        return None
    whole = _curve(np.log(gap), np.log(output))
    later = slice(round(BUILD_UP * n_windows), None)
    return TimeTrend(
        direction=_direction(whole, _curve(np.log(gap[:, later]), np.log(output[:, later]))),
        end_ratio=float(np.exp(2.0 * whole.slope)),
        middle_ratio=float(np.exp(whole.curvature)),
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Curve:
    """ln gap over a record, place from -1 to 1: slope and curvature, and the bounds that chance keeps them within.

    `rise_from_middle` is the smaller one of how far the first and the last quarter lie above the middle.
    """

    slope: float
    curvature: float
    slope_bound: float
    curvature_bound: float
    rise_from_middle: float


def _curve(gap: FloatArray, output: FloatArray) -> _Curve:
    """`gap` and `output` are (n_records, n_windows) logarithms of mean squares."""
    n_records, n_windows = gap.shape
    place = np.tile(np.linspace(-1.0, 1.0, n_windows), (n_records, 1))
    columns = np.array([place, np.square(place), output])
    centred = columns - columns.mean(axis=2, keepdims=True)
    basis = centred.reshape(3, -1).T
    values = (gap - gap.mean(axis=1, keepdims=True)).ravel()
    inverse = np.linalg.pinv(basis)
    coefficients = inverse @ values
    freedom = max(1, values.size - n_records - 3)
    variance = np.square(values - basis @ coefficients).sum() / freedom
    quantile = scipy.special.stdtrit(freedom, 1.0 - 0.5 * UNLIKELY)
    bounds = quantile * np.sqrt(variance * np.square(inverse).sum(axis=1))
    own = (values.reshape(n_records, n_windows) - coefficients[2] * centred[2]).mean(axis=0)
    outer = max(1, n_windows // 4)
    middle = own[(n_windows - 1) // 2 : n_windows // 2 + 1].mean()
    return _Curve(
        slope=float(coefficients[0]),
        curvature=float(coefficients[1]),
        slope_bound=float(bounds[0]),
        curvature_bound=float(bounds[1]),
        rise_from_middle=float(min(own[:outer].mean(), own[-outer:].mean()) - middle),
    )


def _direction(whole: _Curve, later: _Curve) -> TimeDirection:
    enough = float(np.log(TIME_FACTOR))
    if whole.curvature > whole.curvature_bound and whole.rise_from_middle > enough:
        return "both ends"
    if all(2.0 * curve.slope > max(2.0 * curve.slope_bound, enough) for curve in (whole, later)):
        return "grows"
    return "falls" if -2.0 * whole.slope > max(2.0 * whole.slope_bound, enough) else "steady"


def _pooled(windows: WindowTable) -> tuple[FloatArray, FloatArray]:
    """(n_records, n_windows) mean squares of gap and output, each output relative to its variance in the record."""
    count = windows.n_samples
    variance = (np.nan_to_num(windows.output) * count).sum(axis=1) / np.maximum(count.sum(axis=1), 1)
    moves = variance > 0.0
    size = np.where(moves, variance, 1.0)[:, np.newaxis, :]
    valid = (count > 0) & moves[:, np.newaxis, :]
    number = np.maximum(valid.sum(axis=2), 1)
    gap = np.where(valid, np.nan_to_num(windows.gap) / size, 0.0).sum(axis=2) / number
    output = np.where(valid, np.nan_to_num(windows.output) / size, 0.0).sum(axis=2) / number
    return gap, output
