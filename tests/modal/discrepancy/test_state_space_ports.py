"""The direction of a force at a place of a state space."""

import numpy as np
import pytest
from chains import Chain

from modal.discrepancy.plant import plant_matrices
from modal.discrepancy.state_space_plant import state_space_plant


class StateSpace:
    """What the plant reads of a control.StateSpace."""

    def __init__(self, system):
        self.A, self.B, self.C, self.D, self.dt = system.A, system.B, system.C, system.D, 0.0


def entering(chain, port_name):
    """(n_states, n_columns) of the port in the chain's [x; v]."""
    plant = state_space_plant(StateSpace(chain.system), sensor_kind="displacement")
    m = plant_matrices(plant, plant.nominal)
    # both in real modal form, which is unique up to a turn of each block: the outputs' derivatives tell the states
    n = len(m.A)
    rows = np.vstack([m.C @ np.linalg.matrix_power(m.A, k) for k in range(n)])
    known = np.vstack([chain.system.C @ np.linalg.matrix_power(chain.system.A, k) for k in range(n)]) @ chain.states
    return np.linalg.solve(np.linalg.lstsq(rows, known, rcond=None)[0], m.E[:, list(plant.port(port_name).columns)])


@pytest.mark.parametrize("seed", range(4))
def test_a_force_on_a_measured_mass_moves_that_mass_alone(seed):
    chain = Chain(seed, 3, (0, 1, 2), 1)
    for i in range(3):
        found = entering(chain, f"output_{i}")
        np.testing.assert_allclose(found, -np.eye(6)[:, [3 + i]], atol=1e-6)  # per effective mass, opposing


@pytest.mark.parametrize("seed", range(4))
def test_a_force_between_two_masses_pushes_both_by_their_masses(seed):
    chain = Chain(seed, 3, (0, 1, 2), 0)
    mobility = 1 / chain.masses
    wanted = np.zeros((6, 1))
    wanted[3, 0], wanted[5, 0] = -mobility[0], mobility[2]
    np.testing.assert_allclose(entering(chain, "output_0-output_2"), wanted / (mobility[0] + mobility[2]), atol=1e-6)


def test_the_direction_is_open_where_a_mass_is_not_measured():
    """Of the three that forces can have: something may act on the unseen mass too."""
    chain = Chain(1, 3, (0, 2), 0)
    found = entering(chain, "output_0")
    assert found.shape == (6, 3)
    np.testing.assert_allclose(found[:3], 0.0, atol=1e-6)  # no displacement at once, that of the unseen mass neither
    np.testing.assert_allclose(found[3], [-1.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(found[4:, 0], 0.0, atol=1e-6)  # the first is along the sensor


def test_the_direction_is_open_where_the_plant_is_not_reciprocal():
    assert entering(Chain(1, 2, (0, 1), 0), "output_0").shape == (4, 1)
    assert entering(Chain(1, 2, (0, 1), 0, gyroscopic=2.0), "output_0").shape == (4, 2)
