"""The structure behind a state space: of chains whose M, C, K are known, and of systems that are no structure."""

import numpy as np
import pytest
import scipy
from chains import Chain

from modal.structure.continuous_time import ContinuousSystem
from modal.structure.reciprocity import reciprocal_structure


def found_of(chain):
    return reciprocal_structure(chain.system, chain.system.C, chain.free)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("n_dofs", "sensors"), [(1, (0,)), (2, (0, 1)), (3, (0, 1, 2)), (3, (0, 2)), (3, (1, 2))])
def test_the_structure_of_a_chain_pushed_where_it_is_measured(seed, n_dofs, sensors):
    chain = Chain(seed, n_dofs, sensors, sensors[seed % len(sensors)])
    found = found_of(chain)
    squares, shapes = scipy.linalg.eigh(chain.stiffness, np.diag(chain.masses))
    # masses are open up to one factor: the size of the push is not known
    np.testing.assert_allclose(found.stiffness, squares, rtol=1e-7)
    np.testing.assert_allclose(np.abs(found.damping), np.abs(shapes.T @ chain.damping @ shapes), atol=1e-8)
    modal = found.displacements @ chain.states
    ratio = np.abs(modal[:, :n_dofs]) / np.abs(shapes.T * chain.masses)
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-6)
    np.testing.assert_allclose(modal[:, n_dofs:], 0.0, atol=1e-7 * np.abs(modal).max())
    np.testing.assert_allclose(found.displacements @ found.forces, 0.0, atol=1e-8 * np.abs(modal).max() * ratio[0, 0])
    np.testing.assert_allclose(found.displacements @ chain.system.A @ found.forces, np.eye(n_dofs), atol=1e-8)
    angles = scipy.linalg.subspace_angles(chain.forces, found.forces)
    assert np.sin(angles).max() < 1e-6


def test_without_a_driving_point_all_displacements_tell_it_too():
    """Two forces at once on two masses push along no sensor; damping that couples the modes still leaves one P."""
    chain = Chain(3, 3, (0, 1, 2), 0)
    mixed = ContinuousSystem(
        A=chain.system.A, B=chain.forces @ np.array([[1.0], [-0.7], [0.4]]), C=chain.system.C, D=chain.system.D
    )
    found = reciprocal_structure(mixed, mixed.C, chain.free)
    np.testing.assert_allclose(
        found.stiffness, scipy.linalg.eigvalsh(chain.stiffness, np.diag(chain.masses)), rtol=1e-6
    )


@pytest.mark.parametrize("seed", range(6))
def test_two_modes_without_a_driving_point_leave_nothing_to_check_by(seed):
    """Three equations for four numbers: some P would solve them for any plant, an asymmetric one included."""
    chain = Chain(seed, 2, (0, 1), 0, gyroscopic=2.0 * (seed % 2))
    pushed = ContinuousSystem(
        A=chain.system.A, B=chain.forces @ np.array([[1.0], [-0.7]]), C=chain.system.C, D=chain.system.D
    )
    assert reciprocal_structure(pushed, pushed.C, chain.free) is None


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("n_dofs", "sensors"), [(2, (0, 1)), (3, (0, 1, 2)), (3, (0, 2))])
def test_a_spinning_rotor_is_not_reciprocal(seed, n_dofs, sensors):
    """Gyroscopic forces: each mass pushes the other by its velocity, one of them the other way."""
    assert found_of(Chain(seed, n_dofs, sensors, 0)) is not None
    assert found_of(Chain(seed, n_dofs, sensors, 0, gyroscopic=2.0)) is None


@pytest.mark.parametrize("seed", range(6))
def test_a_sensor_of_a_wrong_gain_is_one_on_another_mass(seed):
    """A gain of one sensor turns M^-1 K into that of other masses, and these are found: there is no contradiction."""
    chain = Chain(seed, 2, (0, 1), 0)
    scaled = np.array([[1.0], [1.3]]) * chain.system.C
    found = reciprocal_structure(chain.system, scaled, chain.free)
    np.testing.assert_allclose(found.stiffness, found_of(chain).stiffness, rtol=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_one_sensor_of_two_modes_leaves_nothing_to_check_by(seed):
    assert found_of(Chain(seed, 2, (0,), 0)) is None
    assert found_of(Chain(seed, 3, (0,), 0)) is None


@pytest.mark.parametrize("seed", range(6))
def test_an_unseen_mass_that_is_pushed_leaves_the_structure_open(seed):
    assert found_of(Chain(seed, 3, (0, 2), 1)) is None


def test_negative_masses_are_no_structure():
    """y = q1 - q2 of two uncoupled oscillators, both pushed: reciprocal, but one mass would be negative."""
    A = np.array([[-0.1, 5.0, 0, 0], [-5.0, -0.1, 0, 0], [0, 0, -0.1, 9.0], [0, 0, -9.0, -0.1]])
    B = np.array([[0.0], [1.0], [0.0], [1.0]])
    C = np.array([[1.0, 0.0, -1.0, 0.0], [1.0, 0.0, -1.0, 0.0]])
    system = ContinuousSystem(A=A, B=B, C=C, D=np.zeros((2, 1)))
    same = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    free = np.eye(4)[:, [1, 3]]
    assert reciprocal_structure(system, C[:1], free) is None
    positive = ContinuousSystem(A=A, B=B, C=np.abs(C), D=system.D)
    assert reciprocal_structure(positive, same, free) is None  # two uncoupled plants: their masses have no common scale
    assert reciprocal_structure(positive, np.abs(C[:1]), free) is not None
