import numpy as np
import pytest
from control import StateSpace

from modal.discrepancy.plant import plant_matrices
from modal.discrepancy.state_space_plant import state_space_plant
from modal.discrepancy.tank_levels import is_length

MIX = np.array([[0.3, -1.2], [0.8, 0.5]])


def cascade(first, last, *, mix=None):
    """h1' = u - first h1, h2' = first h1 - last h2; h2 is measured."""
    A, B, C = np.array([[-first, 0.0], [first, -last]]), np.array([[1.0], [0.0]]), np.array([[0.0, 1.0]])
    T = np.eye(2) if mix is None else mix
    return StateSpace(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), np.zeros((1, 1)))


def levels_by_frequency(first, last, s):
    """h1 and h2 for a unit inflow."""
    upper = 1.0 / (s + first)
    return upper, first * upper / (s + last)


def test_the_level_before_the_last_tank_is_known_without_a_sensor():
    first, last = 0.2, 0.05
    plant = state_space_plant(cascade(first, last, mix=MIX), sensor_kind="displacement", output_names=["h"])
    ports = {port.name: port for port in plant.ports}
    assert set(ports) == {"h", "h level", "h upstream 1", "h upstream 2"}
    m = plant_matrices(plant, plant.nominal)
    for s in (0.01j, 0.3j, 0.1 + 0.2j):
        upper, lower = levels_by_frequency(first, last, s)
        states = np.linalg.solve(s * np.eye(2) - m.A, m.B.astype(complex))[:, 0]
        found = {name: ports[name].displacement[:2] @ states + ports[name].displacement[2] for name in ports}
        assert found["h level"] == pytest.approx(lower)
        # the slower rate is that of the last tank here: its level at rest is upper x first / last
        assert found["h upstream 1"] == pytest.approx(upper * first / last)
        assert found["h upstream 2"] != pytest.approx(upper, rel=0.1)


def test_a_flow_between_the_tanks_is_among_the_directions_of_the_upper_level():
    plant = state_space_plant(cascade(0.1, 0.1 + 1e-3, mix=MIX), sensor_kind="displacement", output_names=["h"])
    port = plant.port("h upstream")
    m = plant_matrices(plant, plant.nominal)
    columns = m.E[:, list(port.columns)]
    assert columns.shape == (2, 2)
    np.testing.assert_allclose(port.displacement[:2] @ columns, [-1.0, 0.0], atol=1e-9)
    assert np.linalg.matrix_rank(columns) == 2
    assert port.velocity is None
    assert port.accepts == {"flow"}


def test_what_oscillates_is_no_tank_and_what_hardly_does_is():
    def system(real, imaginary):
        A = np.array([[real, imaginary], [-imaginary, real]])
        row = np.array([[1.0, 0.0]])
        return StateSpace(A, np.array([[0.0], [1.0]]), row, np.zeros((1, 1)))

    swinging = state_space_plant(system(-0.1, 0.5), sensor_kind="displacement", output_units=["V"])
    assert [port.name for port in swinging.ports] == ["output_0"]
    assert "motion" in swinging.ports[0].accepts
    nearly = state_space_plant(system(-0.1, 0.005), sensor_kind="displacement", output_units=["V"])
    assert [port.name for port in nearly.ports] == ["output_0", "output_0 level", "output_0 upstream"]
    assert nearly.ports[0].accepts == {"force"}


@pytest.mark.parametrize(("unit", "answer"), [("m", True), ("rad", True), ("", True), ("V", False), ("°C", False)])
def test_which_units_are_lengths(unit, answer):
    assert is_length(unit) is answer
