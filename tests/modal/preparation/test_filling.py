import numpy as np
import pytest
import scipy
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, simulate

import modal
from modal.preparation.filling import fill_where_needed
from modal.preparation.steps import prepare
from okid.errors import InvalidDataError
from okid.record import Record

N = 3000
GIVEN = {"observer_order": 20, "ridge": 0.0, "input_delay": 0}
"""What a search would take about the same, so that tests of what comes after it cost a quarter."""


def clean_and_noisy(seed, *, noise=0.03, n_samples=N):
    rng = np.random.default_rng(seed)
    system = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015], n_outputs=2)
    inputs = random_inputs(rng, n_samples, 2)
    clean = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    return clean, Record(inputs, with_noise(rng, clean, noise), system.dt)


def gone(pattern, n_samples=N):
    """(n_samples, 2) True where a sample is missing."""
    rows = np.arange(n_samples)[:, np.newaxis]
    if pattern == "every second row":
        return np.repeat(rows % 2 == 1, 2, axis=1)
    if pattern == "two rates":
        return np.hstack([rows < 0, rows % 3 != 0])
    if pattern == "by turns":
        return np.hstack([rows % 2 == 1, rows % 2 == 0])
    return np.random.default_rng(9).random((n_samples, 2)) < float(pattern)


def with_gaps(record, missing):
    return Record(record.inputs, np.where(missing, np.nan, record.outputs), record.dt)


@pytest.mark.parametrize("pattern", ["every second row", "two rates", "by turns", "0.01", "0.2"])
def test_filled_samples_are_nearer_to_the_truth_than_a_measurement(pattern):
    clean, record = clean_and_noisy(1)
    missing = gone(pattern)
    filling = fill_where_needed([with_gaps(record, missing)])
    (filled,) = filling.records
    np.testing.assert_array_equal(filled.outputs[~missing], record.outputs[~missing])
    np.testing.assert_array_equal(filling.measured[0], ~missing)
    error = (filled.outputs - clean)[missing]
    assert np.sqrt(np.mean(np.square(error))) < 0.5 * 0.03 * clean.std()
    assert "samples filled" in filling.choices[0].value


def test_a_long_gap_is_left_alone():
    """It takes few rows, and no model of them is needed."""
    _, record = clean_and_noisy(2)
    missing = np.zeros((N, 2), dtype=bool)
    missing[500:800, 1] = True
    gaps = with_gaps(record, missing)
    filling = fill_where_needed([gaps])
    assert filling.records[0] is gaps
    assert filling.choices == ()


def test_several_records_are_filled_by_one_model():
    clean, record = clean_and_noisy(3)
    missing = gone("every second row")
    gaps = with_gaps(record, missing)
    first, second = fill_where_needed([gaps.samples(0, 1800), gaps.samples(1800)]).records
    error = np.vstack([first.outputs, second.outputs]) - clean
    assert np.sqrt(np.mean(np.square(error[missing]))) < 0.5 * 0.03 * clean.std()


def test_what_the_inputs_do_not_explain_is_interpolated():
    """Half of the motion is a slow disturbance: its neighbours tell of it, the inputs do not."""
    clean, record = clean_and_noisy(4)
    disturbance = np.cos(0.05 * np.arange(N))[:, np.newaxis] * clean.std(axis=0)
    missing = gone("0.2")
    gaps = with_gaps(Record(record.inputs, record.outputs + disturbance, record.dt), missing)
    (filled,) = fill_where_needed([gaps]).records
    error = (filled.outputs - clean - disturbance)[missing]
    assert np.sqrt(np.mean(np.square(error))) < 0.15 * clean.std()


def test_without_inputs_neighbours_are_all_there_is():
    time = np.arange(N) * 0.05
    wave = np.column_stack([np.sin(time), np.cos(time)])
    missing = gone("0.05")
    gaps = Record([], np.where(missing, np.nan, wave), 0.01)
    filling = fill_where_needed([gaps])
    assert np.abs((filling.records[0].outputs - wave)[missing]).max() < 0.05
    assert "interpolated" in filling.choices[0].reason


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_an_output_at_every_twentieth_row_shows_the_states_of_the_others(seed):
    """It had the poles of its images, 40 of them, and a shape of a tenth."""
    rng = np.random.default_rng(seed)
    frequency, times = 1.3 + 0.4 * seed, 0.02 * np.arange(1400)
    wave = np.exp(-0.004 * 2 * np.pi * frequency * times) * np.cos(2 * np.pi * frequency * times)
    outputs = wave[:, np.newaxis] * [1.0, 0.6] + 2e-3 * rng.standard_normal((1400, 2))
    outputs[np.arange(1400) % 20 != 0, 1] = np.nan
    result = modal.identify(Record([], outputs, 0.02), kind="decay", observer_order=64, ridge=0.0)
    near = [mode for mode in result.modes if abs(mode.frequency / frequency - 1) < 1e-3 and mode.verdict != "noise"]
    assert len(near) == 1
    assert abs(near[0].shape[1] / near[0].shape[0]) == pytest.approx(0.6, rel=0.02)
    assert all(mode in near for mode in result.modes.system)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_images_of_rows_that_outputs_do_not_share_are_not_certain(seed):
    """At every second row by turns a frequency and its image at 25 Hz less look alike: half of each was certain."""
    frequency, times = 1.3 + 0.8 * seed, 0.02 * np.arange(700)
    wave = np.exp(-0.01 * 2 * np.pi * frequency * times) * np.cos(2 * np.pi * frequency * times)
    outputs = wave[:, np.newaxis] * [1.0, 0.6] + 2e-3 * np.random.default_rng(seed).standard_normal((700, 2))
    outputs[gone("by turns", 700)] = np.nan
    result = modal.identify(Record([], outputs, 0.02), kind="decay", observer_order=64, ridge=0.0)
    assert not [mode for mode in result.modes.system if mode.frequency > 12.5]
    assert not [mode for mode in result.modes.system if abs(mode.frequency / frequency - 1) > 0.01]


def shaken(rng, n_samples, *, dt=0.02, noise=0.05):
    """(frequencies, damping ratios, shapes, outputs) of three modes in wind: velocities, by exact steps."""
    frequencies, ratios = np.array([3.0, 7.1, 12.4]), np.array([0.01, 0.012, 0.008])
    shapes = np.array([[0.4, 1.0, 0.7], [0.8, 0.3, -1.0], [1.0, -0.9, 0.5], [0.6, 0.6, 0.9]])
    wind = rng.standard_normal((n_samples, 4)) @ shapes
    outputs = np.zeros((n_samples, 4))
    for i in range(3):
        w = 2 * np.pi * frequencies[i]
        step = scipy.linalg.expm(dt * np.array([[0.0, 1.0, 0.0], [-(w**2), -2 * ratios[i] * w, 1.0], [0.0] * 3]))
        state, moved = np.zeros(2), np.empty(n_samples)
        for k in range(n_samples):
            moved[k] = state[1]
            state = step[:2, :2] @ state + step[:2, 2] * wind[k, i]
        outputs += np.outer(moved, shapes[:, i])
    return frequencies, shapes, outputs + noise * outputs.std(axis=0) * rng.standard_normal(outputs.shape)


@pytest.mark.parametrize("rates", [pytest.param((1, 1, 1, 5), marks=pytest.mark.slow), (1, 1, 3, 7)])
def test_slow_sensors_of_a_shaken_structure_show_no_images(rates):
    """Interpolated by themselves they had up to 16 of them, all certain, and spoilt the shapes of the true modes."""
    frequencies, shapes, outputs = shaken(np.random.default_rng(0), 4000)
    outputs[np.arange(4000)[:, np.newaxis] % np.array(rates) != 0] = np.nan
    result = modal.identify(Record([], outputs, 0.02), observer_order=16, ridge=3e-6, order=27)
    found = result.modes.system
    assert [round(mode.frequency, 0) for mode in found] == [3.0, 7.0, 12.0]
    for mode, true in zip(found, shapes.T, strict=True):
        assert abs(np.vdot(mode.shape, true)) ** 2 / np.vdot(mode.shape, mode.shape).real / (true @ true) > 0.995
        assert abs(mode.frequency - frequencies[found.index(mode)]) < 4 * mode.frequency_std


def test_lines_that_outputs_measured_by_turns_cannot_tell_from_their_images_are_not_certain():
    """Two sensors at even rows and two at odd ones: 12.6, 17.9 and 22 Hz were certain, images of 12.4, 7.1 and 3 Hz."""
    frequencies, _, outputs = shaken(np.random.default_rng(0), 6000)
    outputs[::2, :2], outputs[1::2, 2:] = np.nan, np.nan
    result = modal.identify(Record([], outputs, 0.02), order=6, **GIVEN)
    assert result.modes.system
    assert all(np.abs(frequencies - mode.frequency).min() < 0.05 for mode in result.modes.system)
    images = [mode for mode in result.modes if abs(mode.frequency - (25.0 - 7.1)) < 0.1 and mode.verdict != "noise"]
    assert all("image" in mode.reason for mode in images)


PATTERNS = {
    "15 % at random": lambda k, rng: rng.random((k.size, 3)) < 0.15,
    "one at every 3rd, one at every 20th row": lambda k, rng: np.column_stack([k < 0, k % 3 != 0, k % 20 != 0]),
    "by turns": lambda k, rng: k[:, np.newaxis] % 3 != np.arange(3),
}


@pytest.mark.parametrize("pattern", PATTERNS)
def test_deviations_are_those_of_what_was_measured(pattern):
    """Filled samples were counted: 10 to 110 deviations off at two rates, 2.2 in the mean at half of the samples."""
    scores = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        n, dt = 2500, 0.01
        force, outputs = rng.standard_normal(n), np.zeros((n, 3))
        truth = list(zip(np.sort(rng.uniform(2, 35, 3)), rng.uniform(0.004, 0.02, 3), strict=True))
        for f, ratio in truth:
            pole = np.exp((-ratio + 1j * np.sqrt(1 - ratio**2)) * 2 * np.pi * f * dt)
            moved = scipy.signal.lfilter([0, 1], [1, -2 * pole.real, abs(pole) ** 2], force)
            outputs += np.outer(moved / moved.std(), rng.standard_normal(3))
        outputs += 0.03 * rng.standard_normal((n, 3))
        outputs[PATTERNS[pattern](np.arange(n), rng)] = np.nan
        result = modal.identify(Record(force, outputs, dt), order=6, **GIVEN)
        assert len(result.modes.system) == 3
        for mode, (f, ratio) in zip(result.modes.system, truth, strict=True):
            scores.append((mode.frequency - f) / mode.frequency_std)
            scores.append((mode.damping_ratio - ratio) / mode.damping_ratio_std)
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.6  # of 12
    assert np.abs(scores).max() < 4.0


def test_a_slow_sensor_beside_fast_ones_is_filled():
    clean, record = clean_and_noisy(6)
    missing = np.hstack([np.zeros((N, 1), dtype=bool), np.arange(N)[:, np.newaxis] % 17 != 0])
    (filled,) = fill_where_needed([with_gaps(record, missing)]).records
    error = (filled.outputs - clean)[missing]
    assert np.sqrt(np.mean(np.square(error))) < 0.03 * clean.std()


def oversampled(missing):
    """A mode at 2 Hz of a record at 100 Hz; `missing` (n_samples, 2) samples are gone."""
    rng = np.random.default_rng(7)
    force = rng.standard_normal(len(missing))
    pole = np.exp((-0.01 + 1j) * 2 * np.pi * 2.0 * 0.01)
    moved = scipy.signal.lfilter([0, 1], [1, -2 * pole.real, abs(pole) ** 2], force)
    outputs = np.outer(moved / moved.std(), [1.0, -0.7]) + 0.05 * rng.standard_normal((len(missing), 2))
    return Record(force, np.where(missing, np.nan, outputs), 0.01)


def test_a_record_is_not_decimated_where_that_would_mix_in_what_was_filled():
    """Its damping was up to 14 stated deviations off: nearly all that a filter left was made of filled samples."""
    few = prepare([oversampled(gone("0.005", 6000))])
    factor = round(few.records[0].dt / 0.01)
    assert factor > 1
    assert 0.9 < few.measured_share < 0.999  # a sample that was filled spoils those around
    by_turns = oversampled(gone("by turns", 6000))
    whole = prepare([by_turns])
    assert whole.records[0].dt == 0.01
    assert "without what was filled" in next(c for c in whole.choices if c.what == "frequency band").reason
    with pytest.raises(InvalidDataError, match=r"by 4 would leave 0 % of what .* of output_0 .* leave decimation out"):
        prepare([by_turns], decimation=4)


@pytest.mark.parametrize("first", [0, 1])
def test_half_of_the_rows_are_not_decimated_without_inputs_either(first):
    """One half left nothing measured and ended in a division by zero, the other all, and no word of the rest."""
    _, record = clean_and_noisy(8)
    rows = np.arange(N)[:, np.newaxis] % 2 == first
    with pytest.raises(InvalidDataError, match=r"by 2 would leave 0 %"):
        modal.identify(Record([], np.where(rows, np.nan, record.outputs), record.dt), decimation=2)


@pytest.mark.slow
@pytest.mark.parametrize("turns", [3, 4])
def test_one_blow_measured_by_turns_has_no_certain_image(turns):
    """Each output fits the images as well as the lines: 42 and 45.6 Hz were certain, and 8 Hz 25 deviations off.

    `tests/modal/verdict/test_filled.py` asks the verdict alone of such blows, as of those below.
    """
    rng, n, dt = np.random.default_rng(turns), 1500, 0.005
    force, outputs = np.zeros(n), np.zeros((n, 4))
    force[20:23] = [0.5, 1.0, 0.5]
    truth = [(8.0, 0.01), (21.0, 0.012), (37.0, 0.008)]
    for frequency, ratio in truth:
        pole = np.exp((-ratio + 1j * np.sqrt(1 - ratio**2)) * 2 * np.pi * frequency * dt)
        moved = scipy.signal.lfilter([0, 1], [1, -2 * pole.real, abs(pole) ** 2], force)
        outputs += np.outer(moved / moved.std(), rng.uniform(0.3, 1.0, 4) * rng.choice([-1, 1], 4))
    outputs += 0.02 * rng.standard_normal((n, 4))
    outputs[np.arange(n)[:, np.newaxis] % turns != np.arange(4) % turns] = np.nan
    for mode in modal.identify(Record(force, outputs, dt), kind="transient").modes.system:
        frequency, ratio = min(truth, key=lambda one, own=mode: abs(one[0] - own.frequency))
        assert abs(mode.frequency - frequency) < 5 * mode.frequency_std
        assert abs(mode.damping_ratio - ratio) < 5 * mode.damping_ratio_std


@pytest.mark.slow
def test_blows_at_other_turns_tell_lines_from_images():
    """From one blow each image fits as well; from blows at rows of other turns none does: the modes are certain."""
    rng, dt, truth, records = np.random.default_rng(1), 0.005, [(8.0, 0.01), (21.0, 0.012), (37.0, 0.008)], []
    shapes = rng.uniform(0.3, 1.0, (3, 4)) * rng.choice([-1, 1], (3, 4))
    for n, blows in ((1500, (20, 763)), (900, (26, 481)), (2200, (33, 1124))):
        force, outputs = np.zeros(n), np.zeros((n, 4))
        for blow in blows:
            force[blow : blow + 3] = [0.5, 1.0, 0.4]
        for (frequency, ratio), shape in zip(truth, shapes, strict=True):
            pole = np.exp((-ratio + 1j * np.sqrt(1 - ratio**2)) * 2 * np.pi * frequency * dt)
            moved = scipy.signal.lfilter([0, 1], [1, -2 * pole.real, abs(pole) ** 2], force)
            outputs += np.outer(20.0 * abs(pole.imag) * moved / 9.0, shape)
        outputs += 0.02 * rng.standard_normal((n, 4))
        outputs[np.arange(n)[:, np.newaxis] % 4 != np.arange(4)] = np.nan
        records.append(Record(force, outputs, dt))
    found = modal.identify(records, kind="transient").modes.system
    assert [round(mode.frequency) for mode in found] == [8, 21, 37]
    for mode, (frequency, ratio) in zip(found, truth, strict=True):
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std
        assert abs(mode.damping_ratio - ratio) < 4 * mode.damping_ratio_std


@pytest.mark.parametrize(("echo", "follows"), [(0.0, False), (0.05, True)])
def test_what_the_model_leaves_of_the_measured_samples_is_asked_whether_it_follows_the_inputs(echo, follows):
    """Errors of an observer follow what filled them; asking nothing instead would hide what no pole makes."""
    rng, n = np.random.default_rng(0), 3000
    force = rng.standard_normal(n)
    pole = np.exp((-0.02 + 1j) * 2 * np.pi * 5.0 * 0.01)
    moved = scipy.signal.lfilter([0, 1], [1, -2 * pole.real, abs(pole) ** 2], force)
    outputs = moved / moved.std() + echo * np.r_[np.zeros(15), force[:-15]] + 0.05 * rng.standard_normal(n)
    outputs[rng.random(n) < 0.2] = np.nan
    said = modal.identify(Record(force, outputs, 0.01), order=2).warnings
    assert any("leaves over still follows the inputs" in one for one in said) is follows
