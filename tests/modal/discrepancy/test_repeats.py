"""Same inputs found, transients left out, scatter measured."""

import numpy as np
import pytest

from modal.discrepancy.noise_floor import noise_floor
from modal.discrepancy.repeats import exact_period, period_scatter, repeat_scatter, repeated_records
from okid.record import Record


def record(rng, force, std=0.1):
    return Record(force, force + std * rng.standard_normal(force.shape), 0.01)


def test_records_of_the_same_input_are_grouped():
    rng = np.random.default_rng(0)
    one, other = rng.standard_normal((300, 2)), rng.standard_normal((300, 2))
    text = np.round(one, 7)  # through a file
    records = [record(rng, force) for force in (one, other, text, one[:200], other * 1.001, other)]
    assert repeated_records(records) == ((0, 2, 3), (1, 5))


def test_copies_shifts_and_silence_are_no_repeats():
    rng = np.random.default_rng(1)
    force = rng.standard_normal((300, 1))
    original = record(rng, force)
    assert repeated_records([original, original]) == ()
    assert repeated_records([original, record(rng, np.roll(force, 1))]) == ()
    assert repeated_records([original, record(rng, force[:100])]) == ()
    still = [Record(np.zeros(300), rng.standard_normal(300), 0.01) for _ in range(2)]
    assert repeated_records(still) == ()
    undriven = [Record([], rng.standard_normal(300), 0.01) for _ in range(2)]
    assert repeated_records(undriven) == ()


def test_a_period_must_be_exact():
    rng = np.random.default_rng(2)
    force = np.tile(rng.standard_normal(120), 4)
    assert exact_period(Record(force, force, 0.1)) == 120
    assert exact_period(Record(force + 1e-5 * rng.standard_normal(480), force, 0.1)) == 120
    assert exact_period(Record(force + 1e-2 * rng.standard_normal(480), force, 0.1)) is None
    assert exact_period(Record(rng.standard_normal(480), force, 0.1)) is None


@pytest.mark.parametrize("n_repeats", [2, 3, 5])
def test_scatter_of_white_noise_is_its_variance_and_as_sure_as_it_says(n_repeats):
    rng = np.random.default_rng(3)
    common = rng.standard_normal((800, 2))
    found = [
        repeat_scatter([common + [1.0, 3.0] * rng.standard_normal((800, 2)) for _ in range(n_repeats)])
        for _ in range(200)
    ]
    variance = np.array([one.variance for one in found if one is not None])
    assert len(variance) > 190
    np.testing.assert_allclose(variance.mean(axis=0), [1.0, 9.0], rtol=0.01)
    spread = variance.std(axis=0) / [1.0, 9.0]
    stated = np.mean([one.standard_error for one in found if one is not None], axis=0)
    np.testing.assert_allclose(spread, stated, rtol=0.2)


def test_scatter_of_periods_likewise_with_missing_samples_and_a_part_of_a_period():
    rng = np.random.default_rng(4)
    variance, stated = [], []
    for _ in range(300):
        values = np.tile(rng.standard_normal((300, 1)), (9, 1))[:2600] + 0.5 * rng.standard_normal((2600, 1))
        values[rng.random(2600) < 0.1] = np.nan
        found = period_scatter(values, 300)
        if found is None:
            continue
        variance.append(found.variance[0])
        stated.append(found.standard_error[0])
    assert len(variance) > 285
    assert abs(np.mean(variance) / 0.25 - 1) < 0.01
    assert 0.88 < np.std(variance) / 0.25 / np.mean(stated) < 1.1


def test_missing_samples_lower_the_freedom_not_the_scatter():
    rng = np.random.default_rng(5)
    found = []
    for _ in range(100):
        parts = rng.standard_normal((3, 900, 1))
        parts[rng.random(parts.shape) < 0.2] = np.nan
        found.append(repeat_scatter(list(parts)).variance[0])
    assert abs(np.mean(found) - 1) < 0.01


def test_a_transient_is_left_out():
    rng = np.random.default_rng(6)
    k = np.arange(2000)[:, np.newaxis]
    variance = []
    for _ in range(40):
        starts = rng.standard_normal(2) * 30
        parts = [a * np.exp(-0.01 * k) * np.cos(0.2 * k) + rng.standard_normal((2000, 1)) for a in starts]
        found = repeat_scatter(parts)
        assert abs(starts[0] - starts[1]) < 10 or found.n_dropped > 150
        variance.append(found.variance[0])
    assert abs(np.mean(variance) - 1) < 0.05


def test_a_transient_that_stays_is_no_scatter_or_one_of_a_narrow_band():
    rng = np.random.default_rng(7)
    k = np.arange(2000)[:, np.newaxis]
    parts = [a * np.exp(-0.0015 * k) + 0.1 * rng.standard_normal((2000, 1)) for a in (30.0, -30.0)]
    found = repeat_scatter(parts)
    assert found is None or found.memory[0] > 50
    force = rng.standard_normal((2000, 1))
    floor = noise_floor([Record(force, part, 0.01) for part in parts])
    assert set(floor.method) == {"quiet band"}
    np.testing.assert_allclose(floor.variance, 0.01, rtol=0.2)


def test_differences_that_keep_fading_are_no_scatter():
    rng = np.random.default_rng(9)
    fading = np.exp(-0.0012 * np.arange(2400))[:, np.newaxis]
    assert all(repeat_scatter([fading * rng.standard_normal((2400, 1)) for _ in range(2)]) is None for _ in range(10))


def test_a_narrow_band_is_less_sure_than_white_noise():
    rng = np.random.default_rng(8)

    def narrow():
        e = rng.standard_normal(6000)
        return np.convolve(e, np.exp(-0.02 * np.arange(400)) * np.cos(0.3 * np.arange(400)), "same")[:, np.newaxis]

    found = [repeat_scatter([narrow(), narrow()]) for _ in range(30)]
    found = [one for one in found if one is not None]
    assert len(found) > 20
    assert np.median([one.memory[0] for one in found]) > 15
    variance = np.array([one.variance[0] for one in found])
    assert 0.5 < variance.std() / variance.mean() / np.median([one.standard_error[0] for one in found]) < 2.0


def test_too_few_rows_give_nothing():
    assert repeat_scatter([np.zeros((50, 1)), np.ones((50, 1))]) is None
    assert period_scatter(np.zeros((100, 1)), 50) is None
