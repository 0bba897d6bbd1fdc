"""What every law of the motion keeps: exact derivatives, linear amplitudes, units, signs, finite numbers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.effects.dampers import CoulombFriction, QuadraticDrag
from modal.effects.effect import Motion, Situation
from modal.effects.hysteresis import BoucWenHysteresis, SlackInHysteresis
from modal.effects.springs import (
    BilinearStiffness,
    CubicStiffness,
    GapSpring,
    QuadraticStiffness,
    SineSoftening,
    TimeVaryingStiffness,
)

LAWS = {
    CubicStiffness(): (-2.3,),
    QuadraticStiffness(): (1.7,),
    BilinearStiffness(): (-0.8,),
    GapSpring(): (-0.4, 3.0, 0.7),
    CoulombFriction(): (1.3,),
    QuadraticDrag(): (0.6,),
    BoucWenHysteresis(): (2.0, 0.6, 1.8),
    SineSoftening(): (0.9,),
    SlackInHysteresis(): (2.5, 0.3, 0.4),
    TimeVaryingStiffness(): (0.25,),
}
"""Values without symmetry, of the size of the motion below."""
ODD = {
    "cubic_stiffness",
    "gap_spring",
    "coulomb_friction",
    "quadratic_drag",
    "bouc_wen_hysteresis",
    "sine_softening",
    "slack_in_hysteresis",
    "time_varying_stiffness",
}
EVEN = {"quadratic_stiffness"}
NOT_NEGATIVE = {"Fc", "c2", "k_out", "gap", "a", "yield_displacement", "k", "slack", "length_scale"}
law = pytest.mark.parametrize("effect", LAWS, ids=lambda effect: effect.key)
with_memory = pytest.mark.parametrize(
    "effect", [effect for effect in LAWS if effect.n_memory], ids=lambda effect: effect.key
)
seeds = given(seed=st.integers(0, 2**32 - 1))


def random_motion(rng, effect, *, n=60, smoothing=0.3):
    return Motion(
        displacement=rng.normal(size=n),
        velocity=rng.normal(size=n) * 2.0,
        time=rng.uniform(0.0, 5.0, n),
        memory=rng.uniform(-0.55, 0.55, (n, effect.n_memory)),
        displacement_scale=1.1,
        velocity_scale=1.9,
        stiffness=1.4,
        smoothing=smoothing,
    )


def differences(function, point, *, step=1e-5):
    """Central difference over samples, and where both sides agree (no corner between)."""
    below, here, above = function(point - step), function(point), function(point + step)
    smooth = np.abs(above - 2.0 * here + below) < 1e-3 * step * (1.0 + np.abs(above - below) / step)
    return (above - below) / (2.0 * step), smooth


def assert_slopes(claimed, function, point, *, rtol=2e-5, corners=0.05):
    found, smooth = differences(function, point)
    assert np.mean(~smooth) <= corners
    np.testing.assert_allclose(claimed[smooth], found[smooth], rtol=rtol, atol=2e-5)


def with_value(values, j, value):
    return [*values[:j], value, *values[j + 1 :]]


@law
@settings(max_examples=20, deadline=None)
@seeds
def test_the_derivatives_of_the_force_are_those_of_its_value(effect, seed):
    motion, values = random_motion(np.random.default_rng(seed), effect), LAWS[effect]
    force = effect.force(values, motion)
    n = len(motion.time)
    assert force.by_memory.shape == (n, effect.n_memory)
    assert force.by_parameter.shape == (n, len(effect.parameters))
    for claimed, name in ((force.by_displacement, "displacement"), (force.by_velocity, "velocity")):
        assert_slopes(
            claimed,
            lambda x, name=name: effect.force(values, replace(motion, **{name: x})).value,
            getattr(motion, name),
        )
    if effect.n_memory:
        assert_slopes(
            force.by_memory[:, 0],
            lambda x: effect.force(values, replace(motion, memory=x[:, None])).value,
            motion.memory[:, 0],
        )
    for j, value in enumerate(values):
        assert_slopes(
            force.by_parameter[:, j],
            lambda x, j=j: effect.force(with_value(values, j, x), motion).value,
            np.full(n, float(value)),
        )


@with_memory
@settings(max_examples=20, deadline=None)
@seeds
def test_the_derivatives_of_the_memory_are_those_of_its_value(effect, seed):
    rng = np.random.default_rng(seed)
    before, after, values = random_motion(rng, effect), random_motion(rng, effect), LAWS[effect]
    dt = 0.7
    memory = effect.advance(values, before, after, dt)
    n = len(before.time)
    assert memory.value.shape == (n, 1)
    assert memory.by_memory.shape == (n, 1, 1)
    assert memory.by_parameter.shape == (n, 1, len(values))

    def value_at(start=before, end=after, at=values):
        return effect.advance(at, start, end, dt).value[:, 0]

    for name in ("displacement", "velocity"):
        assert_slopes(
            getattr(memory, f"by_{name}_before")[:, 0],
            lambda x, name=name: value_at(start=replace(before, **{name: x})),
            getattr(before, name),
            rtol=1e-3,
        )
        assert_slopes(
            getattr(memory, f"by_{name}_after")[:, 0],
            lambda x, name=name: value_at(end=replace(after, **{name: x})),
            getattr(after, name),
            rtol=1e-3,
        )
    assert_slopes(
        memory.by_memory[:, 0, 0],
        lambda x: value_at(start=replace(before, memory=x[:, None])),
        before.memory[:, 0],
        rtol=1e-3,
    )
    for j, value in enumerate(values):
        assert_slopes(
            memory.by_parameter[:, 0, j],
            lambda x, j=j: value_at(at=with_value(values, j, x)),
            np.full(n, float(value)),
            rtol=1e-3,
        )


@law
@settings(deadline=None)
@seeds
def test_amplitudes_enter_linearly(effect, seed):
    rng = np.random.default_rng(seed)
    motion, values = random_motion(rng, effect), LAWS[effect]
    amplitudes = [j for j, kind in enumerate(effect.parameters) if kind.role == "amplitude"]
    force = effect.force(values, motion)
    if not amplitudes:  # a spring of known stiffness: only its length scale is free
        assert effect.key == "sine_softening"
        return
    columns = effect.screen_columns(values, motion)
    np.testing.assert_allclose(columns @ [values[j] for j in amplitudes], force.value, rtol=1e-10, atol=1e-12)
    weights = rng.uniform(0.1, 2.0, len(amplitudes))
    chosen = effect.from_screen(values, weights)
    np.testing.assert_allclose(effect.screen_columns(chosen, motion), columns)
    np.testing.assert_allclose(effect.force(chosen, motion).value, columns @ weights, rtol=1e-10, atol=1e-12)


@law
@settings(deadline=None)
@seeds
def test_a_change_of_units_changes_the_force_by_its_unit(effect, seed):
    rng = np.random.default_rng(seed)
    motion, values = random_motion(rng, effect), LAWS[effect]
    force, length, time = np.exp(rng.uniform(-3.0, 3.0, 3))
    again = replace(
        motion,
        displacement=motion.displacement * length,
        velocity=motion.velocity * length / time,
        time=motion.time * time,
        memory=motion.memory * length,
        displacement_scale=motion.displacement_scale * length,
        velocity_scale=motion.velocity_scale * length / time,
        stiffness=motion.stiffness * force / length,
    )
    converted = [
        value * force ** kind.dimension[0] * length ** kind.dimension[1] * time ** kind.dimension[2]
        for value, kind in zip(values, effect.parameters, strict=True)
    ]
    np.testing.assert_allclose(
        effect.force(converted, again).value, force * effect.force(values, motion).value, rtol=1e-9, atol=1e-9 * force
    )
    if effect.n_memory:
        np.testing.assert_allclose(
            effect.advance(converted, again, replace(again, displacement=-again.displacement), 0.1 * time).value,
            length * effect.advance(values, motion, replace(motion, displacement=-motion.displacement), 0.1).value,
            rtol=1e-9,
            atol=1e-9 * length,
        )


@law
@pytest.mark.parametrize("smoothing", [0.0, 0.2])
@settings(deadline=None)
@seeds
def test_symmetry(effect, smoothing, seed):
    motion, values = random_motion(np.random.default_rng(seed), effect, smoothing=smoothing), LAWS[effect]
    mirrored = replace(motion, displacement=-motion.displacement, velocity=-motion.velocity, memory=-motion.memory)
    there, back = effect.force(values, motion).value, effect.force(values, mirrored).value
    if effect.key in ODD:
        np.testing.assert_allclose(back, -there, rtol=1e-12, atol=1e-14)
    elif effect.key in EVEN:
        np.testing.assert_allclose(back, there, rtol=1e-12)
    else:
        assert np.max(np.abs(np.abs(back) - np.abs(there))) > 0.1


@law
def test_the_neutral_values_give_no_force(effect):
    motion = random_motion(np.random.default_rng(3), effect)
    force = effect.force(effect.neutral, motion)
    assert not force.value.any()
    assert not force.by_displacement.any()
    assert not force.by_velocity.any()
    assert np.isfinite(force.by_parameter).all()


@law
@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([0.0, 1e-300, 1e-9, 1.0, 1e9, 1e100]),
    scale=st.sampled_from([0.0, 1e-300, 1.0, 1e100]),
    smoothing=st.sampled_from([0.0, 1e-6, 0.3]),
    lengths=st.sampled_from([0.0, 1e-300, 1.0, 1e100]),
)
def test_no_finite_motion_gives_anything_but_finite_numbers(effect, *, seed, size, scale, smoothing, lengths):
    rng = np.random.default_rng(seed)
    motion, after = (
        replace(
            found, displacement=found.displacement * size, velocity=found.velocity * size, memory=found.memory * size
        )
        for found in (random_motion(rng, effect, smoothing=smoothing) for _ in range(2))
    )
    motion = replace(motion, displacement_scale=scale, velocity_scale=scale)
    values = [
        lengths if kind.dimension == (0, 1, 0) else value
        for value, kind in zip(LAWS[effect], effect.parameters, strict=True)
    ]
    force = effect.force(values, motion)
    found = [force.value, force.by_displacement, force.by_velocity, force.by_memory, force.by_parameter]
    if effect.n_memory:
        memory = effect.advance(values, motion, after, 0.01)
        found += [getattr(memory, name) for name in type(memory).__slots__]
    for array in found:
        assert np.isfinite(array).all()


@law
def test_each_record_may_have_values_of_its_own(effect):
    motion, values = random_motion(np.random.default_rng(4), effect), LAWS[effect]
    n = len(motion.time)
    spread = [np.full(n, value) for value in values]
    one, many = effect.force(values, motion), effect.force(spread, motion)
    for name in type(one).__slots__:
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name))
    if effect.n_memory:
        after = random_motion(np.random.default_rng(5), effect)
        one, many = effect.advance(values, motion, after, 0.1), effect.advance(spread, motion, after, 0.1)
        np.testing.assert_array_equal(one.value, many.value)
        np.testing.assert_array_equal(one.by_parameter, many.by_parameter)


@law
def test_the_starts_lie_within_the_bounds_and_the_motion(effect):
    motion = random_motion(np.random.default_rng(6), effect, n=2000)
    situation = Situation(motion=motion, residual_frequencies=(), dt=0.01, longest=20.0)
    starts = effect.starts(situation)
    n_shapes = sum(kind.role == "shape" for kind in effect.parameters)
    assert 1 <= len(starts) <= (4 if n_shapes < 2 else 9)  # two lengths: each of one with each of the other
    assert len(set(starts)) == len(starts)
    largest = np.max(np.abs(motion.displacement))
    for start in starts:
        for value, kind in zip(start, effect.parameters, strict=True):
            assert kind.lower <= value <= kind.upper
            assert value == 1.0 or kind.role == "shape"
            if kind.role == "shape" and kind.dimension == (0, 1, 0) and effect.key != "sine_softening":
                assert 0.0 < value < largest
    still = replace(motion, displacement=np.zeros(9), velocity=np.zeros(9), time=np.zeros(9), memory=motion.memory[:9])
    assert np.isfinite(effect.starts(replace(situation, motion=still))).all()


@law
def test_signs_and_words(effect):
    assert len(effect.neutral) == len(effect.parameters)
    for kind in effect.parameters:
        assert (kind.lower >= 0.0) == (kind.name in NOT_NEGATIVE or kind.name == "n")
        assert kind.meaning
    for text in (effect.law, effect.family, effect.signature, effect.reference):
        assert text
        assert "\n" not in text
    assert "doi" in effect.reference
    assert type(effect).__doc__.count("\n") > 12


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
