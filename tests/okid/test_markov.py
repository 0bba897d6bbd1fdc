"""Markov parameters given by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from okid.errors import InvalidDataError, NumericalError
from okid.markov import MarkovParameters, recover_arrays, recover_markov, recover_system, solve_recursion
from okid.observer import fit_observer
from okid.record import Record


@pytest.mark.parametrize("shape", [(), (5,), (5, 2), (5, 1, 1, 1)])
def test_a_pulse_of_another_number_of_axes_is_refused_with_the_way_out(shape):
    with pytest.raises(InvalidDataError, match=r"shape \(n_lags \+ 1, n_outputs, n_inputs\), .*reshape\(-1, 1, 1\)"):
        MarkovParameters(system=np.ones(shape), dt=0.1)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf, None, "0.1"])
def test_a_time_step_that_is_none(dt):
    with pytest.raises(InvalidDataError, match="positive time step"):
        MarkovParameters(system=np.ones((3, 1, 1)), dt=dt)


def test_a_gain_must_have_the_same_lags_and_outputs():
    with pytest.raises(InvalidDataError, match="gain Markov parameters"):
        MarkovParameters(system=np.ones((4, 2, 1)), dt=0.1, gain=np.ones((3, 2, 2)))


def textbook(D, alpha, beta, n_lags):
    order, q = beta.shape[:2]
    h, g = [D], [np.eye(q)]
    for k in range(1, n_lags + 1):
        given_term = alpha[k - 1] if k <= order else np.zeros_like(D)
        h.append(given_term + sum(beta[i - 1] @ h[k - i] for i in range(1, min(k, order) + 1)))
        g.append(sum(beta[i - 1] @ g[k - i] for i in range(1, min(k, order) + 1)))
    return np.array(h), np.array(g)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    order=st.integers(1, 12),
    n_outputs=st.integers(1, 5),
    n_inputs=st.integers(0, 3),
    n_lags=st.integers(1, 90),
)
def test_equals_the_sums_written_out(seed, order, n_outputs, n_inputs, n_lags):
    rng = np.random.default_rng(seed)
    D, alpha = rng.standard_normal((n_outputs, n_inputs)), rng.standard_normal((order, n_outputs, n_inputs))
    beta = rng.standard_normal((order, n_outputs, n_outputs)) / (order * n_outputs)
    h, g = textbook(D, alpha, beta, n_lags)
    system, gain = recover_arrays(D, alpha, beta, n_lags)
    # rounding grows with what it rounds: an unstable observer's parameters grow without bound
    assert np.allclose(system, h, rtol=0, atol=1e-12 * max(1.0, np.abs(h).max(initial=0.0)))
    assert np.allclose(gain, g, rtol=0, atol=1e-12 * max(1.0, np.abs(g).max()))
    assert np.allclose(
        recover_system(D, alpha, beta, n_lags), h, rtol=0, atol=1e-12 * max(1.0, np.abs(h).max(initial=0.0))
    )


@pytest.mark.parametrize("gain", [1e-3, 1.0, 50.0])
def test_any_observer_of_a_system_gives_its_markov_parameters(gain):
    """alpha_i = C Abar^(i-1) (B - K D), beta_i = C Abar^(i-1) K for any K that makes Abar die out within the order."""
    rng = np.random.default_rng(3)
    n, q = 4, 2
    A = 0.9 * np.linalg.qr(rng.standard_normal((n, n)))[0]
    B, C, D = rng.standard_normal((n, 3)), rng.standard_normal((q, n)), rng.standard_normal((q, 3))
    # Two outputs see four states within two steps: A - K C is nilpotent for this K.
    seen = np.vstack([C, C @ A])
    K = A @ A @ np.linalg.solve(seen, np.vstack([np.zeros((q, q)), np.eye(q)]))
    Abar = A - K @ C
    assert np.abs(Abar @ Abar).max() < 1e-9 * max(1.0, np.abs(K).max())
    alpha = np.array([gain * C @ np.linalg.matrix_power(Abar, i) @ (B - K @ D) for i in range(2)])
    beta = np.array([C @ np.linalg.matrix_power(Abar, i) @ K for i in range(2)])
    system, observer_gain = recover_arrays(gain * D, alpha, beta, 40)
    powers = [np.linalg.matrix_power(A, k) for k in range(40)]
    expected = gain * np.array([D, *[C @ P @ B for P in powers]])
    assert np.abs(system - expected).max() < 1e-10 * np.abs(expected).max()
    expected_gain = np.array([np.eye(q), *[C @ P @ K for P in powers]])
    assert np.abs(observer_gain - expected_gain).max() < 1e-10 * np.abs(expected_gain).max()


def test_units_and_sizes_go_along():
    rng = np.random.default_rng(4)
    u = rng.standard_normal((500, 2)) * [1e4, 1e-3]
    y = np.zeros((500, 1))
    for k in range(1, 500):
        y[k] = 0.7 * y[k - 1] + 1e-4 * u[k - 1, 0] + 1e3 * u[k, 1]
    markov = recover_markov(fit_observer(Record(u, y, 0.05), order=1), n_lags=4)
    expected = [[0.0, 1e3], [1e-4, 700.0], [0.7e-4, 490.0]]
    assert np.allclose(markov.system[:3, 0], expected, rtol=1e-9, atol=1e-14)
    assert (markov.dt, markov.observer_order) == (0.05, 1)
    assert np.allclose(markov.input_scale, u.std(axis=0))
    assert np.allclose(markov.output_scale, y.std(axis=0))
    assert markov.gain[0].item() == 1.0


def test_the_recursion_by_hand():
    beta = np.array([[[0.5]], [[0.25]]])
    forcing = np.array([1.0, 1.5, 0.0, 0.0, 0.0]).reshape(5, 1, 1)
    assert solve_recursion(beta, forcing).ravel().tolist() == [1.0, 2.0, 1.25, 1.125, 0.875]


@pytest.mark.parametrize("n_lags", [0, -3, 1.5, True, np.nan, np.inf, "many", [3]])
def test_lags_that_are_none(n_lags):
    u, y = np.random.default_rng(5).standard_normal((2, 100))
    with pytest.raises(InvalidDataError, match="n_lags must be a whole number"):
        recover_markov(fit_observer(Record(u, y, 0.1), order=1), n_lags=n_lags)


def test_lags_are_twice_the_order_and_at_least_20_unless_given():
    rng = np.random.default_rng(5)
    record = Record(rng.standard_normal(400), rng.standard_normal(400), 0.1)
    short, long = (fit_observer(record, order=order, ridge=0.0) for order in (3, 15))
    assert recover_markov(short).n_lags == 20
    assert recover_markov(long).n_lags == 30
    assert recover_markov(long, n_lags=1).n_lags == 1
    with pytest.raises(InvalidDataError, match="n_lags must be a whole number of at least 1, but is 0"):
        recover_markov(long, n_lags=0)


def test_markov_parameters_beyond_all_numbers_are_refused():
    rng = np.random.default_rng(6)
    u, y = rng.standard_normal(30), np.zeros(30)
    for k in range(1, 30):
        y[k] = 3.0 * y[k - 1] + u[k - 1]
    fit = fit_observer(Record(u, y, 0.1), order=1, ridge=0.0)
    assert recover_markov(fit, n_lags=600).system[-1].item() > 1e250
    with pytest.raises(NumericalError, match="order 1 overflow within 2000 lags"):
        recover_markov(fit, n_lags=2000)
