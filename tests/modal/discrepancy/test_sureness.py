"""How sure an effect is: Wald's test where that holds, the outputs where it does not."""

from types import SimpleNamespace

import numpy as np
import pytest
from brim_problem import tank_with
from engine_plants import some_records, two_masses, with_effects

from modal.discrepancy import sureness as module
from modal.discrepancy.covariance import covariance
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, estimate, simulate_at
from modal.discrepancy.sureness import sureness


def fitted(assembly, unknowns, problem, iterations=20):
    found = estimate(simulate_at(assembly, unknowns, problem), problem, iterations=iterations)
    return SimpleNamespace(coarse=found), SimpleNamespace(fit=problem)


def beside_stiffness(keys, *, noise, seed=2, floor_to_noise=1.0):
    """Two masses with effects, fitted to their own noisy records; the floor may be lower than the noise."""
    plant = two_masses()
    drive = drive_of(some_records(plant, lengths=(150, 120)))
    assembly, unknowns = with_effects(plant, keys, 2)
    problem = Problem(drive=drive, floor=np.full((2, plant.n_outputs), floor_to_noise * noise**2))
    exact = simulate_at(assembly, unknowns, problem).trajectory.outputs
    measured = exact + noise * np.random.default_rng(seed).standard_normal(exact.shape)
    drive = type(drive)(**{name: getattr(drive, name) for name in drive.__slots__} | {"outputs": measured})
    return fitted(assembly, unknowns, Problem(drive=drive, floor=problem.floor))


def wald(node, task, placement):
    """A parameter over its standard deviation: the first one of an effect."""
    found = node.coarse
    at = found.assembly.common_of(placement).start
    return abs(found.unknowns.common[at]) / np.sqrt(covariance(found, task.fit)[at, at])


@pytest.mark.parametrize("floor_to_noise", [1.0, 0.1])
@pytest.mark.parametrize("noise", [0.01, 0.3])
def test_of_an_effect_in_proportion_to_one_parameter_it_is_the_parameter_over_its_deviation(noise, floor_to_noise):
    keys = ["constant_force", "cubic_stiffness"]
    node, task = beside_stiffness(keys, noise=noise, floor_to_noise=floor_to_noise)
    # the cubic spring bends the response to a constant force a little
    assert sureness(node, task)[0] == pytest.approx(wald(node, task, 0), rel=0.05)


def test_so_it_is_of_a_delay_which_has_no_amplitude():
    node, task = beside_stiffness(["input_delay"], noise=0.05)
    assert sureness(node, task)[0] == pytest.approx(wald(node, task, 0), rel=0.2)


def test_a_hard_brim_is_sure_although_any_large_rate_would_do():
    node, task = fitted(*tank_with("overflow", rate=50.0, noise=0.01))
    assert wald(node, task, 0) < 5.0
    assert sureness(node, task)[0] > 100.0


def test_a_brim_that_no_level_reaches_is_none():
    assembly, unknowns, problem = tank_with("overflow", noise=0.01)
    common = unknowns.common.copy()
    common[-2:] = 100.0, 50.0
    empty = simulate_at(assembly, type(unknowns)(common=common, local=unknowns.local), problem)
    assert sureness(SimpleNamespace(coarse=empty), SimpleNamespace(fit=problem)) == pytest.approx([0.0], abs=1e-9)


def test_a_needless_effect_is_within_chance_of_none():
    """Nothing constant flows into this tank: of the needed one beside it that is another matter."""
    node, task = fitted(*tank_with("overflow", "constant_force", rate=50.0, noise=0.01))
    needed, needless = sureness(node, task)
    assert needed > 100.0
    assert needless < 4.0


def test_an_effect_without_which_the_motion_escapes_is_needed(monkeypatch):
    node, task = fitted(*tank_with("overflow", rate=50.0, noise=0.01), iterations=2)
    monkeypatch.setattr(module, "run_without", lambda *_, **__: None)
    assert sureness(node, task) == [np.inf]
