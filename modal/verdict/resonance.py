"""Is a pole that no input drives a resonance? It stands as a peak, and its motion comes and goes as a mode's does.

Without inputs a pole may be the colour of what drives the system, or the edge of a filter. What tells a mode is its
resonance: its half-power bandwidth holds power that stands above what lies on either side.

What random forces shake is nearly Gaussian, so that the Fourier coefficients X_k of the motion have phases that know
nothing of each other. The square of its envelope, |a(t)|^2 with a = sum of X_k exp(2 pi i k t / T) over a band, then
varies as much as the spectrum P_k = |X_k|^2 of that very band lets it, whatever peaks stand there:

    x = sum over d > 0 of |R_d|^2 / (sum of P)^2,   R_d = sum over k of X_(k+d) X_k*,

half of the variance of |a|^2 over its squared mean, is a sum of exponential variables of means Q_d = sum over k of
P_(k+d) P_k / (sum of P)^2, and chance leaves it below x less often than Chernoff's bound,

    least over t >= 0 of exp(t x) / product over d of (1 + t Q_d).

A machine whose speed wanders makes a line as wide as a resonance, the phases of which are those of one sinusoid with a
wandering argument: its envelope is steady. Where the band holds few coefficients, there is nothing that the bound could
refuse. It asks to one side: gusts make an envelope vary more, and speak for no machine.

Of records with inputs it asks what these leave, without the motion of the modes that they drive. What still follows
them may be as steady as they are, and tells of no machine. A mode that stands on a line is one all the same where the
inputs explain it better than the same inputs at other times do.

References:
    Theiler, Eubank, Longtin, Galdrikian, Farmer, Physica D 58, 1992, 77-94, doi 10.1016/0167-2789(92)90102-S (a record
    with random phases in place of its own); Chernoff, Annals of Mathematical Statistics 23(4), 1952, 493-507, doi
    10.1214/aoms/1177729330.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from modal.estimation.free_run import filled
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel, Mode
from modal.modes.shape_comparison import assurance
from modal.preparation.band import share_that_follows
from modal.preparation.lines import MAIN_LOBE, lines_in_words, machine_lines
from modal.verdict.excitation import answer_from_rest, by_chance
from modal.verdict.judgement import LARGEST_BAND, SAME_SHAPE, Answer, doubted
from modal.verdict.probability import LEAST_HEIGHT, MOST_MISSED, RESOLVED
from modal.wording.text import hertz, listed, percent
from okid.arrays import ROUNDED, TINY, BoolArray, ComplexArray, FloatArray
from okid.record import Record
from okid.scaling import channel_scaling

BESIDE = (1.5, 4.0)
"""Compare a peak with what lies so many half-widths off: there a resonance alone has a sixth of its power."""
WIDER = (1.0, 2.0, 4.0)
"""Let sides reach so many times as far, one after the other, until a peak stands out."""
ALIKE = 1.5
"""Count so many neighbouring frequencies as one independent value: the noise bandwidth of the window (Hann)."""
LOADING = 1e-3
"""Null no neighbour below this share of the power beside a peak: chance would be nulled as well."""
FALSE_ALARMS = 1e-4
"""Speak of a steady line where so few records without one would look as much like it, all questions together: a mode is
lost by each."""
RANGE = (0.05, 0.95)
"""Take the frequencies between these quantiles of the power for those that a line wanders over."""
OVERSAMPLED = 4
"""Take so many samples of the envelope's square per period of its fastest part."""
COVERED = 0.5
"""Call a pole that of the line where this share of its half-power band lies within the line's frequencies."""


def standing_out(model: ModalModel, records: Sequence[Record]) -> FloatArray:
    """How many times the power beside a mode its half-power bandwidth holds, a standard deviation of chance more.

    The outputs are weighted by the mode's shape c and the power S on both sides, w = S^-1 c*, as an array of sensors
    that hears one direction and is deaf to its neighbours (Capon). What is heard at a frequency f is counted in what
    would be heard there without the mode: as much as at the mode, of which each neighbour j that stands taller makes
    its resonance's share,

        b(f) = b(f_i) + sum_j P_j (L_j(f) - L_j(f_i)),   L_j(f) = s_j^2 / ((f - f_j)^2 + s_j^2),

    with half its half-power bandwidth s_j, and P_j from what is heard within it. The lesser of the two sides is given.

    Neighbours that are not known yet, and a damping ratio that is too small, put a side on the peak, so where a mode
    does not stand out it is asked again with wider sides, and beside each taller one that is found. The edge of a
    filter has its pass band on one side.

    Args:
        model: modes of the model.
        records: that it was identified from, without inputs.

    Returns:
        (n_modes,) nan where a mode does not turn, or its sides lie outside the band.

    References:
        Capon, Proceedings of the IEEE 57(8), 1969, 1408-1418, doi 10.1109/PROC.1969.7278.

    Example:
        >>> from modal.modes.mode import Mode
        >>> rng, y = np.random.default_rng(0), np.zeros(20_000)
        >>> for k in range(2, y.size):
        ...     y[k] = 1.6 * y[k - 1] - 0.95 * y[k - 2] + rng.standard_normal()
        >>> poles = [np.log(0.95**0.5 * np.exp(0.609j)) / 0.01, np.log(0.97 * np.exp(1.5j)) / 0.01]
        >>> modes = tuple(Mode(pole=s, kind="oscillatory", frequency=abs(s) / 2 / np.pi, damping_ratio=-s.real / abs(s),
        ...                    shape=np.ones(1), participation=np.empty(0)) for s in poles)
        >>> model = ModalModel(modes=modes, dt=0.01, indicator_caution=0.1)
        >>> standing_out(model, [Record([], y, 0.01)]).round(1).tolist()
        [5.2, 0.9]
    """
    longest = max(record.duration for record in records)
    spectra: list[tuple[FloatArray, ComplexArray]] = []
    for record in filled(records):
        motion = np.hanning(record.n_samples + 2)[1:-1, np.newaxis] * (record.outputs - record.outputs.mean(axis=0))
        lines = np.asarray(np.fft.rfftfreq(record.n_samples, record.dt), dtype=np.float64)
        spectra.append((lines[1:], np.fft.rfft(motion, axis=0)[1:] / record.duration**0.5))
    spectrum = (np.concatenate([lines for lines, _ in spectra]), np.concatenate([values for _, values in spectra]))
    waiting: dict[int, _Peak] = {}
    for i, mode in enumerate(model.modes):
        if mode.kind == "oscillatory":
            # a damping ratio that seems too small puts the sides on the peak
            damping = mode.damping_ratio + np.nan_to_num(np.minimum(mode.damping_ratio, mode.damping_ratio_std))
            waiting[i] = _Peak(mode.frequency, max(damping * mode.frequency, RESOLVED / longest), mode.shape)
    found = np.full(len(model), np.nan)
    standing: list[_Peak] = []
    asked = set(waiting)
    while waiting:
        for i in asked:
            found[i] = _tallest(waiting[i], standing, *spectrum)
        highest = max(waiting, key=lambda i: np.nan_to_num(found[i]))
        if not found[highest] >= LEAST_HEIGHT:
            break
        standing.append(waiting.pop(highest))
        asked = {i for i, peak in waiting.items() if peak.reaches(standing[-1], WIDER[-1])}
    return found


class _Peak(NamedTuple):
    """Where a mode would stand [Hz], half its half-power bandwidth [Hz], and its shape (n_outputs,)."""

    frequency: float
    half: float
    shape: ComplexArray

    def resonance(self, lines: FloatArray) -> FloatArray:
        """Power at these lines [Hz] in units of that at the peak."""
        values: FloatArray = self.half**2 / ((lines - self.frequency) ** 2 + self.half**2)
        return values

    def reaches(self, other: "_Peak", times: float) -> bool:
        """Whether sides that reach so many times as far touch the other's band."""
        return abs(other.frequency - self.frequency) <= times * BESIDE[1] * self.half + other.half

    def band(self, lines: FloatArray, low: float = -1.0, high: float = 1.0) -> BoolArray:
        """Which lines lie between so many half-widths off."""
        off = (lines - self.frequency) / self.half
        return np.asarray((low <= off) & (off <= high))


def _tallest(peak: _Peak, standing: Sequence[_Peak], lines: FloatArray, values: ComplexArray) -> float:
    """The first height that is enough as sides grow, the greatest where none is."""
    heights: list[float] = []
    for times in WIDER:
        heights.append(_height(peak, standing, lines, values, times=times))
        if not heights[-1] < LEAST_HEIGHT:
            break
    return float(np.fmax.reduce(heights))


def _height(peak: _Peak, standing: Sequence[_Peak], lines: FloatArray, values: ComplexArray, *, times: float) -> float:
    """Above sides that reach so many times as far; nan where wider ones leave the band."""
    own = peak.band(lines)
    bands = (peak.band(lines, -times * BESIDE[1], -BESIDE[0]), peak.band(lines, BESIDE[0], times * BESIDE[1]))
    sides = [side for side in bands if side.any()]
    if not own.any() or not sides or (times > 1.0 and len(sides) < len(bands)):
        return np.nan
    beside = np.mean([values[side].T @ values[side].conj() / np.count_nonzero(side) for side in sides], axis=0)
    size = np.sqrt(np.maximum(np.diag(beside).real, np.finfo(float).tiny))
    alike = beside / np.outer(size, size) + LOADING * np.eye(size.size)
    weights = np.linalg.solve(alike, peak.shape / size) / size
    heard = np.square(np.abs(values @ weights.conj()))
    background = np.zeros(lines.size)
    for other in standing:
        near = other.band(lines)
        if near.any() and peak.reaches(other, times):
            resonance = other.resonance(lines)
            background += heard[near].mean() / resonance[near].mean() * resonance
    background += max(float(heard[own].mean() - background[own].mean()), np.finfo(float).tiny)
    levels = [float(np.mean(heard[band] / background[band])) for band in (own, *sides)]
    n_values = np.count_nonzero(own) / ALIKE
    return float(levels[0] / max(*levels[1:], np.finfo(float).tiny) * np.exp(np.sqrt(2.0 / n_values)))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SteadyLine:
    """A line whose frequency wanders and whose size does not.

    Attributes:
        low: least frequency of its range [Hz].
        high: greatest one.
        variation: standard deviation of the square of its envelope over the mean; of a resonance it is about one.
        modes: indices of the modes that stand on it.
    """

    low: float
    high: float
    variation: float
    modes: tuple[int, ...]


def told_of_steady_lines(model: ModalModel, records: Sequence[Record]) -> Answer:
    """The same, modes doubtful that are lines of a steady size, and a sentence where there are any.

    Args:
        model: judged, of records without inputs.
        records: that it was identified from.
    """
    lines = [line for line in steady_lines(model, records) if line.modes]
    if not lines:
        return Answer(modes=model)
    modes = list(model.modes)
    for line in lines:
        where = f"{hertz(line.low)} to {hertz(line.high)} Hz"
        why = (
            f"a machine line: its frequency wanders over {where}, but the square of its size varies by "
            f"{percent(line.variation)} only, where that of a resonance under random forces varies by 100 %"
        )
        for i in line.modes:
            modes[i] = doubted(modes[i], why)
    where = listed([f"{hertz(line.low)} to {hertz(line.high)} Hz" for line in lines])
    one = len(lines) == 1
    said = (
        f"{'A line wanders' if one else 'Lines wander'} over {where} and {'keeps its' if one else 'keep their'} size: "
        "a machine whose speed is not quite constant, or a motion that excites itself, and no resonance under random "
        "forces; what was found there is doubtful."
    )
    return Answer(modes=replace(model, modes=tuple(modes)), warnings=(said,))


def told_of_lines_beside(model: ModalModel, records: Sequence[Record], left: Sequence[FloatArray]) -> Answer:
    """The same of records with inputs, modes doubtful that are lines in what these leave, and a sentence for each sort.

    What poles that are no modes of the system make of the inputs is left as well: it may be a line, fitted by chance.

    Args:
        model: judged.
        records: that it was identified from.
        left: (n_samples, n_outputs) a record, what the model leaves that runs from rest, finite: undamped poles
            may have any line for their free motion.
    """
    remains = [
        replace(record, outputs=errors + _uncertain_answers(model, record))
        for record, errors in zip(records, left, strict=True)
    ]
    alone = [record.select(inputs=[]) for record in remains]
    poles = [i for i, mode in enumerate(model.modes) if mode.kind == "oscillatory"]
    half = MAIN_LOBE / min(record.duration for record in records)
    standing = [
        SteadyLine(low=f - half, high=f + half, variation=0.0, modes=_within(model.modes, poles, f - half, f + half))
        for f in machine_lines(alone).frequencies.tolist()
    ]
    standing = _unanswered(standing, remains)
    wandering = [
        line
        for line in _unanswered(steady_lines(model, alone, everywhere=True), remains)
        if not any(line.low <= other.high and other.low <= line.high for other in standing)
    ]
    certain = {i for line in (*standing, *wandering) for i in line.modes if model.modes[i].verdict == "system"}
    chance, modes = by_chance(model, records, left, asked=sorted(certain)), list(model.modes)
    # of a mode that hardly decays, the free motion is a line: none is told where such a one alone stands
    driven = {i for i in certain if not chance[i]}
    standing, wandering = (
        [line for line in lines if not line.modes or not driven.issuperset(line.modes)]
        for lines in (standing, wandering)
    )
    for line in (*standing, *wandering):
        where = f"over {hertz(line.low)} to {hertz(line.high)} Hz"
        for i in line.modes:
            if chance[i]:
                modes[i] = doubted(
                    modes[i],
                    f"on a machine line: what the inputs leave keeps its size {where} as no resonance under random "
                    "forces does, and inputs of another time explain the mode as well",
                )
    return Answer(modes=replace(model, modes=tuple(modes)), warnings=_beside_in_words(standing, wandering))


def _uncertain_answers(model: ModalModel, record: Record) -> FloatArray:
    """(n_samples, n_outputs) what the inputs make stable poles do that are no modes of the system."""
    poles, is_pair = discrete_poles(model.modes, model.dt)
    inputs, every = np.nan_to_num(record.inputs), np.ones(record.n_samples, dtype=np.bool_)
    answers = np.zeros(record.outputs.shape)
    for mode, pole, pair in zip(model.modes, poles.tolist(), is_pair.tolist(), strict=True):
        if mode.verdict != "system" and mode.kind == "oscillatory":
            answers += answer_from_rest(inputs @ mode.participation, pole, (2.0 if pair else 1.0) * mode.shape, every)
    return answers


def _unanswered(lines: Sequence[SteadyLine], remains: Sequence[Record]) -> list[SteadyLine]:
    """Those of which most does not follow the inputs."""
    middle, half = [0.5 * (one.low + one.high) for one in lines], [0.5 * (one.high - one.low) for one in lines]
    shares = share_that_follows(remains, middle, half)
    return [line for line, share in zip(lines, shares.tolist(), strict=True) if share < MOST_MISSED]


def _beside_in_words(standing: Sequence[SteadyLine], wandering: Sequence[SteadyLine]) -> tuple[str, ...]:
    said = []
    if standing:
        shown = lines_in_words(
            np.array([0.5 * (one.low + one.high) for one in standing]), 0.5 * (standing[0].high - standing[0].low)
        )
        said.append(
            f"{shown} in what the inputs leave: a machine that was not measured, the mains or a multiple of a tone "
            "that acts, and a mode only where it hardly decays during the record; poles that stand there tell of it."
        )
    if wandering:
        where = listed([f"{hertz(line.low)} to {hertz(line.high)} Hz" for line in wandering])
        one = len(wandering) == 1
        said.append(
            f"{'A line wanders' if one else 'Lines wander'} over {where} in what the inputs leave and "
            f"{'keeps its' if one else 'keep their'} size: a machine whose speed is not quite constant and whose force "
            "was not measured, and no mode; poles that stand there tell of it."
        )
    return tuple(said)


def steady_lines(model: ModalModel, records: Sequence[Record], *, everywhere: bool = False) -> tuple[SteadyLine, ...]:
    """The lines of a steady size at or near modes of the system, or anywhere.

    Each mode is asked in bands from its half-power bandwidth on either side to `LARGEST_BAND` of its frequency, twice
    as wide each time: a line wanders further than the one pole that stands on it. The steadiest is taken, and the rest
    asked again without its frequencies: a mode that has a line beside it, or within, is none. A line that no mode
    stands on is at the strongest frequency of some band of the largest width.

    Args:
        model: judged.
        records: that it was identified from.
        everywhere: whether to ask near all poles that turn, and in all bands.
    """
    modes = model.modes
    asked = [
        i for i, mode in enumerate(modes) if (mode.verdict == "system" or everywhere) and mode.kind == "oscillatory"
    ]
    longest = max(record.duration for record in records)
    if not (asked or everywhere):
        return ()
    motion = _Motion.of(filled(records))
    places = {i: _Place(modes[i].frequency, modes[i].damping_ratio, modes[i].shape / motion.scale) for i in asked}
    if everywhere:
        places |= {len(modes) + k: place for k, place in enumerate(_strongest(motion))}
    bands = [(i, half) for i, place in places.items() for half in _half_widths(place, longest)]
    answers = [_envelope(places[i], half, motion) for i, half in bands]
    left, lines = set(range(len(bands))), []
    while told := [k for k in left if answers[k].chance < FALSE_ALARMS / len(bands)]:
        best = min(told, key=lambda k: answers[k].variation)
        low, high = answers[best].low, answers[best].high
        on_it = _standing_on(modes, asked, motion, low, high)
        lines.append(SteadyLine(low=low, high=high, variation=answers[best].variation, modes=on_it))
        motion = motion.without(low, high)
        left = {k for k in left if k != best and bands[k][0] not in on_it}
        for k in left:
            i, half = bands[k]
            if places[i].frequency - half <= high and low <= places[i].frequency + half:
                answers[k] = _envelope(places[i], half, motion)
    return tuple(lines)


class _Place(NamedTuple):
    """Where a line is looked for: frequency [Hz], damping ratio, direction (n_outputs,) in units of the scale."""

    frequency: float
    damping_ratio: float
    direction: ComplexArray


def _strongest(motion: "_Motion") -> Iterator[_Place]:
    """In each band of the largest width, up to half the sampling frequency: where most moves in the longest record."""
    lines, values = max(motion.spectra, key=lambda spectrum: spectrum[0].size)
    power, first = np.square(np.abs(values)).sum(axis=1), 0
    while first < lines.size:
        last = max(first + 1, int(np.searchsorted(lines, lines[first] * (1.0 + LARGEST_BAND) / (1.0 - LARGEST_BAND))))
        peak = first + int(power[first:last].argmax())
        yield _Place(float(lines[peak]), 0.0, values[peak])
        first = last


def _half_widths(place: _Place, longest: float) -> Iterator[float]:
    half = 2.0 * max(place.damping_ratio * place.frequency, RESOLVED / longest)
    yield half
    while (half := 2.0 * half) <= LARGEST_BAND * place.frequency:
        yield half


def _standing_on(
    modes: Sequence[Mode], asked: Sequence[int], motion: "_Motion", low: float, high: float
) -> tuple[int, ...]:
    """Which modes a line over these frequencies [Hz] is: within it, the nearest to its shape, and all that have it."""
    covered = _within(modes, asked, low, high)
    if not covered:
        return ()
    there = np.concatenate([values[(f >= low) & (f <= high)] for f, values in motion.spectra])
    shape = np.linalg.svd(there, full_matrices=False)[2][:1].T
    alike = assurance(shape, np.column_stack([modes[i].shape / motion.scale for i in covered]))[0]
    return tuple(i for i, own in zip(covered, alike.tolist(), strict=True) if own >= min(SAME_SHAPE, alike.max()))


def _within(modes: Sequence[Mode], asked: Sequence[int], low: float, high: float) -> tuple[int, ...]:
    """Which of the modes that are asked are covered by a line between these frequencies [Hz]."""
    return tuple(i for i in asked if _share_within(modes[i], low, high) >= COVERED)


def _share_within(mode: Mode, low: float, high: float) -> float:
    """Of the half-power band of a mode."""
    half = max(mode.damping_ratio, ROUNDED) * mode.frequency
    inside = min(high, mode.frequency + half) - max(low, mode.frequency - half)
    return inside / (2.0 * half)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Motion:
    """Spectra of records without a window, which would be an envelope of its own.

    Attributes:
        spectra: (n_lines,) [Hz] and (n_lines, n_outputs) of each record, in units of the scale.
        scale: (n_outputs,) sizes of the outputs.
    """

    spectra: tuple[tuple[FloatArray, ComplexArray], ...]
    scale: FloatArray

    @classmethod
    def of(cls, records: Sequence[Record]) -> "_Motion":
        scale = np.maximum(channel_scaling(records).output_scale, TINY)
        spectra = []
        for record in records:
            lines = np.asarray(np.fft.rfftfreq(record.n_samples, record.dt), dtype=np.float64)
            centred = (record.outputs - record.outputs.mean(axis=0)) / scale
            spectra.append((lines[1:], np.fft.rfft(centred, axis=0)[1:]))
        return cls(spectra=tuple(spectra), scale=scale)

    def without(self, low: float, high: float) -> "_Motion":
        """Nothing left between these frequencies [Hz]."""
        outside = [((lines < low) | (lines > high))[:, np.newaxis] for lines, _ in self.spectra]
        kept = tuple((lines, values * there) for (lines, values), there in zip(self.spectra, outside, strict=True))
        return replace(self, spectra=kept)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Envelope:
    """Chance of so steady a size, its variation, and the range of frequencies [Hz]."""

    chance: float
    variation: float
    low: float = np.nan
    high: float = np.nan


def _envelope(place: _Place, half: float, motion: _Motion) -> _Envelope:
    """Of what is heard of its direction so far on either side of a place [Hz], in all records together."""
    heard = []
    for lines, values in motion.spectra:
        first, last = np.searchsorted(lines, [place.frequency - half, place.frequency + half])
        heard.append((lines[first:last], values[first:last] @ place.direction.conj()))
    total = sum(float(np.square(np.abs(part)).sum()) for _, part in heard)
    seen, means, turns, weights = 0.0, [np.empty(0)], [np.empty(0)], [np.empty(0)]
    for lines, part in heard:
        n = part.size
        if n < 2 or not total > 0.0:
            continue
        size = 1 << (OVERSAMPLED * n - 1).bit_length()
        signal = np.fft.ifft(part, size)
        seen += float(np.square(np.abs(np.fft.fft(np.square(np.abs(signal)))[1:n])).sum()) * (size / total) ** 2
        power = np.fft.fft(np.square(np.abs(part)), size)
        means.append(np.maximum(np.fft.ifft(np.square(np.abs(power))).real[1:n], 0.0) / total**2)
        turn = np.angle(signal[1:] * signal[:-1].conj()) / (2.0 * np.pi)
        turn -= np.round(turn - n / (2.0 * size))  # within half a turn of the band's middle
        turns.append(lines[0] + turn * size * (lines[1] - lines[0]))
        weights.append(np.square(np.abs(signal[1:])))
    turn, weight = np.concatenate(turns), np.concatenate(weights)
    if not turn.size:
        return _Envelope(chance=1.0, variation=np.inf)
    rising = np.argsort(turn)
    share = np.cumsum(weight[rising])
    low, high = turn[rising][np.searchsorted(share, np.array(RANGE) * share[-1])].tolist()
    chance = _chance_below(seen, np.concatenate(means))
    return _Envelope(chance=chance, variation=float(np.sqrt(2.0 * seen)), low=low, high=high)


def _chance_below(x: float, means: FloatArray) -> float:
    """Chernoff's bound of how often a sum of exponential variables of these means is below x."""
    if x >= means.sum():
        return 1.0

    def slope(t: float) -> float:
        return x - float((means / (1.0 + t * means)).sum())

    most = means.size / max(x, TINY)  # there each term is below 1 / t
    t = scipy.optimize.brentq(slope, 0.0, most)
    return float(np.exp(t * x - np.log1p(t * means).sum()))
