"""Smooth contact in place of sharp contact: exact at width 0, near at any other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.effects.effect import LARGEST, cut_to_finite, levels, positive_part

points = st.floats(-1e3, 1e3)
widths = st.floats(1e-6, 10.0)


@settings(deadline=None)
@given(x=points)
def test_without_a_width_contact_is_sharp(x):
    assert positive_part(np.array([x]), 0.0)[0] == max(x, 0.0)


@settings(deadline=None)
@given(x=points, width=widths)
def test_smooth_contact_stays_near_the_sharp_one(x, width):
    part, slope = positive_part(np.array([x]), width)
    assert -1e-12 <= part[0] - max(x, 0.0) <= 0.25 * width * (1.0 + 1e-9)
    assert 0.0 <= slope[0] <= 1.0
    if abs(x) > width:
        assert part[0] == max(x, 0.0)


@settings(deadline=None)
@given(x=points, width=widths)
def test_the_two_sides_of_a_contact_add_up_to_a_spring(x, width):
    there, back = positive_part(np.array([x]), width)[0], positive_part(np.array([-x]), width)[0]
    np.testing.assert_allclose(there - back, x, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("width", [0.1, 2.0])
def test_value_and_slope_are_continuous_at_the_ends_of_the_parabola(width):
    for end in (-width, width):
        near = np.array([end - 1e-9, end + 1e-9])
        value, slope = positive_part(near, width)
        np.testing.assert_allclose(value, max(end, 0.0), atol=2e-9)
        np.testing.assert_allclose(slope, float(end > 0.0), atol=1e-8 / width)


def test_each_sample_may_have_a_width_of_its_own():
    x, widths = np.linspace(-1.0, 1.0, 41), np.linspace(0.01, 2.0, 41)
    value, slope = positive_part(x, widths)
    for k, width in enumerate(widths):
        one_value, one_slope = positive_part(x[k : k + 1], float(width))
        assert (value[k], slope[k]) == (one_value[0], one_slope[0])


def test_motion_out_of_reach_is_cut():
    found = cut_to_finite(np.array([-1e300, 1.5, 1e300]))
    np.testing.assert_array_equal(found, [-LARGEST, 1.5, LARGEST])
    assert np.isfinite(found**5).all()


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_share_of_the_motion_stays_below_each_level(seed):
    motion = np.random.default_rng(seed).normal(size=999)
    shares = (0.1, 0.5, 0.9)
    for level, share in zip(levels(motion, shares), shares, strict=True):
        assert abs(np.mean(np.abs(motion) <= level) - share) < 2e-3


def test_a_motion_at_rest_has_the_unit_as_its_level():
    assert levels(np.zeros(7), (0.1, 0.5)) == (1.0,)
    assert levels(np.empty(0), (0.1, 0.5)) == (1.0,)
    assert levels(np.array([2.0, -2.0]), (0.1, 0.5)) == (2.0,)
