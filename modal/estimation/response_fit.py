"""Poles, shapes and participations fitted to frequency responses as they stand, seen through the window of the blocks.

The model of a table is the sum over poles of c b' g(lambda) + D, with g the transform of lambda^(k-1) r_w(k) over the
lags k = 1 ... n - 1 of a block (1 / (z - lambda) for blocks of whole periods): nothing is divided by the window. Shapes
and feedthrough are linear and leave by projection; poles and participations are found by Gauss-Newton steps
(Golub and Pereyra, SIAM J. Numerical Analysis 10(2), 1973, 413-432, doi 10.1137/0710036; in Kaufman's form).

What a finite block gets wrong is part of the noise: the answer to what came before the block, and what is still to come
after it. For inputs that are white over a resonance its covariance over outputs and lines follows from the model in
closed form (`leakage`), and makes weights and standard deviations right where resonances are narrower than a line.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from era.realisation import Realisation
from modal.modes.modal_form import modal_basis
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray
from okid.frequency_response import ResponseWindow, window_samples

__all__ = [
    "Noise",
    "ResponseFit",
    "ResponseLines",
    "drawn_noise",
    "fit_at",
    "noise_of",
    "pole_deviations",
    "powers_of",
    "realised",
    "refined",
    "start_of",
]

LARGEST_SIZE = 0.999999
"""Keep poles within this size: a structure's answers end, and so do the sums over a state's past."""
MOST_STEPS = 15
"""Take at most so many steps: from a realisation of the same table a refinement stands still within some five."""
STANDS_STILL = 1e-7
"""Stop where a step lowers the squared error by a smaller share: far below what noise decides."""
ROUNDING = 1e-13
"""Take errors for at least this share of a table's largest value: the digits of its numbers."""
LEAST_START = 1e-3
"""Start no pole with a shorter memory than a thousandth a step."""
NEAR, WIDE = 10, 40
"""Smooth the noise over so many lines on either side, where coherence tells it and where only the scatter does: some 20
and 80 values, which give a level to about a quarter and a tenth."""
ROUNDS = 60
"""Split scatter into leakage and floor by so many multiplicative updates; they settle to a few per cent in ten."""
FARTHEST = 8
"""Correlate the errors of lines up to so far apart: beyond, the windows known here leave nothing."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResponseLines:
    """Responses in channels of comparable size, on the grid of the blocks they came from.

    Attributes:
        values: (n_lines, n_outputs, n_inputs), zero where not measured.
        known: the same shape, True where measured.
        z: (n_lines,) exp(2 pi j f dt).
        dt: time step [s].
        lags: (n_samples,) what the window leaves at each lag; None: whole periods, in closed form.
        first: number of the first line on the grid of the block.
        window: of the blocks.
        noise: (n_lines, n_outputs, n_inputs) (1 - coherence) / coherence, None where it is not known.
        trust: the same shape, coherence beyond that of noise alone, 1 where it is not known.
        together: whether all inputs acted at once.
        output_scale: (n_outputs,) sizes that the values were divided by.
        input_scale: (n_inputs,) sizes that they were multiplied by.
    """

    values: ComplexArray
    known: BoolArray
    z: ComplexArray
    dt: float
    lags: FloatArray | None
    first: int
    window: ResponseWindow
    noise: FloatArray | None
    trust: FloatArray
    together: bool
    output_scale: FloatArray
    input_scale: FloatArray

    @property
    def leaks(self) -> bool:
        """Whether blocks cut into answers that go on: a window over inputs that do not repeat."""
        return self.window not in {"periodic", "exponential"}

    def basis(self, poles: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(n_lines, n_poles) g of each pole, and its derivative by the pole's logarithm."""
        if self.lags is None:
            g = 1 / (self.z[:, np.newaxis] - poles)
            return g, poles * g**2
        steps = np.r_[0.0, np.arange(self.lags.size - 1.0)]
        return self.transformed(poles, self.lags), self.transformed(poles, self.lags * steps)

    def transformed(self, poles: ComplexArray, lags: FloatArray | ComplexArray) -> ComplexArray:
        """(n_lines, n_poles) sum over lags k >= 1 of lambda^(k-1) lags(k) z^-k."""
        n = lags.size
        size = np.clip(np.abs(poles), TINY, 1 + 30 / n)  # so that a growing pole's power stays a number
        series = np.zeros((n, poles.size), dtype=np.complex128)
        series[1:] = np.exp(np.arange(n - 1)[:, np.newaxis] * (np.log(size) + 1j * np.angle(poles)))
        series *= lags[:, np.newaxis]
        spectrum: ComplexArray = np.fft.fft(series, axis=0)[self.first : self.first + self.z.size]
        return spectrum

    def ambiguity(self, offset: int) -> tuple[ComplexArray, ComplexArray]:
        """(n_samples,) sums of w(t) w(t - tau) exp(-2 pi j offset t / n) over sum w^2, for tau >= 0 and for -tau."""
        if self.lags is None:
            return np.ones(1, dtype=np.complex128), np.ones(1, dtype=np.complex128)
        n = self.lags.size
        w = self.lags if self.window == "exponential" else window_samples(self.window, n, None, self.dt)
        turned = w * np.exp(-2j * np.pi * offset / n * np.arange(n))
        both = np.fft.ifft(np.fft.fft(turned, 2 * n) * np.fft.fft(w, 2 * n).conj()) / (w @ w)
        return both[:n], np.r_[both[:1], both[:n:-1]]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResponseFit:
    """A model of a table.

    Attributes:
        poles: (n_poles,) discrete poles, one of each pair.
        is_pair: (n_poles,).
        inputs: (n_poles, n_inputs) b, its largest component 1.
        shapes: (n_outputs, n_poles) c.
        feedthrough: (n_outputs, n_inputs) D.
        error: weighted squared error.
        left: (n_lines, n_outputs, n_inputs) table less model, zero where not measured.
        slopes: (n_outputs, n_lines, n_inputs, n_parameters) weighted derivatives of the model by the poles (logarithm,
            real and imaginary part) and then by the participations, what shapes and feedthrough can do projected out.
    """

    poles: ComplexArray
    is_pair: BoolArray
    inputs: ComplexArray
    shapes: ComplexArray
    feedthrough: FloatArray
    error: float
    left: ComplexArray
    slopes: ComplexArray

    @property
    def n_parameters(self) -> int:
        """Numbers that were fitted, linear ones included."""
        n_states = int(np.where(self.is_pair, 2, 1).sum())
        return int(self.slopes.shape[3]) + n_states * len(self.shapes) + self.feedthrough.size

    def expanded(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Poles, participations and shapes with the conjugates of the pairs."""
        pair = self.is_pair
        return (
            np.r_[self.poles, self.poles[pair].conj()],
            np.vstack([self.inputs, self.inputs[pair].conj()]),
            np.hstack([self.shapes, self.shapes[:, pair].conj()]),
        )


def start_of(model: Realisation, dt: float) -> tuple[ComplexArray, BoolArray, ComplexArray]:
    """Poles at steps of dt, pairs and participations of a realisation in a table's channels; growing ones turned in."""
    basis = modal_basis(model)
    poles = np.where(np.abs(basis.poles) >= 1, 1 / np.where(basis.poles == 0, 1, basis.poles.conj()), basis.poles)
    if dt == model.dt:
        return poles, basis.is_pair, _unit(basis.inputs, basis.is_pair)
    # at a shorter step what alternated from sample to sample is a pair
    poles = np.exp(np.log(np.maximum(np.abs(poles), LEAST_START) * np.exp(1j * np.angle(poles))) * dt / model.dt)
    is_pair = np.asarray(poles.imag > 0, dtype=np.bool_)
    return poles, is_pair, _unit(basis.inputs, is_pair)


def _unit(inputs: ComplexArray, is_pair: BoolArray) -> ComplexArray:
    """Participations with a largest component of 1, those of real poles real."""
    at = np.abs(inputs).argmax(axis=1)[:, np.newaxis]
    largest = np.take_along_axis(inputs, at, axis=1)
    inputs = (np.where(largest == 0, 1.0, inputs) / np.where(largest == 0, 1.0, largest)).astype(np.complex128)
    return np.where(is_pair[:, np.newaxis], inputs, inputs.real + 0j)


def fit_at(
    table: ResponseLines, poles: ComplexArray, is_pair: BoolArray, inputs: ComplexArray, weight: FloatArray
) -> ResponseFit:
    """The best shapes and feedthrough for given poles and participations.

    Args:
        table: to fit.
        poles: (n_poles,) discrete.
        is_pair: (n_poles,).
        inputs: (n_poles, n_inputs) participations.
        weight: (n_lines, n_outputs, n_inputs) one over the standard deviation of each value, 0 where not measured.
    """
    n_lines, n_outputs, n_inputs = table.values.shape
    g, dg = table.basis(poles)
    mirrored, d_mirrored = table.basis(poles[is_pair].conj())
    pairs = np.flatnonzero(is_pair)
    plus, minus = g[:, np.newaxis] * inputs.T, mirrored[:, np.newaxis] * inputs[pairs].T.conj()
    real_part = plus.copy()
    real_part[:, :, pairs] += minus
    columns = np.concatenate(
        [real_part, 1j * (plus[:, :, pairs] - minus), np.tile(np.eye(n_inputs) + 0j, (n_lines, 1, 1))], axis=2
    )
    n_poles, fixed = poles.size, np.abs(inputs).argmax(axis=1)
    shapes = np.zeros((n_outputs, n_poles), dtype=np.complex128)
    feedthrough = np.zeros((n_outputs, n_inputs))
    left = np.zeros_like(table.values)
    free = [(r, i) for r in range(n_poles) for i in range(n_inputs) if i != fixed[r]]
    n_free = n_poles + pairs.size + sum(2 if is_pair[r] else 1 for r, _ in free)
    slopes = np.zeros((n_outputs, n_lines, n_inputs, n_free), dtype=np.complex128)
    error = 0.0
    for q in range(n_outputs):
        w = weight[:, q]
        basis, found = _orthonormal(w[:, :, np.newaxis] * columns, w * table.values[:, q])
        c = found[:n_poles] + 0j
        c[pairs] += 1j * found[n_poles : n_poles + pairs.size]
        shapes[q], feedthrough[q] = c, found[n_poles + pairs.size :]
        left[:, q] = np.where(table.known[:, q], table.values[:, q] - columns @ found, 0.0)
        error += float((np.abs(w * left[:, q]) ** 2).sum())
        slope = slopes[q]
        bend = dg[:, np.newaxis] * inputs.T * c
        bend_mirrored = d_mirrored[:, np.newaxis] * (inputs[pairs].T * c[pairs]).conj()
        slope[:, :, :n_poles] = bend
        slope[:, :, pairs] += bend_mirrored
        slope[:, :, n_poles : n_poles + pairs.size] = 1j * (bend[:, :, pairs] - bend_mirrored)
        at = n_poles + pairs.size
        for r, i in free:
            one = c[r] * g[:, r]
            other = c[r].conj() * mirrored[:, int(np.searchsorted(pairs, r))] if is_pair[r] else 0.0
            slope[:, i, at] = one + other
            if is_pair[r]:
                slope[:, i, at + 1] = 1j * (one - other)
            at += 2 if is_pair[r] else 1
        slope *= w[:, :, np.newaxis]
        flat = _stacked(slope)
        flat -= basis @ (basis.T @ flat)
        half = flat.shape[0] // 2
        slopes[q] = (flat[:half] + 1j * flat[half:]).reshape(slope.shape)
    return ResponseFit(
        poles=poles,
        is_pair=is_pair,
        inputs=inputs,
        shapes=shapes,
        feedthrough=feedthrough,
        error=error,
        left=left,
        slopes=slopes,
    )


def _stacked(values: ComplexArray) -> FloatArray:
    """(2 n_lines n_inputs, n_columns) real parts above imaginary parts."""
    flat = values.reshape(-1, values.shape[-1])
    return np.concatenate([flat.real, flat.imag])


def _orthonormal(columns: ComplexArray, wanted: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Orthonormal basis of what the columns span, and the coefficients that fit what is wanted."""
    matrix = _stacked(columns)
    size = np.maximum(np.linalg.norm(matrix, axis=0), TINY)
    left, values, right = np.linalg.svd(matrix / size, full_matrices=False)
    kept = values > values.max(initial=0.0) * np.finfo(float).eps * len(size)
    basis = left[:, kept]
    found = right[kept].T @ ((basis.T @ _stacked(wanted.reshape(-1, 1))[:, 0]) / values[kept]) / size
    return basis, found


def refined(table: ResponseLines, start: ResponseFit, weight: FloatArray, *, n_steps: int = MOST_STEPS) -> ResponseFit:
    """Poles and participations after damped Gauss-Newton steps, as long as the squared error falls.

    Args:
        table: to fit.
        start: where to begin.
        weight: as in `fit_at`.
        n_steps: at most so many.
    """
    best, damping = fit_at(table, start.poles, start.is_pair, start.inputs, weight), 1e-3
    for _ in range(n_steps):
        flat = best.slopes.reshape(-1, best.slopes.shape[3])
        wanted = (weight * best.left).transpose(1, 0, 2).ravel()
        curvature, slope = (flat.conj().T @ flat).real, (flat.conj().T @ wanted).real
        diagonal = np.maximum(np.diag(curvature), TINY)
        trial = best
        while damping < 1e6:
            damped = curvature + np.diag(damping * diagonal)
            step = np.asarray(np.linalg.lstsq(damped, slope, rcond=None)[0], dtype=np.float64)
            trial = fit_at(table, *_moved(best, step), weight)
            if trial.error < best.error:
                damping /= 10
                break
            damping *= 10
        gained = best.error - trial.error
        if gained <= 0:
            break
        best = trial
        if gained <= STANDS_STILL * best.error:
            break
    return best


def _moved(fit: ResponseFit, step: FloatArray) -> tuple[ComplexArray, BoolArray, ComplexArray]:
    n_poles, n_pairs = fit.poles.size, int(fit.is_pair.sum())
    turn = np.zeros(n_poles)
    turn[fit.is_pair] = step[n_poles : n_poles + n_pairs]
    poles = fit.poles * np.exp(np.clip(step[:n_poles], -1, 1) + 1j * np.clip(turn, -1, 1))
    poles = poles * np.minimum(1.0, LARGEST_SIZE / np.maximum(np.abs(poles), TINY))
    # a pair that crosses the axis is its own mirror image
    crossed = fit.is_pair & (poles.imag < 0)
    inputs, at = fit.inputs.copy(), n_poles + n_pairs
    fixed = np.abs(fit.inputs).argmax(axis=1)
    for r in range(n_poles):
        for i in range(inputs.shape[1]):
            if i != fixed[r]:
                inputs[r, i] += step[at] + (1j * step[at + 1] if fit.is_pair[r] else 0.0)
                at += 2 if fit.is_pair[r] else 1
    poles[crossed], inputs[crossed] = poles[crossed].conj(), inputs[crossed].conj()
    return poles, fit.is_pair, _unit(inputs, fit.is_pair)


def realised(fit: ResponseFit, table: ResponseLines) -> Realisation:
    """The model in the units of the responses, with one state for a real pole and two for a pair."""
    order = int(np.where(fit.is_pair, 2, 1).sum())
    A, B = np.zeros((order, order)), np.zeros((order, fit.inputs.shape[1]))
    C = np.zeros((len(fit.shapes), order))
    row = 0
    for pole, is_pair, b, c in zip(fit.poles, fit.is_pair, fit.inputs, fit.shapes.T, strict=True):
        own = slice(row, row + (2 if is_pair else 1))
        A[own, own] = [[pole.real, -pole.imag], [pole.imag, pole.real]] if is_pair else pole.real
        B[own] = [b.real, b.imag] if is_pair else b.real
        C[:, own] = np.column_stack([2 * c.real, -2 * c.imag]) if is_pair else c.real[:, np.newaxis]
        row = own.stop
    into, out = table.input_scale, table.output_scale[:, np.newaxis]
    return Realisation(A, B / into, C * out, fit.feedthrough * out / into, table.dt)


def powers_of(table: ResponseLines, fit: ResponseFit, weight: FloatArray) -> FloatArray:
    """(n_poles,) squares of what each pole adds to the table, in standard deviations."""
    plus, minus = table.basis(fit.poles)[0], table.basis(fit.poles.conj())[0] * fit.is_pair
    powers = []
    for r, (c, b) in enumerate(zip(fit.shapes.T, fit.inputs, strict=True)):
        part = plus[:, r, np.newaxis, np.newaxis] * np.outer(c, b)
        part += minus[:, r, np.newaxis, np.newaxis] * np.outer(c, b).conj()
        powers.append(float(np.square(np.abs(weight * part)).sum()))
    return np.array(powers)


# --- the noise of a table --------------------------------------------------------------------------------------------


def _leakage(table: ResponseLines, fit: ResponseFit, inputs: list[int], offset: int = 0) -> ComplexArray:
    """(n_lines - offset, n_outputs, n_outputs) covariance of what finite blocks leave at lines l + offset and l.

    For independent white inputs of unit power: N(k) = Y(k) - G(k) U(k) with everything a sum over the block's window,
    so each term is a transform of the output's correlation, the pulse response, or nothing, over the window's
    ambiguity.
    """
    poles, b, c = fit.expanded()
    b, d = b[:, inputs], fit.feedthrough[:, inputs]
    poles = poles * np.minimum(1.0, LARGEST_SIZE / np.maximum(np.abs(poles), TINY))
    state = (b @ b.conj().T) / (1 - poles[:, np.newaxis] * poles.conj())
    onward = poles[:, np.newaxis] * (state @ c.conj().T) + b @ d.T
    now = (c @ state @ c.conj().T).real + d @ d.T
    n_lines = table.z.size - offset
    model = c @ (table.basis(poles)[0][:, :, np.newaxis] * b) + d
    later, here = model[offset:], model[:n_lines].conj().transpose(0, 2, 1)
    ahead, behind = table.ambiguity(offset)
    plus = table.transformed(poles, ahead)[:n_lines]
    minus = plus if offset == 0 else table.transformed(poles, behind.conj())[:n_lines]
    outputs = c @ (plus[:, :, np.newaxis] * onward) + _mirrored(c @ (minus[:, :, np.newaxis] * onward))
    out_in = c @ (plus[:, :, np.newaxis] * b) + d * ahead[0]
    in_out = _mirrored(c @ (minus[:, :, np.newaxis] * b) + d * ahead[0].conj())
    both = outputs + now * ahead[0] - out_in @ here - later @ in_out + later @ here * ahead[0]
    return np.asarray(both, dtype=np.complex128)


def _crossing(table: ResponseLines, fit: ResponseFit, offset: int) -> tuple[ComplexArray, ComplexArray]:
    """(n_lines - offset, n_outputs, n_inputs) what is left at one line times the inputs at the other, each way round.

    It makes errors of neighbouring lines turn together, so that their real and imaginary parts are not alike.
    """
    poles, b, c = fit.expanded()
    n_lines = table.z.size - offset
    model = c @ (table.basis(poles)[0][:, :, np.newaxis] * b) + fit.feedthrough
    ahead, behind = table.ambiguity(offset)
    plus, minus = table.transformed(poles, ahead)[:n_lines], table.transformed(poles, behind.conj())[:n_lines]
    later = c @ (plus[:, :, np.newaxis] * b) + (fit.feedthrough - model[offset:]) * ahead[0]
    here = c @ (minus[:, :, np.newaxis] * b) + (fit.feedthrough - model[:n_lines]) * ahead[0].conj()
    return later, here


def _mirrored(matrices: ComplexArray) -> ComplexArray:
    return matrices.conj().transpose(0, 2, 1)


def _own_leakage(table: ResponseLines, fit: ResponseFit) -> FloatArray:
    """(n_lines, n_outputs, n_inputs) power of the leakage in each response."""
    if not table.leaks:
        return np.zeros(table.values.shape)
    n_inputs = table.values.shape[2]
    groups = [list(range(n_inputs))] if table.together else [[i] for i in range(n_inputs)]
    parts = [np.einsum("lqq->lq", _leakage(table, fit, group)).real for group in groups]
    power = np.stack(parts * (n_inputs // len(parts)), axis=2)
    return np.asarray(np.maximum(power, 0.0), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Noise:
    """What the values of a table are uncertain by.

    Attributes:
        variance: (n_lines, n_outputs, n_inputs) of each value.
        leakage: the same shape, what finite blocks leave for inputs of unit power.
        share: (n_inputs,) of it in the variance: one over the number of averages and the input's power.
    """

    variance: FloatArray
    leakage: FloatArray
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
    leak, scatter = _own_leakage(table, fit), np.abs(fit.left) ** 2
    least = max((ROUNDING * np.abs(table.values * table.trust).max()) ** 2, TINY)
    scatter = scatter / max(0.1, 1 - fit.n_parameters / (2 * int(table.known.sum())))
    share = 1.0
    if table.noise is None:
        share, expected = _split(
            scatter, [leak, np.abs(table.values - fit.left) ** 2 * table.known], table.known, least
        )
        seen, reach = scatter, WIDE
    else:
        measured = np.abs(table.values) ** 2
        seen = table.noise * (measured.sum(axis=2, keepdims=True) if table.together else measured)
        floor = np.maximum(_median(np.maximum(seen - leak, 0), table.known), least)
        expected, reach = leak + floor, NEAR
    expected = np.maximum(expected * _smoothed(seen / expected, table.known, reach), least)
    level = _weighted_mean((scatter / expected).reshape(-1, leak.shape[2]), table.known.reshape(-1, leak.shape[2]))
    return Noise(variance=np.maximum(expected * level, least), leakage=leak, share=share * level)


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
    return [m for m in range(most + 1) if abs(table.ambiguity(m)[0][0]) > np.sqrt(np.finfo(float).eps)]


def _covariances(table: ResponseLines, fit: ResponseFit, noise: Noise, offset: int) -> ComplexArray:
    """(n_inputs, n_lines - offset, n_outputs, n_outputs) of the responses to each input at lines l + offset and l.

    The errors of an input's responses are what the outputs hold beside the model, times the input, so their correlation
    over lines is that of the one times that of the other.
    """
    variance = noise.variance.transpose(2, 0, 1)
    n_inputs, n_lines, n_outputs = variance.shape
    own = range(n_lines - offset)
    if not table.leaks:
        size = np.sqrt(variance)
        common = 1.0 if table.lags is None else table.ambiguity(offset)[0][0]
        alone = (size[:, offset:, :, np.newaxis] * size[:, own, np.newaxis]) * np.eye(n_outputs)
        return np.asarray(common * alone, dtype=np.complex128)
    across = table.ambiguity(offset)[0][0]
    groups = [list(range(n_inputs))] if table.together else [[i] for i in range(n_inputs)]
    leaks = np.stack([_leakage(table, fit, group, offset) for group in groups]) * noise.share[:, np.newaxis, None, None]
    power = noise.leakage.transpose(2, 0, 1) * noise.share[:, np.newaxis, np.newaxis]
    rest = np.sqrt(np.maximum(variance - power, 0.0))
    both = leaks + across * (rest[:, offset:, :, np.newaxis] * rest[:, own, np.newaxis]) * np.eye(n_outputs)
    size = np.sqrt(variance / np.maximum(power + rest**2, TINY))
    scaled = both * (size[:, offset:, :, np.newaxis] * size[:, own, np.newaxis]) * across.conj()
    return np.asarray(scaled, dtype=np.complex128)


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
    colour = np.ones(n)
    if table.lags is not None and table.leaks:
        across = np.zeros(n)
        for m in _reach(table):
            across[[m, -m]] = abs(table.ambiguity(m)[0][0]) ** 2
        colour = np.sqrt(np.maximum(np.fft.fft(across).real, 0.0))
    shape = (n_inputs, n, n_outputs)
    white = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    lines = np.fft.fft(white * colour[:, np.newaxis], axis=1)[:, :n_lines] / np.sqrt(2 * n)
    drawn = vectors @ (np.sqrt(np.maximum(values, 0.0)) * lines)[..., np.newaxis]
    return np.where(table.known, drawn[..., 0].transpose(1, 2, 0), 0.0)


def pole_deviations(table: ResponseLines, fit: ResponseFit, noise: Noise) -> tuple[FloatArray, FloatArray]:
    """(n_poles,) standard deviations of frequency [Hz] and damping ratio, for the weights 1 / variance.

    M^-1 S M^-1 with M the curvature and S the covariance of the slope under errors that are correlated over outputs and
    over the lines that the window joins, and not alike in their real and imaginary parts.
    """
    slopes = fit.slopes.transpose(2, 1, 0, 3)  # inputs, lines, outputs, parameters
    flat = slopes.reshape(-1, slopes.shape[3])
    curvature = (flat.conj().T @ flat).real
    weight = np.where(table.known, 1 / np.sqrt(noise.variance), 0.0).transpose(2, 0, 1)
    spread = np.zeros_like(curvature)
    for offset in _reach(table):
        covariance = _covariances(table, fit, noise, offset)
        n_lines = covariance.shape[1]
        later = slopes[:, offset:] * weight[:, offset:, :, np.newaxis]
        here = covariance @ (slopes[:, :n_lines] * weight[:, :n_lines, :, np.newaxis])
        part = 0.5 * np.einsum("ilqa,ilqb->ab", later.conj(), here, optimize=True).real
        spread += part if offset == 0 else part + part.T
    if table.leaks:
        alone = 1.0 if table.together else np.eye(len(noise.share))
        share = np.sqrt(np.outer(noise.share, noise.share)) * alone
        power = noise.leakage * noise.share
        within = np.sqrt(noise.variance / np.maximum(noise.variance, power)).transpose(2, 0, 1)
        scaled = (slopes * (weight * within)[..., np.newaxis]).conj()
        for offset in range(1, min(FARTHEST, table.z.size - 1) + 1):
            later, here = _crossing(table, fit, offset)
            one = np.einsum("ilqa,lqj->lija", scaled[:, offset:], later, optimize=True) * share[..., np.newaxis]
            other = np.einsum("jlqb,lqi->lijb", scaled[:, : later.shape[0]], here, optimize=True)
            part = 0.5 * np.einsum("lija,lijb->ab", one, other, optimize=True).real
            spread += part + part.T
    inverse = np.linalg.pinv(curvature, hermitian=True)
    covariance = inverse @ spread @ inverse
    n_poles, pairs = fit.poles.size, np.flatnonzero(fit.is_pair)
    f_std, d_std = np.full(n_poles, np.nan), np.full(n_poles, np.nan)
    for r in range(n_poles):
        s = np.log(fit.poles[r])
        size = max(abs(s), TINY)
        rows = [r] + ([n_poles + int(np.searchsorted(pairs, r))] if fit.is_pair[r] else [])
        block = covariance[np.ix_(rows, rows)]
        radial = np.array([s.real, s.imag][: len(rows)]) / size
        f_std[r] = np.sqrt(max(0.0, radial @ block @ radial)) / (2 * np.pi * table.dt)
        # damping -a / |s|: its slope is -b^2 / |s|^3 by a and a b / |s|^3 by b
        bend = np.array([-(s.imag**2), s.real * s.imag][: len(rows)]) / size**3
        d_std[r] = np.sqrt(max(0.0, bend @ block @ bend))
    return f_std, d_std
