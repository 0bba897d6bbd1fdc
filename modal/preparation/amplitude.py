"""The values that a channel takes: cut off at a level, too few of them, none but one, or the same one for too long.

**Clipped.** Among the sixteen outermost values that occur, the outermost itself occurs five times as often as any of
the others, and the channel comes back to it several times from below all sixteen. The crest of a sine on a converter's
grid occurs 2.4 times as often as the next level; a channel that settles comes once; one that rests there does so most
of the time. The answer to a blow may come once, too: an output is clipped then where the outermost value alone occurs
several times, the others lie so far apart that chance does not make them equal, and the record goes on.

**Coarse.** Rounding to levels a distance q apart adds noise of standard deviation q / sqrt(12) (Widrow's model, good
from about q = one standard deviation of the signal downwards).

**Stuck.** A body comes to rest smoothly; a frozen channel stops within one sample and jumps when it comes back. It is
told from a coarse converter on a slow motion by its length.

References:
    Widrow, Kollar, Quantization Noise, 2008, chapter 5, doi 10.1017/CBO9780511754661.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Literal

import numpy as np
from numpy.polynomial.hermite_e import hermevander

from modal.modes.mode import ModalModel
from modal.preparation.channel import (
    MOST_ROWS,
    MOST_SPANS,
    MOSTLY,
    NEARLY_ALL,
    NOTABLE,
    SERIOUS,
    SPOILED,
    Channel,
    Finding,
    Span,
    channels_of,
    named,
    spoken,
)
from modal.wording.text import percent
from okid.arrays import ROUNDED, BoolArray, FloatArray
from okid.record import Record
from okid.rows import runs_of
from okid.scaling import channel_scaling

OUTERMOST = 16
"""Compare the outermost value of a channel with so many that lie beside it."""

MORE_OFTEN = 5
"""Call a channel clipped whose outermost value occurs so many times as often: twice what the crest of a sine does."""

FEWEST_VISITS = 3
"""Call a channel clipped that comes to its limit so often; one that settles there comes once."""

BAD_NOISE = 0.3
"""Call rounding noise bad from so many standard deviations of the channel: about one level a standard deviation."""

OFF_GRID = 0.05
"""Say that values lie on no grid where a distance is further from a multiple of the step, in steps."""

LONGER = 10
"""Call a run of equal values stuck so many times as long as any other nearby; the top of a sine is 4.8 times."""

NEIGHBOURHOOD = 8
"""Look so many lengths of a run before and after it."""

SUDDEN = 0.3
"""Take a run for rest that begins and ends with a step of less than this share of the median step nearby."""


LIMITED_TERMS = 12
"""Follow the distortion of a limit to the eleventh power of the motion."""

ANGLES = 0.5 * np.pi * np.linspace(-1.0, 1.0, 2001)
"""Tabulate the autocorrelation after a distortion at the sines of these angles of that before it."""


def clipping_findings(channel: Channel, *, left_out: bool = False) -> list[Finding]:
    """Clipping at the upper, the lower or both ends; `left_out` says that the samples are no longer used."""
    if channel.std == 0.0:
        return []
    sides: list[tuple[Literal["above", "below"], float]] = [("above", 1.0), ("below", -1.0)]
    found = [(side, *hit) for side, sign in sides if (hit := _clipped(channel, sign)) is not None]
    if not found:
        return []
    spans = tuple(sorted(span for _, _, some in found for span in some))[:MOST_SPANS]
    share = sum(count for _, count, _ in found) / channel.n_samples
    levels = " and ".join(
        f"{channel.value(channel.largest if side == 'above' else channel.smallest)} "
        f"({percent(count / channel.n_samples)})"
        for side, count, _ in found
    )
    head = f"{channel.role} {named(channel.name)} stands at its limit {levels} of the samples"
    if channel.role == "output":
        rest = ": it is clipped, by an amplifier or converter out of range; what lies beyond is lost"
        rest += (
            ", so these samples are left out; measure again with a larger range."
            if left_out
            else " and makes false harmonics: mark those samples as missing, or measure again with a larger range."
        )
    else:
        rest = (
            ": right if the source is limited there, but if a sensor or amplifier was out of range, the true input "
            "is not known; compare with the source."
        )
    return [
        channel.finding(
            level="note" if channel.role == "input" else "bad" if share >= SPOILED else "doubtful",
            what="clipped",
            sentence=head + rest,
            spans=spans,
            share=share,
        )
    ]


def clipped_samples(channel: Channel) -> tuple[BoolArray, ...]:
    """(n_samples,) a record: where the channel stands at a limit that clips it."""
    near = ROUNDED * channel.extent
    above, below = (channel.std > 0.0 and _clipped(channel, sign) is not None for sign in (1.0, -1.0))
    return tuple(
        (above & (part >= channel.largest - near)) | (below & (part <= channel.smallest + near))
        for part in channel.parts
    )


def distortion_at_modes(model: ModalModel, records: Sequence[Record], *, steady: bool) -> FloatArray:
    """(n_modes, n_outputs) of `distortion_power` in the half-power band of each mode."""
    half_widths = [max(0.0, mode.damping_ratio) * mode.frequency for mode in model.modes]
    return distortion_power(records, [mode.frequency for mode in model.modes], half_widths, steady=steady)


def distortion_power(
    records: Sequence[Record], frequencies: Sequence[float], half_widths: Sequence[float], *, steady: bool = True
) -> FloatArray:
    """(n_frequencies, n_outputs) share of the power in each band that limits or coarse levels make, 0 without them.

    A law g of the present value turns Gaussian motion of autocorrelation rho(tau) into one of R(rho(tau)), with

        d^n R / d rho^n = E[g^(n)(x) g^(n)(x')],    x and x' of correlation rho:

    all but its part E[g'(x)]^2 rho is sums and differences of what moves, which stand in the spectrum as modes do. A
    limit has one pulse in its second derivative, a converter one a level in its first; how many deviations away they
    lie is known from how often each is met.

    Args:
        records: as measured, without inputs.
        frequencies: [Hz].
        half_widths: [Hz] of the band about each.
        steady: whether what drives the records is; else the motion is not Gaussian, and the share of a limited or
            coarse channel is nan: not known.

    References:
        Price, IRE Transactions on Information Theory 4, 1958, 69-72, doi 10.1109/TIT.1958.1057444.

    Example:
        >>> rng, motion = np.random.default_rng(0), np.zeros(40_000)
        >>> for k in range(2, 40_000):
        ...     motion[k] = 1.6 * motion[k - 1] - 0.95 * motion[k - 2] + rng.standard_normal()
        >>> limit = 1.5 * motion.std()
        >>> record = Record([], np.clip(motion, -limit, limit), 0.01)
        >>> distortion_power([record], [9.7, 29.0], [0.3, 0.3]).round(2).tolist()
        [[0.01], [0.86]]
    """
    outputs = [channel for channel in channels_of(records, channel_scaling(records)) if channel.role == "output"]
    found = np.zeros((len(frequencies), len(outputs)))
    for channel in outputs:
        law = _limited(channel) or _stepped(channel)
        if law is None:
            continue
        if not steady:
            found[:, channel.index] = np.nan
            continue
        lines, power = _power(channel)
        correlation = np.fft.irfft(power)
        linear, distorted = law
        of_motion = np.interp(correlation / correlation[0], np.maximum.accumulate(distorted), np.sin(ANGLES))
        made = power - linear * correlation[0] * np.fft.rfft(of_motion).real
        for i, (frequency, half) in enumerate(zip(frequencies, half_widths, strict=True)):
            band = np.abs(lines - frequency) <= max(half, lines[1])  # resolution of the segments, if not the mode's
            found[i, channel.index] = max(0.0, made[band].sum() / power[band].sum())
    return found


def _limited(channel: Channel) -> tuple[float, FloatArray] | None:
    """E[g']^2 and R at the sines of `ANGLES`, R(1) as unit, of what is clipped; None where nothing is.

    R = sum_k E[g He_k]^2 / k! rho^k, and E[g He_k] = phi(a) He_k-2(a) - phi(b) He_k-2(b) from k = 2 on between limits a
    and b.
    """
    middle = 0.5 * (channel.smallest + channel.largest)
    at_limit = clipped_samples(channel)
    low, high = (
        sum(int((own & (side * (part - middle) > 0)).sum()) for own, part in zip(at_limit, channel.parts, strict=True))
        / channel.n_samples
        for side in (-1.0, 1.0)
    )
    if not low + high > 0.0:
        return None
    normal = NormalDist()
    means = np.zeros(LIMITED_TERMS)
    means[1] = 1.0 - low - high
    for share, sign in ((low, 1.0), (high, -1.0)):
        if share > 0.0:
            limit = sign * normal.inv_cdf(share)
            means[2:] += sign * normal.pdf(limit) * hermevander(limit, LIMITED_TERMS - 3).ravel()
    sizes = np.array([mean**2 / math.factorial(k) for k, mean in enumerate(means)])
    sizes /= sizes.sum()
    return float(sizes[1]), np.asarray(np.polynomial.polynomial.polyval(np.sin(ANGLES), sizes))


def _stepped(channel: Channel) -> tuple[float, FloatArray] | None:
    """The same of a converter that the motion moves over few levels; None where they are many.

    With rho = sin(theta): dR / d theta = sum_ij q_i q_j exp(-(t_i^2 - 2 rho t_i t_j + t_j^2) / (2 cos^2 theta)) / 2 pi
    for steps q_i at t_i deviations.
    """
    if channel.std == 0.0 or _n_levels(channel) > OUTERMOST:
        return None
    values = np.concatenate([part[~np.isnan(part)] for part in channel.parts])
    near = ROUNDED * channel.extent
    levels, counts = np.unique(np.round(values / near), return_counts=True)
    if not 2 < levels.size <= OUTERMOST:  # what has two levels only is switched
        return None
    edges = np.array([NormalDist().inv_cdf(share) for share in np.cumsum(counts[:-1]) / values.size])
    steps = near * np.diff(levels) / values.std()
    squares, products = np.add.outer(edges**2, edges**2), np.multiply.outer(edges, edges)
    inner = ANGLES[1:-1, np.newaxis, np.newaxis]
    exponents = (squares - 2.0 * np.sin(inner) * products) / (2.0 * np.cos(inner) ** 2)
    slopes = np.einsum("i,j,tij->t", steps, steps, np.exp(-exponents)) / (2.0 * math.pi)
    slopes = np.concatenate([slopes[:1], slopes, slopes[-1:]])
    sums = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(ANGLES) * (slopes[1:] + slopes[:-1]))])
    sums -= sums[ANGLES.size // 2]
    linear = float(steps @ np.exp(-0.5 * edges**2)) ** 2 / (2.0 * math.pi)
    return linear / sums[-1], sums / sums[-1]


def _power(channel: Channel) -> tuple[FloatArray, FloatArray]:
    """Frequencies [Hz], and the power there of segments that overlap by half, what is missing taken for the mean."""
    n = min(2048, 2 * (max(len(part) for part in channel.parts) // 2))
    window, power = np.hanning(n + 2)[1:-1], np.zeros(n // 2 + 1)
    for part in channel.parts:
        for start in range(0, len(part) - n + 1, n // 2):
            power += np.abs(np.fft.rfft(window * np.nan_to_num(part[start : start + n] - channel.mean))) ** 2
    return np.arange(n // 2 + 1) / (n * channel.dt), power


def _clipped(channel: Channel, sign: float) -> tuple[int, list[Span]] | None:
    """Number of clipped samples and where, None where that end is not clipped."""
    values, counts = _outermost(channel, sign)
    if values.size < OUTERMOST or counts[0] > MOSTLY * channel.n_samples:
        return None
    alone = counts[0] >= FEWEST_VISITS and _stands_alone(channel, values, counts)
    if counts[0] < MORE_OFTEN * counts[1:].max() and not alone:
        return None
    if _n_levels(channel) < 2 * OUTERMOST:  # a switch or a coarse converter
        return None
    visits = 0
    spans: list[Span] = []
    for number, part in enumerate(channel.parts):
        height = sign * part
        at_limit = height >= values[0] - ROUNDED * channel.extent
        visits += _visits(at_limit, height < values[-1])
        alone = alone and not at_limit[-1:].any()
        spans += [channel.span(number, start, stop) for start, stop in runs_of(at_limit)[:MOST_SPANS]]
    return (int(counts[0]), spans[:MOST_SPANS]) if alone or visits >= FEWEST_VISITS else None


def _stands_alone(channel: Channel, values: FloatArray, counts: np.ndarray) -> bool:
    """Whether an output has no other of its outermost values twice, and these are far apart."""
    if channel.role != "output" or counts[1:].max() > 1:
        return False
    gaps = np.diff(np.unique(np.concatenate(channel.parts)))
    gaps = gaps[gaps > ROUNDED * channel.extent]
    return bool(np.diff(values[1:]).mean() <= -100 * gaps.min(initial=np.inf))  # equal by chance once in a hundred


def _outermost(channel: Channel, sign: float) -> tuple[FloatArray, np.ndarray]:
    """The outermost values that occur, the first the greatest of sign * x, and how often each does."""
    values, counts = np.empty(0), np.empty(0, dtype=np.int64)
    for part in channel.parts:
        for start in range(0, part.size, 1 << 18):
            height = sign * part[start : start + (1 << 18)]
            height = height[~np.isnan(height)]
            if values.size >= OUTERMOST:
                height = height[height >= values[-1]]
            more, times = np.unique(height, return_counts=True)
            values, counts = _merged(
                np.concatenate([values, more]), np.concatenate([counts, times]), ROUNDED * channel.extent
            )
    return values, counts


def _merged(values: FloatArray, counts: np.ndarray, same: float) -> tuple[FloatArray, np.ndarray]:
    """Greatest first, values that differ by rounding only taken together, the outermost sixteen kept."""
    order = np.argsort(values, kind="stable")[::-1]
    values, counts = values[order], counts[order]
    if values.size == 0:
        return values, counts
    firsts = np.concatenate([[True], -np.diff(values) > same])
    group = np.cumsum(firsts) - 1
    sums = np.bincount(group, weights=counts).astype(np.int64)
    return values[firsts][:OUTERMOST], sums[:OUTERMOST]


def _n_levels(channel: Channel) -> int:
    longest = max(channel.parts, key=len)[:MOST_ROWS]
    levels = np.unique(longest[~np.isnan(longest)])
    return 1 + int((np.diff(levels) > ROUNDED * channel.extent).sum())


def _visits(at_limit: np.ndarray, far: np.ndarray) -> int:
    """How often the limit is reached anew after the channel was far from it."""
    events = np.flatnonzero(at_limit | far)
    kinds = at_limit[events]
    return int((kinds[1:] & ~kinds[:-1]).sum()) + int(kinds.size > 0 and bool(kinds[0]))


def resolution_of(channel: Channel) -> float:
    """Distance of neighbouring levels, nan where the values lie on no grid.

    Example:
        >>> from okid.record import Record
        >>> from okid.scaling import channel_scaling
        >>> from modal.preparation.channel import channels_of
        >>> record = Record([], 0.5 * np.random.default_rng(0).integers(-9, 9, 400), 0.1)
        >>> [resolution_of(channel) for channel in channels_of([record], channel_scaling([record]))]
        [0.5]
    """
    if channel.std == 0.0:
        return float("nan")
    taken = [part[: max(2, MOST_ROWS * part.size // channel.n_samples)] for part in channel.parts]
    values = np.unique(np.concatenate(taken))
    values = values[~np.isnan(values)]
    gaps = np.diff(values)
    gaps = gaps[gaps > ROUNDED * channel.extent]
    if gaps.size < 1:
        return float("nan")
    step = float(gaps.min())
    multiples = gaps / step
    step = float(gaps[multiples < 1.5].mean())
    multiples = gaps / step
    on_grid = np.abs(multiples - np.round(multiples)) <= OFF_GRID
    # two values always lie on a grid: a channel with as many values as samples has none
    enough = 2 * values.size <= sum(part.size for part in taken)
    return step if on_grid.all() and (enough or multiples.max() < 1.5) else float("nan")


def resolution_findings(channel: Channel, resolution: float) -> list[Finding]:
    """Rounding noise that is a notable part of an output; the levels of an input are what they are."""
    if channel.role == "input" or not np.isfinite(resolution):
        return []
    noise = resolution / (np.sqrt(12.0) * channel.std)
    if noise < SERIOUS:
        return []
    n_levels = round(channel.extent / resolution) + 1
    return [
        channel.finding(
            level="bad" if noise >= BAD_NOISE else "doubtful",
            what="coarse",
            sentence=f"output {named(channel.name)} moves over {n_levels} levels only, {channel.value(resolution)} "
            f"apart: rounding alone adds noise of {percent(noise)} of its motion; use a smaller range or a more "
            "sensitive sensor.",
            share=float(noise),
        )
    ]


def constant_findings(channel: Channel) -> list[Finding]:
    """The channel never moves by more than its last digit."""
    if channel.std > 0.0:
        return []
    how = f"never moves (always {channel.value(channel.mean)}): it is dead, unplugged or not recorded"
    if np.isnan(channel.mean):
        how = "holds no number: it was not recorded"
    return [
        channel.finding(
            level="bad",
            what="constant",
            sentence=f"{channel.role} {named(channel.name)} {how}; leave it out.",
            share=1.0,
        )
    ]


def repeat_findings(channel: Channel) -> list[Finding]:
    """Every value stands two or more times in a row: the sensor is slower than the recorder."""
    if channel.role == "input" or channel.std == 0.0:
        return []
    lengths = np.concatenate([_runs(part)[1][1:-1] for part in channel.parts])
    if lengths.size < 100:
        return []
    times = int(np.median(lengths))
    share = float((lengths == times).mean())
    if times < 2 or share < NEARLY_ALL:
        return []
    return [
        channel.finding(
            level="doubtful",
            what="repeated samples",
            sentence=f"output {named(channel.name)} holds each value for {times} samples: it was taken at "
            f"{spoken(1 / (times * channel.dt))} Hz only and held in between, which looks like a delay and an "
            f"attenuation; keep one row in {times} of the record.",
            share=share,
        )
    ]


def stuck_findings(channel: Channel, records: Sequence[Record], resolution: float) -> list[Finding]:
    """Runs of equal values in a channel that moves before and after.

    Args:
        channel: the channel.
        records: all channels: where all of them rest, nothing is stuck.
        resolution: distance of neighbouring levels, nan where the values are on no grid.
    """
    if channel.std == 0.0:
        return []
    found = []
    for number, part in enumerate(channel.parts):
        for start, stop in _long_runs(part):
            if channel.role == "input":
                by_design = _is_rest_value(channel, part, start)
            else:
                by_design = _all_rest(records[number], channel, start, stop)
            if not by_design and _is_sudden(part, start, stop, resolution, rough=channel.role == "input"):
                found.append((number, start, stop))
    if not found:
        return []
    at_limit = all(float(channel.parts[n][a]) in {channel.smallest, channel.largest} for n, a, _ in found)
    spans = tuple(channel.span(*run) for run in found[:MOST_SPANS])
    n_stuck = sum(stop - start for _, start, stop in found)
    share = n_stuck / channel.n_samples
    first = found[0]
    value = channel.value(float(channel.parts[first[0]][first[1]]))
    many = f"{len(found)} times, first " if len(found) > 1 else ""
    return [
        channel.finding(
            level="bad" if share >= NOTABLE and channel.role == "output" else "doubtful",
            what="stuck",
            sentence=f"{channel.role} {named(channel.name)} freezes {many}at {value} from {spans[0][1]:.6g} to "
            f"{spans[0][2]:.6g} s, {percent(share)} of its samples in all: "
            + (
                "that is its limit, so it ran out of range or dropped to a rail; mark those samples as missing "
                "(empty cells)."
                if at_limit
                else "it stops and comes back within one sample, so samples were lost or the sensor dropped out; "
                "mark them as missing (empty cells), or cut the record there."
            ),
            spans=spans,
            share=share,
        )
    ]


def _runs(part: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """First sample and length of every run of equal values; a missing sample is a run of its own."""
    edges = np.concatenate([[0], np.flatnonzero(part[1:] != part[:-1]) + 1, [part.size]])
    return edges[:-1], np.diff(edges)


def _long_runs(part: FloatArray) -> list[tuple[int, int]]:
    starts, lengths = _runs(part)
    if starts.size < 3:
        return []
    longest = np.argsort(lengths, kind="stable")[::-1][:MOST_SPANS]
    found = []
    for i in sorted(longest.tolist()):
        start, length = int(starts[i]), int(lengths[i])
        if length < LONGER:
            continue
        low = int(np.searchsorted(starts, start - NEIGHBOURHOOD * length, side="right")) - 1
        high = int(np.searchsorted(starts, start + (1 + NEIGHBOURHOOD) * length))
        others = np.concatenate([lengths[max(0, low) : i], lengths[i + 1 : high]])
        if others.size >= LONGER and length >= LONGER * others.max():
            found.append((start, start + length))
    return found


def _is_rest_value(channel: Channel, part: FloatArray, start: int) -> bool:
    """Whether an input may stand there by design: where it begins or ends, at zero, or at its limits."""
    value = float(part[start])
    return value in {0.0, float(part[0]), float(part[-1]), channel.smallest, channel.largest}


def _all_rest(record: Record, channel: Channel, start: int, stop: int) -> bool:
    """Whether every other channel stands still as well for most of the time."""
    window = slice(start, min(stop, start + 10_000))
    outputs = np.delete(record.outputs[window], channel.index, axis=1)
    others = np.concatenate([record.inputs[window], outputs], axis=1)
    return bool(others.shape[1] > 0 and (others[1:] == others[:-1]).all(axis=1).mean() > MOSTLY)


def _is_sudden(part: FloatArray, start: int, stop: int, resolution: float, *, rough: bool) -> bool:
    """Whether the channel stops or comes back within one sample, as nothing that has mass does."""
    reach = NEIGHBOURHOOD * (stop - start)
    before, after = part[max(0, start - reach) : start + 1], part[stop - 1 : stop + reach]
    steps = np.abs(np.concatenate([np.diff(before), np.diff(after[1:])]))
    steps = steps[steps > 0.0]
    if steps.size < LONGER:
        return False
    ends = [abs(float(part[start] - part[start - 1]))] if start > 0 else []
    ends += [abs(float(part[stop] - part[stop - 1]))] if stop < part.size else []
    jump = max((end for end in ends if np.isfinite(end)), default=0.0)
    if rough:  # a made-up input has corners by design: only one that is rough all the time can be said to freeze
        bends = np.abs(np.concatenate([np.diff(before, 2), np.diff(after[1:], 2)]))
        if np.nanmedian(bends) < SUDDEN * np.median(steps):
            return False
    return bool(jump > SUDDEN * np.median(steps) and not jump <= 3.0 * resolution)
