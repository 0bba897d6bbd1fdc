"""What each candidate would do by itself."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import some_records, two_masses, with_effects

from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, simulate_at
from modal.discrepancy.port_motion import motion_at
from modal.discrepancy.screen_trials import trials_of


def situation(keys=()):
    plant = two_masses()
    drive = drive_of(some_records(plant))
    assembly, unknowns = with_effects(plant, list(keys), 2)
    problem = Problem(drive=drive, floor=np.full((2, 3), 1e-4))
    return simulate_at(assembly, unknowns, problem), problem


@pytest.mark.parametrize("key", ["bouc_wen_hysteresis", "slack_in_hysteresis", "missing_mode"])
def test_a_force_with_states_of_its_own_follows_the_motion(key):
    """The states by the effect's own steps, one after the other, from zero in each record."""
    current, problem = situation()
    drive, effect = problem.drive, CATALOGUE[key]
    for trial in trials_of(current, problem, effect, "between", 0.05)[:3]:
        states = current.trajectory.states
        memory = np.zeros((drive.n_times, effect.n_memory))
        motion = motion_at(trial.placement, states, drive, memory, 0.05 * drive.level)
        for record in range(2):
            for k in range(drive.firsts[record], drive.firsts[record + 1] - 1):
                pair = [
                    replace(
                        motion,
                        displacement=motion.displacement[[i]],
                        velocity=motion.velocity[[i]],
                        time=motion.time[[i]],
                        memory=memory[[i]],
                        smoothing=float(np.min(motion.smoothing)),  # a law with memory has one width for all
                    )
                    for i in (k, k + 1)
                ]
                memory[k + 1] = effect.advance(trial.values, *pair, drive.dt).value[0]
        force = effect.screen_columns(trial.values, replace(motion, memory=memory))[:, 0]
        column = current.scheme.E0[:, 1]
        expected = force[:, None] * column
        expected[:-1] += force[1:, None] * current.scheme.E1[:, 1]
        lasts = [drive.firsts[1] - 1, drive.firsts[2] - 1]
        error = np.delete(trial.sources[0].flow - expected, lasts, axis=0)
        assert np.abs(error).max() < 1e-4 * np.abs(expected).max()


def test_an_unknown_direction_has_a_source_for_each_column():
    current, problem = situation()
    (trial,) = trials_of(current, problem, CATALOGUE["cubic_stiffness"], "anywhere", 0.05)
    assert len(trial.sources) == 2
    first, second = (source.flow for source in trial.sources)
    force = current.trajectory.states[:, 1] ** 3
    assert np.allclose(
        first[:-1], (force[:, None] * current.scheme.E0[:, 2])[:-1] + force[1:, None] * current.scheme.E1[:, 2]
    )
    assert np.allclose(
        second[:-1], (force[:, None] * current.scheme.E0[:, 0])[:-1] + force[1:, None] * current.scheme.E1[:, 0]
    )


def test_the_highest_peak_of_what_is_left_is_tried():
    current, problem = situation()
    drive = problem.drive
    hum = 0.5 * np.sin(2 * np.pi * 4.3 * drive.time[drive.rows])
    outputs = current.trajectory.outputs + 1e-6 + hum[:, None] * [1.0, 0.0, 0.0]
    problem = replace(problem, drive=replace(drive, outputs=outputs))
    trials = trials_of(current, problem, CATALOGUE["periodic_disturbance"], "ground", 0.05)
    assert min(abs(trial.values[1] - 4.3) for trial in trials) < 0.5
    assert abs(trials[0].values[1] - 4.3) < 1 / (53 * 0.02)


def test_an_effect_that_is_there_is_not_tried_again():
    current, problem = situation(["cubic_stiffness"])
    assert trials_of(current, problem, CATALOGUE["cubic_stiffness"], "ground", 0.05) == []
    assert len(trials_of(current, problem, CATALOGUE["cubic_stiffness"], "between", 0.05)) == 1


def test_sensors_and_inputs():
    current, problem = situation()
    (gain,) = trials_of(current, problem, CATALOGUE["sensor_gain"], "speed", 0.05)
    assert np.array_equal(gain.sources[0].sensed[:, 1], current.trajectory.outputs[:, 1])
    assert not gain.sources[0].sensed[:, [0, 2]].any()
    (gain,) = trials_of(current, problem, CATALOGUE["input_gain"], "push", 0.05)
    drive = problem.drive
    assert np.allclose(gain.sources[0].outputs, drive.sample[drive.rows, :1] @ current.scheme.D[:, :1].T)
    limits = trials_of(current, problem, CATALOGUE["input_saturation"], "push", 0.05)
    assert all(0 < trial.values[0] < np.abs(drive.sample[:, 0]).max() for trial in limits)
