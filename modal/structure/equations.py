"""The equations of motion of a model with numbers and units, in plain text."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from modal.effects.catalogue import CATALOGUE, parameter_units
from modal.effects.effect import Effect, ForceEffect
from modal.simulation.plant import Plant
from modal.structure.placed import PlacedEffect, law_of
from modal.structure.structural_plant import relative_vector, structural_plant
from okid.arrays import FloatArray

if TYPE_CHECKING:
    from modal.structure.given import PlantModel
    from modal.structure.structural_model import StructuralModel


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
