"""Bridges over missing samples."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modal.discrepancy.quiet_band import quiet_band, residual_spectrum
from modal.discrepancy.short_gaps import bridgeable_runs, bridged


@given(st.lists(st.booleans(), min_size=1, max_size=60))
def test_runs_begin_and_end_with_a_sample_and_hold_short_gaps_only(there):
    there = np.array(there)
    runs = bridgeable_runs(there)
    covered = np.zeros(there.size, dtype=bool)
    for start, stop in runs:
        assert there[start]
        assert there[stop - 1]
        assert not covered[start:stop].any()
        covered[start:stop] = True
        gap = 0
        for present in there[start:stop]:
            gap = 0 if present else gap + 1
            assert gap <= 6
    assert covered[there].all()
    for (_, stop), (start, _) in pairwise(runs):
        assert start - stop > 6


@pytest.mark.parametrize(("gap", "n_runs"), [(6, 1), (7, 2)])
def test_six_missing_samples_are_bridged_and_seven_are_not(gap, n_runs):
    there = np.ones(30, dtype=bool)
    there[10 : 10 + gap] = False
    assert len(bridgeable_runs(there)) == n_runs


def test_what_is_there_stays_and_a_linear_response_is_bridged_exactly():
    rng = np.random.default_rng(0)
    force = rng.standard_normal((1500, 1))
    moved, state = np.empty(1500), 0.0
    for k in range(1500):
        moved[k] = 2.0 * force[k, 0] + state  # jumps with the input: no smooth curve goes through it
        state = 0.8 * state + force[k, 0]
    holed = moved.copy()
    holed[rng.random(1500) < 0.03] = np.nan
    there = ~np.isnan(holed)
    filled = bridged(holed, force)
    np.testing.assert_array_equal(filled[there], moved[there])
    inner = slice(10, -10)
    assert np.abs(filled - moved)[inner].max() < 1e-3 * moved.std()


@pytest.mark.parametrize("missing", [0.02, 0.1, 0.2])
def test_bridges_lower_the_level_of_the_noise_by_their_share(missing):
    rng = np.random.default_rng(1)
    ratios = []
    for _ in range(20):
        wave = np.sin(0.15 * np.arange(2000)) + 0.05 * rng.standard_normal(2000)
        wave[rng.random(2000) < missing] = np.nan
        wave[[0, -1]] = 0.0
        filled = bridged(wave, np.empty((2000, 0)))
        band = quiet_band(residual_spectrum(np.empty((2000, 0)), filled[:, np.newaxis]), 0)
        ratios.append(band.variance / 0.0025 / (1 - np.isnan(wave).mean()))
    assert abs(np.mean(ratios) - 1) < 0.03 + 0.4 * missing


def test_with_too_little_to_learn_from_lines_are_straight():
    values = np.array([0.0, np.nan, 2.0, np.nan, np.nan, 5.0])
    np.testing.assert_allclose(bridged(values, np.empty((6, 0))), np.arange(6.0))
