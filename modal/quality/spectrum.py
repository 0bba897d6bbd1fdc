"""What the spectrum of a channel tells: a bound on its noise, no roll-off, few periods, white noise, hum of the mains.

In the spectrum of a whole record (Hann window for the mains) the power of noise, and of a resonance that noise drives,
is spread like an exponential variable about a level that is smooth over a few hertz: it exceeds r times its mean with
probability e^-r, and r times the median of its neighbours with probability 2^-r; `FALSE_ALARM` gives both r. A line
stands alone: its power grows with the length of the record, that of its neighbours does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.preparation.channel import (
    BLOCK,
    FALSE_ALARM,
    HARDLY,
    MOST_ROWS,
    MOSTLY,
    NEARLY_ALL,
    NOTABLE,
    Channel,
    Finding,
    named,
    spoken,
    where_found,
)
from modal.wording.numbers import percent
from okid.arrays import FloatArray
from okid.record import Record
from okid.residuals import WHITENESS_LAGS, centred, whiteness

__all__ = [
    "HumLines",
    "alias_findings",
    "hum_findings",
    "mains_lines",
    "most_white_noise",
    "period_findings",
    "white_findings",
]

SMOOTHED = 16
"""Average the floor of a spectrum over so many lines."""

FEW_PERIODS = 10
"""Doubt a record that holds fewer periods of its strongest motion."""

WHITE = 1.5
"""Call an output white below this portmanteau statistic over its freedom: white noise is so in 93 of 100 cases."""

MAINS = (50.0, 60.0)
"""Look for lines of these mains [Hz]."""

MOST_MULTIPLES = 6
"""Look for so many multiples of the mains."""

STRAY = 0.002
"""Look for a line of the mains within this share of its frequency."""

NEIGHBOURS = (2.5, 8.0, 40.0)
"""Compare a line with its neighbours between the first and either other distance, in resolutions (one over the
duration): from just outside the window's main lobe. The larger median counts, so that the peak of a resonance is
compared with its own flanks."""

LEAST_DURATION = 10.0
"""Look for no line in a shorter record [s]: it would be as wide as a mode of 50 Hz with half a per cent of damping."""


def most_white_noise(frequencies: FloatArray, density: FloatArray) -> float:
    """Standard deviation of the most white noise that a channel can hold: its density nowhere exceeds the spectrum.

    Args:
        frequencies: (n_frequencies,) [Hz], evenly spaced.
        density: (n_frequencies,) power spectral density [unit^2/Hz].

    Example:
        >>> round(most_white_noise(np.linspace(0, 50, 101), np.full(101, 0.08)), 6)
        2.0
    """
    inner = density[1:-1]
    if inner.size < SMOOTHED:
        return float("nan")
    sums = np.concatenate([[0.0], np.cumsum(inner)])
    lowest = float(((sums[SMOOTHED:] - sums[:-SMOOTHED]) / SMOOTHED).min())
    return float(np.sqrt(max(lowest, 0.0) * frequencies[-1]))


def alias_findings(record: Record, frequencies: FloatArray, densities: FloatArray) -> list[Finding]:
    """Outputs with motion up to half the sampling frequency; nothing is said of inputs that a converter held.

    Args:
        record: any of the records, for names and hold.
        frequencies: (n_frequencies,) [Hz].
        densities: (n_frequencies, n_outputs).
    """
    if record.input_hold == "zero_order" and record.n_inputs:
        return []
    top = frequencies > NEARLY_ALL * frequencies[-1]
    very_top = (frequencies > 0.95 * frequencies[-1]) & (frequencies < frequencies[-1])
    middle = (frequencies > 0.6 * frequencies[-1]) & (frequencies < 0.8 * frequencies[-1])
    if not very_top.any() or not middle.any():
        return []
    total = np.maximum(densities[1:].sum(axis=0), np.finfo(float).tiny)
    shares = densities[top].sum(axis=0) / total
    flat = densities[very_top].mean(axis=0) > MOSTLY * densities[middle].mean(axis=0)
    which = np.flatnonzero((shares > NOTABLE) & flat)
    if which.size == 0:
        return []
    names = tuple(record.output_names[i] for i in which)
    share = float(shares[which].max())
    return [
        Finding(
            level="note",
            what="no roll-off",
            where=named(names),
            sentence=f"output{'s' * (len(names) > 1)} {named(names)} hold{'s' * (len(names) == 1)} up to "
            f"{percent(share)} of the power above {spoken(NEARLY_ALL * frequencies[-1])} Hz and no roll-off below half "
            "the sampling frequency: without an anti-alias filter, motion above it is folded into the band; if there "
            "was none, sample faster.",
            channels=names,
            share=share,
        )
    ]


def period_findings(records: Sequence[Record]) -> list[Finding]:
    """Output-only records that hold few periods of their strongest motion.

    Args:
        records: without inputs; of others nothing is said, whose slow motion may be the inputs' doing.
    """
    longest = max(records, key=lambda record: record.n_samples)
    if longest.n_inputs or longest.n_samples < BLOCK:
        return []
    summed = np.zeros(longest.n_samples // 2 + 1)
    for i in range(longest.n_outputs):
        values = longest.outputs[:, i]
        # no window: it would leave nothing of a decay but its end
        power = np.square(np.abs(np.fft.rfft(np.nan_to_num(values - np.nanmean(values)))))
        summed += power / max(float(power.sum()), np.finfo(float).tiny)
    n_periods = 1 + int(summed[1:].argmax())
    if n_periods >= FEW_PERIODS or summed[n_periods] < -np.log(FALSE_ALARM) * summed[1:].mean():
        return []
    frequency = n_periods / longest.duration
    return [
        Finding(
            level="doubtful",
            what="too short",
            where="whole record",
            sentence=f"the strongest motion, at {spoken(frequency)} Hz or slower, has {n_periods:.0f} periods at most "
            f"in the longest record of {spoken(longest.duration)} s: too few for a frequency or a damping ratio of "
            f"it; record for {spoken(2 * FEW_PERIODS / frequency)} s or more, or take slow drift off first.",
        )
    ]


def white_findings(records: Sequence[Record], explained: FloatArray) -> list[Finding]:
    """Outputs that are white noise, which no structure's motion is, and that the inputs explain nothing of.

    Args:
        records: of one system.
        explained: (n_outputs,) share of the power above chance that the inputs explain, nan where not known.
    """
    longest = max(records, key=lambda record: record.n_samples)
    found: list[Finding] = []
    for i, name in enumerate(longest.output_names):
        values = longest.outputs[:MOST_ROWS, [i]]
        if len(values) < 10 * WHITENESS_LAGS or np.isnan(values).any() or values.std() == 0.0:
            continue
        if longest.n_inputs and not explained[i] < HARDLY:
            continue
        ratio = whiteness(centred([values / values.std()]), n_lags=WHITENESS_LAGS, n_fitted=0).ratio
        if not ratio < WHITE:
            continue
        found.append(
            Finding(
                level="doubtful",
                what="white noise",
                where=named(name),
                sentence=f"output {named(name)} is white noise (portmanteau ratio {ratio:.2g}, 1 for white)"
                f"{' and has nothing to do with the inputs' if longest.n_inputs else ''}: there is no motion in it to "
                "identify, only the noise of its sensor; look whether it is connected and its range is right.",
                channels=(name,),
            )
        )
    return found


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HumLines:
    """What stands at the multiples of the mains in one channel.

    Attributes:
        mains: (n_lines,) 50 or 60 [Hz].
        frequencies: (n_lines,) [Hz].
        prominence: (n_lines,) power over the median of the neighbours, 0 where the record is too short for it.
        rms: (n_lines,) root mean square of each line, in the channel's unit.
    """

    mains: FloatArray
    frequencies: FloatArray
    prominence: FloatArray
    rms: FloatArray


def mains_lines(channel: Channel) -> HumLines:
    """Prominence and size of the multiples of 50 and 60 Hz, over the longest record."""
    multiples = [(base, base * k) for base in MAINS for k in range(1, MOST_MULTIPLES + 1)]
    mains, frequencies = np.array([pair for pair in multiples if pair[1] < 0.45 / channel.dt]).reshape(-1, 2).T
    part = max(channel.parts, key=len)
    duration = part.size * channel.dt
    prominence, rms = np.zeros(mains.size), np.zeros(mains.size)
    if mains.size and duration >= LEAST_DURATION and channel.std > 0.0:
        window = np.hanning(part.size + 1)[:-1]
        size = 1 << part.size.bit_length()
        spectrum = np.fft.rfft(np.nan_to_num(part - channel.mean) * window, size)
        power = spectrum.real**2 + spectrum.imag**2
        step = 1.0 / (size * channel.dt)
        for i, frequency in enumerate(frequencies):
            strays = STRAY * frequency + 1.0 / duration
            near = _between(frequency - strays, frequency + strays, step)
            peak = near.start + int(power[near].argmax())
            largest = float(power[peak])
            skip, *reaches = (times / duration for times in NEIGHBOURS)
            usual = max(_median_beside(power, peak * step, skip, reach, step) for reach in reaches)
            prominence[i] = largest / max(usual, np.finfo(float).tiny)
            rms[i] = np.sqrt(2.0 * max(largest - usual, 0.0)) / window.sum()
    return HumLines(mains=mains, frequencies=frequencies, prominence=prominence, rms=rms)


def hum_findings(channel: Channel, lines: HumLines, inputs: Sequence[HumLines], n_records: int) -> list[Finding]:
    """Lines of an output that no input holds.

    Args:
        channel: an output.
        lines: of it.
        inputs: of the inputs.
        n_records: number of records.
    """
    if channel.role == "input" or channel.std == 0.0:
        return []
    stands_out = -np.log2(FALSE_ALARM)
    there = lines.prominence > stands_out
    for one in inputs:
        there &= one.prominence < MOSTLY * stands_out
    found: list[Finding] = []
    for base in MAINS:
        own = there & (lines.mains == base)
        if not own.any():
            continue
        share = float(np.sqrt(np.sum(lines.rms[own] ** 2)) / channel.std)
        which = ", ".join(spoken(f) for f in lines.frequencies[own])
        found.append(
            Finding(
                level="bad" if share >= MOSTLY else "doubtful" if share >= NOTABLE else "note",
                what="mains hum",
                where=where_found(channel.name, (), n_records),
                sentence=f"output {named(channel.name)} holds {'sharp lines' if own.sum() > 1 else 'a sharp line'} of "
                f"the {base:.0f} Hz mains ({which} Hz), {percent(share)} of its motion"
                f"{', that no input holds' if inputs else ''}: hum of a ground loop or an unshielded cable, or a "
                "machine at that speed; take no mode there for one of the structure.",
                channels=(channel.name,),
                share=share,
            )
        )
    return found


def _median_beside(power: FloatArray, frequency: float, skip: float, reach: float, step: float) -> float:
    """Median power between `skip` and `reach` [Hz] on either side of a frequency; the larger side counts."""
    below = power[_between(frequency - reach, frequency - skip, step)]
    above = power[_between(frequency + skip, frequency + reach, step)]
    return max(float(np.median(below)), float(np.median(above)))


def _between(low: float, high: float, step: float) -> slice:
    return slice(max(1, int(np.floor(low / step))), max(2, int(np.ceil(high / step)) + 1))
