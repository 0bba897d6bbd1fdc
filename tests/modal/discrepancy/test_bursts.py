"""The level between bursts."""

import numpy as np
import pytest

from modal.discrepancy.bursts import steady_level
from modal.discrepancy.quiet_band import residual_spectrum


def level_of(values):
    return steady_level(residual_spectrum(np.empty((len(values), 0)), values[:, np.newaxis]), 0)


@pytest.mark.parametrize("n_samples", [400, 1000, 3000])
def test_steady_noise_keeps_its_level_and_raises_no_alarm(n_samples):
    rng = np.random.default_rng(0)
    found = [level_of(0.2 * rng.standard_normal(n_samples)) for _ in range(200)]
    assert abs(np.mean([one.variance for one in found]) / 0.04 - 1) < 0.03
    assert abs(np.mean([one.ratio for one in found]) - 1) < 0.02
    assert np.mean([one.bursts for one in found]) < 0.02
    assert abs(np.mean([one.share for one in found]) - (1 - np.exp(-3))) < 0.01


def test_the_level_is_where_the_mean_below_three_times_it_is_that_of_an_exponential():
    from modal.discrepancy.bursts import _between_bursts

    rng = np.random.default_rng(1)
    power = rng.exponential(2.0, 5000)
    power[::10] += 40.0
    level = _between_bursts(power)
    below = power[power < 3 * level]
    expected = level * (1 - 3 * np.exp(-3) / (1 - np.exp(-3)))
    assert abs(below.mean() / expected - 1) < 1e-3
    assert abs(level / 2.0 - 1) < 0.06


def test_jumps_are_seen_and_mostly_set_aside():
    rng = np.random.default_rng(2)
    for _ in range(10):
        jumps = np.zeros(3000)
        jumps[rng.integers(0, 3000, 60)] = rng.choice([-1.0, 1.0], 60)
        values = np.cumsum(jumps) + 0.1 * rng.standard_normal(3000)
        found = level_of(values)
        assert found.bursts
        plain = found.variance / found.ratio
        assert plain > 1.2 * 0.01
        assert 0.8 < found.variance / 0.01 < 1.35


@pytest.mark.parametrize("n_inputs", [1, 3])
def test_what_the_fit_to_inputs_took_is_given_back(n_inputs):
    rng = np.random.default_rng(4)
    variances = []
    for _ in range(30):
        inputs = rng.standard_normal((2000, n_inputs))
        spectrum = residual_spectrum(inputs, inputs[:, :1] + 0.2 * rng.standard_normal((2000, 1)))
        variances.append(steady_level(spectrum, 0).variance)
    assert abs(np.mean(variances) / 0.04 - 1) < 0.04


def test_a_short_record_tells_nothing():
    rng = np.random.default_rng(3)
    assert level_of(rng.standard_normal(70)) is None


def test_silence_is_no_burst():
    found = level_of(np.zeros(1000))
    assert found.variance == 0.0
    assert not found.bursts
