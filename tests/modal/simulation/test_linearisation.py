"""Every derivative of a step and of the outputs against central differences, along random trajectories."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import VALUES, imposed_motion, some_records, two_masses, with_effects

from modal.simulation.assembly import drive_inputs
from modal.simulation.drive import drive_of
from modal.simulation.linearisation import _inverse, linearise
from modal.simulation.scheme import scheme_and_slopes

SMOOTHING = 0.3
"""Wide, so that differences stay within the bends of the sharp laws."""


def situation(plant, keys, *, upsampling=1, missing=0.2, gain=0.0, port=None):
    drive = drive_of(some_records(plant, missing=missing), upsampling)
    assembly, unknowns = with_effects(plant, keys, drive.n_records, port=port)
    scheme, _ = scheme_and_slopes(plant, unknowns.common[: assembly.n_linear], drive.dt)
    rng = np.random.default_rng(3)
    scales = [0.15, 0.15, 1.0, 1.0][: plant.n_states] + [0.1] * assembly.n_memory
    states = smooth(rng, drive.n_times) @ (rng.standard_normal((6, len(scales))) * scales)
    driven = drive_inputs(assembly, unknowns, drive)
    L = gain * rng.standard_normal((plant.n_states, plant.n_outputs)) if gain else None

    def about(trial):
        return linearise(assembly, unknowns, driven, scheme, trial, smoothing=SMOOTHING, gain=L)

    return about, states, rng, drive.firsts


def smooth(rng, n_times):
    k = np.arange(n_times)[:, None]
    return np.sin(k * rng.uniform(0.03, 0.3, 6) + rng.uniform(0, 6, 6)) / np.sqrt(3)


def worst_slopes(about, states, rng, firsts, step=1e-6):
    """Largest errors of the defect's and the outputs' directional derivatives, by their largest entries."""
    found = about(states)
    worst = np.zeros(2)
    for _ in range(4):
        change = rng.standard_normal(states.shape)
        above, below = about(states + step * change), about(states - step * change)
        by_defect = (above.defect - below.defect) / (2 * step)
        for first in firsts[:-1]:
            assert np.abs(by_defect[first] + change[first]).max() < 1e-6
        # what is implicit at the end of a step is undone: M dX[k] - dX[k+1]
        led = np.zeros((1, *states.shape))
        led[0, :-1] = by_defect[1:]
        led[0, np.array(firsts[1:]) - 1] = 0.0
        difference = found.steps.advance(led)[0]
        moved = np.einsum("ijk,kj->ki", found.steps.transitions, change)
        moved[:-1] -= change[1:]
        moved[np.array(firsts[1:]) - 1] = 0.0
        outputs = found.sensors.outputs(change[None])[0]
        by_outputs = (above.outputs - below.outputs) / (2 * step)
        for i, (ours, theirs) in enumerate(((moved, difference), (outputs, by_outputs))):
            worst[i] = max(worst[i], np.abs(ours - theirs).max() / np.abs(theirs).max())
    return worst


@pytest.mark.parametrize("key", list(VALUES))
def test_every_effect_of_the_catalogue_in_free_run(key):
    worst = worst_slopes(*situation(two_masses(), [key]))
    assert worst.max() < 1e-6, worst


@pytest.mark.parametrize("key", list(VALUES))
def test_every_effect_in_observer_form(key):
    worst = worst_slopes(*situation(two_masses(), [key], gain=0.3))
    assert worst.max() < 1e-6, worst


@pytest.mark.parametrize("key", ["bouc_wen_hysteresis", "slack_in_hysteresis", "missing_mode"])
def test_forces_with_states_of_their_own_on_a_plant_without(key):
    worst = worst_slopes(*situation(imposed_motion(), [key]))
    assert worst.max() < 1e-6, worst


@pytest.mark.parametrize("port", ["between", "anywhere"])
def test_other_places_and_directions(port):
    for keys in (["cubic_stiffness", "coulomb_friction"], ["missing_mode", "bouc_wen_hysteresis"]):
        worst = worst_slopes(*situation(two_masses(), keys, port=port))
        assert worst.max() < 1e-6, (keys, worst)


@pytest.mark.parametrize("gain", [0.0, 0.3])
@pytest.mark.parametrize("upsampling", [1, 3])
def test_a_crowd_of_effects_on_a_finer_grid(gain, upsampling):
    keys = [
        "missing_mode",
        "coulomb_friction",
        "bouc_wen_hysteresis",
        "input_gain",
        "sensor_bias",
        "sensor_gain",
        "cubic_stiffness",
    ]
    worst = worst_slopes(*situation(two_masses(), keys, gain=gain, upsampling=upsampling))
    assert worst.max() < 1e-6, worst


def test_records_do_not_touch():
    about, states, _, _ = situation(two_masses(), ["cubic_stiffness", "bouc_wen_hysteresis"], gain=0.3)
    found = about(states)
    assert 70 in found.steps.firsts
    assert not found.steps.back[:, :, 69].any()
    changed = states.copy()
    changed[69] += 1.0
    assert np.array_equal(about(changed).defect[70:], found.defect[70:])
    changed = states.copy()
    changed[70] += 1.0
    assert np.array_equal(about(changed).defect[:70], found.defect[:70])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7])
def test_the_small_systems_are_inverted_time_by_time(n):
    matrices = np.random.default_rng(n).standard_normal((n, n, 50)) + 4.0 * np.eye(n)[:, :, None]
    expected = np.linalg.inv(matrices.transpose(2, 0, 1)).transpose(1, 2, 0)
    assert np.allclose(_inverse(matrices), expected, rtol=1e-9, atol=1e-12)


def test_a_regular_step_whose_first_lines_are_singular_is_inverted():
    crossed = np.eye(3)[::-1][:, :, None]
    assert np.array_equal(_inverse(crossed), crossed)


def test_nothing_is_led_on_where_there_is_nothing():
    about, states, _, _ = situation(two_masses(), ["cubic_stiffness"])
    assert about(states).steps.advance(np.zeros((0, *states.shape))).shape == (0, *states.shape)


def test_a_step_without_a_unique_end_is_an_error():
    with pytest.raises(np.linalg.LinAlgError), np.errstate(all="ignore"):
        _inverse(np.zeros((2, 2, 3)))


def test_missing_samples_do_not_pull_an_observer():
    plant = two_masses()
    drive = drive_of(some_records(plant))
    blind = replace(drive, present=np.zeros_like(drive.present))
    assembly, unknowns = with_effects(plant, ["cubic_stiffness"], 2)
    scheme, _ = scheme_and_slopes(plant, unknowns.common[: assembly.n_linear], drive.dt)
    states = np.random.default_rng(0).standard_normal((drive.n_times, 4))
    gain = np.full((4, 3), 0.2)
    free, unseen, seen = (
        linearise(assembly, unknowns, one, scheme, states, smoothing=SMOOTHING, gain=g)
        for one, g in ((drive, None), (blind, gain), (drive, gain))
    )
    assert np.array_equal(unseen.defect, free.defect)
    assert np.array_equal(unseen.steps.transitions, free.steps.transitions)
    assert not np.allclose(seen.defect, free.defect)
