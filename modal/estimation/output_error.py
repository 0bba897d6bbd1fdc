"""Output-error refinement in modal form: damped Gauss-Newton on the free run's error, stable by construction.

The model's free run, y = sum of Re(c_i x_i) + D u + level, is linear in the shapes c, in D and in the levels, which are
projected out (variable projection, Kaufman's form), and nonlinear in poles, participations b and initial states. A
complex pole is lambda = exp(-exp(a) + j theta), so no step can leave the unit circle. With s = r + j t a sensitivity of
state i (`modal.estimation.modal_states`) and its shape c = a + j d, the real part of a parameter moves the outputs by
Re(c s) = a r - d t, the imaginary part by -Im(c s) = -d r - a t, and their products are, with
P = I - Phi (Phi' Phi)^-1 Phi',

    J'J = (a_i' W a_j) (r_i' P r_j) - (a_i' W d_j) (r_i' P t_j) - (d_i' W a_j) (t_i' P r_j) + (d_i' W d_j) (t_i' P t_j)

for two real parts and likewise for others, so that one Gram matrix of states and sensitivities gives shapes, gradient
and J'J; no Jacobian is formed. The scale that b and c share is fixed by leaving the largest entry of each b alone.
Outputs that were measured in other rows than others have sums of their own, and all of these add up.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy

from modal.estimation.free_run import moving_inputs
from modal.estimation.modal_states import NONE, Block, ModalParameters, SignalLayout
from modal.estimation.signal_sums import signal_grams_over
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record

FIRST_DAMPING = 1e-3
LARGEST_DAMPING = 1e6
SMALLEST_GAIN = 1e-9
"""Relative decrease of the error below which another step is not worth its cost."""
GROWS_AFTER, GROWS_ON = 8, 1e-3
"""Let a model that is to grow do so after so many steps, or once one decreases its error by a smaller share: what is
added moves the others again."""
LARGEST_STEP = 0.7
"""Of the logarithm of a decay rate, and of an angle relative to itself or to what is left to half the sampling rate."""
LEAST_DECAY = 1e-10
"""Decay per sample of a pole on the edge of the unit circle."""
MOST_DECAY = 25.0
"""Decay per sample of a pole that is over at once."""
BEYOND_THE_ENDS = 64
"""Continue an input by so many samples beyond the ends of its record: what it does there matters within a few."""
ROUND_OFF = 1e-13
"""Relative size of directions of the regressors that are rounding error."""
LEAST_CURVATURE = 1e-12
"""Relative curvature below which a direction of the parameters is not in the data."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OutputError:
    """Scaled records, which of their rows count, and in which blocks their sums are kept.

    Attributes:
        records: channels of unit size, without NaN.
        rows: (n_samples,) a record, True where all channels were measured.
        blocks: all rows, with the fold that holds each block out.
        n_direct: the first so many inputs act on the outputs at once; None for all of them.
        measured: (n_samples, n_outputs) a record, False where an output was not measured in a row that counts; none
            where there is no such row. Weights between outputs that are not measured together count for nothing.
        elsewhere: squared weight of samples that are not `measured`: 0 where nobody measured them.

    An input that stands still throughout a record and moves in another makes a level and a start, which each record has
    of its own, so it is set to zero there.
    """

    records: tuple[Record, ...]
    rows: tuple[BoolArray, ...]
    blocks: tuple[Block, ...]
    n_direct: int | None = None
    measured: tuple[BoolArray, ...] = ()
    elsewhere: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "records", moving_inputs(self.records))

    @property
    def counted(self) -> tuple[BoolArray, ...]:
        """(n_samples, n_outputs) a record, True where a sample counts."""
        if self.measured:
            return tuple(rows[:, np.newaxis] & own for rows, own in zip(self.rows, self.measured, strict=True))
        shapes = [record.outputs.shape for record in self.records]
        return tuple(np.broadcast_to(rows[:, np.newaxis], size) for rows, size in zip(self.rows, shapes, strict=True))

    @property
    def shares(self) -> tuple[FloatArray, ...]:
        """(n_samples, n_outputs) a record: squared weight of a sample, 0 where one of the row's channels is missing."""
        return tuple(
            np.where(there, 1.0, np.where(rows[:, np.newaxis], self.elsewhere, 0.0))
            for rows, there in zip(self.rows, self.counted, strict=True)
        )

    @property
    def together(self) -> tuple[tuple[int, ...], ...]:
        """Outputs that are measured in the same rows."""
        groups: dict[bytes, list[int]] = {}
        for i in range(self.records[0].n_outputs):
            groups.setdefault(b"".join(np.packbits(own[:, i]).tobytes() for own in self.measured), []).append(i)
        return tuple(map(tuple, groups.values()))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LinearPart:
    """What is linear in the outputs, by least squares on the training rows.

    Attributes:
        coefficients: (n_regressors, n_outputs) on real and imaginary parts of the states, inputs and levels.
        shapes: (n_outputs, n_poles) c, so that mode i gives Re(c_i x_i).
        error_products: (n_outputs, n_outputs) E'E of the errors on the training rows; zero between outputs that are not
            measured together.
    """

    coefficients: FloatArray
    shapes: ComplexArray
    error_products: FloatArray

    @property
    def squared_errors(self) -> FloatArray:
        """(n_outputs,) of each output."""
        return np.maximum(np.diag(self.error_products), 0.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sums:
    """What the training rows hold in which some outputs were measured together.

    Attributes:
        outputs: which.
        gram: (size, size) products of all signals.
        inverse_factor: (n_kept, n_regressors) W with W'W = (Phi' Phi)^-1 on the directions kept.
        parts: (n_held_out, n, n) of the own regressors and outputs of each block held out, over all rows that count.
    """

    outputs: tuple[int, ...]
    gram: FloatArray
    inverse_factor: FloatArray
    parts: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Normal:
    """Normal equations of one step in the free real parameters.

    Attributes:
        matrix: (n_free, n_free) J'J.
        gradient: (n_free,) J'e.
    """

    matrix: FloatArray
    gradient: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RefinementStep:
    """The model after one accepted step.

    Attributes:
        parameters: nonlinear ones.
        linear: linear ones, from the training rows.
        layout: of all signals.
        apart: blocks that are held out, of which the products are kept.
        sums: over the training rows, of outputs that are measured together.
        error: weighted sum of squares over the training rows.
    """

    parameters: ModalParameters
    linear: LinearPart
    layout: SignalLayout
    apart: tuple[Block, ...]
    sums: tuple[Sums, ...]
    error: float

    @property
    def order(self) -> int:
        """Number of real states: two for a pair."""
        return int(np.where(self.parameters.is_pair, 2, 1).sum())

    def block_errors(self) -> FloatArray:
        """(n_held_out, n_outputs) squared error of the model on the blocks that are held out."""
        phi, coefficients = self.layout.alone.regressors, self.linear.coefficients
        errors = np.empty((len(self.apart), self.layout.n_outputs))
        for one in self.sums:
            seen = list(one.outputs)
            out = [phi.stop + i for i in seen]
            for k, (block, gram) in enumerate(zip(self.apart, one.parts, strict=True)):
                theta = coefficients[self.layout.places(block.record)[phi]][:, seen]
                cross = gram[phi][:, out]
                errors[k, seen] = gram[out, out] - (theta * (2.0 * cross - gram[phi, phi] @ theta)).sum(axis=0)
        return np.maximum(errors, 0.0)


def refine(
    start: RefinementStep,
    data: OutputError,
    *,
    held_out: int = NONE,
    n_steps: int,
    least_gain: float = SMALLEST_GAIN,
    weights: FloatArray | None = None,
    coordinates: "Coordinates | None" = None,
    progress: Callable[[float], None] = lambda _share: None,
) -> list[RefinementStep]:
    """Models after 0, 1, ... at most `n_steps` accepted Levenberg-Marquardt steps.

    Args:
        start: the model to refine, from `step_at`.
        data: what is fitted.
        held_out: blocks with this label do not count.
        n_steps: most steps.
        least_gain: relative decrease of the error by a step below which it is the last.
        weights: (n_outputs, n_outputs) W of the squared error e'We; the unit matrix unless given.
        coordinates: that steps are made in; poles and participations unless given.
        progress: called with the share of the most steps that is behind, before each that is tried.

    References:
        Golub, Pereyra, SIAM Journal on Numerical Analysis 10(2), 1973, 413-432, doi 10.1137/0710036 (variable
        projection); Kaufman, BIT 15, 1975, 49-57, doi 10.1007/BF01932995; Marquardt, Journal of the Society for
        Industrial and Applied Mathematics 11(2), 1963, 431-441, doi 10.1137/0111030.
    """
    weights = np.eye(data.records[0].n_outputs) if weights is None else weights
    coordinates = PolesAndParticipations() if coordinates is None else coordinates
    current = replace(start, error=float((weights * start.linear.error_products).sum()))
    done = [current]
    damping, growth = FIRST_DAMPING, 2.0
    while len(done) <= n_steps and damping < LARGEST_DAMPING:
        normal = step_equations(current, weights=weights, coordinates=coordinates)
        diagonal = np.maximum(np.diag(normal.matrix), 0.0)
        if not diagonal.any():  # what steps change is rounding
            break
        while damping < LARGEST_DAMPING:
            progress((len(done) - 1) / n_steps)
            size = diagonal + ROUND_OFF * diagonal.max(initial=0.0) + np.finfo(np.float64).tiny
            step = _solve(normal.matrix, normal.gradient, damping * size)
            predicted = float(step @ (normal.gradient + damping * size * step))
            there, gain = coordinates.moved(current.parameters, step), 0.0
            if there is not None:
                trial = step_at(there, data, held_out=held_out, weights=weights)
                gain = current.error - trial.error
            if predicted > 0.0 and gain > 0.0:
                damping *= max(1.0 / 5.0, 1.0 - (2.0 * gain / predicted - 1.0) ** 3)
                growth = 2.0
                break
            damping, growth = damping * growth, 2.0 * growth
            if predicted <= least_gain * current.error:
                return done
        else:
            return done
        small = gain <= least_gain * current.error
        current = trial
        done.append(current)
        if small:
            break
    return done


def step_at(
    parameters: ModalParameters, data: OutputError, *, held_out: int = NONE, weights: FloatArray | None = None
) -> RefinementStep:
    """Run the model through the records and solve for its linear part."""
    weights = np.eye(data.records[0].n_outputs) if weights is None else weights
    n_direct = data.records[0].n_inputs if data.n_direct is None else data.n_direct
    together = data.together
    choices: list[Sequence[BoolArray]] = [data.rows]
    fewer: list[bool] = []
    for outputs in together if data.measured else ():  # over the fewer rows, those in which they were measured or not
        own = [counted[:, outputs[0]] for counted in data.counted]
        others = [rows & ~there for rows, there in zip(data.rows, own, strict=True)]
        fewer.append(sum(map(np.count_nonzero, others)) <= sum(map(np.count_nonzero, own)))
        choices.append(others if fewer[-1] else own)
    layout, (every, *found) = signal_grams_over(
        parameters, data.records, choices, data.blocks, n_direct=n_direct, held_out=held_out
    )
    if data.measured:
        shares = [(1.0, data.elsewhere - 1.0) if less else (data.elsewhere, 1.0 - data.elsewhere) for less in fewer]
        found = [
            (of_all * every[0] + own * one[0], of_all * every[1] + own * one[1])
            for one, (of_all, own) in zip(found, shares, strict=True)
        ]
    sums = [
        Sums(outputs=outputs, gram=gram, inverse_factor=_inverse_factor(gram[phi, phi]), parts=parts)
        for phi in (layout.regressors,)
        for outputs, (gram, parts) in zip(together, found or [every], strict=True)
    ]
    linear = linear_part(layout, sums)
    return RefinementStep(
        parameters=parameters,
        linear=linear,
        layout=layout,
        apart=tuple(block for block in data.blocks if block.label == held_out),
        sums=tuple(sums),
        error=float((weights * linear.error_products).sum()),
    )


def linear_part(layout: SignalLayout, sums: Sequence[Sums]) -> LinearPart:
    """Shapes, feedthrough and levels by least squares; directions that the rows do not show are left at zero."""
    n, n_outputs = layout.n_poles, layout.n_outputs
    coefficients, products = np.zeros((layout.n_regressors, n_outputs)), np.zeros((n_outputs, n_outputs))
    for one in sums:
        own, out = np.array(one.outputs), layout.outputs.start + np.array(one.outputs)
        projected = one.inverse_factor @ one.gram[layout.regressors, out]
        coefficients[:, own] = one.inverse_factor.T @ projected
        products[np.ix_(own, own)] = one.gram[np.ix_(out, out)] - projected.T @ projected
    return LinearPart(
        coefficients=coefficients,
        shapes=(coefficients[:n] - 1j * coefficients[n : 2 * n]).T,
        error_products=products,
    )


def _inverse_factor(own: FloatArray) -> FloatArray:
    """(n_kept, n) W with W'W the inverse of (n, n) products, on the directions that are no rounding."""
    size = np.sqrt(np.diag(own))
    size = np.where(size > 0.0, size, 1.0)
    scaled = own / np.outer(size, size)
    factor, info = scipy.linalg.lapack.dpotrf(scaled, lower=1)
    if info == 0 and np.diag(factor).min() ** 2 >= ROUND_OFF:
        return np.asarray(scipy.linalg.solve_triangular(factor, np.diag(1.0 / size), lower=True, check_finite=False))
    values, vectors = np.linalg.eigh(scaled)
    kept = values > ROUND_OFF * max(1.0, values[-1])
    return np.asarray((vectors[:, kept] / np.sqrt(values[kept])).T / size)


def step_equations(step: RefinementStep, *, weights: FloatArray, coordinates: "Coordinates | None" = None) -> Normal:
    """J'WJ and J'We in the free parameters, the linear part projected out."""
    coordinates = PolesAndParticipations() if coordinates is None else coordinates
    layout, linear = step.layout, step.linear
    n, poles, phi = layout.n_sensitivities, layout.n_poles, layout.regressors
    both, families = slice(layout.real.start, layout.imaginary.stop), n // max(1, poles)
    matrix = np.zeros((2, families, poles, 2, families, poles))
    slope = np.zeros(n, dtype=np.complex128)
    for one in step.sums:
        gram, seen = one.gram, list(one.outputs)
        projected = one.inverse_factor @ gram[phi, both]
        own = projected.T @ projected
        np.subtract(gram[both, both], own, out=own)
        out = [layout.outputs.start + i for i in seen]
        residual = gram[both][:, out] - gram[both, phi] @ linear.coefficients[:, seen]
        shapes, W = linear.shapes[seen], weights[np.ix_(seen, seen)]
        _add_weighted(matrix, own.reshape(matrix.shape), shapes, W)
        slope += ((W @ shapes)[:, layout.owners].T * (residual[:n] + 1j * residual[n:])).sum(axis=1)
    matrix, gradient = coordinates.taken(
        step.parameters, matrix.reshape(2 * n, 2 * n), np.concatenate([slope.real, -slope.imag])
    )
    return Normal(matrix=0.5 * (matrix + matrix.T), gradient=gradient)


def _add_weighted(total: FloatArray, products: FloatArray, shapes: ComplexArray, weights: FloatArray) -> None:
    """Add J'WJ from the products of sensitivities: each (2, n_families, n_poles) twice, real and imaginary parts.

    A parameter moves the outputs by its own two of (2, 2, n_outputs, n_poles) shapes times the parts of a sensitivity.
    """
    a, d = shapes.real, shapes.imag
    moved = np.array([[a, -d], [-d, -a]])  # [of the parameter, of the sensitivity]
    weighted = np.einsum("kpon,om,lqmi->kplqni", moved, weights, moved, optimize=True)
    for f in range(total.shape[1]):  # a family at a time stays in cache
        for k, j, p, q in np.ndindex(2, 2, 2, 2):
            total[k, f, :, j] += weighted[k, p, j, q][:, np.newaxis] * products[p, f, :, q]


def outputs_of(step: RefinementStep, real: FloatArray, imaginary: FloatArray) -> FloatArray:
    """(n_free, ..., n_outputs) real part of shape times sensitivity, each parameter's change of the outputs.

    Args:
        step: the model.
        real: (n_sensitivities, ...) products with the sensitivities' real parts; last axis n_outputs or 1.
        imaginary: the same with the imaginary parts.
    """
    c = step.linear.shapes.T[step.layout.owners]
    c = c.reshape(c.shape[0], *([1] * (real.ndim - 2)), c.shape[1])
    raw = np.concatenate([c.real * real - c.imag * imaginary, -c.imag * real - c.real * imaginary])
    products: FloatArray = np.tensordot(PolesAndParticipations().slopes(step.parameters).T, raw, axes=1)
    return products


def slopes_of(step: RefinementStep) -> FloatArray:
    """(n_free, n_regressors, n_outputs) T: a change of the parameters changes the coefficients by -T of it."""
    layout, phi = step.layout, step.layout.regressors
    real, imaginary = np.empty((2, layout.n_sensitivities, layout.n_regressors, layout.n_outputs))
    for one in step.sums:
        inverse = one.inverse_factor.T @ one.inverse_factor
        seen = list(one.outputs)
        real[:, :, seen] = (one.gram[layout.real, phi] @ inverse)[:, :, np.newaxis]
        imaginary[:, :, seen] = (one.gram[layout.imaginary, phi] @ inverse)[:, :, np.newaxis]
    return outputs_of(step, real, imaginary)


def scores_of(step: RefinementStep, slopes: FloatArray, products: FloatArray) -> FloatArray:
    """(n, n_free) gradient of each of (n, size, n_outputs) weighted products, the linear part projected out."""
    layout = step.layout
    each = products.swapaxes(0, 1)
    direct = outputs_of(step, each[layout.real], each[layout.imaginary])
    left = np.einsum("tno,nso->tso", slopes, each[layout.regressors])
    return np.asarray((direct - left).sum(axis=2).T)


@dataclass(frozen=True, slots=True, eq=False)
class Span:
    """What all parameters of a model explain, in orthonormal coordinates: the linear part first, then the others.

    Attributes:
        step: the model.
        weights: (n_outputs,) W of the squared errors.
        root: (n_free, n_kept) of the inverse of the curvature of poles, participations and initial states.
        slopes: of the linear part by these.
        pull: (n_kept,) coordinates of the errors; the linear part's are zero.
    """

    step: RefinementStep
    weights: FloatArray
    root: FloatArray
    slopes: FloatArray
    pull: FloatArray

    @classmethod
    def of(cls, step: RefinementStep, weights: FloatArray) -> "Span":
        """At a model, of errors with these (n_outputs,) weights."""
        normal = step_equations(step, weights=np.diag(weights))
        root = inverse_root(normal.matrix)
        return cls(step, weights, root, slopes_of(step), root.T @ normal.gradient)

    @property
    def n_linear(self) -> int:
        """Coordinates of the linear part."""
        return sum(len(one.inverse_factor) * len(one.outputs) for one in self.step.sums)

    def coordinates(self, products: FloatArray) -> FloatArray:
        """(n, n_linear + n_kept) of n motions by their (n, size, n_outputs) products with all signals."""
        phi = self.step.layout.regressors
        linear = [
            np.einsum("fr,nro->nfo", one.inverse_factor, products[:, phi][:, :, list(one.outputs)])
            * np.sqrt(self.weights[list(one.outputs)])
            for one in self.step.sums
        ]
        others = scores_of(self.step, self.slopes, products * self.weights) @ self.root
        return np.hstack([*(one.reshape(len(one), one.shape[1] * one.shape[2]) for one in linear), others])


def inverse_root(matrix: FloatArray) -> FloatArray:
    """(n, n_kept) R with R R' the pseudo-inverse of a curvature, after scaling to a unit diagonal.

    A direction that the data do not show is left at rest.
    """
    size = sizes_of(matrix)
    scaled = matrix / np.outer(size, size)
    factor, info = scipy.linalg.lapack.dpotrf(scaled, lower=1)
    if info == 0:
        root = scipy.linalg.solve_triangular(factor, np.diag(1.0 / size), lower=True, check_finite=False).T
        # the trace of the inverse bounds its largest eigenvalue: where that is this small every direction is kept
        if np.square(root * size[:, np.newaxis]).sum() * LEAST_CURVATURE < 1.0:
            return np.asarray(root)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > LEAST_CURVATURE
    return np.asarray(vectors[:, kept] / np.sqrt(values[kept]) / size[:, np.newaxis])


def sizes_of(matrix: FloatArray) -> FloatArray:
    """(n,) roots of the diagonal, one where there is nothing."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    return np.where(size > 0.0, size, 1.0)


def without_what_moves_between_samples(step: RefinementStep, data: OutputError) -> OutputError:
    """The data without the part of the outputs that no sum of poles can make of samples of a band-limited input.

    A pole s answers such an input with R / (j w - s), in the model with R lambda / (e^(j w) - lambda), time in samples.
    The two agree at the pole, and differ elsewhere by R K(j w - s),

        K(x) = 1 / x - 1 / (e^x - 1) = 1/2 - x / 12 + x^3 / 720 - ...    for |x| < 2 pi,

    which is smooth, not causal, and known once the model is. Left in the outputs, residues make up for it: by a
    thousandth of themselves at a quarter of the sampling rate. Feedthrough makes the rest of what it has in common with
    the inputs. A pole above half the sampling rate stands in for something else and is left alone.

    Args:
        step: a model of the data.
        data: with inputs that moved between their samples.

    References:
        Abramowitz, Stegun, Handbook of Mathematical Functions, 1964, 23.1.1 (the numbers of Bernoulli in the series).
    """
    parameters = step.parameters
    poles = np.log(parameters.poles)
    resonant = (np.abs(poles) < np.pi) & (np.angle(parameters.poles) < np.pi)
    b, c, poles = parameters.inputs[resonant], step.linear.shapes[:, resonant], poles[resonant]
    made = []
    for record in data.records:
        n = record.n_samples
        beyond = min(BEYOND_THE_ENDS, n - 1)
        inputs = np.pad(record.inputs, ((beyond, beyond), (0, 0)), mode="reflect", reflect_type="odd")
        length = scipy.fft.next_fast_len(len(inputs), real=True)
        spectrum = np.fft.rfft(inputs, length, axis=0)
        angles = 2j * np.pi * np.fft.rfftfreq(length)
        answer = np.zeros((len(angles), c.shape[0]), dtype=np.complex128)
        for pole, row, shape in zip(poles, b / np.exp(poles)[:, np.newaxis], c.T, strict=True):
            for at, acting, seen in ((pole, row, shape), (pole.conj(), row.conj(), shape.conj())):
                x = angles - at
                answer += 0.5 * ((1.0 / x - 1.0 / np.expm1(x)) * (spectrum @ acting))[:, np.newaxis] * seen
        made.append(np.fft.irfft(answer, length, axis=0)[beyond : beyond + n])
    counted = np.concatenate(data.rows)
    known = np.vstack([record.inputs for record in data.records])[counted]
    direct = np.linalg.lstsq(known, np.vstack(made)[counted], rcond=None)[0]
    records = tuple(
        replace(record, outputs=record.outputs - own + record.inputs @ direct)
        for record, own in zip(data.records, made, strict=True)
    )
    return replace(data, records=records)


class Coordinates(Protocol):
    """What a step moves: a chart of the models around one of them."""

    def slopes(self, parameters: ModalParameters) -> FloatArray:
        """(2 n_sensitivities, n_free) change of real, imaginary parts of ln(poles), inputs and states by each one."""
        ...

    def taken(
        self, parameters: ModalParameters, matrix: FloatArray, gradient: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """T'MT and T'g with T the slopes."""
        ...

    def moved(self, parameters: ModalParameters, change: FloatArray) -> ModalParameters | None:
        """The parameters after a change; None where no model is there."""
        ...


@dataclass(frozen=True, slots=True)
class PolesAndParticipations:
    """Logarithms of decays, angles, participations, initial states: no step leaves the unit circle."""

    def slopes(self, parameters: ModalParameters) -> FloatArray:
        """See `Coordinates`: one entry a column, the pole's own one scaled."""
        free, scale = self._free(parameters)
        matrix = np.zeros((scale.size, free.size))
        matrix[free, np.arange(free.size)] = scale[free]
        return matrix

    def taken(
        self, parameters: ModalParameters, matrix: FloatArray, gradient: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Coordinates`."""
        free, scale = self._free(parameters)
        return (matrix * np.outer(scale, scale))[np.ix_(free, free)], (scale * gradient)[free]

    def moved(self, parameters: ModalParameters, change: FloatArray) -> ModalParameters:
        """See `Coordinates`: poles kept inside the unit circle and off the real axis."""
        old = parameters
        free, scale = self._free(old)
        whole = np.zeros(scale.size)
        whole[free] = change
        real, imaginary = whole.reshape(2, -1, old.poles.size)
        decay = np.log(np.maximum(-np.log(np.abs(old.poles)), LEAST_DECAY))
        decay += np.clip(real[0], -LARGEST_STEP, LARGEST_STEP)
        angle = np.abs(np.angle(old.poles))
        room = np.minimum(angle, np.pi - angle)
        angle = angle + np.clip(imaginary[0], -LARGEST_STEP * room, LARGEST_STEP * room)
        size = np.exp(-np.clip(np.exp(decay), LEAST_DECAY, MOST_DECAY))
        poles = np.where(old.is_pair, size * np.exp(1j * angle), size * np.sign(old.poles.real))
        others = real[1:] + 1j * imaginary[1:]
        n_inputs = old.inputs.shape[1]
        return ModalParameters(
            poles=poles,
            is_pair=old.is_pair,
            inputs=old.inputs + others[:n_inputs].T,
            states=old.states + others[n_inputs:],
        )

    @staticmethod
    def _free(parameters: ModalParameters) -> tuple[np.ndarray, FloatArray]:
        """Which of all entries are parameters, none twice, none of no effect, and the scale of each entry."""
        n_poles, n_inputs = parameters.inputs.shape
        moves = np.ones((1 + n_inputs + parameters.states.shape[0], n_poles), dtype=np.bool_)
        moves[1 + n_inputs :][~parameters.states.any(axis=1)] = False
        moves[1 + np.abs(parameters.inputs).argmax(axis=1), np.arange(n_poles)] = False
        free = np.flatnonzero(np.concatenate([moves.ravel(), (moves & parameters.is_pair).ravel()]))
        # the first parameter of a pole is the logarithm of its decay, not the decay itself
        scale = np.ones(2 * moves.size)
        scale[:n_poles] = np.log(np.abs(parameters.poles))
        return free, scale


def _solve(matrix: FloatArray, right: FloatArray, damping: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 0.0) + damping)
    damped = matrix * scale
    damped *= scale[:, np.newaxis]
    np.einsum("ii->i", damped)[:] += damping * scale**2
    # LAPACK itself: where two poles nearly coincide `scipy.linalg.solve` warns of what the damping is there for
    _, solution, info = scipy.linalg.lapack.dposv(damped.T, scale * right)  # symmetric, and columns come first there
    if info:
        solution = np.linalg.lstsq(damped, scale * right, rcond=1e-12)[0]
    result: FloatArray = scale * solution
    return result
