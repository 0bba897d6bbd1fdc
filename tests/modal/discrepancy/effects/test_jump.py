"""The law that jumps, and the line that stands for it over a step."""

from dataclasses import fields

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.discrepancy.effects.coulomb_friction import CoulombFriction
from modal.discrepancy.effects.effect import Motion
from modal.discrepancy.effects.jump import NEAR, jump, jump_line

speeds = st.floats(-50.0, 50.0).map(lambda v: round(v, 4))
widths = st.floats(1e-3, 5.0)


@settings(deadline=None)
@given(v=speeds, width=widths)
def test_the_smooth_sign_stays_within_the_sharp_one_and_is_odd(v, width):
    (value, mirrored), slope = jump(np.array([v, -v]), width)
    assert mirrored == -value
    assert 0.0 <= value * np.sign(v) <= 1.0
    assert np.all((slope >= 0.0) & (slope <= 1.0 / width))
    if v != 0.0:
        assert 1.0 - value * np.sign(v) <= 0.5 * (width / v) ** 2 * (1.0 + 1e-9) + 1e-15
    assert jump(np.array([v]), 0.0)[0][0] == np.sign(v)


@settings(deadline=None)
@given(v0=speeds, v1=speeds, width=st.floats(0.02, 5.0))
def test_the_line_has_the_mean_and_the_moment_of_the_law_over_the_step(v0, v1, width):
    line = jump_line(np.array([v0]), np.array([v1]), width)
    turn = v0 / (v0 - v1) if v0 * v1 < 0.0 else 0.5

    def law(s):
        v = v0 + s * (v1 - v0)
        return v / np.hypot(v, width)

    def over_the_step(weight):
        return sum(
            scipy.integrate.quad(lambda s: weight(s) * law(s), a, b, limit=200)[0]
            for a, b in ((0.0, turn), (turn, 1.0))
        )

    mean, moment = over_the_step(lambda s: 1.0), over_the_step(lambda s: s - 0.5)
    np.testing.assert_allclose(0.5 * (line.start + line.end), mean, atol=2e-4)
    np.testing.assert_allclose((line.end - line.start) / 12.0, moment, atol=2e-4)


@pytest.mark.parametrize("width", [0.03, 1.0])
def test_the_slopes_of_the_line_are_those_of_its_ends(width):
    rng = np.random.default_rng(5)
    before = rng.normal(size=400)
    after = before + rng.normal(size=400) * 10.0 ** rng.uniform(-3.0, 0.5, 400)
    line, step = jump_line(before, after, width), 1e-6
    for end in ("start", "end"):
        for ends, claimed in (
            ((step, 0.0), getattr(line, f"{end}_by_before")),
            ((0.0, step), getattr(line, f"{end}_by_after")),
        ):
            above, below = (
                getattr(jump_line(before + sign * ends[0], after + sign * ends[1], width), end) for sign in (1.0, -1.0)
            )
            found = (above - below) / (2.0 * step)
            wrong = np.abs(claimed - found) > 1e-2 / width  # the law's steepest slope is 1 / width
            assert np.mean(wrong) < 0.005  # where the short cut for a straight law begins, the value steps a little


def test_friction_over_a_step_is_its_force_times_the_line():
    rng = np.random.default_rng(6)
    before, after = (
        Motion(
            displacement=np.zeros(30),
            velocity=rng.normal(size=30),
            time=np.zeros(30),
            memory=np.zeros((30, 0)),
            displacement_scale=1.0,
            velocity_scale=2.0,
            smoothing=0.01,
        )
        for _ in range(2)
    )
    found = CoulombFriction().step_force((0.7,), before, after)
    line = jump_line(before.velocity, after.velocity, 0.02)
    assert found is not None
    for field in fields(line):
        np.testing.assert_allclose(getattr(found, field.name), 0.7 * getattr(line, field.name))
    np.testing.assert_array_equal(found.start_by_parameter[:, 0], line.start)
    np.testing.assert_array_equal(found.end_by_parameter[:, 0], line.end)


@pytest.mark.parametrize("width", [1e-3, 0.3, 10.0])
@pytest.mark.parametrize("middle", [-4.0, 0.0, 0.02, 1.0])
def test_the_line_does_not_hop_where_the_series_takes_over(width, middle):
    """A step that ends there would never converge: Newton's method would go from one branch to the other."""
    threshold = NEAR * np.hypot(middle, width)
    below, above = (
        jump_line(np.array([middle - rise / 2]), np.array([middle + rise / 2]), width)
        for rise in (threshold * (1 - 1e-12), threshold * (1 + 1e-12))
    )
    size = np.hypot(middle, width)
    for end in ("start", "end"):
        assert abs(getattr(below, end) - getattr(above, end))[0] < 1e-10
        for side in ("before", "after"):
            name = f"{end}_by_{side}"
            assert size * abs(getattr(below, name) - getattr(above, name))[0] < 2e-8
