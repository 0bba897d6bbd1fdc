"""The identified gain at work: innovations, a filterpy filter that runs it, prediction k steps ahead with intervals.

    x(k+1) = A x(k) + B u(k) + K e(k),   e(k) = y(k) - C x(k) - D u(k)

K is the gain of the one-step PREDICTOR. A filter that first corrects and then predicts, as filterpy's does, uses
K_filter = A^(-1) K, with the same innovations. Conversely, the Riccati equation with Q = K R K', S = K R returns K
wherever A - K C is stable, and the stable gain with the same innovation spectrum where it is not.

Prediction k steps ahead with intervals: what the filter knows, run on by the model, and how far it can be off.

    y_hat(j | j-k) = y_hat(j | j-1) - sum over i = 1 ... k-1 of C A^(i-1) c(j-i),   c(i): what sample i corrects, K e(i)
    cov = sum over i = 0 ... k-1 of G_i R G_i',   G_0 = I, G_i = C A^(i-1) K

plus C A^(k-1) P A^(k-1)' C' where the state at the origin is not known exactly: after missing samples, and at the start
of the record if so said. The intervals hold for Gaussian innovations of covariance R; that A, B, C, D, K and R were
themselves estimated is not in them.

The innovation form is a state-space model whose noises belong together: Q = K R K', R, S = K R. Its Kalman filter with
state covariance P and the rows a that are there,

    L = (A P Ca' + K R_a) (Ca P Ca' + Raa)^-1,  x+ = A x + B u + L e_a,  P+ = A P A' + K R K' - L (Ca P Ca' + Raa) L'

has P = 0 and L = K as long as nothing is missing: the steady state. A missing sample makes P grow, and complete samples
bring it back to zero as fast as A - K C forgets.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from era.gain import information, inverse, left_over, settled
from era.realisation import Realisation, warn_of_lead
from era.simulation import acting_inputs, check_channels, predict, unknown_after
from era.state_recursion import checked_state, run_from
from okid.arrays import ROUNDED, FloatArray, frozen, real_number, whole_number
from okid.display import Displayed
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record
from okid.residuals import NOT_WHITE, UNLIKELY_WHITE, WHITENESS_LAGS, ResidualCheck, centred, residual_check
from okid.rows import as_records, runs_of

LARGEST_CONDITION = 1e12
"""Condition number of A beyond which A^(-1) K is rounding error."""


def innovations(realisation: Realisation, record: Record, *, initial_state: FloatArray | None = None) -> FloatArray:
    """(n_samples, n_outputs) measured less predicted outputs; NaN where an output is missing or not known.

    Args:
        realisation: model with a gain.
        record: of the model's channels and time step.
        initial_state: (order,) state at the first sample; at rest unless given.

    Raises:
        InvalidDataError: as `era.simulation.predict`.

    Example:
        >>> model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, K=[[0.1]])
        >>> innovations(model, Record([1.0, 0.0, 0.0], [0.0, 2.5, 0.0], 0.01)).ravel()
        array([ 0. ,  0.5, -1.1])
    """
    return record.outputs - predict(realisation, record, initial_state=initial_state).outputs


def kalman_filter(realisation: Realisation) -> Any:
    """A `filterpy.kalman.KalmanFilter` set to run the identified gain in steady state.

    For each sample call `update_steadystate(y - D @ u)`, whose innovation is then in its attribute `y`, and
    `predict_steadystate(u)`: filterpy knows no D, and x and u must both stay one-dimensional. Of a model that looks
    ahead u is the input so many samples later, and a warning says it.

    Args:
        realisation: model with a gain.

    Raises:
        InvalidDataError: no gain.
        NumericalError: A is singular (a delay or deadbeat pole), so that no filter gain A^(-1) K exists.

    Example:
        >>> filter_ = kalman_filter(Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, K=[[0.1]]))
        >>> filter_.update_steadystate(np.array([1.0]))
        >>> filter_.predict_steadystate(np.array([0.0]))
        >>> filter_.x
        array([0.1])
    """
    from filterpy.kalman import KalmanFilter

    model = realisation
    if model.K is None:
        raise InvalidDataError(
            "a Kalman filter needs a gain K and this realisation has none; realise Markov parameters with a gain, or "
            "estimate one with era.gain_from_innovations."
        )
    if model.order == 0:
        raise InvalidDataError("a Kalman filter needs at least one state, but this model is a pure feedthrough.")
    warn_of_lead(model)
    condition = np.linalg.cond(model.A)
    if not condition < LARGEST_CONDITION:
        raise NumericalError(
            f"the filter gain A^-1 K needs an invertible A, but its condition number is {condition:.3g} (a delay or "
            "deadbeat pole); use era.innovations, which needs no inverse."
        )
    result = KalmanFilter(dim_x=model.order, dim_z=model.n_outputs, dim_u=model.n_inputs)
    result.x = np.zeros(model.order)
    result.F, result.H = np.array(model.A), np.array(model.C)
    result.B = np.array(model.B) if model.n_inputs else None
    result.K = np.linalg.solve(model.A, model.K)
    return result


def check_innovations(
    realisation: Realisation, records: Record | Sequence[Record], *, n_lags: int | None = None
) -> ResidualCheck:
    """Test the innovations of a model with a gain for whiteness and for what the inputs still explain.

    The state that each record starts from and a constant in each output are estimated and taken off. Whiteness is
    Hosking's statistic over n_outputs^2 n_lags degrees of freedom, less order times n_outputs when there is a gain, for
    these numbers were fitted. Inputs up to n_lags samples old are correlated with the innovations.

    Args:
        realisation: model with a gain (zeros for one that knows measurement noise only).
        records: one or several of the model's channels and time step, best not those that the gain was fitted to.
        n_lags: L; unless given 20 more than the fitted numbers take up, as far as there are two rows for each.

    Raises:
        InvalidDataError: no gain, other channels or another time step, or too few lags for the numbers fitted.
        InsufficientDataError: fewer complete rows than twice the lags.

    References:
        Hosking, Journal of the American Statistical Association 75(371), 1980, 602-608,
        doi 10.1080/01621459.1980.10477520.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> e, x, y = rng.standard_normal(3000), 0.0, np.empty(3000)
        >>> for k in range(3000):
        ...     y[k], x = x + e[k], 0.9 * x + 0.3 * e[k]
        >>> none = np.empty((1, 0))
        >>> right = Realisation([[0.9]], none, [[1.0]], none, 0.01, K=[[0.3]])
        >>> half = Realisation([[0.9]], none, [[1.0]], none, 0.01, K=[[0.15]])
        >>> [check_innovations(model, Record([], y, 0.01)).whiteness_ratio < 2 for model in (right, half)]
        [True, False]
    """
    model, several = realisation, as_records(records)
    for record in several:
        check_channels(model, record)
    if model.K is None:
        raise InvalidDataError(
            "innovations need a gain K and this realisation has none; estimate one with era.gain_from_innovations, or "
            "give zeros for a model of measurement noise only."
        )
    size = _sizes(several)
    C, K, weight = model.C / size[:, np.newaxis], model.K * size, np.eye(model.n_outputs)
    found = []
    for record in several:
        part, _ = left_over(model, record)
        scaled = type(part)(values=part.values / size, state=part.state)
        _, e = settled(model.A, C, K, scaled, weight)
        found.append(np.where(np.isnan(part.values), np.nan, e))
    errors = centred(found)
    fitted = model.order * model.n_outputs if model.K.any() else 0
    least = fitted // model.n_outputs**2 + 1
    lags = (
        max(least, min(least + WHITENESS_LAGS, errors.n_rows // 2))
        if n_lags is None
        else whole_number(n_lags, name="n_lags (n_outputs^2 n_lags above the numbers of the gain)", least=least)
    )
    return residual_check(
        errors,
        [_known_inputs(model, record) for record in several],
        n_lags=lags,
        n_fitted=fitted,
        first_lag=0,
        what="the innovations of at least one output are",
        words=lambda ratio, p_value, input_ratio: _messages(ratio, p_value, input_ratio, lags),
    )


def _known_inputs(model: Realisation, record: Record) -> FloatArray:
    """(n_samples, n_inputs) inputs where the model looks at them, NaN where one is missing."""
    inputs, missing = acting_inputs(model, record)
    return np.where(missing[:, np.newaxis], np.nan, inputs)


def _sizes(records: Sequence[Record]) -> np.ndarray:
    """(n_outputs,) standard deviations over all records; 1 for an output that never moves."""
    values = np.vstack([record.outputs for record in records])
    there = ~np.isnan(values)
    count = np.maximum(there.sum(axis=0), 1)
    mean = np.where(there, values, 0.0).sum(axis=0) / count
    size = np.sqrt((np.where(there, values - mean, 0.0) ** 2).sum(axis=0) / count)
    return np.where(size > 0.0, size, 1.0)


def _messages(ratio: float, p_value: float, input_ratio: float, lags: int) -> tuple[str, ...]:
    found = []
    if ratio > NOT_WHITE:
        found.append(
            f"the innovations are not white: statistic over degrees of freedom {ratio:.2f} at {lags} lags (white: 1); "
            "the past holds more than the gain uses: the noise has dynamics that are not the model's, or the gain "
            "is not that of these data."
        )
    elif p_value < UNLIKELY_WHITE:
        found.append(
            f"the innovations are nearly white: statistic over degrees of freedom {ratio:.2f} (1 is white), p-value "
            f"{p_value:.2g}."
        )
    else:
        found.append(
            f"the innovations are white: statistic over degrees of freedom {ratio:.2f}, p-value {p_value:.2g}."
        )
    if input_ratio > NOT_WHITE:
        found.append(
            f"inputs up to {lags} samples old still explain part of the innovations (ratio {input_ratio:.2f}, 1 is "
            "none): the model misses dynamics from the inputs, or the system is not linear."
        )
    return tuple(found)


SteadyRun = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Inputs, complete outputs and state at the first sample to one-step predictions and the state after the last."""
NEGLIGIBLE = 1e-9
"""Energy of all later prediction errors by the state's covariance, over one sample's noise, below which it is zero."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Filtered:
    """A pass through a record.

    Attributes:
        predicted: (n_samples, n_outputs) one step ahead.
        corrections: (n_samples, order) L e, what each sample adds to the state.
        spreads: (n_samples, n_outputs) diagonal of M P(k) M' for the M that was asked for.
    """

    predicted: FloatArray
    corrections: FloatArray
    spreads: FloatArray


def filter_run(
    model: Realisation,
    gain: FloatArray,
    noise: FloatArray,
    inputs: FloatArray,
    outputs: FloatArray,
    *,
    state: FloatArray,
    covariance: FloatArray,
    projection: FloatArray,
    steady: SteadyRun,
) -> Filtered:
    """Run the filter through a record.

    Args:
        model: A, B, C, D.
        gain: (order, n_outputs) K.
        noise: (n_outputs, n_outputs) R.
        inputs: (n_samples, n_inputs), finite.
        outputs: (n_samples, n_outputs), NaN where missing.
        state: (order,) at the first sample.
        covariance: (order, order) of the state at the first sample.
        projection: (n_outputs, order) M.
        steady: how to run where the covariance is zero and nothing is missing.
    """
    n_samples = outputs.shape[0]
    there = ~np.isnan(outputs)
    ends = np.zeros(n_samples, dtype=np.intp)
    for start, stop in runs_of(np.asarray(there.all(axis=1))):
        ends[start:stop] = stop
    A, C, P = model.A, model.C, np.array(covariance)
    forgotten = information(A, C, gain, inverse(noise), length=n_samples)
    predicted, spreads = np.empty_like(outputs, subok=False), np.zeros(outputs.shape)
    corrections = np.empty((n_samples, model.order))
    driven = gain @ noise @ gain.T
    k = 0
    while k < n_samples:
        if ends[k] and not P.any():
            rows = slice(k, int(ends[k]))
            predicted[rows], state = steady(inputs[rows], outputs[rows], state)
            corrections[rows] = (outputs[rows] - predicted[rows]) @ gain.T
            k = rows.stop
            continue
        spreads[k] = ((projection @ P) * projection).sum(axis=1)
        seen = there[k]
        predicted[k] = C @ state + model.D @ inputs[k]
        visible = P @ C[seen].T
        size = C[seen] @ visible + noise[np.ix_(seen, seen)]
        L = (A @ visible + gain @ noise[:, seen]) @ inverse(size)
        corrections[k] = L @ (outputs[k, seen] - predicted[k, seen])
        state = A @ state + model.B @ inputs[k] + corrections[k]
        P = A @ P @ A.T + driven - L @ size @ L.T
        P = 0.5 * (P + P.T)
        if seen.all() and float((P * forgotten).sum()) < NEGLIGIBLE:
            P = np.zeros_like(P)
        k += 1
    return Filtered(predicted=predicted, corrections=corrections, spreads=spreads)


def by_recursion(model: Realisation, gain: FloatArray) -> SteadyRun:
    """The innovation recursion, in blocks; needs no inverse of A."""
    A, B = model.A - gain @ model.C, np.hstack([model.B - gain @ model.D, gain])
    D = np.hstack([model.D, np.zeros((model.n_outputs, model.n_outputs))])

    def run(inputs: FloatArray, outputs: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        return run_from(A, B, model.C, D, np.hstack([inputs, outputs]), state=state)

    return run


def by_filterpy(model: Realisation) -> SteadyRun:
    """The steady-state filter of filterpy, a sample at a time.

    Raises:
        InvalidDataError: no gain, or no state.
        NumericalError: A is singular.
    """
    filter_ = kalman_filter(model)

    def run(inputs: FloatArray, outputs: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        filter_.x = np.array(state)
        predicted = np.empty_like(outputs, subok=False)
        for k, y in enumerate(outputs):
            filter_.update_steadystate(y - model.D @ inputs[k])
            predicted[k] = y - filter_.y
            filter_.predict_steadystate(inputs[k] if model.n_inputs else None)
        return predicted, np.asarray(filter_.x, dtype=np.float64)

    return run


TRUSTED_INVERSE = 1e8
"""Condition number of A up to which A^(-1) K costs filterpy's filter no more than half of its digits."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Forecast(Displayed):
    """Predictions of each output at each sample from `steps` samples before, with intervals.

    Attributes:
        means: (n_samples, n_outputs); NaN where a missing input leaves them unknown.
        standard_deviations: (n_samples, n_outputs) of measured less predicted.
        lower: (n_samples, n_outputs) end of the interval.
        upper: (n_samples, n_outputs) end of the interval.
        steps: k.
        probability: that a measurement lies between lower and upper, one output at one sample.
        through: "filterpy" or "recursion", what ran the steady state.
    """

    means: FloatArray
    standard_deviations: FloatArray
    lower: FloatArray
    upper: FloatArray
    steps: int
    probability: float
    through: Literal["filterpy", "recursion"]


def forecast(
    realisation: Realisation,
    record: Record,
    *,
    innovation_covariance: npt.ArrayLike,
    steps: int = 1,
    probability: float = 0.95,
    initial_state: FloatArray | None = None,
    initial_covariance: npt.ArrayLike | None = None,
    through: Literal["auto", "filterpy", "recursion"] = "auto",
) -> Forecast:
    """Predict every sample of a record from the outputs up to `steps` samples before it, and from the inputs up to it.

    The first `steps` - 1 samples are predicted from the start of the record. Outputs that are missing are not used, and
    the intervals widen as the time-varying filter says; so, to forecast on and on from one sample, leave the outputs
    after it NaN, and take steps = 1. Missing inputs are treated as in `era.predict`.

    Args:
        realisation: model with a gain.
        record: of the model's channels and time step; its inputs serve as the future ones.
        innovation_covariance: (n_outputs, n_outputs) R, as from `era.estimate_gain`.
        steps: k, how far ahead.
        probability: of the intervals.
        initial_state: (order,) state at the first sample; at rest unless given.
        initial_covariance: (order, order) of the initial state; exactly known unless given.
        through: what runs the steady state: filterpy's filter, which needs an invertible A, or the innovation recursion
            in blocks, the same to rounding and faster; "auto" is filterpy where A is safely invertible.

    Raises:
        InvalidDataError: no gain, other channels or another time step, or a covariance that is none.
        NumericalError: predictions grow beyond all numbers, or filterpy was asked for and A is singular.

    References:
        Anderson, Moore, Optimal Filtering, Prentice-Hall, 1979, sections 5.4 (noises that belong together) and 7.2
        (prediction).

    Example:
        >>> model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, K=[[0.1]])
        >>> record = Record([1.0, 0.0, 0.0], [0.0, 2.5, 0.0], 0.01)
        >>> ahead = forecast(model, record, innovation_covariance=[[0.25]], steps=2)
        >>> ahead.means.ravel(), ahead.standard_deviations.ravel().round(3), ahead.through
        (array([0., 2., 1.]), array([0.5 , 0.51, 0.51]), 'filterpy')
    """
    check_channels(realisation, record)
    model = replace(realisation, lead=0)  # of the inputs where it looks at them
    if model.K is None:
        raise InvalidDataError(
            "a forecast needs a gain K and this realisation has none; estimate one with era.estimate_gain, or give "
            "zeros for a model of measurement noise only."
        )
    steps = whole_number(steps, name="steps", least=1)
    level = real_number(probability)
    if not 0.0 < level < 1.0:
        raise InvalidDataError(f"a probability must lie between 0 and 1, but is {probability!r}.")
    if through not in ("auto", "filterpy", "recursion"):
        raise InvalidDataError(f'through must be "auto", "filterpy" or "recursion", but is {through!r}.')
    noise = _covariance(innovation_covariance, model.n_outputs, "the innovation covariance")
    start = _covariance(
        np.zeros((model.order, model.order)) if initial_covariance is None else initial_covariance,
        model.order,
        "the initial covariance",
    )
    inputs, missing = acting_inputs(realisation, record)
    chosen = _chosen(model, through)
    reach = _powers(model, min(steps, record.n_samples))
    with np.errstate(over="ignore", invalid="ignore"):
        run = filter_run(
            model,
            model.K,
            noise,
            inputs,
            record.outputs,
            state=checked_state(model.order, initial_state),
            covariance=start,
            projection=_last_power(model, steps),
            steady=by_filterpy(model) if chosen == "filterpy" else by_recursion(model, model.K),
        )
        means = np.array(run.predicted)
        for i in range(1, reach.shape[0]):
            means[i:] -= run.corrections[:-i] @ reach[i - 1].T
        variances = _variances(model.K, noise, start, reach, spreads=run.spreads, steps=steps)
    if not (np.isfinite(means).all() and np.isfinite(variances).all()):
        raise NumericalError(
            f"the forecast {steps} steps ahead grows beyond all numbers; use a model with its poles inside the unit "
            "circle, a gain from era.estimate_gain, or fewer steps."
        )
    if missing.any():
        unknown = _unknown(missing, model.A - model.K @ model.C, steps)
        means[unknown], variances[unknown] = np.nan, np.nan
    deviations = np.sqrt(np.maximum(variances, 0.0))
    half = float(scipy.special.ndtri(0.5 + 0.5 * level)) * deviations
    lower, upper = means - half, means + half
    for array in (means, deviations, lower, upper):
        array.flags.writeable = False
    return Forecast(
        means=means,
        standard_deviations=deviations,
        lower=lower,
        upper=upper,
        steps=steps,
        probability=level,
        through=chosen,
    )


def _chosen(model: Realisation, through: Literal["auto", "filterpy", "recursion"]) -> Literal["filterpy", "recursion"]:
    if through != "auto":
        return through
    if model.order == 0:
        return "recursion"
    return "filterpy" if np.linalg.cond(model.A) < TRUSTED_INVERSE else "recursion"


def _covariance(values: npt.ArrayLike, size: int, name: str) -> FloatArray:
    matrix = frozen(values, name=name, shape=(size, size))
    largest = float(np.abs(matrix).max(initial=0.0))
    lopsided = float(np.abs(matrix - matrix.T).max(initial=0.0)) > ROUNDED * largest
    if lopsided or (size and float(np.linalg.eigvalsh(matrix)[0]) < -ROUNDED * largest):
        raise InvalidDataError(
            f"{name} must be symmetric without negative eigenvalues, but is not; take it from era.estimate_gain or as "
            "E E' / n of innovations."
        )
    return matrix


def _powers(model: Realisation, length: int) -> FloatArray:
    """(length, n_outputs, order) C, C A, C A^2, ..."""
    reach = np.empty((length, model.n_outputs, model.order))
    block = model.C
    for i in range(length):
        reach[i] = block
        block = block @ model.A
    return reach


def _last_power(model: Realisation, steps: int) -> FloatArray:
    """C A^(steps - 1)."""
    power: FloatArray = model.C @ np.linalg.matrix_power(model.A, steps - 1)
    return power


def _variances(
    gain: FloatArray, noise: FloatArray, start: FloatArray, reach: FloatArray, *, spreads: FloatArray, steps: int
) -> FloatArray:
    """(n_samples, n_outputs) variances; of the first steps - 1 samples by their own, shorter horizon."""
    n_samples = spreads.shape[0]
    variances = np.zeros(spreads.shape)
    total = np.diagonal(noise).copy()
    for horizon in range(1, reach.shape[0] + 1):
        if horizon > 1:
            response = reach[horizon - 2] @ gain
            total = total + ((response @ noise) * response).sum(axis=1)
        ahead = reach[horizon - 1]
        if horizon < steps:
            variances[horizon - 1] = total + ((ahead @ start) * ahead).sum(axis=1)
        else:
            variances[horizon - 1 :] = total + spreads[: n_samples - steps + 1]
    return variances


def _unknown(missing: npt.NDArray[np.bool_], closed: FloatArray, steps: int) -> npt.NDArray[np.bool_]:
    """Rows whose origin, or whose way from there, saw a missing input."""
    at_origin = unknown_after(missing, closed)
    position = np.arange(missing.size)
    last = np.maximum.accumulate(np.where(missing, position, -missing.size - steps))
    unknown: npt.NDArray[np.bool_] = at_origin[np.maximum(position - steps + 1, 0)] | (position - last < steps)
    return unknown
