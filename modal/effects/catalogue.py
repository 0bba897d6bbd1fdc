"""Every effect that may be missing from a model: one table; a user's own effect joins a new table the same way."""

from collections.abc import Mapping
from types import MappingProxyType

from modal.effects.ambiguity import AMBIGUOUS, AmbiguityClass, ambiguous_with
from modal.effects.bilinear_stiffness import BilinearStiffness
from modal.effects.bouc_wen_hysteresis import BoucWenHysteresis
from modal.effects.constant_force import ConstantForce
from modal.effects.coulomb_friction import CoulombFriction
from modal.effects.cubic_stiffness import CubicStiffness
from modal.effects.effect import Effect
from modal.effects.effect_check import check_effect
from modal.effects.gap_spring import GapSpring
from modal.effects.input_delay import DelayedInput
from modal.effects.input_gain import InputGain
from modal.effects.input_saturation import InputSaturation
from modal.effects.missing_mode import MissingMode
from modal.effects.overflow import Overflow
from modal.effects.periodic_disturbance import PeriodicDisturbance
from modal.effects.power_law_flow import PowerLawFlow
from modal.effects.quadratic_drag import QuadraticDrag
from modal.effects.quadratic_stiffness import QuadraticStiffness
from modal.effects.sensor_bias import SensorBias
from modal.effects.sensor_gain import SensorGain
from modal.effects.sine_softening import SineSoftening
from modal.effects.slack_in_hysteresis import SlackInHysteresis
from modal.effects.time_varying_stiffness import TimeVaryingStiffness
from okid.errors import InvalidDataError

__all__ = ["AMBIGUOUS", "CATALOGUE", "AmbiguityClass", "ambiguous_with", "register"]

CATALOGUE: Mapping[str, Effect] = MappingProxyType(
    {
        effect.key: effect
        for effect in (
            CubicStiffness(),
            QuadraticStiffness(),
            BilinearStiffness(),
            GapSpring(),
            CoulombFriction(),
            QuadraticDrag(),
            BoucWenHysteresis(),
            SineSoftening(),
            SlackInHysteresis(),
            ConstantForce(),
            TimeVaryingStiffness(),
            MissingMode(),
            DelayedInput(),
            InputSaturation(),
            InputGain(),
            SensorBias(),
            SensorGain(),
            PeriodicDisturbance(),
            PowerLawFlow(),
            Overflow(),
        )
    }
)
"""The effects by key; it cannot be changed in place."""


def register(effect: Effect, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> Mapping[str, Effect]:
    """A new catalogue with one effect more; the given one stays as it is.

    The effect is tried once on a random motion: words, parameters, starts, and every derivative against differences.

    Args:
        effect: The effect, an instance of a force, an input or a sensor effect.
        catalogue: The catalogue to add it to.

    Returns:
        The catalogue to hand to `diagnose`, which cannot be changed in place.

    Raises:
        InvalidDataError: If the key is taken, or if the effect does not keep the contract.

    Example:
        >>> from dataclasses import dataclass
        >>> from modal.effects.cubic_stiffness import CubicStiffness
        >>> @dataclass(frozen=True, slots=True, kw_only=True)
        ... class Hardening(CubicStiffness):
        ...     key = "hardening"
        >>> "hardening" in register(Hardening()), "hardening" in CATALOGUE
        (True, False)
    """
    check_effect(effect)
    if effect.key in catalogue:
        raise InvalidDataError(f"the catalogue already holds an effect {effect.key!r}; give yours another key")
    return MappingProxyType({**catalogue, effect.key: effect})
