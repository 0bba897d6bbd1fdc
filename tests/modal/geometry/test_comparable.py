"""Shapes of outputs in several units, compared as displacements."""

from types import SimpleNamespace

import numpy as np
import pytest

from modal.geometry.scene import comparable_shapes, comparison_words
from modal.modes.shape_comparison import assurance

POLES = (-0.1 + 8.0j, -0.2 + 30.0j)
MOTION = np.random.default_rng(0).standard_normal((4, 2)) + 0j


def seen(orders, factors):
    """Modes as sensors of these derivatives and scales see one and the same motion."""
    return [
        SimpleNamespace(pole=pole, shape=MOTION[:, k] * pole ** np.array(orders) / np.array(factors))
        for k, pole in enumerate(POLES)
    ]


NAMES = ("a", "b", "c", "d")


@pytest.mark.parametrize(
    ("units", "orders", "factors"),
    [
        (("m", "m/s", "m/s^2", "m"), (0, 1, 2, 0), (1, 1, 1, 1)),
        (("mm", "m/s^2", "g", "m/s"), (0, 2, 2, 1), (1e-3, 1, 9.80665, 1)),
        (("rad", "rad/s", "deg", "rad/s^2"), (0, 1, 0, 2), (1, 1, np.pi / 180, 1)),
    ],
)
def test_sensors_of_any_kind_see_the_same_displacements(units, orders, factors):
    shapes = comparable_shapes(seen(orders, factors), NAMES, units)
    assert shapes == pytest.approx(MOTION, rel=1e-6)
    assert assurance(shapes, shapes) == pytest.approx(assurance(MOTION, MOTION), rel=1e-6)
    assert "made displacements" in comparison_words(NAMES, units)


@pytest.mark.parametrize(
    "units", [("m", "N", "m", "m"), ("m", "rad", "m", "m"), ("m", "", "m", "m"), ("m", "V", "m/s", "m")]
)
def test_what_cannot_be_made_displacements_stays_as_it_is_and_is_said(units):
    modes = seen((0, 0, 0, 0), (1, 1, 1, 1))
    assert np.array_equal(comparable_shapes(modes, NAMES, units), MOTION)
    assert "numbers as they are" in comparison_words(NAMES, units)


@pytest.mark.parametrize("unit", ["m/s^2", "counts", ""])
def test_one_unit_needs_nothing_and_no_words(unit):
    modes = seen((2, 2, 2, 2), (1, 1, 1, 1))
    raw = np.column_stack([mode.shape for mode in modes])
    assert np.array_equal(comparable_shapes(modes, NAMES, (unit,) * 4), raw)
    assert comparison_words(NAMES, (unit,) * 4) == ""


def test_no_modes_and_a_pole_at_zero_do_no_harm():
    assert comparable_shapes([], NAMES, ("m", "m/s", "m", "m")).shape == (4, 0)
    still = SimpleNamespace(pole=0j, shape=MOTION[:, 0])
    assert np.array_equal(comparable_shapes([still], NAMES, ("m", "m/s", "m", "m"))[:, 0], MOTION[:, 0])
