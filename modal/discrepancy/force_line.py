"""The straight line that stands for a force over each step, and how it depends on the states at both ends.

A force enters a step as E0 start + E1 end. Its values at the ends would do to second order; with the force in the
middle of the step, w_m, the line is lifted by c = 2/3 (w_m - (w0 + w1)/2), which gives it the force's own mean to
fourth order (Simpson's rule): at 16 steps a period what is left is below a thousandth. A law that jumps, or that stops
the motion within a step, brings its own line (`ForceEffect.step_force`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.discrepancy.effects.effect import Force, ForceEffect, Memory, Motion, StepForce
from modal.discrepancy.plant import Port
from modal.discrepancy.port_motion import midway, shifted
from okid.arrays import FloatArray

__all__ = ["ForceLine", "add_rows", "force_line"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ForceLine:
    """The line over each step and its dependences, over n_times steps.

    Attributes:
        start: (n_times,).
        end: (n_times,).
        start_slope: (n_times, n_parameters) derivative of `start`.
        end_slope: (n_times, n_parameters) derivative of `end`.
        start_before: (n_times, n) dependence of `start` on the states at the start of the step.
        start_after: (n_times, n) dependence of `start` on the states at its end.
        end_before: (n_times, n) dependence of `end` on the states at the start.
        end_after: (n_times, n) dependence of `end` on the states at the end.
    """

    start: FloatArray
    end: FloatArray
    start_slope: FloatArray
    end_slope: FloatArray
    start_before: FloatArray
    start_after: FloatArray
    end_before: FloatArray
    end_after: FloatArray

    def flow(self, column_start: FloatArray, column_end: FloatArray) -> FloatArray:
        """What the force adds to each step (n_times, n_states), entering in these columns."""
        return np.asarray(self.start[:, None] * column_start + self.end[:, None] * column_end)


def add_rows(rows: FloatArray, port: Port, by_displacement: FloatArray, by_velocity: FloatArray) -> None:
    """Add a dependence on the motion at a port to rows (n_times, n_states) over the plant's states."""
    n = rows.shape[1]
    if port.displacement is not None:
        rows += by_displacement[:, None] * port.displacement[:n]
    if port.velocity is not None:
        rows += by_velocity[:, None] * port.velocity[:n]


def force_line(
    effect: ForceEffect,
    values: Sequence[float | FloatArray],
    port: Port,
    before: Motion,
    after: Motion,
    *,
    force: Force,
    dt: float,
    n_states: int,
    n_all: int,
    memory: slice,
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
        n_states: Number of the plant's states.
        n_all: Number of all states.
        memory: Where the effect's own states stand among them.

    Returns:
        The line.
    """
    jump = effect.step_force(values, before, after)
    if jump is not None:
        return _of_jump(jump, port, n_states, n_all)
    at_times = np.zeros((len(force.value), n_all))
    add_rows(at_times[:, :n_states], port, force.by_displacement, force.by_velocity)
    at_times[:, memory] = force.by_memory
    middle = _middle(effect, values, port, before, after, dt=dt, n_states=n_states, n_all=n_all, memory=memory)
    lift = 2.0 / 3.0 * (middle.value - 0.5 * (force.value + shifted(force.value)))
    slope = 2.0 / 3.0 * (middle.slope - 0.5 * (force.by_parameter + shifted(force.by_parameter)))
    by_before = 2.0 / 3.0 * (middle.by_before - 0.5 * at_times)
    by_after = 2.0 / 3.0 * (middle.by_after - 0.5 * shifted(at_times))
    return ForceLine(
        start=force.value + lift,
        end=shifted(force.value) + lift,
        start_slope=force.by_parameter + slope,
        end_slope=shifted(force.by_parameter) + slope,
        start_before=at_times + by_before,
        start_after=by_after,
        end_before=by_before,
        end_after=shifted(at_times) + by_after,
    )


def _of_jump(jump: StepForce, port: Port, n_states: int, n_all: int) -> ForceLine:
    none = np.zeros(len(jump.start))

    def rows(slope: FloatArray) -> FloatArray:
        found = np.zeros((len(none), n_all))
        by_displacement, by_velocity = (slope, none) if jump.reads == "displacement" else (none, slope)
        add_rows(found[:, :n_states], port, by_displacement, by_velocity)
        return found

    return ForceLine(
        start=jump.start,
        end=jump.end,
        start_slope=jump.start_by_parameter,
        end_slope=jump.end_by_parameter,
        start_before=rows(jump.start_by_before),
        start_after=rows(jump.start_by_after),
        end_before=rows(jump.end_by_before),
        end_after=rows(jump.end_by_after),
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
    n_states: int,
    n_all: int,
    memory: slice,
) -> _Middle:
    """The force in the middle of each step, with the effect's own states advanced half a step."""
    between = midway(port, before, after, dt)
    half: Memory | None = None
    if effect.n_memory:
        half = effect.advance(values, before, between, 0.5 * dt)
        between = replace(between, memory=half.value)
    force = effect.force(values, between)
    by_displacement, by_velocity, slope = force.by_displacement, force.by_velocity, force.by_parameter
    by_before, by_after = np.zeros((len(force.value), n_all)), np.zeros((len(force.value), n_all))
    if half is not None:
        by_displacement = by_displacement + np.sum(force.by_memory * half.by_displacement_after, axis=1)
        by_velocity = by_velocity + np.sum(force.by_memory * half.by_velocity_after, axis=1)
        slope = slope + np.einsum("km,kmp->kp", force.by_memory, half.by_parameter)
        by_before[:, memory] = np.einsum("km,kmz->kz", force.by_memory, half.by_memory)
        add_rows(
            by_before[:, :n_states],
            port,
            np.sum(force.by_memory * half.by_displacement_before, axis=1),
            np.sum(force.by_memory * half.by_velocity_before, axis=1),
        )
    d0, d1, v0, v1 = _weights(port, dt)
    for rows, displacement, velocity in ((by_before, d0, v0), (by_after, d1, v1)):
        add_rows(
            rows[:, :n_states],
            port,
            displacement[0] * by_displacement + displacement[1] * by_velocity,
            velocity[0] * by_displacement + velocity[1] * by_velocity,
        )
    return _Middle(value=force.value, slope=slope, by_before=by_before, by_after=by_after)


def _weights(port: Port, dt: float) -> tuple[tuple[float, float], ...]:
    """What d0, d1, v0, v1 give to (displacement, velocity) in the middle of the step, as in `midway`."""
    if port.displacement is None:
        return (0.0, 0.0), (0.0, 0.0), (0.0, 0.5), (0.0, 0.5)
    if port.velocity is None:
        return (0.5, 0.0), (0.5, 0.0), (0.0, 0.0), (0.0, 0.0)
    return (0.5, -1.5 / dt), (0.5, 1.5 / dt), (dt / 8.0, -0.25), (-dt / 8.0, -0.25)
