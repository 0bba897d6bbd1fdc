"""The real modal form: the same system, block by block."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.structure.continuous_time import ContinuousSystem, in_modal_coordinates


def system_of(A: np.ndarray, rng: np.random.Generator) -> ContinuousSystem:
    return ContinuousSystem(
        A=A, B=rng.standard_normal((len(A), 2)), C=rng.standard_normal((3, len(A))), D=rng.standard_normal((3, 2))
    )


@given(seed=st.integers(0, 10**6), n_states=st.integers(1, 7))
@settings(max_examples=40, deadline=None)
def test_keeps_the_transfer_function(seed: int, n_states: int) -> None:
    rng = np.random.default_rng(seed)
    given_system = system_of(rng.standard_normal((n_states, n_states)) - 3 * np.eye(n_states), rng)
    form = in_modal_coordinates(given_system, frequency_tolerance=0.1, damping_tolerance=0.5)
    angular = np.array([0.0, 0.7, 3.0])
    wanted = given_system.response(angular)
    np.testing.assert_allclose(form.system.response(angular), wanted, atol=1e-8 * np.abs(wanted).max())
    assert len(form.parameters) == n_states == len(form.slopes)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_blocks_stand_on_the_diagonal_and_states_are_balanced(seed: int) -> None:
    rng = np.random.default_rng(seed)
    form = in_modal_coordinates(
        system_of(rng.standard_normal((6, 6)) - 3 * np.eye(6), rng), frequency_tolerance=0.1, damping_tolerance=0.5
    )
    whole = np.tensordot([one.nominal for one in form.parameters], form.slopes, axes=(0, 0))
    np.testing.assert_allclose(whole, form.system.A, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(form.system.B), np.linalg.norm(form.system.C), rtol=1e-9)


def test_bad_scaling_of_the_given_states_does_no_harm() -> None:
    rng = np.random.default_rng(0)
    scale = np.array([1e6, 1e-4, 1.0, 1e3])
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-500.0, 200, -0.3, 0.2], [100, -100, 0.1, -0.1]])
    plain = system_of(A, rng)
    scaled = ContinuousSystem(A=A * scale[:, None] / scale, B=plain.B * scale[:, None], C=plain.C / scale, D=plain.D)
    form = in_modal_coordinates(scaled, frequency_tolerance=0.1, damping_tolerance=0.5)
    angular = np.array([1.0, 8.0, 23.0])
    np.testing.assert_allclose(form.system.response(angular), plain.response(angular), rtol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(form.system.B[:2]), np.linalg.norm(form.system.C[:, :2]), rtol=1e-9)


@pytest.mark.parametrize(
    "A",
    [
        np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 0.5], [0.0, 0.0, -1.0]]),
        np.kron(np.eye(2), [[-0.1, 2.0], [-2.0, -0.1]]) + np.diag([1.0, 1.0], 2),
    ],
)
def test_coinciding_poles_without_independent_shapes(A: np.ndarray) -> None:
    given_system = system_of(A, np.random.default_rng(1))
    form = in_modal_coordinates(given_system, frequency_tolerance=0.1, damping_tolerance=0.5)
    angular = np.array([0.3, 2.5])
    np.testing.assert_allclose(form.system.response(angular), given_system.response(angular), rtol=1e-6)
    assert len(form.parameters) == len(A)
    first = form.parameters[0]
    moved = form.system.A + 0.3 * first.deviation * form.slopes[0]
    shifted = np.linalg.eigvals(moved).real - np.linalg.eigvals(form.system.A).real.mean()
    assert shifted.max() == pytest.approx(0.3 * first.deviation, rel=0.01, abs=1e-4)


def test_bounds_keep_poles_stable() -> None:
    rng = np.random.default_rng(3)
    form = in_modal_coordinates(
        system_of(np.array([[-0.02, 5.0, 0.0], [-5.0, -0.02, 0.0], [0.0, 0.0, -0.7]]), rng),
        frequency_tolerance=0.1,
        damping_tolerance=0.5,
    )
    by_name = {one.name: one for one in form.parameters}
    real = by_name["real pole 1 (-0.7 1/s)"]
    np.testing.assert_allclose([real.nominal, real.lower, real.upper], [-0.7, -1.75, -0.28])
    pair = by_name["real part of pole pair 2 (0.7958 Hz)"]
    np.testing.assert_allclose([pair.lower, pair.upper, pair.deviation], [-0.05, -0.008, 0.01])
    imaginary = by_name["imaginary part of pole pair 2 (0.7958 Hz)"]
    np.testing.assert_allclose([imaginary.lower, imaginary.upper], [5 - 1.5, 5 + 1.5], rtol=1e-3)
