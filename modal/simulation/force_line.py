"""The straight line that stands for a force over each step, and how it depends on the states at both ends.

A force enters a step as E0 start + E1 end. Its values at the ends would do to second order; with the force in the
middle of the step, w_m, the line is lifted by c = 2/3 (w_m - (w0 + w1)/2), which gives it the force's own mean to
fourth order (Simpson's rule): at 16 steps a period what is left is below a thousandth. A law that jumps, or that stops
the motion within a step, brings its own line (`ForceEffect.step_force`).

A force sees the states only through the motion at its port: displacement, velocity and its own states, which are fixed
rows of them (`port_rows`). Dependences are kept by these few coordinates, time last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.effects.effect import Force, ForceEffect, Memory, Motion, StepForce
from modal.simulation.plant import Port
from modal.simulation.port_motion import midway, shifted
from okid.arrays import FloatArray

__all__ = ["ForceLine", "Lift", "force_line", "port_rows"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Lift:
    """What a sensor hears of a force at the start of each step besides its law, over n_times steps.

    Attributes:
        value: (n_times,).
        slope: (n_times, n_parameters) derivative by each parameter.
        by_before: (n_coordinates, n_times) dependence on the coordinates of the port at the start of the step.
        by_after: (n_coordinates, n_times) dependence on those at its end.
    """

    value: FloatArray
    slope: FloatArray
    by_before: FloatArray
    by_after: FloatArray


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
    lift: Lift | None = None

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
    effect: ForceEffect,
    values: Sequence[float | FloatArray],
    port: Port,
    before: Motion,
    after: Motion,
    *,
    force: Force,
    dt: float,
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

    Returns:
        The line.
    """
    jump = effect.step_force(values, before, after)
    if jump is not None:
        return _of_jump(jump, 2 + effect.n_memory)
    here = np.stack([force.by_displacement, force.by_velocity, *force.by_memory.T])
    there = shifted(here.T).T
    middle = _middle(effect, values, port, before, after, dt=dt)
    lift = 2.0 / 3.0 * (middle.value - 0.5 * (force.value + shifted(force.value)))
    slope = 2.0 / 3.0 * (middle.slope - 0.5 * (force.by_parameter + shifted(force.by_parameter)))
    by_before = 2.0 / 3.0 * (middle.by_before - 0.5 * here)
    by_after = 2.0 / 3.0 * (middle.by_after - 0.5 * there)
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
    by_before, by_after = np.zeros((2, n_coordinates, 2, len(jump.start)))
    by_before[read] = jump.start_by_before, jump.end_by_before
    by_after[read] = jump.start_by_after, jump.end_by_after
    lift = None
    if jump.lift is not None:
        lift_before, lift_after = np.zeros((2, n_coordinates, len(jump.start)))
        lift_before[read], lift_after[read] = jump.lift.by_before, jump.lift.by_after
        lift = Lift(value=jump.lift.value, slope=jump.lift.by_parameter, by_before=lift_before, by_after=lift_after)
    return ForceLine(
        start=jump.start,
        end=jump.end,
        start_slope=jump.start_by_parameter,
        end_slope=jump.end_by_parameter,
        by_before=by_before,
        by_after=by_after,
        lift=lift,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Middle:
    value: FloatArray
    slope: FloatArray
    by_before: FloatArray
    by_after: FloatArray


def _middle(
    effect: ForceEffect,
    values: Sequence[float | FloatArray],
    port: Port,
    before: Motion,
    after: Motion,
    *,
    dt: float,
) -> _Middle:
    """The force in the middle of each step, with the effect's own states advanced half a step."""
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
    return _Middle(value=force.value, slope=slope, by_before=by_before, by_after=by_after)


def _weights(port: Port, dt: float) -> tuple[tuple[float, float], ...]:
    """What d0, d1, v0, v1 give to (displacement, velocity) in the middle of the step, as in `midway`."""
    if port.displacement is None:
        return (0.0, 0.0), (0.0, 0.0), (0.0, 0.5), (0.0, 0.5)
    if port.velocity is None:
        return (0.5, 0.0), (0.5, 0.0), (0.0, 0.0), (0.0, 0.0)
    return (0.5, -1.5 / dt), (0.5, 1.5 / dt), (dt / 8.0, -0.25), (-dt / 8.0, -0.25)
