"""Rules of decision on both sides, on made-up models with given errors."""

import numpy as np
import pytest
from made_up_nodes import N, made_up, made_up_task

from modal.discrepancy import decision
from modal.discrepancy.absorbed_gain import AbsorbedGain
from modal.discrepancy.decision import decide_nodes
from modal.discrepancy.nodes import counts, log_likelihood_gain


@pytest.fixture(scope="module")
def task():
    return made_up_task()


@pytest.fixture(autouse=True)
def absorbed(monkeypatch):
    """A gain that a free calibration has taken up, and what it saves: none, unless a test appends one."""
    offered = []
    monkeypatch.setattr(decision, "absorbed_gain", lambda _root, _task: offered[0] if offered else None)
    return offered


@pytest.fixture(autouse=True)
def twins(monkeypatch):
    """Models with a law that is nearly the same: none, unless a test appends some."""
    offered = []
    monkeypatch.setattr(decision, "with_twins", lambda _node, _task, _fitted: offered)
    return offered


@pytest.fixture(autouse=True)
def limits(monkeypatch):
    """Simpler laws that `with_limits` offers for the best model: none, unless a test appends some."""
    offered = []
    monkeypatch.setattr(decision, "with_limits", lambda _node, _task: offered)
    return offered


def test_the_gain_is_that_of_two_variances(task):
    before, after = made_up(4.0), made_up(2.0, "cubic_stiffness", fit=1.0)
    assert log_likelihood_gain(before, after, task) == pytest.approx(N * np.log(4.0) + N * np.log(2.0))
    assert log_likelihood_gain(made_up(2.0), made_up(0.1), task) == pytest.approx(2 * N * np.log(4.0))  # floor / 2
    assert log_likelihood_gain(before, made_up(None), task) == -np.inf


def test_a_step_counts_when_error_and_likelihood_both_say_so(task):
    root = made_up(2.0)
    assert counts(root, made_up(1.79, "cubic_stiffness"), task)
    assert not counts(root, made_up(1.81, "cubic_stiffness"), task)
    assert not counts(root, made_up(1.5, "cubic_stiffness", fit=2.7), task)  # the records to fit got worse
    assert not counts(root, made_up(None, "cubic_stiffness"), task)


def test_named(task):
    best = made_up(1.02, "cubic_stiffness")
    found = decide_nodes([made_up(50.0), made_up(3.0, "quadratic_drag"), best], task)
    assert found.status == "named"
    assert found.node is best
    assert found.reasons == ()
    assert found.runners[0].effects == (("quadratic_drag", "ground"),)
    assert found.margins[0] == pytest.approx(2 * N * np.log(3.0 / 1.02))


def test_none(task):
    root = made_up(1.1)
    found = decide_nodes([root, made_up(1.05, "cubic_stiffness")], task)
    assert (found.status, found.node) == ("none", root)
    assert found.runners == found.margins == found.reasons == ()


def test_a_gain_that_only_the_model_as_given_shows_is_never_firm(task, absorbed):
    root, gain, without = made_up(1.1), made_up(1.1, "sensor_gain"), made_up(1.09)
    absorbed.append(AbsorbedGain(node=gain, without=without, fall=42.0))
    found = decide_nodes([root], task)
    assert (found.status, found.node, found.runners, found.margins) == ("unresolved", gain, (without,), (42.0,))
    assert "2 ln L lower by 42" in found.reasons[0]
    root = made_up(1.1, "cubic_stiffness")  # it stood in the model as given
    assert decide_nodes([root], task).runners == (None, without)
    assert decide_nodes([made_up(1.6)], task).reasons[0].startswith("no effect of the catalogue")


def test_a_gap_that_nothing_closes_is_unresolved(task):
    root = made_up(5.0)
    found = decide_nodes([root, made_up(4.9, "cubic_stiffness"), made_up(None, "gap_spring")], task)
    assert (found.status, found.node) == ("unresolved", root)
    assert "no effect" in found.reasons[0]


@pytest.mark.parametrize(("level", "status"), [(1.49, "named"), (1.51, "unresolved")])
def test_a_name_needs_the_floor(task, level, status):
    found = decide_nodes([made_up(50.0), made_up(level, "cubic_stiffness")], task)
    assert found.status == status
    assert bool(found.reasons) == (status == "unresolved")
    assert all("1.23 times the noise floor (limit 1.22)" in reason for reason in found.reasons)


def test_a_law_that_is_nearly_the_same_is_a_rival_that_the_search_may_have_lost(task, twins):
    nodes = [made_up(50.0), made_up(1.02, "cubic_stiffness")]
    assert decide_nodes(nodes, task).status == "named"
    twins.append(made_up(1.021, "sine_softening"))
    found = decide_nodes(nodes, task)
    assert (found.status, found.node, found.runners[0]) == ("unresolved", nodes[1], twins[0])
    assert "sine softening" in found.reasons[0]
    twins[:] = [made_up(1.019, "sine_softening")]
    found = decide_nodes(nodes, task)
    assert (found.status, found.node, found.runners[0]) == ("unresolved", twins[0], nodes[1])


@pytest.mark.parametrize(
    ("rival", "status"), [(1.02 * np.exp(31 / 2 / N), "named"), (1.02 * np.exp(25 / 2 / N), "unresolved")]
)
def test_a_name_needs_a_lead(task, rival, status):
    nodes = [made_up(50.0), made_up(1.02, "gap_spring"), made_up(rival, ("cubic_stiffness", "ground"))]
    if status == "named":
        # gap_spring has two parameters more, which cost 2 ln(2 N): take a rival that loses by more than that
        nodes[2] = made_up(1.02 * np.exp(60 / 2 / N), "cubic_stiffness")
    found = decide_nodes(nodes, task)
    assert found.status == status
    if status == "unresolved":
        assert "nearly as well" in found.reasons[0]


def test_the_same_effect_at_another_place_needs_a_lead_too(task):
    nodes = [made_up(50.0), made_up(1.02, "cubic_stiffness"), made_up(1.021, ("cubic_stiffness", "between"))]
    found = decide_nodes(nodes, task)
    assert found.status == "unresolved"
    assert "between" in found.reasons[0]


def test_a_rival_that_cannot_be_told_apart_by_structure_does_not_block(task):
    nodes = [made_up(50.0), made_up(1.02, ("input_gain", "push")), made_up(1.0201, ("sensor_gain", "place"))]
    assert decide_nodes(nodes, task).status == "unresolved"
    one = decide_nodes(nodes, task, circumstances=frozenset({"one_dof"}))
    assert one.status == "named"
    assert one.runners[0].effects == (("sensor_gain", "place"),)


@pytest.mark.parametrize(("floors", "chosen"), [(1.0, "gap_spring"), (200.0, "cubic_stiffness")])
def test_far_above_the_floor_only_the_held_out_error_decides(task, floors, chosen):
    """One is a little better on held-out records, the other on all: what is left decides which one counts."""
    unseen = made_up(1.00 * floors, "cubic_stiffness", fit=1.40 * floors)
    likely = made_up(1.02 * floors, "gap_spring", fit=1.20 * floors)
    found = decide_nodes([made_up(5000.0), unseen, likely], task)
    assert found.node.effects[0][0] == chosen
    assert found.status == ("named" if floors == 1.0 else "unresolved")


def test_fewer_effects_that_do_as_well_are_preferred(task, monkeypatch):
    monkeypatch.setattr(decision, "without", lambda node, i, task: made_up(50.0))
    one = made_up(1.05, "cubic_stiffness")
    two = made_up(1.0, "cubic_stiffness", "quadratic_drag")
    found = decide_nodes([made_up(50.0), two, one], task)
    assert found.node is one


@pytest.mark.parametrize(("z", "n_effects"), [(4.9, 1), (5.1, 2)])
def test_an_effect_within_five_deviations_of_none_is_dropped(task, monkeypatch, z, n_effects):
    alone = made_up(1.4, "cubic_stiffness")
    monkeypatch.setattr(
        decision, "without", lambda node, i, task: alone if node.effects[i][0] == "quadratic_drag" else made_up(40.0)
    )
    monkeypatch.setattr(decision, "sureness", lambda node, task: [60.0, z])
    found = decide_nodes([made_up(50.0), made_up(1.0, "cubic_stiffness", "quadratic_drag")], task)
    assert len(found.node.effects) == n_effects


def test_an_effect_of_uncertain_size_stays_where_the_likelihood_needs_it(task, monkeypatch):
    """A hard brim: any large rate will do, so the rate's deviation is large; without it the model is far off."""
    monkeypatch.setattr(decision, "without", lambda node, i, task: made_up(40.0, "cubic_stiffness"))
    monkeypatch.setattr(decision, "sureness", lambda node, task: [60.0, 1.0])
    found = decide_nodes([made_up(50.0), made_up(1.0, "cubic_stiffness", "overflow")], task)
    assert len(found.node.effects) == 2


@pytest.mark.parametrize(("root", "status"), [(1.4, "none"), (50.0, "unresolved")])
def test_nothing_is_missing_only_where_the_linear_model_explains_the_data(task, monkeypatch, root, status):
    """All effects were dropped as needless one by one: that alone does not make the linear model right."""
    monkeypatch.setattr(decision, "_pruned", lambda best, root, task: root)
    found = decide_nodes([made_up(root), made_up(1.0, "cubic_stiffness")], task)
    assert (found.status, found.node.effects) == (status, ())
    assert bool(found.reasons) == (status == "unresolved")


def test_an_effect_that_does_not_earn_its_place_is_dropped(task, monkeypatch):
    monkeypatch.setattr(decision, "sureness", lambda node, task: [np.inf] * len(node.effects))
    alone = made_up(1.05, "cubic_stiffness")
    monkeypatch.setattr(
        decision, "without", lambda node, i, task: alone if node.effects[i][0] == "quadratic_drag" else made_up(40.0)
    )
    found = decide_nodes([made_up(50.0), made_up(1.0, "cubic_stiffness", "quadratic_drag")], task)
    assert found.node is alone
    monkeypatch.setattr(decision, "without", lambda node, i, task: made_up(40.0, "cubic_stiffness"))
    found = decide_nodes([made_up(50.0), made_up(1.0, "cubic_stiffness", "quadratic_drag")], task)
    assert len(found.node.effects) == 2
    assert len(found.runners) == len(found.margins) == 2
    assert found.margins == (np.inf, np.inf)


def test_every_effect_has_the_runner_that_lacks_it(task, monkeypatch):
    monkeypatch.setattr(decision, "sureness", lambda node, task: [np.inf] * len(node.effects))
    monkeypatch.setattr(decision, "without", lambda node, i, task: made_up(40.0))
    both = made_up(1.0, "cubic_stiffness", "quadratic_drag")
    first, second = made_up(3.0, "cubic_stiffness"), made_up(5.0, "quadratic_drag")
    found = decide_nodes([made_up(50.0), first, second, both], task)
    assert found.runners == (second, first)
    assert found.status == "named"


def test_nothing_is_missing_only_where_the_fitted_records_agree_too(task):
    from dataclasses import replace

    root = made_up(1.0)
    bad = replace(root, fitted=made_up(58.0).held_out)
    assert decide_nodes([root], task).status == "none"
    assert decide_nodes([bad], task).status == "unresolved"


@pytest.mark.parametrize(
    ("gain", "status"),
    [
        (0.85, "named"),
        (2.9, "named"),
        (1000.0, "unresolved"),
        (0.0174, "unresolved"),
        (1.011, "named"),
        (1.009, "unresolved"),
        (0.991, "unresolved"),
    ],
)
def test_a_gain_like_a_wrong_unit_or_hardly_off_one_is_never_firm(gain, status):
    from types import SimpleNamespace

    from modal.discrepancy.decision import Decision
    from modal.discrepancy.doubted_units import doubted_units

    item = SimpleNamespace(effect=SimpleNamespace(key="input_gain"), where="input_0")
    assembly = SimpleNamespace(placements=(item,), common_of=lambda _: slice(0, 1))
    coarse = SimpleNamespace(assembly=assembly, unknowns=SimpleNamespace(common=np.array([gain])))
    decision = Decision(status="named", node=SimpleNamespace(coarse=coarse), runners=(), margins=(), reasons=())
    found = doubted_units(decision)
    assert found.status == status
    assert bool(found.reasons) == (status == "unresolved")


@pytest.mark.parametrize(("held_out", "fit", "chosen"), [(1.04, 1.01, 0), (1.06, 1.01, 1), (1.04, 1.2, 0)])
def test_a_law_is_replaced_by_its_limit_unless_the_held_out_error_tells_them_apart(task, limits, held_out, fit, chosen):
    limit = made_up(held_out, "gap_spring", fit=fit)
    limits.append(limit)
    found = decide_nodes([made_up(50.0), made_up(1.0, "slack_in_hysteresis")], task)
    assert found.node.effects[0][0] == ("gap_spring", "slack_in_hysteresis")[chosen]


@pytest.mark.parametrize(("fit", "status"), [(1.01, "named"), (1.06, "unresolved")])
def test_a_richer_law_unsettles_its_limit_only_where_it_clearly_fits_better(task, limits, fit, status):
    """2 ln L is 20 or 68 lower without the further parameter; the held-out error falls by less than a tenth."""
    limits.append(made_up(1.01, "gap_spring", fit=fit))
    found = decide_nodes([made_up(50.0), made_up(1.0, "slack_in_hysteresis")], task)
    assert found.node.effects == (("gap_spring", "ground"),)
    assert found.status == status
    assert bool(found.reasons) == (status == "unresolved")


def test_a_richer_law_elsewhere_is_a_rival_like_any_other(task):
    rich, best = made_up(1.01, ("slack_in_hysteresis", "element_1")), made_up(1.0, ("gap_spring", "element_0"))
    assert decide_nodes([made_up(50.0), rich, best], task).status == "unresolved"


def test_a_limit_is_not_looked_for_where_the_gap_is_open(task, limits):
    limits.append(made_up(1.9, "gap_spring"))
    found = decide_nodes([made_up(50.0), made_up(1.8, "slack_in_hysteresis")], task)
    assert found.node.effects == (("slack_in_hysteresis", "ground"),)


@pytest.mark.parametrize(("fit", "status"), [(1.9, "named"), (2.1, "unresolved")])
def test_what_explains_the_held_out_records_only_is_not_firm(task, fit, status):
    found = decide_nodes([made_up(50.0), made_up(1.02, "coulomb_friction", fit=fit)], task)
    assert found.status == status
    assert [words for words in found.reasons if "on the records to fit" in words] == list(found.reasons)


@pytest.mark.parametrize(("n_effects", "status"), [(1, "named"), (2, "named"), (3, "unresolved")])
def test_three_effects_at_once_are_not_firm(task, monkeypatch, n_effects, status):
    monkeypatch.setattr(decision, "without", lambda node, i, task: made_up(50.0))
    monkeypatch.setattr(decision, "sureness", lambda node, task: [100.0] * len(node.effects))
    keys = ["cubic_stiffness", "quadratic_drag", "coulomb_friction"][:n_effects]
    found = decide_nodes([made_up(50.0), made_up(1.02, *keys)], task)
    assert found.status == status
    assert len(found.node.effects) == n_effects
    known = made_up(50.0, "sine_softening")  # effects that the model had already are none of them
    found = decide_nodes([known, made_up(1.02, "sine_softening", *keys[:2])], task)
    assert found.status == "named"


@pytest.mark.parametrize(
    ("untried", "held_out", "said"),
    [(1, 1.0, True), (2, 1.0, False), (np.inf, 1.0, False), (2, 4.0, True), (np.inf, 4.0, True), (None, 4.0, False)],
)
def test_what_a_search_left_untried_is_said_where_it_might_matter(untried, held_out, said):
    """Larger models matter only where the best one does not explain the data."""
    task = made_up_task()
    if untried is not None:
        task.budget.refuse(untried)
    decision = decide_nodes([made_up(50.0), made_up(held_out, "cubic_stiffness")], task)
    assert any("ended before" in words for words in decision.reasons) == said
    assert (decision.status == "named") == (held_out == 1.0 and not said)


def test_a_search_that_was_cut_does_not_say_that_no_effect_of_the_catalogue_helps():
    task = made_up_task()
    task.budget.refuse(1)
    decision = decide_nodes([made_up(1.3, fit=20.0)], task)
    assert decision.status == "unresolved"
    assert decision.reasons[0].startswith("no effect that was tried")
    assert "ended before" in decision.reasons[1]
