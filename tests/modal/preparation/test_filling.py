import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, simulate

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
