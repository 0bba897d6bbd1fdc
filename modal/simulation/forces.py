"""Each force of a model along a trajectory: its value, its line over the steps, its memory, and where it enters.

A force enters a step as E0 start + E1 end. Its values at the ends would do to second order; with the force in the
middle of the step, w_m, the line is lifted by c = 2/3 (w_m - (w0 + w1)/2), which gives it the force's own mean to
fourth order (Simpson's rule): at 16 steps a period what is left is below a thousandth. A law that jumps, or that stops
the motion within a step, brings its own line (`ForceEffect.step_force`).

A force sees the states only through the motion at its port: displacement, velocity and its own states, which are fixed
rows of them (`port_rows`). Dependences are kept by these few coordinates, time last.
"""

from dataclasses import dataclass, replace

import numpy as np

from modal.effects.effect import Force, ForceEffect, Memory, Motion, StepForce, Values, jumps
from modal.simulation.assembly import Assembly, EffectPlacement, Unknowns, per_time
from modal.simulation.drive import Drive, IndexArray
from modal.simulation.plant import Plant, Port, plant_matrices
from modal.simulation.scheme import Scheme
from okid.arrays import FloatArray

LIFT = 2.0 / 3.0
"""Lift the line by this share of what the middle of the step lies above it: then its mean is Simpson's."""


def shifted(values: FloatArray) -> FloatArray:
    """Values one time on; the last time is its own successor (its step is not used)."""
    return np.concatenate([values[1:], values[-1:]])


def motion_at(
    item: EffectPlacement,
    states: FloatArray,
    drive: Drive,
    memory: FloatArray,
    smoothing: float | FloatArray,
    *,
    stiffness: float | None = None,
    mobility: float = 0.0,
    step_compliance: float = 0.0,
) -> Motion:
    """Motion at a force's place along a trajectory of the plant's states (n_times, n_states).

    `stiffness` is that of the place as calibrated, the port's own by default; `mobility` the velocity that a unit of
    force gives it within one step, `step_compliance` the displacement that it takes away, where it moves it at once.
    """
    _, port = item.force_and_port
    n = states.shape[1]

    def along(row: FloatArray | None) -> FloatArray:
        if row is None:
            return np.zeros(len(states))
        return np.asarray(states @ row[:n] + drive.sample @ row[n:])

    return Motion(
        displacement=along(port.displacement),
        velocity=along(port.velocity),
        time=drive.time,
        memory=memory,
        displacement_scale=item.displacement_scale,
        velocity_scale=item.velocity_scale,
        stiffness=next((value for value in (stiffness, port.stiffness) if value is not None), 1.0),
        mass=1.0 if port.mass is None else port.mass,
        mobility=mobility,
        step_compliance=step_compliance,
        smoothing=smoothing,
    )


def step_compliance(plant: Plant, port: Port, direction: FloatArray, dt: float) -> float:
    """Displacement at a port that a force of 1 along `direction` takes away within a step; 0 where it takes none.

    A force moves no displacement at once, so only ports that take flows are looked at. Counted in the model as it was
    given, so that the way a step is taken does not depend on what is fitted.
    """
    if port.displacement is None or "flow" not in port.accepts:
        return 0.0
    column = plant_matrices(plant, plant.nominal).E[:, list(port.columns)] @ direction
    return max(-float(port.displacement[: plant.n_states] @ column) * dt, 0.0)


def one_on(motion: Motion) -> Motion:
    """Motion at the end of each step."""
    return replace(
        motion,
        displacement=shifted(motion.displacement),
        velocity=shifted(motion.velocity),
        time=shifted(motion.time),
        memory=shifted(motion.memory),
    )


def midway(port: Port, before: Motion, after: Motion, dt: float) -> Motion:
    """Motion in the middle of each step, from displacement and velocity at both ends (cubic Hermite); memory as before.

    d_m = (d0 + d1) / 2 + dt (v0 - v1) / 8 and v_m = 3 (d1 - d0) / (2 dt) - (v0 + v1) / 4.
    """
    d0, d1, v0, v1 = before.displacement, after.displacement, before.velocity, after.velocity
    if port.displacement is None:
        displacement, velocity = d0, 0.5 * (v0 + v1)
    elif port.velocity is None:
        displacement, velocity = 0.5 * (d0 + d1), v0
    else:
        displacement = 0.5 * (d0 + d1) + dt * (v0 - v1) / 8.0
        velocity = 1.5 * (d1 - d0) / dt - 0.25 * (v0 + v1)
    return replace(before, displacement=displacement, velocity=velocity, time=0.5 * (before.time + after.time))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Heard:
    """What the outputs hear of a force directly: its law, and while it sticks the mean over the steps on both sides.

    Attributes:
        value: (n_times,).
        slope: (n_times, n_parameters) derivative by each parameter.
        by_now: (n_coordinates, n_times) dependence on the coordinates of the port.
        by_next: (n_coordinates, n_times) dependence on those one time on; None where there is none.
    """

    value: FloatArray
    slope: FloatArray
    by_now: FloatArray
    by_next: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ForceLine:
    """The line over each step and its dependences, over n_times steps.

    Attributes:
        start: (n_times,).
        end: (n_times,).
        start_slope: (n_times, n_parameters) derivative of `start`.
        end_slope: (n_times, n_parameters) derivative of `end`.
        by_before: (n_coordinates, 2, n_times) dependence of start and end on the coordinates of the port at the start
            of the step.
        by_after: (n_coordinates, 2, n_times) dependence on those at its end.
        lift: What a sensor hears besides the law; None for laws that do not jump.
    """

    start: FloatArray
    end: FloatArray
    start_slope: FloatArray
    end_slope: FloatArray
    by_before: FloatArray
    by_after: FloatArray
    lift: Heard | None = None

    @staticmethod
    def none(n_coordinates: int, n_parameters: int, n_times: int) -> "ForceLine":
        """That of what puts no force on the structure."""
        still, slope, by = np.zeros(n_times), np.zeros((n_times, n_parameters)), np.zeros((n_coordinates, 2, n_times))
        return ForceLine(start=still, end=still, start_slope=slope, end_slope=slope, by_before=by, by_after=by)

    def flow(self, column_start: FloatArray, column_end: FloatArray) -> FloatArray:
        """What the force adds to each step (n_times, n_states), entering in these columns."""
        return np.asarray(self.start[:, None] * column_start + self.end[:, None] * column_end)


def port_rows(port: Port, n_states: int, n_all: int, memory: slice) -> FloatArray:
    """The coordinates of a port as rows (2 + n_memory, n_all) over all states: displacement, velocity, own states.

    What a port does not have is a row of zeros.
    """
    own = range(memory.start, memory.stop)
    rows = np.zeros((2 + len(own), n_all))
    if port.displacement is not None:
        rows[0, :n_states] = port.displacement[:n_states]
    if port.velocity is not None:
        rows[1, :n_states] = port.velocity[:n_states]
    rows[2 + np.arange(len(own)), own] = 1.0
    return rows


def force_line(
    effect: ForceEffect, values: Values, port: Port, before: Motion, after: Motion, *, force: Force, dt: float
) -> ForceLine:
    """The line that stands for a force over each step.

    Args:
        effect: The effect.
        values: Its parameters.
        port: Its place.
        before: Motion at the start of each step.
        after: Motion at the end of each step.
        force: The force at the start of each step.
        dt: Step [s].
    """
    jump = effect.step_force(values, before, after)
    if jump is not None:
        return _of_jump(jump, 2 + effect.n_memory)
    here = np.stack([force.by_displacement, force.by_velocity, *force.by_memory.T])
    there = shifted(here.T).T
    value, slope, by_before, by_after = _in_the_middle(effect, values, port, before, after, dt=dt)
    lift = LIFT * (value - 0.5 * (force.value + shifted(force.value)))
    slope = LIFT * (slope - 0.5 * (force.by_parameter + shifted(force.by_parameter)))
    by_before, by_after = LIFT * (by_before - 0.5 * here), LIFT * (by_after - 0.5 * there)
    return ForceLine(
        start=force.value + lift,
        end=shifted(force.value) + lift,
        start_slope=force.by_parameter + slope,
        end_slope=shifted(force.by_parameter) + slope,
        by_before=np.stack([here + by_before, by_before], axis=1),
        by_after=np.stack([by_after, there + by_after], axis=1),
    )


def _of_jump(jump: StepForce, n_coordinates: int) -> ForceLine:
    read = 0 if jump.reads == "displacement" else 1
    by_before, by_after = np.zeros((2, n_coordinates, 2, len(jump.start.value)))
    by_before[read] = jump.start.by_before, jump.end.by_before
    by_after[read] = jump.start.by_after, jump.end.by_after
    lift = None
    if jump.lift is not None:
        by_now, by_next = np.zeros((2, n_coordinates, len(jump.lift.value)))
        by_now[read], by_next[read] = jump.lift.by_before, jump.lift.by_after
        lift = Heard(value=jump.lift.value, slope=jump.lift.by_parameter, by_now=by_now, by_next=by_next)
    return ForceLine(
        start=jump.start.value,
        end=jump.end.value,
        start_slope=jump.start.by_parameter,
        end_slope=jump.end.by_parameter,
        by_before=by_before,
        by_after=by_after,
        lift=lift,
    )


def _in_the_middle(
    effect: ForceEffect, values: Values, port: Port, before: Motion, after: Motion, *, dt: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The force in the middle of each step, with the effect's own states advanced half a step.

    Its value, its slope by each parameter, and its dependence on the coordinates at the start and at the end.
    """
    between = midway(port, before, after, dt)
    half: Memory | None = None
    if effect.n_memory:
        half = effect.advance(values, before, between, 0.5 * dt)
        between = replace(between, memory=half.value)
    force = effect.force(values, between)
    by_displacement, by_velocity, slope = force.by_displacement, force.by_velocity, force.by_parameter
    by_before, by_after = np.zeros((2, 2 + effect.n_memory, len(force.value)))
    if half is not None:
        by_displacement = by_displacement + np.sum(force.by_memory * half.by_displacement_after, axis=1)
        by_velocity = by_velocity + np.sum(force.by_memory * half.by_velocity_after, axis=1)
        slope = slope + np.einsum("km,kmp->kp", force.by_memory, half.by_parameter)
        by_before[0] = np.sum(force.by_memory * half.by_displacement_before, axis=1)
        by_before[1] = np.sum(force.by_memory * half.by_velocity_before, axis=1)
        by_before[2:] = np.einsum("km,kmz->zk", force.by_memory, half.by_memory)
    d0, d1, v0, v1 = _weights(port, dt)
    for rows, displacement, velocity in ((by_before, d0, v0), (by_after, d1, v1)):
        rows[0] += displacement[0] * by_displacement + displacement[1] * by_velocity
        rows[1] += velocity[0] * by_displacement + velocity[1] * by_velocity
    return force.value, slope, by_before, by_after


def _weights(port: Port, dt: float) -> tuple[tuple[float, float], ...]:
    """What d0, d1, v0, v1 give to (displacement, velocity) in the middle of the step, as in `midway`."""
    if port.displacement is None:
        return (0.0, 0.0), (0.0, 0.0), (0.0, 0.5), (0.0, 0.5)
    if port.velocity is None:
        return (0.5, 0.0), (0.5, 0.0), (0.0, 0.0), (0.0, 0.0)
    return (0.5, -1.5 / dt), (0.5, 1.5 / dt), (dt / 8.0, -0.25), (-dt / 8.0, -0.25)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ActingForce:
    """A force along a trajectory. What a step takes from it are lines: its start, its end, then each own state one on.

    Attributes:
        rows: (n_coordinates, n) the coordinates of its port over all states: displacement, velocity, own states.
        span: Where its own states stand among all states.
        force: The force at every time.
        line: The line that stands for it over every step.
        memory: Its own states one time on; None where it has none.
        E0: (n_states,) where the start of the line enters, the direction included.
        E1: (n_states,) where its end enters.
        G: (n_outputs,) what it does to the outputs directly.
    """

    rows: FloatArray
    span: slice
    force: Force
    line: ForceLine
    memory: Memory | None
    E0: FloatArray
    E1: FloatArray
    G: FloatArray

    @property
    def columns(self) -> FloatArray:
        """(n, n_lines) where the lines enter a step."""
        n_memory = self.span.stop - self.span.start
        found = np.zeros((self.rows.shape[1], 2 + n_memory))
        found[: len(self.E0), 0], found[: len(self.E0), 1] = self.E0, self.E1
        found[self.span, 2:] = np.eye(n_memory)
        return found

    @property
    def by_before(self) -> FloatArray:
        """(n_coordinates, n_lines, n_times) dependence of the lines on the coordinates at the start of the step."""
        if self.memory is None:
            return self.line.by_before
        of = self.memory
        own = np.stack([of.by_displacement_before.T, of.by_velocity_before.T, *of.by_memory.transpose(2, 1, 0)])
        return np.concatenate([self.line.by_before, own], axis=1)

    @property
    def by_after(self) -> FloatArray:
        """(n_coordinates, n_lines, n_times) dependence on the coordinates at the end of the step."""
        if self.memory is None:
            return self.line.by_after
        of = self.memory
        own = np.zeros((len(self.rows), of.value.shape[1], len(of.value)))
        own[0], own[1] = of.by_displacement_after.T, of.by_velocity_after.T
        return np.concatenate([self.line.by_after, own], axis=1)

    def heard(self, lasts: IndexArray | None = None) -> Heard:
        """The law at every time; with the last time of each record, where it sticks, the mean over the steps.

        Nothing is known of the steps that would leave the last times.
        """
        by_now = np.stack([self.force.by_displacement, self.force.by_velocity, *self.force.by_memory.T])
        law = Heard(value=self.force.value, slope=self.force.by_parameter, by_now=by_now, by_next=None)
        lift = self.line.lift
        if lasts is None or lift is None or lift.by_next is None or not self.G.any():
            return law
        known = np.ones(len(law.value))
        known[lasts] = 0.0
        return Heard(
            value=law.value + known * lift.value,
            slope=law.slope + known[:, None] * lift.slope,
            by_now=law.by_now + known * lift.by_now,
            by_next=known * lift.by_next,
        )


def acting_forces(
    assembly: Assembly, unknowns: Unknowns, drive: Drive, scheme: Scheme, states: FloatArray, *, smoothing: float
) -> tuple[ActingForce, ...]:
    """All forces of a model along a trajectory.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        drive: Inputs after the effects at the inputs.
        scheme: Matrices of one step.
        states: The trajectory (n_times, n_states + n_memory).
        smoothing: Width of sharp laws, as a share of the motion's scale.
    """
    n, n_all = assembly.plant.n_states, states.shape[1]
    found: list[ActingForce] = []
    first = n
    for i in assembly.forces:
        item = assembly.placements[i]
        effect, port = item.force_and_port
        span = slice(first, first + effect.n_memory)
        first = span.stop
        values = [per_time(value, drive) for value in unknowns.values(assembly, i)]
        at = assembly.stiffness_parameter(i)
        columns, direction = list(port.columns), unknowns.directions(assembly, i)
        mobility = 0.0
        if jumps(effect) and port.velocity is not None:  # of the model as it was given, as for a flow
            column = plant_matrices(assembly.plant, assembly.plant.nominal).E[:, port.columns[0]]
            mobility = abs(float(port.velocity[:n] @ column)) * drive.dt
        motion = motion_at(
            item,
            states[:, :n],
            drive,
            states[:, span],
            smoothing * drive.level,
            stiffness=None if at is None else float(unknowns.common[at]),
            mobility=mobility,
            step_compliance=step_compliance(assembly.plant, port, direction, drive.dt),
        )
        rows, E0, E1, G = port_rows(port, n, n_all, span), scheme.E0, scheme.E1, scheme.G
        enters = [matrix[:, columns] @ direction for matrix in (E0, E1, G)]
        if item.channel >= 0:  # a sensor that remembers, of the output as the model has it now
            rows[0, :n] = scheme.C[item.channel]
            motion = replace(
                motion, displacement=states[:, :n] @ scheme.C[item.channel] + drive.sample @ scheme.D[item.channel]
            )
            enters = [np.zeros(n), np.zeros(n), np.eye(len(G))[item.channel]]
        after = one_on(motion)
        force = effect.force(values, motion)
        if item.channel >= 0:
            line = ForceLine.none(len(rows), len(values), drive.n_times)
        else:
            line = force_line(effect, values, port, motion, after, force=force, dt=drive.dt)
        found.append(
            ActingForce(
                rows=rows,
                span=span,
                force=force,
                line=line,
                memory=effect.advance(values, motion, after, drive.dt) if effect.n_memory else None,
                E0=enters[0],
                E1=enters[1],
                G=enters[2],
            )
        )
    return tuple(found)
