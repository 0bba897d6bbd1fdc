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
        d_poles: (n_nonlinear, n) by the first changes; the others are of the linear part alone.
        d_feed: (n_nonlinear, n, n_inputs + n_outputs).
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
    K, D = form.feed[:, m:], model.whole.D
    poles, right = np.linalg.eig(np.diag(form.poles) + K @ form.shapes)
    left = np.linalg.inv(right)
    shapes, fed = (form.shapes @ right) * size[:, np.newaxis], left @ (form.feed[:, :m] + K @ D)
    wanted, _ = discrete_poles(tuple(modes), model.whole.dt)
    own = np.abs(wanted[:, np.newaxis] - poles).argmin(axis=1) if wanted.size else np.empty(0, dtype=np.intp)
    frequency_std, damping_std = np.zeros((2, own.size))
    shape_std, mass_std = np.zeros((own.size, size.size)), np.zeros((own.size, size.size, m))
    for k, i in enumerate(own.tolist()):
        others = np.divide(1.0, poles[i] - poles, out=np.zeros_like(poles), where=poles != poles[i])
        v, w = right[:, i], left[i]
        seen = form.d_shapes @ v
        moved = seen @ K.T  # dA v
        moved[: len(form.d_poles)] += form.d_feed[:, :, m:] @ (form.shapes @ v) + form.d_poles * v
        d_log = moved @ w / poles[i]
        s = np.log(poles[i])
        growth = (s.conj() * d_log).real / np.abs(s)
        damping = (s.real * growth / np.abs(s) - d_log.real) / np.abs(s)
        frequency_std[k] = np.linalg.norm(growth) / (2 * np.pi * model.whole.dt)
        damping_std[k] = np.linalg.norm(damping) if np.angle(wanted[k]) != 0.0 else 0.0
        change = seen * size + moved @ ((shapes * others) @ left).T
        shape, first = shapes[:, i], int(np.abs(shapes[:, i]).argmax())
        relative = (change - (shape / shape[first]) * change[:, [first]]) / shape[first]
        relative[:, first] = 0.0
        shape_std[k] = np.linalg.norm(relative, axis=0)
        if m:
            with np.errstate(divide="ignore", invalid="ignore"):
                drifts = change / shape
                drifts -= 2.0 * drifts[:, [first]]
                mass = drifts[:, :, np.newaxis] - (_fed(form, w, right * others, fed, D) / fed[i])[:, np.newaxis]
            mass_std[k] = np.linalg.norm(mass.real, axis=0)
    return Uncertainty(
        method="output error",
        frequency_std=frequency_std,
        damping_ratio_std=damping_std,
        shape_std=shape_std,
        mass_std=mass_std,
        markov_std=_markov_deviations(form, model, n_lags) * (size[:, np.newaxis] / model.scaling.input_scale),
        degrees_of_freedom=max(1.0, n_rows_of(model.fit.data) - model.fit.n_numbers / size.size),
    )


def _fed(form: _Form, w: ComplexArray, others: ComplexArray, fed: ComplexArray, D: FloatArray) -> ComplexArray:
    """(n_changes, n_inputs) of w_i (B + K D), with the left eigenvector's own change.

    Args:
        form: of the predictor.
        w: (n,) left eigenvector.
        others: (n, n) right eigenvectors over the distances of their eigenvalues from its own.
        fed: (n, n_inputs) of all of them.
        D: (n_outputs, n_inputs).
    """
    m, n = D.shape[1], len(form.d_poles)
    K, dK = form.feed[:, m:], np.tensordot(form.d_feed[:, :, m:], w, axes=(1, 0))
    moved = np.tensordot(form.d_shapes, w @ K, axes=(1, 0))  # w dA
    moved[:n] += dK @ form.shapes + form.d_poles * w
    change = np.tensordot(form.d_direct, w @ K, axes=(1, 0)) + moved @ (others @ fed)
    change[:n] += np.tensordot(form.d_feed[:, :, :m], w, axes=(1, 0)) + dK @ D
    return np.asarray(change)


def _markov_deviations(form: _Form, model: NoiseModel, n_lags: int) -> FloatArray:
    """(n_lags + 1, n_outputs, n_inputs) of D and C A^(k-1) B with B the participations of the inputs + K D."""
    D = model.whole.D
    m, n, at = D.shape[1], len(form.d_poles), np.arange(form.poles.size)
    deviations = np.zeros((n_lags + 1, *D.shape))
    if not m:
        return deviations
    K, dK = form.feed[:, m:], form.d_feed[:, :, m:]
    A, dA = np.diag(form.poles) + K @ form.shapes, K @ form.d_shapes
    dA[:n] += dK @ form.shapes
    dA[:n, at, at] += form.d_poles
    reach, d_reach = form.feed[:, :m] + K @ D, K @ form.d_direct
    d_reach[:n] += form.d_feed[:, :, :m] + dK @ D
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
    d_poles, d_feed = theta[:, 0] * parameters.poles, theta[:, 1 : 1 + n_in].transpose(0, 2, 1)
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


def _loadings(fit: LikeliestFit) -> tuple[ComplexArray, FloatArray]:
    """(n_nonlinear, n_families, n_poles) and (n_changes, n_regressors, n_outputs): independent, of unit variance."""
    step, layout = fit.step, fit.step.layout
    slopes = fit.coordinates.slopes(step.parameters)
    # R with the degrees of freedom taken off, so that W R = 1 scaled
    R = fit.covariance
    normal = step_equations(step, weights=inverse_covariance(R), coordinates=fit.coordinates)
    (sums,) = step.sums  # a predictor needs every output of a row
    gram, factor, phi, n = sums.gram, sums.inverse_factor, layout.regressors, layout.n_sensitivities
    both = (slopes @ inverse_root(normal.matrix)).T
    theta = (both[:, :n] + 1j * both[:, n:]).reshape(len(both), -1, layout.n_poles)
    # change of the outputs: sum over poles of Re(c sum over families of theta s); what the regressors take up of it
    told = (gram[layout.real, phi] + 1j * gram[layout.imaginary, phi]).reshape(*theta.shape[1:], layout.n_regressors)
    by_pole = np.matmul(theta.transpose(2, 0, 1), told.swapaxes(0, 1)) @ (factor.T @ factor)
    taken = -np.tensordot(by_pole, step.linear.shapes, axes=(0, 1)).real
    own = np.einsum("kn,oq->kqno", factor, np.linalg.cholesky(R))
    return theta, np.concatenate([taken, own.reshape(-1, layout.n_regressors, layout.n_outputs)])


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
