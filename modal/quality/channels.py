"""What each channel says by itself: by its spectrum (noise, no roll-off, few periods, hum) and by its level.

In the spectrum of a whole record (Hann window for the mains) the power of noise, and of a resonance that noise drives,
is spread like an exponential variable about a level that is smooth over a few hertz: it exceeds r times its mean with
probability e^-r, and r times the median of its neighbours with probability 2^-r; `FALSE_ALARM` gives both r. A line
stands alone: its power grows with the length of the record, that of its neighbours does not.

Drift is decided as the identification does (`modal.preparation.drift`), but with the pulse response of an observer in
the place of a model: what the inputs do is taken off, once with a response fitted to the records as they are and once
with one fitted to records without slow motion; then slow functions of time must predict held-out blocks of the rest
clearly better.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.preparation.channel import (
    BLOCK,
    FALSE_ALARM,
    FEWEST_ROWS,
    FITTED_ROWS,
    HARDLY,
    MOST_ROWS,
    MOSTLY,
    NEARLY_ALL,
    NOTABLE,
    Channel,
    Finding,
    named,
    spoken,
)
from modal.preparation.drift import (
    CANDIDATES,
    LEAST_GAIN,
    SAMPLES_PER_FUNCTION,
    SIGNIFICANT,
    SLOW_INPUTS,
    held_out_squares,
    is_significant,
    slow_functions,
    slow_motion,
    without_drift,
)
from modal.preparation.kind import N_PARTS
from modal.quality.coherence import best_pulse, predicted_outputs
from modal.wording.text import percent
from okid.arrays import FloatArray
from okid.errors import IdentificationError
from okid.record import Record
from okid.residuals import WHITENESS_LAGS, centred, whiteness

SMOOTHED = 16
"""Average the floor of a spectrum over so many lines."""

FEW_PERIODS = 10
"""Doubt a record that holds fewer periods of its strongest motion."""

WHITE = 1.5
"""Call an output white below this portmanteau statistic over its freedom: white noise is so in 93 of 100 cases."""

MAINS = (50.0, 60.0)
"""Look for lines of these mains [Hz]."""

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
    """Output-only records that hold few periods of their strongest motion."""
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
    multiples = [(base, base * k) for base in MAINS for k in range(1, 7)]
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


def hum_findings(channel: Channel, lines: HumLines, inputs: Sequence[HumLines]) -> list[Finding]:
    """Lines of an output that no input holds."""
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
            channel.finding(
                level="bad" if share >= MOSTLY else "doubtful" if share >= NOTABLE else "note",
                what="mains hum",
                sentence=f"output {named(channel.name)} holds {'sharp lines' if own.sum() > 1 else 'a sharp line'} of "
                f"the {base:.0f} Hz mains ({which} Hz), {percent(share)} of its motion"
                f"{', that no input holds' if inputs else ''}: hum of a ground loop or an unshielded cable, or a "
                "machine at that speed; take no mode there for one of the structure.",
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


LARGE_OFFSET = 10.0
"""Speak of a mean of so many standard deviations."""


CHANGED = 4.0
"""Say that the level changed where the median of one side is so many times that of the other."""

APART = 2.0
"""Ask that every block of one side be so many times as large as every one of the other: chance does not sort them."""

RING_DOWN = 1.3
"""Take levels for a start that dies out where every block is so many times the next one."""

STEADY = 1.5
"""Call an input steady whose blocks, and those of its steps, differ by less: neither its level nor its band changes."""

FEWEST_BLOCKS = 2
"""Ask for so many blocks with samples on either side of a change."""


def offset_findings(channel: Channel) -> list[Finding]:
    """A mean of many times the motion."""
    if channel.role == "input" or channel.std == 0.0 or abs(channel.mean) < LARGE_OFFSET * channel.std:
        return []
    ratio = abs(channel.mean) / channel.std
    return [
        channel.finding(
            level="note",
            what="offset",
            sentence=f"output {named(channel.name)} stands at {channel.value(channel.mean)}, {spoken(ratio)} times as "
            "far from zero as it moves: the mean is taken off before the fit, but most of the sensor's range serves "
            "the offset; couple it AC or zero it.",
        )
    ]


def is_steady(channel: Channel) -> bool:
    """Whether neither the mean nor the level of an input nor that of its steps from sample to sample changes."""
    for part in channel.parts:
        size = part.size // N_PARTS
        if size:
            away = part[: N_PARTS * size].reshape(N_PARTS, size) - channel.mean
            n_there = np.maximum((~np.isnan(away)).sum(axis=1), 1)  # a block without a sample tells nothing
            if not np.abs(np.nansum(away, axis=1) / n_there).max() <= channel.std:
                return False
    steps = tuple(np.diff(part) for part in channel.parts)
    return all(_spread(levels) <= STEADY for levels in (*block_levels(channel.parts), *block_levels(steps)))


def block_levels(parts: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """(10,) root mean square about each block's mean, a record of some length; nan for a block without a sample."""
    levels = []
    for part in parts:
        if part.size < FEWEST_ROWS:
            continue
        size = part.size // N_PARTS
        blocks = part[: N_PARTS * size].reshape(N_PARTS, size)
        there = ~np.isnan(blocks)
        count = np.where(there.any(axis=1), there.sum(axis=1), np.nan)
        mean = np.where(there, blocks, 0.0).sum(axis=1) / count
        squares = np.square(np.where(there, blocks - mean[:, np.newaxis], 0.0))
        levels.append(np.sqrt(squares.sum(axis=1) / count))
    return tuple(levels)


def level_findings(channel: Channel, inputs_steady: Sequence[bool]) -> list[Finding]:
    """An output whose level changes several times while every input's does not."""
    if channel.role == "input" or channel.std == 0.0 or not inputs_steady or not all(inputs_steady):
        return []
    for number, levels in enumerate(block_levels(channel.parts)):
        change = _change(levels)
        if change is None:
            continue
        cut, before, after = change
        part = [part for part in channel.parts if part.size >= FEWEST_ROWS][number]
        time = cut * (part.size // N_PARTS) * channel.dt
        ratio = max(before, after) / max(min(before, after), np.finfo(float).tiny)
        word, times = ("larger" if after > before else "smaller"), spoken(ratio) if ratio < 1e6 else "many"
        return [
            channel.finding(
                level="doubtful",
                what="level changes",
                sentence=f"output {named(channel.name)} is {times} times {word} from about {spoken(time)} s after the "
                "start, while the inputs keep their level: a sensor that came loose, a range that was switched, or a "
                "structure that changed; look there and cut the record.",
            )
        ]
    return []


def _change(levels: FloatArray) -> tuple[int, float, float] | None:
    """Block from which all levels differ from all before, with the medians of both sides; None if there is none.

    The first block, which holds the start from rest, is left out; two blocks at least lie on either side.
    """
    for cut in range(3, levels.size - 1):
        before, after = (part[~np.isnan(part)] for part in (levels[1:cut], levels[cut:]))
        if min(before.size, after.size) < FEWEST_BLOCKS:
            continue
        medians = float(np.median(before)), float(np.median(after))
        apart = max(float(after.min()) - APART * float(before.max()), float(before.min()) - APART * float(after.max()))
        rings_down = bool((levels[:cut] > RING_DOWN * levels[1 : cut + 1]).all())
        if apart > 0.0 and not rings_down and max(medians) > CHANGED * min(medians):
            return cut, *medians
    return None


def _spread(levels: FloatArray) -> float:
    known = levels[~np.isnan(levels)]
    return float(known.max() / known.min()) if known.size and known.min() > 0.0 else np.inf


def drift_findings(records: Sequence[Record]) -> list[Finding]:
    """Outputs that drift, by the longest record thinned to 6000 rows; none where an input is missing somewhere."""
    longest = max(records, key=lambda record: record.n_samples)
    if longest.n_inputs == 0 or longest.n_samples < FEWEST_ROWS or np.isnan(longest.inputs).any():
        return []
    slow = np.flatnonzero(_slow_shares(longest) > NOTABLE)
    if slow.size == 0:
        return []
    try:
        thinned = longest.decimated(max(1, -(-longest.n_samples // FITTED_ROWS)))
    except IdentificationError:
        return []
    if np.isnan(thinned.outputs).all(axis=0).any() or _slow_inputs(thinned) > SLOW_INPUTS:
        return []
    shares = {int(i): _drift_share(thinned.select(outputs=[int(i)])) for i in slow}
    which = sorted((i for i in shares if shares[i] > NOTABLE), key=lambda i: -shares[i])
    if not which:
        return []
    names = tuple(longest.output_names[i] for i in which)
    share = shares[which[0]]
    return [
        Finding(
            level="doubtful" if share > MOSTLY else "note",
            what="drift",
            where=named(names),
            sentence=f"output{'s' * (len(names) > 1)} {named(names)} drift{'s' * (len(names) == 1)} slowly in a way "
            f"that no input explains ({'up to ' * (len(names) > 1)}{percent(share)} of the power): temperature, a "
            "charge amplifier or an integrated signal; the identification takes drift off, motion that slow cannot "
            "be identified.",
            channels=names,
            share=share,
        )
    ]


def _slow_shares(record: Record) -> FloatArray:
    """(n_outputs,) share of an output's power that all slow functions can take, over block means."""
    shares = np.zeros(record.n_outputs)
    size = -(-record.n_samples // FEWEST_ROWS)
    n_blocks = record.n_samples // size
    functions = np.linalg.qr(slow_functions(n_blocks, CANDIDATES[-1]))[0][:, 1:]
    for i in range(record.n_outputs):
        values = record.outputs[: n_blocks * size, i]
        there = ~np.isnan(values)
        if not there.any():
            continue
        blocks = np.where(there, values - values[there].mean(), 0.0).reshape(n_blocks, size).mean(axis=1)
        taken = float(np.sum((functions.T @ blocks) ** 2)) / n_blocks
        shares[i] = taken / max(float(values[there].var()), np.finfo(float).tiny)
    return shares


def _slow_inputs(record: Record) -> float:
    """Largest power of an input in the slow functions, relative to that of white noise of the same size."""
    functions = np.linalg.qr(slow_functions(record.n_samples, CANDIDATES[-1]))[0][:, 1:]
    inputs = record.inputs - record.inputs.mean(axis=0)
    slow = np.sum((functions.T @ inputs) ** 2, axis=0) / functions.shape[1]
    return float((slow / np.maximum(inputs.var(axis=0), np.finfo(float).tiny)).max())


def _drift_share(record: Record) -> float:
    """Share of one output's power that drifts; 0 where no drift is proved."""
    most = [n for n in CANDIDATES if n <= record.n_samples // SAMPLES_PER_FUNCTION]
    there = ~np.isnan(record.outputs[:, 0])
    if not there.all():
        record = record.samples(*_longest_run(there))
        most = [n for n in most if n <= record.n_samples // SAMPLES_PER_FUNCTION]
    if record.n_samples < FEWEST_ROWS or len(most) < 2:
        return 0.0
    plain = without_drift(record, 0)
    own, freed = best_pulse(plain), best_pulse(without_drift(record, most[-1]))
    if freed is None or not freed[1].min() >= -MOSTLY:  # it adds more than it explains: nothing is known
        return 0.0
    settled = record.n_samples // 10  # the answer to what came before the record has died out, about
    left = (plain.outputs - predicted_outputs(freed[0], plain.inputs))[settled:]
    errors = {n: held_out_squares(slow_motion([left]), n) for n in most}
    best = min(most, key=lambda n: float(errors[n].sum()))
    without = errors[0]
    if own is not None:
        missed = (plain.outputs - predicted_outputs(own[0], plain.inputs))[settled:]
        explained = held_out_squares(slow_motion([missed]), 0)
        without = explained if explained.sum() < without.sum() else without
    gain = without - errors[best]
    if best == 0 or not is_significant(gain, SIGNIFICANT) or gain.sum() < LEAST_GAIN * without.sum():
        return 0.0
    moved = [held_out_squares(slow_motion([plain.outputs[settled:]]), n).sum() for n in (0, best)]
    if gain.sum() < MOSTLY * (moved[0] - moved[1]):  # the rest is what the pulse response missed
        return 0.0
    functions = slow_functions(len(left), best)
    fitted = functions @ np.linalg.lstsq(functions, left, rcond=None)[0]
    return min(1.0, float(fitted.var() / plain.outputs[settled:].var()))


def _longest_run(there: np.ndarray) -> tuple[int, int]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    starts, stops = edges[::2], edges[1::2]
    i = int((stops - starts).argmax())
    return int(starts[i]), int(stops[i])
