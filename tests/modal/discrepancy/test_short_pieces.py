"""A decay cut into pieces of less than two cycles: their spectra show no noise apart from the motion.

The motion is in closed form: a linear oscillator between reversals, each about a rest point that friction has moved.
"""

import numpy as np
import pytest

from modal.discrepancy import CATALOGUE, diagnose
from modal.structure.structural_model import StructuralModel
from okid.record import Record

DT, TURNS, NOISE, LENGTH = 0.02, 2 * np.pi * 1.3, 2e-3, 70
KEYS = ("coulomb_friction", "quadratic_drag", "cubic_stiffness")


def decay(friction, seed, damping=0.01):
    """(280,) x of x'' + 2 z w x' + w^2 (x + f sign(x')) = 0 from x = 1, x' = 0, and white noise."""
    times, x = DT * np.arange(4 * LENGTH), np.empty(4 * LENGTH)
    turning, begun, place = TURNS * np.sqrt(1 - damping**2), 0.0, 1.0
    while begun < times[-1] and abs(place) > friction:
        centre, half = np.sign(place) * friction, np.pi / turning
        there = (times >= begun) & (times <= begun + half)
        phase = turning * (times[there] - begun)
        swing = np.cos(phase) + damping * TURNS / turning * np.sin(phase)
        x[there] = centre + (place - centre) * np.exp(-damping * TURNS * (times[there] - begun)) * swing
        place = centre - (place - centre) * np.exp(-damping * TURNS * half)
        begun += half
    x[times > begun] = place  # it stops
    return x + NOISE * np.random.default_rng(seed).standard_normal(len(x))


def diagnosed(friction, seed):
    x = decay(friction, seed)
    model = StructuralModel(
        [[1.0]], [[0.024 * TURNS]], [[1.03 * TURNS**2]], force_map=np.zeros((1, 0)), sensor_map=[[1.0]],
        sensor_kind="displacement", length_unit="rad", force_unit="N m",
    )  # fmt: skip
    starts = range(0, len(x), LENGTH)
    parts = [Record(np.zeros((LENGTH, 0)), x[k : k + LENGTH], DT, output_units=["rad"]) for k in starts]
    return diagnose(model, parts[::2], parts[1::2], catalogue={key: CATALOGUE[key] for key in KEYS})


@pytest.mark.parametrize(("friction", "seed"), [(0.0, 0), (0.03, 0), (0.03, 1)])
def test_the_floor_gives_way_to_what_the_best_model_leaves(friction, seed):
    """Four floors were 5 to 30 times the noise, and friction of a third of the loss was "none"."""
    found = diagnosed(friction, seed)
    assert [one.effect for one in found.findings] == (["coulomb_friction"] if friction else [])
    assert found.status == ("named" if friction else "none")
    assert np.abs(np.log(found.noise_floor.variance / NOISE**2)).max() < np.log(2.0)
    assert any("taken for what the best model leaves" in words for words in found.warnings)
    if friction:
        ((value,),) = [[one.value for one in finding.parameters] for finding in found.findings]
        assert abs(value - friction * TURNS**2) < 0.05 * friction * TURNS**2
