"""How the outputs depend on everything unknown: further right-hand sides of the trajectory's own recursion.

The derivative of the trajectory by any unknown obeys the linearised recursion with the unknown's own forcing, so the
exact Jacobian of a free run costs one more solve. Unknowns of each record (initial state, phases) are solved together
for all records, whose recursions do not touch, and split afterwards.
"""

from dataclasses import dataclass, replace

import numpy as np

from modal.simulation.assembly import Assembly, Unknowns, drive_inputs, per_row
from modal.simulation.drive import Drive
from modal.simulation.forces import shifted
from modal.simulation.linearisation import linearise
from modal.simulation.scheme import Scheme, solve_band
from modal.simulation.trajectory import Trajectory
from okid.arrays import TINY, FloatArray

__all__ = ["Sensitivity", "Source", "force_response", "respond", "sensitivity"]

DRIVE_STEP = 1e-6
"""Move a drive by this share of its largest value for a central difference: the kinks of its effects stay apart."""


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
        common: Whether by the effects' common unknowns as well, or by each record's own only.
    """
    shared = [_linear(assembly, unknowns, trajectory, slope=slope, position=j) for j, slope in enumerate(slopes)]
    local = [Source(initial=state) for state in range(assembly.plant.n_states)]
    memory = assembly.plant.n_states
    for i, item in enumerate(assembly.placements):

        def by(j: int, i: int = i) -> Source:
            if i in assembly.forces:
                return _force_parameter(assembly, trajectory, i, j)
            if i in assembly.sensors:
                return _sensor_parameter(assembly, unknowns, trajectory, i, j)
            return _input_parameter(assembly, unknowns, drive, trajectory, scheme, placement=i, j=j)

        local += [Source(initial=memory + own) for own in range(item.n_memory)]
        memory += item.n_memory
        local += [by(j) for j in item.local]
        if common:
            shared += [by(j) for j in item.common]
            shared += [
                _direction(assembly, trajectory, scheme, i, column) for column in range(1, 1 + item.n_directions)
            ]
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
        values = [per_row(value, drive) for value in unknowns.values(assembly, i)]
        factors[:, item.channel] *= item.sensor_effect.gain(values)
    return factors


def _linear(assembly: Assembly, unknowns: Unknowns, trajectory: Trajectory, *, slope: Scheme, position: int) -> Source:
    """What the linear parameter at a position does, `slope` the derivative of the scheme by it."""
    about, drive, n = trajectory.linearisation, trajectory.drive, assembly.plant.n_states
    states = about.states[:, :n]
    flow = np.zeros_like(about.states)
    flow[:, :n] = states @ slope.Ad.T + drive.start @ slope.B0.T + drive.end @ slope.B1.T
    outputs = states[drive.rows] @ slope.C.T + drive.sample[drive.rows] @ slope.D.T
    for i, one, heard in zip(assembly.forces, about.acting, about.heard, strict=True):
        item = assembly.placements[i]
        effect, port = item.force_and_port
        if item.channel >= 0 and one.memory is not None:  # the output that the sensor follows
            moved = states @ slope.C[item.channel] + drive.sample @ slope.D[item.channel]
            before, after = one.memory.by_displacement_before, one.memory.by_displacement_after
            flow[:, one.span] = before * moved[:, None] + after * shifted(moved)[:, None]
            outputs += (heard.by_now[0] * moved)[drive.rows, None] * one.G
            continue
        direction = unknowns.directions(assembly, i)
        E0, E1, G = (matrix[:, list(port.columns)] @ direction for matrix in (slope.E0, slope.E1, slope.G))
        if effect.per_stiffness and assembly.stiffness_parameter(i) == position:
            k = float(unknowns.common[position])
            E0, E1, G = E0 + one.E0 / k, E1 + one.E1 / k, G + one.G / k
        flow[:, :n] += one.line.flow(E0, E1)
        outputs += heard.value[drive.rows, None] * G
    return Source(flow=flow, outputs=outputs)


def _force_parameter(assembly: Assembly, trajectory: Trajectory, placement: int, j: int) -> Source:
    about, n = trajectory.linearisation, assembly.plant.n_states
    position = assembly.forces.index(placement)
    one, slope = about.acting[position], about.heard[position].slope[:, j]
    flow = np.zeros_like(about.states)
    flow[:, :n] = one.line.start_slope[:, j, None] * one.E0 + one.line.end_slope[:, j, None] * one.E1
    if one.memory is not None:
        flow[:, one.span] = one.memory.by_parameter[:, :, j]
    return Source(flow=flow, outputs=slope[trajectory.drive.rows, None] * one.G)


def _direction(assembly: Assembly, trajectory: Trajectory, scheme: Scheme, placement: int, column: int) -> Source:
    """What a component of a force's direction does: the force in one more column of its port."""
    about, drive, n = trajectory.linearisation, trajectory.drive, assembly.plant.n_states
    _, port = assembly.placements[placement].force_and_port
    position, added = assembly.forces.index(placement), port.columns[column]
    flow = np.zeros_like(about.states)
    flow[:, :n] = about.acting[position].line.flow(scheme.E0[:, added], scheme.E1[:, added])
    return Source(flow=flow, outputs=about.heard[position].value[drive.rows, None] * scheme.G[:, added])


def _sensor_parameter(assembly: Assembly, unknowns: Unknowns, trajectory: Trajectory, placement: int, j: int) -> Source:
    about, drive = trajectory.linearisation, trajectory.drive
    channel, time = assembly.placements[placement].channel, drive.time[drive.rows]
    reading, slope = about.free[:, channel], np.zeros(len(drive.rows))
    for i in assembly.sensors:
        if assembly.placements[i].channel != channel:
            continue
        effect = assembly.placements[i].sensor_effect
        values = [per_row(value, drive) for value in unknowns.values(assembly, i)]
        slope = effect.gain(values) * slope
        if i == placement:
            slope = effect.by_parameter(values, reading, time)[:, j]
        reading = effect.gain(values) * reading + effect.offset(values, time)
    sensed = np.zeros_like(about.outputs)
    sensed[:, channel] = slope
    return Source(sensed=sensed)


def _input_parameter(
    assembly: Assembly,
    unknowns: Unknowns,
    drive: Drive,
    trajectory: Trajectory,
    scheme: Scheme,
    *,
    placement: int,
    j: int,
) -> Source:
    """What a parameter of an effect at an input does to each step and to the outputs, the trajectory held."""
    slopes = _input_slopes(assembly, unknowns, drive, placement, j)
    about, n = trajectory.linearisation, assembly.plant.n_states
    flow = np.zeros_like(about.states)
    ports = [assembly.placements[i].force_and_port[1] for i in assembly.forces]
    rows = [row for port in ports for row in (port.displacement, port.velocity) if row is not None]
    if not any(row[n:].any() for row in rows):
        flow[:, :n] = slopes[0] @ scheme.B0.T + slopes[1] @ scheme.B1.T
        return Source(flow=flow, outputs=slopes[2][drive.rows] @ scheme.D.T)
    # the drive also moves ports: central differences of the steps
    size, (above, below) = _moved(trajectory.drive, slopes)
    high, low = (
        linearise(assembly, unknowns, moved, scheme, about.states, smoothing=about.smoothing)
        for moved in (above, below)
    )
    flow[:-1] = (high.defect - low.defect)[1:] / (2.0 * size)
    return Source(flow=flow, outputs=(high.free - low.free) / (2.0 * size))


def _input_slopes(assembly: Assembly, unknowns: Unknowns, drive: Drive, placement: int, j: int) -> FloatArray:
    """(3, n_times, n_inputs) derivatives of the drive's start, end and sample by a parameter of an effect at an input.

    Through further effects at the same input they are carried by central differences.
    """
    placements, item = assembly.placements, assembly.placements[placement]
    driven = drive_inputs(replace(assembly, placements=placements[:placement]), unknowns, drive)
    values = unknowns.values(assembly, placement)
    slopes = np.zeros((3, *drive.start.shape))
    for record in range(drive.n_records):
        at = (drive.times_of(record), item.channel)
        found = item.input_effect.by_parameter(values, driven.sample[at], driven.start[at], driven.end[at], drive.dt)
        for k in range(3):
            slopes[(k, *at)] = found[k][j]
    if not any(i > placement and placements[i].channel == item.channel for i in assembly.inputs):
        return slopes
    behind = drive_inputs(replace(assembly, placements=placements[: placement + 1]), unknowns, drive)
    size, moved = _moved(behind, slopes)
    ends = [drive_inputs(assembly, unknowns, one, first=placement + 1) for one in moved]
    above, below = (np.stack([one.start, one.end, one.sample]) for one in ends)
    return np.asarray((above - below) / (2.0 * size))


def _moved(drive: Drive, slopes: FloatArray) -> tuple[float, list[Drive]]:
    """A step along the slopes, and the drive moved by it to either side."""
    size = DRIVE_STEP * max(float(np.abs(drive.sample).max(initial=0.0)), TINY)
    size /= max(float(np.abs(slopes).max(initial=0.0)), TINY)
    moved = [
        replace(
            drive,
            start=drive.start + step * slopes[0],
            end=drive.end + step * slopes[1],
            sample=drive.sample + step * slopes[2],
        )
        for step in (size, -size)
    ]
    return size, moved
