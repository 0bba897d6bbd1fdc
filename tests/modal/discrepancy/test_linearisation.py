"""Every derivative of a step and of the outputs against central differences, along random trajectories."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import VALUES, imposed_motion, some_records, two_masses, with_effects

from modal.discrepancy.drive import drive_of
from modal.discrepancy.driven import drive_inputs
from modal.discrepancy.linearisation import linearise
from modal.discrepancy.scheme import scheme_and_slopes

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

    return about, states, rng, drive.rows


def smooth(rng, n_times):
    k = np.arange(n_times)[:, None]
    return np.sin(k * rng.uniform(0.03, 0.3, 6) + rng.uniform(0, 6, 6)) / np.sqrt(3)


def worst_slopes(about, states, rng, rows, step=1e-6):
    """Largest errors of the defect's and the outputs' directional derivatives, by their largest entries."""
    found = about(states)
    worst = np.zeros(2)
    for _ in range(4):
        change = rng.standard_normal(states.shape)
        above, below = about(states + step * change), about(states - step * change)
        moved = np.zeros_like(states)
        moved[1:] = np.einsum("kij,kj->ki", found.before[:-1], change[:-1]) + np.einsum(
            "ir,krj,kj->ki", found.U, found.V[:-1], change[1:]
        )
        moved -= change
        outputs = np.einsum("koj,kj->ko", found.H, change[rows])
        for i, (ours, one, other) in enumerate(
            ((moved, above.defect, below.defect), (outputs, above.outputs, below.outputs))
        ):
            difference = (one - other) / (2 * step)
            worst[i] = max(worst[i], np.abs(ours - difference).max() / np.abs(difference).max())
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
    assert not found.before[69].any()
    assert not found.V[69].any()
    changed = states.copy()
    changed[69] += 1.0
    assert np.array_equal(about(changed).defect[70:], found.defect[70:])
    changed = states.copy()
    changed[70] += 1.0
    assert np.array_equal(about(changed).defect[:70], found.defect[:70])


def test_the_inverse_undoes_what_is_implicit_at_the_end_of_a_step():
    about, states, rng, _ = situation(two_masses(), ["missing_mode", "coulomb_friction"])
    found = about(states)
    forcing = rng.standard_normal((3, *states.shape))
    whole = np.eye(states.shape[1]) - found.U @ found.V
    assert np.allclose(np.einsum("kij,ckj->cki", whole, found.advance(forcing)), forcing, atol=1e-10)
    assert np.allclose(whole @ found.transitions(), found.before, atol=1e-10)


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
    assert np.array_equal(unseen.before, free.before)
    assert not np.allclose(seen.defect, free.defect)
