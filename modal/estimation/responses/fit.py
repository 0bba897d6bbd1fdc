"""Poles, shapes and participations fitted to frequency responses as they stand, seen through the window of the blocks.

The model of a table is the sum over poles of c b' g(lambda) + D, with g the transform of lambda^(k-1) r_w(k) over the
lags k = 1 ... n - 1 of a block (1 / (z - lambda) for blocks of whole periods): nothing is divided by the window. Shapes
and feedthrough are linear and leave by projection; poles and participations are found by Gauss-Newton steps
(Golub and Pereyra, SIAM J. Numerical Analysis 10(2), 1973, 413-432, doi 10.1137/0710036; in Kaufman's form).
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from era.realisation import Realisation
from modal.modes.modal_form import modal_basis
from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray
from okid.errors import InvalidDataError
from okid.frequency_response import (
    OVERLAP,
    FrequencyResponse,
    ResponseWindow,
    block_length,
    line_spacing,
    window_autocorrelation,
    window_samples,
)

LARGEST_SIZE = 0.999999
"""Keep poles within this size: a structure's answers end, and so do the sums over a state's past."""
MOST_STEPS = 15
"""Take at most so many steps: from a realisation of the same table a refinement stands still within some five."""
STANDS_STILL = 1e-7
"""Stop where a step lowers the squared error by a smaller share: far below what noise decides."""
INDEPENDENT = 1e-5
"""Ask the rank of columns of length 1 where one stands no further off the span of those before it: their Gram matrix
holds the square of that."""
MOST_DAMPING = 1e6
"""Stop where no step gains although it is as short as this many times the curvature makes it."""
LEAST_START = 1e-3
"""Start no pole with a shorter memory than a thousandth a step."""
MOST_BLOCKS = 32
"""Count so many blocks within the length of one: what closer ones add is the sum of these on a finer grid, a factor."""


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
        overlap: share of a block that the next one has as well.
        noise: (n_lines, n_outputs, n_inputs) (1 - coherence) / coherence, None where it is not known.
        trust: the same shape, coherence beyond that of noise alone, 1 where it is not known.
        together: whether all inputs acted at once.
        power: (n_inputs,) of the inputs, relative to each other; 1 where they did not act at once, or it is not known.
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
    overlap: float
    noise: FloatArray | None
    trust: FloatArray
    together: bool
    power: FloatArray
    output_scale: FloatArray
    input_scale: FloatArray

    @property
    def leaks(self) -> bool:
        """Whether blocks cut into answers that go on: a window over inputs that do not repeat."""
        return self.window not in {"periodic", "exponential"}

    def basis(self, poles: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(2, n_lines, n_poles) g of each pole, then of its conjugate; and its derivative by the pole's logarithm."""
        if self.lags is None:
            both = np.stack([poles, poles.conj()])[:, np.newaxis]
            g = 1 / (self.z[:, np.newaxis] - both)
            return g, both * g**2
        steps = np.r_[0.0, np.arange(self.lags.size - 1.0)]
        g, dg = self._both(poles, np.stack([self.lags, self.lags * steps])).transpose(1, 0, 3, 2)
        return g, dg

    def values_of(self, poles: ComplexArray) -> ComplexArray:
        """(2, n_lines, n_poles) g of each pole, then of its conjugate."""
        if self.lags is None:
            return self.basis(poles)[0]
        return np.asarray(self._both(poles, self.lags).transpose(0, 2, 1), dtype=np.complex128)

    def _both(self, poles: ComplexArray, lags: FloatArray) -> ComplexArray:
        """(2, ..., n_poles, n_lines) transforms of each pole's powers over lags, then of its conjugate's."""
        spectra = self._spectra(poles, lags)
        lines = self.first + np.arange(self.z.size)
        # real lags: the conjugate's spectrum is the pole's own, mirrored
        return np.stack([spectra[..., lines], spectra[..., -lines].conj()])

    def transformed(self, poles: ComplexArray, lags: tuple[ComplexArray, ComplexArray], shift: int) -> ComplexArray:
        """(n_lines, n_poles) sum over k >= 1 of lambda^(k-1) a(k - shift) z^(shift - k).

        Args:
            poles: (n_poles,) lambda.
            lags: a(v) and a(-v) for v = 0, 1, ..., as `ambiguity` gives them.
            shift: samples from one block to the other.
        """
        n = lags[0].size
        v = np.arange(1 - shift, n)
        values = _powers(poles, v.size) * np.where(v < 0, lags[1][np.abs(v)], lags[0][v])
        series = np.zeros((poles.size, n), dtype=np.complex128)
        series[:, v[v >= 0]] = values[:, v >= 0]
        series[:, v[v < 0]] += values[:, v < 0]  # at whole lines a block repeats itself
        return np.asarray(np.fft.fft(series)[:, self.first : self.first + self.z.size].T, dtype=np.complex128)

    @property
    def shifts(self) -> tuple[int, ...]:
        """Samples from a block to those that share samples with it, itself among them; of many, `MOST_BLOCKS` apart."""
        if self.lags is None or not self.leaks:
            return (0,)
        n = self.lags.size
        step = max(round(n * (1 - self.overlap)), -(-n // MOST_BLOCKS))
        return tuple(range(-((n - 1) // step) * step, n, step))

    @staticmethod
    def _spectra(poles: ComplexArray, lags: FloatArray) -> ComplexArray:
        """(..., n_poles, n_samples) transform of each pole's powers over lags (..., n_samples), at all of the grid."""
        n = lags.shape[-1]
        series = np.zeros((*lags.shape[:-1], poles.size, n), dtype=np.complex128)
        np.multiply(_powers(poles, n - 1), lags[..., np.newaxis, 1:], out=series[..., 1:])
        return np.asarray(np.fft.fft(series), dtype=np.complex128)

    def joined(self, offset: int) -> complex:
        """Correlation of the errors of lines so far apart, for errors that are white over time."""
        if self.lags is None:
            return 1.0 + 0j
        n = self.lags.size
        w = self._window()
        return complex(w**2 @ np.exp(-2j * np.pi * offset / n * np.arange(n)) / (w @ w))

    def joining(self) -> ComplexArray:
        """(n_samples,) correlation of the errors of a line with those of the lines so far before it, round the block.

        Of a response to hits it is that of what the sensors err by; to random forces that times the forces' own.
        """
        if self.lags is None:
            return np.ones(1, dtype=np.complex128)
        w = self._window()
        alike = np.fft.fft(w**2) / (w @ w)
        return np.asarray(np.abs(alike) ** 2 if self.leaks else alike, dtype=np.complex128)

    def _window(self) -> FloatArray:
        assert self.lags is not None
        if self.window == "exponential":
            return self.lags
        return window_samples(self.window, self.lags.size, None, self.dt)

    def ambiguity(self, offset: int) -> tuple[ComplexArray, ComplexArray]:
        """(n_samples,) sums of w(t) w(t - tau) exp(-2 pi j offset t / n) over sum w^2, for tau >= 0 and for -tau."""
        if self.lags is None:
            return np.ones(1, dtype=np.complex128), np.ones(1, dtype=np.complex128)
        n = self.lags.size
        w = self._window()
        turned = w * np.exp(-2j * np.pi * offset / n * np.arange(n))
        both = np.fft.ifft(np.fft.fft(turned, 2 * n) * np.fft.fft(w, 2 * n).conj()) / (w @ w)
        return both[:n], np.r_[both[:1], both[:n:-1]]


def _powers(poles: ComplexArray, n: int) -> ComplexArray:
    """(n_poles, n) 1, lambda, lambda^2, ..."""
    size = np.clip(np.abs(poles), TINY, 1 + 30 / (n + 1))  # so that a growing pole's power stays a number
    log = (np.log(size) + 1j * np.angle(poles))[:, np.newaxis]
    stride = int(np.ceil(np.sqrt(n + 1)))  # powers below it, times powers of it, are all powers
    few = np.arange(stride)
    powers = np.exp(log * stride * few)[..., np.newaxis] * np.exp(log * few)[:, np.newaxis]
    return np.asarray(powers.reshape(log.size, stride**2)[:, :n], dtype=np.complex128)


def lines_of(response: FrequencyResponse, window: ResponseWindow, finer: int = 1) -> tuple[ResponseLines, FloatArray]:
    """The table in channels of comparable size, and the lines (0 Hz to the last) that its pulse response is made of."""
    noise, trust, together = _noise(response)
    known = np.isfinite(response.response) & (trust > 0)
    values = np.where(known, response.response, 0.0)
    trusted = np.abs(values * trust) ** 2
    out = np.sqrt(_mean(trusted, known, (0, 2)))
    out = np.where(out > 0, out, 1.0)
    into = np.sqrt(_mean(trusted / out[:, np.newaxis] ** 2, known, (0, 1)))
    into = 1 / np.where(into > 0, into, 1.0)
    f = response.frequencies
    dt, lags, first, grid = 0.5 / float(f[-1]) / finer, None, 0, f
    if on_grid(response):
        first = round(float(f[0]) / line_spacing(response))
        n_samples, first = block_length(response, dt if first or finer > 1 else None)
        lags = None if window == "periodic" else window_autocorrelation(response, n_samples, window=window)
    else:  # the start comes from resampled lines, and the window cannot be known
        grid, window = np.linspace(0.0, f[-1], f.size)[np.linspace(0.0, f[-1], f.size) >= f[0]], "periodic"
    table = ResponseLines(
        values=np.asarray(values * into / out[:, np.newaxis], dtype=np.complex128),
        known=known,
        z=np.exp(2j * np.pi * f * dt),
        dt=dt,
        lags=lags,
        first=first,
        window=window,
        overlap=OVERLAP.get(window, 0.0) if response.overlap is None else response.overlap,
        noise=noise,
        trust=trust,
        together=together,
        power=np.ones(response.n_inputs),
        output_scale=out,
        input_scale=into,
    )
    return table, grid


def on_grid(response: FrequencyResponse) -> bool:
    """Whether the lines are those of blocks, so that their window has lags."""
    try:
        line_spacing(response)
    except InvalidDataError:
        return False
    return True


def _noise(response: FrequencyResponse) -> tuple[FloatArray | None, FloatArray, bool]:
    """(1 - coherence) / coherence of each value; its coherence beyond chance; whether all inputs acted at once.

    Beyond chance is nothing, 0, where noise alone has such a coherence in one of twenty lines: no input moved there.
    A coherence of 1 everywhere, as that of one average, or of nan tells nothing of the noise.
    """
    coherence, shape = response.coherence, response.response.shape
    if coherence is None or not (coherence < 1.0 - 1e-9).any():
        return None, np.ones(shape), False
    together = coherence.ndim == 2 and response.n_inputs > 1
    whole = coherence[:, :, np.newaxis] if coherence.ndim == 2 else coherence
    whole = np.broadcast_to(np.clip(np.where(np.isnan(whole), np.nanmedian(whole), whole), 1e-9, 1.0), shape)
    chance, n = (response.n_inputs if together else 1), response.n_averages  # of noise alone it is chance / n
    beyond = 1 - (1 - whole) * n / (n - chance) if n is not None and n > chance else whole
    if n is not None and n > chance:
        beyond = np.where(whole > scipy.special.betaincinv(chance, n - chance, 0.95), beyond, 0.0)
    return 1 / whole - 1, np.maximum(beyond, 0.0), together


def _mean(values: FloatArray, known: BoolArray, axis: tuple[int, int]) -> FloatArray:
    return np.asarray((values * known).sum(axis=axis) / np.maximum(1, known.sum(axis=axis)), dtype=np.float64)


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
        slopes: (n_outputs, 2, n_lines, n_inputs, n_parameters) weighted derivatives of the model's real and imaginary
            part, what shapes and feedthrough can do projected out: by the real part of the poles' logarithms and of the
            free participations, then by the imaginary part of those of pairs.
        inverse: (n_outputs, n_columns, n_columns) covariance of what is linear: real parts of an output's shapes,
            imaginary ones of pairs, feedthrough.
        answers: (n_outputs, n_columns, n_parameters) by how much that falls as each parameter grows.
    """

    poles: ComplexArray
    is_pair: BoolArray
    inputs: ComplexArray
    shapes: ComplexArray
    feedthrough: FloatArray
    error: float
    left: ComplexArray
    slopes: FloatArray
    inverse: FloatArray
    answers: FloatArray

    @property
    def order(self) -> int:
        """Number of states: one for a real pole, two for a pair."""
        return self.poles.size + int(self.is_pair.sum())

    @property
    def start(self) -> "Start":
        """What a refinement begins with."""
        return self.poles, self.is_pair, self.inputs

    @property
    def n_parameters(self) -> int:
        """Numbers that were fitted, linear ones included."""
        return int(self.slopes.shape[-1]) + self.order * len(self.shapes) + self.feedthrough.size

    def expanded(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Poles, participations and shapes with the conjugates of the pairs."""
        pair = self.is_pair
        return (
            np.r_[self.poles, self.poles[pair].conj()],
            np.vstack([self.inputs, self.inputs[pair].conj()]),
            np.hstack([self.shapes, self.shapes[:, pair].conj()]),
        )


Start = tuple[ComplexArray, BoolArray, ComplexArray]
"""Poles, which of them are pairs, and participations."""


def start_of(model: Realisation, dt: float) -> Start:
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
    (g, mirrored), (dg, d_mirrored) = table.basis(poles)
    mirrored, d_mirrored = mirrored * is_pair, d_mirrored * is_pair
    pairs, n_poles = np.flatnonzero(is_pair), poles.size
    columns = _columns(g, mirrored, is_pair, inputs)
    of_pole, of_input = _free(inputs)
    only = np.eye(n_inputs)[:, of_input]
    bend, turn = _parts(
        np.concatenate([dg[:, np.newaxis] * inputs.T, g[:, np.newaxis, of_pole] * only], axis=2),
        np.concatenate([d_mirrored[:, np.newaxis] * inputs.T.conj(), mirrored[:, np.newaxis, of_pole] * only], axis=2),
    )
    owner = np.r_[np.arange(n_poles), of_pole]
    turns = is_pair[owner]
    shapes = np.zeros((n_outputs, n_poles), dtype=np.complex128)
    feedthrough = np.zeros((n_outputs, n_inputs))
    left = np.zeros_like(table.values)
    slopes = np.empty((n_outputs, len(columns), owner.size + int(turns.sum())))
    inverse = np.empty((n_outputs, columns.shape[1], columns.shape[1]))
    answers = np.empty((n_outputs, columns.shape[1], slopes.shape[-1]))
    error = 0.0
    for q in range(n_outputs):
        w = np.tile(weight[:, q].ravel(), 2)
        wanted = _stacked(table.values[:, q, :, np.newaxis])[:, 0]
        basis, mixed = orthonormal(w[:, np.newaxis] * columns)
        found = mixed @ (basis.T @ (w * wanted))
        inverse[q] = mixed @ mixed.T
        c = found[:n_poles] + 0j
        c[pairs] += 1j * found[n_poles : n_poles + pairs.size]
        shapes[q], feedthrough[q] = c, found[n_poles + pairs.size :]
        rest = wanted - columns @ found
        error += float(np.square(w * rest).sum())
        half = (rest[: rest.size // 2] + 1j * rest[rest.size // 2 :]).reshape(n_lines, n_inputs)
        left[:, q] = np.where(table.known[:, q], half, 0.0)
        c = c[owner]
        slope = slopes[q]
        slope[:, : owner.size] = bend * c.real + turn * c.imag
        slope[:, owner.size :] = turn[:, turns] * c.real[turns] - bend[:, turns] * c.imag[turns]
        slope *= w[:, np.newaxis]
        within = basis.T @ slope
        answers[q] = mixed @ within
        slope -= basis @ within
    return ResponseFit(
        poles=poles,
        is_pair=is_pair,
        inputs=inputs,
        shapes=shapes,
        feedthrough=feedthrough,
        error=error,
        left=left,
        slopes=slopes.reshape(n_outputs, 2, n_lines, n_inputs, -1),
        inverse=inverse,
        answers=answers,
    )


def linear_columns(table: ResponseLines, fit: ResponseFit) -> FloatArray:
    """(2 n_lines n_inputs, n_columns) what an output's shapes and feedthrough multiply, as in `ResponseFit.inverse`."""
    g, mirrored = table.values_of(fit.poles)
    return _columns(g, mirrored * fit.is_pair, fit.is_pair, fit.inputs)


def participation_moved(fit: ResponseFit, pole: int, given: int) -> ComplexArray:
    """(n_parameters,) by which the participation of a pole in an input changes as each parameter of a fit grows."""
    n_poles, (of_pole, of_input) = fit.poles.size, _free(fit.inputs)
    turns = fit.is_pair[np.r_[np.arange(n_poles), of_pole]]
    moved = np.zeros(turns.size + int(turns.sum()), dtype=np.complex128)
    own = n_poles + np.flatnonzero((of_pole == pole) & (of_input == given))
    moved[own] = 1.0
    if fit.is_pair[pole]:
        moved[turns.size + np.searchsorted(np.flatnonzero(turns), own)] = 1j
    return moved


def _columns(g: ComplexArray, mirrored: ComplexArray, is_pair: BoolArray, inputs: ComplexArray) -> FloatArray:
    """What shapes multiply, their real parts and then the imaginary ones of pairs, and what the feedthrough does."""
    real_part, imag_part = _parts(g[:, np.newaxis] * inputs.T, mirrored[:, np.newaxis] * inputs.T.conj())
    direct = _stacked(np.tile(np.eye(inputs.shape[1]) + 0j, (len(g), 1, 1)))
    return np.hstack([real_part, imag_part[:, is_pair], direct])


def _free(inputs: ComplexArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pole and input of each participation that is free: all but the largest of each pole."""
    of_pole, of_input = np.nonzero(np.arange(inputs.shape[1]) != np.abs(inputs).argmax(axis=1)[:, np.newaxis])
    return of_pole, of_input


def _parts(plus: ComplexArray, minus: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """What the real and the imaginary part of a factor of `plus`, and its conjugate of `minus`, multiply; stacked."""
    return _stacked(plus + minus), _stacked(1j * (plus - minus))


def _stacked(values: ComplexArray) -> FloatArray:
    """(2 n_lines n_inputs, n_columns) real parts above imaginary parts."""
    flat = values.reshape(values.shape[0] * values.shape[1], values.shape[2])
    return np.concatenate([flat.real, flat.imag])


def orthonormal(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Orthonormal basis of what the columns span, and what makes it of them: basis = columns @ mixed.

    So the coefficients that fit what is wanted are mixed @ (basis.T @ wanted), and mixed @ mixed.T their covariance.

    By Cholesky factors of the Gram matrix, twice over, which is as orthonormal as Householder's and a third of the work
    (Yamamoto, Nakatsukasa, Yanagisawa, Fukaya, ETNA 44, 2015, 306-326); by singular values where columns nearly depend.
    """
    size = np.maximum(np.linalg.norm(columns, axis=0), TINY)
    basis, mixed = columns / size, np.diag(1 / size)
    for _ in range(2):
        lower = _cholesky(basis.T @ basis)
        if lower is None:
            left, values, right = np.linalg.svd(columns / size, full_matrices=False)
            kept = values > values.max(initial=0.0) * np.finfo(float).eps * len(size)
            return left[:, kept], right[kept].T / values[kept] / size[:, np.newaxis]
        step = np.linalg.inv(lower).T
        basis, mixed = basis @ step, mixed @ step
    return basis, mixed


def _cholesky(gram: FloatArray) -> FloatArray | None:
    """The lower factor, None where columns nearly depend."""
    try:
        lower = np.asarray(np.linalg.cholesky(gram), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return lower if np.diag(lower).min() > INDEPENDENT else None


def refined(
    table: ResponseLines,
    start: ResponseFit | Start,
    weight: FloatArray,
    *,
    n_steps: int = MOST_STEPS,
) -> ResponseFit:
    """Poles and participations after damped Gauss-Newton steps, as long as the squared error falls.

    The damping follows how much of the gain that a step promised came true (Nielsen, "Damping parameter in Marquardt's
    method", IMM-REP-1999-05, Technical University of Denmark).

    Args:
        table: to fit.
        start: where to begin.
        weight: as in `fit_at`.
        n_steps: at most so many.
    """
    first = start.start if isinstance(start, ResponseFit) else start
    best, damping, growth = fit_at(table, *first, weight), 1e-3, 2.0
    for _ in range(n_steps if best.poles.size else 0):
        flat = best.slopes.reshape(-1, best.slopes.shape[-1])
        wanted = (weight * best.left).transpose(1, 0, 2)
        curvature, slope = flat.T @ flat, flat.T @ np.stack([wanted.real, wanted.imag], axis=1).ravel()
        diagonal = np.maximum(np.diag(curvature), TINY)
        trial = best
        while damping < MOST_DAMPING:
            damped = curvature + np.diag(damping * diagonal)
            step = np.asarray(np.linalg.lstsq(damped, slope, rcond=None)[0], dtype=np.float64)
            trial = fit_at(table, *_moved(best, step), weight)
            if trial.error < best.error:
                promised = float(step @ (slope + damping * diagonal * step))
                damping *= max(1 / 3, 1 - (2 * (best.error - trial.error) / max(promised, TINY) - 1) ** 3)
                growth = 2.0
                break
            damping, growth = damping * growth, 2 * growth
        gained = best.error - trial.error
        if gained <= 0:
            break
        best = trial
        if gained <= STANDS_STILL * best.error:
            break
    return best


def _moved(fit: ResponseFit, step: FloatArray) -> Start:
    n_poles, (of_pole, of_input) = fit.poles.size, _free(fit.inputs)
    turns = fit.is_pair[np.r_[np.arange(n_poles), of_pole]]
    change = step[: turns.size] + 0j
    change[turns] += 1j * step[turns.size :]
    poles = fit.poles * np.exp(np.clip(change[:n_poles].real, -1, 1) + 1j * np.clip(change[:n_poles].imag, -1, 1))
    poles = poles * np.minimum(1.0, LARGEST_SIZE / np.maximum(np.abs(poles), TINY))
    # a pair that crosses the axis is its own mirror image
    crossed = fit.is_pair & (poles.imag < 0)
    inputs = fit.inputs.copy()
    inputs[of_pole, of_input] += change[n_poles:]
    poles[crossed], inputs[crossed] = poles[crossed].conj(), inputs[crossed].conj()
    return poles, fit.is_pair, _unit(inputs, fit.is_pair)


def realised(fit: ResponseFit, table: ResponseLines) -> Realisation:
    """The model in the units of the responses, with one state for a real pole and two for a pair."""
    order = fit.order
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


def losses(fit: ResponseFit) -> FloatArray:
    """(n_poles,) by about how much the squared error would grow without each pole, everything else fitted again.

    Wald's statistic of its shapes, with the other poles free to move: of two poles that share one resonance, either may
    go, because the other one can take its part.
    """
    n_poles, pairs = fit.poles.size, np.flatnonzero(fit.is_pair)
    flat = fit.slopes.reshape(-1, fit.slopes.shape[-1])
    curvature = flat.T @ flat
    of_pole = _free(fit.inputs)[0]
    owner = np.r_[np.arange(n_poles), of_pole]
    owner = np.r_[owner, owner[fit.is_pair[owner]]]
    found = np.zeros(n_poles)
    for r in range(n_poles):
        others = np.flatnonzero(owner != r)
        own = [r, n_poles + int(np.searchsorted(pairs, r))] if fit.is_pair[r] else [r]
        parts = np.stack([fit.shapes[:, r].real, fit.shapes[:, r].imag], axis=1)[:, : len(own)]
        means = np.linalg.pinv(fit.inverse[:, own][:, :, own], hermitian=True)
        with_others = fit.answers[:, own][:, :, others]
        found[r] = np.einsum("qa,qab,qb->", parts, means, parts)
        pull = np.einsum("qau,qab,qb->u", with_others, means, parts)
        give = curvature[np.ix_(others, others)] + np.einsum("qau,qab,qbv->uv", with_others, means, with_others)
        if others.size:
            size = np.sqrt(np.maximum(np.diag(give), TINY))
            found[r] -= (pull / size) @ np.linalg.pinv(give / np.outer(size, size), hermitian=True) @ (pull / size)
    return np.maximum(found, 0.0)


def without_pole(table: ResponseLines, fit: ResponseFit, pole: int, weight: FloatArray, *, n_steps: int) -> ResponseFit:
    """The fit without a pole, the others refined."""
    kept = np.arange(fit.poles.size) != pole
    return refined(table, (fit.poles[kept], fit.is_pair[kept], fit.inputs[kept]), weight, n_steps=n_steps)
