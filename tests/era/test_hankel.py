"""The block Hankel matrix against two plain loops, its products by FFT against the matrix."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import markov, modal_system, random_system

from era.balanced import decompose, order_choice, realise_from
from era.hankel import BlockHankelOperator, block_hankel, block_sizes, choose_order, hankel_energy, leading_triplets
from okid.errors import InsufficientDataError, InvalidDataError
from okid.markov import MarkovParameters


def hankel_by_loops(markov, a, b):
    _, q, m = markov.shape
    matrix = np.empty((a * q, b * m))
    for i in range(a):
        for j in range(b):
            matrix[i * q : (i + 1) * q, j * m : (j + 1) * m] = markov[1 + i + j]
    return matrix


sizes = st.tuples(*(st.integers(1, n) for n in (7, 7, 4, 3)))


@given(sizes)
def test_matrix_equals_two_plain_loops(size):
    a, b, q, m = size
    markov = np.random.default_rng(a + 10 * b).standard_normal((a + b + 2, q, m))
    np.testing.assert_array_equal(block_hankel(markov, a, b), hankel_by_loops(markov, a, b))


def test_matrix_leaves_out_the_feedthrough():
    markov = np.zeros((6, 2, 2))
    markov[0] = 1e9
    assert not block_hankel(markov, 2, 3).any()


@given(sizes, st.sampled_from(["dense", "fft"]))
def test_products_equal_those_of_the_matrix(size, products):
    a, b, q, m = size
    rng = np.random.default_rng(a + 10 * b)
    markov = rng.standard_normal((a + b, q, m))
    matrix = hankel_by_loops(markov, a, b)
    operator = BlockHankelOperator.of(markov, a, b, products=products)
    right, left = rng.standard_normal((b * m, 3)), rng.standard_normal((a * q, 3))
    assert operator.shape == matrix.shape
    np.testing.assert_allclose(operator.times(right), matrix @ right, atol=1e-12)
    np.testing.assert_allclose(operator.transpose_times(left), matrix.T @ left, atol=1e-12)


def test_a_large_matrix_is_not_built_and_a_small_one_is():
    large = BlockHankelOperator.of(np.zeros((4001, 8, 2)), 2000, 2000)
    assert large.matrix is None
    assert large.spectrum is not None
    small = BlockHankelOperator.of(np.zeros((21, 2, 2)), 10, 10)
    assert small.matrix is not None
    assert small.spectrum is None


def test_without_inputs_there_are_rows_and_no_columns():
    assert block_hankel(np.zeros((6, 3, 0)), 2, 3).shape == (6, 0)


@pytest.mark.parametrize("products", ["dense", "fft"])
def test_as_many_lags_as_needed_are_enough_and_one_less_is_not(products):
    markov = np.ones((5, 1, 1))
    assert block_hankel(markov, 2, 3).shape == (2, 3)
    assert BlockHankelOperator.of(markov, 2, 3, products=products).shape == (2, 3)
    with pytest.raises(InsufficientDataError, match="up to lag 4, but there are 3"):
        BlockHankelOperator.of(markov[:4], 2, 3, products=products)
    with pytest.raises(InsufficientDataError, match="up to lag 4, but there are 3"):
        block_hankel(markov[:4], 2, 3)


@given(sizes)
def test_energy_is_the_square_of_the_frobenius_norm(size):
    a, b, q, m = size
    markov = np.random.default_rng(a + 10 * b).standard_normal((a + b + 1, q, m))
    assert hankel_energy(markov, a, b) == pytest.approx(np.sum(hankel_by_loops(markov, a, b) ** 2), rel=1e-12)


@given(st.integers(1, 5000))
def test_transform_length_is_the_smallest_product_of_2_3_and_5(least):
    length = least
    while True:
        rest = length
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            break
        length += 1
    operator = BlockHankelOperator.of(np.zeros((least + 1, 1, 1)), least, 1, products="fft")
    assert operator.n_transform == length


@given(st.integers(2, 500), st.integers(1, 20), st.integers(1, 20))
def test_default_sizes_use_every_lag_and_neither_side_is_short(n_lags, n_outputs, n_inputs):
    a, b = block_sizes(n_lags, n_outputs, n_inputs)
    assert a + b == n_lags
    assert min(a, b) >= (n_lags - 1) // 3


def test_one_given_size_leaves_the_rest_to_the_other():
    assert block_sizes(100, 2, 2, n_block_rows=30) == (30, 70)
    assert block_sizes(100, 2, 2, n_block_columns=30) == (70, 30)
    assert block_sizes(100, 2, 2, n_block_columns=1) == (99, 1)
    assert block_sizes(100, 2, 2, n_block_rows=1) == (1, 99)
    assert block_sizes(100, 2, 2, n_block_columns=99) == (1, 99)
    assert block_sizes(100, 2, 2, n_block_rows=99) == (99, 1)
    assert block_sizes(100, 2, 2, n_block_rows=20, n_block_columns=80) == (20, 80)


@pytest.mark.parametrize(
    ("channels", "sizes"), [((2, 2), (45, 45)), ((16, 1), (30, 60)), ((1, 16), (60, 30)), ((3, 2), (36, 54))]
)
def test_shares_follow_the_channels_between_a_third_and_two_thirds(channels, sizes):
    assert block_sizes(90, *channels) == sizes
    assert block_sizes(2, *channels) == (1, 1)


@pytest.mark.parametrize(
    ("arguments", "numbers"),
    [({"n_block_rows": 60, "n_block_columns": 60}, ("120", "100")), ({"n_block_rows": 100}, ("101", "100"))],
)
def test_too_few_lags_says_how_many_are_needed(arguments, numbers):
    with pytest.raises(InsufficientDataError) as raised:
        block_sizes(100, 2, 2, **arguments)
    assert all(number in str(raised.value) for number in numbers)


def test_wrong_sizes_are_errors():
    with pytest.raises(InsufficientDataError, match="at least 2 lags"):
        block_sizes(1, 1, 1)
    with pytest.raises(InvalidDataError, match="n_block_rows must be a whole number of at least 1, but is 0"):
        block_sizes(10, 1, 1, n_block_rows=0)
    with pytest.raises(InvalidDataError, match="n_block_columns must be a whole number of at least 1, but is 0"):
        block_sizes(10, 1, 1, n_block_columns=0)
    with pytest.raises(InsufficientDataError, match="up to lag 9, but there are 5"):
        block_hankel(np.zeros((6, 1, 1)), 5, 5)


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


def test_takes_the_largest_ratio():
    choice = choose_order(np.array([10.0, 9.0, 8.0, 7.0, 0.5, 0.4, 0.3]))
    assert choice.order == 4
    assert choice.ratio == pytest.approx(14.0)
    assert choice.sum_share == pytest.approx(34.0 / 35.2)
    assert choice.energy_share == pytest.approx(294.0 / 294.5)


def test_rounding_error_is_the_numerical_rank_not_a_gap_among_zeros():
    choice = choose_order(np.array([5.0, 4.0, 3.0, 1e-16, 1e-30, 0.0]))
    assert (choice.order, choice.rank) == (3, 3)
    assert "numerical rank" in choice.reason


def test_no_response_beyond_the_feedthrough_is_order_zero():
    choice = choose_order(np.zeros(4))
    assert choice.order == 0
    assert choice.energy_share == 1.0


def test_a_limit_holds():
    assert choose_order(np.array([9.0, 8.0, 7.0, 0.1, 0.09]), max_order=2).order <= 2


def test_energy_of_values_that_were_not_computed_counts():
    assert choose_order(np.array([2.0, 1.0, 0.1]), energy=10.0).energy_share == pytest.approx(0.5)


@pytest.mark.parametrize("n_real", [0, 1])
def test_noise_free_data_give_the_order_of_the_system(n_real):
    rng = np.random.default_rng(4)
    system = modal_system(
        rng, frequencies=[3.0, 3.3, 9.0], damping_ratios=[0.01, 0.02, 0.01], real_poles=[-8.0][:n_real]
    )
    parameters = MarkovParameters(system=markov(system, 80), dt=system.dt)
    for method in ("full", "randomised"):
        choice = order_choice(decompose(parameters, method=method))
        assert choice.order == 6 + n_real
        assert choice.energy_share == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_noisy_markov_parameters_give_the_order_of_the_system(seed):
    rng = np.random.default_rng(seed)
    system = modal_system(rng, frequencies=[2.0, 6.0, 14.0], damping_ratios=[0.02, 0.01, 0.01])
    h = markov(system, 200)
    h[1:] += 0.01 * h[1:].std() * rng.standard_normal(h[1:].shape)
    assert order_choice(decompose(MarkovParameters(system=h, dt=system.dt))).order == 6


def test_a_pair_is_kept_whole_where_the_gap_is_weak():
    turn = 0.95 * np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    A = np.zeros((4, 4))
    A[:2, :2], A[2:, 2:] = turn, turn @ turn
    values = np.array([1.0, 0.9, 0.8, 0.5])
    assert choose_order(values, A=A).order == 4  # 0.8 / 0.5 is the largest ratio, but order 3 cuts the second pair
    assert choose_order(values).order == 3
    assert choose_order(np.array([1.0, 0.9, 0.8, 0.1]), A=A).order == 3  # a clear gap is believed


def test_the_reason_names_the_three_measures():
    reason = choose_order(np.array([3.0, 0.3, 0.1])).reason
    for part in ("order 1", "s1/s2 = 10", "88.2 % of their sum", "98.90 % of their energy"):
        assert part in reason


def test_the_last_values_of_a_noisy_matrix_are_no_gap():
    values = np.concatenate([[9.0, 8.0], np.linspace(1.0, 0.5, 20), [0.02]])
    assert choose_order(values, rank=values.size).order == 2
