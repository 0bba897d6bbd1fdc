"""The straight line that stands for a force over a step: its impulse and its moment against quadrature."""

import numpy as np
import pytest
from engine_plants import VALUES, some_records, two_masses, with_effects

from modal.simulation.drive import drive_of
from modal.simulation.forces import force_line, motion_at, one_on, port_rows


def line_of(key, path, smoothing=0.005):
    """Line and true force over steps of a motion with displacement `path(t)` and velocity `path.deriv`."""
    plant = two_masses()
    drive = drive_of(some_records(plant, lengths=(40, 41), dt=0.02))
    assembly, _ = with_effects(plant, [key], 2)
    item = assembly.placements[0]
    speed = path.deriv()
    t = drive.time
    states = np.stack([path(t), 0 * t, speed(t), 0 * t], axis=1)
    motion = motion_at(item, states, drive, np.zeros((len(t), 0)), smoothing)
    effect, port = item.force_and_port
    values = VALUES[key]
    line = force_line(
        effect,
        values,
        port,
        motion,
        one_on(motion),
        force=effect.force(values, motion),
        dt=drive.dt,
    )
    nodes, weights = np.polynomial.legendre.leggauss(400)
    mean, moment = np.zeros(39), np.zeros(39)
    for node, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        at = t[:39] + node * drive.dt
        states = np.stack([path(at), 0 * at, speed(at), 0 * at], axis=1)
        short = drive_of(some_records(plant, lengths=(39,), levels=(1.0,), dt=0.02))
        value = effect.force(values, motion_at(item, states, short, np.zeros((39, 0)), smoothing)).value
        mean += weight * value
        moment += weight * (node - 0.5) * value
    return line, mean, moment


@pytest.mark.parametrize("key", ["cubic_stiffness", "quadratic_stiffness", "quadratic_drag", "sine_softening"])
def test_a_smooth_law_has_its_mean_to_fourth_order(key):
    line, mean, _ = line_of(key, np.polynomial.Polynomial([0.1, 1.2, -1.0, -0.4]))

    assert np.abs(mean_of(line)[:39] - mean).max() < 1e-4 * np.abs(mean).max()


def mean_of(line):
    return (line.start + line.end) / 2


def test_friction_that_reverses_within_a_step_has_its_mean_and_moment():
    """v falls in a straight line through zero at 0.105 s, in the middle of nowhere."""
    line, mean, moment = line_of("coulomb_friction", np.polynomial.Polynomial([0.0, 2.1, -10.0]))
    size = VALUES["coulomb_friction"][0]
    assert np.abs(mean_of(line)[:39] - mean).max() < 5e-3 * size
    assert np.abs((line.end - line.start)[:39] / 12 - moment).max() < 5e-3 * size
    assert np.count_nonzero(np.abs(mean) < 0.9 * size) == 1


def test_the_coordinates_of_a_port():
    plant = two_masses()
    rows = port_rows(plant.port("between"), 4, 7, slice(5, 7))
    assert np.array_equal(
        rows, [[-1, 1, 0, 0, 0, 0, 0], [0, 0, -1, 1, 0, 0, 0], [0, 0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 0, 1]]
    )


def test_what_the_line_adds_to_a_step():
    line, _, _ = line_of("cubic_stiffness", np.polynomial.Polynomial([0.1, 1.0]))
    found = line.flow(np.array([1.0, 0.0]), np.array([2.0, 5.0]))
    assert np.array_equal(found[:, 0], line.start + 2 * line.end)
    assert np.array_equal(found[:, 1], 5 * line.end)
