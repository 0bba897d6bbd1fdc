"""A first guess that lets the motion escape is weakened until it does not."""

from types import SimpleNamespace

import numpy as np
import pytest
from engine_plants import some_records, two_masses, with_effects

from modal.discrepancy import within_reach as module
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem
from modal.discrepancy.within_reach import amplitudes, scaled, within_reach


def situation(key):
    plant = two_masses()
    drive = drive_of(some_records(plant, missing=0.0))
    assembly, unknowns = with_effects(plant, [key], drive.n_records)
    task = SimpleNamespace(fit=Problem(drive=drive, floor=np.full((drive.n_records, plant.n_outputs), 1e-4)))
    return assembly, unknowns, task, np.zeros((drive.n_times, plant.n_states + assembly.n_memory))


@pytest.mark.parametrize(
    ("key", "factor"), [("cubic_stiffness", 0.2), ("sine_softening", 5.0), ("input_saturation", 5.0)]
)
def test_a_weaker_law_is_a_smaller_amplitude_or_a_larger_length(key, factor):
    assembly, unknowns, _, _ = situation(key)
    at = assembly.common_of(0).start
    weaker = scaled(assembly, unknowns, 0.2)
    assert weaker.common[at] == pytest.approx(factor * unknowns.common[at])
    assert [index for index, _ in amplitudes(assembly)] == [at]


@pytest.mark.parametrize(
    ("errors", "share"),  # in units of the error of no motion at all, at the whole strength, half and a fifth of it
    [((99.0, 1.0, 1.0), 1.0), ((101.0, 1.0, 1.0), 0.5), ((101.0, None, 1.0), 0.2), ((300.0, None, 200.0), 1.0)],
)
def test_a_motion_that_escapes_without_leaving_the_range_of_numbers_is_weakened_too(monkeypatch, errors, share):
    assembly, unknowns, task, states = situation("cubic_stiffness")
    at, silent = assembly.common_of(0).start, np.sum((task.fit.drive.outputs * task.fit.weights) ** 2)
    left = iter(errors)

    def simulated(_assembly, tried, *_args, **_options):
        error = next(left)
        return None if error is None else SimpleNamespace(squares=error * silent, strength=tried.common[at])

    monkeypatch.setattr(module, "simulate_at", simulated)
    found = within_reach(assembly, unknowns, task, states, smoothing=0.0)
    assert found.strength == pytest.approx(share * unknowns.common[at])
