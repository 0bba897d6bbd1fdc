"""An effect of the catalogue with its values, at its place in a model, and the equations of motion in plain text."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from modal.effects.catalogue import CATALOGUE, parameter_units
from modal.effects.effect import Effect, ForceEffect, InputEffect, ParameterKind, SensorEffect
from modal.simulation.plant import Plant
from modal.structure.structural_plant import relative_vector, structural_plant
from okid.arrays import FloatArray, real_number
from okid.display import Displayed
from okid.errors import InvalidDataError

if TYPE_CHECKING:
    from modal.structure.given import PlantModel
    from modal.structure.structural_model import StructuralModel


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


def equations_of_structure(model: "StructuralModel", *, catalogue: Mapping[str, Effect] = CATALOGUE) -> str:
    """One line a degree of freedom, one an output, then each effect with its law and its numbers.

    Example:
        >>> from modal.structure.structural_model import StructuralModel
        >>> model = StructuralModel.chain([2.0], [800.0], [1.5], force_dofs=0, sensor_dofs=0, output_names=["tip"])
        >>> print(equations_of_structure(model.with_effect("cubic_stiffness", "element_0", k3=2e5)))
        Equations of motion; x0 [m], forces [N], ' is d/dt [1/s]
          DOF 0: 2 x0'' + 1.5 x0' + 800 x0 + f1 = input_0
          tip [m] = x0
          f1 [N]: cubic_stiffness at element_0, f = k3 d^3; d = x0, v = d'
            k3 = 200000 N/m^3 (cubic stiffness)
    """
    plant = structural_plant(model)
    positions = [f"x{i}" for i in range(model.n_dofs)]
    places = {element.name: element.ends for element in model.elements} | {
        f"dof_{i}": (i,) for i in range(model.n_dofs)
    }
    forces = [one for one in model.effects if isinstance(law_of(one, catalogue), ForceEffect)]
    joins = np.array([relative_vector(places[one.where], model.n_dofs) for one in forces]).reshape(-1, model.n_dofs)
    labels = [f"f{number + 1}" for number in range(len(forces))]
    units = f"{', '.join(positions)} [{model.length_unit}], forces [{model.force_unit}], ' is d/dt [1/s]"
    lines = [f"Equations of motion; {units}"]
    for i in range(model.n_dofs):
        left = linear_sum(
            [*model.mass[i], *model.damping[i], *model.stiffness[i], *joins[:, i]],
            [*(f"{x}''" for x in positions), *(f"{x}'" for x in positions), *positions, *labels],
        )
        into = model.force_map[i] - (0.0 if model.base_motion is None else model.mass[i] @ model.base_motion)
        lines.append(f"  DOF {i}: {left} = {linear_sum(into, model.input_names)}")
    for output, (name, unit) in enumerate(zip(model.output_names, model.output_units, strict=True)):
        lines.append(f"  {name} [{unit}] = {_reading(model, output, positions)}")
    motions = {}
    for one, join in zip(forces, joins, strict=True):
        has = plant.port(one.where).displacement is not None
        motions[one.where] = linear_sum(join, positions if has else [f"{x}'" for x in positions])
    return "\n".join(lines + describe_effects(plant, model.effects, motions=motions, catalogue=catalogue))


def equations_of_plant(model: "PlantModel", *, catalogue: Mapping[str, Effect] = CATALOGUE) -> str:
    """One line a state, one an output, then each effect with its law and its numbers.

    Example:
        >>> import control
        >>> from modal.structure.given import PlantModel
        >>> shaft = PlantModel.from_state_space(control.ss([[-5.0]], [[4.0]], [[1.0]], [[0.0]]), sensor_kind="velocity",
        ...     output_names=["speed"], output_units=["rad/s"])
        >>> print(equations_of_plant(shaft.with_effect("quadratic_drag", "speed", c2=0.01)))
        Equations of state; ' is d/dt [1/s]
          x0' = -5 x0 + 2 input_0 - 0.5 f1
          speed [rad/s] = 2 x0
          f1 [rad/s^2]: quadratic_drag at speed, f = c2 v |v|; v = 2 x0
            c2 = 0.01 (rad/s^2) s^2/rad^2 (drag coefficient)
    """
    plant, matrices = model.plant, model.matrices
    states = [f"x{i}" for i in range(plant.n_states)]
    forces = [one for one in model.effects if isinstance(law_of(one, catalogue), ForceEffect)]
    names = [*states, *plant.input_names, *(f"f{number + 1}" for number in range(len(forces)))]
    weights = np.zeros((plant.n_forces, len(forces)))
    for number, one in enumerate(forces):
        columns = plant.port(one.where).columns
        weights[list(columns), number] = one.direction or (1.0, *(0.0,) * (len(columns) - 1))
    lines = ["Equations of state; ' is d/dt [1/s]"]
    rates = np.hstack([matrices.A, matrices.B, matrices.E @ weights])
    lines += [f"  {state}' = {linear_sum(row, names)}" for state, row in zip(states, rates, strict=True)]
    readings = np.hstack([matrices.C, matrices.D, matrices.G @ weights])
    for name, unit, row in zip(plant.output_names, plant.output_units, readings, strict=True):
        lines.append(f"  {name} [{unit}] = {linear_sum(row, names)}")
    motions = {}
    for port in plant.ports:
        row = port.velocity if port.displacement is None else port.displacement
        motions[port.name] = "0" if row is None else linear_sum(row, names[: len(row)])
    return "\n".join(lines + describe_effects(plant, model.effects, motions=motions, catalogue=catalogue))


def _reading(model: "StructuralModel", output: int, positions: list[str]) -> str:
    kind = model.sensor_kind[output]
    primes = {"displacement": "", "velocity": "'", "acceleration": "''"}[kind]
    coefficients = list(model.sensor_map[output])
    names = [f"{x}{primes}" for x in positions]
    if kind == "acceleration" and model.base_motion is not None:
        coefficients += list(model.sensor_map[output] @ model.base_motion)
        names += model.input_names
    return linear_sum(coefficients, names)


def describe_effects(
    plant: Plant,
    effects: Sequence[PlacedEffect],
    *,
    motions: Mapping[str, str],
    catalogue: Mapping[str, Effect],
) -> list[str]:
    """Two or more lines an effect: its law at its place, then each parameter with its unit.

    Args:
        plant: What gives the units.
        effects: The effects.
        motions: What d is (v at a place that has no d) at each place of a force, in words.
        catalogue: What holds the effects.
    """
    lines = []
    number = 0
    for one in effects:
        effect = law_of(one, catalogue)
        if isinstance(effect, ForceEffect):
            number += 1
            port = plant.port(one.where)
            motion = f"v = {motions[one.where]}" if port.displacement is None else f"d = {motions[one.where]}, v = d'"
            lines.append(f"  f{number} [{port.force_unit}]: {one.effect} at {one.where}, {effect.law}; {motion}")
        else:
            lines.append(f"  {one.where}: {one.effect}, {effect.law}")
        units = parameter_units(plant, effect, one.where)
        for index, (kind, unit) in enumerate(zip(effect.parameters, units, strict=True)):
            lines.append(f"    {kind.name} = {_value(one, index)} {unit}".rstrip() + f" ({kind.meaning})")
    return lines


def _value(one: PlacedEffect, index: int) -> str:
    if one.local_values[index]:
        return f"{', '.join(f'{value:.6g}' for value in one.local_values[index])} (one a record)"
    deviation = one.deviations[index]
    return f"{one.values[index]:.6g}" + ("" if math.isnan(deviation) else f" +- {deviation:.2g}")


def linear_sum(coefficients: Sequence[float] | FloatArray, names: Sequence[str]) -> str:
    """A sum in plain text, zero terms left out.

    Example:
        >>> linear_sum([1.0, 0.0, -2.5], ["a", "b", "c"]), linear_sum([0.0], ["a"])
        ('a - 2.5 c', '0')
    """
    terms = []
    for coefficient, name in zip(coefficients, names, strict=True):
        if coefficient != 0:
            size = "" if abs(coefficient) == 1 else f"{abs(coefficient):.6g} "
            sign = "-" if coefficient < 0 else "+"
            terms.append(f"{sign} {size}{name}")
    text = " ".join(terms) or "0"
    return text.removeprefix("+ ") if text.startswith("+") else text.replace("- ", "-", 1)
