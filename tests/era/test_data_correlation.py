"""ERA/DC on systems whose truth is known, against the textbook's double loops, and what noise does to it."""

import numpy as np
import pytest
from containers import markov_parameters
from systems import markov, modal_system, pole_distance, pulse_response, random_system

from era.balanced import realise, realise_data_correlation
from modal.modes.extraction import extract_modes
from okid.errors import InsufficientDataError, InvalidDataError
from okid.markov import MarkovParameters


def correlation(h, k, a, b):
    """R(k) = H(k) H(0)' block by block."""
    return np.block([[sum(h[1 + k + i + s] @ h[1 + j + s].T for s in range(b)) for j in range(a)] for i in range(a)])


def textbook_era_dc(h, sizes, order):
    """Juang, Cooper, Wright 1988, steps a apart; B by least squares on the pulse responses of all block rows."""
    (a, b, first_lag, rows, columns), (q, m) = sizes, h.shape[1:]
    lags = [first_lag + k + i * a for k in (0, 1) for i in range(rows + columns - 1)]
    R = {lag: correlation(h, lag, a, b) for lag in set(lags)}
    U = [np.block([[R[first_lag + k + (i + j) * a] for j in range(columns)] for i in range(rows)]) for k in (0, 1)]
    P, s, Qt = np.linalg.svd(U[0])
    root = np.diag(np.sqrt(s[:order]))
    observability = P[:, :order] @ root
    A = np.linalg.inv(root) @ P[:, :order].T @ U[1] @ Qt[:order].T @ np.linalg.inv(root)
    B = np.linalg.lstsq(observability, h[1 : 1 + a * rows].reshape(-1, m), rcond=None)[0]
    return A, B, observability[:q], s


SIZES = [{}, {"n_block_rows": 3}, {"n_block_rows": 4, "first_lag": 0}, {"n_block_rows": 10, "n_block_columns": 20}]


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize(("n_inputs", "n_outputs", "n_real"), [(1, 1, 0), (2, 3, 1), (1, 4, 0), (3, 1, 2)])
def test_noise_free_systems_are_exact(n_inputs, n_outputs, n_real, sizes):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        system = random_system(rng, n_inputs=n_inputs, n_outputs=n_outputs, n_real_poles=n_real)
        model = realise_data_correlation(markov_parameters(system), **sizes)
        assert model.order == system.order
        assert pole_distance(np.linalg.eigvals(system.A), np.linalg.eigvals(model.A)) < 1e-10
        truth = markov(system, 160)  # twice as far as the data reached: B belongs to lag 1, not to the first lag
        np.testing.assert_allclose(pulse_response(model, 160), truth, atol=1e-10 * np.abs(truth).max())


@pytest.mark.parametrize("first_lag", [0, 1, 7])
def test_no_first_lag_turns_b(first_lag):
    system = random_system(np.random.default_rng(4))
    model = realise_data_correlation(markov_parameters(system), first_lag=first_lag)
    truth = markov(system, 40)
    np.testing.assert_allclose(pulse_response(model, 40), truth, atol=1e-10 * np.abs(truth).max())


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("sizes", [(1, 25, 1, 17, 18), (3, 20, 2, 6, 7)])
def test_equals_the_textbook_computation(noise, sizes):
    a, b, first_lag, rows, columns = sizes
    rng = np.random.default_rng(7)
    h = markov(random_system(rng, weak_mode=0.5), first_lag + (rows + columns - 1) * a + b)
    h += noise * rng.standard_normal(h.shape)
    model = realise_data_correlation(
        MarkovParameters(system=h, dt=0.01), order=6, n_block_rows=a, n_block_columns=b, first_lag=first_lag
    )
    A, B, C, values = textbook_era_dc(h, sizes, 6)
    sign = np.sign((model.C * C).sum(axis=0))
    np.testing.assert_allclose(model.A, sign[:, np.newaxis] * A * sign, atol=1e-8)
    np.testing.assert_allclose(model.B, sign[:, np.newaxis] * B, atol=1e-8)
    np.testing.assert_allclose(model.C, C * sign, atol=1e-8)
    np.testing.assert_allclose(model.singular_values[:6], values[:6], rtol=1e-10)


def test_large_matrices_take_the_randomised_way_to_the_same_model():
    rng = np.random.default_rng(5)
    system = random_system(rng, n_outputs=4)
    h = markov(system, 400)
    h += 1e-3 * h[1:].std() * rng.standard_normal(h.shape)
    model = realise_data_correlation(MarkovParameters(system=h, dt=0.01), order=6)
    assert model.singular_values.size < 100  # of 400: it was not decomposed in full
    A, _, _, _ = textbook_era_dc(h, (1, 199, 1, 100, 101), 6)
    assert pole_distance(np.linalg.eigvals(A), np.linalg.eigvals(model.A)) < 1e-6


@pytest.mark.parametrize("a", [1, 4])
def test_white_noise_biases_the_lags_below_the_block_rows_only(a):
    """The mean of R(k) over white noise of variance 1 is the sum over its samples of R(k) of that sample alone:
    b I on the blocks j = i + k, nothing from k = a on."""
    b, q = 6, 2
    for k in range(2 * a + 1):
        mean = np.zeros((a * q, a * q))
        for sample in range(1, 3 * a + b + 1):
            for channel in range(q):
                h = np.zeros((3 * a + b + 1, q, 1))
                h[sample, channel] = 1.0
                mean += correlation(h, k, a, b)
        np.testing.assert_array_equal(mean, b * np.kron(np.eye(a, k=k), np.eye(q)))


def test_the_default_first_lag_leaves_that_bias_out():
    """Many strong noise records: with the first lag at a the averaged U(0) keeps the rank of the system."""
    rng = np.random.default_rng(2)
    system = modal_system(rng, frequencies=[8.0], damping_ratios=[0.02], n_outputs=1, n_inputs=1)
    h = markov(system, 100)
    noise = 0.5 * h[1:].std()
    damping = {0: [], 1: []}
    for _ in range(300):
        noisy = h + noise * rng.standard_normal(h.shape)
        for first_lag, found in damping.items():
            model = realise_data_correlation(
                MarkovParameters(system=noisy, dt=0.01), order=2, first_lag=first_lag, n_block_columns=95
            )
            poles = np.log(np.linalg.eigvals(model.A).astype(complex))
            found.append(-(poles.real / np.abs(poles))[0])
    bias = {lag: abs(np.median(found) - 0.02) for lag, found in damping.items()}
    assert bias[1] < 0.5 * bias[0]


def test_sizes_by_default():
    """Half of the lags are summed, and the first lag is the number of block rows: no bias."""
    rng = np.random.default_rng(9)
    h = markov(random_system(rng), 61)
    parameters = MarkovParameters(system=h + 0.01 * rng.standard_normal(h.shape), dt=0.01)
    for sizes in ({}, {"n_block_rows": 3}):
        a = sizes.get("n_block_rows", 1)
        b = (61 - 2 * a + 1) // 2
        given = realise_data_correlation(parameters, order=6, n_block_rows=a, n_block_columns=b, first_lag=a)
        default = realise_data_correlation(parameters, order=6, **sizes)
        np.testing.assert_array_equal(default.A, given.A)
        np.testing.assert_array_equal(default.B, given.B)


def test_the_end_of_an_observer_is_not_taken_for_the_order():
    """Six exponentials in all, four of them a thousand times weaker: of a system when measured, of an observer of
    order 2 with three outputs they are all that it can give, and the gap before its end counts."""
    system = modal_system(
        np.random.default_rng(3), frequencies=[4, 9, 20], damping_ratios=[0.02] * 3, mode_sizes=[1, 1e-3, 1e-3]
    )
    assert realise_data_correlation(markov_parameters(system)).order == 6
    assert realise_data_correlation(markov_parameters(system, observer_order=2)).order == 2


def test_lower_orders_are_corners():
    rng = np.random.default_rng(2)
    h = markov(random_system(rng), 60)
    h += 0.01 * rng.standard_normal(h.shape)
    parameters = MarkovParameters(system=h, dt=0.01, gain=rng.standard_normal((61, 3, 3)))
    whole = realise_data_correlation(parameters, order=9, n_block_rows=2)
    for order in (0, 1, 4, 9):
        alone, corner = realise_data_correlation(parameters, order=order, n_block_rows=2), whole.truncated(order)
        np.testing.assert_allclose(pulse_response(corner, 20), pulse_response(alone, 20), atol=1e-9)
        np.testing.assert_allclose(corner.C @ corner.K, alone.C @ alone.K, atol=1e-9)


def test_the_factors_are_data_and_give_the_indicators_of_the_mode():
    system = random_system(np.random.default_rng(3))
    exact = extract_modes(realise_data_correlation(markov_parameters(system, 100)))
    assert len(exact) == 3
    for mode in exact:
        assert mode.emac > 1 - 1e-6
        assert mode.amplitude_coherence > 1 - 1e-9
    rng = np.random.default_rng(8)
    h = markov(system, 100)
    h += 0.1 * h[1:].std() * rng.standard_normal(h.shape)
    noisy = extract_modes(realise_data_correlation(MarkovParameters(system=h, dt=system.dt), order=20))
    nearest = [min(abs(mode.frequency / f - 1) for f in system.frequencies) for mode in noisy]
    far = [mode.emac for mode, distance in zip(noisy, nearest, strict=True) if distance > 0.05]
    near = [mode.emac for mode, distance in zip(noisy, nearest, strict=True) if distance < 0.005]
    assert max(near) > 0.8
    assert np.median(far) < 0.3


def test_the_gain_is_realised_with_the_system_and_alone():
    rng = np.random.default_rng(8)
    system = random_system(rng)
    K = 0.1 * rng.standard_normal((system.order, 3))
    g = np.array([np.eye(3), *pulse_response(system, 100, K)[1:]])
    scales = {"input_scale": [3.0, 0.2], "output_scale": [0.5, 1.0, 7.0]}
    model = realise_data_correlation(markov_parameters(system, 100, gain=g, **scales), order=6)
    found = np.array(pulse_response(model, 40, model.K)[1:])
    np.testing.assert_allclose(found, g[1:41], atol=1e-9 * np.abs(g[1:]).max())
    only = MarkovParameters(system=np.zeros((101, 3, 0)), gain=g, dt=system.dt, output_scale=[0.5, 1.0, 7.0])
    model = realise_data_correlation(only)
    assert (model.order, model.B.shape, model.D.shape) == (6, (6, 0), (3, 0))
    found = np.array(pulse_response(model, 40, model.K)[1:])
    np.testing.assert_allclose(found, g[1:41], atol=1e-9 * np.abs(g[1:]).max())
    assert realise_data_correlation(markov_parameters(system)).K is None


def test_automatic_order_agrees_with_era_on_clear_data():
    rng = np.random.default_rng(6)
    for seed in range(5):
        h = markov(random_system(np.random.default_rng(seed), weak_mode=None), 120)
        h += 1e-3 * h[1:].std() * rng.standard_normal(h.shape)
        parameters = MarkovParameters(system=h, dt=0.01)
        assert realise_data_correlation(parameters).order == realise(parameters).order == 6


def test_the_fewest_lags_and_what_lies_below():
    h = 0.9 ** np.arange(4.0).reshape(-1, 1, 1)
    model = realise_data_correlation(MarkovParameters(system=h, dt=0.1))
    np.testing.assert_allclose(model.A, [[0.9]], atol=1e-12)
    with pytest.raises(InsufficientDataError, match="first lag 1 needs Markov parameters up to lag 3, but there are 2"):
        realise_data_correlation(MarkovParameters(system=h[:3], dt=0.1))
    with pytest.raises(InsufficientDataError, match="5 block rows, 1 block columns and first lag 5 needs"):
        realise_data_correlation(MarkovParameters(system=h, dt=0.1), n_block_rows=5)


def test_orders_beyond_the_rank_are_refused():
    system = random_system(np.random.default_rng(0))
    with pytest.raises(InsufficientDataError, match="numerical rank 6: it holds squares"):
        realise_data_correlation(markov_parameters(system), order=7)
    with pytest.raises(InsufficientDataError, match="smaller side 60"):
        realise_data_correlation(markov_parameters(system), order=200)


@pytest.mark.parametrize(
    "wrong", [{"order": -1}, {"order": "best"}, {"n_block_rows": 0}, {"n_block_columns": 1.5}, {"first_lag": -1}]
)
def test_arguments_outside_their_range_are_refused(wrong):
    with pytest.raises(InvalidDataError, match="must be a whole number of at least"):
        realise_data_correlation(markov_parameters(random_system(np.random.default_rng(0))), **wrong)


def test_the_wrong_stage_is_named():
    with pytest.raises(InvalidDataError, match=r"a realisation takes a MarkovParameters.*okid\.recover_markov"):
        realise_data_correlation(np.zeros((10, 1, 1)))


def test_output_only_without_a_gain_is_refused():
    with pytest.raises(InvalidDataError, match="need the Markov parameters of a gain"):
        realise_data_correlation(MarkovParameters(system=np.zeros((10, 2, 0)), dt=0.1))
