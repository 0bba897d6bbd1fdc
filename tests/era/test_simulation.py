"""Free run and one-step prediction against one sample after the other."""

import numpy as np
import pytest
import scipy
import scipy.signal
import systems
from containers import realisation_of
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import random_system

from era.realisation import Realisation
from era.simulation import estimate_initial_state, predict, simulate
from era.state_recursion import CHUNK_SAMPLES, PoleRecursion, simulate_array
from okid.errors import InsufficientDataError, InvalidDataError, NumericalError
from okid.record import Record


def by_loop(A, B, C, D, inputs, *, state):
    outputs = np.empty((len(inputs), len(C)))
    for k, u in enumerate(inputs):
        outputs[k] = C @ state + D @ u
        state = A @ state + B @ u
    return outputs


def stable_gain(rng, system):
    P = scipy.linalg.solve_discrete_are(
        system.A.T, system.C.T, np.eye(system.order), np.diag(rng.uniform(0.5, 2, system.n_outputs))
    )
    return system.A @ P @ system.C.T @ np.linalg.inv(system.C @ P @ system.C.T + np.eye(system.n_outputs))


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 3000), st.integers(0, 12), st.integers(0, 3), st.integers(1, 4), st.integers(0, 2**31)
)  # fmt: skip
def test_equals_a_plain_loop_for_any_size(n_samples, order, n_inputs, n_outputs, seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((order, order))
    A *= 0.99 / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-3)
    B, C = rng.standard_normal((order, n_inputs)), rng.standard_normal((n_outputs, order))
    D, u = rng.standard_normal((n_outputs, n_inputs)), rng.standard_normal((n_samples, n_inputs))
    start = rng.standard_normal(order)
    expected = by_loop(A, B, C, D, u, state=start)
    found = simulate_array(A, B, C, D, u, initial_state=start)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max(initial=1.0))


def test_long_records_are_exact_over_the_edges_of_chunks():
    rng = np.random.default_rng(1)
    system = random_system(rng, n_modes=5, damping_range=(0.0005, 0.002))
    u = rng.standard_normal((2 * CHUNK_SAMPLES + 77, 2))
    start = systems.initial_state(rng, system, u)
    expected = systems.simulate(system, u, initial_state=start)
    record = Record(u, np.zeros_like(expected), system.dt)
    found = simulate(realisation_of(system), record, initial_state=start).outputs
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_equals_dlsim():
    rng = np.random.default_rng(2)
    system = random_system(rng)
    u = rng.standard_normal((500, 2))
    expected = scipy.signal.dlsim((system.A, system.B, system.C, system.D, system.dt), u)[1]
    found = simulate(realisation_of(system), Record(u, np.zeros((500, 3)), system.dt)).outputs
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_defective_and_marginal_models_are_exact():
    A = np.array(
        [[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]
    )  # a triple pole at 1: k^2 growth, in whole numbers
    B, C, D = np.array([[0.0], [0.0], [1.0]]), np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 1))
    u = np.zeros((3000, 1))
    u[0] = 1.0
    k = np.arange(3000.0)
    np.testing.assert_array_equal(simulate_array(A, B, C, D, u).ravel(), np.where(k > 2, (k - 1) * (k - 2) / 2, 0.0))


def test_result_is_a_record_with_everything_else_kept():
    model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01)
    record = Record(
        [1.0, 0.0, 0.0],
        [5.0, 5.0, 5.0],
        0.01,
        input_names=["force"],
        output_names=["tip"],
        output_units=["m"],
        input_hold="linear",
        name="test",
        start_time=3.0,
    )
    found = simulate(model, record)
    assert (found.input_names, found.output_names, found.output_units) == (("force",), ("tip",), ("m",))
    assert (found.input_hold, found.name, found.start_time) == ("linear", "test", 3.0)
    np.testing.assert_array_equal(found.outputs.ravel(), [0.0, 2.0, 1.0])
    np.testing.assert_array_equal(record.outputs.ravel(), [5.0, 5.0, 5.0])
    assert not found.outputs.flags.writeable


def test_no_inputs_and_no_states():
    free = Realisation([[0.5]], np.empty((1, 0)), [[2.0]], np.empty((1, 0)), 0.01)
    found = simulate(free, Record([], [0.0] * 4, 0.01), initial_state=np.array([4.0])).outputs
    np.testing.assert_allclose(found.ravel(), [8.0, 4.0, 2.0, 1.0])
    through = Realisation(np.empty((0, 0)), np.empty((0, 1)), np.empty((1, 0)), [[3.0]], 0.01)
    np.testing.assert_array_equal(simulate(through, Record([1.0, 2.0], [0.0, 0.0], 0.01)).outputs.ravel(), [3.0, 6.0])


def test_unstable_models_run_until_no_number_holds_them():
    model = Realisation([[2.0]], [[1.0]], [[1.0]], [[0.0]], 0.01)
    short = simulate(model, Record([1.0] + [0.0] * 99, np.zeros(100), 0.01)).outputs
    assert short[-1, 0] == 2.0**98
    with pytest.raises(NumericalError, match=r"magnitude 2; use a stable model"):
        simulate(model, Record([1.0] + [0.0] * 4999, np.zeros(5000), 0.01))
    raw = simulate_array(model.A, model.B, model.C, model.D, np.ones((5000, 1)))
    assert not np.isfinite(raw[-1]).any()


def test_wrong_channels_time_step_or_state_are_errors_with_numbers():
    model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01)
    with pytest.raises(InvalidDataError, match=r"1 inputs and 1 outputs, but the record has 2 inputs \(a, b\).*select"):
        simulate(model, Record(np.zeros((5, 2)), np.zeros(5), 0.01, input_names=["a", "b"]))
    with pytest.raises(InvalidDataError, match=r"time step of 0\.01 s, but the record one of 0\.02 s"):
        simulate(model, Record(np.zeros(5), np.zeros(5), 0.02))
    with pytest.raises(InvalidDataError, match=r"must be 1 finite numbers"):
        simulate(model, Record(np.zeros(5), np.zeros(5), 0.01), initial_state=np.zeros(2))
    with pytest.raises(InvalidDataError, match=r"needs a gain K .*gain_from_innovations"):
        predict(model, Record(np.zeros(5), np.zeros(5), 0.01))


def test_outputs_after_an_input_gap_are_missing_until_the_state_is_known_again():
    rng = np.random.default_rng(3)
    model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.3]], 0.01)
    u = rng.standard_normal(100)
    whole = simulate(model, Record(u, np.zeros(100), 0.01)).outputs
    u[40:43] = np.nan
    found = simulate(model, Record(u, np.zeros(100), 0.01)).outputs
    memory = 7  # 0.5^7 < 0.01 <= 0.5^6
    assert np.isnan(found[40 : 43 + memory]).all()
    assert not np.isnan(found[:40]).any()
    assert not np.isnan(found[43 + memory :]).any()
    np.testing.assert_array_equal(found[:40], whole[:40])
    assert np.abs(found[50:] - whole[50:]).max() < 0.05 * np.abs(whole).max()
    marginal = Realisation([[1.0]], [[1.0]], [[2.0]], [[0.0]], 0.01)
    assert np.isnan(simulate(marginal, Record(u, np.zeros(100), 0.01)).outputs[40:]).all()


def test_prediction_equals_a_plain_loop_with_and_without_missing_outputs():
    rng = np.random.default_rng(4)
    system = random_system(rng)
    K = stable_gain(rng, system)
    u = rng.standard_normal((3000, 2))
    y = systems.simulate(system, u) + rng.standard_normal((3000, 3))
    start = rng.standard_normal(system.order)
    for missing in (0.0, 0.01):
        y[rng.random(y.shape) < missing] = np.nan
        expected, state = np.empty_like(y), start
        for k in range(3000):
            expected[k] = system.C @ state + system.D @ u[k]
            innovation = np.nan_to_num(y[k] - expected[k], nan=0.0)
            state = system.A @ state + system.B @ u[k] + K @ innovation
        found = predict(realisation_of(system, K), Record(u, y, system.dt), initial_state=start).outputs
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_prediction_with_zero_gain_is_the_free_run():
    rng = np.random.default_rng(5)
    system = random_system(rng)
    record = Record(rng.standard_normal((400, 2)), rng.standard_normal((400, 3)), system.dt)
    found = predict(realisation_of(system, np.zeros((system.order, 3))), record).outputs
    np.testing.assert_allclose(found, simulate(realisation_of(system), record).outputs, atol=1e-12)


def test_a_gain_that_diverges_is_an_error():
    model = Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.01, K=[[5.0]])
    rng = np.random.default_rng(6)
    with pytest.raises(NumericalError, match=r"A - K C has magnitude 4\.5"):
        predict(model, Record(rng.standard_normal(3000), rng.standard_normal(3000), 0.01))


@pytest.mark.parametrize(("radius", "angles"), [(0.97, (0.05, 0.225, 0.4)), (0.97, (0.05, 0.17, 0.28, 0.4))])
def test_transfer_function_of_oversampled_data_is_not_blown_up_by_powers_of_its_companion_matrix(radius, angles):
    # Stable, but |A^k| reaches 1e5 and 2e8: blocks of A^32 by squaring gave 6e-5 and 1e114 of the largest output.
    poles = radius * np.exp(1j * np.array([*angles, *(-angle for angle in angles)]))
    order = poles.size
    A = np.vstack([-np.poly(poles).real[1:], np.eye(order)[:-1]])
    B, C, D = np.eye(order)[:, :1], np.ones((1, order)), np.zeros((1, 1))
    u = np.random.default_rng(0).standard_normal((3000, 1))
    truth = by_loop(*(part.astype(np.longdouble) for part in (A, B, C, D, u)), state=np.zeros(order, np.longdouble))
    in_doubles = by_loop(A, B, C, D, u, state=np.zeros(order))
    size = float(np.abs(truth).max())
    allowed = 10 * float(np.abs(in_doubles - truth).max()) / size
    found = simulate_array(A, B, C, D, u)
    assert float(np.abs(found - truth).max()) / size < max(allowed, 1e-12)


@pytest.mark.parametrize("n_samples", [0, 1, 16, 17, 31, 32, 300, 5000])
@pytest.mark.parametrize("shared", [False, True])
def test_states_of_single_poles_are_those_of_a_loop(n_samples, shared):
    """Poles that die at once, turn, lie on the unit circle to rounding, and at zero."""
    rng = np.random.default_rng(n_samples)
    poles = np.array([0.3 - 0.2j, 0.999 * np.exp(0.7j), (1 - 1e-12) * np.exp(2j), 0.0, -0.95])
    drive = rng.standard_normal((1 if shared else 5, n_samples))
    drive = drive if shared else drive + 1j * rng.standard_normal(drive.shape)
    start = rng.standard_normal(5) + 1j * rng.standard_normal(5)
    truth, state = np.empty((5, n_samples), dtype=complex), start
    for k in range(n_samples):
        truth[:, k] = state
        state = poles * state + drive[:, k]
    for longest in (n_samples, 8192):  # the last chunk of a record is shorter than the products were made for
        states, after = PoleRecursion.of(poles, longest).run(drive, start)
        np.testing.assert_allclose(states, truth, rtol=0, atol=1e-10)
        np.testing.assert_allclose(after, state, rtol=0, atol=1e-10)


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
    found = estimate_initial_state(realisation_of(system), Record(u, y, system.dt), rows=rows)
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
    found = estimate_initial_state(realisation_of(system), Record(u, y, system.dt))
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
    found = estimate_initial_state(realisation_of(system), Record(u, y, system.dt))
    np.testing.assert_allclose(found, start, atol=1e-9)


def test_the_simulation_from_it_repeats_the_record():
    rng = np.random.default_rng(6)
    system = random_system(rng)
    u = rng.standard_normal((500, 2))
    y = systems.simulate(system, u, initial_state=rng.standard_normal(system.order))
    record, model = Record(u, y, system.dt), realisation_of(system)
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
