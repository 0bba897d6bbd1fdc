"""Every effect that may be missing from a model: the table, the names and units of its entries, and how to add one.

A law with a wrong derivative does not fail loudly: Newton's steps slow down and the fitted values are off. So a user's
own effect is tried once on a random motion before it enters a catalogue.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from modal.effects.dampers import CoulombFriction, QuadraticDrag, StribeckFriction
from modal.effects.effect import Effect, ForceEffect, InputEffect, Motion, SensorEffect, Situation, is_form_free
from modal.effects.flows import Overflow, PowerLawFlow
from modal.effects.hysteresis import BoucWenHysteresis, SlackInHysteresis
from modal.effects.inputs import ActuatorLag, DelayedInput, InputGain, InputSaturation
from modal.effects.outside_forces import ConstantForce, MissingMode, PeriodicDisturbance
from modal.effects.sensors import RecordOffset, SensorBias, SensorGain, SensorLag
from modal.effects.smooth_law import SmoothDamping, SmoothStiffness
from modal.effects.springs import (
    BilinearStiffness,
    CubicStiffness,
    GapSpring,
    QuadraticStiffness,
    SineSoftening,
    TimeVaryingStiffness,
)
from modal.simulation import DIFFERENCE_STEP
from modal.simulation.plant import Plant
from okid.arrays import FloatArray
from okid.errors import InvalidDataError

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
            StribeckFriction(),
            SmoothStiffness(),
            SmoothDamping(),
            ActuatorLag(),
            SensorLag(),
            RecordOffset(),
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
        >>> from modal.effects.springs import CubicStiffness
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


def by_form(catalogue: Mapping[str, Effect]) -> tuple[dict[str, Effect], dict[str, Effect]]:
    """The effects of a catalogue with a law of their own, and those of unknown form, which contain many of the former.

    Example:
        >>> list(by_form(CATALOGUE)[1])
        ['smooth_stiffness', 'smooth_damping']
    """
    free = {key: one for key, one in catalogue.items() if is_form_free(one)}
    return {key: one for key, one in catalogue.items() if key not in free}, free


_NAMES_KEPT = {"coulomb": "Coulomb", "bouc": "Bouc", "wen": "Wen", "stribeck": "Stribeck"}
"""Words of catalogue keys that are people's names."""


_LAWS_OF_UNKNOWN_FORM = {
    "smooth_stiffness": "a smooth law of the displacement",
    "smooth_damping": "a smooth law of the velocity",
}
"""What has no name."""


def effect_name(key: str) -> str:
    """A catalogue key in words; what is in words already stays.

    Example:
        >>> effect_name("bouc_wen_hysteresis"), effect_name("input_delay"), effect_name("viscous damping")
        ('Bouc-Wen hysteresis', 'input delay', 'viscous damping')
    """
    if key in _LAWS_OF_UNKNOWN_FORM:
        return _LAWS_OF_UNKNOWN_FORM[key]
    words = [_NAMES_KEPT.get(word, word) for word in key.split("_") if word]
    return " ".join(words).replace("Bouc Wen", "Bouc-Wen")


def effects_at(effects: Sequence[tuple[str, str]]) -> str:
    """Effects, each with its place.

    Example:
        >>> effects_at([("coulomb_friction", "element_1"), ("input_delay", "force")])
        'Coulomb friction at element_1 and input delay at force'
    """
    return " and ".join(f"{effect_name(key)} at {where}" for key, where in effects)


def one_of(keys: Sequence[str]) -> str:
    """Names of which one is meant.

    Example:
        >>> one_of(["quadratic_drag", "viscous damping"]), one_of(["a_b", "c", "d"])
        ('quadratic drag or viscous damping', 'a b, c or d')
    """
    names = [effect_name(key) for key in keys]
    return " or ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} or {names[-1]}"


def composed_unit(dimension: tuple[int, int, int], *, force_unit: str, length_unit: str) -> str:
    """The unit force^a length^b s^c in plain text.

    Args:
        dimension: Powers (a, b, c).
        force_unit: Unit of the force, or of the channel.
        length_unit: Unit of the displacement.

    Example:
        >>> composed_unit((1, -3, 0), force_unit="N", length_unit="m")
        'N/m^3'
        >>> composed_unit((1, -2, 2), force_unit="N m", length_unit="rad")
        'N m s^2/rad^2'
        >>> composed_unit((1, -1, 0), force_unit="m/s^2", length_unit="m"), composed_unit((0, 0, -1),
        ...     force_unit="N", length_unit="m")
        ('(m/s^2)/m', 'Hz')
    """
    if dimension == (0, 0, -1):
        return "Hz"
    factors = [
        (unit, power) for unit, power in zip((force_unit, length_unit, "s"), dimension, strict=True) if power and unit
    ]
    above = [_power(unit, power, alone=len(factors) == 1) for unit, power in factors if power > 0]
    below = [_power(unit, -power, alone=False) for unit, power in factors if power < 0]
    if not below:
        return " ".join(above)
    under = below[0] if len(below) == 1 and " " not in below[0] else f"({' '.join(below)})"
    return f"{' '.join(above) or '1'}/{under}"


def parameter_units(plant: Plant, effect: Effect, where: str) -> tuple[str, ...]:
    """The unit of each parameter of an effect at a place of a plant; "" for a pure number or an unknown unit.

    Raises:
        KeyError: There is no such port.
    """
    if isinstance(effect, ForceEffect):
        port = plant.port(where)
        force, length = port.force_unit, port.length_unit
    else:
        names = (*plant.input_names, *plant.output_names)
        units = dict(zip(names, (*plant.input_units, *plant.output_units), strict=True))
        force, length = units[where], ""
    return tuple(composed_unit(kind.dimension, force_unit=force, length_unit=length) for kind in effect.parameters)


def _power(unit: str, power: int, *, alone: bool) -> str:
    """`unit` to a power, in brackets where it would be misread."""
    compound = "/" in unit or (" " in unit and power > 1)
    named = f"({unit})" if compound and not (alone and power == 1) else unit
    return named if power == 1 else f"{named}^{power}"


TOLERANCE = 1e-4
"""Refuse a derivative that is off from its difference by more than this share of the largest entry."""
KINDS = frozenset({"motion", "force", "mass", "flow"})
READABLE = frozenset({"displacement", "velocity", "stiffness"})


def check_effect(effect: Effect) -> None:
    """Try an effect on a random motion.

    Args:
        effect: A force, an input or a sensor effect.

    Raises:
        InvalidDataError: If it lacks a word, names a parameter twice, proposes no usable start, or if a derivative
            disagrees with differences of its value.

    Example:
        >>> from modal.effects.outside_forces import ConstantForce
        >>> check_effect(ConstantForce())
    """
    _check_words(effect)
    try:
        _check_laws(effect)
    except NotImplementedError as missing:
        raise InvalidDataError(
            f"effect {effect.key!r} lacks a method; give `starts`, and `force` (with `advance` where n_memory > 0), "
            "`apply`, or `gain`, `offset` and `by_parameter`"
        ) from missing


def _check_laws(effect: Effect) -> None:
    motion = _random_motion(effect.n_memory)
    values = _check_starts(effect, motion)
    if isinstance(effect, ForceEffect):
        _check_force(effect, values, motion)
    elif isinstance(effect, InputEffect):
        _check_input(effect, values, motion.displacement)
    elif isinstance(effect, SensorEffect):
        _check_sensor(effect, values, motion)
    else:
        raise InvalidDataError(f"effect {effect.key!r} is neither a ForceEffect, an InputEffect nor a SensorEffect")


def _check_words(effect: Effect) -> None:
    title = type(effect).__name__
    for word in ("key", "law", "family", "signature", "reference"):
        text = getattr(effect, word, None)
        if not isinstance(text, str) or not text.strip():
            raise InvalidDataError(f"effect {title} has no {word}; give it as a class attribute of type str")
    names = [kind.name for kind in getattr(effect, "parameters", ())]
    if not names or len(set(names)) < len(names):
        raise InvalidDataError(f"effect {effect.key!r} needs one or more parameters of different names; it has {names}")
    for kind in effect.parameters:
        if not kind.lower < kind.upper:
            raise InvalidDataError(
                f"parameter {kind.name!r} of effect {effect.key!r} has the bounds {kind.lower:g} and {kind.upper:g}; "
                "the lower must be below the upper"
            )
    if len(getattr(effect, "neutral", ())) != len(names):
        raise InvalidDataError(f"effect {effect.key!r} needs `neutral` with one value for each of {names}")
    if isinstance(effect, ForceEffect) and (not effect.needs <= READABLE or effect.acts_at not in KINDS):
        raise InvalidDataError(
            f"effect {effect.key!r} needs {sorted(effect.needs)} and acts at {effect.acts_at!r}; it may need "
            f"{sorted(READABLE)} and act at one of {sorted(KINDS)}"
        )


def _random_motion(n_memory: int, n_samples: int = 48) -> Motion:
    rng = np.random.default_rng(20260101)
    return Motion(
        displacement=rng.standard_normal(n_samples),
        velocity=2.0 * rng.standard_normal(n_samples),
        time=np.linspace(0.0, 2.0, n_samples),
        memory=0.3 * rng.standard_normal((n_samples, n_memory)),
        displacement_scale=1.0,
        velocity_scale=2.0,
        stiffness=3.0,
        mass=2.0,
        smoothing=0.1,
    )


def _check_starts(effect: Effect, motion: Motion) -> list[float]:
    """Values near the first start, off any bound; they must be usable as they are."""
    dt = float(motion.time[1])
    starts = effect.starts(Situation(motion=motion, residual_frequencies=(1.0, 2.5), dt=dt, longest=2.0))
    lower = np.array([kind.lower for kind in effect.parameters])
    upper = np.array([kind.upper for kind in effect.parameters])
    for start in starts:
        given = np.array(start, dtype=np.float64)
        if given.shape != lower.shape or not np.all((given >= lower) & (given <= upper) & np.isfinite(given)):
            raise InvalidDataError(
                f"effect {effect.key!r} proposes to start from {start}; a start has one finite value within its bounds "
                f"for each of {[kind.name for kind in effect.parameters]}"
            )
    if not starts:
        raise InvalidDataError(f"effect {effect.key!r} proposes no start on a random motion; return one or more")
    moved = 1.1 * np.array(starts[0], dtype=np.float64) + 0.05
    return [float(value) for value in np.clip(moved, lower + 2.0 * DIFFERENCE_STEP, upper - 2.0 * DIFFERENCE_STEP)]


def _difference(value_at: Callable[[float], FloatArray], at: float) -> FloatArray:
    step = DIFFERENCE_STEP * max(abs(at), 1.0)
    return (value_at(at + step) - value_at(at - step)) / (2.0 * step)


def _by_motion(value_of: Callable[[Motion], FloatArray], motion: Motion, moved: str | int) -> FloatArray:
    """Difference by the displacement, the velocity, or the state of the effect with that index."""
    return _difference(lambda shift: value_of(_shifted(motion, moved, shift)), 0.0)


def _by_value(value_of: Callable[[list[float]], FloatArray], values: list[float], j: int) -> FloatArray:
    return _difference(lambda value: value_of([*values[:j], value, *values[j + 1 :]]), values[j])


def _shifted(motion: Motion, moved: str | int, shift: float) -> Motion:
    if moved == "displacement":
        return replace(motion, displacement=motion.displacement + shift)
    if moved == "velocity":
        return replace(motion, velocity=motion.velocity + shift)
    return replace(motion, memory=motion.memory + shift * (np.arange(motion.memory.shape[1]) == moved))


def _compare(effect: Effect, what: str, derivative: FloatArray, difference: FloatArray) -> None:
    if derivative.shape != difference.shape or not np.all(np.isfinite(derivative)):
        raise InvalidDataError(
            f"effect {effect.key!r}: {what} must be finite and of shape {difference.shape}; its shape is "
            f"{derivative.shape}"
        )
    worst = float(np.max(np.abs(derivative - difference), initial=0.0))
    size = float(np.max(np.abs(difference), initial=0.0))
    if not worst <= TOLERANCE * size + TOLERANCE**2:
        raise InvalidDataError(
            f"effect {effect.key!r}: {what} is off by {worst:.3g} from central differences of the value, whose largest "
            f"entry is {size:.3g}; correct the derivative"
        )


def _check_values(
    effect: Effect, values: list[float], value_of: Callable[[list[float]], FloatArray], by_parameter: FloatArray
) -> None:
    for j, kind in enumerate(effect.parameters):
        _compare(effect, f"by_parameter of {kind.name!r}", by_parameter[..., j], _by_value(value_of, values, j))


def _check_force(effect: ForceEffect, values: list[float], motion: Motion) -> None:
    def value_of(moved: Motion) -> FloatArray:
        return effect.force(values, moved).value

    force = effect.force(values, motion)
    _compare(effect, "by_displacement", force.by_displacement, _by_motion(value_of, motion, "displacement"))
    _compare(effect, "by_velocity", force.by_velocity, _by_motion(value_of, motion, "velocity"))
    for m in range(effect.n_memory):
        _compare(effect, "by_memory", force.by_memory[:, m], _by_motion(value_of, motion, m))
    _check_values(effect, values, lambda changed: effect.force(changed, motion).value, force.by_parameter)
    amplitudes = [j for j, kind in enumerate(effect.parameters) if kind.role == "amplitude"]
    doubled = [2.0 * value if j in amplitudes else value for j, value in enumerate(values)]
    columns = effect.force(doubled, motion).by_parameter[:, amplitudes]
    _compare(effect, "by_parameter at twice the amplitudes", columns, force.by_parameter[:, amplitudes])
    if np.any(np.abs(effect.force(list(effect.neutral), motion).value) > 0.0):
        raise InvalidDataError(f"effect {effect.key!r} gives a force at its neutral values {effect.neutral}")
    if effect.n_memory:
        _check_memory(effect, values, motion)


def _check_memory(effect: ForceEffect | SensorEffect, values: list[float], motion: Motion) -> None:
    dt = 0.02
    rng = np.random.default_rng(20260102)
    after = replace(
        motion,
        displacement=motion.displacement + 0.05 * rng.standard_normal(motion.time.size),
        velocity=motion.velocity + 0.5 * rng.standard_normal(motion.time.size),
        time=motion.time + dt,
    )

    def from_before(moved: Motion) -> FloatArray:
        return effect.advance(values, moved, after, dt).value

    def from_after(moved: Motion) -> FloatArray:
        return effect.advance(values, motion, moved, dt).value

    memory = effect.advance(values, motion, after, dt)
    for what, derivative, difference in (
        ("by_displacement_before", memory.by_displacement_before, _by_motion(from_before, motion, "displacement")),
        ("by_velocity_before", memory.by_velocity_before, _by_motion(from_before, motion, "velocity")),
        ("by_displacement_after", memory.by_displacement_after, _by_motion(from_after, after, "displacement")),
        ("by_velocity_after", memory.by_velocity_after, _by_motion(from_after, after, "velocity")),
        *(
            (f"by_memory {m}", memory.by_memory[:, :, m], _by_motion(from_before, motion, m))
            for m in range(effect.n_memory)
        ),
    ):
        _compare(effect, f"{what} of `advance`", derivative, difference)
    _check_values(effect, values, lambda changed: effect.advance(changed, motion, after, dt).value, memory.by_parameter)


def _check_input(effect: InputEffect, values: list[float], drive: FloatArray) -> None:
    end_before, dt = np.roll(drive, -1), 0.02

    def changed(at: list[float]) -> FloatArray:
        return np.stack([*effect.apply(at, drive, end_before, dt), effect.at_samples(at, drive, drive, end_before, dt)])

    start, end = effect.apply(values, drive, end_before, dt)
    sample = effect.at_samples(values, drive, drive, end_before, dt)
    if not all(part.shape == drive.shape and np.all(np.isfinite(part)) for part in (start, end, sample)):
        raise InvalidDataError(f"effect {effect.key!r} must return a finite start and end for each step it was given")
    same, _ = effect.apply(effect.neutral, drive, drive, 0.02)
    if not np.allclose(same, drive):
        raise InvalidDataError(f"effect {effect.key!r} changes the input at its neutral values {effect.neutral}")
    by_parameter = np.stack(effect.by_parameter(values, drive, drive, end_before, dt))
    _check_values(effect, values, changed, np.moveaxis(by_parameter, 1, -1))


def _check_sensor(effect: SensorEffect, values: list[float], motion: Motion) -> None:
    output, time = motion.displacement, motion.time
    if effect.n_memory:
        _check_memory(effect, values, motion)
        return

    def sensed(at: list[float]) -> FloatArray:
        return np.asarray(effect.gain(at) * output + effect.offset(at, time))

    _check_values(effect, values, sensed, effect.by_parameter(values, output, time))
    if not np.allclose(sensed(list(effect.neutral)), output):
        raise InvalidDataError(f"effect {effect.key!r} changes the output at its neutral values {effect.neutral}")
