"""Folds that fit unlike each other are a warning where it is the error that differs, not the motion."""

import numpy as np
from scipy.signal import lfilter

from modal.identification.pipeline import identify
from okid.record import Record

DRIVE = np.random.default_rng(0).standard_normal(6000)
NOISE = np.random.default_rng(1).standard_normal(6000)


def warned(u, y):
    """The orders are given: what the folds tell of is no matter of the search."""
    found = identify(Record(u, y, 0.01), kind="driven", observer_order=10, ridge=0.0, order=2)
    return any("fit very differently" in words for words in found.warnings)


def test_a_fold_at_rest_fits_badly_without_a_fault():
    u = np.where(np.arange(6000) < 1500, DRIVE, 0.0)
    assert not warned(u, lfilter([0.0, 1.0], [1.0, -1.2, 0.8], u) + 0.01 * NOISE)


def test_a_burst_that_no_input_makes_is_said():
    burst = np.where(np.abs(np.arange(6000) - 3900) < 200, 4.0 * NOISE, 0.0)
    assert warned(DRIVE, lfilter([0.0, 1.0], [1.0, -1.2, 0.8], DRIVE) + 0.01 * NOISE + burst)
