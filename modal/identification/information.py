"""Standard deviations from the information matrix of an innovation form: nothing else is needed where e is white.

With the loadings L of all numbers of the predictor, L L' = (J'WJ)^-1 scaled by what was fitted, every change of the
predictor's poles, participations and shapes changes A = diag(poles) + K C, and that, by first order, its eigenvalues:

    dA = d diag(poles) + dK C + K dC,   d lambda_i = w_i dA v_i,
    d(C v_i) = dC v_i + sum over j != i of C v_j (w_j dA v_i) / (lambda_i - lambda_j)

with left and right eigenvectors w, v.

References:
    Ljung, System Identification: Theory for the User, 2nd edition, 1999, section 9.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from era.gain import inverse as inverse_covariance
from modal.estimation.output_error import inverse_root, step_equations
from modal.estimation.prediction_error import LikeliestFit, n_rows_of
from modal.identification.noise_model import NoiseModel
from modal.modes.modal_form import discrete_poles
from modal.modes.mode import Mode, Uncertainty
from okid.arrays import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Form:
    """A predictor with one state for each of its poles, conjugates included, and how its numbers change.

    Attributes:
        poles: (n,).
        feed: (n, n_inputs + n_outputs).
        shapes: (n_outputs, n).
        d_poles: (n_changes, n).
        d_feed: (n_changes, n, n_inputs + n_outputs).
        d_shapes: (n_changes, n_outputs, n).
        d_direct: (n_changes, n_outputs, n_inputs).
    """

    poles: ComplexArray
    feed: ComplexArray
    shapes: ComplexArray
    d_poles: ComplexArray
    d_feed: ComplexArray
    d_shapes: ComplexArray
    d_direct: FloatArray


def innovation_uncertainty(model: NoiseModel, modes: Sequence[Mode], *, n_lags: int) -> Uncertainty:
    """Standard deviations of the modes and Markov parameters of a model with its noise.

    Args:
        model: from `noise_model`.
        modes: of its realisation.
        n_lags: Markov parameters asked for.
    """
    form, size = _form(model.fit), model.scaling.output_scale
    m = form.d_direct.shape[2]
    K, dK = form.feed[:, m:], form.d_feed[:, :, m:]
    A = np.diag(form.poles) + K @ form.shapes
    dA = dK @ form.shapes + K @ form.d_shapes
    at = np.arange(form.poles.size)
    dA[:, at, at] += form.d_poles
    poles, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    seen = left @ dA @ right
    apart = poles - poles[:, np.newaxis]
    share = np.divide(1.0, apart, out=np.zeros_like(apart), where=apart != 0)
    shapes = (form.shapes @ right) * size[:, np.newaxis]
    reach, d_reach = (
        form.feed[:, :m] + K @ model.whole.D,
        form.d_feed[:, :, :m] + dK @ model.whole.D + K @ form.d_direct,
    )
    fed = left @ reach
    d_fed = left @ d_reach - (seen * share) @ fed
    d_shapes = (form.d_shapes @ right) * size[:, np.newaxis] + shapes @ (seen * share)
    wanted, _ = discrete_poles(tuple(modes), model.whole.dt)
    own = np.abs(wanted[:, np.newaxis] - poles).argmin(axis=1) if wanted.size else np.empty(0, dtype=np.intp)
    d_log = seen[:, own, own] / poles[own]
    s = np.log(poles[own])
    growth = (s.conj() * d_log).real / np.abs(s)
    damping = (s.real * growth / np.abs(s) - d_log.real) / np.abs(s)
    first = np.abs(shapes[:, own]).argmax(axis=0), np.arange(own.size)
    change = d_shapes[:, :, own]
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = change / shapes[:, own]
        moved = (moved - 2.0 * moved[:, first[0], first[1]][:, np.newaxis]).transpose(0, 2, 1)
        mass = moved[..., np.newaxis] - (d_fed / fed)[:, own, np.newaxis]
    relative = shapes[:, own] / shapes[:, own][first]
    change = (change - relative * change[:, first[0], first[1]][:, np.newaxis]) / shapes[:, own][first]
    change[:, first[0], first[1]] = 0.0
    into = model.scaling.input_scale
    return Uncertainty(
        method="output error",
        frequency_std=np.linalg.norm(growth, axis=0) / (2 * np.pi * model.whole.dt),
        damping_ratio_std=np.where(np.angle(wanted) != 0.0, np.linalg.norm(damping, axis=0), 0.0),
        shape_std=np.sqrt(np.square(np.abs(change)).sum(axis=0)).T,
        mass_std=np.linalg.norm(mass.real, axis=0),
        markov_std=_markov_deviations(form, A, dA, model, n_lags) * (size[:, np.newaxis] / into),
        degrees_of_freedom=max(1.0, n_rows_of(model.fit.data) - model.fit.n_numbers / size.size),
    )


def _markov_deviations(form: _Form, A: ComplexArray, dA: ComplexArray, model: NoiseModel, n_lags: int) -> FloatArray:
    """(n_lags + 1, n_outputs, n_inputs) of D and C A^(k-1) B with B the participations of the inputs + K D."""
    m, D = form.d_direct.shape[2], model.whole.D
    deviations = np.zeros((n_lags + 1, *D.shape))
    if not m:
        return deviations
    K, dK = form.feed[:, m:], form.d_feed[:, :, m:]
    reach, d_reach = form.feed[:, :m] + K @ D, form.d_feed[:, :, :m] + dK @ D + K @ form.d_direct
    deviations[0] = np.linalg.norm(form.d_direct, axis=0)
    for k in range(1, n_lags + 1):
        deviations[k] = np.linalg.norm((form.d_shapes @ reach + form.shapes @ d_reach).real, axis=0)
        d_reach = dA @ reach + A @ d_reach
        reach = A @ reach
    return deviations


def _form(fit: LikeliestFit) -> _Form:
    parameters, linear, layout = fit.step.parameters, fit.step.linear, fit.step.layout
    theta, coefficients = _loadings(fit)
    n, n_in = layout.n_poles, layout.n_inputs
    places = layout.n_sensitivities
    complex_ = (theta[:, :places] + 1j * theta[:, places:]).reshape(theta.shape[0], -1, n)
    d_poles, d_feed = complex_[:, 0] * parameters.poles, complex_[:, 1 : 1 + n_in].transpose(0, 2, 1)
    d_c = (coefficients[:, :n] - 1j * coefficients[:, n : 2 * n]).transpose(0, 2, 1)
    pair = parameters.is_pair
    half = np.where(pair, 0.5, 1.0)

    def with_conjugates(values: ComplexArray, axis: int) -> ComplexArray:
        return np.concatenate([values, np.compress(pair, values, axis=axis).conj()], axis=axis)

    return _Form(
        poles=with_conjugates(parameters.poles, 0),
        feed=with_conjugates(parameters.inputs, 0),
        shapes=with_conjugates(linear.shapes * half, 1),
        d_poles=with_conjugates(d_poles, 1),
        d_feed=with_conjugates(d_feed, 1),
        d_shapes=with_conjugates(d_c * half, 2),
        d_direct=coefficients[:, 2 * n : 2 * n + layout.n_direct].transpose(0, 2, 1),
    )


def _loadings(fit: LikeliestFit) -> tuple[FloatArray, FloatArray]:
    """(n_changes, 2 n_sensitivities) and (n_changes, n_regressors, n_outputs): independent changes of unit variance."""
    step, layout = fit.step, fit.step.layout
    slopes = fit.coordinates.slopes(step.parameters)
    # R with the degrees of freedom taken off, so that W R = 1 scaled
    R = fit.covariance
    normal = step_equations(step, weights=inverse_covariance(R), coordinates=fit.coordinates)
    theta = (slopes @ inverse_root(normal.matrix)).T
    (sums,) = step.sums  # a predictor needs every output of a row
    gram, factor = sums.gram, sums.inverse_factor
    phi, c = layout.regressors, step.linear.shapes.T[layout.owners]
    inverse = factor.T @ factor
    n = layout.n_sensitivities
    real, imaginary = theta[:, :n], theta[:, n:]
    # change of the outputs: sum of Re(c (real + i imaginary) s); what the regressors take up of it
    weighted = (real + 1j * imaginary)[:, :, np.newaxis] * c
    products = np.tensordot(weighted.real, gram[layout.real, phi], axes=(1, 0))
    products -= np.tensordot(weighted.imag, gram[layout.imaginary, phi], axes=(1, 0))
    taken = -np.einsum("son,nk->sko", products, inverse)
    own = np.einsum("kn,oq->kqno", factor, np.linalg.cholesky(R))
    own = own.reshape(-1, layout.n_regressors, layout.n_outputs)
    return np.vstack([theta, np.zeros((own.shape[0], theta.shape[1]))]), np.concatenate([taken, own])


def mean_by_information(values: Sequence[float], deviations: Sequence[float]) -> tuple[float, float]:
    """Average by information and its deviation; the plain one and nan where a deviation is not known.

    Example:
        >>> [round(one, 4) for one in mean_by_information([1.0, 2.0], [0.1, 0.2])]
        [1.2, 0.0894]
    """
    value, std = np.array(values), np.array(deviations)
    if not value.size:
        return float("nan"), float("nan")
    if not (np.isfinite(std).all() and (std > 0.0).all()):
        return float(value.mean()), float("nan")
    weight = std**-2.0
    return float((weight * value).sum() / weight.sum()), float(weight.sum() ** -0.5)
