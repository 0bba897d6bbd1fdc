"""Ambient motion behind a filter: what stands above the Nyquist frequency is folded below it."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt

import modal
from okid.record import Record

OVER = 8
"""Simulate at so many times 100 Hz, filter, and take every so-manieth sample."""
AMBIENT = {"observer_order": 32, "ridge": 1e-5, "order": 6}
DRIVEN = {"observer_order": 63, "ridge": 3e-4, "order": 8}
"""What a search takes."""


@pytest.mark.parametrize(("frequency", "seen", "sure"), [(51.0, 49.0, False), (44.0, 44.0, True)])
def test_a_mode_beside_the_nyquist_frequency_is_no_certain_one(frequency, seen, sure):
    """51 Hz through a Butterworth filter of order 6 at 40 Hz was a certain mode at 49 Hz, at 0.99."""
    force = np.random.default_rng(1).standard_normal((OVER * 5000, 2))
    motion = np.zeros_like(force)
    for at, shape in ((12.0, (1.0, 0.6)), (frequency, (0.7, -1.0))):
        pole = np.exp(2 * np.pi * at * complex(-0.003, 1.0) / (100 * OVER))
        own = lfilter([0.0, 1.0], [1.0, -2 * pole.real, abs(pole) ** 2], force @ np.array(shape))
        motion += np.outer(own / own.std(), shape)
    filtered = sosfilt(butter(6, 40.0, fs=100 * OVER, output="sos"), motion, axis=0)[::OVER]
    outputs = filtered + 0.005 * filtered.std() * np.random.default_rng(2).standard_normal(filtered.shape)
    found = [
        mode for mode in modal.identify(Record([], outputs, 0.01), **AMBIENT).modes if abs(mode.frequency - seen) < 0.3
    ]
    assert [mode.verdict for mode in found if mode.verdict != "noise"] == ["system" if sure else "doubtful"]
    assert any("Hz folded" in mode.reason for mode in found) != sure


@pytest.mark.parametrize(("frequency", "seen", "sure"), [(51.0, 48.9, False), (44.0, 44.0, True)])
def test_nor_is_one_that_a_force_drives_between_its_samples(frequency, seen, sure):
    """What is measured of the force passes the same filter, folded too, and the model looks ahead."""
    force, motion = np.random.default_rng(1).standard_normal(OVER * 5000), np.zeros((OVER * 5000, 2))
    for at, shape in ((12.0, (1.0, 0.6)), (frequency, (0.7, -1.0))):
        pole = np.exp(2 * np.pi * at * complex(-0.003, 1.0) / (100 * OVER))
        own = lfilter([0.0, 1.0], [1.0, -2 * pole.real, abs(pole) ** 2], force)
        motion += np.outer(own / own.std(), shape)
    sections = butter(6, 40.0, fs=100 * OVER, output="sos")
    outputs = sosfilt(sections, motion, axis=0)[::OVER]
    outputs = outputs + 0.005 * outputs.std() * np.random.default_rng(2).standard_normal(outputs.shape)
    result = modal.identify(Record(sosfilt(sections, force)[::OVER], outputs, 0.01), **DRIVEN)
    assert result.input_delay[0] < 0
    found = [mode for mode in result.modes if abs(mode.frequency - seen) < 0.3]
    assert [mode.verdict for mode in found if mode.verdict != "noise"] == ["system" if sure else "doubtful"]
    assert any("Hz folded" in mode.reason for mode in found) != sure
