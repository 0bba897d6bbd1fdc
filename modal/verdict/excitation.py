"""Does the input drive this mode? How much of the outputs is lost when its answer to the inputs is left out.

A periodic disturbance is found again in every part of a record, as an undamped pole, and the fit gives it some
participation by chance. On rows that the model has not seen, that participation only does harm: the free run is better
without it. For a mode that the input drives it gets worse.

Tones are lines too. A shaker that plays a few of them determines the response at so many frequencies and nowhere else;
poles that stand on them, or anywhere between, explain the record as well as the modes do. What tells a mode is its
answer between the lines: to what else the force holds, and to the tones' beginnings and ends. The sums and multiples of
tones, which amplifier, shaker and joints make, are lines as well, however weak: each tells of one frequency, in the
force or in the answer alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from era.state_recursion import PoleRecursion
from modal.estimation.whitening import output_filters, stretches
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel, Mode
from modal.preparation.kind import acting_in
from modal.preparation.lines import MAIN_LOBE, blackman_harris, line_bins
from modal.verdict.probability import FEWEST_TURNS, HARDLY_DRIVEN, drifting, f_ratio
from modal.wording.text import counted, hertz, listed
from okid.arrays import ROUNDED, BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import complete_rows, runs_of, usable_rows

N_SHIFTS = 19
"""Compare what the inputs explain with what so many shifts of them do: chance alone is best once in twenty times."""
LEAST_DECAY = 1.0
"""Decay -Re(s) T over the longest record below which a mode cannot be told from a line that never ends."""
DEVIATIONS = 3.0
"""Standard deviations by which the logarithm of the damping may be smaller than it seems."""
UNDAMPED_GAIN = 0.1
"""Held-out gain from which such a mode is taken for driven all the same."""
NEARLY_ALL = 0.99
"""Count the strongest lines that hold this share of their power: a fit at best tells a hundredth."""
WEAK_LINE = 1e-3
"""Leave out beside the lines what stands above its neighbourhood more than chance lets one record do in a thousand."""
FAINT = 1e-4
"""Ask in a mode's own band where the inputs hold less than this share of their largest density: noise and leakage."""
MOST_SHOWN = 6
"""Name so many lines in a sentence."""
MOSTLY = 0.5
"""Call an input one of lines where they hold more than this share of its power; ask what a window sees of an answer
where it is more than this share of what it sees of an even one."""


def driven_gain(
    model: ModalModel,
    records: Sequence[Record],
    left: Sequence[FloatArray],
    *,
    rows: Sequence[BoolArray] | None = None,
    by_itself: bool = True,
) -> FloatArray:
    """Share of the squared error without what the inputs make a mode do that this removes.

        gain_i = 1 - |e|^2 / |e + y_i|^2

    with e what the model's free run leaves, initial states fitted, and y_i the mode's answer to the inputs from rest,
    both behind the filter that makes e white (`modal.estimation.whitening`): a mode is weighed by the noise beside it.
    What the mode could do by itself, from any state in each output, and a constant are projected out of both. A line
    that the inputs do not drive is all free motion, and its answer to them is chance; left in, the fitted state would
    make up for that answer, and the answer seem to matter.

    Args:
        model: modes of the model that ran.
        records: that it ran through; missing inputs count as zero.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.
        rows: (n_samples,) a record, True where a row counts; all unless given. The filter's past may be any row.
        by_itself: whether the mode could also move by itself in these rows, which is projected out.

    Returns:
        (n_modes,) at most 1, negative where the run is better without; nan for growing modes, and for all without
        inputs or without a row.
    """
    modes = model.modes
    gains = np.full(len(modes), np.nan)
    if not modes or not records[0].n_inputs:
        return gains
    poles, is_pair = discrete_poles(modes, model.dt)
    weight = np.where(is_pair, 2.0, 1.0)
    driven = [i for i in range(len(modes)) if modes[i].kind != "unstable"]
    counted = [np.ones(record.n_samples, dtype=np.bool_) for record in records] if rows is None else rows
    with_it, without = np.zeros(len(modes)), np.zeros(len(modes))
    n_rows = 0
    whole = [complete_rows(errors) for errors in left]
    seen = stretches(left, whole)
    if not seen:
        return gains
    filters = output_filters(seen)
    memory = max(one.size for one in filters) - 1
    for record, errors, finite, there in zip(records, left, whole, counted, strict=True):
        inputs = np.nan_to_num(record.inputs)
        times = np.flatnonzero(usable_rows(finite, memory) & there)
        if not times.size:
            continue
        n_rows += times.size
        rest = _white(errors, filters, times)
        every = np.ones(record.n_samples, dtype=np.bool_)
        for i in driven:
            part = answer_from_rest(
                inputs @ modes[i].participation, complex(poles[i]), weight[i] * modes[i].shape, every
            )
            free = _free_motion(complex(poles[i]), times) if by_itself else np.empty((len(rest), 0))
            for total, values in ((with_it, rest), (without, rest + _white(part, filters, times))):
                total[i] += float((values**2).sum() - ((free.T @ values) ** 2).sum())
    if n_rows:
        least = np.finfo(float).eps * with_it[driven] + np.finfo(float).tiny  # nothing without: nothing is gained
        gains[driven] = 1 - with_it[driven] / np.maximum(without[driven], least)
    return gains


def _white(values: FloatArray, filters: Sequence[FloatArray], times: NDArray[np.intp]) -> FloatArray:
    """(n_times, n_outputs) of the rows that are wanted, each output behind its filter."""
    return np.column_stack([sum(one * values[times - k, o] for k, one in enumerate(a)) for o, a in enumerate(filters)])


def _free_motion(pole: complex, times: NDArray[np.intp]) -> FloatArray:
    """(n_times, 1 to 3) orthonormal: a constant, and what the mode does by itself from any state."""
    with np.errstate(under="ignore"):
        motion = np.exp(np.log(pole) * (times - times[0]))
    columns = [np.ones(times.size), motion.real, *([motion.imag] if pole.imag else [])]
    basis, corner = np.linalg.qr(np.column_stack(columns))
    size = np.abs(np.diag(corner))
    kept: FloatArray = basis[:, size > 1e-9 * size.max()]
    return kept


def answer_from_rest(drive: ComplexArray, pole: complex, shape: ComplexArray, kept: BoolArray) -> FloatArray:
    """(n_kept, n_outputs) of x(k+1) = pole x(k) + drive(k), y(k) = Re(shape x(k)), from rest."""
    recursion = PoleRecursion.of(np.array([pole]), drive.size)
    states, _ = recursion.run(drive[np.newaxis], np.zeros(1, dtype=np.complex128))
    return (states[0, kept, np.newaxis] * shape).real


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BetweenLines:
    """What inputs of a few lines tell of each mode.

    Attributes:
        lines: (n_lines,) [Hz], by rising frequency.
        gain: (n_modes,) as `driven_gain`, on the frequencies within the mode's half-power bandwidth on either side, and
            two main lobes of the window at least, at which no input and no output has a line.
        n_values: (n_modes,) independent values that it was taken on, all outputs together.
    """

    lines: FloatArray
    gain: FloatArray
    n_values: NDArray[np.intp]

    @property
    def shown(self) -> str:
        """The lines in words."""
        which = listed([hertz(line) for line in self.lines[:MOST_SHOWN]])
        return f"{counted(self.lines.size)} line{'s' * (self.lines.size > 1)} ({which} Hz)" if (
            self.lines.size <= MOST_SHOWN
        ) else f"{self.lines.size} lines"  # fmt: skip


def between_lines(
    model: ModalModel, records: Sequence[Record], left: Sequence[FloatArray], *, output_scale: FloatArray
) -> BetweenLines | None:
    """The evidence of each mode beside the lines of the inputs; None where these are not a few lines.

    The gain of `driven_gain` in the frequency domain (Parseval, Blackman-Harris window), near the mode's frequency and
    without the lines and what the window makes of them.

    Args:
        model: modes of the model that ran.
        records: that it ran through.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.
        output_scale: (n_outputs,) sizes of the outputs.
    """
    modes = model.modes
    if not modes or not records[0].n_inputs:
        return None
    looked = [_line_bins(np.nan_to_num(record.inputs)) for record in records]
    poles, is_pair = discrete_poles(modes, model.dt)
    lines = _lines(looked, records)
    few = 0 < lines.size < 3 * int(np.where(is_pair, 2, 1).sum())  # three numbers an unknown, as rows have
    if not few or max(one.share for one in looked) < MOSTLY:
        return None
    with_it, without, n_values = np.zeros(len(modes)), np.zeros(len(modes)), np.zeros(len(modes), dtype=np.intp)
    for record, errors, one in zip(records, left, looked, strict=True):
        n = record.n_samples
        there = complete_rows(errors)
        between = _between(record, one.bins)
        frequencies = np.fft.rfftfreq(n, record.dt)
        window = np.where(there, blackman_harris(n), 0.0)[:, np.newaxis]
        rest = np.fft.rfft(window * np.where(there[:, np.newaxis], errors / output_scale, 0.0), axis=0)
        inputs, every = np.nan_to_num(record.inputs), np.ones(n, dtype=np.bool_)
        for i, mode in enumerate(modes):
            # of a mode narrower than the window's main lobe, what shows beside it is its skirt
            reach = max(2.0 * mode.damping_ratio * mode.frequency, 2 * (MAIN_LOBE + 1) / (n * record.dt))
            near = (np.abs(frequencies - mode.frequency) <= reach) & between
            if mode.kind == "unstable" or not near.any():
                continue
            weight = 2.0 if is_pair[i] else 1.0
            part = (
                answer_from_rest(inputs @ mode.participation, complex(poles[i]), weight * mode.shape, every)
                / output_scale
            )
            with_it[i] += np.square(np.abs(rest[near])).sum()
            without[i] += np.square(np.abs((rest + np.fft.rfft(window * part, axis=0))[near])).sum()
            # a frequency holds two numbers, and the window makes neighbours alike two by two
            n_values[i] += int(near.sum()) * output_scale.size
    gain = 1.0 - with_it / np.maximum(without, np.finfo(float).tiny)
    return BetweenLines(lines=lines, gain=np.where(n_values > 0, gain, np.nan), n_values=n_values)


def beyond_inputs(
    model: ModalModel, records: Sequence[Record], left: Sequence[FloatArray], *, output_scale: FloatArray
) -> tuple[FloatArray, NDArray[np.intp]]:
    """The evidence of each mode in its own band, where the inputs hardly move there: at the edge of theirs.

    A pole there fits the flank that the answers have within the band of the inputs. What a mode does shows in its own
    band: the gain of `driven_gain` there, in the frequency domain (Parseval, Blackman-Harris window), in which the
    noise of a measured input explains nothing. The window hardly sees the ends of a record, where a sweep may pass the
    mode: of an answer of which it sees less than half of an even share nothing is told.

    Args:
        model: modes of the model that ran.
        records: that it ran through.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.
        output_scale: (n_outputs,) sizes of the outputs.

    Returns:
        (n_modes,) gain, nan where an input moves in the mode's band or nothing can be told, and (n_modes,) independent
        values.
    """
    seen, even = np.zeros((2, len(model)))
    with_it, without, n_values = np.zeros(len(model)), np.zeros(len(model)), np.zeros(len(model), dtype=np.intp)
    poles, _ = discrete_poles(model.modes, model.dt)
    moving = np.zeros(len(model), dtype=np.bool_)
    for record, errors in zip(records, left, strict=True):
        n, there = record.n_samples, complete_rows(errors)
        frequencies, inputs = np.fft.rfftfreq(n, record.dt), np.nan_to_num(record.inputs)
        window = np.where(there, blackman_harris(n), 0.0)[:, np.newaxis]
        density = np.square(np.abs(np.fft.rfft(window * (inputs - inputs.mean(axis=0)), axis=0)))
        rest = np.fft.rfft(window * np.where(there[:, np.newaxis], errors / output_scale, 0.0), axis=0)
        every = np.ones(n, dtype=np.bool_)
        summed = np.vstack([np.zeros(density.shape[1]), np.cumsum(density, axis=0)])
        for i, mode in enumerate(model.modes):
            half = max(mode.damping_ratio * mode.frequency, (MAIN_LOBE + 1) / (n * record.dt))
            first, last = np.searchsorted(frequencies, [mode.frequency - half, mode.frequency + half])
            if mode.kind != "oscillatory" or last - first < 2:
                moving[i] = True
                continue
            bands = summed[last - first :] - summed[: first - last]
            here = summed[last] - summed[first]
            moving[i] |= bool((here > FAINT * bands.max(axis=0)).any())
            if moving[i]:
                continue
            near = slice(first, last)
            part = (
                answer_from_rest(inputs @ mode.participation, complex(poles[i]), 2.0 * mode.shape, every) / output_scale
            )
            seen[i] += np.square(window * part).sum()
            even[i] += np.square(blackman_harris(n)).mean() * np.square(part[there]).sum()
            with_it[i] += np.square(np.abs(rest[near])).sum()
            without[i] += np.square(np.abs((rest + np.fft.rfft(window * part, axis=0))[near])).sum()
            n_values[i] += int(last - first) * output_scale.size
    gain = 1.0 - with_it / np.maximum(without, np.finfo(float).tiny)
    return np.where(moving | (n_values == 0) | (seen < MOSTLY * even), np.nan, gain), n_values


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Lines:
    """Where any input of a record has a line: (n_frequencies,) each; the power there, and its largest share."""

    bins: BoolArray
    power: FloatArray
    share: float


def _line_bins(inputs: FloatArray) -> _Lines:
    bins, spectra = line_bins(inputs)
    power = np.where(bins, spectra, 0.0)
    return _Lines(
        bins=np.asarray(bins.any(axis=1), dtype=np.bool_), power=power.sum(axis=1), share=float(power.sum(axis=0).max())
    )


def _between(record: Record, lines: BoolArray) -> BoolArray:
    """(n_frequencies,) where neither an input nor an output has a line, however weak, and the window shows none."""
    times = float(np.log2(lines.size / WEAK_LINE))
    weak, _ = line_bins(np.nan_to_num(np.hstack([record.inputs, record.outputs])), times=times)
    shown = np.convolve(lines | weak.any(axis=1), np.ones(2 * MAIN_LOBE + 1), mode="same")
    return np.asarray(shown == 0)


def _lines(looked: Sequence[_Lines], records: Sequence[Record]) -> FloatArray:
    """(n_lines,) [Hz] that hold nearly all of the lines' power; what the window cannot tell apart is one."""
    frequency, power = np.empty(0), np.empty(0)
    for one, record in zip(looked, records, strict=True):
        for first, last in runs_of(one.bins):
            peak = first + int(one.power[first:last].argmax())
            frequency = np.append(frequency, peak / record.duration)
            power = np.append(power, one.power[first:last].sum())
    order = np.argsort(-power)
    enough = 1 + int(np.searchsorted(np.cumsum(power[order]), NEARLY_ALL * power.sum()))
    kept = np.sort(frequency[order[:enough]])
    apart = MAIN_LOBE / min(record.duration for record in records)
    return kept[np.diff(kept, prepend=-np.inf) > apart]


def ringing(model: ModalModel, records: Sequence[Record], left: Sequence[FloatArray]) -> FloatArray:
    """(n_modes,) F ratio of what each mode does while no input acts, from the first blow or release on.

    A blow has zeros in its spectrum. A pole on one of them answers while the blow lasts, whatever happens then (an
    amplifier that is overloaded, a sensor that shifts), and is over with it. A mode rings on. Where errors ring as it
    does, under wind, the filter that makes them white takes the ringing away as well: so the product of the answer with
    the records without it is also compared with its products with the errors at all other times.

    Args:
        model: modes of the model that ran.
        records: that it ran through.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.

    Returns:
        nan where no row is without an input.

    Example:
        >>> blow = np.r_[1.0, 1.0, np.zeros(98)]  # nothing at half the sampling rate
        >>> modes = tuple(Mode(pole=-0.1 + 2j * np.pi * f, kind="oscillatory", frequency=f, damping_ratio=0.1 / f / 6.3,
        ...                    shape=np.ones(1), participation=np.ones(1)) for f in (10.0, 49.999))
        >>> model = ModalModel(modes=modes, dt=0.01, indicator_caution=0.1)
        >>> noise = np.random.default_rng(0).standard_normal((100, 1))
        >>> (ringing(model, [Record(blow, np.ones(100), 0.01)], [noise]) > 5.0).tolist()
        [True, False]
    """
    acting = acting_in(records)
    over = [~own & (np.arange(own.size) >= own.argmax()) for own in acting]
    after = [np.where(own[:, np.newaxis], errors, np.nan) for own, errors in zip(over, left, strict=True)]
    gains = driven_gain(model, records, after, by_itself=False)
    n_values = records[0].n_outputs * sum(int(complete_rows(errors).sum()) for errors in after)
    white = np.array([f_ratio(mode, float(gain), n_values) for mode, gain in zip(model.modes, gains, strict=True)])
    return np.fmax(white, _beyond_other_times(model, records, after))


def _beyond_other_times(model: ModalModel, records: Sequence[Record], left: Sequence[FloatArray]) -> FloatArray:
    """(n_modes,) square of the product of each answer with the records without it, over what chance makes, and over k.

    With the errors e of n rows y'e varies by sum over lags of (y'e(lag))^2 / n, whatever their colour; k: `f_ratio`.
    """
    poles, _ = discrete_poles(model.modes, model.dt)
    rows = [complete_rows(errors) for errors in left]
    together = np.concatenate([errors[there] for errors, there in zip(left, rows, strict=True)])
    size = np.sqrt(np.square(together).sum(axis=0) / max(len(together), 1))
    size, (common, chance) = np.maximum(size, ROUNDED * size.max()), np.zeros((2, len(model)))
    if not size.any():
        return np.full(len(model), np.nan)
    for record, errors, there in zip(records, left, rows, strict=True):
        e = np.where(there[:, np.newaxis], errors / size, 0.0)
        spectrum = np.fft.rfft(e, 2 * there.size, axis=0)
        for i, mode in enumerate(model.modes):
            if mode.kind != "oscillatory" or not there.any():
                continue
            drive, shape = np.nan_to_num(record.inputs) @ mode.participation, 2.0 * mode.shape / size
            y = answer_from_rest(drive, complex(poles[i]), shape, np.ones_like(there)) * there[:, np.newaxis]
            lags = np.fft.irfft((np.fft.rfft(y, 2 * there.size, axis=0).conj() * spectrum).sum(axis=1))
            common[i] += float((y * (y + e)).sum())
            chance[i] += float(np.square(lags).sum() / there.sum())
    k = np.array([2 * (mode.shape.size + mode.participation.size) for mode in model.modes])
    return np.divide(np.square(common), k * chance, out=np.full(len(model), np.nan), where=chance > 0)


def undriven_doubt(mode: Mode, gain: float, duration: float, *, free: bool = False) -> tuple[str, ...]:
    """Why a mode may be no answer to the input, in words; empty where there is no doubt.

    Args:
        mode: from the whole record.
        gain: its mean held-out gain; nan where unknown.
        duration: of the longest record [s]; nan where unknown.
        free: whether it rings down undriven: what drives wanders, but of what is free a line that never ends has no
            damping beyond its deviation.

    Example:
        >>> mode = Mode(pole=-0.01 + 9j, kind="oscillatory", frequency=1.43, damping_ratio=0.0011,
        ...             shape=np.ones(1), participation=np.ones(1))
        >>> undriven_doubt(mode, 0.02, 20.0)
        ('an undamped line, which decays by only 18 % over 20 s: periodic disturbance?',)
    """
    # the least decay that its standard deviation allows; a line's damping is not zero, but cannot be told from zero.
    # The smaller a damping ratio the smaller its deviation: its logarithm is what is about normal
    spread = 0.0 if np.isnan(mode.damping_ratio_std) else mode.damping_ratio_std / abs(mode.damping_ratio or 1.0)
    decay = -mode.pole.real * duration * float(np.exp(-DEVIATIONS * spread))
    undamped = mode.kind == "oscillatory" and decay < LEAST_DECAY
    undamped &= not (free and mode.damping_ratio > DEVIATIONS * mode.damping_ratio_std)
    if gain < 0:
        words = "the input does not drive it (held-out gain negative)"
        line = "an undamped line that the input does not drive (held-out gain negative): periodic disturbance?"
        return (line if undamped else words,)
    if undamped and not gain >= UNDAMPED_GAIN:
        if mode.frequency * duration < FEWEST_TURNS:
            return (drifting(mode, duration),)
        if -mode.pole.real * duration < LEAST_DECAY:
            share = -100 * np.expm1(mode.pole.real * duration)
            how = f"an undamped line, which decays by only {share:.2g} % over {duration:.4g} s"
        else:
            share = -100 * np.expm1(-decay)
            how = f"perhaps an undamped line: its decay over {duration:.4g} s may be as little as {share:.2g} %"
        return (f"{how}: periodic disturbance?",)
    return ()


def by_chance(
    model: ModalModel, records: Sequence[Record], left: Sequence[FloatArray], *, asked: Sequence[int] | None = None
) -> BoolArray:
    """(n_modes,) whether inputs that act at another time explain what a line does as well as those that were measured.

    What the inputs make an undamped line do never ends: it wanders, and fits hum whose frequency is not quite that of
    the pole in all rows, held-out ones between them included. So does the answer to any other input. Circular shifts of
    the inputs are such inputs, and of `N_SHIFTS` of them and the right one the right one is the best by chance as often
    as one in `N_SHIFTS` + 1 times (Fisher's exact test by permutation). Each may answer with any participation and
    shape.

    Args:
        model: modes of the model that ran.
        records: that it ran through; missing inputs count as zero.
        left: (n_samples, n_outputs) a record, NaN where an output is missing.
        asked: modes to ask; unless given, those that decay by less than `LEAST_DECAY` over the longest record.
    """
    chance = np.zeros(len(model), dtype=np.bool_)
    poles, _ = discrete_poles(model.modes, model.dt)
    if asked is None:
        longest = max(record.duration for record in records)
        asked = [i for i, mode in enumerate(model.modes) if -mode.pole.real * longest < LEAST_DECAY]
    for i in asked:
        mode = model.modes[i]
        if mode.kind != "oscillatory" or not records[0].n_inputs:
            continue
        shares = np.zeros(N_SHIFTS + 1)
        for record, errors in zip(records, left, strict=True):
            inputs = np.nan_to_num(record.inputs)
            kept = complete_rows(errors)
            own = answer_from_rest(inputs @ mode.participation, complex(poles[i]), 2.0 * mode.shape, kept)
            free = _free_motion(complex(poles[i]), np.flatnonzero(kept))
            values = errors[kept] + own
            values = (values - free @ (free.T @ values)) / np.maximum(errors[kept].std(axis=0), np.finfo(float).tiny)
            for k in range(N_SHIFTS + 1):
                moved = np.roll(inputs, k * record.n_samples // (N_SHIFTS + 1), axis=0)
                answers = [
                    answer_from_rest(column.astype(np.complex128), complex(poles[i]), np.array([turn]), kept)
                    for column in moved.T
                    for turn in (1.0 + 0j, 1j)
                ]
                basis = np.linalg.qr(np.column_stack([free, *answers]))[0][:, free.shape[1] :]
                shares[k] += float(((basis.T @ values) ** 2).sum())
        chance[i] = shares[0] <= shares[1:].max()
    return chance


def beyond_doubt(mode: Mode, ratio: float) -> tuple[str, ...]:
    """Why a mode may be the edge of the inputs' band, in words; `ratio` as `f_ratio` has it in the mode's own band."""
    if not ratio < HARDLY_DRIVEN:
        return ()
    words = f"the inputs hardly move at {mode.frequency:.4g} Hz, and nothing there follows them"
    return (f"{words}: it may be a fit to the edge of their band",)


def line_doubt(lines: BetweenLines | None, ratio: float) -> tuple[str, ...]:
    """Why a mode may be no more than what a few lines of the drive leave open, in words.

    Args:
        lines: of the inputs; None where they are no few lines.
        ratio: F ratio of the mode beside them, nan where nothing of its band lies beside them.
    """
    if lines is None or ratio >= HARDLY_DRIVEN:
        return ()
    return (f"the inputs are {lines.shown}, and beside them nothing shows it: a fit to the lines, not a mode",)
