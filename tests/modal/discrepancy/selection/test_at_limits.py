"""A law that has come to its limit is told as that limit, also where the records hold more than it explains."""

import numpy as np
import pytest

from modal.discrepancy.diagnosis import decide
from modal.structure.structural_model import StructuralModel
from okid.record import Record

INERTIA, LOSS, FRICTION, DT, N_STEPS = 1.0, 0.5, 0.2, 0.04, 40


def turned(rng, level, n_samples=500):
    """A motor with dry friction and a slow torque that nobody measured; its speed has noise of a hundredth."""
    drive = np.repeat(level * rng.standard_normal(n_samples // 10), 10)
    phase, speed, w = rng.uniform(0, 2 * np.pi), np.empty(n_samples), 0.0
    for k, u in enumerate(drive):
        speed[k] = w
        for step in range(N_STEPS):
            gust = 0.1 * np.sin(1.3 * DT * (k + step / N_STEPS) + phase) * np.cos(0.37 * DT * k)
            w += DT / N_STEPS * (u + gust - LOSS * w - FRICTION * np.tanh(w / 0.003)) / INERTIA
    return Record(drive, speed + 0.01 * speed.std() * rng.standard_normal(n_samples), DT)


@pytest.mark.parametrize("seed", [2, 5, 6])
def test_friction_without_an_excess_is_coulomb_friction(seed):
    rng = np.random.default_rng(seed)
    records = [turned(rng, level) for level in (1.0, 3.0, 2.0)]
    motor = StructuralModel(
        np.array([[INERTIA]]), np.array([[0.9 * LOSS]]), np.array([[0.0]]), force_map=np.array([[1.0]]),
        sensor_map=np.array([[1.0]]), sensor_kind="velocity",
    )  # fmt: skip
    richer = motor.with_effect("stribeck_friction", "element_0", Fc=0.15, excess=0.01, stribeck_velocity=0.3)
    found = decide([motor, richer], fit=records[:2], held_out=records[2:])
    assert found.status == "unresolved"
    assert [one.effect for one in found.findings] == ["coulomb_friction"]
    (friction,) = found.findings[0].parameters
    assert abs(friction.value - FRICTION) < 0.1 * FRICTION
