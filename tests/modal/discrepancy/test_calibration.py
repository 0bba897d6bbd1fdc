"""A calibration whose free run is out of step with the record from the first beat on."""

import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy import calibration as module
from modal.discrepancy.calibration import fitted_either_way
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, estimate, simulate_at
from modal.discrepancy.given import given_model, placed_assembly


def started(stiffness, seed, *, law=None):
    """A mass whose resonance is 1 % wide, the model's stiffness as given."""
    fit, _, variance = experiment(law, n_samples=500, seed=seed, dampings=(0.1,))
    given = given_model(nominal(stiffnesses=(stiffness,), dampings=(0.1,)), tuple(fit))
    drive = drive_of(tuple(fit))
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, drive, {})
    problem = Problem(drive=drive, floor=np.full((2, 1), variance))
    return simulate_at(assembly, unknowns, problem), problem


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("stiffness", [80.0, 118.0])
def test_a_frequency_off_by_many_widths_of_the_resonance_is_found(stiffness, seed):
    start, problem = started(stiffness, seed)
    found = fitted_either_way(start, problem, iterations=12)
    assert found.level < 1.2
    assert found.gain is None  # a free run
    assert found.unknowns.common == pytest.approx([100.0, 0.1], rel=2e-2)


def test_the_free_run_alone_does_not_find_it():
    """Or the way by the observer form would not be needed."""
    levels = [
        estimate(start, problem, iterations=12).level for start, problem in (started(118.0, s) for s in (1, 2, 3))
    ]
    assert max(levels) > 100.0


def test_a_fit_that_explains_the_data_is_not_made_twice(monkeypatch):
    start, problem = started(100.5, 1)
    monkeypatch.setattr(module, "observer_gain", None)
    assert fitted_either_way(start, problem, iterations=12).level < 1.2


def test_the_better_way_is_taken(monkeypatch):
    """Beside a missing friction the observer form may lead elsewhere; a gain that leads astray must not count."""
    start, problem = started(103.0, 1, law=lambda d, v, t: 0.8 * np.sign(v))
    directly = estimate(start, problem, iterations=12)
    assert directly.level > 1.2
    assert fitted_either_way(start, problem, iterations=12).cost <= directly.cost
    with monkeypatch.context() as patch:
        patch.setattr(module, "observer_gain", lambda *_args: np.full((2, 1), -0.05))
        assert fitted_either_way(start, problem, iterations=12).cost <= directly.cost
    monkeypatch.setattr(module, "observer_gain", lambda *_args: None)
    assert fitted_either_way(start, problem, iterations=12).cost == directly.cost
