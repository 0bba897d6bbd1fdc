"""Does the gap grow with the level of the excitation?

With g^2 = (mean square of the gap - floor) / variance of the output, the slope of ln g against ln level tells
laws apart: -1 for a force that stays the same (friction, a disturbance), 0 for what scales with the motion, 1 for a
square law, 2 for a cube. Its uncertainty comes from leaving out one time window after the other (jackknife), which asks
nothing about the colour of the gap, from that of the floor, and from the scatter about the line.

"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from modal.localisation.gap_tables import WindowTable
from modal.simulation.tolerances import SURE
from okid.arrays import FloatArray

__all__ = ["LevelDirection", "LevelTrend", "level_trends"]

LevelDirection = Literal["falls", "rises", "stays", "unknown"]

FLOOR_KNOWN_TO = 0.1
"""Relative uncertainty of a variance that was estimated from a few periods or one band."""
LEAST_DEVIATION = 0.02
"""Of ln g: no gap is known better than that, a law is no exact power either."""
SLOPE_THAT_COUNTS = 0.3
"""A smaller slope is what a wrong parameter shows when the spectrum differs a little from level to level."""
STAYS_WITHIN = 0.5
"""Two deviations beside the slope must lie within this for a gap to stay: half of what the slowest law gives."""
LEAST_OUTPUT_RATIO = 1.5
"""Of the loudest to the quietest output: with less, every gap is nearly of one size."""
SILENT_SHARE = 0.5
"""A level without a gap above the floor tells something when the most that it could hide is below this share."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LevelTrend:
    """The gap above the floor against the level of the excitation.

    Attributes:
        direction: of the relative gap: "falls", "rises", "stays", or "unknown" where the records cannot tell.
        slope: of ln relative gap against ln level; nan where fewer than two levels show a gap.
        slope_std: its standard deviation.
        absolute_slope: of ln absolute gap.
        absolute_slope_std: its standard deviation.
        output_ratio: rms of the output in the loudest record that shows a gap over that in the quietest, 1 without any.
        relative: (n_records,) gap above the floor relative to the output's rms; nan where there is none.
        silent: (n_records,) True where no gap shows above the floor.
    """

    direction: LevelDirection
    slope: float
    slope_std: float
    absolute_slope: float
    absolute_slope_std: float
    output_ratio: float
    relative: FloatArray
    silent: npt.NDArray[np.bool_]

    @property
    def same_absolute_size(self) -> bool:
        """Whether the absolute gap is known to be the same at every level though the output is not."""
        return (
            self.output_ratio > LEAST_OUTPUT_RATIO
            and abs(self.absolute_slope) + 2.0 * self.absolute_slope_std < STAYS_WITHIN
        )


def level_trends(
    windows: WindowTable, floor: FloatArray, levels: FloatArray, numbers: npt.NDArray[np.int64]
) -> tuple[tuple[LevelTrend, ...], LevelTrend]:
    """One trend an output, and that of all outputs together, each relative to its own size.

    Args:
        windows: mean squares of gap and output by window.
        floor: (n_records, n_outputs) variance of the noise.
        levels: (n_records,) size of the excitation.
        numbers: (n_records,) of the level, from 1.
    """
    count = windows.n_samples.astype(float)
    gap, output = np.nan_to_num(windows.gap) * count, np.nan_to_num(windows.output) * count
    own = [
        _level_trend(
            _Sums(gap=gap[..., i], output=output[..., i], count=count[..., i], floor=floor[:, i]), levels, numbers
        )
        for i in range(floor.shape[1])
    ]
    # every output in units of its rms over all records, so that no unit counts more than another
    size = np.maximum(output.sum(axis=(0, 1)) / np.maximum(count.sum(axis=(0, 1)), 1.0), np.finfo(np.float64).tiny)
    together = _Sums(
        gap=(gap / size).sum(axis=2),
        output=(output / size).sum(axis=2),
        count=count.sum(axis=2),
        floor=(floor / size * count.sum(axis=1)).sum(axis=1) / np.maximum(count.sum(axis=(1, 2)), 1.0),
    )
    return tuple(own), _level_trend(together, levels, numbers)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Sums:
    """(n_records, n_windows) sums of squares and numbers of samples, and (n_records,) variance of the noise."""

    gap: FloatArray
    output: FloatArray
    count: FloatArray
    floor: FloatArray


def _level_trend(sums: _Sums, levels: FloatArray, numbers: npt.NDArray[np.int64]) -> LevelTrend:
    tiny = np.finfo(np.float64).tiny
    count = np.maximum(sums.count.sum(axis=1), 1.0)
    size = np.maximum(sums.output.sum(axis=1) / count, tiny)
    above = sums.gap.sum(axis=1) / count - sums.floor
    without = _leave_one_out(sums.gap, sums.count) - sums.floor[:, np.newaxis]
    size_without = np.maximum(_leave_one_out(sums.output, sums.count), tiny)
    shown = above > sums.floor * np.maximum(2.0 * FLOOR_KNOWN_TO, 4.0 * np.sqrt(2.0 / count))
    shown &= (without > 0.0).all(axis=1) & (levels > 0.0) & (size > tiny)
    most = np.maximum(above, 0.0) + SURE * _jackknife(without) + FLOOR_KNOWN_TO * sums.floor
    above, without = np.where(shown, above, 1.0), np.where(shown[:, np.newaxis], without, 1.0)
    by_floor = np.where(shown, 0.5 * FLOOR_KNOWN_TO * sums.floor / above, 0.0)
    relative, absolute = 0.5 * np.log(above / size), 0.5 * np.log(above)
    relative_std = _log_deviation(0.5 * np.log(without / size_without), by_floor)
    absolute_std = _log_deviation(0.5 * np.log(without), by_floor)
    x = np.log(np.where(levels > 0.0, levels, 1.0))[shown]
    slope, slope_std = _line(x, relative[shown], relative_std[shown], numbers[shown])
    absolute_slope, absolute_slope_std = _line(x, absolute[shown], absolute_std[shown], numbers[shown])
    seen = np.where(shown, np.exp(relative), np.nan)
    return LevelTrend(
        direction=_of_slope(slope, slope_std)
        if np.isfinite(slope)
        else _of_silence(seen, np.sqrt(most / size), numbers),
        slope=slope,
        slope_std=slope_std,
        absolute_slope=absolute_slope,
        absolute_slope_std=absolute_slope_std,
        output_ratio=float(np.sqrt(size[shown].max() / size[shown].min())) if shown.any() else 1.0,
        relative=seen,
        silent=~shown,
    )


def _leave_one_out(sums: FloatArray, count: FloatArray) -> FloatArray:
    """(n_records, n_windows) mean without each window."""
    left = np.maximum(count.sum(axis=1, keepdims=True) - count, 1.0)
    result: FloatArray = (sums.sum(axis=1, keepdims=True) - sums) / left
    return result


def _jackknife(values: FloatArray) -> FloatArray:
    """(n_records,) standard deviation of a number from its values without each window."""
    n = values.shape[1]
    result: FloatArray = np.sqrt((n - 1) / n * np.square(values - values.mean(axis=1, keepdims=True)).sum(axis=1))
    return result


def _log_deviation(without_each: FloatArray, by_floor: FloatArray) -> FloatArray:
    result: FloatArray = np.sqrt(np.square(_jackknife(without_each)) + np.square(by_floor) + LEAST_DEVIATION**2)
    return result


def _line(x: FloatArray, y: FloatArray, deviation: FloatArray, numbers: npt.NDArray[np.int64]) -> tuple[float, float]:
    """Slope of a weighted line and its deviation, widened where the points scatter more than they say."""
    if np.unique(numbers).size < 2:
        return np.nan, np.nan
    weight = 1.0 / np.square(deviation)
    centred = x - (weight @ x) / weight.sum()
    spread = float(weight @ np.square(centred))
    slope = float(weight @ (centred * y)) / spread
    left = y - (weight @ y) / weight.sum() - slope * centred
    freedom = x.size - 2
    excess = float(weight @ np.square(left)) / freedom if freedom > 0 else 1.0
    return slope, float(np.sqrt(max(1.0, excess) / spread))


def _of_slope(slope: float, deviation: float) -> LevelDirection:
    if abs(slope) > max(SLOPE_THAT_COUNTS, SURE * deviation):
        return "rises" if slope > 0.0 else "falls"
    return "stays" if abs(slope) + 2.0 * deviation < STAYS_WITHIN else "unknown"


def _of_silence(relative: FloatArray, most: FloatArray, numbers: npt.NDArray[np.int64]) -> LevelDirection:
    """One level alone shows a gap: where the others hide none that could be as large, the direction is certain.

    `most` is the largest relative gap that a record could hide.
    """
    shown = np.isfinite(relative)
    if not shown.any() or shown.all() or float(most[~shown].max()) > SILENT_SHARE * float(relative[shown].min()):
        return "unknown"
    if (numbers[~shown] < numbers[shown].min()).all():
        return "rises"
    return "falls" if (numbers[~shown] > numbers[shown].max()).all() else "unknown"
