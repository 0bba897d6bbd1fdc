"""Motion at the places of forces, along a trajectory."""

from dataclasses import replace

import numpy as np

from modal.effects.effect import Motion
from modal.simulation.assembly import EffectPlacement
from modal.simulation.drive import Drive
from modal.simulation.plant import Plant, Port, plant_matrices
from okid.arrays import FloatArray

__all__ = ["midway", "motion_at", "one_on", "shifted", "step_compliance", "step_mobility"]


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


def step_mobility(plant: Plant, port: Port, dt: float) -> float:
    """Velocity that a force of 1 gives a port within a step; of the model as it was given, likewise."""
    if port.velocity is None:
        return 0.0
    column = plant_matrices(plant, plant.nominal).E[:, port.columns[0]]
    return abs(float(port.velocity[: plant.n_states] @ column)) * dt


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
