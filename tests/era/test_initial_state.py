"""The initial state: exact where the rows determine it, zero where they do not."""

import numpy as np
import pytest
import scipy
import systems
from systems import random_system

from era.realisation import Realisation
from era.simulation import estimate_initial_state, simulate
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record


def realisation(system):
    return Realisation(system.A, system.B, system.C, system.D, system.dt)


@pytest.mark.parametrize("n_samples", [30, 700, 40_000])
def test_is_exact_on_half_the_rows_with_missing_outputs(n_samples):
    rng = np.random.default_rng(n_samples)
    system = random_system(rng, n_real_poles=1)
    u = rng.standard_normal((n_samples, 2))
    start = systems.initial_state(rng, system, u)
    y = systems.simulate(system, u, initial_state=start)
    rows = rng.random(n_samples) < 0.5
    y[~rows] = 1e6  # must not be looked at
    y[rng.random(y.shape) < 0.1] = np.nan
    found = estimate_initial_state(realisation(system), Record(u, y, system.dt), rows=rows)
    np.testing.assert_allclose(found, start, atol=1e-9 * np.abs(start).max())


def test_equals_plain_least_squares_on_noisy_rows():
    rng = np.random.default_rng(1)
    system = random_system(rng)
    u = rng.standard_normal((300, 2))
    y = systems.simulate(system, u, initial_state=rng.standard_normal(system.order))
    y += rng.standard_normal(y.shape)
    response = np.vstack([system.C @ np.linalg.matrix_power(system.A, k) for k in range(300)])
    forced = systems.simulate(system, u)
    expected = np.linalg.lstsq(response, (y - forced).ravel(), rcond=None)[0]
    found = estimate_initial_state(realisation(system), Record(u, y, system.dt))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_what_the_rows_do_not_see_is_chosen_for_the_least_energy():
    A = np.diag([0.99, 0.3])  # the second state has died out before the rows begin: noise must not decide it
    model = Realisation(A, np.zeros((2, 1)), [[1.0, 1.0]], [[0.0]], 0.01)
    rng = np.random.default_rng(2)
    y = 2.0 * 0.99 ** np.arange(400) + 1e-3 * rng.standard_normal(400)
    rows = np.arange(400) >= 20
    found = estimate_initial_state(model, Record(np.zeros(400), y, 0.01), rows=rows)
    responses = np.array([0.99, 0.3]) ** np.arange(400)[:, np.newaxis]
    energy = responses.T @ responses
    assert found[0] == pytest.approx(2.0, abs=0.01)
    assert found[1] == pytest.approx(-2.0 * energy[0, 1] / energy[1, 1], abs=0.01)


def test_marginal_and_growing_poles():
    turn = [[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]
    rng = np.random.default_rng(3)
    for growth, n_samples in ((1.0, 20_000), (1.01, 20_000), (1.5, 200)):
        A = scipy.linalg.block_diag(1.0, turn, growth)
        C, start = rng.standard_normal((2, 4)), rng.standard_normal(4)
        y = np.array([C @ np.linalg.matrix_power(A, k) @ start for k in range(min(n_samples, 1500))])
        record = Record([], np.vstack([y, np.zeros((n_samples - len(y), 2))]) if growth > 1 else y, 0.01)
        model = Realisation(A, np.empty((4, 0)), C, np.empty((2, 0)), 0.01)
        np.testing.assert_allclose(estimate_initial_state(model, record), start, atol=1e-6)


def test_states_of_very_different_size_do_not_hide_one_another():
    rng = np.random.default_rng(4)
    system = random_system(rng)
    scale = np.diag(10.0 ** np.linspace(-8, 8, system.order))
    A, B = scale @ system.A @ np.linalg.inv(scale), scale @ system.B
    model = Realisation(A, B, system.C @ np.linalg.inv(scale), system.D, system.dt)
    u, start = rng.standard_normal((500, 2)), rng.standard_normal(system.order)
    y = systems.simulate(system, u, initial_state=start)
    found = estimate_initial_state(model, Record(u, y, system.dt))
    np.testing.assert_allclose(np.linalg.solve(scale, found), start, atol=1e-8)


def test_rows_after_an_input_gap_are_left_out():
    rng = np.random.default_rng(5)
    system = random_system(rng)
    u, start = rng.standard_normal((300, 2)), rng.standard_normal(system.order)
    y = systems.simulate(system, u, initial_state=start)
    u[200] = np.nan
    y[201:] = 1e6
    found = estimate_initial_state(realisation(system), Record(u, y, system.dt))
    np.testing.assert_allclose(found, start, atol=1e-9)


def test_the_simulation_from_it_repeats_the_record():
    rng = np.random.default_rng(6)
    system = random_system(rng)
    u = rng.standard_normal((500, 2))
    y = systems.simulate(system, u, initial_state=rng.standard_normal(system.order))
    record, model = Record(u, y, system.dt), realisation(system)
    repeated = simulate(model, record, initial_state=estimate_initial_state(model, record)).outputs
    np.testing.assert_allclose(repeated, y, atol=1e-10 * np.abs(y).max())


def test_order_zero_has_no_state():
    model = Realisation(np.empty((0, 0)), np.empty((0, 1)), np.empty((1, 0)), [[3.0]], 0.01)
    assert estimate_initial_state(model, Record([1.0, 2.0], [3.0, 6.0], 0.01)).shape == (0,)


def test_wrong_or_empty_rows_are_errors_with_numbers():
    model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01)
    record = Record(np.zeros(9), np.zeros(9), 0.01)
    with pytest.raises(InvalidDataError, match="rows must be 9 truth values"):
        estimate_initial_state(model, record, rows=np.ones(8, dtype=bool))
    with pytest.raises(InsufficientDataError, match="at least one output sample"):
        estimate_initial_state(model, record, rows=np.zeros(9, dtype=bool))


def test_free_response_is_found_for_a_transfer_function_of_oversampled_data():
    # In companion form |A^k| reaches 5e8 before it decays: A^1024 by squaring is not even stable.
    angles = np.array([0.01, 0.03, 0.05])
    poles = 0.99 * np.exp(1j * np.concatenate([angles, -angles]))
    A = np.vstack([-np.poly(poles).real[1:], np.eye(6)[:-1]])
    rng = np.random.default_rng(0)
    model = Realisation(A, np.eye(6)[:, :1], rng.standard_normal((1, 6)), np.zeros((1, 1)), 0.1)
    state, outputs = rng.standard_normal(6), np.empty(2000)
    for k in range(2000):
        outputs[k], state = model.C[0] @ state, A @ state
    record = Record(np.zeros(2000), outputs, 0.1)
    again = simulate(model, record, initial_state=estimate_initial_state(model, record)).outputs[:, 0]
    assert np.abs(again - outputs).max() < 1e-4 * np.abs(outputs).max()


def test_of_a_strongly_unstable_model_overflows_nothing():
    model = Realisation([[2.0, 1.0], [0.0, 0.5]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]], 0.1)
    state, outputs = np.array([1.0, 2.0]), np.empty(30)
    for k in range(30):
        outputs[k], state = model.C[0] @ state, model.A @ state
    found = estimate_initial_state(model, Record(np.zeros(30), outputs, 0.1))
    np.testing.assert_allclose(found, [1.0, 2.0], rtol=1e-6)
