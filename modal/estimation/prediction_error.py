"""The innovation form, fitted by the engine of output error: one likelihood for a system and for the noise upon it.

    x(k+1) = A x(k) + B u(k) + K e(k),   y(k) = C x(k) + D u(k) + e(k),   e white with covariance R

Its one-step predictor x(k+1) = (A - K C) x + (B - K D) u + K y is a free run with the inputs [u, y], no direct part
for y, and white errors: what `modal.estimation.output_error` fits. K = 0 is output error itself. With the errors
weighted by R^-1, and R taken from them in turn, the fit is the likeliest: -2 ln L = N ln det R + constant.

Poles of a predictor are often real and meet on the axis, so steps are made in sections of two states,

    x+ = [[m, d], [1, m]] x + [b1, b2]' z,   poles m +- sqrt(d),

which are smooth where two real poles become a pair.

References:
    Ljung, System Identification: Theory for the User, 2nd edition, 1999, sections 4.3 (innovations form), 7.2
    (prediction errors), 9.4 (asymptotic covariance); Schwarz, Annals of Statistics 6(2), 1978, 461-464,
    doi 10.1214/aos/1176344136 (criterion).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from era.realisation import Realisation
from modal.estimation.free_run import driven_by_outputs, one_step_predictor
from modal.estimation.modal_parameters import real_modal_form, starting_parameters
from modal.estimation.modal_states import ModalParameters, blocks_of
from modal.estimation.output_error import Coordinates, OutputError, RefinementStep, refine, step_equations
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.errors import InsufficientDataError
from okid.gram import LagGram, lag_gram
from okid.record import Record
from okid.scaling import ROUNDING, ChannelScaling, channel_scaling

ROUNDS = 8
"""End after so many rounds in which weights and model settle."""
STEPS_A_ROUND = 12
"""Make at most so many steps with the same weights."""
STILL = 0.01
"""End where a step lets -2 ln L fall by less: a tenth of a standard deviation in whatever direction; or a round by less
for each number that is fitted: a tenth in the mean over all directions."""
SMALLEST_NOISE = 1e-3
"""Weight no combination of outputs as if it had less than this share of the noisiest output's noise."""
NOISE_FREE = 1e-7
"""Stop where the errors are smaller than this, relative to the outputs: they are rounding, and have no covariance."""
SHORTEST_PAST = 4
"""Try so many samples of the outputs' past first, then twice as many as long as a regression on them gains."""
ROWS_A_NUMBER = 10
"""Fit no more numbers than a tenth of the rows or values."""
EDGE = 1.0 - 1e-9
"""Take no predictor with a pole beyond: it never forgets what it started from."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LikeliestFit:
    """A model of greatest likelihood of its class.

    Attributes:
        step: where the refinement stands still.
        data: what it was fitted to.
        weights: (n_outputs, n_outputs) R^-1.
        coordinates: that its numbers are counted in.
        log_likelihood: -2 ln L up to a constant of the data.
        n_numbers: fitted.
    """

    step: RefinementStep
    data: OutputError
    weights: FloatArray
    coordinates: Coordinates
    log_likelihood: float
    n_numbers: int

    @property
    def criterion(self) -> float:
        """Schwarz's: the least is taken."""
        return self.log_likelihood + self.n_numbers * float(np.log(n_rows_of(self.data)))

    @property
    def covariance(self) -> FloatArray:
        """(n_outputs, n_outputs) R of the errors, the numbers fitted to each output taken off; none below the least."""
        n_rows = n_rows_of(self.data)
        values, vectors = _noises(self.step, max(1.0, n_rows - self.n_numbers / self.step.layout.n_outputs))
        covariance: FloatArray = (vectors * values) @ vectors.T
        return covariance


def n_rows_of(data: OutputError) -> int:
    """Rows that count."""
    return sum(int(rows.sum()) for rows in data.rows)


def likeliest(
    start: RefinementStep,
    data: OutputError,
    coordinates: Coordinates,
    *,
    rounds: int = ROUNDS,
    excess: Callable[[RefinementStep], float] = lambda _step: 0.0,
    progress: Callable[[float], None] = lambda _share: None,
) -> LikeliestFit:
    """Refined with the inverse covariance of the errors as their weights, until neither moves.

    Args:
        start: where from.
        data: what is fitted.
        coordinates: that steps are made in.
        rounds: at most so many, each with the weights of the one before.
        excess: by which a statistic of the errors, that falls by no more than -2 ln L does, is too large: the fit ends
            where the rounds to come, each with the fall of the last, do not promise as much.
        progress: called with the share that is behind at most.
    """
    n_rows, n_outputs = n_rows_of(data), start.layout.n_outputs
    step = start
    weights, size = _weights(step, n_rows)
    for number in range(rounds):
        if leaves_rounding(step, n_rows):
            break
        least = STILL / (n_rows * n_outputs)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a pole that the data do not show
            done = refine(
                step,
                data,
                n_steps=STEPS_A_ROUND,
                least_gain=least,
                weights=weights,
                coordinates=coordinates,
                progress=share_of(progress, number / rounds, (number + 1) / rounds),
            )
        step = done[-1]
        weights, new = _weights(step, n_rows)
        gain, size = size - new, new
        if gain < STILL * _n_numbers(step, coordinates) or excess(step) > (rounds - 1 - number) * gain:
            break
    return LikeliestFit(
        step=step,
        data=data,
        weights=weights,
        coordinates=coordinates,
        log_likelihood=size,
        n_numbers=_n_numbers(step, coordinates),
    )


def promised_criterion(step: RefinementStep, data: OutputError, coordinates: Coordinates) -> float:
    """The least criterion that a start promises: by twice the fall of -2 ln L of an undamped step.

    References:
        Rao, Mathematical Proceedings of the Cambridge Philosophical Society 44(1), 1948, 50-57,
        doi 10.1017/S0305004100023987 (score test).
    """
    n_rows = n_rows_of(data)
    weights, size = _weights(step, n_rows)
    normal = step_equations(step, weights=weights, coordinates=coordinates)
    sizes = np.diag(normal.matrix)
    scale = 1.0 / np.sqrt(np.maximum(sizes, ROUNDING * sizes.max() + np.finfo(np.float64).tiny))
    matrix = normal.matrix * np.outer(scale, scale) + ROUNDING * np.eye(scale.size)
    fall = float((scale * normal.gradient) @ np.linalg.solve(matrix, scale * normal.gradient))
    return size - 2.0 * fall + _n_numbers(step, coordinates) * float(np.log(n_rows))


def _n_numbers(step: RefinementStep, coordinates: Coordinates) -> int:
    """Of the chart and of the linear part, where a real pole has one state, and a pair two."""
    n_regressors = step.layout.n_regressors - int((~step.parameters.is_pair).sum())
    return coordinates.slopes(step.parameters).shape[1] + n_regressors * step.layout.n_outputs


def share_of(progress: Callable[[float], None], first: float, last: float) -> Callable[[float], None]:
    """Tells the whole, from `first` to `last`, of what is behind of a part.

    Example:
        >>> share_of(print, 0.25, 0.75)(0.5)
        0.5
    """
    return lambda share: progress(first + (last - first) * share)


def leaves_rounding(step: RefinementStep, n_rows: int) -> bool:
    """Whether the model explains its outputs, of unit size, to rounding."""
    return float(step.linear.squared_errors.mean()) <= NOISE_FREE**2 * n_rows


def _weights(step: RefinementStep, n_rows: int) -> tuple[FloatArray, float]:
    """R^-1 and N ln det R."""
    values, vectors = _noises(step, n_rows)
    return (vectors / values) @ vectors.T, n_rows * float(np.log(values).sum())


def _noises(step: RefinementStep, n_rows: float) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and vectors of R; what is too small for a weight of its own, or rounding, is taken as larger."""
    values, vectors = np.linalg.eigh(step.linear.error_products / n_rows)
    return np.maximum(values, max(SMALLEST_NOISE**2 * values[-1], np.finfo(np.float64).tiny)), vectors


def predictor_data(records: Sequence[Record], rows: Sequence[BoolArray]) -> OutputError:
    """Scaled records with their outputs among their inputs; all rows in one block a record."""
    twins = tuple(driven_by_outputs(record) for record in records)
    return OutputError(
        records=twins, rows=tuple(rows), blocks=blocks_of(twins, [[[] for _ in twins]]), n_direct=records[0].n_inputs
    )


def predictor_start(model: Realisation, data: OutputError) -> RefinementStep | None:
    """Where to start from a model with a gain, in scaled channels; None where its predictor is not stable."""
    return starting_parameters(one_step_predictor(model), data)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CanonicalVariates:
    """Combinations of the past that tell most about the future outputs, the most telling first: where to start.

    With the past z(k) of inputs and outputs over p samples, its covariance P = L L' and the predictions H z of the next
    p outputs by regression on z, weighted by their innovations' R^(-1/2), the states are V' L^-1 z with V of the
    singular vectors of R^(-1/2) H L; what future inputs and outputs add is known and left out, so feedback does no
    harm. S, P and the covariances c of states and outputs are those given the inputs of the sample. Regressions of
    y(k) and of the next states on states and inputs give C, D and the predictor. n states leave S - c'c; the least
    N ln det(S - c'c) + n (2 n_outputs + n_inputs) ln N says how many, states of the noise among them.

    Attributes:
        states: (n_most, n_channels p) V' L^-1.
        outputs: (n_most, n_outputs) c.
        now: (n_outputs, n_outputs) S.
        lags: (n_channels (p + 1), same) covariance of u(k), y(k), u(k-1), y(k-1) ... y(k-p).
        past: p.
        n_rows: N.
        scaling: of the channels.
        dt: time step [s].

    References:
        Larimore, Proceedings of the 29th IEEE Conference on Decision and Control, 1990, 596-604,
        doi 10.1109/CDC.1990.203665; Jansson, IFAC Proceedings Volumes 36(16), 2003, 1559-1564,
        doi 10.1016/S1474-6670(17)34983-3 (the future's part by a regression first); Schwarz's criterion as above.

    Example:
        >>> rng, y = np.random.default_rng(1), np.zeros(4000)
        >>> for k in range(2, 4000):
        ...     y[k] = 1.6 * y[k - 1] - 0.9 * y[k - 2] + rng.standard_normal()
        >>> found = CanonicalVariates.of([Record([], y, 0.01)])
        >>> found.order, np.abs(np.linalg.eigvals(found.predictor(2).A)).round(2).tolist()
        (2, [0.95, 0.95])
    """

    states: FloatArray
    outputs: FloatArray
    now: FloatArray
    lags: FloatArray
    past: int
    n_rows: int
    scaling: ChannelScaling
    dt: float

    @classmethod
    def of(cls, records: Sequence[Record]) -> "CanonicalVariates | None":
        """Of records; None where they are too short, or channels repeat each other.

        The past is twice as long as Akaike's criterion of a regression on it asks for.
        """
        q, scaling = records[0].n_outputs, channel_scaling(records)
        n_channels = q + records[0].n_inputs
        longest = sum(record.n_samples for record in records) // (ROWS_A_NUMBER * n_channels)
        best, least, p = 0, np.inf, SHORTEST_PAST
        try:
            while p <= longest:
                gram = lag_gram(records, p, scaling=scaling)
                S, P, cross = _given_inputs(_covariance(gram), gram)
                left = S - cross.T @ scipy.linalg.cho_solve(scipy.linalg.cho_factor(P), cross)
                criterion = gram.n_rows * np.linalg.slogdet(left)[1] + 2 * p * q * n_channels
                if not criterion < least:
                    break
                best, least, p = p, criterion, 2 * p
            if not best:
                return None
            return cls.of_gram(lag_gram(records, min(2 * best, longest), scaling=scaling), scaling, records[0].dt)
        except (np.linalg.LinAlgError, InsufficientDataError):
            return None

    @classmethod
    def of_gram(cls, gram: LagGram, scaling: ChannelScaling, dt: float) -> "CanonicalVariates | None":
        """With the past of all its lags; None where channels repeat each other.

        Args:
            gram: of records.
            scaling: of its channels.
            dt: time step [s].
        """
        lags = _covariance(gram)
        q, p, width = gram.n_outputs, gram.order, gram.n_inputs + gram.n_outputs
        try:
            S, P, cross = _given_inputs(lags, gram)
            regression = scipy.linalg.cho_solve(scipy.linalg.cho_factor(P), cross).T
            left = S - regression @ cross
            whitened = np.linalg.solve(np.linalg.cholesky(left - ROUNDING * S.diagonal().max() * np.eye(q)), regression)
            L = np.linalg.cholesky(P)
        except np.linalg.LinAlgError:
            return None
        H = np.zeros((p * q, p * width))
        for i in range(p):
            H[i * q : (i + 1) * q, : (p - i) * width] = whitened[:, i * width :]
        _, values, V = np.linalg.svd(H @ L, full_matrices=False)
        states = scipy.linalg.solve_triangular(L, V[values > NOISE_FREE * values[0]].T, lower=True, trans=1).T
        return cls(
            states=states,
            outputs=states @ cross,
            now=S,
            lags=lags,
            past=p,
            n_rows=gram.n_rows,
            scaling=scaling,
            dt=dt,
        )

    @property
    def order(self) -> int:
        """Number of states of least criterion."""
        return self._least(float(np.log(self.n_rows)))

    @property
    def largest_order(self) -> int:
        """The same by Akaike's criterion, which takes more states of the noise."""
        return self._least(2.0)

    def _least(self, price: float) -> int:
        numbers = 2 * self.now.shape[0] + self.scaling.input_scale.size
        left, criteria = self.now.copy(), []
        for n, own in enumerate(self.outputs, 1):
            left -= np.outer(own, own)
            sign, size = np.linalg.slogdet(left)
            criteria.append(self.n_rows * size + n * numbers * price if sign > 0 else np.inf)
        return 1 + int(np.argmin(criteria))

    def predictor(self, order: int) -> Realisation | None:
        """The model with so many states, in the units of the records; None where there are not so many, or no noise."""
        if order > len(self.states):
            return None
        into, size, states = self.scaling.input_scale, self.scaling.output_scale, self.states[:order]
        m, width = into.size, into.size + size.size
        now = scipy.linalg.block_diag(states, np.eye(width))  # of past and present: the states come first
        now = np.hstack([now[:, states.shape[1] :], now[:, : states.shape[1]]])
        seen, n = self.lags @ now.T, order + m
        own, after = now @ seen, states @ seen[: states.shape[1]]
        try:
            closed = np.linalg.solve(own, after.T).T
            direct = np.linalg.solve(own[:n, :n], own[:n, n:]).T
        except np.linalg.LinAlgError:
            return None
        C, D = direct[:, :order] * size[:, np.newaxis], direct[:, order:] * np.divide.outer(size, into)
        return _model(closed[:, :order], closed[:, order:] / np.concatenate([into, size]), C, D, self.dt)


def _covariance(gram: LagGram) -> FloatArray:
    """((p + 1) n_channels, same) of u(k), y(k), u(k-1), y(k-1) .. y(k-p)."""
    level = gram.matrix[1:, 0] / gram.n_rows
    covariance: FloatArray = gram.matrix[1:, 1:] / gram.n_rows - np.outer(level, level)
    return covariance


def _given_inputs(covariance: FloatArray, gram: LagGram) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Covariances of y(k), of the past with the rounding of its sums, and of the past with it, given u(k)."""
    m, width = gram.n_inputs, gram.n_inputs + gram.n_outputs
    if m:
        factor = scipy.linalg.cho_factor(covariance[:m, :m])
        covariance = covariance - covariance[:, :m] @ scipy.linalg.cho_solve(factor, covariance[:m])
    past = covariance[width:, width:]
    past = past + ROUNDING * np.trace(past) * np.eye(len(past))
    return covariance[m:width, m:width], past, covariance[width:, m:width]


def innovation_form(step: RefinementStep, dt: float) -> Realisation:
    """A, B, C, D, K of scaled channels from a fitted predictor."""
    A, B, C = real_modal_form(step)
    n = step.layout.n_poles
    return _model(A, B, C, step.linear.coefficients[2 * n : 2 * n + step.layout.n_direct].T, dt)


def _model(closed: FloatArray, feed: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> Realisation:
    m = D.shape[1]
    K = feed[:, m:]
    return Realisation(closed + K @ C, feed[:, :m] + K @ D, C, D, dt, K=K)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Layout:
    """Which poles make up each section: (first, second), second -1 for a pair and -2 for a real pole alone."""

    members: tuple[tuple[int, int], ...]
    held: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Sections:
    """Sections of two states; the participations of one input in each are held, which fixes its coordinates.

    Attributes:
        n_measured: sections on which no input beyond the first so many acts, none of the outputs, stay so: the noise is
            no noise of their states.
    """

    n_measured: int | None = None

    def slopes(self, parameters: ModalParameters) -> FloatArray:
        """See `Coordinates`."""
        n_poles, n_inputs = parameters.inputs.shape
        n_drives = n_inputs + parameters.states.shape[0]
        n_sensitivities = n_poles * (1 + n_drives)
        drives = np.vstack([parameters.inputs.T, parameters.states])  # (n_drives, n_poles)
        columns: list[FloatArray] = []

        def add(entries: Sequence[tuple[int, int, complex]]) -> None:
            column = np.zeros(2 * n_sensitivities)
            for kind, pole, value in entries:
                place = kind * n_poles + pole
                column[place] = value.real
                column[n_sensitivities + place] = value.imag if parameters.is_pair[pole] else 0.0
            columns.append(column)

        layout = _sections(parameters)
        for (first, second), held in zip(layout.members, layout.held, strict=True):
            pole = complex(parameters.poles[first])
            if second == -2:
                add([(0, first, 1 / pole)])
                for j in self._free(parameters, [first], held):
                    add([(1 + j, first, 1.0)])
                continue
            own = [first] if second == -1 else [first, second]
            _, s = _mean_and_root(parameters, first, second)
            roots = [s] if second == -1 else [s, -s]
            at = [complex(parameters.poles[i]) for i in own]
            b1 = self._of_section(drives, first, second, s)[0]
            add([(0, i, 1 / pole) for i, pole in zip(own, at, strict=True)])
            change = [(0, i, 1 / (2 * r * pole)) for i, r, pole in zip(own, roots, at, strict=True)]
            change += [
                (1 + j, i, -b1[j] / (4 * r**3)) for j in range(n_drives) for i, r in zip(own, roots, strict=True)
            ]
            add(change)
            for j in self._free(parameters, own, held):
                add([(1 + j, i, 1 / (2 * r)) for i, r in zip(own, roots, strict=True)])
                add([(1 + j, i, 0.5 + 0j) for i in own])
        return np.array(columns).T

    def taken(
        self, parameters: ModalParameters, matrix: FloatArray, gradient: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Coordinates`."""
        slopes = scipy.sparse.csr_array(self.slopes(parameters).T)  # a number moves one section
        return (slopes @ (slopes @ matrix).T).T, slopes @ gradient

    def moved(self, parameters: ModalParameters, change: FloatArray) -> ModalParameters | None:
        """See `Coordinates`; None where a pole leaves the unit circle."""
        n_inputs = parameters.inputs.shape[1]
        drives = np.vstack([parameters.inputs.T, parameters.states])
        layout = _sections(parameters)
        poles: list[complex] = []
        is_pair: list[bool] = []
        columns: list[ComplexArray] = []
        at = 0
        for (first, second), held in zip(layout.members, layout.held, strict=True):
            free = self._free(parameters, [first] if second < 0 else [first, second], held)
            if second == -2:
                column = drives[:, first].copy()
                column[free] += change[at + 1 : at + 1 + len(free)]
                poles.append(complex(parameters.poles[first].real + change[at]))
                is_pair.append(False)
                columns.append(column)
                at += 1 + len(free)
                continue
            mean, s = _mean_and_root(parameters, first, second)
            b1, b2 = self._of_section(drives, first, second, s)
            mean, square = mean + change[at], (s * s).real + change[at + 1]
            own = change[at + 2 : at + 2 + 2 * len(free)].reshape(-1, 2)
            b1[free] += own[:, 0]
            b2[free] += own[:, 1]
            at += 2 + 2 * len(free)
            s = np.sqrt(complex(square)) if abs(square) > ROUNDING**2 else complex(ROUNDING)
            square = (s * s).real
            upper: ComplexArray = (b2 / 2 + b1 / (2 * s)).astype(np.complex128)
            poles.append(mean + s)
            columns.append(upper)
            is_pair.append(square < 0)
            if square >= 0:
                poles.append(mean - s)
                columns.append((b2 / 2 - b1 / (2 * s)).astype(np.complex128))
                is_pair.append(False)
        found = np.array(poles, dtype=np.complex128)
        size = np.abs(found)
        if not (size < EDGE).all() or not size.all():
            return None
        whole = np.array(columns, dtype=np.complex128)
        return ModalParameters(
            poles=found, is_pair=np.array(is_pair), inputs=whole[:, :n_inputs], states=whole[:, n_inputs:].T
        )

    def _free(self, parameters: ModalParameters, own: Sequence[int], held: int) -> list[int]:
        """Which drives of a section move."""
        n_inputs, n_states = parameters.inputs.shape[1], parameters.states.shape[0]
        first = n_inputs if self.n_measured is None else self.n_measured
        still = range(first, n_inputs) if not parameters.inputs[own, first:].any() else ()
        resting = n_inputs + np.flatnonzero(~parameters.states.any(axis=1))  # begins at rest: known
        return [j for j in range(n_inputs + n_states) if j != held and j not in still and j not in resting]

    @staticmethod
    def _of_section(drives: ComplexArray, first: int, second: int, s: complex) -> tuple[FloatArray, FloatArray]:
        """(n_drives,) b1 and b2 of a section."""
        if second == -1:
            return -2 * s.imag * drives[:, first].imag, 2 * drives[:, first].real
        total, difference = drives[:, first] + drives[:, second], drives[:, first] - drives[:, second]
        return s.real * difference.real, total.real


def _mean_and_root(parameters: ModalParameters, first: int, second: int) -> tuple[float, complex]:
    pole = complex(parameters.poles[first])
    if second == -1:
        return pole.real, 1j * pole.imag
    other = complex(parameters.poles[second])
    return (pole + other).real / 2, complex(max((pole - other).real / 2, ROUNDING))


def _sections(parameters: ModalParameters) -> _Layout:
    """Pairs, then real poles two by two, the closest first, and what is left over."""
    members = [(int(i), -1) for i in np.flatnonzero(parameters.is_pair)]
    real = [int(i) for i in np.flatnonzero(~parameters.is_pair)]
    real.sort(key=lambda i: -parameters.poles[i].real)
    while len(real) > 1:
        gaps = -np.diff(parameters.poles[real].real)
        at = int(gaps.argmin())
        members.append((real[at], real[at + 1]))
        real = real[:at] + real[at + 2 :]
    members += [(i, -2) for i in real]
    size = np.abs(parameters.inputs)
    held = [int((size[a] if b < 0 else np.minimum(size[a], size[b])).argmax()) for a, b in members]
    return _Layout(members=tuple(members), held=tuple(held))
