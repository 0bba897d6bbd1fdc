"""The sentences of a gap: its size, output, band, level and time, each from one rule on the numbers."""

from collections.abc import Iterator, Sequence

import numpy as np

from modal.discrepancy.gap import Gap
from modal.discrepancy.gap_character import SingleLine, excess_spectrum, narrowest_interval, single_line
from modal.discrepancy.gap_trend import LevelTrend
from modal.discrepancy.statements import Statement, listed, part, quantity, times
from okid.arrays import BoolArray, FloatArray

__all__ = ["agreement", "disagreement"]

CONCENTRATED = 0.5
"""Of the way from an even spread over the outputs to all in one, from which on one output is named."""
MOSTLY = 0.5
"""Share of the gap from which on a part of it is named."""
NARROW_RATIO = 3.0
"""Highest over lowest frequency up to which the gap is said to lie in a band."""
NARROW_WIDTH = 0.1
"""The same as width, of the Nyquist frequency."""
COHERENT = 0.3
"""Share of the gap that follows the simulation, from which on it moves with the structure."""
INCOHERENT = 0.15
"""The same up to which it does not."""
LAWS = {
    "rises": "a force that grows faster than the motion (a spring that hardens or softens, drag, a limit)",
    "falls": "friction-like, a force that grows less than the motion",
    "stays": "it scales with the excitation (a wrong parameter, gain, delay, missing mode or bilinear spring)",
}


def agreement(gap: Gap) -> Statement:
    """The one sentence of a gap that is nowhere above the noise."""
    ratio = gap.in_floors
    size = f"{ratio.max():.3g} of" if ratio.size == 1 else f"{ratio.min():.3g} to {ratio.max():.3g} of"
    text = f"Measurement and simulation agree within the noise: the gap is {size} the floor (mean square)."
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
    yield _level(gap, trend, coherent=float(coherent[output]), line=line, constant_share=constant_share)
    yield from _time(gap)


def _size(gap: Gap, above: BoolArray) -> Statement:
    relative = np.where(above, np.nan_to_num(gap.relative), -1.0)
    record, output = (int(i) for i in np.unravel_index(int(np.argmax(relative)), relative.shape))
    where = gap.output_names[output]
    if len(gap.measured) > 1:
        where += f" of {gap.measured[record].name or f'record {record + 1}'}"
    seen = gap.relative[above & np.isfinite(gap.relative)]
    reach = f"is {part(float(seen.max()))}" if seen.size == 1 else _reach(seen)
    floors = times(float(gap.in_floors[above].max()))
    text = (
        f"The gap {reach} of the size of the outputs (rms) and up to {floors} the noise floor (mean square), largest "
        f"in {where}"
    )
    quiet = int((~above).sum())
    if quiet:
        text += f"; in {quiet} of {above.size} outputs and records it is within the noise"
    return Statement(subject="size", text=text + ".")


def _reach(values: FloatArray) -> str:
    return f"is {part(float(values.min()))} to {part(float(values.max()))}"


def _constant(gap: Gap, output: int, share: float) -> Statement:
    unit = gap.measured[0].output_units[output]
    means = [float(np.nanmean(residual[:, output])) for residual in gap.residuals]
    size = quantity(means[0], unit) if len(means) == 1 else f"{quantity(min(means))} to {quantity(max(means), unit)}"
    text = f"{part(share)} of the gap in {gap.output_names[output]} is constant, measured minus simulated {size}."
    return Statement(subject="constant", text=text)


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
    size = quantity(high, unit) if len(gap.measured) == 1 else f"{quantity(low)} to {quantity(high, unit)}"
    text = (
        f"{part(line.share)} of the gap in {gap.output_names[output]} is one line at {line.frequency:.4g} Hz, of "
        f"amplitude {size}, where the simulated output has {part(line.simulated_share)} of its power."
    )
    return Statement(subject="line", text=text)


def _level(
    gap: Gap, trend: LevelTrend, *, coherent: float, line: SingleLine | None, constant_share: float
) -> Statement:
    if gap.n_levels < 2:
        text = (
            f"All records are of one level of the {gap.level_source}, so nothing tells what depends on the amplitude "
            "from what does not."
        )
    elif not np.isfinite(trend.slope):
        text = _silent_levels(gap, trend)
    elif trend.same_absolute_size:
        cause = _same_size(coherent, line, constant_share)
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


def _same_size(coherent: float, line: SingleLine | None, constant_share: float) -> str:
    """What a gap of one size is, by whether it is one line, constant, or moves with the structure."""
    if constant_share >= MOSTLY:
        return "an offset of a sensor or a constant force"
    if line is not None:
        return "a periodic disturbance, not a property of the structure"
    if coherent <= INCOHERENT:
        return f"a disturbance, not a property of the structure ({part(max(0.0, coherent))} of it follows the model)"
    if coherent >= COHERENT:
        return f"friction-like, a force of one size that follows the motion ({part(coherent)} of it does)"
    return "friction or a disturbance"


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
        text = f"The gap grows in time: its mean square rises {times(trend.end_ratio)} from start to end of a record."
    elif trend.direction == "falls":
        text = (
            f"The gap falls in time: its mean square at the end of a record is {part(trend.end_ratio)} of that at "
            "the start, as from a wrong initial state or a transient."
        )
    else:
        text = (
            f"The gap is smallest in the middle of the records and {times(trend.middle_ratio)} that (mean square) "
            "at both ends: as a parameter that drifts in time leaves after it was fitted as a constant."
        )
    yield Statement(subject="time", text=text)
