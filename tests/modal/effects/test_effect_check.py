"""A user's own effect with one fault each: the check must find every one, in one sentence."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from modal.effects.catalogue import register
from modal.effects.effect import ForceEffect, InputEffect, ParameterKind
from modal.effects.inputs import InputGain
from modal.effects.missing_mode import MissingMode
from modal.effects.outside_forces import ConstantForce
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
