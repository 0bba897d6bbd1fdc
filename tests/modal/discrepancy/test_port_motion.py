"""Motion at a port, at both ends of a step and in its middle."""

from dataclasses import replace

import numpy as np
import pytest
from brim_problem import Tank
from engine_plants import some_records, two_masses, with_effects

from modal.discrepancy.drive import drive_of
from modal.discrepancy.port_motion import midway, motion_at, one_on, shifted, step_compliance
from modal.discrepancy.state_space_plant import state_space_plant


def situation():
    plant = two_masses()
    drive = drive_of(some_records(plant))
    assembly, _ = with_effects(plant, ["cubic_stiffness"], 2, port="between")
    return plant, drive, assembly.placements[0]


def test_it_reads_states_and_inputs_through_the_ports_rows():
    plant, drive, item = situation()
    states = np.random.default_rng(0).standard_normal((drive.n_times, 4))
    row = item.port.displacement + np.array([0, 0, 0, 0, 0.5, -2.0])
    item = replace(item, port=replace(item.port, displacement=row))
    motion = motion_at(item, states, drive, np.zeros((drive.n_times, 0)), 0.01)
    assert np.allclose(
        motion.displacement, states[:, 1] - states[:, 0] + 0.5 * drive.sample[:, 0] - 2 * drive.sample[:, 1]
    )
    assert np.allclose(motion.velocity, states[:, 3] - states[:, 2])
    assert motion.stiffness == plant.ports[1].stiffness
    assert motion.mass == plant.ports[1].mass
    blind = replace(item, port=replace(item.port, displacement=None, stiffness=None))
    motion = motion_at(blind, states, drive, np.zeros((drive.n_times, 0)), 0.01)
    assert not motion.displacement.any()
    assert motion.stiffness == 1.0


def test_one_on_is_the_next_sample():
    _, drive, item = situation()
    states = np.random.default_rng(0).standard_normal((drive.n_times, 4))
    motion = motion_at(item, states, drive, states[:, :1], 0.01)
    after = one_on(motion)
    for name in ("displacement", "velocity", "time", "memory"):
        assert np.array_equal(getattr(after, name)[:-1], getattr(motion, name)[1:])
    assert np.array_equal(shifted(np.arange(3)), [1, 2, 2])


@pytest.mark.parametrize("powers", [(1.0, -2.0, 0.5, 3.0)])
def test_the_middle_of_a_cubic_is_exact(powers):
    _, drive, item = situation()
    path = np.polynomial.Polynomial(powers)
    speed = path.deriv()
    t, h = np.linspace(-1, 1, drive.n_times), 2 / (drive.n_times - 1)
    states = np.stack([0 * t, path(t), 0 * t, speed(t)], axis=1)
    motion = motion_at(item, states, drive, np.zeros((drive.n_times, 0)), 0.01)
    found = midway(item.port, motion, one_on(motion), h)
    middle = (t[:-1] + t[1:]) / 2
    assert np.allclose(found.displacement[:-1], path(middle), atol=1e-12)
    assert np.allclose(found.velocity[:-1], speed(middle), atol=1e-11)


def test_the_middle_without_displacement_or_velocity_is_the_mean():
    _, drive, item = situation()
    states = np.random.default_rng(0).standard_normal((drive.n_times, 4))
    motion = motion_at(item, states, drive, np.zeros((drive.n_times, 0)), 0.01)
    after = one_on(motion)
    flow = midway(replace(item.port, velocity=None), motion, after, 0.1)
    assert np.allclose(flow.displacement, (motion.displacement + after.displacement) / 2)
    shaft = midway(replace(item.port, displacement=None), motion, after, 0.1)
    assert np.allclose(shaft.velocity, (motion.velocity + after.velocity) / 2)


def test_a_flow_moves_its_level_at_once_and_a_force_moves_no_displacement():
    """States of a third of the level: a flow of 1 takes 1 / s from the level, so dt in a step."""
    tank = state_space_plant(Tank, sensor_kind="displacement")
    (port,) = (port for port in tank.ports if "flow" in port.accepts)
    direction = np.ones(len(port.columns))
    assert step_compliance(tank, port, direction, 0.2) == pytest.approx(0.2)
    assert step_compliance(tank, port, -direction, 0.2) == 0.0  # it would raise the level
    assert step_compliance(tank, replace(port, displacement=None), direction, 0.2) == 0.0
    plant, _, item = situation()
    assert step_compliance(plant, item.port, np.ones(len(item.port.columns)), 0.2) == 0.0
