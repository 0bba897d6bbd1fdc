"""The observer fit: an ARX model of the data by least squares, the first half of OKID.

    y(k) = D u(k) + sum_{i=1..p} [alpha_i u(k-i) + beta_i y(k-i)] + offset + e(k)

with alpha_i = C Abar^(i-1) (B - K D), beta_i = C Abar^(i-1) K, Abar = A - K C (Juang, Phan, Horta, Longman, Journal of
Guidance, Control, and Dynamics 16(2), 1993, doi 10.2514/3.21006). The first p samples of every record are dropped, so
any initial state is right.
"""

import warnings
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Literal

import numpy as np

from okid.arrays import FloatArray
from okid.display import Displayed
from okid.errors import IdentificationWarning, InsufficientDataError
from okid.excitation import POOR_CONDITION
from okid.gram import LagGram, chunked_gram, lag_gram
from okid.least_squares import ObserverCoefficients, RegressionRows, solve
from okid.record import Record
from okid.rows import as_records, check_enough_rows, check_rows_left
from okid.scaling import ChannelScaling, channel_scaling

_DEPENDENT = 1e4
"""Condition number times relative residual from which the regressors are called dependent. Noise alone, which fills
every direction that the system leaves empty, gives a product of order ten."""
_NOISE_FREE = 1e-6
"""Relative residual below which nothing is left that an ill-conditioned fit could blow up."""


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class ObserverFit(Displayed):
    """Coefficients of the observer equation, in the units of the record.

    Attributes:
        feedthrough: (n_outputs, n_inputs) D.
        input_coefficients: (order, n_outputs, n_inputs) alpha_1 ... alpha_order.
        output_coefficients: (order, n_outputs, n_outputs) beta_1 ... beta_order.
        offset: (n_outputs,) constant of each output's equation.
        dt: time step [s].
        ridge: what was added to the unit diagonal of the Gram matrix of the scaled channels, for lag 0; it grows with
            the lag as ridge (1 + lag).
        input_scale: (n_inputs,) standard deviation of each input, by which channels were made comparable.
        output_scale: (n_outputs,) likewise.
        residual_covariance: (n_outputs, n_outputs) of the one-step residual e, degrees of freedom taken off.
        n_rows: number of complete rows that were fitted.
        n_parameters: unknowns per output.
        condition: estimated condition number of the scaled regressor matrix, ridge included; an upper estimate where
            the method is "cholesky", of the directions kept otherwise.
        method: "cholesky", "eigh" (rank-deficient: directions without information left out) or "qr" (short or
            ill-conditioned).
        rank: number of directions kept.
    """

    feedthrough: FloatArray
    input_coefficients: FloatArray
    output_coefficients: FloatArray
    offset: FloatArray
    dt: float
    ridge: float
    input_scale: FloatArray
    output_scale: FloatArray
    residual_covariance: FloatArray
    n_rows: int
    n_parameters: int
    condition: float
    method: Literal["cholesky", "eigh", "qr"]
    rank: int

    def __repr__(self) -> str:
        return (
            f"ObserverFit(order {self.order}, ridge {self.ridge:.3g}, {self.n_inputs} inputs, "
            f"{self.n_outputs} outputs, {self.n_rows} rows, condition {self.condition:.2g}, {self.method})"
        )

    @property
    def order(self) -> int:
        """Number of past samples that the observer uses."""
        return self.output_coefficients.shape[0]

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return self.feedthrough.shape[1]

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return self.feedthrough.shape[0]


def fit_observer(
    records: Record | Sequence[Record], *, order: int, ridge: float | None = None, executor: Executor | None = None
) -> ObserverFit:
    """Fit the observer equation to one record or to several of one system.

    The first `order` samples of every record are dropped, so any initial state is right; a missing sample drops the
    rows that it touches; a constant in each equation takes up offsets; channels are scaled to unit standard deviation.

    Args:
        records: with the same channels, units and time step.
        order: number of past samples, at least (number of states) / n_outputs; `modal.choose_orders` chooses it, and
            the ridge with it, by the error of a free run on held-out rows.
        ridge: added to the unit diagonal of the Gram matrix, growing as ridge (1 + lag); None adds nothing.
        executor: who sums the Gram matrix over chunks of the records: None for this process, any
            `concurrent.futures.Executor`, or `modal.batch.Workers`, whose processes are started again when they die. It
            pays from about 1e8 values on, or where files are remote; a mapped file must be seen by its processes, too.

    Raises:
        InvalidDataError: an order or ridge that is none, or records that do not belong together.
        InsufficientDataError: too few samples for the order, too few left between missing ones, or a channel that never
            moves.
        ExecutorError: the executor broke.

    Warns:
        IdentificationWarning: the inputs do not excite enough for the order, or the regressors are nearly dependent.

    References:
        Juang, Phan, Horta, Longman, Journal of Guidance, Control, and Dynamics 16(2), 1993, 320-329, equations 8 to 16,
        doi 10.2514/3.21006.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> u = rng.standard_normal(400)
        >>> y = np.convolve(u, [0.0, 1.0])[:400]
        >>> fit = fit_observer(Record(u, y, 0.01), order=1)
        >>> fit.input_coefficients.ravel().round(9).tolist(), fit.n_rows
        ([1.0], 399)
    """
    several = as_records(records)
    check_enough_rows(several, order)
    order = int(order)
    scaling = channel_scaling(several)
    check_channels_move(several, scaling)
    if executor is None:
        gram = lag_gram(several, order, scaling=scaling)
    else:
        gram = chunked_gram(several, order, scaling=scaling, executor=executor)
    check_rows_left(several, order, gram.n_rows)
    source = RegressionRows(records=several, scaling=scaling)
    coefficients = solve(gram, 0.0 if ridge is None else ridge, source=source)
    _warn_where_poor(coefficients, gram, several[0])
    return observer_fit(coefficients, scaling, several[0].dt)


def observer_fit(coefficients: ObserverCoefficients, scaling: ChannelScaling, dt: float) -> ObserverFit:
    """The observer in the units of the record."""
    into, size = scaling.input_scale, scaling.output_scale[:, np.newaxis]
    feedthrough = coefficients.feedthrough * (size / into)
    input_coefficients = coefficients.input_coefficients * (size / into)
    output_coefficients = coefficients.output_coefficients * (size / scaling.output_scale)
    offset = scaling.output_mean + coefficients.offset * scaling.output_scale
    offset -= (feedthrough + input_coefficients.sum(axis=0)) @ scaling.input_mean
    offset -= output_coefficients.sum(axis=0) @ scaling.output_mean
    covariance = coefficients.residual_covariance * (size * scaling.output_scale)
    for array in (feedthrough, input_coefficients, output_coefficients, offset, covariance):
        array.flags.writeable = False
    n_outputs, n_inputs = feedthrough.shape
    return ObserverFit(
        feedthrough=feedthrough,
        input_coefficients=input_coefficients,
        output_coefficients=output_coefficients,
        offset=offset,
        dt=dt,
        ridge=coefficients.ridge,
        input_scale=scaling.input_scale,
        output_scale=scaling.output_scale,
        residual_covariance=covariance,
        n_rows=coefficients.n_rows,
        n_parameters=1 + n_inputs + coefficients.order * (n_inputs + n_outputs),
        condition=coefficients.condition,
        method=coefficients.method,
        rank=coefficients.rank,
    )


def check_channels_move(records: Sequence[Record], scaling: ChannelScaling) -> None:
    """Refuse channels that never move.

    Raises:
        InsufficientDataError: a constant input or output; the message names them.
    """
    for kind, names, constant, means in (
        ("input", records[0].input_names, scaling.constant_inputs, scaling.input_mean),
        ("output", records[0].output_names, scaling.constant_outputs, scaling.output_mean),
    ):
        if constant:
            listed = ", ".join(f"{names[i]!r} (always {means[i]:.6g})" for i in constant)
            raise InsufficientDataError(
                f"every {kind} must move, but {listed} does not; leave it out with record.select({kind}s=...)."
            )


def _warn_where_poor(coefficients: ObserverCoefficients, gram: LagGram, record: Record) -> None:
    """Say when the data do not determine the observer.

    The regressors' condition number is at least that of the inputs among them (interlacing), so well-conditioned fits,
    the usual case, need no second look.
    """
    deficient = coefficients.rank < coefficients.n_parameters
    if coefficients.condition < POOR_CONDITION and not deficient:
        return
    order = coefficients.order
    remedy = "add a ridge (1e-3), decimate to the band that is excited, lower the order, or excite more frequencies"
    if record.n_inputs:
        inputs = _input_condition(gram, coefficients.ridge)
        if inputs > POOR_CONDITION:
            warnings.warn(
                f"the inputs do not excite enough for observer order {order}: their {order + 1} lags have condition "
                f"number {inputs:.1e} (below {POOR_CONDITION:.0e} is safe), so the Markov parameters are uncertain "
                f"however small the one-step error is; {remedy}.",
                IdentificationWarning,
                stacklevel=3,
            )
            return
    residual = float(np.sqrt(coefficients.residual_covariance.diagonal().min()))
    if residual > _NOISE_FREE and (deficient or coefficients.condition * residual > _DEPENDENT):
        warnings.warn(
            f"the regressors of observer order {order} are nearly dependent: condition number "
            f"{coefficients.condition:.1e}, {coefficients.rank} of {coefficients.n_parameters} directions kept; "
            f"look for outputs that repeat each other, add a ridge (1e-3) or lower the order.",
            IdentificationWarning,
            stacklevel=3,
        )


def _input_condition(gram: LagGram, ridge: float) -> float:
    """Condition number of the inputs' own regressors, means removed, ridge included."""
    n_channels, width = gram.n_inputs + gram.n_outputs, gram.order + 1
    places = (1 + n_channels * np.arange(width)[:, np.newaxis] + np.arange(gram.n_inputs)).ravel()
    mean = gram.matrix[0, places]
    own = gram.matrix[np.ix_(places, places)] - np.outer(mean, mean / gram.n_rows)
    own.flat[:: own.shape[0] + 1] += ridge * gram.n_rows * np.repeat(np.arange(1.0, width + 1.0), gram.n_inputs)
    values = np.linalg.eigvalsh(own)
    return float(np.sqrt(values[-1] / max(values[0], np.finfo(np.float64).eps * values[-1])))
