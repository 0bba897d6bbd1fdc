"""Every effect that may be missing from a model: one table; a user's own effect joins a new table the same way."""

from collections.abc import Mapping
from types import MappingProxyType

from modal.discrepancy.ambiguity import AMBIGUOUS, AmbiguityClass, ambiguous_with
from modal.discrepancy.effect_check import check_effect
from modal.discrepancy.effects.bilinear_stiffness import BilinearStiffness
from modal.discrepancy.effects.bouc_wen_hysteresis import BoucWenHysteresis
from modal.discrepancy.effects.constant_force import ConstantForce
from modal.discrepancy.effects.coulomb_friction import CoulombFriction
from modal.discrepancy.effects.cubic_stiffness import CubicStiffness
from modal.discrepancy.effects.effect import Effect
from modal.discrepancy.effects.gap_spring import GapSpring
from modal.discrepancy.effects.input_delay import DelayedInput
from modal.discrepancy.effects.input_gain import InputGain
from modal.discrepancy.effects.input_saturation import InputSaturation
from modal.discrepancy.effects.missing_mode import MissingMode
from modal.discrepancy.effects.overflow import Overflow
from modal.discrepancy.effects.periodic_disturbance import PeriodicDisturbance
from modal.discrepancy.effects.power_law_flow import PowerLawFlow
from modal.discrepancy.effects.quadratic_drag import QuadraticDrag
from modal.discrepancy.effects.quadratic_stiffness import QuadraticStiffness
from modal.discrepancy.effects.sensor_bias import SensorBias
from modal.discrepancy.effects.sensor_gain import SensorGain
from modal.discrepancy.effects.sine_softening import SineSoftening
from modal.discrepancy.effects.slack_in_hysteresis import SlackInHysteresis
from modal.discrepancy.effects.time_varying_stiffness import TimeVaryingStiffness
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
        >>> from modal.discrepancy.effects.cubic_stiffness import CubicStiffness
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
