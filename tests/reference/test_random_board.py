"""Errors over their bounds, pooled: against numbers put in by hand, and the standard error against its own scatter."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture(scope="module")
def board(repository):
    sys.path.insert(0, str(repository / "tests" / "benchmarks"))
    try:
        import random_board
    finally:
        sys.path.pop(0)
    return random_board


def case(*bounds):
    bounds = np.array(bounds)
    return SimpleNamespace(bound=SimpleNamespace(frequency_std=bounds, damping_ratio_std=bounds / 10))


def score(*errors):
    return {"found": [None if e is None else {"frequency": e, "damping_ratio": e / 10} for e in errors]}


def test_every_found_mode_counts_once(board):
    cases = [case(1.0, 2.0), case(1.0)]
    scores = [[score(1.0, -4.0), score(None, 2.0)], [score(3.0), {"failure": "none"}]]
    ratio = board.ratio_over_bound(cases, scores, "frequency")
    assert ratio["rms"] == pytest.approx(np.sqrt((1 + 4 + 1 + 9) / 4))
    assert ratio["median"] == pytest.approx(np.median([np.sqrt(6 / 3), 3.0]))
    assert (ratio["n"], ratio["beyond"]) == (4, 0)
    assert board.ratio_over_bound(cases, scores, "damping_ratio")["rms"] == pytest.approx(ratio["rms"])


def test_an_error_beyond_nine_bounds_counts_as_missed(board):
    ratio = board.ratio_over_bound([case(1.0)], [[score(1.0), score(-9.5), score(9.0)]], "frequency")
    assert (ratio["n"], ratio["beyond"]) == (2, 1)
    assert ratio["rms"] == pytest.approx(np.sqrt(41))
    assert ratio["std"] is None
    assert board.ratio_over_bound([case(1.0)], [[score(None)]], "frequency") is None


def test_the_standard_error_is_the_scatter_over_fresh_systems(board):
    """Errors of one system share a factor, so that they are not independent; 20 systems, 400 times."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(400):
        cases = [case(*np.ones(rng.integers(2, 5))) for _ in range(20)]
        factors = rng.uniform(0.7, 1.3, 20)
        scores = [
            [score(*(f * rng.standard_normal(len(one.bound.frequency_std)))) for _ in range(12)]
            for one, f in zip(cases, factors, strict=True)
        ]
        found.append(board.ratio_over_bound(cases, scores, "frequency"))
    scatter = np.std([one["rms"] for one in found])
    assert np.mean([one["std"] for one in found]) == pytest.approx(scatter, rel=0.12)


def test_a_missed_mode_costs_a_setting_as_much_as_a_wild_one(board):
    cases = [case(1.0)]
    assert board.sweep_score(cases, [[score(None)]]) == board.sweep_score(cases, [[score(50.0)]]) == 9.0
    assert board.sweep_score(cases, [[score(2.0)]]) == pytest.approx(2.0)
    assert board.sweep_score(cases, [[score(1.0), {"failure": "none"}]]) == pytest.approx(np.sqrt((1 + 81) / 2))
