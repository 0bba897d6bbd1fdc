"""The ground of a diagnosis: no floor below what a simulation can follow, whatever the records or a model say."""

from dataclasses import replace

import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy import setup as module
from modal.discrepancy.given import given_model
from modal.discrepancy.setup import prepare_setup, roots, with_uncovered_floor

THOUSANDTH = 1e-3


@pytest.fixture(scope="module")
def prepared():
    """Records without noise, and the calibrated model along them."""
    fit, held_out, _ = experiment(n_samples=400, noise=0.0)
    made = prepare_setup(given_model(nominal(), tuple(fit)), tuple(fit), tuple(held_out), {}, lambda *_: None)
    return made, *roots(made)


def test_records_without_noise_are_those_of_another_integrator(prepared):
    setup, *_ = prepared
    sizes = [record.outputs.var(axis=0) for record in (*setup.fit, *setup.held_out)]
    assert setup.floor.variance == pytest.approx(THOUSANDTH**2 * np.array(sizes))
    assert setup.task.fit.floor == pytest.approx(setup.floor.variance[:2])


@pytest.mark.parametrize("share", [1.0, 1e-6])
def test_a_residual_below_that_uncovers_nothing(prepared, monkeypatch, share):
    setup, as_given, root = prepared
    monkeypatch.setattr(module, "lowered_floor", lambda floor, *_: replace(floor, variance=share * floor.variance))
    found, nodes, given = with_uncovered_floor(setup, (root,), as_given)
    assert found is setup
    assert nodes == (root,)
    assert given is as_given


def test_a_lower_floor_counts_for_the_records_and_the_models_alike(prepared, monkeypatch):
    setup, as_given, root = prepared
    noisy = replace(setup.floor, variance=9.0 * setup.floor.variance)
    raised = replace(setup, floor=noisy)
    monkeypatch.setattr(module, "lowered_floor", lambda *_: setup.floor)
    found, (scaled, *_), given = with_uncovered_floor(raised, (root,), as_given)
    assert found.task.fit.floor == pytest.approx(setup.task.fit.floor)
    assert scaled.fit_level == pytest.approx(9.0 * root.fit_level)
    assert given.held_out_level == pytest.approx(9.0 * as_given.held_out_level)
