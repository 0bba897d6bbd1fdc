"""A budget in CPU seconds: kept, and what is left untried is said."""

import time

import pytest
from everyday_mistakes import mistake

import modal
import okid
from modal.discrepancy import CATALOGUE, diagnose
from modal.discrepancy.selection import form_free
from modal.discrepancy.selection.form_free import curves_beside
from modal.discrepancy.setup import prepare_setup, roots
from modal.simulation import trajectory
from modal.simulation.scheme import OVERHEAD, cpu_seconds, work_done
from modal.structure.given import given_model
from okid.errors import InvalidDataError


def given(catalogue=("cubic_stiffness", "quadratic_drag", "missing_mode", "gap_spring")):
    """A record that none of these effects explains."""
    case = mistake("record_offset", 1002)
    model = modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[0], sensor_dofs=[0], sensor_kind="displacement"
    )
    records = [okid.Record(u, y, case.dt) for u, y in case.records]
    return (model, records[:-1], records[-1]), {key: CATALOGUE[key] for key in catalogue}


def test_a_search_ends_with_its_budget_and_says_so():
    road, catalogue = given()
    start = time.process_time()
    found = diagnose(*road, catalogue=catalogue, budget=0.05)  # less than any machine needs to try the first effect
    assert time.process_time() - start < 3.0
    assert found.status == "unresolved"
    assert any("ended before every effect was tried" in words for words in found.warnings)
    assert "catalogue explains" not in found.verdict  # most of it was not even tried


def test_no_curve_is_begun_after_the_budget():
    (model, fits, held_out), _ = given()
    setup = prepare_setup(given_model(model, fits), fits, (held_out,), CATALOGUE, lambda *_: None)
    _, root = roots(setup)
    before = work_done()
    with cpu_seconds(1e-9):
        assert curves_beside(root, root, setup.task) == []
    assert work_done() == before


def test_curves_that_were_not_found_are_not_sought_again(monkeypatch):
    sought = []
    monkeypatch.setattr(form_free, "curves_beside", lambda parent, *_: sought.append(parent) or [])
    curves, root, other = form_free.CurveSearch(), object(), object()
    assert [curves(one, root, None) for one in (root, other, root)] == [[], [], []]
    assert sought == [root, other]


def test_a_budget_is_a_positive_number():
    road, catalogue = given()
    with pytest.raises(InvalidDataError, match="positive number of CPU seconds"):
        diagnose(*road, catalogue=catalogue, budget=0.0)


def test_every_look_at_a_force_along_the_records_is_counted(monkeypatch):
    """It costs more than the solve that it leads to, and trials that are taken back lead to none."""
    looks = []

    def counted(*args, **options):
        looks.append(len(args[4]))
        return linearise(*args, **options)

    linearise = trajectory.linearise
    monkeypatch.setattr(trajectory, "linearise", counted)
    road, _ = given()
    stiff = road[0].with_effect("cubic_stiffness", "element_0", k3=1e6)
    before = work_done()
    modal.simulate(stiff, road[2].inputs, dt=road[2].dt)
    solves = work_done() - before - sum(2 * rows + OVERHEAD for rows in looks)
    assert len(looks) > 2
    assert solves >= (len(looks) - 1) * (2 * looks[0] + OVERHEAD) / 2  # half of the looks at most were taken back
