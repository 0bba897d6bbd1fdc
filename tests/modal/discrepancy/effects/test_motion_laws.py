"""Laws without memory against their definitions in the catalogue, sharp and exact, and against energy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.effects.dampers import CoulombFriction, QuadraticDrag
from modal.effects.effect import Motion
from modal.effects.springs import (
    BilinearStiffness,
    CubicStiffness,
    GapSpring,
    QuadraticStiffness,
    SineSoftening,
    TimeVaryingStiffness,
)

coordinates = st.floats(-100.0, 100.0).map(lambda x: round(x, 6))  # no subnormal numbers: their squares are 0
positive = st.floats(1e-3, 100.0)


def motion(d=(0.0,), v=(0.0,), t=(0.0,), *, smoothing=0.0, stiffness=1.0):
    d, v, t = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (d, v, t)))
    return Motion(
        displacement=d,
        velocity=v,
        time=t,
        memory=np.zeros((len(d), 0)),
        displacement_scale=1.0,
        velocity_scale=1.0,
        stiffness=stiffness,
        smoothing=smoothing,
    )


def value(effect, values, at):
    return effect.force(values, at).value


@settings(deadline=None)
@given(d=coordinates, v=coordinates, t=coordinates.map(abs), a=coordinates)
def test_the_laws_of_one_amplitude_are_those_of_the_catalogue(d, v, t, a):
    at = motion([d], [v], [t])
    for effect, exact in (
        (CubicStiffness(), a * d**3),
        (QuadraticStiffness(), a * d**2),
        (BilinearStiffness(), a * max(d, 0.0)),
        (CoulombFriction(), a * np.sign(v)),
        (QuadraticDrag(), a * v * abs(v)),
        (TimeVaryingStiffness(), a * t * d),
    ):
        np.testing.assert_allclose(value(effect, (a,), at), exact, rtol=1e-12, atol=0.0)


@settings(deadline=None)
@given(d=coordinates, k_in=st.floats(-5.0, 5.0), k_out=st.floats(0.0, 10.0), gap=st.floats(0.0, 50.0))
def test_the_gap_spring_is_that_of_the_catalogue(d, k_in, k_out, gap):
    exact = k_in * d + ((k_out - k_in) * (abs(d) - gap) * np.sign(d) if abs(d) > gap else 0.0)
    np.testing.assert_allclose(value(GapSpring(), (k_in, k_out, gap), motion([d])), exact, rtol=1e-10, atol=1e-10)


@settings(deadline=None)
@given(d=coordinates, k=positive, gap=st.floats(0.0, 50.0), smoothing=st.floats(1e-3, 2.0))
def test_a_spring_of_one_stiffness_has_no_gap_however_smooth(d, k, gap, smoothing):
    found = GapSpring().force((k, k, gap), motion([d], smoothing=smoothing))
    np.testing.assert_allclose(found.value, k * d, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.by_displacement, k, rtol=1e-10)
    np.testing.assert_allclose(
        value(GapSpring(), (0.0, k, 0.0), motion([d], smoothing=smoothing)), k * d, rtol=1e-10, atol=1e-10
    )


@settings(deadline=None)
@given(d=coordinates, k=positive, length=st.floats(0.1, 1e6))
def test_sine_softening_makes_of_the_spring_a_pendulum(d, k, length):
    found = value(SineSoftening(), (length,), motion([d], stiffness=k))
    np.testing.assert_allclose(k * d + found, k * length * np.sin(d / length), rtol=1e-9, atol=1e-9 * k)


@settings(deadline=None)
@given(d=st.floats(0.1, 1.0), length=st.floats(50.0, 1e4))
def test_sine_softening_is_cubic_at_first_and_keeps_its_digits(d, length):
    found = value(SineSoftening(), (length,), motion([d], stiffness=2.0))
    cubic = -2.0 * d**3 / (6.0 * length**2)
    np.testing.assert_allclose(found, cubic * (1.0 - (d / length) ** 2 / 20.0), rtol=1e-8)


def test_sine_softening_follows_the_weight_of_its_screen():
    """A weight is a cubic term: four times the term at half the length scale; none or a wrong sign: a long one."""
    effect, small = SineSoftening(), motion(np.linspace(-0.05, 0.05, 11), stiffness=3.0)
    column = effect.screen_columns((1.0,), small)
    np.testing.assert_allclose(column[:, 0], value(effect, (1.0,), small))
    found = effect.from_screen((1.0,), (4.0,))
    np.testing.assert_allclose(found, (0.5,))
    np.testing.assert_allclose(value(effect, found, small), 4.0 * column[:, 0], rtol=2e-3)
    assert effect.from_screen((1.0,), (-3.0,))[0] > 5.0


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_friction_and_drag_only_take_energy(smoothing, seed):
    velocity = np.random.default_rng(seed).normal(size=200)
    for effect in (CoulombFriction(), QuadraticDrag()):
        assert np.all(value(effect, (0.7,), motion(v=velocity, smoothing=smoothing)) * velocity >= 0.0)


@settings(deadline=None)
@given(amplitude=positive, frequency=positive)
def test_what_friction_and_drag_take_from_a_cycle_of_a_sine(amplitude, frequency):
    """4 Fc A and (8/3) c2 A^3 w^2: the areas from which the equivalent dampings of the textbooks follow."""
    n = 4000
    angle = 2.0 * np.pi * (np.arange(n) + 0.5) / n
    velocity = amplitude * frequency * np.cos(angle)
    for effect, exact in (
        (CoulombFriction(), 4.0 * amplitude),
        (QuadraticDrag(), 8.0 / 3.0 * amplitude**3 * frequency**2),
    ):
        work = np.sum(value(effect, (1.0,), motion(v=velocity)) * velocity) * 2.0 * np.pi / (n * frequency)
        np.testing.assert_allclose(work, exact, rtol=1e-5)


@settings(deadline=None)
@given(d=coordinates, factor=positive)
def test_bilinear_stiffness_is_homogeneous_in_the_amplitude_and_quadratic_is_not(d, factor):
    one, many = motion([d]), motion([d * factor])
    np.testing.assert_allclose(
        value(BilinearStiffness(), (1.0,), many), factor * value(BilinearStiffness(), (1.0,), one), rtol=1e-12
    )
    np.testing.assert_allclose(
        value(QuadraticStiffness(), (1.0,), many), factor**2 * value(QuadraticStiffness(), (1.0,), one), rtol=1e-10
    )


@pytest.mark.parametrize("effect_values", [(BilinearStiffness(), (2.0,)), (GapSpring(), (0.5, 2.5, 0.8))])
def test_elastic_laws_give_back_what_they_took(effect_values):
    effect, values = effect_values
    angle = 2.0 * np.pi * np.arange(2001) / 2000.0
    displacement = np.sin(angle) + 0.5 * np.cos(2.0 * angle)
    force = value(effect, values, motion(displacement, smoothing=0.2))
    assert abs(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(displacement))) < 1e-12
