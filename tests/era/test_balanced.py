"""ERA on systems whose truth is known, and what may not change it."""

import numpy as np
import pytest
import scipy
import systems
from containers import markov_parameters
from hypothesis import example, given, settings
from hypothesis import strategies as st
from systems import chain_matrices, markov, modal_system, pole_distance, pulse_response, random_system, structure

from era.balanced import decompose, realise, realise_data_correlation, realise_from
from okid.errors import InsufficientDataError, InvalidDataError
from okid.markov import MarkovParameters, recover_markov
from okid.observer import fit_observer
from okid.record import Record


def textbook_era(h, a, b, order):
    """Juang, Pappa 1985: two Hankel matrices by loops, numpy's SVD, all products written out."""
    _, q, m = h.shape
    H0, H1 = (
        np.vstack([np.hstack([h[1 + s + i + j] for j in range(b)]) for i in range(a)])
        for s in (0, 1)
    )  # fmt: skip
    U, s, Vt = np.linalg.svd(H0)
    U, S, V = U[:, :order], np.diag(np.sqrt(s[:order])), Vt[:order].T
    Si = np.linalg.inv(S)
    return Si @ U.T @ H1 @ V @ Si, (S @ V.T)[:, :m], (U @ S)[:q]


@pytest.mark.parametrize("method", ["full", "randomised"])
@pytest.mark.parametrize(("n_inputs", "n_outputs", "n_real"), [(1, 1, 0), (2, 3, 1), (1, 4, 0), (3, 1, 2)])
def test_noise_free_systems_are_exact(method, n_inputs, n_outputs, n_real):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        system = random_system(rng, n_inputs=n_inputs, n_outputs=n_outputs, n_real_poles=n_real)
        model = realise(markov_parameters(system), method=method)
        assert model.order == system.order
        assert pole_distance(np.linalg.eigvals(system.A), np.linalg.eigvals(model.A)) < 1e-10
        truth = markov(system, 160)  # twice as far as the data reached
        np.testing.assert_allclose(pulse_response(model, 160), truth, atol=1e-9 * np.abs(truth).max())


@pytest.mark.parametrize(
    ("way", "second", "n_lags", "atol"), [(realise, 5.02, 300, 1e-10), (realise_data_correlation, 5.1, 400, 1e-9)]
)
def test_close_modes_are_told_apart(way, second, n_lags, atol):
    system = modal_system(np.random.default_rng(1), frequencies=[5.0, second], damping_ratios=[0.01, 0.01], n_outputs=2)
    model = way(markov_parameters(system, n_lags), order=4)
    assert pole_distance(np.linalg.eigvals(system.A), np.linalg.eigvals(model.A)) < atol


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("order", [3, 6])
def test_equals_the_textbook_computation(noise, order):
    rng = np.random.default_rng(7)
    h = markov(random_system(rng), 60)
    h += noise * rng.standard_normal(h.shape)
    model = realise(MarkovParameters(system=h, dt=0.01), order=order, n_block_rows=25, n_block_columns=30)
    A, B, C = textbook_era(h, 25, 30, order)
    sign = np.sign((model.C * C).sum(axis=0))
    np.testing.assert_allclose(model.A, sign[:, np.newaxis] * A * sign, atol=1e-10)
    np.testing.assert_allclose(model.B, sign[:, np.newaxis] * B, atol=1e-10)
    np.testing.assert_allclose(model.C, C * sign, atol=1e-10)


def test_shear_frame_of_the_koma_package():
    """KOMA's shear frame of five storeys: 0.1812 0.5289 0.8338 1.0711 1.2217 Hz, that is k/m = 16."""
    mass, damping, stiffness = chain_matrices([1.0] * 5, [16.0] * 5, [0.05] * 5)
    frame = structure(
        mass, damping, stiffness, force_dofs=[0, 2], sensor_dofs=range(5), sensor_kinds="acceleration", dt=0.1
    )
    model = realise(markov_parameters(frame, 200))
    poles = np.log(np.linalg.eigvals(model.A).astype(complex)) / 0.1
    frequencies = np.sort(np.abs(poles[poles.imag > 0])) / (2 * np.pi)
    np.testing.assert_allclose(frequencies, [0.1812, 0.5289, 0.8338, 1.0711, 1.2217], atol=5e-5)


def test_struck_mass_by_its_closed_form():
    """One pulse held for dt: det A = exp(-2 sigma dt), trace A = 2 exp(-sigma dt) cos(wd dt)."""
    m, c, k, dt = 1.0, 0.4, 4.0, 0.1
    w0, zeta = np.sqrt(k / m), c / (2 * np.sqrt(k * m))
    sigma, wd = zeta * w0, w0 * np.sqrt(1 - zeta**2)

    def step(t):  # response to a unit force switched on at 0
        return (1 - np.exp(-sigma * t) * (np.cos(wd * t) + sigma / wd * np.sin(wd * t))) / k

    t = dt * np.arange(1, 50)
    pulse = np.concatenate([[0.0], step(t) - step(t - dt)])
    model = realise(MarkovParameters(system=pulse[:, None, None], dt=dt))
    assert model.order == 2
    assert np.linalg.det(model.A) == pytest.approx(np.exp(-2 * sigma * dt), abs=1e-12)
    assert np.trace(model.A) == pytest.approx(2 * np.exp(-sigma * dt) * np.cos(wd * dt), abs=1e-12)


def test_lower_orders_are_corners_of_one_decomposition():
    rng = np.random.default_rng(2)
    h = markov(random_system(rng), 60)
    h += 0.01 * rng.standard_normal(h.shape)
    parameters = MarkovParameters(system=h, dt=0.01)
    found = decompose(parameters)
    for order in (0, 1, 4, 9):
        nested, alone = realise_from(found, order), realise(parameters, order=order)
        again = realise_from(found, 9).truncated(order)
        for one, other in ((nested, alone), (nested, again)):
            np.testing.assert_allclose(pulse_response(one, 20), pulse_response(other, 20), atol=1e-12)
        assert nested.factors.observability.shape[1] == order == again.factors.controllability.shape[0]


def test_factors_rebuild_the_scaled_hankel_matrix():
    system = random_system(np.random.default_rng(3))
    scales = {"input_scale": np.array([2.0, 30.0]), "output_scale": np.array([0.1, 1.0, 50.0])}
    parameters = markov_parameters(system, 30, **scales)
    factors = realise(parameters, order=6, n_block_rows=10, n_block_columns=15).factors
    h = parameters.system * scales["input_scale"] / scales["output_scale"][:, None]
    whole = np.vstack([np.hstack([h[1 + i + j] for j in range(15)]) for i in range(10)])
    rebuilt = factors.observability @ factors.controllability
    np.testing.assert_allclose(rebuilt, whole, atol=1e-12 * np.abs(whole).max())
    balance = factors.observability.T @ factors.observability
    np.testing.assert_allclose(balance, factors.controllability @ factors.controllability.T, atol=1e-9)


factor = st.floats(1e-3, 1e3)


@pytest.mark.parametrize(("way", "atol", "rtol"), [(realise, 1e-9, 1e-7), (realise_data_correlation, 1e-7, 1e-6)])
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), input_factor=factor, output_factor=factor)
def test_units_change_b_and_c_and_no_pole(way, *, atol, rtol, seed, input_factor, output_factor):
    rng = np.random.default_rng(seed)
    h = markov(random_system(rng, n_modes=2), 40)
    h += 0.01 * rng.standard_normal(h.shape)
    first = way(MarkovParameters(system=h, dt=0.01), order=4)
    changed = h.copy()
    changed[:, :, 0] *= input_factor
    changed[:, 1] *= output_factor
    scales = {"input_scale": [1 / input_factor, 1.0], "output_scale": [1.0, output_factor, 1.0]}
    second = way(MarkovParameters(system=changed, dt=0.01, **scales), order=4)
    np.testing.assert_allclose(np.poly(second.A), np.poly(first.A), atol=atol)
    np.testing.assert_allclose(second.singular_values, first.singular_values, rtol=atol)  # squares of ERA/DC: 1e-7
    response = pulse_response(first, 20)
    response[:, :, 0] *= input_factor
    response[:, 1] *= output_factor
    np.testing.assert_allclose(pulse_response(second, 20), response, rtol=rtol, atol=atol * np.abs(response).max())


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.permutations([0, 1, 2]), st.permutations([0, 1]))
def test_permuted_channels_permute_the_model(seed, outputs, inputs):
    rng = np.random.default_rng(seed)
    h = markov(random_system(rng, n_modes=2), 40)
    h += 0.01 * rng.standard_normal(h.shape)
    plain = pulse_response(realise(MarkovParameters(system=h, dt=0.01), order=4), 20)
    turned = pulse_response(realise(MarkovParameters(system=h[:, outputs][:, :, inputs], dt=0.01), order=4), 20)
    np.testing.assert_allclose(turned, plain[:, outputs][:, :, inputs], atol=1e-9 * np.abs(plain).max())


@settings(max_examples=25, deadline=None)
@example(39293)
@given(st.integers(0, 2**31))
def test_a_similarity_transform_of_the_truth_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    system = random_system(rng, n_modes=2)
    left, right = (np.linalg.qr(rng.standard_normal((4, 4)))[0] for _ in range(2))
    T = left @ np.diag([0.5, 0.8, 1.2, 2.0]) @ right  # well conditioned: rounding is no part of the claim
    h, A = markov(system, 40), T @ system.A @ np.linalg.inv(T)
    B, C = T @ system.B, system.C @ np.linalg.inv(T)
    transformed = np.array([system.D] + [C @ np.linalg.matrix_power(A, k) @ B for k in range(40)])
    poles = [np.linalg.eigvals(realise(MarkovParameters(system=x, dt=0.01), order=4).A) for x in (h, transformed)]
    assert pole_distance(*poles) < 1e-7


def test_twice_dt_halves_frequency_by_the_definition_of_dt():
    h = markov(random_system(np.random.default_rng(5)), 60)
    models = [realise(MarkovParameters(system=h, dt=dt), order=6) for dt in (0.01, 0.02)]
    fast, slow = (np.sort(np.abs(np.log(np.linalg.eigvals(x.A).astype(complex))) / x.dt) for x in models)
    np.testing.assert_allclose(slow, fast / 2, rtol=1e-12)


def test_gain_of_a_riccati_predictor_is_recovered():
    rng = np.random.default_rng(8)
    system = random_system(rng)
    Q, R = 0.1 * np.eye(system.order), np.diag([1.0, 0.5, 2.0])
    P = scipy.linalg.solve_discrete_are(system.A.T, system.C.T, Q, R)
    K = system.A @ P @ system.C.T @ np.linalg.inv(system.C @ P @ system.C.T + R)
    powers = [np.linalg.matrix_power(system.A, k) for k in range(80)]
    g = np.array([np.eye(3)] + [system.C @ power @ K for power in powers])
    scales = {"input_scale": [3.0, 0.2], "output_scale": [0.5, 1.0, 7.0]}
    parameters = markov_parameters(system, gain=g, **scales)
    for choice in ("system", "system_and_gain"):
        model = realise(parameters, order=6, realise_on=choice)
        found = np.array([model.C @ np.linalg.matrix_power(model.A, k) @ model.K for k in range(40)])
        np.testing.assert_allclose(found, g[1:41], atol=1e-9 * np.abs(g[1:]).max())
        expected = np.linalg.eigvals(system.A - K @ system.C)
        assert pole_distance(expected, np.linalg.eigvals(model.A - model.K @ model.C)) < 1e-8
        np.testing.assert_allclose(pulse_response(model, 40), parameters.system[:41], atol=1e-9)
    output_only = MarkovParameters(system=np.zeros((81, 3, 0)), gain=g, dt=system.dt, output_scale=[0.5, 1.0, 7.0])
    model = realise(output_only)
    assert (model.order, model.B.shape, model.D.shape) == (6, (6, 0), (3, 0))
    found = np.array([model.C @ np.linalg.matrix_power(model.A, k) @ model.K for k in range(40)])
    np.testing.assert_allclose(found, g[1:41], atol=1e-9 * np.abs(g[1:]).max())


def test_without_a_gain_there_is_no_k():
    assert realise(markov_parameters(random_system(np.random.default_rng(0)))).K is None


@pytest.mark.parametrize("way", [realise, realise_data_correlation])
def test_pure_feedthrough_is_a_model_of_order_zero(way):
    model = way(MarkovParameters(system=np.stack([np.eye(2), *np.zeros((9, 2, 2))]), dt=0.1))
    assert (model.order, model.B.shape, model.C.shape) == (0, (0, 2), (2, 0))
    np.testing.assert_array_equal(model.D, np.eye(2))


def test_an_order_above_the_rank_is_an_error_with_numbers():
    parameters = markov_parameters(random_system(np.random.default_rng(0)))
    for method in ("full", "randomised"):
        with pytest.raises(InsufficientDataError, match=r"model order 8 .* numerical rank 6 .* at most 6") as told:
            realise(parameters, order=8, method=method)
        largest = decompose(parameters, method=method, max_order=6).singular_values[0]
        assert f"largest singular value {largest:.3g}" in str(told.value)


def test_too_few_lags_for_the_order_is_an_error_with_numbers():
    with pytest.raises(InsufficientDataError, match=r"order 40 .* make .* from 0 to 1\d"):
        realise(markov_parameters(random_system(np.random.default_rng(0)), 12), order=40)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"order": "best"}, "whole number"),
        ({"order": 2.5}, "whole number"),
        ({"order": None}, "whole number"),
        ({"order": np.nan}, "whole number"),
        ({"order": -1}, "at least 0"),
        ({"n_block_rows": 2.5}, "n_block_rows must be a whole number"),
        ({"method": "fast"}, "method must be one of auto, full, randomised"),
        ({"realise_on": "gain"}, "realise_on must be one of system, system_and_gain"),
        ({"realise_on": "system_and_gain"}, "gain"),
    ],
)
def test_wrong_options_are_errors(options, words):
    with pytest.raises(InvalidDataError, match=words):
        realise(markov_parameters(random_system(np.random.default_rng(0))), **options)


def test_a_decomposition_of_few_orders_says_how_to_get_more():
    rng = np.random.default_rng(0)
    found = decompose(MarkovParameters(system=rng.standard_normal((50, 2, 2)), dt=0.1), max_order=4)
    with pytest.raises(InsufficientDataError, match="max_order=6"):
        realise_from(found, 6)


def test_arrays_of_a_decomposition_are_frozen():
    found = decompose(markov_parameters(random_system(np.random.default_rng(0))))
    with pytest.raises(ValueError, match="read-only"):
        found.left[0, 0] = 1.0


@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_the_rank_that_an_observer_gives_is_not_taken_for_the_order_of_the_system(noise):
    # 10 past samples of 3 outputs: 30 exponentials, and rounding error behind them, whatever the data were.
    rng = np.random.default_rng(0)
    truth = random_system(rng, n_modes=3, n_outputs=3)
    u = rng.standard_normal((3000, truth.n_inputs))
    y = systems.simulate(truth, u, initial_state=rng.standard_normal(truth.order))
    y += noise * y.std(axis=0) * rng.standard_normal(y.shape)
    found = recover_markov(fit_observer(Record(u, y, truth.dt), order=10), n_lags=100)
    assert decompose(found).rank == 30
    assert realise(found).order == truth.order


def test_an_observer_of_the_least_order_gives_the_whole_system():
    rng = np.random.default_rng(3)
    truth = random_system(rng, n_modes=3, n_outputs=3)
    u = rng.standard_normal((1000, truth.n_inputs))
    y = systems.simulate(truth, u, initial_state=rng.standard_normal(truth.order))
    found = recover_markov(fit_observer(Record(u, y, truth.dt), order=2), n_lags=60)
    assert realise(found).order == truth.order
