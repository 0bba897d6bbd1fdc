"""What each candidate effect would do by itself: its force at a place along the current trajectory, at a few shapes.

A law that is linear in its amplitudes gives one history an amplitude; what is not linear (a gap, a yield displacement,
a frequency, a delay) is tried at the values that the effect proposes from the motion at its place and from the peaks of
what the model leaves.
"""

from dataclasses import dataclass, replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem
from modal.discrepancy.selection.memory_along import memory_along
from modal.effects.effect import Effect, ForceEffect, InputEffect, Motion, SensorEffect, Situation
from modal.simulation.assembly import Assembly, EffectPlacement, Unknowns, initial_unknowns, place_effect
from modal.simulation.driven import drive_inputs
from modal.simulation.port_motion import motion_at
from modal.simulation.sensitivity import Source, force_response
from okid.arrays import TINY, FloatArray

__all__ = ["TriedShape", "trials_of"]

N_PEAKS = 4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TriedShape:
    """An effect at a place, at one shape.

    Attributes:
        placement: The effect at its place.
        values: Its parameters; amplitudes stand at 1.
        sources: What each amplitude does by itself, for each column of the port.
    """

    placement: EffectPlacement
    values: tuple[float, ...]
    sources: tuple[Source, ...]


def trials_of(current: Estimate, problem: Problem, effect: Effect, where: str, smoothing: float) -> list[TriedShape]:
    """An effect at a place, at each shape worth a try.

    Args:
        current: The model so far.
        problem: The records to fit.
        effect: The effect.
        where: Name of the place.
        smoothing: Width of sharp laws, as a share of the motion's scale.

    Returns:
        The trials; none where the model has that effect there already, or none of its shapes shows.
    """
    assembly, trajectory = current.assembly, current.trajectory
    drive = trajectory.drive
    item = place_effect(assembly.plant, effect, where)
    if any(other.effect.key == effect.key and other.where == where for other in assembly.placements):
        return []
    if isinstance(effect, ForceEffect):
        states, memory = trajectory.states[:, : assembly.plant.n_states], np.zeros((drive.n_times, effect.n_memory))
        motion = motion_at(item, states, drive, memory, smoothing * drive.level)
    else:
        signal = drive.sample if isinstance(effect, InputEffect) else trajectory.linearisation.free
        time = drive.time if isinstance(effect, InputEffect) else drive.time[drive.rows]
        motion = _signal(signal[:, item.channel], time)
    motion = replace(
        motion,
        displacement_scale=max(float(np.std(motion.displacement)), TINY),
        velocity_scale=max(float(np.std(motion.velocity)), TINY),
    )
    item = replace(item, displacement_scale=motion.displacement_scale, velocity_scale=motion.velocity_scale)
    situation = Situation(
        motion=motion,
        residual_frequencies=_peaks(current, problem),
        dt=drive.dt,
        longest=float(drive.time.max()),
    )
    found = []
    for values in effect.starts(situation):
        sources = _sources(current, item, values, motion)
        if sources:
            found.append(TriedShape(placement=item, values=values, sources=tuple(sources)))
    return found


def _signal(values: FloatArray, time: FloatArray) -> Motion:
    return Motion(
        displacement=values,
        velocity=np.zeros_like(values),
        time=time,
        memory=np.zeros((len(values), 0)),
        displacement_scale=1.0,
        velocity_scale=1.0,
    )


def _sources(current: Estimate, item: EffectPlacement, values: tuple[float, ...], motion: Motion) -> list[Source]:
    effect, drive, n = item.effect, current.trajectory.drive, current.assembly.plant.n_states
    n_all = current.trajectory.states.shape[1]
    if isinstance(effect, ForceEffect):
        if effect.n_memory:
            memory = memory_along(effect, values, motion, drive)
            if memory is None:
                return []
            motion = replace(motion, memory=memory)
        histories = effect.screen_columns(values, motion)
        _, port = item.force_and_port
        return [
            force_response(drive, current.scheme, column, history, n_all)
            for column in port.columns
            for history in histories.T
        ]
    if isinstance(effect, SensorEffect):
        slopes = effect.by_parameter(effect.neutral, motion.displacement, motion.time)
        found = []
        for slope in slopes.T:
            sensed = np.zeros_like(current.trajectory.outputs)
            sensed[:, item.channel] = slope
            found.append(Source(sensed=sensed))
        return found
    moved = values
    if values == effect.neutral:
        moved = tuple(value + 1.0 for value in values)
    lone = Assembly(plant=current.assembly.plant, placements=(item,))
    changed = drive_inputs(lone, _plain(lone, moved, drive.n_records), drive)
    flow = np.zeros((drive.n_times, n_all))
    flow[:, :n] = (changed.start - drive.start) @ current.scheme.B0.T + (changed.end - drive.end) @ current.scheme.B1.T
    direct = (changed.sample - drive.sample)[drive.rows] @ current.scheme.D.T
    if not flow.any() and not direct.any():
        return []
    return [Source(flow=flow, outputs=direct)]


def _plain(lone: Assembly, values: tuple[float, ...], n_records: int) -> Unknowns:
    unknowns = initial_unknowns(lone, n_records)
    unknowns.common[lone.n_linear :] = [values[j] for j in lone.placements[0].common]
    return unknowns


def _peaks(current: Estimate, problem: Problem) -> tuple[float, ...]:
    """Frequencies of the highest peaks of what the model leaves, outputs in units of their residual."""
    drive = problem.drive
    residual = np.where(drive.present, drive.outputs - current.trajectory.outputs, 0.0)
    length = min(drive.row_firsts[r + 1] - drive.row_firsts[r] for r in range(drive.n_records))
    power = np.zeros(length // 2 + 1)
    window = np.hanning(length)
    for record in range(drive.n_records):
        part = residual[drive.rows_of(record)][:length]
        scale = np.maximum(part.std(axis=0), TINY)
        power += np.sum(np.abs(np.fft.rfft((part - part.mean(axis=0)) / scale * window[:, None], axis=0)) ** 2, axis=1)
    dt = drive.dt * (int(drive.rows[1]) if len(drive.rows) > 1 else 1)
    frequencies = np.fft.rfftfreq(length, dt)
    inner = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])) + 1
    order = inner[np.argsort(-power[inner])]
    chosen: list[int] = []
    for index in order:
        if index > 1 and all(abs(index - other) > 3 for other in chosen):
            chosen.append(int(index))
        if len(chosen) == N_PEAKS:
            break
    return tuple(float(frequencies[index]) for index in chosen)
