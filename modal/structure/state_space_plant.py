"""A general linear state space as a plant with ports.

A structure measured by displacement sensors has displacements d = C x; velocity sensors read the derivative of
C A^-1 x, accelerometers the second derivative of C A^-2 x. A force cannot move a displacement at once, so its direction
e in the state space is one with (displacement rows) e = 0: the null space of these rows. Half of the states of a
structure at most are displacements; the other half is what a force can drive.

Places are the outputs, and the differences of two of them. Where the matrices show that the plant is a structure with
symmetric M, C, K (`modal.structure.reciprocity`) and all its modes are measured, a force at a place is known to act
along the sensor. Elsewhere a port has several columns: the first gives the displacement there an acceleration of -1
(the force opposes motion), the others add what a force at that place may do elsewhere and give it none. Forces are
counted per effective mass at the place, in length unit / s^2.

Where a displacement does not exist:
    - a plant whose displacement answers to an input at once (a level in a tank, a temperature: C B is not small) is of
      first order: its port takes flows in any direction of the states; its displacement row is the output itself.
      Where no pole oscillates a displacement may also be the level of one of several tanks: further ports, "output_0
      level" and "output_0 upstream", take flows; where its unit is no length either, the first port takes constant and
      periodic forces only.
    - velocity sensors of a shaft that nothing holds, or of a mass that only a damper holds: a constant force gives a
      constant velocity, not none. The port has a velocity only, and forces act in any direction of the states.
    - an integrator needs its displacement measured: an acceleration does not show it.

A level at the end of a cascade answers to the inflow as a displacement answers to a force: not at once. So where no
pole oscillates an output may be either. What flows out of the last tank is p h with the tank's rate p, and what flows
in comes from the tank before it, whose level is therefore known without a sensor:

    h' = p (h_before - h),    h_before = h + h' / p

counted so that both levels are the same at rest. Which tank has which rate does not show in the linear model (the
cascade in the other order has the same response), so each rate that a pole shows gives a place.

Without dynamics, motion is imposed and a force is measured (a damper or a joint in a testing machine):

    y = D u + force

Inputs are displacements, or displacements with their velocities; each displacement is a port, and a force law of the
motion there adds to the measured force. Uncertain are the entries of D: a linear stiffness and a linear damping.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Literal

import numpy as np
import scipy

from modal.effects.catalogue import composed_unit
from modal.simulation.plant import LinearParameter, Plant, Port, plant_matrices
from modal.structure.continuous_time import ContinuousSystem, continuous_system, in_modal_coordinates
from modal.structure.reciprocity import (
    REACH,
    OutputMotion,
    Structure,
    internal_changes,
    motion_of_outputs,
    reciprocal_structure,
    symmetric_changes,
)
from modal.structure.structural_model import RIGID, SensorKind, matched_names, sensor_kinds, tolerance
from okid.arrays import ROUNDED, FloatArray
from okid.errors import InvalidDataError
from okid.record import InputHold, Record, labels

_SWINGS = 0.1
"""Let a pole oscillate above this imaginary part, as a share of its real part; poles of equal tanks, identified from
noisy data, come out as a pair with a small one."""

_SAME_RATE = 0.05
"""Take two rates for one below this relative difference."""

_LENGTHS = frozenset({"m", "mm", "cm", "um", "nm", "µm", "km", "in", "ft", "mil", "rad", "mrad", "deg", "°", "rev"})


def is_length(unit: str) -> bool:
    """Whether a unit is one of displacements or angles; one that is not known may be."""
    return unit in _LENGTHS or not unit


def tank_levels(
    system: ContinuousSystem, motions: tuple[OutputMotion, ...], names: tuple[str, ...]
) -> tuple[tuple[str, OutputMotion], ...]:
    """The levels: of each output that may be one, and of the tank before it.

    Args:
        system: Minimal, stable.
        motions: Of its outputs.
        names: Of its outputs.

    Returns:
        Name of each place ("output_0 level", "output_0 upstream", with numbers from the slowest rate on where there
        are several) and what moves there; none where a pole oscillates.
    """
    poles = np.linalg.eigvals(system.A).astype(np.complex128)
    if (np.abs(poles.imag) > _SWINGS * np.abs(poles.real)).any():
        return ()
    found: list[tuple[str, OutputMotion]] = []
    rates = _rates(-poles.real)
    for name, one, row in zip(names, motions, system.C, strict=True):
        if one.nature != "mechanical" or one.displacement is None or one.velocity is None or one.direct.any():
            continue
        level = replace(one, nature="flow", velocity=None, driven=row)
        found.append((f"{name} level", level))
        for number, rate in enumerate(rates, start=1):
            above = one.displacement + one.velocity / rate
            tail = "" if len(rates) == 1 else f" {number}"
            found.append((f"{name} upstream{tail}", replace(level, displacement=above, driven=above[: len(system.A)])))
    return tuple(found)


def _rates(decays: FloatArray) -> tuple[float, ...]:
    """The different rates [1/s], rising; an integrator has none."""
    kept: list[float] = []
    for rate in np.sort(decays):
        if rate > 0 and (not kept or rate > (1.0 + _SAME_RATE) * kept[-1]):
            kept.append(float(rate))
    return tuple(kept)


_ACCEPTS = {
    "mechanical": frozenset({"motion", "force", "mass"}),
    "shaft": frozenset({"motion", "force"}),
    "flow": frozenset({"flow", "force"}),
}


def ports_of(
    system: ContinuousSystem,
    motions: tuple[OutputMotion, ...],
    names: tuple[str, ...],
    *,
    forces: FloatArray,
    directions: Literal["along_sensors", "any"],
) -> tuple[tuple[Port, ...], FloatArray, FloatArray]:
    """The ports with their E and G.

    Args:
        system: In real modal form.
        motions: What the outputs show.
        names: Of the outputs.
        forces: (n_states, n_forces) directions of the states in which forces can act; orthonormal, or those of unit
            forces on modes of unit mass, for then the shortest one that moves a place is that along its sensor.
        directions: "along_sensors": a force at a place has that direction; "any": any of them.

    Returns:
        The ports, E (n_states, n_columns) and G (n_outputs, n_columns).
    """
    n_states = len(system.A)
    levels = tank_levels(system, motions, names)
    places = [(name, one, _accepted(one, levels)) for name, one in zip(names, motions, strict=True)]
    for i, j in _pairs(motions):
        # an absorber hangs on one place; between two its force would have nothing to stand on
        places.append((f"{names[i]}-{names[j]}", motions[i].less(motions[j]), _accepted(motions[i], levels) - {"mass"}))
    places += [(name, one, frozenset({"flow"})) for name, one in levels]
    ports: list[Port] = []
    columns: list[FloatArray] = [np.zeros((n_states, 0))]
    n_columns = 0
    for name, motion, accepts in places:
        found = _opposing(np.eye(n_states) if motion.nature == "flow" else forces, motion.driven)
        if found is not None and directions == "along_sensors":
            found = found[:, :1]
        if found is not None:
            columns.append(found)
            ports.append(
                Port(
                    name=name,
                    displacement=motion.displacement,
                    velocity=motion.velocity,
                    columns=tuple(range(n_columns, n_columns + found.shape[1])),
                    stiffness=_static_stiffness(system.A, motion, found[:, 0]),
                    mass=1.0 if motion.nature == "mechanical" else None,
                    length_unit=motion.unit,
                    force_unit=motion.force_unit,
                    accepts=accepts,
                )
            )
            n_columns += found.shape[1]
    entering = np.hstack(columns)
    return tuple(ports), entering, np.array([motion.direct for motion in motions]) @ entering


def _accepted(motion: OutputMotion, levels: tuple[tuple[str, OutputMotion], ...]) -> frozenset[str]:
    """What may act where an output is; where it may be a level and its unit is no length, no mechanical law may."""
    if motion.nature == "mechanical" and levels and not is_length(motion.unit):
        return frozenset({"force"})
    return _ACCEPTS[motion.nature]


def _opposing(free: FloatArray, driven: FloatArray) -> FloatArray | None:
    """Columns of E for a force at a place, None where none of the free directions moves it.

    The first is the shortest direction e with driven e = -1; the others, of its length, have driven e = 0.
    """
    moves = free.T @ driven
    size = float(np.linalg.norm(moves))
    if size <= 1e-8 * float(np.linalg.norm(driven)) or size == 0:
        return None
    first = -moves / size**2
    others = scipy.linalg.null_space(moves[None] / size) / size
    return free @ np.hstack([first[:, None], others])


def _static_stiffness(A: FloatArray, motion: OutputMotion, opposing: FloatArray) -> float | None:
    """Constant force by the displacement that it gives at the place, per effective mass; k / m for one DOF."""
    if motion.nature != "mechanical" or motion.displacement is None or np.linalg.cond(A) > 1 / ROUNDED:
        return None
    compliance = float(motion.displacement[: len(A)] @ np.linalg.solve(A, opposing))
    return 1 / compliance if compliance > 0 else None


def _pairs(motions: tuple[OutputMotion, ...]) -> list[tuple[int, int]]:
    reach = len(motions) if len(motions) <= 12 else 1  # beyond, only neighbours in the order of the outputs
    return [
        (i, j)
        for i, first in enumerate(motions)
        for j, second in enumerate(motions[: i + reach + 1])
        if j > i and (first.nature, first.unit) == (second.nature, second.unit)
    ]


_ALIKE = 0.95
"""Refuse a velocity whose integral explains less than this share of the mean square of an input."""

_RELATIVE = 0.5
"""Let an entry of D be off by this share of its size, as a standard deviation."""


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
                    lower=float(D[o, i]) - REACH * deviation,
                    upper=float(D[o, i]) + REACH * deviation,
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


_RANK = 1e-6
"""Drop singular values of the displacement rows below this share of the largest."""


def state_space_plant(
    system: Any,
    *,
    sensor_kind: SensorKind | Sequence[SensorKind],
    input_hold: InputHold = "zero_order",
    dt: float | None = None,
    records: Sequence[Record] = (),
    input_names: Sequence[str] = (),
    output_names: Sequence[str] = (),
    input_units: Sequence[str] = (),
    output_units: Sequence[str] = (),
    frequency_tolerance: float = 0.1,
    damping_tolerance: float = 0.5,
) -> Plant:
    """The plant of a state space, in real modal form.

    Uncertain are stiffness and damping of a structure, which stay symmetric (`symmetric_changes`); where no symmetry
    shows, all linear forces inside it (`internal_changes`), because a wrong stiffness changes shapes and static
    response as well as poles; of a plant that is no structure the real and imaginary part of each pole.

    The arguments are those of `PlantModel.from_state_space`.

    Raises:
        InvalidDataError: No state space, an unstable one, one that no continuous-time system samples to, or an
            accelerometer on an integrator.
        NumericalError: The conversion to continuous time is not exact.

    Example:
        >>> import control
        >>> mass_on_spring = control.ss([[0.0, 1.0], [-100.0, -0.4]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
        >>> plant = state_space_plant(mass_on_spring, sensor_kind="displacement")
        >>> [port.name for port in plant.ports], [parameter.name for parameter in plant.parameters]
        (['output_0'], ['stiffness of mode 1 (1.592 Hz)', 'damping of mode 1 (1.592 Hz)'])
    """
    continuous = continuous_system(system, input_hold=input_hold, dt=dt)
    n_outputs, n_inputs = continuous.D.shape
    names = matched_names(input_names, output_names, n_inputs=n_inputs, n_outputs=n_outputs)
    units = (
        labels(input_units, n_inputs, "input", named=False),
        labels(output_units, n_outputs, "output", named=False),
    )
    if len(continuous.A) == 0:
        return static_plant(continuous.D, records=records, names=names, units=units)
    _check_stable(continuous.A)
    form = in_modal_coordinates(
        continuous,
        frequency_tolerance=tolerance(frequency_tolerance, name="frequency_tolerance"),
        damping_tolerance=tolerance(damping_tolerance, name="damping_tolerance"),
    )
    kinds = sensor_kinds(sensor_kind, n_outputs)
    modal = form.system
    motions = motion_of_outputs(modal, kinds, units[1])
    free = _free_directions(motions, len(modal.A))
    structure = _structure(modal, motions, free)
    ports, forces, direct = ports_of(
        modal,
        motions,
        names[1],
        forces=free if structure is None else structure.forces,
        directions="any" if structure is None or free.shape[1] > structure.n_modes else "along_sensors",
    )
    constant = np.block([[modal.A, modal.B, forces], [modal.C, modal.D, direct]])
    n_states = len(modal.A)
    if structure is None:
        changes = internal_changes(modal.A, free, motions, tolerance=frequency_tolerance)
    else:
        changes = symmetric_changes(
            modal.A, structure, motions, frequency_tolerance=frequency_tolerance, damping_tolerance=damping_tolerance
        )
    parameters, found = (form.parameters, form.slopes) if changes is None else changes
    slopes = np.zeros((len(parameters), *constant.shape))
    slopes[:, : found.shape[1], :n_states] = found
    constant -= np.tensordot(np.array([parameter.nominal for parameter in parameters]), slopes, axes=(0, 0))
    return Plant(
        system=np.concatenate([constant[None], slopes]),
        n_states=n_states,
        n_inputs=n_inputs,
        parameters=parameters,
        ports=ports,
        input_names=names[0],
        output_names=names[1],
        input_units=units[0],
        output_units=units[1],
    )


def _check_stable(A: FloatArray) -> None:
    poles = np.linalg.eigvals(A)
    worst = poles[poles.real.argmax()]
    if worst.real > RIGID * np.abs(poles).max():
        raise InvalidDataError(
            f"a model must be stable, but this one has a pole at {worst.real:.4g} {worst.imag:+.4g}i 1/s; leave that "
            "mode out, or close the loop that holds it."
        )


def _structure(system: ContinuousSystem, motions: tuple[OutputMotion, ...], free: FloatArray) -> Structure | None:
    """The structure behind the state space, where all outputs show its motion; what never oscillates may be tanks."""
    rows = [one.displacement[: len(system.A)] for one in motions if one.displacement is not None]
    if len(rows) < len(motions) or any(one.nature != "mechanical" for one in motions):
        return None
    if not np.iscomplex(np.linalg.eigvals(system.A)).any():
        return None
    return reciprocal_structure(system, np.array(rows), free)


def _free_directions(motions: tuple[OutputMotion, ...], n_states: int) -> FloatArray:
    """(n_states, n_free) orthonormal directions that leave every measured displacement where it is."""
    rows = [
        one.displacement[:n_states] for one in motions if one.nature == "mechanical" and one.displacement is not None
    ]
    if not rows:
        return np.eye(n_states)
    scaled = np.array([row / np.linalg.norm(row) for row in rows if row.any()]).reshape(-1, n_states)
    _, sizes, right = np.linalg.svd(scaled)
    rank = min(int((sizes > _RANK * sizes.max(initial=0.0)).sum()), n_states // 2)
    return np.ascontiguousarray(right[rank:].T)
