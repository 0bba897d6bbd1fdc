"""How many steps a sample needs."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import imposed_motion, some_records, two_masses

from modal.discrepancy.plant import plant_matrices
from modal.discrepancy.steps import steps_per_sample

FASTEST = np.abs(np.linalg.eigvals(plant_matrices(two_masses(), two_masses().nominal).A)).max() / (2 * np.pi)


def steps(dt, hold="linear"):
    plant = two_masses()
    record = replace(some_records(plant)[0], dt=dt, input_hold=hold)
    return steps_per_sample(plant, plant.nominal, [record])


@pytest.mark.parametrize(("hold", "wanted"), [("linear", 16), ("zero_order", 16), ("band_limited", 30)])
def test_every_resonance_gets_its_steps(hold, wanted):
    for per_period in (50.0, 15.0, 7.0, 5.5):
        dt = 1 / (FASTEST * per_period)
        found = steps(dt, hold)
        assert found * per_period >= wanted or found == 6
        assert found == 1 or (found - 1) * per_period < wanted


def test_a_resonance_above_the_nyquist_frequency_does_not_count():
    assert steps(1 / (FASTEST * 1.5)) < 6 or np.isclose(FASTEST, 0)
    plant = two_masses()
    slow = replace(some_records(plant)[0], dt=10.0)
    assert steps_per_sample(plant, plant.nominal, [slow]) == 1


def test_without_states_one_is_enough():
    plant = imposed_motion()
    assert steps_per_sample(plant, plant.nominal, some_records(plant)) == 1
