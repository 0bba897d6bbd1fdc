"""Around which trajectory effects are tried."""

from types import SimpleNamespace

import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy import expansion as module
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, simulate_at
from modal.discrepancy.given import given_model, placed_assembly
from modal.discrepancy.observer import observer_gain


@pytest.fixture
def current():
    """A spring too soft by half, so that the free run is far from the records."""
    fit, _, variance = experiment(n_samples=300)
    given = given_model(nominal(stiffnesses=(50.0,)), tuple(fit))
    drive = drive_of(tuple(fit))
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, drive, {})
    problem = Problem(drive=drive, floor=np.full((2, 1), variance))
    return simulate_at(assembly, unknowns, problem), problem


def observed(current, gain, monkeypatch):
    fitted, problem = current
    monkeypatch.setattr(module, "observer_gain", lambda *_args: gain)
    return module._observed(fitted, SimpleNamespace(fit=problem, upsampling=1))


def test_the_observer_form_is_taken_where_it_is_nearer_to_the_data(current, monkeypatch):
    fitted, problem = current
    found = observed(current, observer_gain(fitted, problem, 1), monkeypatch)
    assert found.gain is not None
    assert found.cost < fitted.cost


def test_a_correction_that_leads_astray_is_not_taken(current, monkeypatch):
    """A sensor with a wrong sign or gain pulls the states away from the truth."""
    fitted, problem = current
    astray = -0.05 * observer_gain(fitted, problem, 1)
    assert observed(current, astray, monkeypatch) is fitted


def test_the_model_stays_as_it_is_where_no_correction_is_needed(current, monkeypatch):
    assert observed(current, None, monkeypatch) is current[0]


@pytest.mark.parametrize(
    ("calibrated", "given", "at_bound", "effects", "begin"),
    [
        (100.0, 95.0, False, (), "calibrated"),  # hardly better: the calibration stands
        (100.0, 50.0, False, (), "given"),
        (None, 50.0, False, (), "given"),
        (100.0, None, False, (), "calibrated"),
        (100.0, 50.0, False, (("cubic_stiffness", "element_0"),), "calibrated"),
        (50.0, 100.0, True, (), "given"),
    ],
)
def test_all_start_from_the_linear_parameters_that_lead_the_first_further(
    current, monkeypatch, *, calibrated, given, at_bound, effects, begin
):
    fitted, _ = current
    costs = {"calibrated": calibrated, "given": given}
    tried = []

    def fit(_node, _observed, candidate, _task, *, linear):
        tried.append((candidate, linear))
        cost = costs[linear]
        return None if cost is None else SimpleNamespace(cost=cost, linear=linear, candidate=candidate)

    monkeypatch.setattr(module, "_observed_fit", fit)
    coarse = SimpleNamespace(assembly=fitted.assembly, at_bounds=np.array([at_bound, False]))
    found = module._observed_fits(SimpleNamespace(coarse=coarse, effects=effects), fitted, ["a", "b", "c"], None)
    assert [(one.candidate, one.linear) for one in found] == [(name, begin) for name in "abc"]
    assert {linear for candidate, linear in tried if candidate != "a"} == {begin}
