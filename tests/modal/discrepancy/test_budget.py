"""A search that may cost only so much says so, and gives what it has."""

import numpy as np
import pytest
from made_up_nodes import made_up, made_up_task

from modal.discrepancy import search as beam
from modal.discrepancy import setup as ground
from modal.discrepancy.banded import band_of, solve_band
from modal.discrepancy.budget import OVERHEAD, Budget, add_work, work_done
from modal.discrepancy.search import search_effects
from modal.discrepancy.workflow import diagnose
from modal.structure import StructuralModel
from okid.record import Record


def test_a_solve_counts_its_rows_of_states_and_what_a_call_costs():
    before = work_done()
    solve_band(band_of(np.zeros((2, 2, 50))), np.ones((3, 50, 2)))
    assert work_done() - before == 50 * 2 + OVERHEAD


def test_a_stage_that_is_not_finished_marks_the_whole_and_a_part_does_not():
    whole = Budget(10_000.0 + OVERHEAD)
    part, stage = whole.part(0.5), whole.stage()
    add_work(8000, 1)
    assert not part.allows()
    assert whole.allows()
    assert not whole.spent
    assert not stage.allows()
    assert whole.spent


@pytest.mark.parametrize(
    ("cut", "untried"),
    [
        ((), 1),  # one effect that was not tried might explain it all
        (("gap_spring",), np.inf),  # the models beside it need not all be tried: beside another all is explained
        (("cubic_stiffness",), 2),  # rivals of the model that explains the data were not tried
    ],
)
def test_only_what_bears_on_the_result_counts_as_left_untried(monkeypatch, cut, untried):
    levels = {
        (): {"gap_spring": 10.0, "cubic_stiffness": 15.0},
        ("gap_spring",): {"quadratic_drag": 8.0},
        ("cubic_stiffness",): {"quadratic_drag": 1.0},
    }

    def expand(node, task):
        keys = tuple(key for key, _ in node.effects)
        if keys == cut:
            task.budget.refuse()
        return [made_up(level, *keys, key) for key, level in levels.get(keys, {}).items()]

    monkeypatch.setattr(beam, "expand", expand)
    task = made_up_task()
    found = search_effects(made_up(50.0), task)
    assert min(node.held_out_level for node in found) == 1.0
    assert task.budget.untried == untried


def test_where_nothing_explains_the_data_any_cut_counts(monkeypatch):
    def expand(node, task):
        if not node.effects:
            task.budget.refuse()
            return [made_up(10.0, "gap_spring")]
        return []

    monkeypatch.setattr(beam, "expand", expand)
    task = made_up_task()
    search_effects(made_up(50.0), task)
    assert task.budget.untried == 1


def struck(size, seed, n=1500, dt=0.02, substeps=10):
    """One mass of 1 kg on 100 N/m and a cubic spring, pushed at random, by semi-implicit Euler."""
    push = size * np.repeat(np.random.default_rng(seed).standard_normal(n // 5), 5)
    x = v = 0.0
    outputs = np.empty(n)
    for k, u in enumerate(push):
        outputs[k] = x
        for _ in range(substeps):
            v += dt / substeps * (u - 0.6 * v - 100.0 * x - 4000.0 * x**3)
            x += dt / substeps * v
    noise = 1e-4 * np.random.default_rng(seed + 100).standard_normal(n)
    return Record(push, outputs + noise, dt, input_hold="zero_order")


def test_a_diagnosis_that_runs_out_of_work_gives_its_best_guess_and_says_so(monkeypatch):
    model = StructuralModel.chain([1.0], [100.0], [0.6], force_dofs=[0], sensor_dofs=[0])
    records = [struck(0.5, 0), struck(1.0, 1)], struck(0.8, 2)
    whole = diagnose(model, *records)
    assert [one.effect for one in whole.findings][:1] == ["cubic_stiffness"]
    assert not any("ended before" in words for words in whole.warnings)
    monkeypatch.setattr(ground, "MOST_WORK", 20.0)
    hasty = diagnose(model, *records)
    assert hasty.status == "unresolved"
    assert any("the search was ended before every effect was tried" in words for words in hasty.warnings)
