"""The plant's matrices."""

import numpy as np
import pytest
from engine_plants import DAMPINGS, MASSES, STIFFNESSES, imposed_motion, two_masses

from modal.discrepancy.plant import plant_matrices


def test_matrices_are_affine_in_the_linear_parameters():
    plant = two_masses()
    found = plant_matrices(plant, np.array([95.0, 1.5]))
    m0, _ = MASSES
    assert found.A[2, 0] == pytest.approx(-(95.0 + STIFFNESSES[1]) / m0)
    assert found.A[2, 2] == pytest.approx(-(1.5 + DAMPINGS[1]) / m0)
    assert np.array_equal(found.C[2], found.A[2])
    assert np.array_equal(found.D[2], found.B[2])
    assert np.array_equal(found.G[2], found.E[2])
    assert found.E.shape == (4, 3)
    assert (plant.n_outputs, plant.n_forces, plant.n_inputs) == (3, 3, 2)
    assert np.array_equal(plant.nominal, [90.0, 0.8])


def test_ports_by_name():
    plant = two_masses()
    assert plant.port("between") is plant.ports[1]
    with pytest.raises(KeyError):
        plant.port("behind")


def test_a_plant_without_states():
    found = plant_matrices(imposed_motion(), np.array([3.0]))
    assert found.A.shape == (0, 0)
    assert np.array_equal(found.D, [[3.0, 0.5, 0.2]])


def test_the_system_cannot_be_changed_in_place():
    with pytest.raises(ValueError, match="read-only"):
        two_masses().system[0, 0, 0] = 1.0
