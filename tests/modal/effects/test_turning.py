"""The peak between two samples."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.effects.effect import Motion
from modal.effects.hysteresis import turning_point


def motion(displacement, velocity):
    n = len(displacement)
    return Motion(
        displacement=np.asarray(displacement, dtype=float),
        velocity=np.asarray(velocity, dtype=float),
        time=np.zeros(n),
        memory=np.zeros((n, 0)),
        displacement_scale=1.0,
        velocity_scale=1.0,
    )


@settings(deadline=None)
@given(
    start=st.floats(-5.0, 5.0), speed=st.floats(-5.0, 5.0), acceleration=st.floats(-50.0, 50.0), dt=st.floats(0.01, 1.0)
)
def test_the_peak_of_a_parabola_is_exact(start, speed, acceleration, dt):
    end, last = start + speed * dt + 0.5 * acceleration * dt**2, speed + acceleration * dt
    found = turning_point(motion([start], [speed]), motion([end], [last]), dt)
    peak = start - speed**2 / (2.0 * acceleration) if speed * last < 0.0 else start
    np.testing.assert_allclose(found.value, peak, rtol=1e-6, atol=1e-9)


def test_the_peak_of_a_sine_is_found_to_fourth_order_in_the_step():
    worst = []
    for samples in (15, 30, 60):
        step = 2.0 * np.pi / samples
        phase = 0.5 * np.pi - step * np.linspace(0.03, 0.97, 95)
        found = turning_point(
            motion(np.sin(phase), np.cos(phase)), motion(np.sin(phase + step), np.cos(phase + step)), step
        )
        assert found.turns.all()
        worst.append(np.max(np.abs(found.value - 1.0)))
    assert worst[1] < 3e-5  # the samples themselves miss the peak by up to 1 - cos(pi / 30) = 5.5e-3
    for coarse, fine in itertools.pairwise(worst):
        assert 14.0 < coarse / fine < 18.0


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_turning_point_lies_beyond_both_ends_and_elsewhere_there_is_none(seed):
    rng = np.random.default_rng(seed)
    d0, d1, v0, v1 = rng.normal(size=(4, 200))
    found = turning_point(motion(d0, v0), motion(d1, v1), 0.8)
    assert 0 < np.sum(found.turns) < 200
    way = np.sign(v0[found.turns])
    assert np.all((found.value - d0)[found.turns] * way > 0.0)
    assert np.all((found.value - d1)[found.turns] * way > 0.0)
    assert np.all((v0 * v1)[found.turns] < 0.0)
    np.testing.assert_array_equal(found.value[~found.turns], d0[~found.turns])


def test_a_port_without_velocity_moves_in_straight_lines():
    found = turning_point(motion([0.0, 1.0], [0.0, 0.0]), motion([1.0, 0.0], [0.0, 0.0]), 0.1)
    assert not found.turns.any()
    np.testing.assert_array_equal(found.value, [0.0, 1.0])
