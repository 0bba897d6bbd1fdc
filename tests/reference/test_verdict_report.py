"""The figures of the calibration against counting by hand and against numbers that were put into the data."""

import importlib.util
import itertools

import numpy as np
import pytest


@pytest.fixture(scope="module")
def statistics(repository):
    path = repository / "tests" / "benchmarks" / "verdict_report.py"
    spec = importlib.util.spec_from_file_location("verdict_report", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_separation_counts_pairs_and_halves_ties(statistics):
    rng = np.random.default_rng(1)
    true, score = rng.random(60) < 0.4, rng.integers(0, 8, 60).astype(float)
    pairs = [np.sign(a - b) for a, b in itertools.product(score[true], score[~true])]
    assert statistics.separation(true, score) == pytest.approx(np.mean(pairs) / 2 + 0.5)
    score[3] = np.nan
    assert statistics.separation(true, score) == pytest.approx(
        statistics.separation(np.delete(true, 3), np.delete(score, 3))
    )
    assert np.isnan(statistics.separation(np.ones(4, dtype=bool), np.arange(4.0)))


def test_the_numbers_are_found_again_though_some_poles_tell_nothing(statistics):
    rng = np.random.default_rng(2)
    features = np.column_stack([rng.random(20000), rng.uniform(-4, 0, 20000)])
    p = 1 / (1 + np.exp(7.6 - 13.4 * features[:, 0] - 1.3 * features[:, 1]))
    lapses = rng.random(20000) < statistics.LAPSES
    true = np.where(lapses, rng.random(20000) < 0.5, rng.random(20000) < p)
    found = statistics.fit_logistic(true, features)
    errors = np.array([found.offset - 7.6, found.slopes[0] - 13.4, found.slopes[1] - 1.3]) / found.spread
    assert np.all(np.abs(errors) < 4)
    assert np.all(found.spread < 0.4)
    np.testing.assert_allclose(found.probability(np.array([[found.limit(0.8, -0.5), -0.5]])), 0.8)


def test_separable_poles_give_finite_numbers(statistics):
    r = np.array([0.1, 0.2, 0.8, 0.9])[:, np.newaxis]
    found = statistics.fit_logistic(r[:, 0] > 0.5, r)
    assert np.all(np.isfinite([found.offset, *found.slopes, *found.spread]))
    assert found.limit(0.5) == pytest.approx(0.5, abs=0.05)


def test_thin_bins_are_merged_and_no_pole_is_lost(statistics):
    p = np.concatenate([np.full(40, 0.05), np.full(10, 0.35), np.full(25, 0.45), np.full(50, 0.85), np.full(5, 0.99)])
    true = np.concatenate([np.zeros(40), np.ones(10), np.zeros(25), np.ones(55)]).astype(bool)
    found = statistics.reliability(true, p)
    assert [(b.low, b.high, b.count) for b in found] == [(0.0, 0.1, 40), (0.1, 0.5, 35), (0.5, 1.0, 55)]
    assert found[1].said == pytest.approx(np.mean(p[40:75]))
    assert [b.true for b in found] == pytest.approx([0.0, 10 / 35, 1.0])
