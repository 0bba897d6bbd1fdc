"""What the values of a table of frequency responses are uncertain by, and the poles that are fitted to them.

What a finite block gets wrong is part of the noise: the answer to what came before the block, and what is still to come
after it. For inputs that are white over a resonance its covariance over outputs and lines follows from the model in
closed form (`leakage`), and makes weights and standard deviations right where resonances are narrower than a line.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from modal.estimation.responses.fit import (
    LARGEST_SIZE,
    ResponseFit,
    ResponseLines,
    linear_columns,
    participation_moved,
)
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray

ROUNDING = 1e-13
"""Take errors for at least this share of a table's largest value: the digits of its numbers."""
NEAR, WIDE = 10, 40
"""Smooth the noise over so many lines on either side, where coherence tells it and where only the scatter does: some 20
and 80 values, which give a level to about a quarter and a tenth."""
ROUNDS = 60
"""Split scatter into leakage and floor by so many multiplicative updates; they settle to a few per cent in ten."""
FARTHEST = 8
"""Correlate the errors of lines up to so far apart: beyond, the windows known here leave nothing."""

DRAWN = 20
"""Hold what a model leaves against so many draws, which give their deviation to a sixth."""
MOST_WEIGHTS = 2**23
"""Hold so many complex weights of sums of errors at once, 134 MB and two copies, or those of a part of one mode."""
SURE = 5.0
"""Call a ratio of variances another than 1 from so many standard deviations: one of 10^6 by chance."""


def _leakage(table: ResponseLines, fit: ResponseFit, inputs: list[int], offset: int, shift: int) -> ComplexArray:
    """(n_lines - offset, n_outputs, n_outputs) covariance of what finite blocks leave at lines l + offset and l.

    For independent white inputs of the table's powers: N(k) = Y(k) - G(k) U(k) with everything a sum over the block's
    window, so each term is a transform of the output's correlation, the pulse response, or nothing, over the window's
    ambiguity. Of line l + offset the block begins `shift` samples later.
    """
    poles, b, c = fit.expanded()
    sizes = np.sqrt(table.power[inputs])
    b, d = sizes * b[:, inputs], sizes * fit.feedthrough[:, inputs]
    poles = poles * np.minimum(1.0, LARGEST_SIZE / np.maximum(np.abs(poles), TINY))
    state = (b @ b.conj().T) / (1 - poles[:, np.newaxis] * poles.conj())
    onward = poles[:, np.newaxis] * (state @ c.conj().T) + b @ d.T
    now = (c @ state @ c.conj().T).real + d @ d.T
    n_lines = table.z.size - offset
    model = c @ (table.basis(poles)[0][0][:, :, np.newaxis] * b) + d
    later, here = model[offset:], model[:n_lines].conj().transpose(0, 2, 1)
    plus, minus = _over(table, poles, offset, shift)
    common = _common(table, shift, offset)
    outputs = c @ (plus[:, :, np.newaxis] * onward) + _mirrored(c @ (minus[:, :, np.newaxis] * onward))
    out_in = c @ (plus[:, :, np.newaxis] * b) + d * common
    in_out = _mirrored(c @ (minus[:, :, np.newaxis] * b) + d * common.conj())
    both = outputs + now * common - out_in @ here - later @ in_out + later @ here * common
    return np.asarray(both, dtype=np.complex128)


def _over(table: ResponseLines, poles: ComplexArray, offset: int, shift: int) -> tuple[ComplexArray, ComplexArray]:
    """(n_lines - offset, n_poles) sums of powers over the window, of blocks and lines so far apart, each way round."""
    n_lines = table.z.size - offset
    ahead, behind = table.ambiguity(offset)
    plus = table.transformed(poles, (ahead, behind), shift)[:n_lines]
    return plus, table.transformed(poles, (behind.conj(), ahead.conj()), -shift)[:n_lines]


def _crossing(table: ResponseLines, fit: ResponseFit, offset: int, shift: int) -> tuple[ComplexArray, ComplexArray]:
    """(n_lines - offset, n_outputs, n_inputs) what is left at one line times the inputs at the other, each way round.

    It makes errors of neighbouring lines, and of blocks that overlap, turn together, so that their real and imaginary
    parts are not alike.
    """
    poles, b, c = fit.expanded()
    n_lines = table.z.size - offset
    model = c @ (table.basis(poles)[0][0][:, :, np.newaxis] * b) + fit.feedthrough
    plus, minus = _over(table, poles, offset, shift)
    common = _common(table, shift, offset)
    later = c @ (plus[:, :, np.newaxis] * b) + (fit.feedthrough - model[offset:]) * common
    here = c @ (minus[:, :, np.newaxis] * b) + (fit.feedthrough - model[:n_lines]) * common.conj()
    return later, here


def _mirrored(matrices: ComplexArray) -> ComplexArray:
    return matrices.conj().transpose(0, 2, 1)


def _own_leakage(table: ResponseLines, fit: ResponseFit) -> tuple[FloatArray, FloatArray]:
    """(n_lines, n_outputs, n_inputs) power of the leakage in each response: of blocks apart, and as they overlap.

    Of as many averages: what blocks share they say twice, and what one lacks of the answers the next one may hold.
    """
    if not table.leaks:
        return np.zeros(table.values.shape), np.zeros(table.values.shape)
    n_inputs = table.values.shape[2]
    groups = [list(range(n_inputs))] if table.together else [[i] for i in range(n_inputs)]
    both = []
    for shift in table.shifts:
        parts = [np.einsum("lqq->lq", _leakage(table, fit, group, 0, shift)) for group in groups]
        both.append(np.stack(parts * (n_inputs // len(parts)), axis=2) * _common(table, shift).conj())
    alone = np.maximum(both[table.shifts.index(0)].real, 0.0)
    # no two blocks share more than each holds, which rounding does not know where broad poles cancel one another
    most = sum(float(np.abs(_common(table, shift)[0, 0, 0])) for shift in table.shifts)
    return alone, np.clip(sum(both).real, 0.0, most * alone)


def _common(table: ResponseLines, shift: int, offset: int = 0) -> ComplexArray:
    """(n_lines - offset, 1, 1) correlation of a white input's spectra, of blocks and lines so far apart."""
    ahead, behind = table.ambiguity(offset)
    alike = ahead[-shift] if shift < 0 else behind[shift]
    return np.asarray(alike * (table.z[: table.z.size - offset] ** shift)[:, np.newaxis, np.newaxis])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Noise:
    """What the values of a table are uncertain by.

    Attributes:
        variance: (n_lines, n_outputs, n_inputs) of each value.
        leakage: the same shape, what finite blocks leave for inputs of the table's powers.
        averaged: the same of blocks that overlap.
        share: (n_inputs,) of it in the variance: one over the number of averages and the input's power.
    """

    variance: FloatArray
    leakage: FloatArray
    averaged: FloatArray
    share: FloatArray


def noise_of(table: ResponseLines, fit: ResponseFit) -> Noise:
    """Variance of each value of a table.

    What coherence says is split into leakage and a floor, so that their sum has the narrow shape of the one and the
    steadiness of the other; the scatter about the model, where there is no coherence, into these two and a part that
    grows with the response, as a noisy force and an error of the calibration make it, else a window that leaks passes
    for the likeliest wherever resonances scatter; what it is more or less than that, in the mean over
    neighbouring lines, corrects it. The level, one for each input, is that of the scatter.

    Args:
        table: what was fitted.
        fit: the model of it.
    """
    (leak, averaged), scatter = _own_leakage(table, fit), np.abs(fit.left) ** 2
    least = max((ROUNDING * np.abs(table.values * table.trust).max()) ** 2, TINY)
    scatter = scatter / max(0.1, 1 - fit.n_parameters / (2 * int(table.known.sum())))
    share = 1.0
    if table.noise is None:
        modelled = np.abs(table.values - fit.left) ** 2 * table.known
        share, expected = _from_scatter(scatter, [averaged, modelled], table, least)
        seen, reach = scatter, WIDE
    else:
        seen = _left_out(table)
        floor = np.maximum(_median(np.maximum(seen - leak, 0), table.known), least)
        expected, reach = leak + floor, NEAR
    expected = np.maximum(expected * _smoothed(seen / expected, table.known, reach), least)
    if table.noise is not None:
        expected = expected * (averaged + floor * _twice(table)) / (leak + floor)
    level = _weighted_mean((scatter / expected).reshape(-1, leak.shape[2]), table.known.reshape(-1, leak.shape[2]))
    return Noise(variance=np.maximum(expected * level, least), leakage=leak, averaged=averaged, share=share * level)


def _twice(table: ResponseLines) -> float:
    """By how much noise that is white over time scatters more than in as many blocks apart, which do not overlap."""
    return float(sum(abs(_common(table, shift)[0, 0, 0]) ** 2 for shift in table.shifts)) if table.leaks else 1.0


def _left_out(table: ResponseLines) -> FloatArray:
    """(n_lines, n_outputs, n_inputs) power of what does not follow the inputs, as coherence has it."""
    assert table.noise is not None
    power = table.power * np.abs(table.values) ** 2
    return np.asarray(table.noise * (power.sum(axis=2, keepdims=True) if table.together else power))


def with_powers(table: ResponseLines, fit: ResponseFit) -> ResponseLines:
    """The table with the powers of inputs that acted at once: the weaker one is, the further its responses scatter.

    A table of several references does not state them. What blocks leave at a resonance is mostly made by the input that
    drives it most: taken for equal, the noise there was up to 3 times too large beside a neighbour that the other input
    drives (seed 61701 of the benchmark, Hann 512).

    Args:
        table: of several references.
        fit: a model of it.
    """
    if not table.together:
        return table
    share = noise_of(table, fit).share
    power = 1 / np.maximum(share, max(TINY, np.finfo(float).eps * float(share.max())))
    return replace(table, power=power / power.mean())


def beyond_blocks(
    table: ResponseLines, fit: ResponseFit, noise: Noise, relative: FloatArray, n_averages: int | None
) -> FloatArray:
    """(n_poles,) what does not follow the inputs at each resonance, over what should not; 1 as a rule.

    There blocks cut into answers that go on, which the model tells, and sensors are noisy, which the lines beside tell
    (coherence falls by both). More is motion that the structure makes of other forces, of other frequencies (it is not
    linear) or of a force that falls there; less, of a force that is uneven. The ratio is 1 where it is no surer than
    that: 5 standard deviations of a mean of so many averages, of the damping that the model was made with, and of the
    power of what rings, of which blocks hold no more than so many memories.

    Args:
        table: with coherence, else nothing is known.
        fit: the model of it.
        noise: of `noise_of`.
        relative: (n_poles,) standard deviation of each damping over itself.
        n_averages: as stated, None where the scatter has to tell.
    """
    ratios = np.ones(fit.poles.size)
    if table.noise is None or table.lags is None or not table.leaks:
        return ratios
    n = n_averages or 1 / float((noise.share * table.power).mean())
    seen, expected = _beside_blocks(table, noise)
    for r in np.flatnonzero(fit.is_pair).tolist():
        near = _at_resonance(table, fit, r)
        told = np.outer(np.abs(fit.shapes[:, r]) ** 2, np.abs(fit.inputs[r]) ** 2) * expected[near].any(axis=0)
        if told.sum() > 0:
            each = seen[near].sum(axis=0) / np.maximum(expected[near].sum(axis=0), TINY)
            ratio = float((each * told).sum() / told.sum())
            memories = -np.log(np.abs(fit.poles[r])) * n * table.lags.size * (1 - table.overlap)
            spread = np.sqrt(1 / n + min(1.0, relative[r]) ** 2 / 4 + 1 / max(memories, TINY))
            ratios[r] = ratio if abs(np.log(max(ratio, TINY))) > SURE * spread else 1.0
    return ratios


def _beside_blocks(table: ResponseLines, noise: Noise) -> tuple[FloatArray, FloatArray]:
    """(n_lines, n_outputs, n_inputs) power of what does not follow the inputs, and of what blocks and sensors make."""
    seen = np.where(table.known, _left_out(table), 0.0)
    floor = _median(np.maximum(seen - noise.leakage, 0), table.known)
    return seen, np.where(table.known, noise.leakage + floor, 0.0)


def _at_resonance(table: ResponseLines, fit: ResponseFit, r: int) -> BoolArray:
    """(n_lines,) within the half-power band of a pair, or two lines."""
    s = np.log(fit.poles[r])
    line = float(np.median(np.diff(np.angle(table.z))))
    return np.asarray(np.abs(np.angle(table.z) - abs(s)) <= max(2 * line, -s.real), dtype=np.bool_)


def beneath_distortion(table: ResponseLines, fit: ResponseFit, noise: Noise) -> BoolArray:
    """(n_poles,) whether a pole answers less at its own resonance than another one, and than what is distorted there.

    What is not linear changes the responses themselves, by up to as much as what does not follow the inputs beyond
    blocks and sensors: under that, a pole may be the bend of a stronger resonance.

    Args:
        table: with coherence, else nothing is known.
        fit: the model of it.
        noise: of `noise_of`.
    """
    beneath = np.zeros(fit.poles.size, dtype=np.bool_)
    if table.noise is None or not fit.poles.size:
        return beneath
    seen, expected = _beside_blocks(table, noise)
    plus, minus = table.basis(fit.poles)[0]
    residues = fit.shapes.T[:, :, np.newaxis] * fit.inputs[:, np.newaxis]
    for r in np.flatnonzero(fit.is_pair).tolist():
        near = _at_resonance(table, fit, r)
        each = np.einsum("lp,pqi->plqi", plus[near], residues)
        each[fit.is_pair] += np.einsum("lp,pqi->plqi", minus[near], residues.conj())[fit.is_pair]
        power = (np.abs(each) ** 2 * table.power * table.known[near]).sum(axis=(1, 2, 3))
        distorted = float((seen[near] - expected[near]).sum()) / (len(table.power) if table.together else 1)
        beneath[r] = power[r] < distorted and power[r] < power.max()
    return beneath


def runs_on(table: ResponseLines, fit: ResponseFit, noise: Noise) -> BoolArray:
    """(n_poles,) whether what the model leaves near each resonance runs on from line to line, as noise does not.

    A resonance whose frequency or damping depends on its level is no sum of poles. The correlation over lines that no
    window joins is held against that of drawn errors: further from their mean than 5 of their standard deviations. Not
    asked of blocks that leak where no coherence tells how much: a linear structure failed it (white forces, 41184).
    """
    digits = np.sqrt(np.finfo(float).eps) * np.abs(table.values).max()
    if (table.leaks and table.noise is None) or np.abs(fit.left).max() <= digits:  # of a model's table rounding is left
        return np.zeros(fit.poles.size, dtype=np.bool_)
    rng, weight = np.random.default_rng(DRAWN), np.where(table.known, 1 / np.sqrt(noise.variance), 0.0)
    reach, last = _reach(table)[-1], table.z.size - 1
    angles = np.abs(np.log(fit.poles))
    wide = np.where(fit.is_pair, -np.log(np.maximum(np.abs(fit.poles), TINY)), 0.0)
    first, end = (np.searchsorted(np.angle(table.z), angles + side * wide) for side in (-1, 1))

    def courses(left: ComplexArray) -> FloatArray:
        found = []
        for low, high in zip(np.maximum(first - NEAR, 0), np.minimum(end + NEAR, last), strict=True):
            x = (weight * left)[low : high + 1]
            power = max(float((np.abs(x) ** 2).sum()), TINY)
            offsets = range(reach + 1, min(reach + 5, len(x)))
            found.append(sum(abs(np.vdot(x[:-m], x[m:])) for m in offsets) / power)
        return np.array(found)

    drawn = np.array([courses(drawn_noise(table, fit, noise, rng)) for _ in range(DRAWN)])
    off: BoolArray = courses(fit.left) > drawn.mean(axis=0) + SURE * drawn.std(axis=0)
    return off & fit.is_pair & (angles >= np.angle(table.z[0])) & (angles <= np.angle(table.z[last]))


def _from_scatter(
    scatter: FloatArray, parts: list[FloatArray], table: ResponseLines, least: float
) -> tuple[float, FloatArray]:
    """`_split` of the scatter or, of lines that do not leak, of its ratio to its own course over the lines.

    The likelier of the two: a force that fades makes a course which parts that grow with the response cannot follow,
    and they then take the noise from the antiresonances to the resonances.
    """
    split = _split(scatter, parts, table.known, least)
    if table.leaks:
        return split

    def unlikely(expected: FloatArray) -> float:
        variance = np.maximum(expected * _smoothed(scatter / expected, table.known, WIDE), least)
        return float((table.known * (scatter / variance + np.log(variance))).sum())

    course = np.maximum(_smoothed(scatter, table.known, WIDE), least)
    other = _split(scatter / course, parts, table.known, least / float(course.max()))
    return min(split, other, key=lambda one: unlikely(one[1]))


def _split(scatter: FloatArray, parts: list[FloatArray], known: BoolArray, least: float) -> tuple[float, FloatArray]:
    """The first part's share in the scatter and the variance: some of each part and a floor of each response.

    By the likelihood of exponentially distributed powers, with multiplicative updates, which leave no size negative.
    """
    floor = np.maximum(_median(scatter, known) / np.log(2), least)  # of an exponential distribution
    sizes = [
        float(np.median(scatter[known & (part > 0)] / part[known & (part > 0)])) if part.any() else 0.0
        for part in parts
    ]
    variance = floor + sum(size * part for size, part in zip(sizes, parts, strict=True))
    for _ in range(ROUNDS):
        above, below = known * scatter / variance**2, known / variance
        sizes = [
            size * float(np.sqrt((above * part).sum() / max(float((below * part).sum()), TINY)))
            for size, part in zip(sizes, parts, strict=True)
        ]
        floor = np.maximum(floor * np.sqrt(above.sum(axis=0) / np.maximum(below.sum(axis=0), TINY)), least)
        variance = floor + sum(size * part for size, part in zip(sizes, parts, strict=True))
    return sizes[0], variance


def _weighted_mean(values: FloatArray, known: BoolArray) -> FloatArray:
    return np.asarray((values * known).sum(axis=0) / np.maximum(1, known.sum(axis=0)), dtype=np.float64)


def _median(values: FloatArray, known: BoolArray) -> FloatArray:
    """Over the lines, which a band without input does not move."""
    return np.asarray(np.nan_to_num(np.nanmedian(np.where(known, values, np.nan), axis=0)), dtype=np.float64)


def _smoothed(values: FloatArray, known: BoolArray, reach: int) -> FloatArray:
    """Mean over the lines around each one."""
    ones = np.ones(2 * reach + 1)  # summed anew for each line: a running sum would drown small values in large ones
    total, count = (
        scipy.ndimage.convolve1d(part, ones, axis=0, mode="constant") for part in (values * known, known * 1.0)
    )
    return np.asarray(total / np.maximum(1, count), dtype=np.float64)


def _reach(table: ResponseLines) -> list[int]:
    """Offsets of lines whose errors belong together."""
    if table.lags is None or table.window in {"uniform", "periodic"}:
        return [0]
    most = min(FARTHEST, table.z.size - 1)
    return [m for m in range(most + 1) if abs(table.joined(m)) > np.sqrt(np.finfo(float).eps)]


def _covariances(table: ResponseLines, fit: ResponseFit, noise: Noise, offset: int) -> ComplexArray:
    """(n_inputs, n_lines - offset, n_outputs, n_outputs) of the responses to each input at lines l + offset and l.

    The errors of an input's responses are what the outputs hold beside the model, times the input, so their correlation
    over lines, and over blocks that overlap, is that of the one times that of the other.
    """
    variance = noise.variance.transpose(2, 0, 1)
    n_outputs = variance.shape[2]
    if not table.leaks:
        size = np.sqrt(variance)
        common = table.joined(offset)
        own = slice(variance.shape[1] - offset)
        alone = (size[:, offset:, :, np.newaxis] * size[:, own, np.newaxis]) * np.eye(n_outputs)
        return np.asarray(common * alone, dtype=np.complex128)
    power = noise.averaged.transpose(2, 0, 1) * noise.share[:, np.newaxis, np.newaxis]
    size = np.sqrt(variance / np.maximum(variance, power))
    both = _modelled(table, fit, noise, offset)
    own = slice(both.shape[1])
    scaled = both * (size[:, offset:, :, np.newaxis] * size[:, own, np.newaxis])
    return np.asarray(scaled, dtype=np.complex128)


def _modelled(table: ResponseLines, fit: ResponseFit, noise: Noise, offset: int) -> ComplexArray:
    """The same of leaking blocks, before it is scaled to the variance of each value."""
    variance = noise.variance.transpose(2, 0, 1)
    n_inputs, _, n_outputs = variance.shape
    groups = [list(range(n_inputs))] if table.together else [[i] for i in range(n_inputs)]
    power = noise.averaged.transpose(2, 0, 1) * noise.share[:, np.newaxis, np.newaxis]
    rest = np.sqrt(np.maximum(variance - power, 0.0) / _twice(table))
    own = slice(variance.shape[1] - offset)
    white = (rest[:, offset:, :, np.newaxis] * rest[:, own, np.newaxis]) * np.eye(n_outputs)
    both = np.zeros(white.shape, dtype=np.complex128)
    for shift in table.shifts:
        leaks = np.stack([_leakage(table, fit, group, offset, shift) for group in groups])
        common = _common(table, shift, offset)
        both += (leaks * noise.share[:, np.newaxis, np.newaxis, np.newaxis] + common * white) * common.conj()
    return both


def lines_joined(table: ResponseLines) -> float:
    """Sum over lines of the correlation of their errors with those of one."""
    return float(table.joining().sum().real)


def drawn_noise(table: ResponseLines, fit: ResponseFit, noise: Noise, rng: np.random.Generator) -> ComplexArray:
    """(n_lines, n_outputs, n_inputs) errors as the table has them, correlated over outputs and lines.

    A table plus and minus such errors is what its averages would have given by halves: two tables of twice the
    variance, independent of one another (Leiner, Duan, Wasserman, Ramdas, "Data fission", J. American Statistical
    Association 120, 2025, doi 10.1080/01621459.2023.2270748).
    """
    covariance = _covariances(table, fit, noise, 0)
    n_inputs, n_lines, n_outputs, _ = covariance.shape
    values, vectors = np.linalg.eigh(covariance)
    n = n_lines if table.lags is None else table.lags.size
    across = np.zeros(n, dtype=np.complex128)
    across[: table.joining().size] = table.joining()
    colour = np.sqrt(np.maximum(n * np.fft.ifft(across).real, 0.0))
    shape = (n_inputs, n, n_outputs)
    white = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    lines = np.fft.fft(white * colour[:, np.newaxis], axis=1)[:, :n_lines] / np.sqrt(2 * n)
    drawn = vectors @ (np.sqrt(np.maximum(values, 0.0)) * lines)[..., np.newaxis]
    return np.where(table.known, drawn[..., 0].transpose(1, 2, 0), 0.0)


def pole_deviations(table: ResponseLines, fit: ResponseFit, noise: Noise) -> tuple[FloatArray, FloatArray]:
    """(n_poles,) standard deviations of frequency [Hz] and damping ratio, for the weights 1 / variance.

    M^-1 S M^-1 with M the curvature and S the covariance of the slope under errors that are correlated over outputs and
    over the lines that the window joins, and not alike in their real and imaginary parts. The correlations are those
    of a model, and cut off where they fade, so that S may have negative parts; no deviation is less than if each line
    told as much as those that the window joins do together.
    """
    inverse = _inverse_curvature(fit)
    (spread,) = _spreads(table, fit, noise, [fit.slopes])
    covariance, least = inverse @ spread @ inverse, 0.5 * inverse / lines_joined(table)
    n_poles, pairs = fit.poles.size, np.flatnonzero(fit.is_pair)
    f_std, d_std = np.full(n_poles, np.nan), np.full(n_poles, np.nan)
    for r in range(n_poles):
        s = np.log(fit.poles[r])
        size = max(abs(s), TINY)
        rows = [r] + ([fit.inputs.size + int(np.searchsorted(pairs, r))] if fit.is_pair[r] else [])
        block, floor = covariance[np.ix_(rows, rows)], least[np.ix_(rows, rows)]
        radial = np.array([s.real, s.imag][: len(rows)]) / size
        f_std[r] = np.sqrt(max(float(radial @ floor @ radial), float(radial @ block @ radial))) / (2 * np.pi * table.dt)
        # damping -a / |s|: its slope is -b^2 / |s|^3 by a and a b / |s|^3 by b
        bend = np.array([-(s.imag**2), s.real * s.imag][: len(rows)]) / size**3
        d_std[r] = np.sqrt(max(float(bend @ floor @ bend), float(bend @ block @ bend)))
    return f_std, d_std


def _inverse_curvature(fit: ResponseFit) -> FloatArray:
    flat = fit.slopes.reshape(-1, fit.slopes.shape[-1])
    curvature = flat.T @ flat
    # in units of their own, so that what is undetermined does not depend on how the unknowns are measured
    units = np.sqrt(np.maximum(np.diag(curvature), TINY))
    inverse: FloatArray = np.linalg.pinv(curvature / np.outer(units, units), hermitian=True) / np.outer(units, units)
    return inverse


def _spreads(table: ResponseLines, fit: ResponseFit, noise: Noise, several: Sequence[FloatArray]) -> list[FloatArray]:
    """(n_sums, n_sums) covariances of weighted sums of the errors, with weights shaped as slopes, n_sums of them."""
    weights = [(each[:, 0] + 1j * each[:, 1]).transpose(2, 1, 0, 3) for each in several]  # inputs, lines, outputs, sums
    known = np.where(table.known, 1 / np.sqrt(noise.variance), 0.0).transpose(2, 0, 1)
    spreads = [np.zeros((each.shape[-1],) * 2) for each in several]
    for offset in _reach(table):
        covariance = _covariances(table, fit, noise, offset)
        n_lines = covariance.shape[1]
        for k, weight in enumerate(weights):
            later = weight[:, offset:] * known[:, offset:, :, np.newaxis]
            here = covariance @ (weight[:, :n_lines] * known[:, :n_lines, :, np.newaxis])
            part = 0.5 * np.einsum("ilqa,ilqb->ab", later.conj(), here, optimize=True).real
            spreads[k] += part if offset == 0 else part + part.T
    if not table.leaks:
        return spreads
    alone = 1.0 if table.together else np.eye(len(noise.share))
    blocks = noise.share * table.power  # one over their number
    share = np.sqrt(np.outer(blocks, blocks)) * alone
    power = noise.averaged * noise.share
    within = np.sqrt(noise.variance / np.maximum(noise.variance, power)).transpose(2, 0, 1)
    scaled = [(weight * (known * within)[..., np.newaxis]).conj() for weight in weights]
    for offset in range(min(FARTHEST, table.z.size - 1) + 1):
        crossed = [_crossing(table, fit, offset, shift) for shift in table.shifts]
        for k, each in enumerate(scaled):
            part = np.zeros_like(spreads[k])
            for ahead, behind in crossed:
                one = np.einsum("ilqa,lqj->lija", each[:, offset:], ahead, optimize=True) * share[..., np.newaxis]
                other = np.einsum("jlqb,lqi->lijb", each[:, : ahead.shape[0]], behind, optimize=True)
                part += 0.5 * np.einsum("lija,lijb->ab", one, other, optimize=True).real
            spreads[k] += part if offset == 0 else part + part.T
    return spreads


def residue_deviations(
    table: ResponseLines, fit: ResponseFit, noise: Noise, poles: Sequence[int]
) -> list[tuple[FloatArray, FloatArray]]:
    """Deviations of shape and modal mass of some poles of a fit with the weights 1 / variance.

    A residue is c_o b_i. What the errors e, weighted, do to the poles and participations is K^-1 J' e with J the slopes
    and K the curvature, and to the shapes of an output, V C' e less what they answer to those, with C the columns that
    the shapes multiply and V their inverse: sums of errors, whose covariance is that of `pole_deviations`.

    Args:
        table: that was fitted.
        fit: of it.
        noise: about it.
        poles: indices of pairs.

    Returns:
        For each (n_outputs,) root mean square distance of the components of a shape whose largest is 1, and
        (n_outputs, n_inputs) relative standard deviations of the mass m ~ c_o / (c_l^2 b_i), l the largest component;
        the frequency in it is known far better, and left out.
    """
    n_outputs, _, n_lines, n_inputs, n_free = fit.slopes.shape
    by_step = fit.slopes.reshape(n_outputs, -1, n_free) @ _inverse_curvature(fit)
    weight = np.where(table.known, 1 / np.sqrt(noise.variance), 0.0).transpose(1, 0, 2).reshape(n_outputs, -1)
    own = np.tile(weight, 2)[..., np.newaxis] * linear_columns(table, fit)
    shapes, masses = np.zeros((len(poles), n_outputs)), np.zeros((len(poles), n_outputs, n_inputs))
    most = max(1, n_free // 2 - n_inputs - 1)  # outputs at a time: their sums have no more weights than slopes are
    parts = np.array_split(np.arange(n_outputs), -(-n_outputs // most))
    sizes = np.abs(fit.shapes[:, poles] * table.output_scale[:, np.newaxis]).T
    asked = [
        (k, [int(sizes[k].argmax()), *part[part != sizes[k].argmax()].tolist()])
        for k in range(len(poles))
        for part in parts
    ]
    n_together = max(1, MOST_WEIGHTS // (n_outputs * n_lines * n_inputs * 2 * (len(parts[0]) + 1 + n_inputs)))
    for first in range(0, len(asked), n_together):
        batch = asked[first : first + n_together]
        changes = [_residue_changes(fit, by_step, own, poles[k], of) for k, of in batch]
        spreads = _spreads(table, fit, noise, changes)
        for (k, outputs), change, spread in zip(batch, changes, spreads, strict=True):
            flat = change.reshape(-1, change.shape[-1])
            both = spread, 0.5 * flat.T @ flat / lines_joined(table)
            n, n_asked = len(outputs) + n_inputs, len(outputs)
            unit = np.eye(n)
            apart = unit[:n_asked] - unit[0]
            of_mass = (unit[:n_asked] - 2.0 * unit[0])[:, np.newaxis] - unit[n_asked:]
            shapes[k, outputs] = _variance(apart, both, slice(n)) + _variance(apart, both, slice(n, 2 * n))
            masses[k, outputs] = _variance(of_mass, both, slice(n))
    relative = sizes / sizes.max(axis=1, keepdims=True, initial=TINY)
    return list(zip(np.sqrt(shapes) * relative, np.sqrt(masses), strict=True))


def _residue_changes(
    fit: ResponseFit, by_step: FloatArray, columns: FloatArray, pole: int, asked: Sequence[int]
) -> FloatArray:
    """Weights, shaped as slopes, of the errors in sums: relative changes of a pole's shape, then of its participations.

    Of the outputs that are asked for, and of all inputs; real parts of them all, then the imaginary ones.
    """
    n_outputs, _, n_lines, n_inputs, _ = fit.slopes.shape
    rows = [pole, fit.poles.size + int(np.searchsorted(np.flatnonzero(fit.is_pair), pole))]
    sums = np.zeros((n_outputs, by_step.shape[1], len(asked) + n_inputs), dtype=np.complex128)
    for k, o in enumerate(asked):
        c = _nonzero(fit.shapes[o, pole])
        sums[..., k] -= by_step @ ((fit.answers[o][rows[0]] + 1j * fit.answers[o][rows[1]]) / c)
        own = columns[o] @ fit.inverse[o][:, rows]
        sums[o, :, k] += (own[:, 0] + 1j * own[:, 1]) / c
    for i in range(n_inputs):
        moved = participation_moved(fit, pole, i) / _nonzero(fit.inputs[pole, i])
        sums[..., len(asked) + i] = by_step @ moved
    return np.concatenate([sums.real, sums.imag], axis=-1).reshape(n_outputs, 2, n_lines, n_inputs, -1)


def _variance(weights: FloatArray, covariances: Sequence[FloatArray], part: slice) -> FloatArray:
    """The largest that any of the covariances gives to the weighted sums, weights along the last axis."""
    forms = [np.einsum("...a,ab,...b->...", weights, one[part, part], weights) for one in covariances]
    return np.asarray(np.maximum(np.max(forms, axis=0), 0.0), dtype=np.float64)


def _nonzero(value: complex) -> complex:
    """A component that is nothing as the least number, so that its relative deviation is beyond all bounds."""
    return value if value != 0 else TINY
