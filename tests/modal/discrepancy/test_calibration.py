"""A calibration whose free run is out of step with the record from the first beat on."""

import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy import calibration as module
from modal.discrepancy.calibration import fitted_either_way
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, estimate, simulate_at
from modal.discrepancy.given import given_model, placed_assembly
from modal.discrepancy.setup import prepare_setup, roots
from modal.discrepancy.workflow import diagnose


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


def test_bounds_are_moved_out_where_that_explains_all_and_only_then():
    """A stiffness that is 45 % off, and the same beside a friction that is missing."""
    for law, explained in ((None, True), (lambda d, v, t: 1.5 * np.sign(v), False)):
        fit, held_out, _ = experiment(law, n_samples=500)
        given = given_model(nominal(stiffnesses=(55.0,)), tuple(fit))
        setup = prepare_setup(given, tuple(fit), tuple(held_out), {}, lambda *_: None)
        _, root = roots(setup)
        upper = given.plant.parameters[0].upper
        value = root.coarse.unknowns.common[0]
        assert (value > upper) == explained
        if explained:
            assert value == pytest.approx(100.0, rel=5e-3)
            assert root.held_out_level < 1.2


def test_the_reader_is_told_what_lies_beyond_its_tolerance():
    fit, held_out, _ = experiment(n_samples=500)
    found = diagnose(nominal(stiffnesses=(55.0,)), list(fit), list(held_out))
    assert found.status == "none"
    assert any("lies beyond the tolerance" in words and "stiffness of element_0" in words for words in found.warnings)
