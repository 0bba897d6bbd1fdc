import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import initial_state, modal_system, simulate

from modal.estimation.free_run import free_runs
from modal.preparation.quick_model import quick_model
from okid.record import Record


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_it_finds_the_modes_and_leaves_the_noise(noise):
    rng = np.random.default_rng(1)
    system = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015])
    inputs = random_inputs(rng, 2500, 2)
    clean = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    record = Record(inputs, with_noise(rng, clean, noise) / clean.std(axis=0) + 3.0, system.dt)
    quick = quick_model([record])
    assert quick.error == pytest.approx(noise, rel=0.1, abs=2e-2)
    found = np.abs(np.log(quick.form.poles)) / (2 * np.pi * system.dt)
    for frequency in system.frequencies:
        assert np.abs(found - frequency).min() < 0.005 * frequency
    (run,) = free_runs(quick.form, [record])
    assert np.sqrt(np.mean(np.square(run - record.outputs))) == pytest.approx(quick.error)


def test_data_that_no_model_can_be_made_of_give_none():
    record = Record(np.zeros(100) + np.arange(100.0) % 2, np.where(np.arange(100) % 2, np.nan, 1.0), 0.1)
    assert quick_model([record]) is None
