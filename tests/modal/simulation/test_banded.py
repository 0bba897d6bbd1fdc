"""The banded solve against the recursion itself, one step at a time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.simulation.scheme import band_of, solve_band


def by_loop(transitions, forcing):
    found = np.zeros_like(forcing)
    for column, one in enumerate(forcing):
        state = np.zeros(forcing.shape[2])
        for k, added in enumerate(one):
            state = (transitions[:, :, k - 1] @ state if k else 0.0) + added
            found[column, k] = state
    return found


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 6), n_times=st.integers(1, 40), n_columns=st.integers(1, 4), seed=st.integers(0, 1000))
def test_it_is_the_recursion(n, n_times, n_columns, seed):
    rng = np.random.default_rng(seed)
    transitions = 0.7 * rng.standard_normal((n, n, n_times))
    forcing = rng.standard_normal((n_columns, n_times, n))
    given_forcing = forcing.copy()
    found = solve_band(band_of(transitions), forcing)
    expected = by_loop(transitions, forcing)
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert np.array_equal(forcing, given_forcing)


def test_zeros_cut_the_recursion():
    rng = np.random.default_rng(1)
    transitions, forcing = rng.standard_normal((3, 3, 20)), rng.standard_normal((2, 20, 3))
    transitions[:, :, 11] = 0.0
    found = solve_band(band_of(transitions), forcing)
    assert np.allclose(found[:, 12:], by_loop(transitions[:, :, 12:], forcing[:, 12:]))


@pytest.mark.parametrize(("n", "n_columns"), [(0, 3), (2, 0), (0, 0)])
def test_nothing_to_solve(n, n_columns):
    found = solve_band(band_of(np.zeros((n, n, 5))), np.zeros((n_columns, 5, n)))
    assert found.shape == (n_columns, 5, n)
