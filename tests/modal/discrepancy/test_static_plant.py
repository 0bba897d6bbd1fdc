"""Imposed motion in, force out."""

import numpy as np
import pytest

from modal.discrepancy.plant import plant_matrices
from modal.discrepancy.state_space_plant import state_space_plant
from modal.discrepancy.static_plant import motion_inputs, static_plant_of_records
from okid.record import Record

TIME = np.arange(400) * 0.01


class Gain:
    """A model without states."""

    def __init__(self, D: list[list[float]]) -> None:
        self.D, self.dt = np.array(D), 0.01
        self.A, self.B = np.zeros((0, 0)), np.zeros((0, self.D.shape[1]))
        self.C = np.zeros((self.D.shape[0], 0))


def record(inputs: list[np.ndarray]) -> Record:
    return Record(np.stack(inputs, axis=1), 3 * np.sin(2 * TIME) + 0.1, 0.01)


def test_the_velocity_of_a_noisy_displacement_is_recognised() -> None:
    rng = np.random.default_rng(0)
    x, v = np.sin(5 * TIME) + 0.02 * rng.standard_normal(400), 5 * np.cos(5 * TIME) + 0.1
    other = rng.standard_normal(400)
    assert motion_inputs([record([x, v])]) == ((0, 1),)
    assert motion_inputs([record([v, other, x])]) == ((1, None), (2, 0))


@pytest.mark.parametrize("factor", [3.0, -1.0, 0.0])
def test_another_scale_is_no_velocity(factor: float) -> None:
    found = motion_inputs([record([np.sin(5 * TIME), factor * 5 * np.cos(5 * TIME) + 1e-9 * TIME])])
    assert found == ((0, None), (1, None))


def test_every_record_must_agree() -> None:
    good = record([np.sin(5 * TIME), 5 * np.cos(5 * TIME)])
    bad = record([np.sin(5 * TIME), np.cos(11 * TIME)])
    assert motion_inputs([good, bad]) == ((0, None), (1, None))
    assert motion_inputs([]) == ()


def test_ports_are_the_motions_and_forces_add_to_the_output() -> None:
    moved = record([np.sin(5 * TIME), 5 * np.cos(5 * TIME)])
    plant = state_space_plant(
        Gain([[40.0, 0.0]]),
        sensor_kind="displacement",
        dt=0.01,
        records=[moved],
        input_names=["displacement", "velocity"],
        output_names=["force"],
        input_units=["in", "in/s"],
        output_units=["kip"],
    )
    (port,) = plant.ports
    assert (port.name, port.length_unit, port.force_unit) == ("displacement", "in", "kip")
    np.testing.assert_array_equal(port.displacement, [1.0, 0.0])
    np.testing.assert_array_equal(port.velocity, [0.0, 1.0])
    m = plant_matrices(plant, plant.nominal)
    assert m.A.shape == (0, 0)
    np.testing.assert_array_equal(m.D, [[40.0, 0.0]])
    np.testing.assert_array_equal(m.G, [[1.0]])
    assert [(one.name, one.nominal) for one in plant.parameters] == [
        ("force by displacement", 40.0),
        ("force by velocity", 0.0),
    ]
    assert [one.unit for one in plant.parameters] == ["kip/in", "kip/(in/s)"]
    size = np.std(moved.outputs) / np.std(moved.inputs, axis=0)
    np.testing.assert_allclose([one.deviation for one in plant.parameters], [max(20.0, size[0]), size[1]])
    np.testing.assert_array_equal(plant_matrices(plant, np.array([7.0, 2.0])).D, [[7.0, 2.0]])


def test_without_records_zero_entries_are_fixed_and_every_input_is_a_displacement() -> None:
    plant = state_space_plant(Gain([[4.0, 0.0], [0.0, 0.0]]), sensor_kind="displacement")
    assert [one.name for one in plant.parameters] == ["output_0 by input_0"]
    assert [port.name for port in plant.ports] == [
        "input_0 to output_0",
        "input_0 to output_1",
        "input_1 to output_0",
        "input_1 to output_1",
    ]
    assert all(port.velocity is None for port in plant.ports)


def test_a_plant_from_a_file_learns_from_the_records() -> None:
    moved = record([np.sin(5 * TIME), 5 * np.cos(5 * TIME)])
    alone = state_space_plant(Gain([[4.0, 0.0]]), sensor_kind="displacement", input_names=["x", "v"])
    learnt = static_plant_of_records(alone, [moved])
    assert [port.name for port in alone.ports] == ["x", "v"]
    assert [port.name for port in learnt.ports] == ["x"]
    assert len(learnt.parameters) == 2
    np.testing.assert_array_equal(plant_matrices(learnt, learnt.nominal).D, [[4.0, 0.0]])
