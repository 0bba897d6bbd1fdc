"""What the search need not fit: counted, because these rules change cost only."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import modal
import okid
from modal.discrepancy.selection import beam
from modal.discrepancy.setup import prepare_setup, roots
from modal.effects.catalogue import CATALOGUE
from modal.structure.given import given_model, simulate


def prepared(model, fits, held_out, keys):
    catalogue = {key: CATALOGUE[key] for key in keys}
    setup = prepare_setup(given_model(model, fits), fits, (held_out,), catalogue, lambda *_: None)
    return roots(setup)[1], setup.task


def records_with(effect, **values):
    """A model, and records of three levels of one that has an effect besides."""
    model = modal.StructuralModel.chain([1.0], [900.0], [1.2], force_dofs=[0], sensor_dofs=[0])
    truth = model.with_effect(effect, "element_0", **values)
    rng, records = np.random.default_rng(9201), []
    for level in (2.0, 6.0, 4.0):
        run = simulate(truth, level * rng.standard_normal((300, 1)), dt=0.01)
        noise = 0.01 * run.outputs.std() * rng.standard_normal(run.outputs.shape)
        records.append(okid.Record(run.inputs, run.outputs + noise, run.dt))
    return model, records[:-1], records[-1]


def test_no_richer_law_runs_free_where_its_limit_leaves_only_noise(monkeypatch):
    root, task = prepared(*records_with("coulomb_friction", Fc=0.6), ["coulomb_friction", "stribeck_friction"])
    followed, run = [], beam._free_run

    def counted(fit, *rest):
        followed.append(fit.assembly.placements[-1].effect.key)
        return run(fit, *rest)

    monkeypatch.setattr(beam, "_free_run", counted)
    beam.expand(root, task)
    assert followed == ["coulomb_friction"]


def test_a_curve_that_leaves_more_than_a_name_in_free_run_is_not_followed(monkeypatch):
    root, task = prepared(*records_with("cubic_stiffness", k3=3e6), ["gap_spring"])  # near it, but not all
    asked = []

    def curves(_parent, _root, given):
        asked.append(given)
        return []

    monkeypatch.setattr(beam, "MOST_EFFECTS", 1)
    beam.search_effects(root, task, curves=curves)
    assert asked[0].reached < root.fit_level
    monkeypatch.setattr(beam, "_free_run", lambda fit, *_: pytest.fail(f"{fit.level} was followed"))
    beam.expand(root, replace(asked[0], reached=0.0))


def test_a_law_that_explains_the_data_with_other_masses_goes_before_one_that_leads_without(monkeypatch):
    """Another effect beside the leader costs many times what the masses do, and the true law is then never reached."""
    levels, asked = {"stops": 80.0, "cubic": 1.05, "curve": 1.0}, []

    def released(node, _task):
        asked.append(node.effects[0])
        return SimpleNamespace(held_out_level=levels[node.effects[0]])

    monkeypatch.setattr(beam, "with_released_masses", released)
    monkeypatch.setattr(beam, "_named", str)
    front = [SimpleNamespace(effects=(name,), held_out_level=100.0) for name in levels]
    task = SimpleNamespace(budget=SimpleNamespace(left=1.0), report=lambda *_: None)
    ordered = beam._masses_first(front, task)
    assert [node.effects[0] for node, _ in ordered] == ["cubic", "stops", "curve"]
    assert asked == ["stops", "cubic"]  # none is fitted for nothing, nor twice
    assert [heavier is None for _, heavier in ordered] == [False, False, True]
    task.budget.left = 0.0
    assert beam._masses_first(front, task) == [(node, None) for node in front]
    assert asked == ["stops", "cubic"]  # what is spent is spent
