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

from modal.localisation.gap import BEYOND_CHANCE
from modal.wording.text import Statement, percent
from okid.arrays import BoolArray, ComplexArray, FloatArray, whole_number
from okid.record import Record
from okid.rows import as_records

LARGEST_DIFFERENCE = 1e-3
"""Call no shift T a period from this mean square of u(k + T) - u(k) on, over twice the variance of u: 3 % noise on the
input."""
UNLIKE = 0.1
"""Ask that a shift first pull the input apart from itself this far in the same measure: else it only shows a slow
signal."""
SHORTEST = 4
"""Look for no period of fewer samples."""


def input_period(record: Record) -> int | None:
    """Number of samples after which all inputs repeat, at least twice in the record; None where there is none.

    Example:
        >>> sine = np.sin(2 * np.pi * np.arange(100) / 20)
        >>> input_period(Record(sine, sine, 0.1)), input_period(Record(np.arange(100.0), sine, 0.1))
        (20, None)
    """
    inputs = record.inputs[:, np.ptp(record.inputs, axis=0) > 0.0]
    n_samples = record.n_samples
    if not inputs.shape[1] or np.isnan(record.inputs).any() or n_samples < 2 * SHORTEST:
        return None
    difference = _differences((inputs - inputs.mean(axis=0)) / inputs.std(axis=0))
    apart = np.flatnonzero(difference > UNLIKE)
    if not apart.size:
        return None
    again = np.flatnonzero(difference < LARGEST_DIFFERENCE)
    again = again[again > max(apart[0], SHORTEST - 1)]
    if not again.size:
        return None
    # an input that moves slowly is nearly itself one sample on as well: the best of the first few shifts
    run = again[: 1 + int(np.argmax(np.append(np.diff(again) > 1, values=True)))]
    return int(run[np.argmin(difference[run])])


def periods_of(values: FloatArray, period: int) -> FloatArray:
    """(n_periods, period, n_columns) the last whole periods of a signal, in order.

    Example:
        >>> periods_of(np.arange(7.0)[:, np.newaxis], 3)[:, :, 0].tolist()
        [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    """
    n_periods = len(values) // period
    return values[len(values) - n_periods * period :].reshape(n_periods, period, values.shape[1])


def _differences(inputs: FloatArray) -> FloatArray:
    """(n_samples // 2 + 1,) mean square of u(k + T) - u(k) over twice the variance, the worst input of each shift T."""
    n_samples = len(inputs)
    spectrum = np.fft.rfft(inputs, 2 * n_samples, axis=0)
    shifts = np.arange(n_samples // 2 + 1)
    products = np.fft.irfft(np.square(np.abs(spectrum)), axis=0)[shifts]
    power = np.concatenate([np.zeros((1, inputs.shape[1])), np.cumsum(np.square(inputs), axis=0)])
    ends = power[n_samples - shifts] + power[n_samples] - power[shifts]
    # both ends share what they miss: a period in which the input rests must not divide by zero
    difference: FloatArray = (ends - 2.0 * products) / (2.0 * (n_samples - shifts)[:, np.newaxis])
    return difference.max(axis=1)


EXCITED = 1e-3
"""Call a line excited from this power relative to the strongest on (-30 dB)."""
UNEXCITED = 1e-5
"""Call a line not excited up to this power (-50 dB) unless the noise of the input is larger; between the two it is left
out."""
REACH = 3
"""Look at lines up to this multiple of the highest excited one: a single sine's third harmonic lies there."""
FEWEST_PERIODS = 3
"""Ask for one period for the transient to die out in, and two for their scatter."""
FALSE_ALARM = 1e-4
"""Take what chance does more rarely than this for a line."""
DOMINANT = 4.0
"""Call one kind of line the larger from this ratio of the power per line on (6 dB)."""


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
    excited = ((mean > EXCITED * largest) & (mean > BEYOND_CHANCE**2 * noise)).any(axis=1)
    quiet = ((mean < UNEXCITED * largest) | ((mean < BEYOND_CHANCE**2 * noise) & (mean < EXCITED * largest))).all(
        axis=1
    )
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


def line_statements(lines: Lines) -> list[Statement]:
    """What the lines that are not excited show, one sentence; or why no record can show them."""
    measured = lines.measured
    if not measured:
        reasons = list(dict.fromkeys(lines.reasons))
        return [Statement(subject="lines", text=f"Odd and even lines tell nothing here: {'; '.join(reasons)}.")]
    level = np.array([one.level for one in measured])  # (n_records, 2, n_outputs)
    has_odd, has_even = (any(one.counts[kind] for one in measured) for kind in (1, 2))
    odd, even = float(level[:, 0].max()), float(level[:, 1].max())
    if odd == 0.0 and even == 0.0:
        what = "lines that are not excited" if has_odd and has_even else f"{'odd' if has_odd else 'even'} lines"
        return [Statement(subject="lines", text=f"The {what} carry noise only: no nonlinearity shows on them.")]
    if even > DOMINANT * odd:
        text = f"Even lines carry {percent(np.sqrt(even))} of the amplitude of an excited line"
        text += f", odd ones {_size(odd)}" if has_odd else ""
        text += ": a law that is even in the motion (quadratic, bilinear, one-sided contact)."
    elif odd > DOMINANT * even:
        text = f"Odd lines that are not excited carry {percent(np.sqrt(odd))} of the amplitude of an excited line"
        text += f", even ones {_size(even)}" if has_even else ""
        text += ": a law that is odd in the motion (cubic, friction, drag, symmetric contact)."
    else:
        text = (
            f"Odd lines that are not excited carry {percent(np.sqrt(odd))} and even ones {percent(np.sqrt(even))} of "
            "the amplitude of an excited line: a law that is neither odd nor even, or two laws."
        )
    return [Statement(subject="lines", text=text)]


def _size(power: float) -> str:
    return percent(float(np.sqrt(power))) if power > 0.0 else "noise only"
