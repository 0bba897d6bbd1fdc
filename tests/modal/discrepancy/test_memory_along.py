"""States of laws with memory along a given motion, against a plain march from sample to sample."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from modal.discrepancy import memory_along as module
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.effects.effect import Motion
from modal.discrepancy.memory_along import memory_along

DT = 0.01
LENGTHS = (700, 400)


def motion_of(n_memory, smoothing=0.01):
    """Several sines of different size in each record, with the velocity that belongs to them."""
    parts = []
    for number, n in enumerate(LENGTHS):
        t = DT * np.arange(n)
        sizes, speeds = (1.0 + number) * np.array([1.0, 0.4, 0.3]), np.array([3.0, 7.7, 13.1])
        parts.append(np.stack([np.sin(np.outer(t, speeds)) @ sizes, np.cos(np.outer(t, speeds)) @ (sizes * speeds), t]))
    x, v, t = np.concatenate(parts, axis=1)
    return Motion(
        displacement=x, velocity=v, time=t, memory=np.zeros((len(x), n_memory)), displacement_scale=float(x.std()),
        velocity_scale=float(v.std()), smoothing=np.full(len(x), smoothing),
    )  # fmt: skip


def drive():
    return SimpleNamespace(n_times=sum(LENGTHS), firsts=(0, LENGTHS[0], sum(LENGTHS)), dt=DT)


def marched(effect, values, motion):
    """Sample by sample from rest."""
    z = np.zeros_like(motion.memory)

    def at(k):
        rows = slice(k, k + 1)
        return replace(
            motion, displacement=motion.displacement[rows], velocity=motion.velocity[rows], time=motion.time[rows],
            memory=z[rows], smoothing=motion.smoothing[rows],
        )  # fmt: skip

    for first, n in ((0, LENGTHS[0]), (LENGTHS[0], LENGTHS[1])):
        for k in range(first, first + n - 1):
            z[k + 1] = effect.advance(values, at(k), at(k + 1), DT).value[0]
    return z


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("bouc_wen_hysteresis", (1.0, 0.3, 2.0)),
        ("bouc_wen_hysteresis", (1.0, 0.02, 1.0)),
        ("slack_in_hysteresis", (1.0, 0.2, 0.1)),
        ("slack_in_hysteresis", (1.0, 0.01, 1.0)),
        ("missing_mode", (0.1, 1.3, 0.05)),
    ],
)
def test_it_is_what_a_march_from_sample_to_sample_gives(key, values):
    effect = CATALOGUE[key]
    motion = motion_of(effect.n_memory)
    found = memory_along(effect, values, motion, drive())
    wanted = marched(effect, values, motion)
    assert np.abs(found - wanted).max() <= 2e-6 * np.abs(wanted).max()


def test_a_rate_independent_law_is_solved_for_at_the_turns_alone():
    motion = motion_of(1)
    nodes = module._nodes(motion, np.array([0, LENGTHS[0]]))
    turns = np.flatnonzero(np.diff(np.sign(np.diff(motion.displacement))))
    assert len(nodes) < 0.25 * sum(LENGTHS)
    assert {0, LENGTHS[0] - 1, LENGTHS[0], sum(LENGTHS) - 1} <= set(nodes.tolist())
    assert all({k, k + 1} & set(nodes.tolist()) for k in turns.tolist())
