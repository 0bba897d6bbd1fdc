"""A force law by itself: what it is drawn against, its value over a grid of that, and its derivatives."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from modal.effects.effect import ForceEffect, Motion, Values
from modal.simulation.assembly import EffectPlacement
from modal.simulation.tolerances import DIFFERENCE_STEP, ROUNDING
from okid.arrays import FloatArray

__all__ = ["Reading", "force_law", "loaded_law", "reading_of", "still_motion"]

LOADING_STEPS = 60
"""Steps in which a law with memory is loaded from rest to either side."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Reading:
    """What a force law is drawn against.

    Attributes:
        against: What it is.
        period: Period of a law at one frequency [s], 0 for none.
        at_displacement: Displacement at which a law of time is drawn; 1 where it does not read it.
        scaled: Whether it reads the displacement as well as the time.
    """

    against: Literal["displacement", "velocity", "time"]
    period: float = 0.0
    at_displacement: float = 1.0
    scaled: bool = False


def still_motion(item: EffectPlacement, n: int, *, smoothing: float = 0.0) -> Motion:
    """(n,) samples of no motion at a force's place."""
    port = item.port
    stiffness = None if port is None else port.stiffness
    mass = None if port is None else port.mass
    zeros = np.zeros(n)
    return Motion(
        displacement=zeros,
        velocity=zeros,
        time=zeros,
        memory=np.zeros((n, item.n_memory)),
        displacement_scale=item.displacement_scale,
        velocity_scale=item.velocity_scale,
        stiffness=1.0 if stiffness is None else stiffness,
        mass=1.0 if mass is None else mass,
        smoothing=smoothing,
    )


def reading_of(item: EffectPlacement, effect: ForceEffect, values: Values) -> Reading:
    """What a force law is drawn against: time where it depends on it, else displacement, else velocity."""
    n = 7
    d, v = item.displacement_scale, item.velocity_scale
    at = _moved(still_motion(item, n), displacement=np.full(n, d), velocity=np.full(n, v))
    later = _moved(at, time=np.linspace(0.0, 1.0, n) ** 2 * 7.3)
    then = effect.force(values, later).value
    if effect.n_memory == 0 and not np.allclose(then, effect.force(values, at).value, rtol=ROUNDING, atol=0.0):
        at_rest = effect.force(values, _moved(later, displacement=np.zeros(n))).value
        scaled = not np.allclose(then, at_rest, rtol=ROUNDING, atol=0.0)
        rates = [j for j, kind in enumerate(effect.parameters) if kind.dimension == (0, 0, -1)]
        rate = float(np.mean(values[rates[0]])) if rates else 0.0
        return Reading(
            against="time",
            period=1.0 / rate if rate > 0.0 else 0.0,
            at_displacement=d if scaled else 1.0,
            scaled=scaled,
        )
    has_displacement = item.port is not None and item.port.displacement is not None
    if "displacement" in effect.needs or (has_displacement and not effect.needs):
        return Reading(against="displacement")
    return Reading(against="velocity")


def force_law(
    item: EffectPlacement, effect: ForceEffect, values: Values, reading: Reading, grid: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The law (n,) over a grid of what it is drawn against, and its derivative (n, n_parameters)."""
    still = still_motion(item, len(grid))
    if reading.against == "time":
        moved = _moved(still, time=grid, displacement=np.full(len(grid), reading.at_displacement))
    elif reading.against == "velocity":
        moved = _moved(still, velocity=grid)
    else:
        moved = _moved(still, displacement=grid)
    force = effect.force(values, moved)
    return force.value, force.by_parameter


def loaded_law(
    item: EffectPlacement, effect: ForceEffect, values: Values, grid: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """A law with memory as it loads from rest to either side, and its derivative, by central differences."""
    given = np.array([float(np.mean(value)) for value in values])
    steps = DIFFERENCE_STEP * np.maximum(np.abs(given), 1e-12)
    moves = np.repeat(np.diag(steps), 2, axis=0) * np.tile([1.0, -1.0], len(given))[:, None]
    trials = given + np.concatenate([np.zeros((1, len(given))), moves])
    reach = np.array([float(grid.min()), float(grid.max())])
    paths = np.linspace(0.0, 1.0, LOADING_STEPS + 1)[:, None] * reach
    displacement = np.tile(paths, (1, len(trials)))
    parameters = list(np.repeat(trials, 2, axis=0).T)
    at = still_motion(item, displacement.shape[1])
    forces = np.zeros_like(displacement)
    for k, following in enumerate(displacement):
        after = _moved(at, displacement=following)
        if k:
            memory = effect.advance(parameters, at, after, dt).value
            after = _moved(after, memory=memory)
        forces[k] = effect.force(parameters, after).value
        at = after
    found = np.concatenate([forces[:0:-1, 0::2], forces[:, 1::2]]).T
    along = np.concatenate([paths[:0:-1, 0], paths[:, 1]])
    order = np.argsort(along, kind="stable")
    law = np.stack([np.interp(grid, along[order], one[order]) for one in found])
    return law[0], ((law[1::2] - law[2::2]) / (2.0 * steps[:, None])).T


def _moved(
    motion: Motion,
    *,
    displacement: FloatArray | None = None,
    velocity: FloatArray | None = None,
    time: FloatArray | None = None,
    memory: FloatArray | None = None,
) -> Motion:
    return Motion(
        displacement=motion.displacement if displacement is None else displacement,
        velocity=motion.velocity if velocity is None else velocity,
        time=motion.time if time is None else time,
        memory=motion.memory if memory is None else memory,
        displacement_scale=motion.displacement_scale,
        velocity_scale=motion.velocity_scale,
        stiffness=motion.stiffness,
        mass=motion.mass,
        smoothing=motion.smoothing,
    )
