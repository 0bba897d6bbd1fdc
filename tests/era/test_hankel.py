"""The block Hankel matrix against two plain loops, its products by FFT against the matrix."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from era.hankel import BlockHankelOperator, block_hankel, block_sizes, hankel_energy
from okid.errors import InsufficientDataError, InvalidDataError


def hankel_by_loops(markov, a, b, shift=0):
    _, q, m = markov.shape
    matrix = np.empty((a * q, b * m))
    for i in range(a):
        for j in range(b):
            matrix[i * q : (i + 1) * q, j * m : (j + 1) * m] = markov[1 + shift + i + j]
    return matrix


sizes = st.tuples(*(st.integers(1, n) for n in (7, 7, 4, 3)))


@given(sizes, st.integers(0, 2))
def test_matrix_equals_two_plain_loops(size, shift):
    a, b, q, m = size
    markov = np.random.default_rng(a + 10 * b).standard_normal((a + b + shift + 2, q, m))
    np.testing.assert_array_equal(block_hankel(markov, a, b, shift), hankel_by_loops(markov, a, b, shift))


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
    with pytest.raises(InsufficientDataError, match="up to lag 5, but there are 4"):
        block_hankel(markov, 2, 3, shift=1)


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
