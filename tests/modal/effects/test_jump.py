"""The law that jumps, and the line that stands for it over a step."""

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.effects.dampers import NEAR, CoulombFriction, jump, jump_line
from modal.effects.effect import Motion

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
    np.testing.assert_allclose(0.5 * (line.start + line.end)[0], mean, atol=2e-4)
    np.testing.assert_allclose((line.end - line.start)[0] / 12.0, moment, atol=2e-4)


@pytest.mark.parametrize("change", [0.0, 0.1, 2.0])
@pytest.mark.parametrize("width", [0.03, 1.0])
def test_the_slopes_of_the_line_are_those_of_its_ends(width, change):
    rng = np.random.default_rng(5)
    before = rng.normal(size=400)
    after = before + rng.normal(size=400) * 10.0 ** rng.uniform(-3.0, 0.5, 400)
    line, step = jump_line(before, after, width, change=change), 1e-6
    for part in ("start", "end", "lift"):
        for by, moved in (("before", (step, 0.0, 0.0)), ("after", (0.0, step, 0.0)), ("change", (0.0, 0.0, step))):
            if by == "change" and change == 0.0:  # it cannot fall further
                continue
            above, below = (
                jump_line(before + sign * moved[0], after + sign * moved[1], width, change=change + sign * moved[2])
                for sign in (1.0, -1.0)
            )
            found = (getattr(above, part)[0] - getattr(below, part)[0]) / (2.0 * step)
            claimed = getattr(line, part)[1 + ("before", "after", "change").index(by)]
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
            mobility=0.4,
        )
        for _ in range(2)
    )
    found = CoulombFriction().step_force((0.7,), before, after)
    line = jump_line(before.velocity, after.velocity, 0.02, change=0.7 * 0.4)
    assert found is not None
    step = 1e-6
    above, below = (CoulombFriction().step_force((0.7 + sign * step,), before, after) for sign in (1.0, -1.0))
    for part in ("start", "end", "lift"):
        told, of_line = getattr(found, part), getattr(line, part)
        np.testing.assert_allclose([told.value, told.by_before, told.by_after], 0.7 * of_line[:3])
        slope = (getattr(above, part).value - getattr(below, part).value) / (2.0 * step)
        np.testing.assert_allclose(told.by_parameter[:, 0], slope, atol=1e-6)


def under_a_constant_load(v0, load, friction):
    """A mass of one over a step of one: velocity at the end, mean and moment of the sign of the velocity; sharp.

    Event by event: it slides until it stops, then reverses, goes on or sticks.
    """
    direction = np.sign(v0) or (np.sign(load) if abs(load) > friction else 0.0)
    if direction == 0.0:
        return 0.0, load / friction, 0.0
    slowing = load - friction * direction
    stop = -v0 / slowing if v0 * slowing < 0.0 else np.inf
    if stop >= 1.0:
        return v0 + slowing, direction, 0.0
    later = load / friction if abs(load) <= friction else -direction
    end = 0.0 if abs(load) <= friction else (load - friction * later) * (1.0 - stop)
    mean = stop * direction + (1.0 - stop) * later
    return end, mean, 0.5 * stop * (1.0 - stop) * (later - direction)


@settings(deadline=None)
@given(v0=st.floats(-3.0, 3.0), load=st.floats(-3.0, 3.0), friction=st.floats(0.1, 2.0))
def test_where_the_law_is_far_from_resolved_the_line_is_exact_under_a_constant_load(v0, load, friction):
    end, mean, moment = under_a_constant_load(v0, load, friction)
    width = 1e-7
    line = jump_line(np.array([v0]), np.array([end]), width, change=friction)
    if abs(end) > 1e-2 and abs(v0) > 1e-2:
        np.testing.assert_allclose(0.5 * (line.start + line.end)[0], mean, atol=1e-4)
        np.testing.assert_allclose((line.end - line.start)[0] / 12.0, moment, atol=1e-4)


def implicit_step(v0, load, friction, width):
    """The velocity at which the step's own balance of momentum closes, by bisection: it rises with the velocity."""

    def miss(v1):
        line = jump_line(np.array([v0]), np.array([v1]), width, change=friction)
        return v1 - v0 - load + friction * 0.5 * float((line.start + line.end)[0, 0])

    return scipy.optimize.brentq(miss, v0 - 10.0, v0 + 10.0, xtol=1e-15)


@pytest.mark.parametrize("load", [0.0, 0.5, -0.9])
@pytest.mark.parametrize("v0", [0.3, 1.0, -0.02])
def test_a_mass_that_stops_within_a_step_sticks_from_then_on(v0, load):
    """On a straight path its velocity would ring about zero with the sign changing at every step."""
    width, velocities = 1e-4, [v0]
    for _ in range(8):
        velocities.append(implicit_step(velocities[-1], load, 1.0, width))
    stuck = np.array(velocities[4:])
    assert np.abs(stuck).max() < 4.0 * width
    assert np.all(stuck * load >= -1e-9)
    held, _ = jump(stuck, width)
    np.testing.assert_allclose(held, load, atol=1e-3)


@pytest.mark.parametrize("change", [0.5, 2.0, 3.0, 4.0, 6.0, 10.0, 100.0])
def test_a_small_velocity_fades_without_ringing_whatever_the_step(change):
    width = 1.0
    for start in (1e-3, -1e-3):
        assert implicit_step(start, 0.0, change, width) * start > -1e-12


def test_the_value_at_a_moment_is_that_between_two_steps_while_a_mass_sticks():
    """A load that rises in a straight line: the law at a time holds the mean load of the step before it."""
    width, rise = 1e-5, 0.04
    velocities = [0.0]
    for k in range(15):
        velocities.append(implicit_step(velocities[-1], rise * (k + 0.5), 1.0, width))
    law, _ = jump(np.array(velocities), width)
    line = jump_line(np.array(velocities[:-1]), np.array(velocities[1:]), width, change=1.0)
    at = rise * np.arange(15)
    assert np.abs(law[:-1] - at)[3:].max() > 0.4 * rise
    np.testing.assert_allclose((law[:-1] + line.lift[0])[3:], at[3:], atol=0.04 * rise)


def test_a_sliding_mass_has_no_lift():
    line = jump_line(np.array([1.0, -2.0]), np.array([-1.0, -1.0]), 0.01, change=1.0)
    np.testing.assert_allclose(line.lift[0], 0.0, atol=1e-5)


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
        apart = np.abs(getattr(below, end) - getattr(above, end))[:3, 0]
        assert apart[0] < 1e-10
        assert size * apart[1:].max() < 2e-8
