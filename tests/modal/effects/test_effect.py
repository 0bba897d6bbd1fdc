"""A user's own effect with one fault each: the check must find every one, in one sentence."""

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import pytest
from differences import central
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.effects.ambiguity import AMBIGUOUS, Circumstance, ambiguous_with
from modal.effects.catalogue import CATALOGUE, register
from modal.effects.effect import (
    LARGEST,
    WALL,
    ForceEffect,
    InputEffect,
    ParameterKind,
    cut_to_finite,
    levels,
    positive_part,
    share_of_end,
)
from modal.effects.inputs import InputGain
from modal.effects.outside_forces import ConstantForce, MissingMode
from modal.effects.sensors import SensorGain
from modal.effects.springs import CubicStiffness
from okid.errors import InvalidDataError


def variant(base, name="Mine", **changes):
    """A user's effect: one of the catalogue under a key of its own, with some of its attributes changed."""
    return dataclass(frozen=True, slots=True, kw_only=True)(type(name, (base,), {"key": "mine", **changes}))()


def other(base, method, change):
    """The same with what one method gives changed by `change(right, its first two arguments)`."""

    def changed(self, *arguments):
        return change(getattr(base(), method)(*arguments), *arguments[:2])

    return variant(base, **{method: changed})


def spring(change):
    return other(CubicStiffness, "force", change)


def not_linear(self, values, motion):
    right = CubicStiffness().force([values[0] ** 2], motion)
    return replace(right, by_parameter=2.0 * values[0] * right.by_parameter)


K3, OFFSET = CubicStiffness.parameters[0], ConstantForce.parameters[0]


class NoKey(ForceEffect):
    pass


@dataclass(frozen=True, slots=True, kw_only=True)
class NoForce(ForceEffect):
    key, law, family, signature, reference = "mine", "f = ?", "mine", "none", "none"
    parameters = CubicStiffness.parameters
    neutral = (0.0,)

    def starts(self, situation):
        return ((1.0,),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Squared(InputEffect):
    """A user's own change of an input, without derivatives of its own."""

    key, law, family, signature, reference = "mine", "u' = u + a u |u|", "mine", "harmonics", "none"
    parameters = (ParameterKind(name="a", meaning="curvature", dimension=(-1, 0, 0)),)
    neutral = (0.0,)

    def starts(self, situation):
        return ((1.0,),)

    def apply(self, values, start, end, dt):
        return start + values[0] * start * np.abs(start), end + values[0] * end * np.abs(end)


def test_an_input_without_derivatives_of_its_own_gets_differences():
    drive = np.linspace(-1.0, 1.0, 9)
    start, end, sample = register(Squared(), catalogue={})["mine"].by_parameter(
        [0.3], drive, 2.0 * drive, 3.0 * drive, 0.1
    )
    for found, at in ((start, 2.0 * drive), (end, 3.0 * drive), (sample, drive)):
        np.testing.assert_allclose(found, [at * np.abs(at)], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (
            spring(lambda f, *_: replace(f, by_displacement=1.01 * f.by_displacement)),
            "'mine': by_displacement is off by",
        ),
        (spring(lambda f, v, m: replace(f, value=f.value + 0.1 * v[0] * m.velocity)), "by_velocity is off by"),
        (spring(lambda f, *_: replace(f, by_parameter=-f.by_parameter)), "by_parameter of 'k3' is off by"),
        (variant(CubicStiffness, force=not_linear), "by_parameter at twice the amplitudes is off by"),
        (spring(lambda f, *_: replace(f, by_velocity=np.zeros((1, 2)))), "by_velocity must be finite and of shape"),
        (spring(lambda f, *_: replace(f, value=f.value + 1.0)), "gives a force at its neutral values"),
        (
            other(MissingMode, "advance", lambda m, *_: replace(m, by_velocity_after=1.1 * m.by_velocity_after)),
            "by_velocity_after of `advance` is off by",
        ),
        (
            other(MissingMode, "force", lambda f, *_: replace(f, by_memory=np.zeros_like(f.by_memory))),
            "by_memory is off by",
        ),
        (
            variant(CubicStiffness, parameters=(K3, K3), neutral=(0.0, 0.0)),
            "needs one or more parameters of different names",
        ),
        (variant(CubicStiffness, starts=lambda self, situation: ()), "proposes no start"),
        (
            variant(ConstantForce, parameters=(replace(OFFSET, lower=2.0),)),
            "a start has one finite value within its bounds",
        ),
        (variant(CubicStiffness, "NoLaw", law=" "), "NoLaw has no law"),
        (NoKey(), "NoKey has no key"),
        (variant(CubicStiffness, neutral=()), "needs `neutral` with one value for each"),
        (variant(CubicStiffness, needs=frozenset({"acceleration"})), "needs ['acceleration']"),
        (
            variant(CubicStiffness, parameters=(replace(K3, lower=1.0, upper=0.0),)),
            "the lower must be below the upper",
        ),
        (
            other(SensorGain, "by_parameter", lambda _right, _values, output: np.ones((output.size, 1))),
            "by_parameter of 'gain' is off by",
        ),
        (variant(SensorGain, neutral=(2.0,)), "changes the output at its neutral values"),
        (variant(InputGain, neutral=(0.0,)), "changes the input at its neutral values"),
        (
            other(InputGain, "by_parameter", lambda right, *_: (right[0], right[0], right[2])),
            "by_parameter of 'gain' is off by",
        ),
        (NoForce(), "'mine' lacks a method"),
        (
            other(InputGain, "apply", lambda right, *_: (right[0][1:], right[1][1:])),
            "must return a finite start and end",
        ),
    ],
)
def test_a_fault_is_found_and_said_in_one_sentence(effect, words):
    with pytest.raises(InvalidDataError) as caught:
        register(effect, catalogue={})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_faultless_ones_pass():
    for effect in (variant(CubicStiffness), ConstantForce(), MissingMode(), SensorGain(), InputGain()):
        assert register(effect, catalogue={})[effect.key] is effect


PAIRS = [  # the table of what cannot be told apart, and the classes by structure
    ("coulomb_friction", "quadratic_drag", "one_level"),
    ("gap_spring", "cubic_stiffness", "one_level"),
    ("bilinear_stiffness", "quadratic_stiffness", "one_level"),
    ("input_saturation", "input_gain", "one_level"),
    ("missing_mode", "periodic_disturbance", "one_level"),
    ("sensor_gain", "input_gain", "one_dof"),
    ("coulomb_friction", "constant_force", "one_way"),
    ("sensor_bias", "constant_force", "one_output"),
]


@pytest.mark.parametrize(("one", "other", "circumstance"), PAIRS)
def test_a_pair_stands_under_its_circumstance_only_and_both_ways(one, other, circumstance):
    for key, twin in ((one, other), (other, one)):
        under = [found.others(key) for found in ambiguous_with(key, circumstances=[circumstance])]
        assert any(twin in others for others in under)
        rest = set(get_args(Circumstance)) - {circumstance}
        assert not any(twin in found.others(key) for found in ambiguous_with(key, circumstances=rest))


def test_every_member_is_in_the_catalogue_and_every_class_says_when_and_what_separates():
    for found in AMBIGUOUS:
        assert set(found.effects) <= set(CATALOGUE)
        assert len(found.effects) + len(found.besides) >= 2
        assert found.circumstance in get_args(Circumstance)
        assert found.when
        assert found.separates


def test_no_effect_is_listed_beside_itself():
    for key in CATALOGUE:
        for found in ambiguous_with(key, circumstances=get_args(Circumstance)):
            assert key in found.effects
            assert key not in found.others(key)


def test_half_a_sample_of_delay_is_a_question_of_the_hold():
    assert not ambiguous_with("input_delay")
    (found,) = ambiguous_with("input_delay", circumstances=["half_a_sample"])
    assert "half a sample" in found.others("input_delay")[0]


def test_a_delay_seen_by_one_sensor_may_be_that_sensors():
    (found,) = ambiguous_with("input_delay", circumstances=["one_output"])
    assert found.others("input_delay") == ("a delay of the sensor",)


def test_a_sine_seen_by_one_sensor_may_be_hum_in_its_cable():
    (found,) = ambiguous_with("periodic_disturbance", circumstances=["one_output"])
    assert found.others("periodic_disturbance") == ("hum in the sensor or its cable",)


def test_a_gain_of_the_only_drive_is_the_scale_of_the_structure():
    (found,) = ambiguous_with("input_gain", circumstances=["one_drive"])
    assert found.others("input_gain") == ("scale of all masses, stiffnesses and dampings",)


def test_a_sensor_of_a_state_space_may_sit_on_another_mass():
    (found,) = ambiguous_with("sensor_gain", circumstances=["unknown_masses"])
    assert "mass" in found.others("sensor_gain")[0]
    assert not ambiguous_with("input_gain", circumstances=["unknown_masses"])


def test_an_unknown_effect_is_in_no_class():
    assert ambiguous_with("mine", circumstances=get_args(Circumstance)) == ()


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


stiffness = st.floats(0.0, 1e9)


def left_of(z):
    """What a step leaves of a level above the brim."""
    share, _ = share_of_end(z)
    return (1.0 - (1.0 - share) * z) / (1.0 + share * z)


@given(z=st.floats(0.0, 1e4))
def test_the_slope_is_that_of_the_share(z):
    assert share_of_end(z)[1] == pytest.approx(central(lambda at: share_of_end(at)[0], z), abs=1e-9)


@given(z=stiffness)
def test_the_start_of_a_step_takes_no_more_than_half_a_level(z):
    """So the level at the end rises with that at the start, as long as the plant keeps half of it."""
    share, _ = share_of_end(z)
    assert 0.5 <= share <= 1.0
    assert z * (1.0 - share) <= 0.5 + 1e-6


def test_soft_steps_are_of_second_order():
    z = np.array([0.1, 0.05, 0.025])
    error = np.abs(left_of(z) - np.exp(-z))
    assert np.all(error[:-1] / error[1:] > 7.0)  # of third order in one step
    assert error[0] < 3e-4


def test_a_wall_leaves_nothing():
    """A line between both ends would leave -1, and ring for ever."""
    assert abs(left_of(WALL)) < 2.0 / WALL
    assert np.all(left_of(np.geomspace(1e-3, 1e8, 300)) >= -1e-8)
