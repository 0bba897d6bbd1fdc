"""Shapes in the complex plane, and the words for them on both sides of every limit."""

import numpy as np
import pytest

from modal.geometry.scene import complexity_words, phasors
from modal.modes.mode import Mode


def mode(shape, *, collinearity=0.99, deviation=2.0, pole=-0.4 + 12j):
    return Mode(
        pole=pole,
        kind="oscillatory",
        frequency=2.0,
        damping_ratio=0.03,
        shape=np.asarray(shape, dtype=complex),
        participation=np.ones(1),
        phase_collinearity=collinearity,
        mpd=deviation,
    )


@pytest.mark.parametrize(
    ("collinearity", "deviation", "words"),
    [
        (0.951, 9.9, "nearly real"),
        (0.949, 9.9, "complex"),
        (0.951, 10.1, "complex"),
        (0.51, 30.0, "complex"),
        (0.49, 30.0, "no common phase"),
        (np.nan, 3.0, "not known"),
        (0.99, np.nan, "not known"),
    ],
)
def test_words_follow_the_two_numbers(collinearity, deviation, words):
    assert complexity_words(mode([1, 0.5, 0.2], collinearity=collinearity, deviation=deviation)) == words


def test_one_sensor_has_no_complexity():
    assert complexity_words(mode([1.0])) == "one sensor"
    assert complexity_words(mode([1.0, 0.0])) != "one sensor"


def test_phasors_of_a_real_shape_lie_flat_whatever_its_phase():
    found = phasors(mode(np.array([0.5, -1.0, 0.2]) * np.exp(0.7j)), ["m"] * 3)
    np.testing.assert_allclose(found, [-0.5, 1.0, -0.2], atol=1e-12)


def test_displacements_beside_accelerations_keep_their_line():
    pole = -0.4 + 12j
    found = phasors(mode([0.5, -1.0 * pole**2], pole=pole), ["m", "m/s^2"])
    np.testing.assert_allclose(np.abs(found.imag), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(found.real), 1.0)


def test_each_unit_has_its_own_largest():
    found = phasors(mode([1.0, 0.5, 1e-6]), ["m", "m", "rad"])
    np.testing.assert_allclose(np.abs(found), [1.0, 0.5, 1.0])
    assert np.isfinite(phasors(mode([1.0, 0.0], pole=0j), ["m", "m/s"])).all()
