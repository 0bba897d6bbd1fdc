"""The closed-form sums against least squares on the rows written out, one row an output and sample."""

import numpy as np
import pytest

from modal.estimation.free_run import STATE_REGULARISATION, fit_initial_state

RUNS = [[(0, 120)], [(0, 30), (45, 46), (60, 120)], [(3, 90)]]


def a_problem(seed, n_outputs=2, n_samples=120):
    rng = np.random.default_rng(seed)
    poles = np.array([0.97 * np.exp(0.4j), 0.9 * np.exp(1.9j), 0.8 + 0j])
    shapes = rng.standard_normal((n_outputs, 3)) + 1j * rng.standard_normal((n_outputs, 3))
    return rng, poles, shapes, rng.standard_normal((n_samples, n_outputs)) + 2.0


def written_out(poles, shapes, n_samples):
    """(n_samples, n_outputs, unknowns) responses to real parts, imaginary parts and levels."""
    powers = poles ** np.arange(n_samples)[:, np.newaxis]
    response = shapes * powers[:, np.newaxis, :]
    levels = np.broadcast_to(np.eye(shapes.shape[0]), (n_samples, shapes.shape[0], shapes.shape[0]))
    return np.concatenate([response.real, -response.imag, levels], axis=2)


@pytest.mark.parametrize("runs", RUNS, ids=str)
def test_the_fit_is_regularised_least_squares(runs):
    _, poles, shapes, signals = a_problem(1)
    rows = np.zeros(120, bool)
    for first, last in runs:
        rows[first:last] = True
    columns = written_out(poles, shapes, 120)
    chosen = columns[rows].reshape(-1, 8)
    energy = (
        0.5 * (np.abs(shapes) ** 2).sum(axis=0) * (np.abs(poles) ** (2 * np.arange(120)[:, np.newaxis])).sum(axis=0)
    )
    scale = np.concatenate([energy, energy, np.full(2, rows.sum())])
    matrix = chosen.T @ chosen + STATE_REGULARISATION * np.diag(scale)
    expected = np.linalg.solve(matrix, chosen.T @ signals[rows].ravel())
    powers = poles ** np.arange(120)[:, np.newaxis]
    products = ((powers[:, np.newaxis, :] * shapes) * signals[:, :, np.newaxis])[rows].sum(axis=(0, 1))
    state, level = fit_initial_state(
        poles, shapes, products, signals[rows].sum(axis=0), patterns=[(np.arange(2), runs, 1)], n_samples=120
    )
    # imaginary part of a real pole's state: with complex shapes it counts like any other
    np.testing.assert_allclose(np.concatenate([state.real, state.imag, level]), expected, rtol=1e-7, atol=1e-9)


def test_no_rows_no_state():
    _, poles, shapes, _ = a_problem(2)
    state, level = fit_initial_state(
        poles, shapes, np.zeros(3, complex), np.zeros(2), patterns=[(np.arange(2), [], 1)], n_samples=120
    )
    np.testing.assert_array_equal(state, 0.0)
    np.testing.assert_array_equal(level, 0.0)


def test_no_poles_leave_the_mean():
    nothing = np.zeros(0, complex)
    state, level = fit_initial_state(
        nothing,
        np.zeros((2, 0), complex),
        nothing,
        np.array([10.0, -20.0]),
        patterns=[(np.arange(2), [(0, 10)], 1)],
        n_samples=10,
    )
    assert state.size == 0
    np.testing.assert_allclose(level, [1.0, -2.0], rtol=1e-8)
