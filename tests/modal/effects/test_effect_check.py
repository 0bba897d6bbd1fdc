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


@dataclass(frozen=True, slots=True, kw_only=True)
class Spring(CubicStiffness):
    key = "mine"


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongSlope(Spring):
    def force(self, values, motion):
        right = CubicStiffness().force(values, motion)
        return replace(right, by_displacement=1.01 * right.by_displacement)


@dataclass(frozen=True, slots=True, kw_only=True)
class ForgottenVelocity(Spring):
    def force(self, values, motion):
        right = CubicStiffness().force(values, motion)
        return replace(right, value=right.value + 0.1 * values[0] * motion.velocity)


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongParameter(Spring):
    def force(self, values, motion):
        right = CubicStiffness().force(values, motion)
        return replace(right, by_parameter=-right.by_parameter)


@dataclass(frozen=True, slots=True, kw_only=True)
class NotLinear(Spring):
    def force(self, values, motion):
        right = CubicStiffness().force([values[0] ** 2], motion)
        return replace(right, by_parameter=2.0 * values[0] * right.by_parameter)


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongShape(Spring):
    def force(self, values, motion):
        right = CubicStiffness().force(values, motion)
        return replace(right, by_velocity=np.zeros((1, 2)))


@dataclass(frozen=True, slots=True, kw_only=True)
class NeverNeutral(Spring):
    def force(self, values, motion):
        right = CubicStiffness().force(values, motion)
        return replace(right, value=right.value + 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongMemory(MissingMode):
    key = "mine"

    def advance(self, values, before, after, dt):
        right = MissingMode().advance(values, before, after, dt)
        return replace(right, by_velocity_after=1.1 * right.by_velocity_after)


@dataclass(frozen=True, slots=True, kw_only=True)
class ForgottenMemory(MissingMode):
    key = "mine"

    def force(self, values, motion):
        right = MissingMode().force(values, motion)
        return replace(right, by_memory=np.zeros_like(right.by_memory))


@dataclass(frozen=True, slots=True, kw_only=True)
class Twice(Spring):
    parameters = (CubicStiffness.parameters[0], CubicStiffness.parameters[0])
    neutral = (0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoStart(Spring):
    def starts(self, situation):
        return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class StartBelow(ConstantForce):
    key = "mine"
    parameters = (ParameterKind(name="offset", meaning="a force", dimension=(1, 0, 0), lower=2.0),)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoLaw(Spring):
    law = " "


@dataclass(frozen=True, slots=True, kw_only=True)
class NoKey(ForceEffect):
    pass


@dataclass(frozen=True, slots=True, kw_only=True)
class NoNeutral(Spring):
    neutral = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadsAcceleration(Spring):
    needs = frozenset({"acceleration"})


@dataclass(frozen=True, slots=True, kw_only=True)
class SwappedBounds(Spring):
    parameters = (ParameterKind(name="k3", meaning="a stiffness", dimension=(1, -3, 0), lower=1.0, upper=0.0),)


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongSensor(SensorGain):
    key = "mine"

    def by_parameter(self, values, output, time):
        return np.ones((output.size, 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class NeutralSensor(SensorGain):
    key = "mine"
    neutral = (2.0,)


@dataclass(frozen=True, slots=True, kw_only=True)
class NeutralInput(InputGain):
    key = "mine"
    neutral = (0.0,)


@dataclass(frozen=True, slots=True, kw_only=True)
class ShortInput(InputGain):
    key = "mine"

    def apply(self, values, start, end, dt):
        return start[1:], end[1:]


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongInput(InputGain):
    key = "mine"

    def by_parameter(self, values, sample, start, end, dt):
        return start[np.newaxis], start[np.newaxis], sample[np.newaxis]


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
        (WrongSlope(), "'mine': by_displacement is off by"),
        (ForgottenVelocity(), "by_velocity is off by"),
        (WrongParameter(), "by_parameter of 'k3' is off by"),
        (NotLinear(), "by_parameter at twice the amplitudes is off by"),
        (WrongShape(), "by_velocity must be finite and of shape"),
        (NeverNeutral(), "gives a force at its neutral values"),
        (WrongMemory(), "by_velocity_after of `advance` is off by"),
        (ForgottenMemory(), "by_memory is off by"),
        (Twice(), "needs one or more parameters of different names"),
        (NoStart(), "proposes no start"),
        (StartBelow(), "a start has one finite value within its bounds"),
        (NoLaw(), "NoLaw has no law"),
        (NoKey(), "NoKey has no key"),
        (NoNeutral(), "needs `neutral` with one value for each"),
        (ReadsAcceleration(), "needs ['acceleration']"),
        (SwappedBounds(), "the lower must be below the upper"),
        (WrongSensor(), "by_parameter of 'gain' is off by"),
        (NeutralSensor(), "changes the output at its neutral values"),
        (NeutralInput(), "changes the input at its neutral values"),
        (WrongInput(), "by_parameter of 'gain' is off by"),
        (NoForce(), "'mine' lacks a method"),
        (ShortInput(), "must return a finite start and end"),
    ],
)
def test_a_fault_is_found_and_said_in_one_sentence(effect, words):
    with pytest.raises(InvalidDataError) as caught:
        register(effect, catalogue={})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_faultless_ones_pass():
    for effect in (Spring(), ConstantForce(), MissingMode(), SensorGain(), InputGain()):
        assert register(effect, catalogue={})[effect.key] is effect
