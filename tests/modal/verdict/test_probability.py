"""The probability of a mode: the formula of `modal/docs/verdict.md`, its limits, and the numbers a mode brings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modal.modes.mode import Mode
from modal.verdict.probability import f_ratio, probability

SHARES = st.floats(0.0, 1.0)


def odds(p):
    return np.log(p / (1 - p))


@given(SHARES, st.floats(-0.99, 5.99))
def test_log_odds_are_straight_in_the_repeatability_and_in_the_tenfolds_of_the_ratio(r, tenfolds):
    assert odds(probability(r, 10.0**tenfolds)) == pytest.approx(14.1 * r + 0.95 * tenfolds - 11.5, abs=1e-6)


@given(SHARES)
def test_without_inputs_the_repeatability_alone_counts(r):
    assert odds(probability(r)) == pytest.approx(17.5 * r - 12.0, abs=1e-6)
    assert probability(r, np.nan) == probability(r)


def test_nothing_more_is_learnt_beyond_the_limits_of_the_ratio():
    assert probability(0.7, 0.0) == probability(0.7, 0.1) < probability(0.7, 0.11)
    assert probability(0.7, 0.99e6) < probability(0.7, 1e6) == probability(0.7, np.inf)


@pytest.mark.parametrize(("pole", "kind", "halves"), [(-1 + 9j, "oscillatory", 2), (-1 + 0j, "real", 1)])
def test_the_ratio_is_that_of_analysis_of_variance(pole, kind, halves):
    """Explained per number that the mode brings over unexplained per measured value, three outputs and two inputs."""
    mode = Mode(
        pole=pole, kind=kind, frequency=1.4, damping_ratio=0.1, shape=np.ones(3), participation=np.ones(2)
    )  # fmt: skip
    explained, left, n_values = 30.0, 970.0, 6000
    expected = (explained / (5 * halves)) / (left / n_values)
    assert f_ratio(mode, explained / (explained + left), n_values) == pytest.approx(expected, rel=1e-12)
    assert f_ratio(mode, 0.0, n_values) == 0.0
    assert 1e15 < f_ratio(mode, 1.0, n_values) < np.inf
