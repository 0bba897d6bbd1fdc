"""Forwards against one step at a time, backwards against finite differences, the Gramian against its sum."""

import numpy as np
import pytest

from era.state_recursion import backward_states, finite_gramian, innovation_run, one_step


def random_form(rng, order=5, n_outputs=3):
    A = rng.standard_normal((order, order))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    return A, rng.standard_normal((n_outputs, order)), 0.1 * rng.standard_normal((order, n_outputs))


@pytest.mark.parametrize("share", [0.0, 0.003, 0.2])
def test_forwards_is_one_step_after_the_other(share):
    rng = np.random.default_rng(1)
    A, C, K = random_form(rng)
    values, x = rng.standard_normal((1500, 3)), rng.standard_normal(5)
    values[rng.random(values.shape) < share] = np.nan
    found, last = innovation_run(A, C, K, values, state=x)
    expected = np.empty_like(values)
    for k, v in enumerate(values):
        expected[k] = np.nan_to_num(v - C @ x)
        x = A @ x + K @ expected[k]
    np.testing.assert_allclose(found, expected, atol=1e-11)
    np.testing.assert_allclose(last, x, atol=1e-11)


@pytest.mark.parametrize("share", [0.0, 0.003, 0.2])
def test_prediction_with_inputs_is_one_step_after_the_other(share):
    rng = np.random.default_rng(4)
    A, C, K = random_form(rng)
    B, D = rng.standard_normal((5, 2)), rng.standard_normal((3, 2))
    inputs, outputs, x = rng.standard_normal((900, 2)), rng.standard_normal((900, 3)), rng.standard_normal(5)
    outputs[rng.random(outputs.shape) < share] = np.nan
    found, last = one_step(A, B, C, D, K, inputs=inputs, outputs=outputs, state=x)
    expected = np.empty_like(outputs)
    for k, (u, y) in enumerate(zip(inputs, outputs, strict=True)):
        expected[k] = C @ x + D @ u
        x = A @ x + B @ u + K @ np.nan_to_num(y - expected[k])
    np.testing.assert_allclose(found, expected, atol=1e-10)
    np.testing.assert_allclose(last, x, atol=1e-10)


def test_backwards_is_the_derivative_of_the_sum_of_squares():
    rng = np.random.default_rng(2)
    A, C, K = random_form(rng)
    values, x, weight = rng.standard_normal((60, 3)), rng.standard_normal(5), np.diag([1.0, 2.0, 0.5])

    def half_sum(gain, state):
        e, _ = innovation_run(A, C, gain, values, state=state)
        return 0.5 * np.sum((e @ weight) * e)

    e, _ = innovation_run(A, C, K, values, state=x)
    states, first = backward_states(A, C, K, e @ weight)
    step = 1e-6
    for i in range(5):
        push = step * np.eye(5)[i]
        assert (half_sum(K, x - push) - half_sum(K, x + push)) / (2 * step) == pytest.approx(first[i], rel=1e-6)
        for j in range(3):
            turn = np.outer(push, np.eye(3)[j])
            slope = (half_sum(K - turn, x) - half_sum(K + turn, x)) / (2 * step)
            assert slope == pytest.approx((states.T @ e)[i, j], rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("length", [0, 1, 2, 7, 64, 101])
def test_gramian_is_its_sum(length):
    rng = np.random.default_rng(3)
    A, C, _ = random_form(rng)
    weight = C.T @ C
    terms = [np.linalg.matrix_power(A, i).T @ weight @ np.linalg.matrix_power(A, i) for i in range(length)]
    expected = sum(terms, np.zeros((5, 5)))
    np.testing.assert_allclose(finite_gramian(A, weight, length), expected, rtol=1e-10, atol=1e-12)
