"""One record's floor: gaps, slow channels, odd inputs, short records, quantisation."""

import numpy as np
import pytest

from modal.discrepancy.spectral_floor import smallest_variance, spectral_floor
from okid.record import Record


def oscillation(rng, n_samples, *, std):
    force = rng.standard_normal(n_samples)
    pulse = 0.98 ** np.arange(400) * np.sin(0.15 * np.arange(400))
    return force, np.convolve(force, pulse)[:n_samples] + std * rng.standard_normal(n_samples)


def mean_ratio(change, *, std=0.05, n_samples=2000, n_runs=25, seed=0):
    """Mean of estimate over truth when `change(rng, force, moved)` makes the record."""
    rng = np.random.default_rng(seed)
    ratios = []
    for _ in range(n_runs):
        force, moved = oscillation(rng, n_samples, std=std)
        ratios.append(spectral_floor(change(rng, force, moved)).variance[0] / std**2)
    return np.mean(ratios)


def with_holes(rng, force, moved):
    moved[rng.random(moved.size) < 0.1] = np.nan
    return Record(force, moved, 0.01)


def with_a_long_hole(rng, force, moved):
    moved[900:1100] = np.nan
    moved[:7] = np.nan
    return Record(force, moved, 0.01)


def every_second_row(rng, force, moved):
    moved[1::2] = np.nan
    return Record(force, moved, 0.01)


def with_a_hole_in_the_input(rng, force, moved):
    force[300:305] = np.nan
    return Record(force, moved, 0.01)


def with_a_dead_input(rng, force, moved):
    return Record(np.stack([force, np.full(force.size, 3.0)], axis=1), moved, 0.01)


def with_an_offset(rng, force, moved):
    return Record(force + 100.0, moved - 1e4, 0.01)


@pytest.mark.parametrize(
    "change",
    [with_holes, with_a_long_hole, every_second_row, with_a_hole_in_the_input, with_a_dead_input, with_an_offset],
)
def test_the_floor_is_right_for_records_as_they_are(change):
    assert abs(mean_ratio(change) - 1) < 0.07


def test_an_input_that_never_moves_costs_nothing():
    force, moved = oscillation(np.random.default_rng(1), 1500, std=0.05)
    alone = spectral_floor(Record(force, moved, 0.01))
    beside = spectral_floor(with_a_dead_input(None, force, moved))
    np.testing.assert_array_equal(beside.variance, alone.variance)
    np.testing.assert_array_equal(beside.standard_error, alone.standard_error)


def test_bursts_are_set_aside_and_make_the_floor_unsure():
    rng = np.random.default_rng(2)
    for _ in range(5):
        hits = np.where(rng.random(3000) < 0.03, rng.standard_normal(3000), 0.0)
        floor = spectral_floor(Record([], hits + 0.1 * rng.standard_normal(3000), 0.01))
        assert 0.8 < floor.variance[0] / 0.01 < 1.6  # 4 with the hits
        assert floor.standard_error[0] >= 0.5
        assert "bursts" in floor.notes[0]


def test_no_floor_is_below_the_quantisation():
    steps = 0.5 * np.round(2 * np.sin(0.001 * np.arange(3000)))  # a few steps in all: hardly any high frequencies
    floor = spectral_floor(Record([], steps, 0.01))
    assert floor.variance[0] >= 0.25 / 12 * (1 - 1e-12)
    assert "quantisation" in floor.notes[0]


def test_several_inputs_and_a_short_record():
    rng = np.random.default_rng(3)
    ratios, errors = [], []
    for _ in range(40):
        force = rng.standard_normal((400, 3))
        moved = force @ [1.0, -2.0, 0.5] + 0.1 * rng.standard_normal(400)
        floor = spectral_floor(Record(force, moved, 0.01))
        ratios.append(floor.variance[0] / 0.01)
        errors.append(floor.standard_error[0])
    assert abs(np.mean(ratios) - 1) < 0.06
    assert np.std(ratios) < 1.3 * np.median(errors)


def test_a_residual_in_the_place_of_the_outputs():
    rng = np.random.default_rng(4)
    force, moved = oscillation(rng, 2000, std=0.0)
    noise = 0.05 * rng.standard_normal((2000, 1))
    floor = spectral_floor(Record(force, moved, 0.01), noise)
    assert abs(floor.variance[0] / 0.0025 - 1) < 0.15


@pytest.mark.parametrize("n_samples", [1, 2, 3, 5, 63])
def test_very_short_records_give_a_guess_and_say_so(n_samples):
    rng = np.random.default_rng(5)
    floor = spectral_floor(Record([], rng.standard_normal(n_samples), 0.01))
    assert floor.standard_error[0] == 3.0
    assert n_samples < 3 or "guess" in floor.notes[0]
    assert np.isfinite(floor.variance).all()


def test_the_guess_from_differences_is_right_for_white_noise():
    rng = np.random.default_rng(6)
    guesses = [spectral_floor(Record([], rng.standard_normal(50), 0.01)).variance[0] for _ in range(300)]
    assert abs(np.mean(guesses) - 1) < 0.1


@pytest.mark.parametrize(("step", "offset"), [(0.25, 0.0), (0.1, 0.37), (3.0, 1e3)])
def test_the_step_of_the_values_is_found(step, offset):
    rng = np.random.default_rng(7)
    values = offset + step * np.round(20 * rng.standard_normal(500))
    np.testing.assert_allclose(smallest_variance(Record([], values, 1.0)), step**2 / 12, rtol=1e-6)


def test_values_without_a_step_are_only_rounded_to_double_precision():
    rng = np.random.default_rng(8)
    assert smallest_variance(Record([], rng.standard_normal(500), 1.0))[0] < 1e-28
    assert smallest_variance(Record([], np.full(500, 2.0), 1.0))[0] < 1e-28


def test_outputs_are_named_in_words():
    rng = np.random.default_rng(9)
    record = Record([], rng.standard_normal((2000, 2)), 0.01, output_names=["roof", "base"])
    floor = spectral_floor(record)
    assert "'roof'" in floor.words(record)
    assert floor.words(record, np.array([False, True])).startswith("'base'")
    assert "'roof'" not in floor.words(record, np.array([False, True]))
