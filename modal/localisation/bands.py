"""Frequency bands, and the mean square of a signal line by line, so that the bands of a record add up to the whole.

The lines are those of the discrete Fourier transform of the record without a window: then the constant part and the
power of all lines sum to the mean square exactly (Parseval), whatever the bands.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from modal.simulation.tolerances import ROUNDING
from modal.wording.statements import number
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.scalars import real_number

__all__ = ["GapBand", "check_bands", "line_power", "line_share", "octave_bands", "resonance_bands"]

MOST_OCTAVES = 8
HALF_WIDTH = 0.15
"""Of a resonance's frequency: the band around it, on either side."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapBand:
    """The frequencies low < f <= high.

    Attributes:
        name: what a person calls it.
        low: [Hz].
        high: [Hz].
    """

    name: str
    low: float
    high: float


def octave_bands(highest: float, *, lowest: float = 0.0) -> tuple[GapBand, ...]:
    """Octaves downwards from the highest frequency, at most eight bands; the last reaches down to 0 Hz.

    Args:
        highest: upper edge of the highest band [Hz], as a rule the Nyquist frequency.
        lowest: no band but the one from 0 Hz lies below it [Hz].

    Raises:
        InvalidDataError: a highest frequency that is not positive.

    Example:
        >>> [band.name for band in octave_bands(8.0, lowest=1.5)]
        ['0 to 2 Hz', '2 to 4 Hz', '4 to 8 Hz']
    """
    if not 0.0 < real_number(highest) < np.inf:
        raise InvalidDataError(f"the highest frequency of the bands must be positive, but is {highest!r} Hz.")
    edges = [highest]
    while len(edges) < MOST_OCTAVES and edges[-1] / 2.0 > lowest:
        edges.append(edges[-1] / 2.0)
    return tuple(_between(low, high) for low, high in pairwise([0.0, *reversed(edges)]))


def resonance_bands(
    resonances: Sequence[float], highest: float, *, half_width: float = HALF_WIDTH
) -> tuple[GapBand, ...]:
    """One band around each resonance, one below, between and above them: together all frequencies up to the highest.

    Neighbours that come closer than their widths are parted at the geometric mean of the two.

    Args:
        resonances: [Hz], in any order; those outside 0 to `highest` are left out.
        highest: upper edge of the last band [Hz].
        half_width: of the band around a resonance, relative to its frequency.

    Raises:
        InvalidDataError: a highest frequency that is not positive, or a width that does not lie between 0 and 1.

    Example:
        >>> [band.name for band in resonance_bands([4.0], 10.0, half_width=0.25)]
        ['0 to 3 Hz', 'around 4 Hz', '5 to 10 Hz']
    """
    if not 0.0 < real_number(half_width) < 1.0:
        raise InvalidDataError(f"the half width of a band must lie between 0 and 1, but is {half_width!r}.")
    if not 0.0 < real_number(highest) < np.inf:
        raise InvalidDataError(f"the highest frequency of the bands must be positive, but is {highest!r} Hz.")
    found = sorted({float(f) for f in resonances if 0.0 < f < highest})
    bands: list[GapBand] = []
    reached = 0.0
    for i, frequency in enumerate(found):
        low, high = frequency * (1.0 - half_width), min(highest, frequency * (1.0 + half_width))
        low = max(low, reached)
        if i + 1 < len(found):
            high = min(high, float(np.sqrt(frequency * found[i + 1])))
        if low > reached * (1.0 + ROUNDING):
            bands.append(_between(reached, low))
        bands.append(GapBand(name=f"around {_hertz(frequency)} Hz", low=low, high=high))
        reached = high
    if reached < highest:
        bands.append(_between(reached, highest))
    return tuple(bands)


def check_bands(bands: Sequence[GapBand]) -> tuple[GapBand, ...]:
    """The bands, checked to have edges in order and not to overlap.

    Raises:
        InvalidDataError: no band, an edge below 0, a band of no width, or two that overlap.
    """
    for band in bands:
        if not 0.0 <= band.low < band.high:
            raise InvalidDataError(
                f"a band needs edges 0 <= low < high, but {band.name!r} has {band.low:.6g} and {band.high:.6g} Hz."
            )
    ordered = sorted(bands, key=lambda band: band.low)
    for below, above in pairwise(ordered):
        if above.low < below.high * (1.0 - ROUNDING):
            raise InvalidDataError(
                f"bands must not overlap, but {below.name!r} ends at {below.high:.6g} Hz and {above.name!r} begins at "
                f"{above.low:.6g} Hz."
            )
    if not ordered:
        raise InvalidDataError("at least one band is needed; leave `bands` out for octaves.")
    return tuple(ordered)


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
