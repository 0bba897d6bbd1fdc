"""Lines in a spectrum: narrow peaks that one sinusoid makes, and records without them.

A machine at constant speed stands in ambient motion as sinusoids, often several multiples of one frequency. Poles model
them as undamped modes, and the order of the model grows until they are followed. In the spectrum of a whole record a
sinusoid is as narrow as the window; a mode that noise drives is as wide as its damping, and what it does within twenty
resolutions of its peak no single sinusoid can follow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.modes.mode import Choice
from modal.wording.text import counted, hertz, listed, percent
from okid.arrays import TINY, BoolArray, FloatArray
from okid.record import Record
from okid.rows import runs_of

LINE = 300.0
"""Call a frequency a line where its power is so many times the median nearby: chance has 2^-300."""
MAIN_LOBE = 4
"""Leave out so many frequencies on either side of a line: the main lobe of the window (Blackman-Harris)."""
BESIDE = 32
"""Take the median nearby over so many frequencies."""
WITHIN = 20
"""Ask what one sinusoid leaves of the motion within so many resolutions (one over the duration) of a peak."""
MOST_LEFT = 0.05
"""Take a peak for a sinusoid that leaves nowhere nearby more than this share of its power; one taken off a mode does
that only where the mode decays by less than 1 / e over the record."""
REFINED = 2
"""Refine the frequency of a sinusoid so many times: the error that is left is that of the noise."""
FINER = 16
"""Look for the frequency of a sinusoid on a grid so many times finer than the resolution."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MachineLines:
    """Records without inputs, or that were struck, less the sinusoids in them.

    Attributes:
        records: the very records that came where there is no line.
        frequencies: (n_lines,) [Hz], rising.
        choices: what was taken off, and why; empty without lines.
        warnings: the lines, and which of them are multiples of one frequency.
    """

    records: tuple[Record, ...]
    frequencies: FloatArray
    choices: tuple[Choice, ...] = ()
    warnings: tuple[str, ...] = ()


def machine_lines(records: Sequence[Record]) -> MachineLines:
    """Find the sinusoids of records without inputs and take them off; with inputs nothing is done.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> hum = np.sin(2 * np.pi * 7.3 * 0.01 * np.arange(4000))
        >>> found = machine_lines([Record([], hum + rng.standard_normal(4000), 0.01)])
        >>> found.frequencies.round(2), bool(abs(found.records[0].outputs.std() - 1.0) < 0.03)
        (array([7.3]), True)
    """
    if records[0].n_inputs:
        return MachineLines(records=tuple(records), frequencies=np.empty(0))
    freed: list[Record] = []
    found: list[float] = []
    share = 0.0
    for record in records:
        values, lines = _without_sinusoids(record.outputs, record.dt)
        freed.append(replace(record, outputs=values) if lines else record)
        found += lines
        share = max(share, share_taken(record, values))
    why = (
        f"one sinusoid leaves at most {percent(MOST_LEFT)} of its power within {WITHIN} resolutions of each, which it "
        "does of no mode under noise"
    )
    return lines_taken_off(records, freed, found, share, why)


def lines_taken_off(
    records: Sequence[Record], freed: Sequence[Record], found: Sequence[float], share: float, why: str
) -> MachineLines:
    """What was taken off in words: lines [Hz] that were found, up to a share of an output's power, and why."""
    if not found:
        return MachineLines(records=tuple(records), frequencies=np.empty(0))
    apart = MAIN_LOBE / min(record.duration for record in records)
    rising = np.sort(found)
    lines_found = rising[np.diff(rising, prepend=-np.inf) > apart]
    shown = f"{listed([hertz(line) for line in lines_found])} Hz"
    sentence = (
        f"{lines_in_words(lines_found, apart)}, up to {percent(share)} of an output's power: "
        f"{'a sinusoid' if lines_found.size == 1 else 'sinusoids'} of a machine or the mains, no mode; taken off "
        "before the fit."
    )
    return MachineLines(
        records=tuple(freed),
        frequencies=lines_found,
        choices=(
            Choice(
                what="machine lines",
                value=f"taken off at {shown}",
                reason=why,
            ),
        ),
        warnings=(sentence,),
    )


def share_taken(record: Record, values: FloatArray) -> float:
    """The largest share of an output's power that these values lack."""
    before, after = (np.nansum(np.square(one), axis=0) for one in (record.outputs, values))
    return float(np.max(1.0 - after / np.maximum(before, TINY)))


def lines_in_words(lines: FloatArray, apart: float) -> str:
    """Where lines [Hz] stand and which of them are multiples of one frequency, as far as `apart`, without a full stop.

    Example:
        >>> lines_in_words(np.array([7.3, 14.6]), 0.1)
        'Two lines stand at 7.3 and 14.6 Hz (7.3 and 14.6 Hz are multiples of 7.3 Hz)'
    """
    families = _families(lines, apart)
    rest = f" ({'; '.join(families)})" if families else ""
    how_many = "A line stands" if lines.size == 1 else f"{counted(lines.size).capitalize()} lines stand"
    return f"{how_many} at {listed([hertz(line) for line in lines])} Hz{rest}"


def blackman_harris(n_samples: int) -> FloatArray:
    """(n_samples,) window whose side lobes stay 92 dB below its main lobe, of one period.

    References:
        Harris, Proceedings of the IEEE 66(1), 1978, 51-83, table I, doi 10.1109/PROC.1978.10837.
    """
    turn = 2.0 * np.pi * np.arange(n_samples) / n_samples
    window: FloatArray = 0.35875 - 0.48829 * np.cos(turn) + 0.14128 * np.cos(2 * turn) - 0.01168 * np.cos(3 * turn)
    return window


def line_bins(values: FloatArray, *, times: float = LINE) -> tuple[BoolArray, FloatArray]:
    """Where the spectrum of each column has lines.

    Args:
        values: (n_samples, n_channels), none missing.
        times: the median nearby that the power of a line is at least.

    Returns:
        (n_frequencies, n_channels) True on a line, and the power there as a share of the channel's; the frequencies are
        those of `numpy.fft.rfftfreq`, the window is Blackman-Harris.
    """
    window = blackman_harris(len(values))[:, np.newaxis]
    spectra = np.square(np.abs(np.fft.rfft((values - values.mean(axis=0)) * window, axis=0)))
    spectra = spectra / np.maximum(spectra.sum(axis=0), np.finfo(float).tiny)
    first, n_blocks = 2 * MAIN_LOBE, (len(spectra) - 2 * MAIN_LOBE) // BESIDE
    bins = np.zeros(spectra.shape, dtype=np.bool_)
    if n_blocks > 1:
        blocks = spectra[first : first + n_blocks * BESIDE].reshape(n_blocks, BESIDE, -1)
        medians = np.median(blocks, axis=1)
        padded = np.concatenate([medians[:1], medians, medians[-1:]])
        usual = np.repeat(np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:]), BESIDE, axis=0)
        bins[first : first + len(usual)] = blocks.reshape(usual.shape) > times * usual
    return bins, spectra


def _without_sinusoids(outputs: FloatArray, dt: float) -> tuple[FloatArray, list[float]]:
    """The outputs of one record less the sinusoids in them, and their frequencies [Hz]."""
    there = np.isfinite(outputs)
    size = np.sqrt(np.nanmean(np.square(outputs), axis=0))
    scaled = np.where(there, outputs, 0.0) / np.where(size > 0.0, size, 1.0)
    bins, power = line_bins(scaled)
    peaks = [
        first + int(power[first:last].max(axis=1).argmax()) for first, last in runs_of(np.asarray(bins.any(axis=1)))
    ]
    n = len(outputs)
    found: list[float] = []
    for peak in sorted(peaks, key=lambda k: -float(power[k].max())):
        if any(abs(peak - f * n * dt) < MAIN_LOBE for f in found):
            continue
        cycles = _sinusoid(np.fft.rfft(scaled, axis=0), peak)
        if cycles is None:
            continue
        time = np.arange(n) / n
        for _ in range(REFINED):  # the phase that a wrong frequency gains from the first half to the second
            halves = np.split(np.exp(-2j * np.pi * cycles * time)[:, np.newaxis] * scaled, [n // 2])
            first, second = (half.sum(axis=0) for half in halves)
            cycles += float(np.angle((first.conj() * second).sum())) / np.pi
        wave = np.exp(2j * np.pi * cycles * time)
        basis = np.column_stack([wave.real, wave.imag])
        for channel in range(outputs.shape[1]):
            rows = there[:, channel]
            weights = np.linalg.lstsq(basis[rows].T @ basis[rows], basis[rows].T @ scaled[rows, channel], rcond=None)[0]
            scaled[rows, channel] -= basis[rows] @ weights
        found.append(cycles / (n * dt))
    return (np.where(there, scaled * size, np.nan), found) if found else (outputs, found)


def _sinusoid(spectrum: np.ndarray, peak: int) -> float | None:
    """Frequency, in cycles a record, of the sinusoid that explains the motion near a peak; None where none does."""
    low, high = max(1, peak - WITHIN), min(len(spectrum), peak + WITHIN + 1)
    part = spectrum[low:high]
    # the motion near the peak as a short complex signal; a sinusoid stays one
    motion = np.fft.ifft(part, axis=0)
    fine = np.square(np.abs(np.fft.fft(motion, FINER * len(part), axis=0))).sum(axis=1)
    offset = float(fine.argmax()) / FINER
    wave = np.exp(2j * np.pi * offset / len(part) * np.arange(len(part)))[:, np.newaxis] / np.sqrt(len(part))
    left = np.fft.fft(motion - wave * (wave.conj() * motion).sum(axis=0), axis=0)
    return low + offset if np.square(np.abs(left)).sum(axis=1).max() <= MOST_LEFT * fine.max() else None


def _families(lines: FloatArray, apart: float) -> list[str]:
    """Multiples of one frequency among the lines, in words."""
    words, left = [], list(lines)
    for first in lines:
        members = [line for line in left if abs(line - round(line / first) * first) <= apart]
        if first in left and len(members) > 1:
            words.append(f"{listed([hertz(line) for line in members])} Hz are multiples of {hertz(first)} Hz")
            left = [line for line in left if line not in members]
    return words
