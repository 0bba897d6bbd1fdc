"""Free run and one-step prediction against one sample after the other."""

import numpy as np
import pytest
import scipy.signal
import systems
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import random_system

from era.realisation import Realisation
from era.simulation import predict, simulate
from era.state_recursion import CHUNK_SAMPLES, PoleRecursion, simulate_array
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record


def by_loop(A, B, C, D, inputs, *, state):
    outputs = np.empty((len(inputs), len(C)))
    for k, u in enumerate(inputs):
        outputs[k] = C @ state + D @ u
        state = A @ state + B @ u
    return outputs


def realisation(system, K=None):
    return Realisation(system.A, system.B, system.C, system.D, system.dt, K=K)


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
    found = simulate(realisation(system), record, initial_state=start).outputs
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_equals_dlsim():
    rng = np.random.default_rng(2)
    system = random_system(rng)
    u = rng.standard_normal((500, 2))
    expected = scipy.signal.dlsim((system.A, system.B, system.C, system.D, system.dt), u)[1]
    found = simulate(realisation(system), Record(u, np.zeros((500, 3)), system.dt)).outputs
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
        found = predict(realisation(system, K), Record(u, y, system.dt), initial_state=start).outputs
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_prediction_with_zero_gain_is_the_free_run():
    rng = np.random.default_rng(5)
    system = random_system(rng)
    record = Record(rng.standard_normal((400, 2)), rng.standard_normal((400, 3)), system.dt)
    found = predict(realisation(system, np.zeros((system.order, 3))), record).outputs
    np.testing.assert_allclose(found, simulate(realisation(system), record).outputs, atol=1e-12)


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
