"""A plant with effects as a model."""

import numpy as np
import pytest

from modal.structure.plant_model import PlantModel
from okid.errors import InvalidDataError


class System:
    """Two masses, both displacements measured."""

    dt = 0.0
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-500.0, 200, -0.3, 0.2], [100, -100, 0.1, -0.1]])
    B = np.array([[0.0], [0.0], [1.0], [0.0]])
    C = np.eye(4)[:2]
    D = np.zeros((2, 1))


def model() -> PlantModel:
    return PlantModel.from_state_space(
        System(), sensor_kind="displacement", output_names=["low", "high"], output_units=["mm", "mm"], dt=0.01
    )


def test_matrices_at_the_nominal_and_at_other_parameters() -> None:
    plain = model()
    s = 3j
    m = plain.matrices
    exact = System.C @ np.linalg.solve(s * np.eye(4) - System.A, System.B.astype(complex))
    np.testing.assert_allclose(m.C @ np.linalg.solve(s * np.eye(4) - m.A, m.B.astype(complex)), exact, rtol=1e-10)
    moved = PlantModel(
        plain.plant, linear=plain.linear + 0.01 * np.array([p.deviation for p in plain.plant.parameters])
    )
    change = np.tensordot(moved.linear - plain.linear, plain.plant.system[1:, :4, :4], axes=(0, 0))
    np.testing.assert_allclose(moved.matrices.A, m.A + change, rtol=1e-10, atol=1e-10)
    assert not moved.linear.flags.writeable


def test_effects_are_added_to_a_copy() -> None:
    plain = model()
    found = plain.with_effect("coulomb_friction", "low-high", Fc=0.1).with_effect("sensor_gain", "high", gain=0.9)
    assert plain.effects == ()
    assert [one.where for one in found.effects] == ["low-high", "high"]
    assert repr(found) == (
        "PlantModel(4 states, inputs ['input_0'], outputs ['low', 'high'], with coulomb_friction at low-high, "
        "sensor_gain at high)"
    )
    assert "Fc = 0.1 mm/s^2" in found.equations()


def test_refuses() -> None:
    with pytest.raises(InvalidDataError, match=r"linear parameters must have shape \(6\), but has \(1,\)"):
        PlantModel(model().plant, linear=np.ones(1))
    with pytest.raises(
        InvalidDataError, match="there is no place 'roof'; cubic_stiffness can act at low, high, low-high"
    ):
        model().with_effect("cubic_stiffness", "roof", k3=1.0)
