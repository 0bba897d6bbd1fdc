"""A plant without dynamics: motion is imposed, a force is measured (a damper or a joint in a testing machine).

    y = D u + force

Inputs are displacements, or displacements with their velocities; each displacement is a port, and a force law of the
motion there adds to the measured force. Uncertain are the entries of D: a linear stiffness and a linear damping.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

from modal.effects.effect_units import composed_unit
from modal.simulation.plant import LinearParameter, Plant, Port, plant_matrices
from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["motion_inputs", "static_plant", "static_plant_of_records"]

_ALIKE = 0.95
"""Share of an input's mean square that the integral of its velocity must explain."""

_RELATIVE = 0.5
"""Relative standard deviation of the prior on an entry of D."""


def motion_inputs(records: Sequence[Record]) -> tuple[tuple[int, int | None], ...]:
    """Which inputs are motions, and which input is the velocity of each.

    Input j is the velocity of input i when its integral, up to a constant and a drift, explains more than 95 % of the
    mean square of input i, with a factor between 0.8 and 1.25, in every record.

    Args:
        records: Of the same channels.

    Returns:
        Index of each input that is no other one's velocity, with the index of its velocity, None where there is none.

    Example:
        >>> t = np.arange(200) * 0.01
        >>> record = Record(np.stack([np.sin(6 * t), 6 * np.cos(6 * t)], axis=1), 3 * np.sin(6 * t), 0.01)
        >>> motion_inputs([record])
        ((0, 1),)
    """
    n_inputs = records[0].n_inputs if records else 0
    velocity: dict[int, int] = {}
    for i, j in product(range(n_inputs), repeat=2):
        free = i not in velocity and i not in velocity.values() and j not in velocity and j not in velocity.values()
        if i != j and free and all(_is_velocity(record, i, j) for record in records):
            velocity[i] = j
    return tuple((i, velocity.get(i)) for i in range(n_inputs) if i not in velocity.values())


def _is_velocity(record: Record, displacement: int, velocity: int) -> bool:
    """Integrals are compared, not derivatives: noise on a displacement is large in its derivative."""
    x, v = record.inputs[:, displacement], record.inputs[:, velocity]
    if np.isnan(x).any() or np.isnan(v).any() or len(x) < 8:
        return False
    integral = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2)]) * record.dt
    line = np.stack([np.ones(len(x)), np.linspace(-1.0, 1.0, len(x))], axis=1)
    left = [signal - line @ np.linalg.lstsq(line, signal, rcond=None)[0] for signal in (x, integral)]
    power = float(left[1] @ left[1])
    if power == 0 or not left[0].any():
        return False
    factor = float(left[0] @ left[1]) / power
    rest = left[0] - factor * left[1]
    return 0.8 < factor < 1.25 and float(rest @ rest) < (1 - _ALIKE) * float(left[0] @ left[0])


def static_plant(
    D: FloatArray,
    *,
    records: Sequence[Record],
    names: tuple[tuple[str, ...], tuple[str, ...]],
    units: tuple[tuple[str, ...], tuple[str, ...]],
) -> Plant:
    """The plant of imposed motion and measured force.

    The prior on an entry of D has a standard deviation of half its size and, where records are given, at least as much
    as would make up the whole of the output; without records a zero entry stays zero.

    Args:
        D: (n_outputs, n_inputs) stiffness or damping by which each input gives each force.
        records: What tells which input is the velocity of which; may be none, then each input is a displacement.
        names: Of inputs and outputs.
        units: Of inputs and outputs.
    """
    n_outputs, n_inputs = D.shape
    system = [np.hstack([D, np.eye(n_outputs)])]
    parameters = []
    sizes = _sizes(D, records)
    for o, i in product(range(n_outputs), range(n_inputs)):
        deviation = float(sizes[o, i])
        if deviation > 0:
            known = units[1][o] and units[0][i]
            unit = composed_unit((1, -1, 0), force_unit=units[1][o], length_unit=units[0][i]) if known else ""
            parameters.append(
                LinearParameter(
                    name=f"{names[1][o]} by {names[0][i]}",
                    unit=unit,
                    nominal=float(D[o, i]),
                    deviation=deviation,
                    lower=float(D[o, i]) - 10 * deviation,
                    upper=float(D[o, i]) + 10 * deviation,
                )
            )
            slope = np.zeros_like(system[0])
            slope[o, i] = 1.0
            system[0][o, i] = 0.0
            system.append(slope)
    motions = motion_inputs(records) if records else tuple((i, None) for i in range(n_inputs))
    return Plant(
        system=np.stack(system),
        n_states=0,
        n_inputs=n_inputs,
        parameters=tuple(parameters),
        ports=tuple(_port(names, units, motion, output) for motion in motions for output in range(n_outputs)),
        input_names=names[0],
        output_names=names[1],
        input_units=units[0],
        output_units=units[1],
    )


def static_plant_of_records(plant: Plant, records: Sequence[Record]) -> Plant:
    """A plant without states, made anew with what the records tell; any other plant as it is.

    A model file holds D alone: which input is the velocity of which, and how large an entry of D may be, the records
    say.

    Args:
        plant: Of a model that was made without records.
        records: To fit the model to.
    """
    if plant.n_states:
        return plant
    D = plant_matrices(plant, plant.nominal).D
    names, units = (plant.input_names, plant.output_names), (plant.input_units, plant.output_units)
    return static_plant(D, records=records, names=names, units=units)


def _sizes(D: FloatArray, records: Sequence[Record]) -> FloatArray:
    sizes = _RELATIVE * np.abs(D)
    for record in records:
        moved, read = np.nanstd(record.inputs, axis=0), np.nanstd(record.outputs, axis=0)
        whole = np.divide(read[:, None], moved, out=np.zeros_like(D), where=moved > 0)
        sizes = np.maximum(sizes, whole)
    return sizes


def _port(
    names: tuple[tuple[str, ...], tuple[str, ...]],
    units: tuple[tuple[str, ...], tuple[str, ...]],
    motion: tuple[int, int | None],
    output: int,
) -> Port:
    rows = np.eye(len(names[0]))
    displacement, velocity = motion
    name = names[0][displacement]
    return Port(
        name=name if len(names[1]) == 1 else f"{name} to {names[1][output]}",
        displacement=rows[displacement],
        velocity=None if velocity is None else rows[velocity],
        columns=(output,),
        length_unit=units[0][displacement] or "m",
        force_unit=units[1][output] or "N",
        accepts=frozenset({"motion", "force"}),
    )
