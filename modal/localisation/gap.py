"""How far a simulation is from the measurement: by record and output, frequency band, time window and level.

The gap is measured minus simulated, its mean included: a static error is an error. Everything here is a table of mean
squares of it, with that of the noise beside it; what the tables say in words is `modal.localisation.evidence`'s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from modal.localisation.bands import GapBand, check_bands, octave_bands
from modal.localisation.gap_tables import BandTable, CellTable, WindowTable, spectral_tables, window_table
from modal.localisation.gap_time import TimeTrend, time_trend
from modal.localisation.gap_trend import LevelTrend, level_trends
from modal.simulation.tolerances import ROUNDING
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.record import Record
from okid.rows import as_records
from okid.scalars import whole_number

__all__ = ["Gap", "LevelSource", "excitation_levels", "measure_gap"]

LevelSource = Literal["inputs", "outputs"]
"""What the level of a record was taken from: outputs only where no input drives any record."""

SAME_LEVEL = 1.1
"""Ratio of input sizes up to which two records are of one level."""


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


def measure_gap(
    measured: Record | Sequence[Record],
    simulated: Record | Sequence[Record],
    floor: npt.ArrayLike,
    *,
    bands: Sequence[GapBand] | Literal["octaves"] = "octaves",
    n_windows: int = 8,
) -> Gap:
    """Compare measured records with their simulations.

    Args:
        measured: one record or several of one system.
        simulated: as many, in the same order: same outputs, samples and time step.
        floor: (n_records, n_outputs) variance of the measurement noise; a number or (n_outputs,) holds for all.
        bands: frequency bands, e.g. from `resonance_bands`, or "octaves" down from the Nyquist frequency.
        n_windows: consecutive windows of equal length.

    Raises:
        InvalidDataError: records that do not match, a floor that is negative or of the wrong shape, bands that overlap.

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
    n_windows = whole_number(n_windows, name="the number of time windows", least=1)
    residuals = tuple(_residual(one, other) for one, other in zip(several, others, strict=True))
    variance = np.array([np.nanvar(record.outputs, axis=0) for record in several])
    noise = _floor(floor, variance)
    if isinstance(bands, str):
        longest = max(record.duration for record in several)
        chosen = octave_bands(0.5 / several[0].dt, lowest=min(4.0 / longest, 0.25 / several[0].dt))
    else:
        chosen = check_bands(bands)
    constant, by_band, by_cell = spectral_tables(others, residuals, noise, chosen)
    windows = window_table(several, residuals, n_windows)
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

    Args:
        records: of one system.

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
    result: FloatArray = np.maximum(noise, np.square(ROUNDING) * variance.mean(axis=0) + tiny)
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
    if abs(one.dt - other.dt) > ROUNDING * one.dt:
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
