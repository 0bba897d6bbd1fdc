"""What was filled takes no true mode's certainty away, and gives none."""

import numpy as np
import pytest
from scipy.signal import lfilter

import modal
from modal.modes.mode import ModalModel, Mode
from modal.verdict.filled import told_where_measured
from okid.record import Record

DT, N = 0.01, 4000
GIVEN = {"observer_order": 20, "ridge": 0.0, "order": 4, "input_delay": 0}
"""What a search would take about the same."""


def answers(force, *modes):
    """(N, n_outputs) sum of modes (frequency [Hz], damping ratio, shape), each of deviation 1 before its shape."""
    total = 0.0
    for frequency, ratio, shape in modes:
        pole = np.exp((-ratio + 1j * np.sqrt(1 - ratio**2)) * 2 * np.pi * frequency * DT)
        moved = lfilter([0, 1], [1, -2 * pole.real, abs(pole) ** 2], force)
        total = total + np.outer(moved / moved.std(), shape)
    return total


def system_near(result, frequency):
    return [mode for mode in result.modes.system if abs(mode.frequency / frequency - 1) < 0.005]


def identified(rng, force, outputs, missing):
    holed = np.where(rng.random(outputs.shape) < missing, np.nan, outputs)
    return modal.identify(Record(force, holed, DT), **GIVEN)


@pytest.mark.parametrize("missing", [0.02, 0.2])
def test_a_mode_that_is_weaker_than_slow_noise_stays_certain(missing):
    """It stands high above the noise in its own band; a variance over all of it called it chance."""
    rng = np.random.default_rng(3)
    force = rng.standard_normal(N)
    outputs = answers(force, (3.0, 0.01, [1.0, 0.7]), (17.0, 0.01, [0.05, -0.05]))
    slow = lfilter([1.0], [1.0, -0.99], rng.standard_normal((N, 2)), axis=0)
    outputs += 0.3 * slow / slow.std(axis=0)
    result = identified(rng, force, outputs, missing)
    assert system_near(result, 3.0)
    assert system_near(result, 17.0)


def test_a_mode_that_one_of_twenty_outputs_shows_stays_certain():
    rng = np.random.default_rng(4)
    force = rng.standard_normal(N)
    local = np.where(np.arange(20) == 3, 0.1, 0.0)
    outputs = answers(force, (5.0, 0.01, rng.standard_normal(20)), (19.0, 0.01, local))
    outputs += 0.03 * rng.standard_normal(outputs.shape)
    result = identified(rng, force, outputs, 0.02)
    assert system_near(result, 5.0)
    assert system_near(result, 19.0)


def test_a_model_of_the_filled_record_alone_has_no_certain_mode():
    """Of a decay at every second and third row it was certain 12 deviations off: errors of filling are no noise."""
    rng = np.random.default_rng(5)
    force = rng.standard_normal(N)
    outputs = answers(force, (3.0, 0.01, [1.0, 0.7])) + 0.03 * rng.standard_normal((N, 2))
    there = rng.random(outputs.shape) > 0.2
    result = modal.identify(Record(force, np.where(there, outputs, np.nan), DT), **GIVEN | {"order": 2})
    left = [record.outputs - run.outputs for record, run in zip(result.records, result.simulated, strict=True)]
    asked = (result.modes, result.records, left, [there])
    assert told_where_measured(*asked, is_driven=True, is_fitted=True).system
    assert not told_where_measured(*asked, is_driven=True, is_fitted=False).system


def test_images_of_a_slow_sensor_are_not_certain_and_the_modes_are():
    rng = np.random.default_rng(7)
    force = rng.standard_normal(N)
    outputs = answers(force, (4.6, 0.01, [1.0, 0.6, -0.4]), (10.6, 0.01, [0.5, -1.0, 0.8]))
    outputs += 0.03 * rng.standard_normal(outputs.shape)
    outputs[np.arange(N) % 10 != 0, 1:] = np.nan
    result = modal.identify(Record(force, outputs, DT), **GIVEN)
    assert len(result.modes.system) == 2
    assert system_near(result, 4.6)
    (mode,) = system_near(result, 10.6)
    assert (mode.shape / mode.shape[0]).real == pytest.approx([1.0, -2.0, 1.6], rel=0.1)


@pytest.mark.parametrize("seeds", [(1,), pytest.param((0, 1), marks=pytest.mark.slow)])
def test_deviations_of_a_decay_with_missing_samples_hold(seeds):
    """They were two to four times too small, and every fourth mode had none: a first model had made the samples."""
    z = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        turned = 2 * np.pi * DT * np.arange(3000)
        modes = [(5.1, 0.006), (13.7, 0.01), (24.3, 0.008)]
        each = [np.exp(-z * f * turned) * np.cos(f * np.sqrt(1 - z**2) * turned + f) for f, z in modes]
        outputs = np.column_stack(each) @ rng.standard_normal((3, 3)) + 6e-3 * rng.standard_normal((3000, 3))
        outputs[rng.random(outputs.shape) < 0.1] = np.nan
        result = modal.identify(Record([], outputs, DT), kind="decay", observer_order=91, ridge=3e-6, order=6)
        for frequency, ratio in modes:
            (mode,) = system_near(result, frequency)
            z.append((mode.frequency - frequency) / mode.frequency_std)
            z.append((mode.damping_ratio - ratio) / mode.damping_ratio_std)
    assert np.isfinite(z).all()
    assert np.sqrt(np.mean(np.square(z))) < 2.0


def struck(*hits):
    """Certain modes of one of four outputs a row, struck once a record: what the verdict on filled samples is given."""
    rng, modes, poles = np.random.default_rng(4), [], []
    for frequency, ratio in ((8.0, 0.01), (21.0, 0.012), (37.0, 0.008)):
        pole = 2 * np.pi * frequency * complex(-ratio, np.sqrt(1 - ratio**2))
        shape = rng.uniform(0.3, 1.0, 4) * rng.choice([-1, 1], 4)
        known = {"frequency": frequency, "damping_ratio": ratio, "shape": shape, "participation": np.ones(1)}
        modes.append(Mode(pole=pole, kind="oscillatory", verdict="system", **known))
        poles.append(pole)
    records, left, there = [], [], []
    for hit in hits:
        force = np.zeros(700)
        force[hit : hit + 3] = [0.5, 1.0, 0.4]
        moved = [lfilter([0, 1], [1, -np.exp(0.005 * pole)], force + 0j).real for pole in poles]
        left.append(0.02 * rng.standard_normal((700, 4)))
        records.append(Record(force, 2 * np.array(moved).T @ [mode.shape for mode in modes] + left[-1], 0.005))
        there.append(np.arange(700)[:, np.newaxis] % 4 == np.arange(4))
    told = ModalModel(modes=tuple(modes), dt=0.005, indicator_caution=0.1)
    return told_where_measured(told, records, left, there, is_driven=False, is_fitted=True)


def test_one_blow_measured_by_turns_tells_no_line_from_its_images_and_blows_at_other_turns_do():
    """Each output fits the images as well as the lines where all blows fall into rows of one turn."""
    for hits in ((20,), (20, 24, 40)):
        assert not struck(*hits).system
        assert all("an image of it fits" in mode.reason for mode in struck(*hits))
    assert len(struck(20, 25, 31).system) == 3
