"""The innovation form: its chart by differences, its optimum and its information by an explicit loop over samples."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from crb import cramer_rao_bound
from noise_families import noise_record
from noisy import noisy_data, noisy_system
from systems import random_system, simulate

from era.realisation import Realisation
from modal.estimation.modal_parameters import errors_of
from modal.estimation.modal_states import ModalParameters
from modal.estimation.output_error import step_at, step_equations
from modal.estimation.prediction_error import (
    CanonicalVariates,
    Sections,
    innovation_form,
    likeliest,
    predictor_data,
    predictor_start,
    promised_criterion,
)
from modal.identification.information import innovation_uncertainty
from modal.identification.noise_model import NoiseModel, noise_model
from modal.identification.pipeline import identify
from modal.modes.extraction import extract_modes
from okid.record import Record
from okid.scaling import channel_scaling

CHART = Sections()
POLES = {
    "pairs": ([0.9 * np.exp(0.4j), 0.8 * np.exp(1.9j)], [True, True]),
    "a pair and two real poles": ([0.9 * np.exp(0.4j), 0.7, 0.5], [True, False, False]),
    "three real poles": ([0.9, -0.6, 0.3], [False, False, False]),
    "nearly double": ([0.7001, 0.6999, 0.9 * np.exp(0.4j)], [False, False, True]),
}


def parameters_of(rng, poles, is_pair):
    pair = np.array(is_pair)
    inputs, states = (rng.standard_normal((*shape, 2)) @ [1, 1j] for shape in ((pair.size, 4), (2, pair.size)))
    return ModalParameters(
        poles=np.array(poles, dtype=complex),
        is_pair=pair,
        inputs=np.where(pair[:, np.newaxis], inputs, inputs.real),
        states=np.where(pair, states, states.real),
    )


def records_of(rng):
    return [Record(rng.standard_normal((n, 2)), rng.standard_normal((n, 2)), 0.1) for n in (60, 80)]


@pytest.mark.parametrize("name", POLES)
def test_the_gradient_is_that_of_the_error_along_every_coordinate(name):
    rng = np.random.default_rng(3)
    records = records_of(rng)
    data = predictor_data(records, [record.complete_rows() for record in records])
    weights = np.array([[1.0, 0.3], [0.3, 2.0]])
    step = step_at(parameters_of(rng, *POLES[name]), data, weights=weights)
    found = step_equations(step, weights=weights, coordinates=CHART)
    size = 1e-6 / (1.0 + np.sqrt(np.diag(found.matrix) / step.error))
    for i, h in enumerate(size):
        at = np.where(np.arange(size.size) == i, h, 0.0)
        there = [step_at(CHART.moved(step.parameters, sign * at), data, weights=weights).error for sign in (1, -1)]
        assert (there[1] - there[0]) / (4 * h) == pytest.approx(
            found.gradient[i], rel=2e-3, abs=1e-5 * np.sqrt(found.matrix[i, i] * step.error)
        )


@pytest.mark.parametrize("name", POLES)
def test_as_many_numbers_count_as_matrices_in_no_particular_basis_have(name):
    """A, B - K D, K, C, a start of each record less a change of basis; D, and a level of each record."""
    poles, is_pair = POLES[name]
    rng = np.random.default_rng(3)
    records = records_of(rng)
    data = predictor_data(records, [record.complete_rows() for record in records])
    fit = likeliest(step_at(parameters_of(rng, poles, is_pair), data), data, CHART, rounds=0)
    n, m, q = len(poles) + sum(is_pair), 2, 2
    assert fit.n_numbers == n * n + n * (m + q) + q * n + 2 * n - n * n + q * m + 2 * q


def test_two_real_poles_become_a_pair_and_back_and_no_step_leaves_the_unit_circle():
    rng = np.random.default_rng(4)
    start = parameters_of(rng, [0.7, 0.5], [False, False])
    change = np.zeros(CHART.slopes(start).shape[1])
    change[1] = -0.02  # d from 0.01 to -0.01
    pair = CHART.moved(start, change)
    np.testing.assert_allclose(pair.poles, [0.6 + 0.1j])
    assert pair.is_pair.tolist() == [True]
    change[1] = 0.02
    back = CHART.moved(pair, change)
    np.testing.assert_allclose(back.poles, [0.7, 0.5])
    change[0] = 0.5
    assert CHART.moved(start, change) is None


def loop_errors(matrices, u, y):
    """One sample after the other."""
    A, B, C, D, K, start, level = matrices
    x, errors = start, np.empty_like(y)
    for k in range(len(y)):
        errors[k] = y[k] - C @ x - D @ u[k] - level
        x = A @ x + B @ u[k] + K @ errors[k]
    return errors


def fitted(seed, n_samples):
    rng = np.random.default_rng(seed)
    truth = noisy_system(rng, n_modes=2)
    u, y = noisy_data(rng, truth, n_samples)
    records = [Record(u, y, truth.system.dt)]
    s = truth.system
    data = predictor_data(records, [record.complete_rows() for record in records])
    start = predictor_start(Realisation(s.A, s.B, s.C, s.D, s.dt, K=truth.K), data)
    return truth, records, likeliest(start, data, CHART)


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_keeps_within_the_criterion_that_its_start_promises(seed):
    """The bound is twice the fall of an undamped step: where nothing is left to fall, it is the criterion itself."""
    rng, (truth, _, fit) = np.random.default_rng(seed), fitted(seed, 600)
    assert promised_criterion(fit.step, fit.data, CHART) == pytest.approx(fit.criterion, abs=1.0)
    s = truth.system
    gain = truth.K + 0.02 * rng.standard_normal(truth.K.shape)
    start = predictor_start(Realisation(s.A, s.B, s.C, s.D, s.dt, K=gain), fit.data)
    promised = promised_criterion(start, fit.data, CHART)
    at_start = likeliest(start, fit.data, CHART, rounds=0).criterion
    assert at_start - 10 * (at_start - fit.criterion) < promised < fit.criterion < at_start


def test_the_deviations_are_those_of_an_explicit_jacobian_of_all_matrices():
    truth, records, fit = fitted(5, 400)
    model = innovation_form(fit.step, truth.system.dt)
    (u, y), n = (records[0].inputs, records[0].outputs), model.order
    fitted_errors = errors_of(fit.step, fit.data)[0]
    shapes = [model.A.shape, model.B.shape, model.C.shape, model.D.shape, model.K.shape, (n,), (2,)]
    # states at the first sample and level by least squares, so that the loop starts where the fit does
    flat = np.concatenate([np.asarray(part).ravel() for part in (model.A, model.B, model.C, model.D, model.K)])

    def errors(theta):
        parts, at = [], 0
        for shape in shapes:
            parts.append(theta[at : at + int(np.prod(shape))].reshape(shape))
            at += int(np.prod(shape))
        return loop_errors(parts, u, y)

    theta = np.concatenate([flat, np.zeros(n + 2)])
    base = errors(theta)
    columns = [(errors(theta + h) - base).ravel() for h in np.eye(theta.size)[-n - 2 :]]
    theta[-n - 2 :] = np.linalg.lstsq(np.array(columns).T, (fitted_errors - base).ravel(), rcond=None)[0]
    np.testing.assert_allclose(errors(theta), fitted_errors, atol=1e-5 * y.std())
    steps = 1e-6 * np.eye(theta.size)
    J = np.array([(errors(theta + h) - errors(theta - h)) / 2e-6 for h in steps])
    weighted = np.einsum("pko,oq->pkq", J, np.linalg.inv(fit.covariance))
    covariance = np.linalg.pinv(np.einsum("pko,qko->pq", weighted, J), rcond=1e-9, hermitian=True)
    scaling = channel_scaling(records)
    one = np.ones(2)
    scaling = type(scaling)(
        **{
            field: (one if field.endswith("scale") else 0 * one)
            for field in ("input_mean", "input_scale", "output_mean", "output_scale")
        }
    )
    noise = NoiseModel(
        fit=fit, whole=model, realisation=model, scaling=scaling, n_noise=0, whiteness_ratio=1.0, gained=1.0
    )
    modes = extract_modes(model).modes
    found = innovation_uncertainty(noise, modes, n_lags=3)

    def numbers(theta):
        poles = np.linalg.eigvals(theta[: n * n].reshape(n, n))
        s = np.log(poles[poles.imag > 0]) / truth.system.dt
        s = s[np.argsort(np.abs(s))]
        return np.concatenate([np.abs(s) / (2 * np.pi), -s.real / np.abs(s)])

    slopes = np.array([(numbers(theta + h) - numbers(theta - h)) / 2e-6 for h in steps]).T
    expected = np.sqrt(np.einsum("ap,pq,aq->a", slopes, covariance, slopes))
    np.testing.assert_allclose(np.concatenate([found.frequency_std, found.damping_ratio_std]), expected, rtol=1e-3)
    markov = [model.D, model.C @ model.B]
    for k in (0, 1):
        entry = np.empty_like(markov[k])
        for i, j in np.ndindex(entry.shape):

            def pulse(theta, i=i, j=j, k=k):
                parts, at = [], 0
                for shape in shapes:
                    parts.append(theta[at : at + int(np.prod(shape))].reshape(shape))
                    at += int(np.prod(shape))
                return parts[3][i, j] if k == 0 else parts[2][i] @ parts[1][:, j]

            slope = np.array([(pulse(theta + h) - pulse(theta - h)) / 2e-6 for h in steps])
            entry[i, j] = np.sqrt(slope @ covariance @ slope)
        np.testing.assert_allclose(found.markov_std[k], entry, rtol=1e-3)


def test_the_fit_is_near_the_true_gain_and_no_worse_than_the_truth():
    truth, records, fit = fitted(6, 6000)
    model, s = innovation_form(fit.step, truth.system.dt), truth.system
    true_errors = loop_errors(
        (s.A, s.B, s.C, s.D, truth.K, np.zeros(s.order), np.zeros(2)), records[0].inputs, records[0].outputs
    )
    R = true_errors.T @ true_errors / len(true_errors)
    assert fit.log_likelihood < len(true_errors) * np.linalg.slogdet(R)[1]
    np.testing.assert_allclose(fit.covariance, truth.covariance, rtol=0.1, atol=0.05 * np.trace(truth.covariance))
    found, wanted = model.C @ model.K, s.C @ truth.K
    np.testing.assert_allclose(found, wanted, atol=0.2 * np.abs(wanted).max())


def test_a_fit_whose_errors_cannot_become_white_ends_where_its_rounds_do_not_promise_as_much():
    """The excess of the fit is counted from a start that is far from the optimum, whose first round falls much."""
    truth, _, fit = fitted(6, 1500)
    s = truth.system
    start = predictor_start(Realisation(s.A * 0.97, s.B, s.C, s.D, s.dt, K=0.5 * truth.K), fit.data)
    sizes = {}
    for excess in (0.0, 1e3, np.inf):
        asked = []
        found = likeliest(start, fit.data, CHART, excess=lambda step: asked.append(step) or excess)  # noqa: B023 called here
        sizes[excess] = len(asked), found.log_likelihood
    assert sizes[0.0][1] < sizes[np.inf][1]
    assert sizes[np.inf][0] == 1 <= sizes[1e3][0] <= sizes[0.0][0]


def test_outputs_that_foretell_each_other_leave_a_covariance_that_can_be_used():
    """Fewer things drive the outputs than there are, and no noise: rounding may make its least eigenvalue negative."""
    _, _, fit = fitted(6, 1500)
    rank_one = np.outer([1.0, 2.0], [1.0, 2.0])
    linear = replace(fit.step.linear, error_products=rank_one - 1e-14 * np.eye(2))
    values = np.linalg.eigvalsh(replace(fit, step=replace(fit.step, linear=linear)).covariance)
    assert 0.0 < values[0] < 2e-6 * values[1]


def ambient_outputs(frequencies, ratio, n_outputs, n_samples, dt):
    """Modes that each have a white force of their own, seen by more or fewer sensors, with white noise on each."""
    rng = np.random.default_rng(20)
    s = 2 * np.pi * frequencies * (-ratio + 1j * np.sqrt(1 - ratio**2))
    recursion = [np.poly(np.exp(np.array([pole, pole.conjugate()]) * dt)).real for pole in s]
    forces = rng.standard_normal((frequencies.size, n_samples + 2000))
    motion = [scipy.signal.lfilter([1.0], row, force)[2000:] for row, force in zip(recursion, forces, strict=True)]
    y = np.array([one / one.std() for one in motion]).T @ rng.standard_normal((frequencies.size, n_outputs))
    return y + 0.05 * y.std(axis=0) * rng.standard_normal(y.shape)


def test_canonical_variates_know_the_order_and_every_mode_before_the_first_step():
    frequencies, dt = np.linspace(3.0, 40.0, 12), 0.01
    record = Record([], ambient_outputs(frequencies, 0.01, 6, 20000, dt), dt)
    variates = CanonicalVariates.of([record])
    assert variates.order == 24
    model = variates.predictor(24)
    found = np.log(np.linalg.eigvals(model.A)) / dt
    found = found[found.imag > 0]
    assert np.abs(np.abs(found)[:, np.newaxis] / (2 * np.pi * frequencies) - 1.0).min(axis=0).max() < 0.01
    assert (-found.real / np.abs(found)).max() < 0.03
    assert CanonicalVariates.of([Record([], np.tile(record.outputs[:, :1], 2), dt)]) is None


def driven_outputs(seed, n_rows, noise_poles):
    """Two modes, one coloured input with a direct part, three sensors, each with autoregressive noise of its own."""
    rng = np.random.default_rng(seed)
    s = random_system(rng, n_modes=2, n_inputs=1, n_outputs=3, close_pair=None, weak_mode=None)
    u = scipy.signal.lfilter([1.0], [1.0, -0.6], rng.standard_normal((n_rows, 1)), axis=0)
    y, white = simulate(s, u), rng.standard_normal((n_rows, 3))
    noise = np.array(
        [scipy.signal.lfilter([1.0], np.poly(poles).real, white[:, i]) for i, poles in enumerate(noise_poles)]
    )
    sizes = 0.2 * y.std(axis=0) / noise.std(axis=1)
    start = Realisation(s.A, s.B, s.C, s.D, s.dt, K=np.zeros((s.order, 3)))
    return s, Record(u, y + noise.T * sizes, s.dt), start, sizes


@pytest.mark.parametrize(("kind", "system", "order"), [("force", 603, 6), ("loop", 61000, 8)])
def test_canonical_variates_of_driven_records_know_the_order_in_open_and_closed_loop(kind, system, order):
    case = noise_record(kind, system=system, record=0)
    variates = CanonicalVariates.of([Record(case.inputs, case.outputs, case.system.dt)])
    assert variates.order == order == case.system.order
    found = np.log(np.linalg.eigvals(variates.predictor(order).A)) / case.system.dt
    found = found[found.imag > 0]
    assert np.abs(np.abs(found)[:, np.newaxis] / (2 * np.pi * case.system.frequencies) - 1.0).min(axis=0).max() < 0.02


def test_noise_of_many_states_is_modelled_and_the_system_keeps_its_own():
    """No count of noise states is tried: four and twelve of them, each as many as there are."""
    resonant = [
        [0.9 * np.exp(sign * angle * 1j) for angle in (0.4 + 0.2 * i, 1.8) for sign in (1, -1)] for i in range(3)
    ]
    for poles in (([0.9], [0.8], [-0.6, 0.7]), resonant):
        _, record, start, _ = driven_outputs(3, 3000, poles)
        found, why = noise_model([record], start, evidence=start)
        assert found is not None, why
        assert (found.realisation.order, found.n_noise) == (4, sum(map(len, poles)))


@pytest.mark.parametrize("seed", [2, 3])
def test_modes_are_as_well_known_as_the_noise_of_the_sensors_allows_and_no_better(seed):
    """A gain of modes that no noise drives fits the noise in their band by chance: they seem better known, or worse."""
    s, record, start, sizes = driven_outputs(seed, 4000, [[0.8, -0.5]] * 3)
    found, why = noise_model([record], start, evidence=start)
    assert found is not None, why
    modes = extract_modes(found.realisation).modes
    known = innovation_uncertainty(found, modes, n_lags=1)
    # filtered by the autoregression of all sensors the noise is white, and the system is the same
    inputs = scipy.signal.lfilter(np.poly([0.8, -0.5]), [1.0], record.inputs, axis=0)
    bound = cramer_rao_bound(s, inputs, initial_state=np.zeros(s.order), noise_std=sizes, level="unknown")
    np.testing.assert_allclose(known.frequency_std, bound.frequency_std, rtol=0.06)
    np.testing.assert_allclose(known.damping_ratio_std, bound.damping_ratio_std, rtol=0.06)
    assert (np.abs([mode.frequency for mode in modes] - s.frequencies) < 4.0 * bound.frequency_std).all()


def test_states_that_held_out_rows_ask_for_in_vain_are_left_out():
    """Where hidden forces ring on from block to block, held-out rows take their answers for modes."""
    case = noise_record("force", system=603, record=0)
    s, record = case.system, Record(case.inputs, case.outputs, case.system.dt)
    vain = np.exp((-0.01 + 1j) * np.array([0.29, 0.66]))  # beside two of the modes
    A = scipy.linalg.block_diag(s.A, *([[pole.real, -pole.imag], [pole.imag, pole.real]] for pole in vain))
    rng = np.random.default_rng(0)
    B = np.vstack([s.B, 0.1 * s.B.std() * rng.standard_normal((4, s.n_inputs))])
    C = np.hstack([s.C, s.C.std() * rng.standard_normal((s.n_outputs, 4))])
    start = Realisation(A, B, C, s.D, s.dt, K=np.zeros((s.order + 4, s.n_outputs)))
    found, why = noise_model([record], start, evidence=start)
    assert found is not None, why
    assert (found.realisation.order, found.n_noise) == (s.order, 0)


def test_a_predictor_whose_errors_follow_the_inputs_is_not_taken():
    """An echo later than any order that its noise would pay for leaves errors that are white all the same."""
    s, record, start, _ = driven_outputs(5, 4000, ([0.9], [0.8], [0.7]))
    rng = np.random.default_rng(6)
    outputs = record.outputs.copy()
    u = rng.standard_normal((4000, 1))
    outputs += simulate(s, u) - simulate(s, record.inputs)
    outputs[18:] += 0.02 * outputs.std() * u[:-18]
    found, why = noise_model([Record(u, outputs, s.dt)], start, evidence=start)
    assert found is None
    assert "follow the inputs" in why


def released_while_driven(n_at_rest):
    """A decay of 1500 rows in two outputs, a fiftieth of it ambient motion of the same modes, after rows of rest."""
    rng, poles = np.random.default_rng(12), (0.99 * np.exp(0.3j), 0.985 * np.exp(0.9j))
    A = scipy.linalg.block_diag(*([[pole.real, pole.imag], [-pole.imag, pole.real]] for pole in poles))
    C = rng.standard_normal((2, 4))
    start = Realisation(A, np.ones((4, 1)), C, np.zeros((2, 1)), 0.01, K=0.01 * rng.standard_normal((4, 2)))
    y, x = np.zeros((n_at_rest + 1501, 2)), np.ones(4)
    for row in y[n_at_rest + 1 :]:
        row[:] = C @ x + 0.001 * rng.standard_normal(2)
        x = A @ x + 0.02 * rng.standard_normal(4)
    release = np.zeros((len(y), 1))
    release[n_at_rest] = 1.0
    return start, Record(release, y, 0.01)


def test_rows_of_rest_say_that_the_state_is_zero_and_nothing_of_the_noise():
    """They stand before a release for the observer's sake, and were not measured: more of them change nothing."""
    seen = []
    for n_at_rest in (40, 400):
        start, record = released_while_driven(n_at_rest)
        found, why = noise_model([record], start, evidence=start)
        assert found is not None, why
        assert (found.realisation.order, found.n_noise) == (4, 0)
        assert not found.fit.step.parameters.states.any()
        modes = extract_modes(found.realisation).modes
        known = innovation_uncertainty(found, modes, n_lags=1)
        seen.append([found.covariance.ravel(), [m.frequency for m in modes], known.frequency_std])
        error = np.sort([m.frequency for m in modes]) - np.array([0.3, 0.9]) / (2 * np.pi * 0.01)
        assert (np.abs(error) < 4 * known.frequency_std).all()
    for short, long in zip(*seen, strict=True):
        np.testing.assert_allclose(long, short, rtol=0.02)


def test_where_output_error_has_no_model_that_runs_there_may_be_one_with_its_noise():
    """Free exponentials that follow what drives a decay end on the unit circle, where rounding lets them grow."""
    start, record = released_while_driven(40)
    A = scipy.linalg.block_diag(start.A, 1.0 + 1e-8)
    grows = Realisation(A, np.ones((5, 1)), np.ones((2, 5)), start.D, start.dt, K=np.zeros((5, 2)))
    found, why = noise_model([record], grows, evidence=grows)
    assert found is not None, why
    assert found.realisation.order == 4
    assert "runs" in why


def test_forces_that_nobody_measured_are_the_noise_of_modes_that_the_inputs_hardly_drive():
    """Two hidden forces as large as the measured one: white errors on the outputs were assumed for want of a better."""
    case = noise_record("hidden", system=13000, record=0)
    given = {"observer_order": 20, "ridge": 0.0, "order": 12, "input_delay": 0}  # as a search would, about
    result = identify(Record(case.inputs, case.outputs, case.system.dt), **given)
    (noise,) = [choice for choice in result.choices if choice.what == "noise"]
    assert str(noise.value).startswith("innovation form")
    assert "white (ratio" in noise.reason
    for mode in result.modes.system:
        i = np.abs(case.system.frequencies - mode.frequency).argmin()
        assert abs(mode.frequency - case.system.frequencies[i]) < 4.0 * mode.frequency_std
        assert abs(mode.damping_ratio - case.system.damping_ratios[i]) < 4.0 * mode.damping_ratio_std


def test_a_far_too_long_observer_makes_no_mode_of_ambient_motion():
    """Three modes, and eight states of the noise of six sensors."""
    case = noise_record("coloured", system=61000, record=0)
    result = identify(Record([], case.outputs, case.system.dt), observer_order=90)
    assert result.fitted_model.order <= 1.3 * (6 + 8)
    certain = np.array([mode.frequency for mode in result.modes.system])
    np.testing.assert_allclose(certain, case.system.frequencies, rtol=0.01)
