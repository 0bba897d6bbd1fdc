"""A mass on a spring that is struck with a hammer, slides and is held by friction, seen by an accelerometer."""

import math

import numpy as np
import pytest

from modal.discrepancy import CATALOGUE, diagnose
from modal.structure.structural_model import StructuralModel
from okid.record import Record

DT, SUBSTEPS = 0.001, 20
MASS, STIFFNESS, DAMPING, FRICTION = 1.0, 8000.0, 4.0, 1.5
WIDTH = 0.006


def struck(seed, hits=3, n=600, noise=0.1):
    """Blows of a few milliseconds at random times, some while it still rings; half of it is stuck between them."""
    random = np.random.default_rng(seed)
    times = np.sort(random.uniform(0.05, 0.9 * n * DT, hits))
    sizes = random.uniform(8.0, 25.0, hits)

    def force(t):
        phase = ((t[:, np.newaxis] - times) / WIDTH).clip(0, 1)
        return np.sin(np.pi * phase) ** 2 @ sizes

    step, x, v = DT / SUBSTEPS, 0.0, 0.0
    inputs, outputs = force(DT * np.arange(n)), np.empty(n)
    pushes = force(step * (np.arange(n * SUBSTEPS) + 0.5)).reshape(n, SUBSTEPS).tolist()
    for k in range(n):
        outputs[k] = accelerated(inputs[k], x, v)[0]
        for push in pushes[k]:
            a, _ = accelerated(push, x, v)
            middle = v + 0.5 * step * a
            a, stuck = accelerated(push, x + 0.5 * step * v, middle)
            x, before, v = x + step * middle, v, v + step * a
            if stuck or before * v < 0.0:
                v = 0.0
    return Record(
        inputs,
        outputs + noise * random.standard_normal(n),
        DT,
        input_names=["hammer"],
        output_names=["tip"],
        input_units=["N"],
        output_units=["m/s^2"],
        input_hold="band_limited",
    )


def accelerated(push, x, v):
    """Acceleration, and whether friction holds the mass."""
    rest = push - STIFFNESS * x
    if v == 0.0 and abs(rest) <= FRICTION:
        return 0.0, True
    way = math.copysign(1.0, v if v != 0.0 else rest)
    return (rest - DAMPING * v - FRICTION * way) / MASS, False


def test_friction_is_named_where_it_holds_the_mass_between_the_blows():
    model = StructuralModel.chain([MASS], [7760.0], [2.8], force_dofs=[0], sensor_dofs=[0], sensor_kind="acceleration")
    rivals = ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "bouc_wen_hysteresis", "constant_force")
    catalogue = {key: CATALOGUE[key] for key in rivals}
    found = diagnose(model, [struck(1), struck(2)], struck(3), catalogue=catalogue)
    assert found.status == "named"
    assert [one.effect for one in found.findings] == ["coulomb_friction"]
    assert found.findings[0].parameters[0].value == pytest.approx(FRICTION, rel=0.02)
