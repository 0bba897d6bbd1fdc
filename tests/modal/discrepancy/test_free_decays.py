"""Free decays of a mass with friction: what is held out begins in motion, and at rest friction holds the mass."""

import numpy as np
import pytest

from modal.discrepancy import CATALOGUE, diagnose
from modal.structure.structural_model import StructuralModel
from okid.record import Record

DT, SUBSTEPS, FRICTION, NOISE, N = 0.004, 100, 0.8, 1e-4, 300
STIFFNESS, DAMPING = 600.0, 0.6


def decay(start, n=N):
    """1 kg let go at rest from `start`; between turns the force of friction is constant, and a mass that turns where
    the spring is weaker than friction stays."""
    step = DT / SUBSTEPS
    x, v, way, stuck = start, 0.0, -np.sign(start), False
    found = np.empty(n)
    for k in range(n):
        found[k] = x
        for _ in range(0 if stuck else SUBSTEPS):
            middle = v + 0.5 * step * (-STIFFNESS * x - DAMPING * v - FRICTION * way)
            next_v = v + step * (-STIFFNESS * (x + 0.5 * step * v) - DAMPING * middle - FRICTION * way)
            x += step * middle
            v = next_v
            if v * way < 0.0:
                v, way = 0.0, -way
                if STIFFNESS * abs(x) <= FRICTION:
                    stuck = True
                    break
    return found


def test_friction_is_named_from_decays_alone():
    random = np.random.default_rng(4)
    records = [
        Record(np.zeros((N, 0)), decay(start) + NOISE * random.standard_normal(N), DT, output_names=["x"])
        for start in (0.02, 0.05, 0.035)
    ]
    nothing = np.zeros((1, 0))
    model = StructuralModel(
        [[1.0]], [[0.75]], [[624.0]], force_map=nothing, sensor_map=[[1.0]], sensor_kind="displacement"
    )
    rivals = ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "bouc_wen_hysteresis", "gap_spring")
    found = diagnose(model, records[:2], records[2], catalogue={key: CATALOGUE[key] for key in rivals})
    assert found.status == "named"
    assert [one.effect for one in found.findings] == ["coulomb_friction"]
    assert found.findings[0].parameters[0].value == pytest.approx(FRICTION, rel=0.01)
