"""Odd and even lines: what a periodic excitation that leaves lines out shows of a nonlinearity, without any model.

A linear system answers a periodic input at the lines that are excited and nowhere else. Let the input hold odd lines
only, some of them left out ("random-odd"). A law that is even in the motion (quadratic, bilinear, a stop on one side)
answers at even lines; one that is odd (cubic, friction, drag, a gap on both sides) at odd lines, those left out
included. The scatter from period to period is the noise on each line, so no model and no floor is needed.

References:
    Schoukens, Pintelon, Dobrowiecki, Rolain, Identification of linear systems with nonlinear distortions, Automatica
    41(3), 2005, 491-504, doi 10.1016/j.automatica.2004.10.004.
    Pintelon, Schoukens, System Identification: A Frequency Domain Approach, 2nd edition, Wiley 2012, chapter 4,
    doi 10.1002/9781118287422.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from modal.localisation.periods import input_period, periods_of
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import as_records
from okid.scalars import whole_number

__all__ = ["LineKind", "Lines", "RecordLines", "measure_lines"]

LineKind = Literal["excited", "odd", "even"]

EXCITED = 1e-3
"""Power of a line relative to the strongest from which on it is excited (-30 dB)."""
UNEXCITED = 1e-5
"""The same up to which it is not (-50 dB) unless the noise of the input is larger; between the two it is left out."""
REACH = 3
"""Lines up to this multiple of the highest excited one are looked at: a single sine's third harmonic lies there."""
FEWEST_PERIODS = 3
"""One for the transient to die out in, two for their scatter."""
FALSE_ALARM = 1e-4
DOMINANT = 4.0
"""Ratio of the power per line (6 dB) from which on one kind of line is called the larger."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RecordLines:
    """Output power of one record on each kind of line, mean over the lines of that kind.

    Attributes:
        period: samples.
        n_periods: averaged; the first whole period of the record is left out.
        counts: number of lines that are excited, odd and not, even and not.
        power: (3, n_outputs) mean power of a line that is excited, odd and not, even and not; squared output units.
        noise: (3, n_outputs) power of the noise on the mean over the periods, likewise.
        shows: (3, n_outputs) True where the power is above the noise (F test, one false alarm in 10 000).
    """

    period: int
    n_periods: int
    counts: tuple[int, int, int]
    power: FloatArray
    noise: FloatArray
    shows: BoolArray

    @property
    def level(self) -> FloatArray:
        """(2, n_outputs) power above the noise of an odd and of an even line, relative to an excited line."""
        above = np.where(self.shows[1:], self.power[1:] - self.noise[1:], 0.0)
        size = np.where(self.power[0] > 0.0, self.power[0], 1.0)
        result: FloatArray = above / size
        return result


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Lines:
    """Odd and even lines of several records.

    Attributes:
        records: what each record shows, None where it cannot.
        reasons: why it cannot, "" where it can.
        output_names: of the outputs.
    """

    records: tuple[RecordLines | None, ...]
    reasons: tuple[str, ...]
    output_names: tuple[str, ...]

    @property
    def measured(self) -> tuple[RecordLines, ...]:
        """Those records that show lines."""
        return tuple(record for record in self.records if record is not None)


def measure_lines(records: Record | Sequence[Record], *, period: int | Literal["auto"] = "auto") -> Lines:
    """Output power on excited, odd and even lines of each record that repeats and leaves lines out.

    Args:
        records: one measured record or several of one system.
        period: samples, or "auto" to find it from the inputs.

    Raises:
        InvalidDataError: records that do not belong together, or a period below 4 samples.

    Example:
        >>> time = np.arange(1024) / 256  # four periods of 256 samples
        >>> force = np.sin(2 * np.pi * 3 * time) + np.sin(2 * np.pi * 7 * time)
        >>> noise = 1e-3 * np.random.default_rng(0).standard_normal(1024)
        >>> lines = measure_lines(Record(force, force + 0.1 * force**2 + noise, 0.01))
        >>> lines.records[0].shows[:, 0].tolist()  # excited, odd, even
        [True, False, True]
    """
    several = as_records(records)
    given = None if period == "auto" else whole_number(period, name="a period", least=4, otherwise='or "auto"')
    found = [_record_lines(record, given) for record in several]
    return Lines(
        records=tuple(one if isinstance(one, RecordLines) else None for one in found),
        reasons=tuple(one if isinstance(one, str) else "" for one in found),
        output_names=several[0].output_names,
    )


def _record_lines(record: Record, given: int | None) -> RecordLines | str:
    """What the record shows, or one sentence why it cannot."""
    if not record.n_inputs:
        return "the record has no input whose lines could be told apart"
    if np.isnan(record.inputs).any() or np.isnan(record.outputs).any():
        return "samples are missing, which smears every line over the others"
    period = input_period(record) if given is None else given
    if period is None:
        return "the inputs do not repeat within the record"
    n_periods = record.n_samples // period
    if n_periods < FEWEST_PERIODS:
        return (
            f"it holds {n_periods} periods of {period} samples; {FEWEST_PERIODS} are needed, one for the transient and "
            "two for the noise"
        )
    inputs, outputs = _spectra(record.inputs, period)[1:], _spectra(record.outputs, period)[1:]
    kinds = _line_kinds(inputs)
    counts = tuple(int(mask.sum()) for mask in kinds)
    if counts[1] + counts[2] == 0:
        return "all lines of the band are excited, so no line is left to show a nonlinearity"
    return _measured(outputs, kinds, period)


def _spectra(values: FloatArray, period: int) -> ComplexArray:
    """(n_periods, n_lines, n_columns) spectrum of each period, scaled so that squares are mean squares."""
    spectra = np.fft.rfft(periods_of(values, period), axis=1)[:, 1 : (period + 1) // 2]
    scaled: ComplexArray = spectra * (np.sqrt(2.0) / period)
    return scaled


def _line_kinds(inputs: ComplexArray) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Which lines 1, 2, ... are excited, odd and not, even and not."""
    mean = np.square(np.abs(inputs.mean(axis=0)))
    noise = inputs.var(axis=0, ddof=1) / len(inputs)
    largest = mean.max(axis=0)
    largest = np.where(largest > 0.0, largest, 1.0)
    # the loudest input decides whether a line is excited, every input whether it is not
    excited = ((mean > EXCITED * largest) & (mean > 16.0 * noise)).any(axis=1)
    quiet = ((mean < UNEXCITED * largest) | ((mean < 16.0 * noise) & (mean < EXCITED * largest))).all(axis=1)
    number = np.arange(1, mean.shape[0] + 1)
    highest = int(number[excited].max(initial=0))
    within = quiet & ~excited & (number <= REACH * highest)
    return excited, within & (number % 2 == 1), within & (number % 2 == 0)


def _measured(outputs: ComplexArray, kinds: Sequence[BoolArray], period: int) -> RecordLines:
    n_periods, _, n_outputs = outputs.shape
    mean = np.square(np.abs(outputs.mean(axis=0)))
    noise = outputs.var(axis=0, ddof=1) / n_periods
    power, floor = np.full((3, n_outputs), np.nan), np.full((3, n_outputs), np.nan)
    shows = np.zeros((3, n_outputs), dtype=np.bool_)
    for i, mask in enumerate(kinds):
        n_lines = int(mask.sum())
        if n_lines:
            power[i], floor[i] = mean[mask].mean(axis=0), noise[mask].mean(axis=0)
            limit = scipy.special.fdtri(2 * n_lines, 2 * n_lines * (n_periods - 1), 1.0 - FALSE_ALARM)
            # rounding of a record without noise is no answer of the system
            shows[i] = power[i] > np.maximum(limit * floor[i], 1e-24 * mean.max(axis=0))
    counts = (int(kinds[0].sum()), int(kinds[1].sum()), int(kinds[2].sum()))
    return RecordLines(period=period, n_periods=n_periods, counts=counts, power=power, noise=floor, shows=shows)
