"""The evidence in words of where measurement and simulation disagree, as a person reads it before anything is fitted.

Each sentence follows from one rule on the numbers of a `Gap`, of `LevelModes` and of `Lines`; where the numbers do not
carry a sentence it is not said. Nothing here names an effect: the words are those of families of laws.

A mode's pole moves by d omega / omega along the imaginary axis and by d zeta along the real one, both relative to its
size. Only what is at least half of the larger of the two is said: where a resonance moves by more than its own width
within one level already, the damping ratio of a linear model of that level says nothing of energy.

A force that belongs to the structure moves with it, so part of the gap is coherent with the simulated output; a
disturbance from outside is not, whatever its size.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from modal.localisation.bands import line_power
from modal.localisation.gap import BEYOND_CHANCE, Gap, LevelTrend
from modal.localisation.levels import LevelMode, LevelModes
from modal.localisation.lines import Lines, line_statements
from modal.simulation import AT_FLOOR
from modal.wording.text import Statement, listed, number, part, percent, quantity, times, times_floor_text
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.display import Displayed

N_SEGMENTS = 8
"""Average spectra over so many segments of a record, half overlapping."""
INDEPENDENT = 0.6
"""Count half-overlapping Hann segments as this share of independent ones (Welch)."""
LINE_REACH = 2
"""Sum a line over so many cells on either side: a record of any length spreads it over these."""
ONE_LINE = 0.7
"""Call a gap one line that holds at least this share of it above the noise."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Interval:
    """The narrowest range of frequencies that holds a share of the gap.

    Attributes:
        low: [Hz].
        high: [Hz].
        share: of the gap above the noise, its constant part included in the whole.
        simulated_share: of the simulated output's variance in the same range.
    """

    low: float
    high: float
    share: float
    simulated_share: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SingleLine:
    """One frequency that holds most of the gap, though little of the simulated output.

    Attributes:
        frequency: [Hz].
        share: of the gap above the noise.
        simulated_share: of the simulated output's variance at that frequency.
        amplitudes: (n_records,) of the line [output units].
    """

    frequency: float
    share: float
    simulated_share: float
    amplitudes: FloatArray


def excess_spectrum(gap: Gap, outputs: Sequence[int]) -> tuple[float, FloatArray]:
    """Constant part and (n_cells,) spectrum of the gap above the noise, relative to the outputs' variances.

    Sums over the outputs, means over the records. Single cells may be negative.
    """
    chosen = list(outputs)
    size = np.where(gap.variance > 0.0, gap.variance, np.inf)[:, chosen]
    lengths = np.array([[record.n_samples] for record in gap.measured])
    constant = (gap.constant - gap.floor / lengths)[:, chosen] / size
    spectrum = (gap.cells.gap - gap.cells.floor)[..., chosen] / size[:, np.newaxis]
    return float(constant.sum(axis=1).mean()), spectrum.sum(axis=2).mean(axis=0)


def narrowest_interval(gap: Gap, outputs: Sequence[int], *, share: float = 0.8) -> Interval | None:
    """The narrowest range of frequencies that holds a share of the gap above the noise; None where there is no gap."""
    constant, cells = excess_spectrum(gap, outputs)
    total = cells.sum()
    if not total > 0.0:
        return None
    top = 1 + int(np.argmax(np.cumsum(cells) >= 0.999 * total))
    step = -(-top // 512)
    edges = np.minimum(np.arange(0, top + step, step), cells.size)
    sums = np.concatenate([[0.0], np.cumsum(cells)])[edges]
    inside = sums[np.newaxis, :] - sums[:, np.newaxis]
    width = (edges[np.newaxis, :] - edges[:, np.newaxis]).astype(float)
    fits = (inside >= share * total) & (width > 0)
    # of equally narrow ranges the fullest
    best = np.where(fits, width - 0.5 * inside / max(float(inside.max()), float(total)), np.inf)
    first, last = (edges[i] for i in np.unravel_index(int(np.argmin(best)), best.shape))
    size = np.where(gap.variance > 0.0, gap.variance, np.inf)[:, np.newaxis, :]
    simulated = (gap.cells.simulated / size)[..., list(outputs)].sum(axis=2).mean(axis=0)
    return Interval(
        low=float(gap.cells.edges[first]),
        high=float(gap.cells.edges[last]),
        share=float(cells[first:last].sum() / (total + max(0.0, constant))),
        simulated_share=_share(simulated, int(first), int(last)),
    )


def single_line(gap: Gap, output: int) -> SingleLine | None:
    """The line that holds most of the gap of an output at every record, though not of the simulated output."""
    # absolute sums: a disturbance has the same size in every record
    cells = (gap.cells.gap - gap.cells.floor)[..., output]
    whole = cells.sum(axis=0)
    total = whole.sum() + float(np.maximum(gap.constant[:, output], 0.0).sum())
    peak = int(np.argmax(whole))
    near = slice(max(0, peak - LINE_REACH), peak + LINE_REACH + 1)
    share = float(whole[near].sum() / total) if total > 0.0 else 0.0
    simulated = _share(gap.cells.simulated[..., output].mean(axis=0), near.start, near.stop)
    if share < ONE_LINE or simulated > 0.5 * share:
        return None
    return SingleLine(
        frequency=_centre(gap, output, gap.cells.edges[near.start], gap.cells.edges[min(near.stop, whole.size)]),
        share=share,
        simulated_share=simulated,
        amplitudes=np.sqrt(2.0 * np.maximum(cells[:, near].sum(axis=1), 0.0)),
    )


def _centre(gap: Gap, output: int, low: float, high: float) -> float:
    """Mean frequency of the gap's lines between two frequencies, in the longest record [Hz]."""
    longest = max(range(len(gap.measured)), key=lambda i: gap.measured[i].n_samples)
    power = line_power(gap.residuals[longest][:, [output]])[1][:, 0]
    place = np.arange(1, power.size + 1) / gap.measured[longest].duration
    near = (place >= low) & (place <= high)
    return float(power[near] @ place[near] / power[near].sum())


def coherent_share(gap: Gap) -> FloatArray:
    """(n_outputs,) share of the gap that is coherent with the simulated output, mean over records; nan where unknown.

    The coherence of the two, weighted by the spectrum of the gap, less the bias of an average over few segments.

    References:
        Bendat, Piersol, Random Data, 4th edition, Wiley 2010, chapter 9, doi 10.1002/9781118032428.
    """
    shares = np.array(
        [_coherent_share(residual, run.outputs) for residual, run in zip(gap.residuals, gap.simulated, strict=True)]
    )
    known = np.isfinite(shares)
    total = np.where(known, shares, 0.0).sum(axis=0)
    result: FloatArray = np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
    return result


def _coherent_share(residual: FloatArray, simulated: FloatArray) -> FloatArray:
    length = len(residual) // N_SEGMENTS
    if length < 2 * N_SEGMENTS:
        return np.full(residual.shape[1], np.nan)
    first, second = _segments(residual, length), _segments(simulated, length)
    own, other = (np.square(np.abs(spectra)).mean(axis=0) for spectra in (first, second))
    cross = np.square(np.abs((first * second.conj()).mean(axis=0)))
    coherent = np.divide(cross, other, out=np.zeros_like(cross), where=other > 0.0).sum(axis=0)
    whole = own.sum(axis=0)
    share = np.divide(coherent, whole, out=np.full_like(coherent, np.nan), where=whole > 0.0)
    bias = 1.0 / (INDEPENDENT * len(first))
    result: FloatArray = (share - bias) / (1.0 - bias)
    return result


def _segments(values: FloatArray, length: int) -> ComplexArray:
    """(n_segments, n_lines, n_outputs) spectra of half-overlapping Hann segments, means and missing samples at zero."""
    with np.errstate(invalid="ignore"):
        mean = np.nanmean(values, axis=0)
    whole = np.nan_to_num(values - mean)
    window = np.hanning(length + 1)[:-1, np.newaxis]
    starts = range(0, len(values) - length + 1, max(1, length // 2))
    spectra: ComplexArray = np.array(
        [np.fft.rfft(window * whole[start : start + length], axis=0)[1:] for start in starts]
    )
    return spectra


def _share(power: FloatArray, first: int, last: int) -> float:
    total = float(power.sum())
    return float(power[first:last].sum()) / total if total > 0.0 else 0.0


CONCENTRATED = 0.5
"""Name one output from this share on of the way from an even spread over the outputs to all in one."""
MOSTLY = 0.5
"""Name a part of the gap, and a movement beside a larger one, from this share on; means that differ by less are one
offset."""
NARROW_RATIO = 3.0
"""Say that a gap lies in a band up to this ratio of its highest to its lowest frequency."""
NARROW_WIDTH = 0.1
"""Say the same up to this width, of the Nyquist frequency."""
COHERENT = 0.3
"""Say that a gap moves with the structure where at least this share of it follows the simulation."""
INCOHERENT = 0.15
"""Say that it does not up to this share."""
Offset = Literal["none", "one", "several"]
"""Whether most of the gap is its mean, and whether all records have the same one."""
LAWS = {
    "rises": "a force that grows faster than the motion (a spring that hardens or softens, drag, a limit)",
    "falls": "a force that grows less than the motion, as of friction or of the play in a joint",
    "stays": "it scales with the excitation (a wrong parameter, gain, delay, missing mode or bilinear spring)",
}


def agreement(gap: Gap) -> Statement:
    """The one sentence of a gap that is nowhere above the noise."""
    low, high = (times_floor_text(float(end)) for end in (gap.in_floors.min(), gap.in_floors.max()))
    size = high if low == high else f"{low} to {high}"
    text = f"Measurement and simulation agree within the noise: the gap is {size} times the noise floor."
    return Statement(subject="size", text=text)


def disagreement(
    gap: Gap, *, above: BoolArray, output: int, shares: FloatArray, coherent: FloatArray
) -> Iterator[Statement]:
    """The sentences of a gap.

    Args:
        gap: from `measure_gap`.
        above: (n_records, n_outputs) True where the gap is above the noise.
        output: index of the output that holds most of it.
        shares: (n_outputs,) of the gap.
        coherent: (n_outputs,) share that follows the simulated output.
    """
    n_outputs = len(gap.output_names)
    alone = n_outputs == 1 or shares[output] >= 1.0 / n_outputs + CONCENTRATED * (1.0 - 1.0 / n_outputs)
    chosen = (output,) if alone else tuple(range(n_outputs))
    constant, cells = excess_spectrum(gap, chosen)
    constant_share = constant / (constant + max(0.0, float(cells.sum()))) if constant > 0.0 else 0.0
    line = single_line(gap, output)
    yield _size(gap, above)
    if not alone:
        parts = [f"{part(share)} in {name}" for share, name in zip(shares, gap.output_names, strict=True)]
        yield Statement(subject="output", text=f"The gap is spread over the outputs: {listed(parts)}.")
    if constant_share >= MOSTLY:
        yield _constant(gap, output, constant_share)
    else:
        yield _band(gap, chosen, float(shares[output]) if alone else 1.0)
    if line is not None:
        yield _line(gap, output, line)
    trend = gap.output_trends[output] if alone else gap.trend
    if gap.n_levels > 1:  # what one level cannot tell is the advice's to say
        kept: Offset = "one" if _one_offset(_means(gap, output)) else "several"
        offset = kept if constant_share >= MOSTLY else "none"
        yield _level(gap, trend, coherent=float(coherent[output]), line=line, offset=offset)
    yield from _time(gap)


def _size(gap: Gap, above: BoolArray) -> Statement:
    relative = np.where(above, np.nan_to_num(gap.relative), -1.0)
    record, output = (int(i) for i in np.unravel_index(int(np.argmax(relative)), relative.shape))
    where = gap.output_names[output]
    if len(gap.measured) > 1:
        where += f" of {gap.measured[record].name or f'record {record + 1}'}"
    seen = gap.relative[above & np.isfinite(gap.relative)]
    reach = f"is {part(float(seen.max()))}" if seen.size == 1 else _reach(seen)
    floors = times_floor_text(float(gap.in_floors[above].max()))
    most = "" if seen.size == 1 else "up to "
    text = f"The gap {reach} of the size of the outputs and {most}{floors} times the noise floor, largest in {where}"
    quiet = int((~above).sum())
    if quiet:
        text += f"; in {quiet} of {above.size} outputs and records it is within the noise"
    return Statement(subject="size", text=text + ".")


def _reach(values: FloatArray) -> str:
    low, high = part(float(values.min())), part(float(values.max()))
    return f"is {low}" if low == high else f"is {low.removesuffix(' %')} to {high}"


def _constant(gap: Gap, output: int, share: float) -> Statement:
    unit = gap.measured[0].output_units[output]
    means = _means(gap, output)
    kept = "constant" if _one_offset(means) else "constant within a record but not the same in all"
    text = (
        f"{part(share)} of the gap in {gap.output_names[output]} is {kept}, measured minus simulated "
        f"{_range(min(means), max(means), unit)}."
    )
    return Statement(subject="constant", text=text)


def _means(gap: Gap, output: int) -> list[float]:
    return [float(np.nanmean(residual[:, output])) for residual in gap.residuals]


def _one_offset(means: Sequence[float]) -> bool:
    """Whether all records are off by about the same: an offset is, a law that a straight line stands in for is not."""
    return max(means) - min(means) <= MOSTLY * max(abs(mean) for mean in means)


def _range(low: float, high: float, unit: str) -> str:
    """Both ends, or one number where they read the same."""
    ends = quantity(low), quantity(high)
    return quantity(high, unit) if ends[0] == ends[1] else f"{ends[0]} to {quantity(high, unit)}"


def _band(gap: Gap, outputs: Sequence[int], share: float) -> Statement:
    """Where in frequency; `share` is what these outputs hold of the whole gap."""
    found = narrowest_interval(gap, outputs)
    if found is None:
        return Statement(subject="band", text="The gap is too small to place it in frequency.")
    low, high = found.low, found.high
    where = f"in {gap.output_names[outputs[0]]} " if len(outputs) == 1 and len(gap.output_names) > 1 else ""
    text = f"{part(found.share * share)} of the gap is {where}"
    if high <= NARROW_RATIO * low or high - low <= NARROW_WIDTH * float(gap.cells.edges[-1]):
        text += f"between {_span(low, high)}, as is {part(found.simulated_share)} of the simulated motion."
    else:
        text += f"spread from {low:.3g} to {high:.3g} Hz."
    return Statement(subject="band", text=text)


def _span(low: float, high: float) -> str:
    """The two ends with as many digits as tell them apart."""
    digits = next((n for n in range(3, 8) if f"{low:.{n}g}" != f"{high:.{n}g}"), 8)
    return f"{low:.{digits}g} and {high:.{digits}g} Hz"


def _line(gap: Gap, output: int, line: SingleLine) -> Statement:
    unit = gap.measured[0].output_units[output]
    low, high = float(line.amplitudes.min()), float(line.amplitudes.max())
    size = _range(low, high, unit)
    text = (
        f"{part(line.share)} of the gap in {gap.output_names[output]} is one line at {line.frequency:.4g} Hz, of "
        f"amplitude {size}, where the simulated output has {part(line.simulated_share)} of its power."
    )
    return Statement(subject="line", text=text)


def _level(gap: Gap, trend: LevelTrend, *, coherent: float, line: SingleLine | None, offset: Offset) -> Statement:
    if not np.isfinite(trend.slope):
        text = _silent_levels(gap, trend)
    elif trend.same_absolute_size:
        cause = _same_size(coherent, line, offset)
        text = f"The gap has the same absolute size at every level ({_slope(trend)}): {cause}."
    elif trend.direction == "unknown":
        text = f"The records do not tell whether the relative gap changes with level ({_slope(trend)})."
    else:
        text = f"The relative gap {trend.direction} with level ({_slope(trend)}): {LAWS[trend.direction]}."
    return Statement(subject="level", text=text)


def _slope(trend: LevelTrend) -> str:
    if trend.same_absolute_size:
        return f"slope {trend.absolute_slope:+.2f} ± {trend.absolute_slope_std:.2f}"
    return f"slope {trend.slope:+.2f} ± {trend.slope_std:.2f}"


def _same_size(coherent: float, line: SingleLine | None, offset: Offset) -> str:
    """What a gap of one size is, by whether it is one line, constant, or moves with the structure."""
    if offset == "one":
        return "an offset of a sensor or a constant force"
    if offset == "several":
        return "another rest point in each record, or a curved law that a straight one stands in for"
    if line is not None:
        return "a periodic disturbance, not a property of the structure"
    if coherent <= INCOHERENT:
        return f"a disturbance, not a property of the structure ({part(max(0.0, coherent))} of it follows the model)"
    if coherent >= COHERENT:
        return (
            f"a force of one size that follows the motion ({part(coherent)} of it does), as of friction or of the play "
            "in a joint"
        )
    return "friction, play or a disturbance"


def _silent_levels(gap: Gap, trend: LevelTrend) -> str:
    """Fewer than two levels show a gap, so there is no slope."""
    shown = sorted({int(number) for number, silent in zip(gap.level_numbers, trend.silent, strict=True) if not silent})
    if not shown:
        return "At no level is the gap of this output large enough to tell how it changes with level."
    text = f"A gap shows above the noise at level {shown[0]} of {gap.n_levels} only"
    if trend.direction == "rises":
        return text + ": a contact, a limit or a force that grows faster than the motion."
    if trend.direction == "falls":
        return text + ": a force that grows less than the motion, or a disturbance."
    return text + "; at the others the noise could hide one as large."


def _time(gap: Gap) -> Iterator[Statement]:
    trend = gap.time_trend
    if trend is None or trend.direction == "steady":
        return
    if trend.direction == "grows":
        text = (
            f"The gap grows in time: {times(_root(trend.end_ratio))} as large at the end of a record as at the start."
        )
    elif trend.direction == "falls":
        text = (
            f"The gap falls in time: at the end of a record it is {part(_root(trend.end_ratio))} of what it is at the "
            "start, as from a wrong initial state or a transient."
        )
    else:
        text = (
            f"The gap is smallest in the middle of the records and {times(_root(trend.middle_ratio))} as large at both "
            "ends, as a parameter that drifts in time leaves after it was fitted as a constant."
        )
    yield Statement(subject="time", text=text)


def _root(ratio: float) -> float:
    """Of root mean squares, from one of mean squares."""
    return math.sqrt(max(ratio, 0.0))


def mode_statements(modes: LevelModes) -> list[Statement]:
    """One sentence for each mode that moves with level, or one that none does."""
    if not modes.modes:
        return [Statement(subject="modes", text=f"Modes against level are not known: {modes.reason}.")]
    texts = [text for mode in modes.modes for text in _of_mode(mode)]
    if not texts and all(_rests(mode) for mode in modes.modes):
        texts = [f"No mode moves with level in frequency{_or_damping(modes)}."]
    return [Statement(subject="modes", text=text) for text in texts]


def _rests(mode: LevelMode) -> bool:
    return mode.frequency_tendency == "stays" and (mode.kind == "real" or mode.damping_tendency == "stays")


def _or_damping(modes: LevelModes) -> str:
    return " or damping" if any(mode.kind == "oscillatory" for mode in modes.modes) else ""


def _of_mode(mode: LevelMode) -> list[str]:
    first, last = (int(i) for i in np.flatnonzero(np.isfinite(mode.frequencies))[[0, -1]])
    span = f"from level {first + 1} to {last + 1}"
    if mode.kind == "real":
        return _of_real(mode, first, last, span)
    change = float(mode.frequencies[last] / mode.frequencies[first] - 1.0)
    damping = float(mode.damping_ratios[last] - mode.damping_ratios[first])
    name = f"mode {mode.number} ({number(float(mode.frequencies[first]))} Hz)"
    texts = []
    if mode.frequency_tendency in ("rises", "falls") and abs(change) >= MOSTLY * abs(damping):
        law = (
            "a spring that hardens, or play that closes"
            if mode.frequency_tendency == "rises"
            else "a spring that softens, yields or slips"
        )
        texts.append(f"Frequency of {name} {mode.frequency_tendency} by {percent(abs(change))} {span}: {law}.")
    if mode.damping_tendency in ("rises", "falls") and abs(damping) >= MOSTLY * abs(change):
        law = "drag-like, or a loop that grows" if mode.damping_tendency == "rises" else "friction-like"
        ends = [percent(float(mode.damping_ratios[i])) for i in (first, last)]
        texts.append(f"Damping of {name} {mode.damping_tendency} from {ends[0]} to {ends[1]} {span}: {law}.")
    return texts


def _of_real(mode: LevelMode, first: int, last: int, span: str) -> list[str]:
    if mode.frequency_tendency not in ("rises", "falls"):
        return []
    times = 1.0 / (2.0 * np.pi * mode.frequencies[[first, last]])
    moves, law = ("falls", "drag-like") if mode.frequency_tendency == "rises" else ("rises", "friction-like")
    return [
        f"Time constant of pole {mode.number} {moves} from {number(times[0])} to {number(times[1])} s {span}: {law}."
    ]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Location(Displayed):
    """What is known of the gap before any candidate is fitted.

    Attributes:
        statements: the most general first.
        agrees: whether the gap is nowhere above the noise; then one statement says so.
        output: index of the output that holds most of the gap relative to its size.
        output_shares: (n_outputs,) share of each output, zeros where there is no gap.
        coherent: (n_outputs,) share of the gap that is coherent with the simulated output.
        modes: frequency and damping of each mode at each level, None where they were not asked for.
    """

    statements: tuple[Statement, ...]
    agrees: bool
    output: int
    output_shares: FloatArray
    coherent: FloatArray
    modes: LevelModes | None = None

    @property
    def sentences(self) -> tuple[str, ...]:
        """The texts of the statements."""
        return tuple(statement.text for statement in self.statements)


def locate(gap: Gap, *, modes: LevelModes | None = None, lines: Lines | None = None) -> Location:
    """Say where measurement and simulation disagree: output, band, level, time, modes, lines.

    Args:
        gap: from `measure_gap`.
        modes: from `level_modes` on the measured records, None to leave them out.
        lines: from `measure_lines` on the measured records, None to leave them out.

    Example:
        >>> from modal.localisation.gap import measure_gap
        >>> from okid.record import Record
        >>> rng = np.random.default_rng(1)
        >>> force, noise = rng.standard_normal(2000), 0.01 * rng.standard_normal(2000)
        >>> hum = 0.1 * np.sin(2 * np.pi * 12.0 * np.arange(2000) * 0.01)
        >>> simulated = Record(force, force, 0.01)
        >>> print(*locate(measure_gap(Record(force, force + noise, 0.01), simulated, 1e-4)).sentences)
        Measurement and simulation agree within the noise: the gap is 0.999 times the noise floor.
        >>> found = locate(measure_gap(Record(force, force + hum + noise, 0.01), simulated, 1e-4))
        >>> print(found.sentences[1])
        99.9 % of the gap is between 11.97 and 12.03 Hz, as is under 1 % of the simulated motion.
    """
    limit = AT_FLOOR + BEYOND_CHANCE * np.sqrt(2.0 / np.maximum(1, gap.windows.n_samples.sum(axis=1)))
    above: BoolArray = gap.in_floors > limit
    coherent = coherent_share(gap)
    shares = _output_shares(gap, above)
    output = int(np.argmax(shares))
    agrees = not bool(above.any())
    if agrees:
        statements = [agreement(gap)]
    else:
        statements = list(disagreement(gap, above=above, output=output, shares=shares, coherent=coherent))
        statements += [] if lines is None or not lines.measured else line_statements(lines)
        statements += [] if modes is None or modes.levels.size < 2 else mode_statements(modes)
    return Location(
        statements=tuple(statements), agrees=agrees, output=output, output_shares=shares, coherent=coherent, modes=modes
    )


def _output_shares(gap: Gap, above: BoolArray) -> FloatArray:
    """(n_outputs,) each output's part of the sum of mean squares above the noise, relative to its variance."""
    excess = np.where(above, np.maximum(np.nan_to_num(gap.excess), 0.0), 0.0).sum(axis=0)
    total = float(excess.sum())
    shares: FloatArray = excess / total if total > 0.0 else np.zeros_like(excess)
    return shares
