"""What was found, in numbers and words."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from engine_plants import VALUES, two_masses, with_effects
from made_up_nodes import N, made_up, made_up_task

from modal.discrepancy.ambiguity import ambiguous_with
from modal.discrepancy.decision import Decision
from modal.discrepancy.findings import even_rivals, findings_of, hypothesis_of

KEYS = ["cubic_stiffness", "missing_mode", "periodic_disturbance"]


def found(n_known=1, margins=(np.inf, 50.0, 70.0), circumstances=("always",)):
    plant = two_masses()
    assembly, unknowns = with_effects(plant, KEYS, 2, port="anywhere")
    node = made_up(1.1, *[(key, "anywhere") for key in KEYS])
    fitted = SimpleNamespace(
        assembly=assembly, unknowns=unknowns, level=node.fitted.level, mean_square=node.fitted.mean_square
    )
    node = replace(node, fitted=fitted)
    root = made_up(21.0, *[(key, "anywhere") for key in KEYS[:n_known]])
    runner = made_up(5.0, ("gap_spring", "between"))
    decision = Decision(status="named", node=node, runners=(None, runner, runner), margins=margins, reasons=())
    deviations = np.arange(1.0, assembly.n_common + 1)
    task = made_up_task()
    found = findings_of(decision, root, task, plant, deviations=deviations, circumstances=frozenset(circumstances))
    return found, task, root, runner


def test_one_finding_an_effect_that_the_model_did_not_have():
    all_of_them, *_ = found(n_known=0)
    assert [one.effect for one in all_of_them] == KEYS
    later, *_ = found(n_known=1)
    assert [one.effect for one in later] == KEYS[1:]
    assert all(one.where == "anywhere" for one in later)


def test_parameters_come_with_deviation_and_unit():
    (mode, hum), *_ = found()
    assert [one.name for one in mode.parameters] == ["mass_ratio", "frequency", "damping"]
    assert [one.value for one in mode.parameters] == list(VALUES["missing_mode"])
    assert [one.unit for one in mode.parameters] == ["", "1/s", ""] or mode.parameters[1].unit == "Hz"
    # two linear parameters, then the cubic stiffness and its direction
    assert [one.std for one in mode.parameters] == [5.0, 6.0, 7.0]
    amplitude, frequency, phase = hum.parameters
    assert (amplitude.std, frequency.std) == (9.0, 10.0)
    assert np.isnan(phase.std)
    assert phase.value == pytest.approx(VALUES["periodic_disturbance"][2] + 0.35)
    assert "mean over the records" in phase.meaning


def test_the_evidence_is_told():
    (mode, _), _, _, runner = found()
    evidence = mode.evidence
    assert evidence.closed == pytest.approx(1 - 0.1 / 20.0)
    assert evidence.log_likelihood == pytest.approx(2 * N * np.log(21.0 / 1.1))
    assert evidence.margin == 50.0
    assert evidence.words == "the held-out gap falls from 4.58 to 1.05 times the noise floor, with the other effects"
    assert mode.runner_up.effects == runner.effects


def test_without_a_rival():
    ((mode, _), *_) = found(margins=(np.inf, np.inf, np.inf))
    assert mode.evidence.margin == np.inf
    assert mode.ambiguous_with == ()


def test_what_it_cannot_be_told_from():
    (mode, _), *_ = found()
    assert mode.ambiguous_with == ()
    (mode, hum), *_ = found(circumstances=("always", "one_level"))
    assert "periodic_disturbance" in mode.ambiguous_with
    assert "missing_mode" in hum.ambiguous_with


@pytest.mark.parametrize(("margin", "listed"), [(-3.0, True), (1.0, True), (29.0, True), (31.0, False)])
@pytest.mark.parametrize(("key", "rival"), [("sensor_bias", "constant_force"), ("constant_force", "sensor_bias")])
def test_where_the_evidence_ties_each_lists_the_other(key, rival, margin, listed):
    decision = Decision(
        status="unresolved",
        node=SimpleNamespace(effects=((key, "output_0"),)),
        runners=(SimpleNamespace(effects=((rival, "output_1"),)),),
        margins=(margin,),
        reasons=(),
    )
    assert even_rivals(decision, 0) == ((rival,) if listed else ())
    rows = ambiguous_with(key, even_with=even_rivals(decision, 0))
    assert any(rival in row.others(key) for row in rows) == listed


def test_a_runner_up_with_the_same_effect_elsewhere_is_no_rival_to_be_told_from_by_kind():
    decision = Decision(
        status="unresolved",
        node=SimpleNamespace(effects=(("sensor_bias", "output_0"),)),
        runners=(SimpleNamespace(effects=(("sensor_bias", "output_1"),)),),
        margins=(1.0,),
        reasons=(),
    )
    assert ambiguous_with("sensor_bias", even_with=even_rivals(decision, 0)) == ()


def test_a_hypothesis_is_a_model_seen_from_the_root():
    _, task, root, runner = found()
    one = hypothesis_of(runner, root, task)
    assert (one.effects, one.fit_level, one.held_out_level) == ((("gap_spring", "between"),), 5.0, 5.0)
    assert one.log_likelihood == pytest.approx(2 * N * np.log(21.0 / 5.0))
    assert hypothesis_of(root, root, task).log_likelihood == 0.0
