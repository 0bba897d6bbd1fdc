import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, simulate

import modal
from modal.preparation.filling import fill_where_needed
from okid.record import Record

N = 3000


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
    assert "output samples were missing" in filling.warnings[0]


def test_a_long_gap_is_left_alone():
    """It takes few rows, and no model of them is needed."""
    _, record = clean_and_noisy(2)
    missing = np.zeros((N, 2), dtype=bool)
    missing[500:800, 1] = True
    gaps = with_gaps(record, missing)
    filling = fill_where_needed([gaps])
    assert filling.records[0] is gaps
    assert filling.choices == filling.warnings == ()


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


@pytest.mark.parametrize("seed", range(3))
def test_an_output_at_every_twentieth_row_shows_the_states_of_the_others(seed):
    """It had the poles of its images, 40 of them, and a shape of a tenth."""
    rng = np.random.default_rng(seed)
    frequency, times = 1.3 + 0.4 * seed, 0.02 * np.arange(1400)
    wave = np.exp(-0.004 * 2 * np.pi * frequency * times) * np.cos(2 * np.pi * frequency * times)
    outputs = wave[:, np.newaxis] * [1.0, 0.6] + 2e-3 * rng.standard_normal((1400, 2))
    outputs[np.arange(1400) % 20 != 0, 1] = np.nan
    result = modal.identify(Record([], outputs, 0.02), kind="decay")
    near = [mode for mode in result.modes if abs(mode.frequency / frequency - 1) < 1e-3 and mode.verdict != "noise"]
    assert len(near) == 1
    assert abs(near[0].shape[1] / near[0].shape[0]) == pytest.approx(0.6, rel=0.02)
    assert all(mode in near for mode in result.modes.system)


@pytest.mark.parametrize("seed", range(2))
def test_images_of_rows_that_outputs_do_not_share_are_not_certain(seed):
    """At every second row by turns a frequency and its image at 25 Hz less look alike: half of each was certain."""
    frequency, times = 1.3 + 0.8 * seed, 0.02 * np.arange(700)
    wave = np.exp(-0.01 * 2 * np.pi * frequency * times) * np.cos(2 * np.pi * frequency * times)
    outputs = wave[:, np.newaxis] * [1.0, 0.6] + 2e-3 * np.random.default_rng(seed).standard_normal((700, 2))
    outputs[gone("by turns", 700)] = np.nan
    result = modal.identify(Record([], outputs, 0.02), kind="decay")
    assert not [mode for mode in result.modes.system if mode.frequency > 12.5]
    assert not [mode for mode in result.modes.system if abs(mode.frequency / frequency - 1) > 0.01]


def test_a_slow_sensor_beside_fast_ones_is_filled():
    clean, record = clean_and_noisy(6)
    missing = np.hstack([np.zeros((N, 1), dtype=bool), np.arange(N)[:, np.newaxis] % 17 != 0])
    (filled,) = fill_where_needed([with_gaps(record, missing)]).records
    error = (filled.outputs - clean)[missing]
    assert np.sqrt(np.mean(np.square(error))) < 0.03 * clean.std()
