"""An effect of the catalogue with its values, at its place in a model."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect, ForceEffect, InputEffect, ParameterKind, SensorEffect
from modal.simulation.plant import Plant
from okid.arrays import real_number
from okid.display import Displayed
from okid.errors import InvalidDataError


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PlacedEffect(Displayed):
    """An effect at a place of a model.

    Attributes:
        effect: Key in the catalogue.
        where: Name of the port, of the input or of the output.
        names: Names of the parameters, in the order of the effect.
        values: Their values, in the units that the place gives; of a parameter that each record has its own value of,
            the mean.
        deviations: Standard deviations of the values; NaN where they are not known.
        local_values: One tuple a parameter: its value in each record, empty where all records share one.
        direction: Components of the force over the columns of its port, the first of them 1; () for the first column
            alone.

    Example:
        >>> found = PlacedEffect(effect="cubic_stiffness", where="element_1", names=("k3",), values=(2e5,))
        >>> found.value("k3"), found.deviations
        (200000.0, (nan,))
    """

    effect: str
    where: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    deviations: tuple[float, ...] = ()
    local_values: tuple[tuple[float, ...], ...] = ()
    direction: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        if not self.deviations:
            set_(self, "deviations", (math.nan,) * len(self.names))
        if not self.local_values:
            set_(self, "local_values", ((),) * len(self.names))
        counts = [len(self.values), len(self.deviations), len(self.local_values)]
        if set(counts) != {len(self.names)}:
            raise InvalidDataError(
                f"{self.effect} has {len(self.names)} parameters, but {counts[0]} values, {counts[1]} deviations and "
                f"{counts[2]} tuples of local values were given; give one of each a parameter."
            )

    def value(self, name: str) -> float:
        """The value of the parameter of that name.

        Raises:
            KeyError: If there is none.
        """
        if name not in self.names:
            raise KeyError(name)
        return self.values[self.names.index(name)]


def law_of(one: PlacedEffect, catalogue: Mapping[str, Effect]) -> Effect:
    """The law of an effect at its place, with as many parameters as it has values.

    Raises:
        InvalidDataError: It is not in the catalogue.
    """
    if one.effect not in catalogue:
        raise InvalidDataError(
            f"there is no effect {one.effect!r} in the catalogue; pass catalogue=modal.discrepancy.register(effect) "
            "with that effect."
        )
    return catalogue[one.effect].with_values(dict(zip(one.names, one.values, strict=True)))


def placed_effect(
    plant: Plant,
    effect: str | Effect,
    where: str,
    values: Mapping[str, float | Sequence[float]],
    *,
    deviations: Mapping[str, float] | None = None,
    direction: Sequence[float] = (),
) -> PlacedEffect:
    """An effect of the catalogue at a place of a plant, every name and number checked.

    Args:
        plant: Whose places, inputs and outputs there are.
        effect: Key in the catalogue, or an effect that is not in it.
        where: Name of a port, an input or an output, as the effect asks for.
        values: All parameters of the effect by name; several numbers, one a record, where the parameter is local.
        deviations: Standard deviations by name, where they are known.
        direction: Components of the force over the columns of its port, where the port has several.

    Raises:
        InvalidDataError: No such effect or place, or a parameter that is missing, unknown or out of its bounds.
    """
    if not isinstance(effect, Effect) and effect not in CATALOGUE:
        raise InvalidDataError(f"there is no effect {effect!r} in the catalogue; it holds {', '.join(CATALOGUE)}.")
    kind = (effect if isinstance(effect, Effect) else CATALOGUE[effect]).with_values(values)
    possible = possible_places(plant, kind)
    if where not in possible:
        everywhere = [port.name for port in plant.ports] + [*plant.input_names, *plant.output_names]
        why = f"{kind.key} cannot act at {where!r}" if where in everywhere else f"there is no place {where!r}"
        raise InvalidDataError(f"{why}; {kind.key} can act at {', '.join(possible) or 'no place of this model'}.")
    known = {parameter.name: parameter for parameter in kind.parameters}
    _check_names(kind.key, known, values)
    _check_names(kind.key, known, {**dict.fromkeys(known), **(deviations or {})})
    of_records = {name: _local_values(kind.key, known[name], values[name]) for name in known}
    means = {
        name: _checked(kind.key, known[name], sum(own) / len(own) if own else values[name])
        for name, own in of_records.items()
    }
    return PlacedEffect(
        effect=kind.key,
        where=where,
        names=tuple(known),
        values=tuple(means.values()),
        deviations=tuple(real_number((deviations or {}).get(name)) for name in known),
        local_values=tuple(of_records.values()),
        direction=_direction(plant, kind, where, direction),
    )


def _direction(plant: Plant, effect: Effect, where: str, direction: Sequence[float]) -> tuple[float, ...]:
    components = tuple(real_number(component) for component in direction)
    n_columns = len(plant.port(where).columns) if isinstance(effect, ForceEffect) else 0
    finite = all(math.isfinite(one) for one in components)
    if components and (len(components) != n_columns or not finite or components[0] != 1):
        raise InvalidDataError(
            f"the direction of a force at {where} has {n_columns} finite components of which the first is 1, but "
            f"{direction!r} was given; leave it out for a force that acts at the place alone."
        )
    return components


def possible_places(plant: Plant, effect: Effect) -> tuple[str, ...]:
    """The names of the places of a plant where an effect can act."""
    if isinstance(effect, InputEffect):
        return plant.input_names
    if isinstance(effect, SensorEffect):
        return plant.output_names
    if isinstance(effect, ForceEffect):
        fit = [port for port in plant.ports if effect.acts_at in port.accepts]
        return tuple(port.name for port in fit if all(getattr(port, name) is not None for name in effect.needs))
    return ()


def _check_names(effect: str, known: Mapping[str, ParameterKind], given: Mapping[str, Any]) -> None:
    missing, unknown = [name for name in known if name not in given], [name for name in given if name not in known]
    if missing or unknown:
        what = f"lacks {', '.join(missing)}" if missing else f"has no parameter {', '.join(unknown)}"
        meanings = "; ".join(f"{name}: {kind.meaning}" for name, kind in known.items())
        raise InvalidDataError(f"{effect} {what}; its parameters are {meanings}.")


def _local_values(effect: str, kind: ParameterKind, value: Any) -> tuple[float, ...]:
    """The value in each record; empty where one number stands for all."""
    if isinstance(value, str) or not isinstance(value, Iterable) or getattr(value, "ndim", 1) == 0:
        return ()
    if not kind.local:
        raise InvalidDataError(
            f"{kind.name} of {effect} is one number for all records, but {value!r} was given; pass one number."
        )
    return tuple(_checked(effect, kind, one) for one in value)


def _checked(effect: str, kind: ParameterKind, value: Any) -> float:
    number = real_number(value)
    if math.isnan(number) or (math.isinf(number) and kind.role == "amplitude"):
        raise InvalidDataError(f"{kind.name} of {effect} ({kind.meaning}) must be a number, but is {value!r}.")
    if not kind.lower <= number <= kind.upper:
        upper = "" if math.isinf(kind.upper) else f" and at most {kind.upper:g}"
        raise InvalidDataError(
            f"{kind.name} of {effect} ({kind.meaning}) must be at least {kind.lower:g}{upper}, but is {number:g}."
        )
    return number
