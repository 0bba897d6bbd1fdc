"""How far a simulation is from the measurement: by record and output, frequency band, time window and level.

The gap is measured minus simulated, its mean included: a static error is an error.

In time: the logarithm of the gap's mean square in each window is fitted by a level for each record, and by a slope, a
curvature and the logarithm of the output's mean square in the window, which all records share: what the output explains
is the excitation's. Only what goes on after the first quarter is growth: a gap that starts from equal states takes the
memory of the structure to build up. A gap that is smallest in the middle is what a parameter that drifts leaves after
it was fitted as a constant.

With level: with g^2 = (mean square of the gap - floor) / variance of the output, the slope of ln g against ln level
tells laws apart: -1 for a force that stays the same (friction, a disturbance), 0 for what scales with the motion, 1 for
a square law, 2 for a cube. Its uncertainty comes from leaving out one time window after the other (jackknife), which
asks nothing about the colour of the gap, from that of the floor, and from the scatter about the line.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy

from modal.localisation.bands import BandTable, CellTable, WindowTable, octave_bands, spectral_tables, window_table
from modal.simulation import SURE, UNLIKELY
from okid.arrays import ROUNDED, FloatArray
from okid.errors import InvalidDataError
from okid.record import Record
from okid.rows import as_records

TimeDirection = Literal["grows", "falls", "both ends", "steady"]

BEYOND_CHANCE = 4.0
"""Believe a change, a line or a gap by more standard deviations than this: many are looked at."""
TIME_FACTOR = 2.0
"""Say nothing of a ratio of mean squares along a record below this."""
BUILD_UP = 0.25
"""Let a gap take this share of a record to build up from equal states."""


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
    """Whether the gap grows within the records; None with fewer than six windows or where one has no gap."""
    gap, output = _pooled(windows)
    n_windows = gap.shape[1]
    if n_windows < 6 or not ((gap > 0.0) & (output > 0.0)).all():
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


LevelDirection = Literal["falls", "rises", "stays", "unknown"]

FLOOR_KNOWN_TO = 0.1
"""Expect this relative error of a variance that was estimated from a few periods or one band."""
LEAST_DEVIATION = 0.02
"""Give ln g at least this deviation: no gap is known better, a law is no exact power either."""
SLOPE_THAT_COUNTS = 0.3
"""Ignore a smaller slope: a wrong parameter shows as much when the spectrum differs a little from level to level."""
STAYS_WITHIN = 0.5
"""Say that a gap stays where two deviations beside the slope lie within this: half of what the slowest law gives."""
LEAST_OUTPUT_RATIO = 1.5
"""Tell no absolute size from a smaller ratio of the loudest to the quietest output."""
SILENT_SHARE = 0.5
"""Learn from a level without a gap where the most that it could hide is below this share of what others show."""


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
    shown = above > sums.floor * np.maximum(2.0 * FLOOR_KNOWN_TO, BEYOND_CHANCE * np.sqrt(2.0 / count))
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


LevelSource = Literal["inputs", "outputs"]
"""What the level of a record was taken from: outputs only where no input drives any record."""

SAME_LEVEL = 1.1
"""Give records one level whose input sizes differ by at most this ratio."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Gap:
    """Mean squares of measured minus simulated, cut in every direction.

    Attributes:
        measured: records.
        simulated: their simulations.
        residuals: (n_samples, n_outputs) a record, measured minus simulated, read-only; NaN where either is missing.
        floor: (n_records, n_outputs) variance of the noise, at least that of rounding.
        mean_square: (n_records, n_outputs) of the residuals.
        variance: (n_records, n_outputs) of the measured outputs about their means.
        constant: (n_records, n_outputs) part of `mean_square` that is the square of the residual's mean.
        bands: the rest by frequency band.
        cells: the rest in fine cells of frequency, the same for all records.
        windows: the whole by time window.
        levels: (n_records,) size of the excitation relative to the loudest record, see `excitation_levels`.
        level_numbers: (n_records,) 1 for the quietest level, 2 for the next ...; records within 10 % share one.
        level_source: "inputs", or "outputs" where no input drives the records.
        output_trends: gap against level, one an output.
        trend: gap against level, all outputs together.
        time_trend: gap against time within the records, all outputs together; None where it cannot be told.
    """

    measured: tuple[Record, ...]
    simulated: tuple[Record, ...]
    residuals: tuple[FloatArray, ...]
    floor: FloatArray
    mean_square: FloatArray
    variance: FloatArray
    constant: FloatArray
    bands: BandTable
    cells: CellTable
    windows: WindowTable
    levels: FloatArray
    level_numbers: npt.NDArray[np.int64]
    level_source: LevelSource
    output_trends: tuple[LevelTrend, ...]
    trend: LevelTrend
    time_trend: TimeTrend | None

    @property
    def rmse(self) -> FloatArray:
        """(n_records, n_outputs) root mean square of the gap, output units."""
        return np.sqrt(self.mean_square)

    @property
    def relative(self) -> FloatArray:
        """(n_records, n_outputs) gap relative to the rms of the output about its mean; nan where it rests."""
        return np.sqrt(_ratio(self.mean_square, self.variance))

    @property
    def in_floors(self) -> FloatArray:
        """(n_records, n_outputs) mean square of the gap in units of the noise variance: 1 is a perfect model."""
        result: FloatArray = self.mean_square / self.floor
        return result

    @property
    def excess(self) -> FloatArray:
        """(n_records, n_outputs) mean square above the floor over the output's variance; nan where it rests."""
        return _ratio(self.mean_square - self.floor, self.variance)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.measured[0].output_names

    @property
    def n_levels(self) -> int:
        """Number of distinct levels."""
        return int(self.level_numbers.max())


def measure_gap(measured: Record | Sequence[Record], simulated: Record | Sequence[Record], floor: npt.ArrayLike) -> Gap:
    """Compare measured records with their simulations.

    Args:
        measured: one record or several of one system.
        simulated: as many, in the same order: same outputs, samples and time step.
        floor: (n_records, n_outputs) variance of the measurement noise; a number or (n_outputs,) holds for all.

    Raises:
        InvalidDataError: records that do not match, a floor that is negative or of the wrong shape.

    Example:
        >>> time = np.arange(400) * 0.01
        >>> force = np.sin(2 * np.pi * time)
        >>> tip = Record(force, 2.0 * force + 0.1 * np.sin(2 * np.pi * 10 * time), 0.01)
        >>> gap = measure_gap(tip, Record(force, 2.0 * force, 0.01), 1e-4)
        >>> gap.relative.round(3).tolist(), gap.in_floors.round(6).tolist()
        ([[0.05]], [[50.0]])
        >>> gap.bands.bands[gap.bands.power[0, :, 0].argmax()].name
        '6.25 to 12.5 Hz'
    """
    several, others = as_records(measured), as_records(simulated)
    _check_match(several, others)
    residuals = tuple(_residual(one, other) for one, other in zip(several, others, strict=True))
    variance = np.array([np.nanvar(record.outputs, axis=0) for record in several])
    noise = _floor(floor, variance)
    longest = max(record.duration for record in several)
    octaves = octave_bands(0.5 / several[0].dt, lowest=min(4.0 / longest, 0.25 / several[0].dt))
    constant, by_band, by_cell = spectral_tables(others, residuals, noise, octaves)
    windows = window_table(several, residuals, 8)
    levels, numbers, source = excitation_levels(several)
    output_trends, trend = level_trends(windows, noise, levels, numbers)
    return Gap(
        measured=several,
        simulated=others,
        residuals=residuals,
        floor=noise,
        mean_square=np.array([np.nanmean(np.square(values), axis=0) for values in residuals]),
        variance=variance,
        constant=constant,
        bands=by_band,
        cells=by_cell,
        windows=windows,
        levels=levels,
        level_numbers=numbers,
        level_source=source,
        output_trends=output_trends,
        trend=trend,
        time_trend=time_trend(windows),
    )


def excitation_levels(records: Sequence[Record]) -> tuple[FloatArray, npt.NDArray[np.int64], LevelSource]:
    """How hard each record drives the system, relative to the loudest, and the number of its level from 1.

    The level is the root mean square over the inputs, each relative to its own root mean square in all records; its
    mean counts, for a constant input drives too. Without an input that moves anything the outputs take its place.

    Returns:
        (n_records,) levels, (n_records,) numbers, and what they were taken from.

    Example:
        >>> records = [Record([size, -size], [0.0, 1.0], 0.1) for size in (2.0, 1.0, 2.1)]
        >>> levels, numbers, source = excitation_levels(records)
        >>> levels.round(3).tolist(), numbers.tolist(), source
        ([0.952, 0.476, 1.0], [2, 1, 2], 'inputs')
    """
    squares = np.array([np.nanmean(np.square(record.inputs), axis=0) for record in records])
    source: LevelSource = "inputs"
    if not (squares > 0.0).any():
        squares = np.array([np.nanvar(record.outputs, axis=0) for record in records])
        source = "outputs"
    whole = squares.mean(axis=0)
    level = np.sqrt((squares / np.where(whole > 0.0, whole, 1.0)).sum(axis=1))
    level = level / max(float(level.max()), np.finfo(np.float64).tiny)
    order = np.argsort(level, kind="stable")
    steps = level[order][1:] > SAME_LEVEL * level[order][:-1]
    numbers = np.empty(level.size, dtype=np.int64)
    numbers[order] = 1 + np.concatenate([[0], np.cumsum(steps)])
    return level, numbers, source


def _residual(measured: Record, simulated: Record) -> FloatArray:
    residual: FloatArray = measured.outputs - simulated.outputs
    residual.flags.writeable = False
    return residual


def _floor(given: npt.ArrayLike, variance: FloatArray) -> FloatArray:
    try:
        noise = np.broadcast_to(np.asarray(given, dtype=np.float64), variance.shape)
    except (TypeError, ValueError) as error:
        raise InvalidDataError(
            f"the noise floor must be (n_records, n_outputs) = {variance.shape} variances, but is {given!r}."
        ) from error
    if not (np.isfinite(noise) & (noise >= 0.0)).all():
        raise InvalidDataError(
            "the noise floor must be finite and at least 0; give variances, in squared output units."
        )
    tiny = np.finfo(np.float64).tiny
    result: FloatArray = np.maximum(noise, np.square(ROUNDED) * variance.mean(axis=0) + tiny)
    return result


def _check_match(measured: Sequence[Record], simulated: Sequence[Record]) -> None:
    """Refuse records that cannot be subtracted from each other."""
    if len(measured) != len(simulated):
        raise InvalidDataError(
            f"each measured record needs its simulation, but there are {len(measured)} and {len(simulated)}; simulate "
            "every record."
        )
    one, other = measured[0], simulated[0]
    for what in ("output_names", "output_units"):
        if getattr(one, what) != getattr(other, what):
            raise InvalidDataError(
                f"measured and simulated records need the same {what.replace('_', ' ')}, but have "
                f"{list(getattr(one, what))} and {list(getattr(other, what))}; select or rename them."
            )
    if abs(one.dt - other.dt) > ROUNDED * one.dt:
        raise InvalidDataError(
            f"measured and simulated records need the same time step, but have {one.dt:.9g} and {other.dt:.9g} s; "
            "simulate at the step of the measurement."
        )
    for number, (record, run) in enumerate(zip(measured, simulated, strict=True)):
        if record.n_samples != run.n_samples:
            raise InvalidDataError(
                f"a record and its simulation need the same samples, but record {number} has {record.n_samples} and "
                f"its simulation {run.n_samples}."
            )
        both = np.isfinite(record.outputs) & np.isfinite(run.outputs)
        if not both.any(axis=0).all():
            name = record.output_names[int(np.argmin(both.any(axis=0)))]
            raise InvalidDataError(
                f"output {name!r} of record {number} and its simulation have no sample in common; leave it out."
            )


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    moves = denominator > 0.0
    result: FloatArray = np.where(moves, numerator / np.where(moves, denominator, 1.0), np.nan)
    return result
