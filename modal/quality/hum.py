"""Hum of the mains: lines at 50 or 60 Hz and their multiples that the inputs do not hold.

In the spectrum of the whole record (Hann window) the power of noise, and of a resonance that noise drives, is
spread like an exponential variable about a level that is smooth over a few hertz: it exceeds r times the median of its
neighbours with probability 2^-r. A line stands alone: its power grows with the length of the record, that of its
neighbours does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.quality.channel import Channel, named, spoken, where_found
from modal.quality.findings import Finding
from modal.wording.numbers import percent
from okid.arrays import FloatArray

__all__ = ["HumLines", "hum_findings", "mains_lines"]

MAINS = (50.0, 60.0)
MOST_MULTIPLES = 6
OFF = 0.002
"""Of its frequency: how far the mains stray."""
NEIGHBOURS = (2.5, 8.0, 40.0)
"""Resolutions (one over the duration) from the peak to its neighbours: from just outside the window's main lobe, to
either of two distances. The larger median counts, so that the peak of a resonance is compared with its own flanks."""
STANDS_OUT = 30.0
"""Power over the median of the neighbours: by chance with probability 1e-9 a line."""
HOLDS = 15.0
"""The same from which an input is said to hold the line itself."""
SHORTEST = 10.0
"""Seconds: in a shorter record a line is as wide as a mode of 50 Hz with half a per cent of damping."""
DOUBTFUL_SHARE = 0.01
BAD_SHARE = 0.5


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
    if mains.size and duration >= SHORTEST and channel.std > 0.0:
        window = np.hanning(part.size + 1)[:-1]
        size = 1 << part.size.bit_length()
        spectrum = np.fft.rfft(np.nan_to_num(part - channel.mean) * window, size)
        power = spectrum.real**2 + spectrum.imag**2
        step = 1.0 / (size * channel.dt)
        for i, frequency in enumerate(frequencies):
            strays = OFF * frequency + 1.0 / duration
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
    there = lines.prominence > STANDS_OUT
    for one in inputs:
        there &= one.prominence < HOLDS
    found: list[Finding] = []
    for base in MAINS:
        own = there & (lines.mains == base)
        if not own.any():
            continue
        share = float(np.sqrt(np.sum(lines.rms[own] ** 2)) / channel.std)
        which = ", ".join(spoken(f) for f in lines.frequencies[own])
        found.append(
            Finding(
                level="bad" if share >= BAD_SHARE else "doubtful" if share >= DOUBTFUL_SHARE else "note",
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
