"""Simulation by Newton's method on the whole trajectory, and how it depends on everything unknown.

Every step's defect is driven to zero at once: one solve of the recursion an iteration (`modal.simulation.scheme`).
From a near trajectory one to three iterations are enough. Where the whole does not converge, sharp laws are
first smoothed and then sharpened, and at last the records are marched through in windows.

The derivative of the trajectory by any unknown obeys the linearised recursion with the unknown's own forcing, so the
exact Jacobian of a free run costs one more solve. Unknowns of each record (initial state, phases) are solved together
for all records, whose recursions do not touch, and split afterwards.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from modal.effects.effect import jumps
from modal.simulation.assembly import Assembly, Unknowns, drive_inputs, per_row
from modal.simulation.drive import Drive
from modal.simulation.forces import shifted
from modal.simulation.linearisation import Linearisation, linearise
from modal.simulation.scheme import Recursion, Scheme
from okid.arrays import TINY, FloatArray

SHARP = 0.005
"""Smooth sharp laws over this share of the motion's scale in a finished simulation: at 0.02 a sticking motor's
simulation stays 14 times above the noise."""

TOLERANCE = 1e-8
"""Call a trajectory converged when no step misses by more than this share of the states' size."""

LADDER = (0.3, 0.1, 0.03, 0.012, 0.005, 0.002)
"""Soften sharp laws to these widths, one after the other, where they do not converge as they are."""
MEMORY_RISE = 30.0
"""Let the defect rise by this factor in a Newton step of laws with memory; see `allowed_rise`."""
SMALLEST_SHARE = 0.1
"""Try no smaller share of a Newton step."""

FIRST_WINDOW, SMALLEST_WINDOW, LARGEST_WINDOW = 64, 1, 256
"""Steps of a window in the march."""

STUBBORN_WINDOW, STUBBORN_ITERATIONS = 4, 60
"""A window this short is iterated longer: a single step onto a law that sticks needs many short Newton steps."""

GROW_AFTER = 3
"""Let windows grow again after so many in a row that converged: each failure is wasted."""

OVERHEAD = 200
"""Count an evaluation of a window as so many times besides its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """What a simulation may cost before it is given up.

    Attributes:
        iterations: Newton iterations of the whole.
        brim_iterations: Those with a brim: where a level was thought to stand at it and still rises, a step of Newton's
            method mends one step of time, and a tank takes hundreds of these to fill.
        march: Evaluations of the whole trajectory that a march may cost.
    """

    iterations: int
    brim_iterations: int
    march: float


FAR = Patience(iterations=25, brim_iterations=400, march=300.0)
"""Give up so late from any start."""
NEAR = Patience(iterations=10, brim_iterations=40, march=10.0)
"""Give up so soon from a trajectory that is near already: a trial step that needs more is taken for too long."""

About = Callable[[FloatArray, float], Linearisation]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trajectory:
    """A simulated trajectory and the model about it."""

    linearisation: Linearisation
    recursion: Recursion
    drive: Drive

    @property
    def states(self) -> FloatArray:
        """The trajectory (n_times, n_states + n_memory)."""
        return self.linearisation.states

    @property
    def outputs(self) -> FloatArray:
        """Outputs at the measured rows (n_rows, n_outputs)."""
        return self.linearisation.outputs


def resting_states(assembly: Assembly, drive: Drive) -> FloatArray:
    """A trajectory to start from: all zero."""
    return np.zeros((drive.n_times, assembly.plant.n_states + assembly.n_memory))


def simulate_states(
    assembly: Assembly,
    unknowns: Unknowns,
    drive: Drive,
    scheme: Scheme,
    states: FloatArray,
    *,
    smoothing: float = SHARP,
    gain: FloatArray | None = None,
    start: Literal["far", "near"] = "far",
) -> Trajectory | None:
    """Simulate.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        drive: Inputs as recorded.
        scheme: Matrices of one step.
        states: A trajectory to start from (n_times, n_states + n_memory).
        smoothing: Width of sharp laws as a share of the motion's scale.
        gain: Observer gain, or None for a free run.
        start: "far": sharp laws are softened first where the whole does not converge; "near": a few iterations only.

    Returns:
        The trajectory; None where none was found (the motion escapes, or Newton's method does not converge).
    """
    driven = drive_inputs(assembly, unknowns, drive)

    def about(trial: FloatArray, width: float) -> Linearisation:
        return linearise(assembly, unknowns, driven, scheme, trial, smoothing=width, gain=gain)

    rise, patience = allowed_rise(assembly), NEAR if start == "near" else FAR
    brim = rise == np.inf
    found = _newton(about, states, smoothing, patience.brim_iterations if brim else patience.iterations, rise)
    if found is None and not brim:
        marched = _march(
            assembly, unknowns, driven, scheme, states, smoothing=smoothing, budget=patience.march, gain=gain
        )
        found = None if marched is None else _newton(about, marched, smoothing, NEAR.iterations, rise)
    if found is None and start == "far":
        found = _softened(about, states, smoothing, rise)
    if found is None:
        return None
    return Trajectory(linearisation=found, recursion=found.steps.recursion(), drive=driven)


def allowed_rise(assembly: Assembly) -> float:
    """Factor by which a Newton step may raise the defect.

    A law with memory is piecewise linear: full steps settle one piece after the other although the defect rises on the
    way. Beside a law that jumps they do not settle. Nor does the defect tell anything of a brim, where it is as large
    as the brim is hard: the level of a tank rises with the one before and its overflow is convex, and then full steps
    settle from any start (Ortega, Rheinboldt 1970, section 13.3, https://doi.org/10.1137/1.9780898719468).
    """
    effects = [assembly.placements[i].force_and_port[0] for i in assembly.forces]
    if any(effect.is_brim for effect in effects):
        return np.inf
    return MEMORY_RISE if assembly.n_memory and not any(jumps(effect) for effect in effects) else 1.0


def _softened(about: About, states: FloatArray, smoothing: float, rise: float) -> Linearisation | None:
    """Soften sharp laws until Newton's method converges, then sharpen them step by step."""
    found: Linearisation | None = None
    for width in (*(step for step in LADDER if step > smoothing), smoothing):
        softer = _newton(about, states, width, FAR.iterations, rise)
        if softer is None and found is not None:
            return None
        if softer is not None:
            found, states = softer, softer.states
    return found


def _march(
    assembly: Assembly,
    unknowns: Unknowns,
    driven: Drive,
    scheme: Scheme,
    states: FloatArray,
    *,
    smoothing: float,
    budget: float,
    gain: FloatArray | None,
) -> FloatArray | None:
    """Solve window by window, all records side by side; a window that does not converge is halved.

    `budget` is in evaluations of the whole trajectory.
    """
    spent, rise = 0.0, allowed_rise(assembly)
    found = states.copy()
    for record, first in enumerate(driven.firsts[:-1]):
        found[first] = unknowns.local[record, list(assembly.initial)]
    longest = int(np.diff(driven.firsts).max())
    position, width, solved_in_a_row = 0, FIRST_WINDOW, GROW_AFTER
    while position < longest - 1:
        window, index, which = driven.window(position, position + width + 1)
        initial = found[index[list(window.firsts[:-1])]]
        some = Unknowns(common=unknowns.common, local=unknowns.local[which])

        def about(trial: FloatArray, wide: float) -> Linearisation:
            nonlocal spent
            spent += (len(trial) + OVERHEAD) / len(states)
            return linearise(assembly, some, window, scheme, trial, smoothing=wide, gain=gain, initial=initial)  # noqa: B023 - used within this turn of the loop

        held = np.repeat(initial, np.diff(window.firsts), axis=0)
        iterations = NEAR.iterations if width > STUBBORN_WINDOW else STUBBORN_ITERATIONS
        solved = _newton(about, found[index], smoothing, iterations, rise) or _newton(
            about, held, smoothing, iterations, rise
        )
        if solved is None:
            width, solved_in_a_row = width // 2, 0
            if width < SMALLEST_WINDOW or spent > budget:
                return None
            continue
        found[index] = solved.states
        position, solved_in_a_row = position + width, solved_in_a_row + 1
        if solved_in_a_row >= GROW_AFTER:
            width = min(2 * width, LARGEST_WINDOW)
    return found


def _newton(about: About, states: FloatArray, width: float, iterations: int, rise: float) -> Linearisation | None:
    """Newton's method; None where it does not converge or a step has no unique end."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"), suppress(np.linalg.LinAlgError):
        current = about(states, width)
        miss = _miss(current)
        for _ in range(iterations):
            if miss == 0.0:  # at rest without inputs, or no states at all
                return current
            if not np.isfinite(miss):
                return None
            step = _step(current)
            if not np.isfinite(step).all():
                return None
            largest = float(np.abs(step).max(initial=0.0))
            size = float(np.abs(current.states).max(initial=0.0)) + largest
            share = 1.0
            trial = about(current.states + step, width)
            trial_miss = _miss(trial)
            while not trial_miss < max(rise * miss, TOLERANCE * size) and share > SMALLEST_SHARE:
                share /= 2.0
                trial = about(current.states + share * step, width)
                trial_miss = _miss(trial)
            if not np.isfinite(trial_miss):
                return None
            done = share == 1.0 and (largest <= TOLERANCE * size or not current.acting)  # of what is linear the first
            current, miss = trial, trial_miss
            if done:
                return current
    return None


def _miss(current: Linearisation) -> float:
    return float(np.sqrt(np.mean(current.defect**2))) if current.defect.size else 0.0


def _step(current: Linearisation) -> FloatArray:
    # The step k -> k + 1 is row k of what is led on; a record's initial state arrives unchanged.
    forcing = current.defect[np.newaxis].copy()
    if current.acting:
        forcing[:, 1:] = current.steps.advance(forcing[:, 1:])
    return current.steps.recursion().solve(forcing)[0]


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
    shared: list[Callable[[], Source]] = [
        partial(_linear, assembly, unknowns, trajectory, slope=slope, position=j) for j, slope in enumerate(slopes)
    ]
    local: list[Callable[[], Source]] = [partial(Source, initial=state) for state in range(assembly.plant.n_states)]
    memory = assembly.plant.n_states
    for i, item in enumerate(assembly.placements):

        def by(j: int, i: int = i) -> Source:
            if i in assembly.forces:
                return _force_parameter(assembly, trajectory, i, j)
            if i in assembly.sensors:
                return _sensor_parameter(assembly, unknowns, trajectory, i, j)
            return _input_parameter(assembly, unknowns, drive, trajectory, scheme, placement=i, j=j)

        local += [partial(Source, initial=memory + own) for own in range(item.n_memory)]
        memory += item.n_memory
        local += [partial(by, j) for j in item.local]
        if common:
            shared += [partial(by, j) for j in item.common]
            shared += [
                partial(_direction, assembly, trajectory, scheme, i, column)
                for column in range(1, 1 + item.n_directions)
            ]
    n, each = len(shared), (make() for make in (*shared, *local))  # one at a time: a flow is as long as the records
    states, outputs = respond(assembly, unknowns, trajectory, each, n + len(local), gain=gain)
    return Sensitivity(common=outputs[:n], local=outputs[n:], common_states=states[:n], local_states=states[n:])


def respond(
    assembly: Assembly,
    unknowns: Unknowns,
    trajectory: Trajectory,
    sources: Iterable[Source],
    n_sources: int,
    *,
    gain: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Response of the model, linearised about the trajectory, to several sources.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        trajectory: The trajectory.
        sources: What is added.
        n_sources: How many they are.
        gain: Observer gain of the trajectory, or None.

    Returns:
        States (n_sources, n_times, n) and outputs (n_sources, n_rows, n_outputs).
    """
    about, drive = trajectory.linearisation, trajectory.drive
    n_times, n_all = about.states.shape
    factors = _factors(assembly, unknowns, drive)
    direct = np.zeros((n_sources, len(drive.rows), len(about.outputs.T)))
    forcing, initial = np.zeros((n_sources, n_times, n_all)), np.full(n_sources, -1)
    led = forcing[:, 1:]  # what stands at the time that it leads from, arrives one later
    for position, source in enumerate(sources):
        if source.outputs is not None:
            direct[position] += factors * source.outputs
        if source.sensed is not None:
            direct[position] += source.sensed
        if source.flow is not None:
            led[position] = source.flow[:-1]
        initial[position] = source.initial
    if gain is not None:
        n = assembly.plant.n_states
        leading = drive.rows < n_times - 1
        corrected = np.where(drive.present, direct, 0.0)[:, leading] @ gain.T
        led[:, drive.rows[leading], :n] -= corrected
    forcing[:, list(drive.firsts[1:-1])] = 0.0
    if about.acting:
        led[:] = about.steps.advance(led)
    begun = np.flatnonzero(initial >= 0)
    for first in drive.firsts[:-1]:
        forcing[begun, first, initial[begun]] = 1.0
    states = trajectory.recursion.solve(forcing)
    direct += about.sensors.outputs(states)
    return states, direct


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
