"""An effect's own states along a given motion, by Newton's method on the whole of it.

A rate-independent law goes straight through where the motion does not turn round: it depends on the turning points
alone. These are solved for first, a small share of the samples, and all others follow from the last one before them.
"""

from dataclasses import replace

import numpy as np

from modal.effects.effect import ForceEffect, Motion, Values
from modal.simulation.banded import band_of, solve_band
from modal.simulation.drive import Drive, IndexArray
from okid.arrays import TINY, BoolArray, FloatArray

__all__ = ["memory_along"]

TRIES, MISS = 40, 1e-6
"""Iterations, and the last change that counts as none, as a share of the largest state."""


def memory_along(effect: ForceEffect, values: Values, motion: Motion, drive: Drive) -> FloatArray | None:
    """The states of an effect that remembers.

    Args:
        effect: The effect.
        values: Its parameters.
        motion: Motion at its place, at all times of the drive.
        drive: The records; each begins without memory.

    Returns:
        (n_times, n_memory); None where they do not settle.
    """
    firsts = np.array(drive.firsts[:-1])
    if not effect.rate_independent:
        return _solved(effect, values, motion, nodes=np.arange(drive.n_times), firsts=firsts, dt=drive.dt)
    nodes = _nodes(motion, firsts)
    found = _solved(effect, values, motion, nodes=nodes, firsts=np.searchsorted(nodes, firsts), dt=drive.dt)
    return None if found is None else _filled(effect, values, motion, nodes=nodes, found=found, dt=drive.dt)


def _nodes(motion: Motion, firsts: IndexArray) -> IndexArray:
    """First and last samples of records, and those between which the motion may turn round."""
    way = np.sign(np.diff(motion.displacement))
    speed = np.sign(motion.velocity)
    same = (speed[:-1] * speed[1:] > 0.0) & (speed[:-1] == way)
    same[firsts[1:] - 1] = False
    inner = np.zeros(len(motion.displacement), dtype=np.bool_)
    inner[1:-1] = same[:-1] & same[1:] & (way[:-1] == way[1:])
    return np.flatnonzero(~inner)


def _solved(
    effect: ForceEffect, values: Values, motion: Motion, *, nodes: IndexArray, firsts: IndexArray, dt: float
) -> FloatArray | None:
    """The states at the nodes."""
    following = np.minimum(np.arange(len(nodes)) + 1, len(nodes) - 1)
    straight = nodes[following] > nodes + 1
    lasts = np.append(firsts[1:], len(nodes)) - 1
    z = np.zeros((len(nodes), effect.n_memory))
    begin, end = _taken(motion, nodes, straight), _taken(motion, nodes[following], straight)
    for _ in range(TRIES):
        step = effect.advance(values, replace(begin, memory=z), replace(end, memory=z[following]), dt)
        forcing = np.zeros((1, *z.shape))
        forcing[0, 1:] = (step.value - z[following])[:-1]
        forcing[0, firsts] = -z[firsts]
        transitions = step.by_memory.transpose(1, 2, 0).copy()
        transitions[:, :, lasts] = 0.0
        change = solve_band(band_of(transitions), forcing)[0]
        z = z + change
        if not np.isfinite(z).all():
            return None
        if np.abs(change).max() <= MISS * max(np.abs(z).max(), TINY):
            return z
    return None


def _filled(
    effect: ForceEffect, values: Values, motion: Motion, *, nodes: IndexArray, found: FloatArray, dt: float
) -> FloatArray:
    """The states at all samples, straight from the last node before each."""
    last = np.searchsorted(nodes, np.arange(len(motion.displacement)), side="right") - 1
    straight = np.ones(len(last), dtype=np.bool_)
    begin = replace(_taken(motion, nodes[last], straight), memory=found[last])
    end = replace(_taken(motion, np.arange(len(last)), straight), memory=found[last])
    return effect.advance(values, begin, end, dt).value


def _taken(motion: Motion, rows: IndexArray, straight: BoolArray) -> Motion:
    """The motion at some samples; without a velocity a step is a straight line."""
    return replace(
        motion,
        displacement=motion.displacement[rows],
        velocity=np.where(straight, 0.0, motion.velocity[rows]),
        time=motion.time[rows],
        memory=motion.memory[rows],
        smoothing=np.broadcast_to(motion.smoothing, motion.displacement.shape)[rows],
    )
