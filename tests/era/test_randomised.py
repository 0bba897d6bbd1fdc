"""The randomised decomposition against LAPACK's, and the error that it states against the true one."""

import numpy as np
import pytest
from systems import markov, modal_system, random_system

from era.balanced import decompose, realise_from
from era.hankel import BlockHankelOperator, block_hankel, leading_triplets
from okid.markov import MarkovParameters


def noisy_markov(seed, noise, n_lags=240, **sizes):
    rng = np.random.default_rng(seed)
    system = modal_system(
        rng, frequencies=[2.0, 5.0, 11.0, 23.0, 40.0], damping_ratios=[0.02, 0.01, 0.01, 0.02, 0.01], **sizes
    )
    h = markov(system, n_lags)
    h[1:] += noise * h[1:].std() * rng.standard_normal(h[1:].shape)
    return h


def test_low_rank_is_exact_without_power_steps():
    h = markov(random_system(np.random.default_rng(1)), 240)
    matrix = block_hankel(h, 120, 120)
    found = leading_triplets(BlockHankelOperator.of(h, 120, 120), 6, rng=np.random.default_rng(0))
    assert found.complete
    rebuilt = found.left * found.singular_values @ found.right
    np.testing.assert_allclose(rebuilt, matrix, atol=1e-13 * np.linalg.norm(matrix))


@pytest.mark.parametrize("noise", [1e-6, 0.01, 0.1])
def test_leading_part_of_noisy_data_agrees_with_the_full_decomposition(noise):
    parameters = MarkovParameters(system=noisy_markov(2, noise), dt=0.01)
    full, fast = (decompose(parameters, method=method, max_order=10) for method in ("full", "randomised"))
    assert fast.subspace_error.max() < 0.1
    np.testing.assert_allclose(fast.singular_values[:10], full.singular_values[:10], rtol=1e-5)
    poles = [np.linalg.eigvals(realise_from(found, 10).A) for found in (full, fast)]
    assert np.abs(np.subtract.outer(*poles)).min(axis=1).max() < 1e-3 * noise
    assert fast.energy == pytest.approx(np.sum(full.singular_values**2), rel=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_the_stated_error_is_above_the_true_one(seed):
    """Beyond the gap too (20 of 10 states): where neighbours are too close to settle the statement says so."""
    h = noisy_markov(seed, 0.05)
    matrix = block_hankel(h, 120, 120)
    found = leading_triplets(BlockHankelOperator.of(h, 120, 120), 20, rng=np.random.default_rng(seed))
    left = np.linalg.svd(matrix)[0][:, :26]
    true = np.linalg.norm(found.left - left @ (left.T @ found.left), axis=0)
    assert (true[:10] <= found.subspace_error[:10]).all()
    assert true[:10].max() < 1e-3
    assert found.subspace_error[10:].max() > 0.1


def test_triplets_are_orthonormal_and_consistent():
    h = noisy_markov(3, 0.05)
    matrix = block_hankel(h, 120, 120)
    found = leading_triplets(BlockHankelOperator.of(h, 120, 120), 15, rng=np.random.default_rng(0))
    np.testing.assert_allclose(found.left.T @ found.left, np.eye(15), atol=1e-12)
    np.testing.assert_allclose(found.right @ found.right.T, np.eye(15), atol=1e-12)
    np.testing.assert_allclose(matrix @ found.right.T, found.left * found.singular_values, atol=1e-10)


def test_equal_data_give_equal_models_and_another_seed_the_same_answer():
    parameters = MarkovParameters(system=noisy_markov(4, 0.02), dt=0.01)
    options = {"method": "randomised", "max_order": 10}
    first, again = decompose(parameters, **options), decompose(parameters, **options)
    other = decompose(parameters, **options, rng=np.random.default_rng(99))
    np.testing.assert_array_equal(first.A, again.A)
    np.testing.assert_allclose(np.poly(other.A), np.poly(first.A), atol=1e-4)


def test_automatic_method_is_full_when_small_and_randomised_when_large():
    small = MarkovParameters(system=noisy_markov(0, 0.01, 40), dt=0.01)
    large = MarkovParameters(system=noisy_markov(0, 0.01, 600), dt=0.01)
    assert decompose(small).method == "full"
    assert decompose(large, max_order=20).method == "randomised"
    assert decompose(large, max_order=400).method == "full"


def test_zero_response_has_rank_zero():
    found = decompose(MarkovParameters(system=np.zeros((200, 2, 2)), dt=0.01), method="randomised")
    assert (found.rank, found.max_order) == (0, 0)
