"""The gap cut by frequency and by time: tables of mean squares that add up to the whole, with the noise beside them.

The lines are those of the discrete Fourier transform of the record without a window: then the constant part and the
power of all lines sum to the mean square exactly (Parseval), whatever the bands.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from modal.wording.text import number
from okid.arrays import FloatArray
from okid.record import Record


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapBand:
    """The frequencies low < f <= high."""

    name: str
    low: float
    high: float


def octave_bands(highest: float, *, lowest: float = 0.0) -> tuple[GapBand, ...]:
    """Octaves downwards from the highest frequency, at most eight bands; the last reaches down to 0 Hz.

    Args:
        highest: upper edge of the highest band [Hz], as a rule the Nyquist frequency.
        lowest: no band but the one from 0 Hz lies below it [Hz].

    Example:
        >>> [band.name for band in octave_bands(8.0, lowest=1.5)]
        ['0 to 2 Hz', '2 to 4 Hz', '4 to 8 Hz']
    """
    edges = [highest]
    while len(edges) < 8 and edges[-1] / 2.0 > lowest:
        edges.append(edges[-1] / 2.0)
    return tuple(_between(low, high) for low, high in pairwise([0.0, *reversed(edges)]))


def line_power(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean square of each column: its constant part, and the rest line by line.

    Missing samples count as the mean, and the lines are scaled up by the share that is missing.

    Args:
        values: (n_samples, n_columns), NaN where missing.

    Returns:
        (n_columns,) square of the mean, and (n_lines, n_columns) power of the lines k / (n_samples dt), k = 1, 2, ...;
        both nan for a column without a sample.

    Example:
        >>> time = np.arange(8) / 8
        >>> constant, lines = line_power(3.0 + 2.0 * np.sin(2 * np.pi * time)[:, np.newaxis])
        >>> constant.round(12).tolist(), lines[:, 0].round(12).tolist()
        ([9.0], [2.0, 0.0, 0.0, 0.0])
    """
    there = ~np.isnan(values)
    count = there.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(there, values, 0.0).sum(axis=0) / count
        scale = len(values) / count
    spectrum = np.fft.rfft(np.where(there, values - np.where(count > 0, mean, 0.0), 0.0), axis=0)[1:]
    power: FloatArray = np.square(np.abs(spectrum)) * (line_share(len(values))[:, np.newaxis] / len(values)) * scale
    return np.square(mean), power


def line_share(n_samples: int) -> FloatArray:
    """(n_lines,) share of the variance of white noise that falls on each line k = 1, 2, ...

    Example:
        >>> line_share(4).tolist(), line_share(5).tolist()
        ([0.5, 0.25], [0.4, 0.4])
    """
    share = np.full(n_samples // 2, 2.0 / n_samples)
    if n_samples % 2 == 0 and n_samples > 0:
        share[-1] = 1.0 / n_samples
    return share


def _between(low: float, high: float) -> GapBand:
    return GapBand(name=f"{_hertz(low)} to {_hertz(high)} Hz", low=low, high=high)


def _hertz(frequency: float) -> str:
    """Three digits, none of them an idle zero: 0.391, 2, 12.5."""
    text = number(frequency)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


IntArray = npt.NDArray[np.int64]

ON_EDGE = 1e-6
"""Count a line to a band whose upper edge is relatively this near."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BandTable:
    """Mean square of the gap in each frequency band.

    Attributes:
        bands: by rising frequency.
        power: (n_records, n_bands, n_outputs) part of the gap's mean square.
        floor: (n_records, n_bands, n_outputs) the same of white noise of the floor's variance.
        n_lines: (n_records, n_bands) lines of the Fourier transform in the band.
    """

    bands: tuple[GapBand, ...]
    power: FloatArray
    floor: FloatArray
    n_lines: IntArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CellTable:
    """Spectra of all records on one fine grid of frequency cells, from 0 Hz (the mean left out) to Nyquist.

    Attributes:
        edges: (n_cells + 1,) [Hz]; the cells lie about the lines of the shortest record, so none is cut by an edge.
        gap: (n_records, n_cells, n_outputs) part of the gap's mean square.
        floor: (n_records, n_cells, n_outputs) the same of the noise.
        simulated: (n_records, n_cells, n_outputs) part of the simulated output's variance.
    """

    edges: FloatArray
    gap: FloatArray
    floor: FloatArray
    simulated: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WindowTable:
    """Mean squares in consecutive windows of equal length.

    Attributes:
        edges: (n_records, n_windows + 1) first sample of each window, and the number of samples.
        gap: (n_records, n_windows, n_outputs) mean square of the gap; nan where a window has no sample.
        output: (n_records, n_windows, n_outputs) of the measured output about the mean of its record.
        n_samples: (n_records, n_windows, n_outputs) samples that are there.
    """

    edges: IntArray
    gap: FloatArray
    output: FloatArray
    n_samples: IntArray


def spectral_tables(
    simulated: Sequence[Record], residuals: Sequence[FloatArray], floor: FloatArray, bands: Sequence[GapBand]
) -> tuple[FloatArray, BandTable, CellTable]:
    """(n_records, n_outputs) constant part of the gap, and the rest by band and by cell.

    Args:
        simulated: records.
        residuals: (n_samples, n_outputs) a record.
        floor: (n_records, n_outputs) variance of the noise.
        bands: that do not overlap.
    """
    nyquist = 0.5 / simulated[0].dt
    n_cells = max(1, min(2048, *(record.n_samples // 2 for record in simulated)))
    parts = [
        _Spectrum.of(record, residual, bands, n_cells) for record, residual in zip(simulated, residuals, strict=True)
    ]
    noise = floor[:, np.newaxis, :]
    table = BandTable(
        bands=tuple(bands),
        power=np.array([part.bands for part in parts]),
        floor=np.array([part.band_share for part in parts])[:, :, np.newaxis] * noise,
        n_lines=np.array([part.band_lines for part in parts], dtype=np.int64),
    )
    cells = CellTable(
        edges=np.concatenate([[0.0], (np.arange(1.5, n_cells)) * nyquist / n_cells, [nyquist]]),
        gap=np.array([part.cells for part in parts]),
        floor=np.array([part.cell_share for part in parts]) * noise,
        simulated=np.array([part.simulated for part in parts]),
    )
    return np.array([part.constant for part in parts]), table, cells


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Spectrum:
    """Constant part, bands and cells of one record; shares are those of white noise."""

    constant: FloatArray
    bands: FloatArray
    band_share: FloatArray
    band_lines: IntArray
    cells: FloatArray
    cell_share: FloatArray
    simulated: FloatArray

    @staticmethod
    def of(record: Record, residual: FloatArray, bands: Sequence[GapBand], n_cells: int) -> "_Spectrum":
        constant, lines = line_power(residual)
        simulated = line_power(record.outputs)[1]
        share = line_share(record.n_samples)
        place = np.arange(1, len(lines) + 1) / record.duration
        cell = np.clip(np.rint(place * (2.0 * record.dt * n_cells)).astype(np.int64) - 1, 0, n_cells - 1)
        inside = np.array([(place > b.low * (1.0 + ON_EDGE)) & (place <= b.high * (1.0 + ON_EDGE)) for b in bands])
        return _Spectrum(
            constant=constant,
            bands=inside @ lines,
            band_share=inside @ share,
            band_lines=inside.sum(axis=1),
            cells=_summed(lines, cell, n_cells),
            cell_share=_summed(share[:, np.newaxis], cell, n_cells),
            simulated=_summed(simulated, cell, n_cells),
        )


def window_table(records: Sequence[Record], residuals: Sequence[FloatArray], n_windows: int) -> WindowTable:
    """The gap and the measured outputs by time window.

    Args:
        records: measured.
        residuals: (n_samples, n_outputs) a record.
        n_windows: of equal length to a sample; a record shorter than that has empty ones.
    """
    edges, gap, output, counts = [], [], [], []
    for record, residual in zip(records, residuals, strict=True):
        own = np.linspace(0, record.n_samples, n_windows + 1).round().astype(np.int64)
        about_mean = record.outputs - np.nanmean(record.outputs, axis=0)
        pieces = list(zip(own[:-1].tolist(), own[1:].tolist(), strict=True))
        edges.append(own)
        gap.append([_mean_square(residual[first:last]) for first, last in pieces])
        output.append([_mean_square(about_mean[first:last]) for first, last in pieces])
        counts.append([np.isfinite(residual[first:last]).sum(axis=0) for first, last in pieces])
    return WindowTable(
        edges=np.array(edges), gap=np.array(gap), output=np.array(output), n_samples=np.array(counts, dtype=np.int64)
    )


def _mean_square(values: FloatArray) -> FloatArray:
    """(n_columns,) over the samples that are there, nan without one."""
    there = ~np.isnan(values)
    count = there.sum(axis=0)
    total = np.square(np.where(there, values, 0.0)).sum(axis=0)
    result: FloatArray = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return result


def _summed(lines: FloatArray, cell: IntArray, n_cells: int) -> FloatArray:
    """(n_cells, n_columns) sums of the lines of each cell."""
    summed: FloatArray = np.zeros((n_cells, lines.shape[1]))
    for column, own in zip(summed.T, lines.T, strict=True):
        column[:] = np.bincount(cell, weights=own, minlength=n_cells)
    return summed
