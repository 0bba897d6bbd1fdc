"""Block products against a loop over samples; lengths around the block's, poles at zero and at the edge, no poles."""

import numpy as np
import pytest

from modal.estimation.free_run import BLOCK, ModalRecursion, powers_of


def a_model(seed, n_poles, n_inputs, n_outputs, *, largest=0.99):
    rng = np.random.default_rng(seed)

    def complex_normal(*shape):
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    poles = largest * np.sqrt(rng.random(n_poles)) * np.exp(1j * np.pi * rng.random(n_poles))
    poles[n_poles // 2 :] = poles[n_poles // 2 :].real
    return rng, poles, complex_normal(n_poles, n_inputs), complex_normal(n_outputs, n_poles)


def loop(model, inputs, state):
    poles, participations, shapes, D = model
    outputs = np.empty((inputs.shape[0], D.shape[0]))
    for k, u in enumerate(inputs):
        outputs[k] = (shapes @ state).real + D @ u
        state = poles * state + participations @ u
    return outputs


@pytest.mark.parametrize("n_samples", [1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK, 7 * BLOCK + 3, 500])
@pytest.mark.parametrize(("n_poles", "n_inputs", "n_outputs"), [(1, 1, 1), (5, 2, 3), (4, 0, 2), (0, 2, 1)])
def test_a_run_is_the_loop_over_samples(n_samples, n_poles, n_inputs, n_outputs):
    rng, poles, participations, shapes = a_model(n_samples, n_poles, n_inputs, n_outputs)
    D, inputs = rng.standard_normal((n_outputs, n_inputs)), rng.standard_normal((n_samples, n_inputs))
    recursion = ModalRecursion.of(poles, participations, shapes, D)
    expected = loop((poles, participations, shapes, D), inputs, np.zeros(n_poles, complex))
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(recursion.from_rest(inputs), expected, rtol=0, atol=1e-12 * scale)
    state = rng.standard_normal(n_poles) + 1j * rng.standard_normal(n_poles)
    free = loop((poles, participations, shapes, D), np.zeros_like(inputs), state)
    scale = max(1.0, np.abs(free).max())
    np.testing.assert_allclose(recursion.free_response(state, n_samples), free, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("n_samples", [1, BLOCK + 5, 300])
def test_products_are_sums_over_rows_and_outputs(n_samples):
    rng, poles, participations, shapes = a_model(3, 4, 1, 2)
    signals = rng.standard_normal((n_samples, 2))
    recursion = ModalRecursion.of(poles, participations, shapes, np.zeros((2, 1)))
    expected = np.zeros(4, complex)
    for k in range(n_samples):
        expected += poles**k * (shapes.T @ signals[k])
    np.testing.assert_allclose(recursion.products(signals), expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("largest", [0.5, 0.99, 0.9999])
def test_a_free_response_is_followed_until_it_has_died_out(largest):
    poles = np.array([largest, 0.3]) + 0j
    recursion = ModalRecursion.of(poles, np.ones((2, 1), complex), np.ones((1, 2), complex), np.zeros((1, 1)))
    n_alive = recursion.n_alive(1_000_000)
    assert largest**n_alive <= 1e-12
    assert largest ** (n_alive - 2 * BLOCK) > 1e-12 or n_alive <= 2 * BLOCK
    assert recursion.n_alive(20) == 20


def test_poles_at_zero_and_at_one():
    poles = np.array([0.0, 1.0]) + 0j
    recursion = ModalRecursion.of(poles, np.ones((2, 1), complex), np.ones((1, 2), complex), np.zeros((1, 1)))
    inputs = np.arange(100.0)[:, np.newaxis]
    past = np.r_[0.0, inputs[:-1, 0]]
    np.testing.assert_allclose(recursion.from_rest(inputs)[:, 0], past + np.cumsum(past), rtol=1e-13)
    assert recursion.n_alive(12345) == 12345


def test_powers_are_powers():
    poles = np.array([0.9 * np.exp(0.3j), -0.5, 0.0])
    found = powers_of(poles, 21)
    for k in range(21):
        np.testing.assert_allclose(found[k], poles**k, rtol=1e-13)
