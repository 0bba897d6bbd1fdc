"""How the outputs depend on everything unknown: further right-hand sides of the trajectory's own recursion.

The derivative of the trajectory by any unknown obeys the linearised recursion with the unknown's own forcing, so the
exact Jacobian of a free run costs one more solve. Unknowns of each record (initial state, phases) are solved together
for all records, whose recursions do not touch, and split afterwards.

What a parameter of an effect at an input adds to each step and to the outputs, the trajectory held.
"""

from dataclasses import dataclass, replace

import numpy as np

from modal.simulation.assembly import Assembly, Unknowns, drive_inputs, per_time
from modal.simulation.drive import Drive
from modal.simulation.linearisation import Linearisation, linearise
from modal.simulation.plant import Port
from modal.simulation.scheme import Scheme, solve_band
from modal.simulation.trajectory import Trajectory
from okid.arrays import TINY, FloatArray

__all__ = ["Sensitivity", "Source", "force_response", "input_forcing", "respond", "sensitivity"]


def input_forcing(
    assembly: Assembly,
    unknowns: Unknowns,
    drive: Drive,
    trajectory: Trajectory,
    scheme: Scheme,
    *,
    placement: int,
    j: int,
) -> tuple[FloatArray, FloatArray]:
    """What parameter j of the effect at an input does by itself.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        drive: Inputs as recorded.
        trajectory: The simulated trajectory.
        scheme: Matrices of one step.
        placement: Index of the effect.
        j: Index of its parameter.

    Returns:
        (n_times, n) what a unit of it adds to the step that leaves each time, and (n_rows, n_outputs) to the outputs
        before the sensors' effects.
    """
    slopes = _input_slopes(assembly, unknowns, drive, placement, j)
    about, n = trajectory.linearisation, assembly.plant.n_states
    if any(_reads_inputs(assembly.placements[i].force_and_port[1], n) for i in assembly.forces):
        return _through_ports(assembly, unknowns, trajectory, scheme, slopes)
    start, end, sample = slopes
    flow = np.zeros_like(about.states)
    flow[:, :n] = start @ scheme.B0.T + end @ scheme.B1.T
    return flow, sample[drive.rows] @ scheme.D.T


def _reads_inputs(port: Port, n_states: int) -> bool:
    return any(row is not None and bool(row[n_states:].any()) for row in (port.displacement, port.velocity))


def _through_ports(
    assembly: Assembly, unknowns: Unknowns, trajectory: Trajectory, scheme: Scheme, slopes: tuple[FloatArray, ...]
) -> tuple[FloatArray, FloatArray]:
    """What a change of the drive does where it also moves ports, the states held: central differences of the steps."""
    about, drive = trajectory.linearisation, trajectory.drive
    largest = max(float(np.abs(slope).max(initial=0.0)) for slope in slopes)
    size = 1e-6 * max(float(np.abs(drive.sample).max(initial=0.0)), TINY) / max(largest, TINY)
    above, below = (
        linearise(
            assembly,
            unknowns,
            replace(
                drive,
                start=drive.start + step * slopes[0],
                end=drive.end + step * slopes[1],
                sample=drive.sample + step * slopes[2],
            ),
            scheme,
            about.states,
            smoothing=about.smoothing,
        )
        for step in (size, -size)
    )
    flow = np.zeros_like(about.states)
    flow[:-1] = (above.defect - below.defect)[1:] / (2.0 * size)
    return flow, (above.free - below.free) / (2.0 * size)


def _input_slopes(
    assembly: Assembly, unknowns: Unknowns, drive: Drive, placement: int, j: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives of the drive's start, end and sample by a parameter of an effect at an input."""
    position = assembly.inputs.index(placement)
    earlier = replace(assembly, placements=assembly.placements[:placement])
    later = assembly.inputs[position + 1 :]
    driven = drive_inputs(earlier, unknowns, drive)
    channel, effect = assembly.placements[placement].channel, assembly.placements[placement].input_effect
    values = unknowns.values(assembly, placement)
    slopes = np.zeros((3, *drive.start.shape))
    for record in range(drive.n_records):
        at = (drive.times_of(record), channel)
        found = effect.by_parameter(values, driven.sample[at], driven.start[at], driven.end[at], drive.dt)
        for k in range(3):
            slopes[(k, *at)] = found[k][j]
    if any(assembly.placements[i].channel == channel for i in later):
        slopes = _carried(assembly, unknowns, drive, slopes, placement)
    return slopes[0], slopes[1], slopes[2]


def _carried(assembly: Assembly, unknowns: Unknowns, drive: Drive, slopes: FloatArray, placement: int) -> FloatArray:
    """Derivatives of the drive behind one effect, carried through the effects after it by central differences."""
    before = drive_inputs(replace(assembly, placements=assembly.placements[: placement + 1]), unknowns, drive)
    size = 1e-6 * max(float(np.abs(before.sample).max(initial=0.0)), TINY)
    size /= max(float(np.abs(slopes).max(initial=0.0)), TINY)
    found = []
    for sign in (1.0, -1.0):
        moved = replace(
            before,
            start=before.start + sign * size * slopes[0],
            end=before.end + sign * size * slopes[1],
            sample=before.sample + sign * size * slopes[2],
        )
        after = drive_inputs(assembly, unknowns, moved, first=placement + 1)
        found.append(np.stack([after.start, after.end, after.sample]))
    return np.asarray((found[0] - found[1]) / (2.0 * size))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sensitivity:
    """Derivatives along a trajectory.

    Attributes:
        common: (n_common, n_rows, n_outputs) of the outputs by each common unknown.
        local: (n_local, n_rows, n_outputs) by each unknown of the record that the row belongs to.
        common_states: (n_common, n_times, n) of the states.
        local_states: (n_local, n_times, n).
    """

    common: FloatArray
    local: FloatArray
    common_states: FloatArray
    local_states: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Source:
    """What one unknown does by itself, the trajectory held.

    Attributes:
        flow: (n_times, n) what it adds to the step that leaves each time.
        outputs: (n_rows, n_outputs) what it adds to the outputs, before the sensors' effects; None for nothing.
        sensed: (n_rows, n_outputs) what it adds behind them; None for nothing.
        initial: Component of the initial state that it is, or -1.
    """

    flow: FloatArray | None = None
    outputs: FloatArray | None = None
    sensed: FloatArray | None = None
    initial: int = -1


def sensitivity(
    assembly: Assembly,
    unknowns: Unknowns,
    drive: Drive,
    trajectory: Trajectory,
    scheme: Scheme,
    *,
    slopes: tuple[Scheme, ...],
    gain: FloatArray | None = None,
    common: bool = True,
) -> Sensitivity:
    """Derivatives of states and outputs by everything unknown.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        drive: Inputs as recorded.
        trajectory: The simulated trajectory.
        scheme: Matrices of one step.
        slopes: Their derivative by each linear parameter.
        gain: Observer gain of the trajectory, or None.
        common: Whether by the common unknowns as well, or by each record's own only.

    Returns:
        The derivatives.
    """
    about, driven = trajectory.linearisation, trajectory.drive
    shared = [
        _linear(about, driven, scheme, slope, assembly=assembly, unknowns=unknowns, j=j)
        for j, slope in enumerate(slopes)
    ]
    local = [Source(initial=state) for state in range(assembly.plant.n_states)]
    memory = assembly.plant.n_states
    for i, item in enumerate(assembly.placements):
        local += [Source(initial=memory + own) for own in range(item.n_memory)]
        memory += item.n_memory
        local += [_parameter(assembly, unknowns, drive, trajectory, scheme, placement=i, j=j) for j in item.local]
        if common:
            shared += [_parameter(assembly, unknowns, drive, trajectory, scheme, placement=i, j=j) for j in item.common]
            directions = range(1, 1 + item.n_directions)
            shared += [_direction(about, driven, scheme, assembly, placement=i, column=column) for column in directions]
    states, outputs = respond(assembly, unknowns, trajectory, [*shared, *local], gain=gain)
    n = len(shared)
    return Sensitivity(common=outputs[:n], local=outputs[n:], common_states=states[:n], local_states=states[n:])


def respond(
    assembly: Assembly,
    unknowns: Unknowns,
    trajectory: Trajectory,
    sources: list[Source],
    *,
    gain: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Response of the model, linearised about the trajectory, to several sources.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        trajectory: The trajectory.
        sources: What is added.
        gain: Observer gain of the trajectory, or None.

    Returns:
        States (n_sources, n_times, n) and outputs (n_sources, n_rows, n_outputs).
    """
    about, drive = trajectory.linearisation, trajectory.drive
    n_times, n_all = about.states.shape
    factors = _factors(assembly, unknowns, drive)
    direct = np.zeros((len(sources), len(drive.rows), len(about.outputs.T)))
    led = np.zeros((len(sources), n_times, n_all))
    for position, source in enumerate(sources):
        if source.outputs is not None:
            direct[position] += factors * source.outputs
        if source.sensed is not None:
            direct[position] += source.sensed
        if source.flow is not None:
            led[position] = source.flow
    if gain is not None:
        n = assembly.plant.n_states
        led[:, drive.rows, :n] -= np.where(drive.present, direct, 0.0) @ gain.T
    lasts = np.array(drive.firsts[1:]) - 1
    led[:, lasts] = 0.0
    forcing = np.zeros_like(led)
    forcing[:, 1:] = about.steps.advance(led)[:, :-1]
    for position, source in enumerate(sources):
        if source.initial >= 0:
            forcing[position, list(drive.firsts[:-1]), source.initial] = 1.0
    states = solve_band(trajectory.band, forcing)
    return states, about.sensors.outputs(states) + direct


def force_response(drive: Drive, scheme: Scheme, column: int, force: FloatArray, n_all: int) -> Source:
    """What a force (n_times,) in one column of E does by itself."""
    flow = np.zeros((len(force), n_all))
    n = scheme.Ad.shape[0]
    flow[:, :n] = force[:, None] * scheme.E0[:, column]
    flow[:-1, :n] += force[1:, None] * scheme.E1[:, column]
    return Source(flow=flow, outputs=force[drive.rows, None] * scheme.G[:, column])


def _factors(assembly: Assembly, unknowns: Unknowns, drive: Drive) -> FloatArray:
    factors = np.ones(drive.outputs.shape)
    for i in assembly.sensors:
        item = assembly.placements[i]
        values = [per_time(value, drive) for value in unknowns.values(assembly, i)]
        factors[:, item.channel] *= item.sensor_effect.gain(values)
    return factors


def _linear(
    about: Linearisation,
    drive: Drive,
    scheme: Scheme,
    slope: Scheme,
    *,
    assembly: Assembly,
    unknowns: Unknowns,
    j: int,
) -> Source:
    n = assembly.plant.n_states
    states = about.states[:, :n]
    flow = np.zeros_like(about.states)
    flow[:, :n] = states @ slope.Ad.T + drive.start @ slope.B0.T + drive.end @ slope.B1.T
    outputs = states[drive.rows] @ slope.C.T + drive.sample[drive.rows] @ slope.D.T
    for i, line, heard in zip(assembly.forces, about.lines, about.heard, strict=True):
        effect, port = assembly.placements[i].force_and_port
        columns, direction = list(port.columns), unknowns.directions(assembly, i)
        flow[:, :n] += line.flow(slope.E0[:, columns] @ direction, slope.E1[:, columns] @ direction)
        outputs += heard.value[drive.rows, None] * (slope.G[:, columns] @ direction)
        if effect.per_stiffness and assembly.stiffness_parameter(i) == j:
            k = float(unknowns.common[j])
            flow[:, :n] += line.flow(scheme.E0[:, columns] @ direction, scheme.E1[:, columns] @ direction) / k
            outputs += heard.value[drive.rows, None] * (scheme.G[:, columns] @ direction) / k
    return Source(flow=flow, outputs=outputs)


def _parameter(
    assembly: Assembly,
    unknowns: Unknowns,
    drive: Drive,
    trajectory: Trajectory,
    scheme: Scheme,
    *,
    placement: int,
    j: int,
) -> Source:
    if placement in assembly.forces:
        return _force_parameter(assembly, unknowns, trajectory, scheme, placement=placement, j=j)
    if placement in assembly.sensors:
        return _sensor_parameter(assembly, unknowns, trajectory, placement, j)
    flow, outputs = input_forcing(assembly, unknowns, drive, trajectory, scheme, placement=placement, j=j)
    return Source(flow=flow, outputs=outputs)


def _force_parameter(
    assembly: Assembly, unknowns: Unknowns, trajectory: Trajectory, scheme: Scheme, *, placement: int, j: int
) -> Source:
    about, drive, n = trajectory.linearisation, trajectory.drive, assembly.plant.n_states
    _, port = assembly.placements[placement].force_and_port
    position, columns = assembly.forces.index(placement), list(port.columns)
    direction, line = unknowns.directions(assembly, placement), about.lines[position]
    slope = about.heard[position].slope[:, j]
    flow = np.zeros_like(about.states)
    flow[:, :n] = line.start_slope[:, j, None] * (scheme.E0[:, columns] @ direction)
    flow[:, :n] += line.end_slope[:, j, None] * (scheme.E1[:, columns] @ direction)
    memory = about.memories[position]
    if memory is not None:
        first = n
        for before in range(position):
            earlier = about.memories[before]
            first += 0 if earlier is None else earlier.value.shape[1]
        flow[:, first : first + memory.value.shape[1]] = memory.by_parameter[:, :, j]
    return Source(flow=flow, outputs=slope[drive.rows, None] * about.G[:, position])


def _sensor_parameter(assembly: Assembly, unknowns: Unknowns, trajectory: Trajectory, placement: int, j: int) -> Source:
    about, drive = trajectory.linearisation, trajectory.drive
    channel, time = assembly.placements[placement].channel, drive.time[drive.rows]
    reading, slope = about.free[:, channel], np.zeros(len(drive.rows))
    for i in assembly.sensors:
        if assembly.placements[i].channel != channel:
            continue
        effect = assembly.placements[i].sensor_effect
        values = [per_time(value, drive) for value in unknowns.values(assembly, i)]
        slope = effect.gain(values) * slope
        if i == placement:
            slope = effect.by_parameter(values, reading, time)[:, j]
        reading = effect.gain(values) * reading + effect.offset(values, time)
    sensed = np.zeros_like(about.outputs)
    sensed[:, channel] = slope
    return Source(sensed=sensed)


def _direction(
    about: Linearisation, drive: Drive, scheme: Scheme, assembly: Assembly, *, placement: int, column: int
) -> Source:
    _, port = assembly.placements[placement].force_and_port
    position, n = assembly.forces.index(placement), assembly.plant.n_states
    line, added = about.lines[position], [port.columns[column]]
    flow = np.zeros_like(about.states)
    flow[:, :n] = line.flow(scheme.E0[:, added[0]], scheme.E1[:, added[0]])
    return Source(flow=flow, outputs=about.heard[position].value[drive.rows, None] * scheme.G[:, added[0]])
