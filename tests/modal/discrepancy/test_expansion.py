"""Around which trajectory effects are tried."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy import expansion as module
from modal.discrepancy import observed_fits as fits_module
from modal.discrepancy import promising
from modal.discrepancy.budget import Budget
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, simulate_at
from modal.discrepancy.given import given_model, placed_assembly
from modal.discrepancy.held_out import rested
from modal.discrepancy.observed_fits import observed_fits, observed_form, weaker_form
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
    monkeypatch.setattr(fits_module, "observer_gain", lambda *_args: gain)
    return observed_form(fitted, SimpleNamespace(fit=problem, upsampling=1))


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


def candidate(key, fall, where="ground"):
    return SimpleNamespace(key=key, where=where, fall=fall)


@pytest.mark.parametrize(("best", "n_effects"), [(0.49, 4), (0.51, 1)])
def test_where_no_candidate_convinces_several_effects_are_followed(best, n_effects):
    """A changing stiffness may hide behind a sensor gain that takes ten times as much at first."""
    names = ["sensor_gain", "time_varying_stiffness", "missing_mode", "gap_spring", "input_delay"]
    found = promising._promising([candidate(key, best if k == 0 else 0.01 / k) for k, key in enumerate(names)])
    assert [one.key for one in found] == names[:n_effects]


def test_a_law_too_hard_to_move_starts_again_much_weaker(monkeypatch):
    tried = []

    def within_reach(_assembly, unknowns, *_args, **_options):
        return SimpleNamespace(size=unknowns.common[0])

    def fitted(start, *_args, **_options):
        tried.append(start.size)
        stuck = start.size > 100.0
        return SimpleNamespace(cost=50.0 if stuck else 1.0, iterations=0 if stuck else 4)

    effect = SimpleNamespace(parameters=(SimpleNamespace(role="amplitude"),), neutral=(0.0,))
    assembly = SimpleNamespace(
        placements=(SimpleNamespace(effect=effect, common=(0,)),), common_of=lambda _position: slice(0, 1)
    )
    monkeypatch.setattr(module, "within_reach", within_reach)
    monkeypatch.setattr(module, "estimate", fitted)
    for size, expected in ((500.0, [500.0, 50.0]), (20.0, [20.0])):
        tried.clear()
        unknowns = SimpleNamespace(common=np.array([size]), local=None)
        fit = SimpleNamespace(assembly=assembly, unknowns=unknowns, trajectory=SimpleNamespace(states=None))
        monkeypatch.setattr(module, "rested", lambda start, _problem: start)
        assert module._free_run(fit, SimpleNamespace(fit=None), 0.03).cost == 1.0
        assert tried == expected


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

    def begun(_node, _observed, candidate, _task, *, linear, smoothing):
        assert smoothing == 0.03
        tried.append((candidate.where, linear))
        cost = costs[linear]
        return None if cost is None else begun_fit(candidate, cost, cost, linear=linear, where=candidate.where)

    monkeypatch.setattr(fits_module, "_begun", begun)
    monkeypatch.setattr(fits_module, "_first_smoothing", lambda *_: 0.03)
    coarse = SimpleNamespace(assembly=fitted.assembly, at_bounds=np.array([at_bound, False]))
    node, task = SimpleNamespace(coarse=coarse, effects=effects), SimpleNamespace(budget=Budget())
    candidates = [SimpleNamespace(key="cubic_stiffness", where=name, fall=0.5) for name in "abc"]
    found, left_out = observed_fits(node, fitted, candidates, task)
    assert left_out == []
    assert [(one.where, one.linear) for one in found] == [(name, begin) for name in "abc"]
    assert {linear for candidate, linear in tried if candidate != "a"} == {begin}


def begun_fit(candidate, cost, level, *, ended=True, **more):
    fit = SimpleNamespace(cost=cost, level=level, iterations=1, **more)
    return fits_module._Begun(candidate=candidate, fit=fit, ended=ended)


def candidate_of(key, fall, where="element_0"):
    return SimpleNamespace(key=key, where=where, fall=fall)


@pytest.mark.parametrize(
    ("key", "where", "fall", "level", "outdone"),
    [
        ("gap_spring", "element_0", 0.19, 5.0, True),  # the screen promised less than half, and 95 % is explained
        ("gap_spring", "element_0", 0.21, 5.0, False),
        ("gap_spring", "element_0", 0.19, 6.5, False),  # too much is left
        ("cubic_stiffness", "element_0", 0.3, 1.4, True),  # the same law from another of its shapes
        ("cubic_stiffness", "element_0", 0.3, 1.6, False),
        ("cubic_stiffness", "element_1", 0.3, 1.4, False),
    ],
)
def test_what_promised_much_less_is_not_fitted_once_a_fit_explains_nearly_everything(key, where, fall, level, outdone):
    leader = begun_fit(candidate_of("cubic_stiffness", 0.4), 100.0, level)
    observed = SimpleNamespace(level=101.0)
    assert fits_module._outdone(candidate_of(key, fall, where), leader, observed) == outdone


def test_what_is_outdone_is_not_begun_and_does_not_ask_for_work(current, monkeypatch):
    fitted, _ = current
    begun = []

    def begin(_node, _observed, candidate, _task, **_options):
        begun.append(candidate.key)
        return begun_fit(candidate, 100.0, 1.0)

    monkeypatch.setattr(fits_module, "_begun", begin)
    monkeypatch.setattr(fits_module, "_first_smoothing", lambda *_: 0.03)
    coarse = SimpleNamespace(assembly=fitted.assembly, at_bounds=np.array([True, False]))
    candidates = [candidate_of(key, fall) for key, fall in (("a", 0.8), ("b", 0.5), ("c", 0.3))]
    task = SimpleNamespace(budget=Budget())
    observed = SimpleNamespace(level=50.0)
    _, left_out = observed_fits(SimpleNamespace(coarse=coarse, effects=()), observed, candidates, task)
    assert (begun, left_out) == (["a", "b"], candidates[2:])
    spent = SimpleNamespace(budget=Budget(0.0))
    observed_fits(SimpleNamespace(coarse=coarse, effects=()), observed, [candidates[0], candidates[2]], spent)
    assert not spent.budget.spent


@pytest.mark.parametrize(("level", "begun"), [(2.0, [["a", "b", "c"]]), (40.0, [["a", "b", "c"], ["c"]])])
def test_what_was_left_out_is_fitted_where_the_leader_fails_in_free_run(monkeypatch, level, begun):
    """An observer that follows the outputs closely hides how much a model leaves."""
    asked = []

    def fits(_node, _observed, candidates, _task):
        asked.append([one.key for one in candidates])
        return [], [one for one in candidates if one.key == "c" and len(asked) == 1]

    candidates = [candidate_of(key, fall) for key, fall in (("a", 0.8), ("b", 0.5), ("c", 0.3))]
    monkeypatch.setattr(module, "seen", lambda *_: (None, candidates))
    monkeypatch.setattr(module, "observed_fits", fits)
    monkeypatch.setattr(module, "_free_runs", lambda *_: ([], {}))
    monkeypatch.setattr(module, "_judged", lambda *_, **__: [SimpleNamespace(fit_level=level)])
    node = SimpleNamespace(held_out_level=50.0, fit_level=50.0, effects=())
    module.expand(node, None)
    assert asked == begun


def test_nothing_is_outdone_beside_a_model_that_explains_the_data_as_it_is():
    """Levels below 1 are those of a floor that is too high: a fit that is worse than none would look clear."""
    leader = begun_fit(candidate_of("cubic_stiffness", 0.4), 100.0, 0.97)
    assert not fits_module._outdone(candidate_of("gap_spring", 0.1), leader, SimpleNamespace(level=0.95))


def fit_of(key, cost, where="element_0"):
    item = SimpleNamespace(effect=CATALOGUE[key], where=where)
    return SimpleNamespace(assembly=SimpleNamespace(placements=(item,)), cost=cost)


@pytest.mark.parametrize(
    ("rich", "where", "kept"),
    [
        (99.0, "element_0", ["coulomb_friction", "bouc_wen_hysteresis"]),
        (101.0, "element_0", ["coulomb_friction"]),  # its own fit has gone astray
        (101.0, "element_1", ["coulomb_friction", "bouc_wen_hysteresis"]),
    ],
)
def test_a_law_that_fits_no_better_than_its_limit_is_followed_through_the_limit(rich, where, kept):
    fits = [fit_of("coulomb_friction", 100.0), fit_of("bouc_wen_hysteresis", rich, where)]
    found = module._worth(fits, SimpleNamespace(cost=1000.0))
    assert [fit.assembly.placements[-1].effect.key for fit in found] == kept


def test_a_limit_is_not_followed_through_the_richer_law():
    fits = [fit_of("coulomb_friction", 100.0), fit_of("bouc_wen_hysteresis", 50.0)]
    assert len(module._worth(fits, SimpleNamespace(cost=1000.0))) == 2


@pytest.mark.parametrize(
    ("cost", "where", "order"),
    [
        (104.0, "element_0", ["gap_spring", "coulomb_friction", "bouc_wen_hysteresis"]),
        (151.0, "element_0", ["gap_spring", "bouc_wen_hysteresis", "coulomb_friction"]),  # fits clearly worse
        (104.0, "element_1", ["gap_spring", "bouc_wen_hysteresis", "coulomb_friction"]),  # no limit of it
    ],
)
def test_a_limit_of_a_richer_law_is_followed_before_it_where_it_fits_nearly_as_well(cost, where, order):
    ranked = [fit_of("gap_spring", 90.0), fit_of("bouc_wen_hysteresis", 100.0), fit_of("coulomb_friction", cost, where)]
    assert [fit.assembly.placements[0].effect.key for fit in module._ordered(ranked)] == order


@pytest.mark.parametrize(
    ("gain", "level", "best", "every"),
    [(None, 50.0, 0.2, True), ("some", 50.0, 0.2, False), (None, 5.0, 0.2, False), (None, 50.0, 0.6, False)],
)
def test_every_effect_is_tried_where_the_screen_goes_along_a_wrong_motion_and_knows_little(
    monkeypatch, gain, level, best, every
):
    """What a struck mass under friction shows to a screen along the linear motion is friction of the wrong sign."""
    bounded = [candidate_of("input_gain", best), candidate_of("missing_mode", 0.15)]
    others = [
        ("coulomb_friction", 0.02),
        ("quadratic_drag", 0.015),
        ("quadratic_drag", 0.012),
        ("coulomb_friction", 0.01),
    ]
    turned = [*bounded, *(candidate_of(*one) for one in others)]
    screens = {"bounded": bounded, "turned": turned}
    monkeypatch.setattr(promising, "screen_candidates", lambda *_, signs="bounded": screens[signs])
    found = promising._candidates(
        SimpleNamespace(gain=gain, level=level), bounded, SimpleNamespace(fit=None, catalogue={})
    )
    extra = turned[2:4] if every else []
    assert found == [*bounded, *extra]


def test_a_fit_begins_at_rest_where_initial_states_only_made_up_for_a_missing_law():
    fit, _, variance = experiment(lambda d, v, t: 0.0, n_samples=300, levels=(1.0, 2.0, 1.0))
    given = given_model(nominal(), tuple(fit))
    problem = Problem(drive=drive_of(tuple(fit), 2), floor=np.full((len(fit), 1), variance))
    assembly, unknowns = placed_assembly(given.plant, given.linear, (), problem.drive)
    rest = simulate_at(assembly, unknowns, problem)
    assert rested(rest, problem) is rest
    odd = simulate_at(assembly, replace(unknowns, local=unknowns.local + 0.5), problem)
    assert rested(odd, problem).cost == pytest.approx(rest.cost)


@pytest.mark.parametrize(
    ("strong", "weak", "cost", "taken"),
    [
        (0.2, 0.31, 99.0, True),
        (0.2, 0.29, 99.0, False),
        (0.51, 0.9, 99.0, False),
        (0.2, None, 99.0, False),
        (0.2, 0.31, 101.0, False),  # worse than no correction at all
    ],
)
def test_a_weaker_gain_is_taken_where_it_shows_much_more(monkeypatch, strong, weak, cost, taken):
    """A tuned mass of a hundredth is hidden by an observer that follows the outputs too closely."""
    observed = SimpleNamespace(gain="whole", fall=strong)
    weaker = SimpleNamespace(gain="weak", fall=weak, cost=cost)
    monkeypatch.setattr(promising, "observed_form", lambda *_: observed)
    monkeypatch.setattr(promising, "weaker_form", lambda *_: None if weak is None else weaker)
    monkeypatch.setattr(promising, "screen_candidates", lambda form, *_: [candidate_of("missing_mode", form.fall)])
    found, candidates = promising.seen(
        SimpleNamespace(coarse=SimpleNamespace(cost=100.0)), SimpleNamespace(fit=None, catalogue={})
    )
    assert found is (weaker if taken else observed)
    assert [one.fall for one in candidates] == [weak if taken else strong]


def test_the_weaker_gain_is_a_tenth_and_of_none_there_is_none(current):
    fitted, problem = current
    gain = observer_gain(fitted, problem, 1)
    task = SimpleNamespace(fit=problem)
    observed = simulate_at(fitted.assembly, fitted.unknowns, problem, gain=gain)
    assert weaker_form(observed, task).gain == pytest.approx(0.1 * gain)
    assert weaker_form(fitted, task) is None


def test_close_rivals_of_the_best_are_followed_in_whatever_order(monkeypatch):
    """A limit that was pulled forward must not end the loop before a better fit behind it."""
    fits = [fit_of("gap_spring", 90.0), fit_of("bouc_wen_hysteresis", 100.0), fit_of("coulomb_friction", 149.0)]
    tried = []

    def free_run(fit, *_):
        tried.append(fit.cost)
        return SimpleNamespace(cost=fit.cost, level=1.0)

    monkeypatch.setattr(module, "_free_run", free_run)
    monkeypatch.setattr(module, "_found_again", lambda run, *_: run)
    monkeypatch.setattr(module, "_finished", lambda *_: SimpleNamespace(held_out_level=1.0))
    ordered = module._ordered(fits)
    assert [fit.cost for fit in ordered] == [90.0, 149.0, 100.0]
    module._free_runs(ordered, SimpleNamespace(budget=Budget()), SimpleNamespace(effects=()))
    assert tried == [90.0, 100.0]


@pytest.mark.parametrize(
    ("cost", "fall", "ended", "level", "gone_on"),
    [
        (299.0, 0.1, False, 100.0, True),  # not far behind the best one
        (301.0, 0.1, False, 100.0, False),
        (301.0, 0.1, True, 100.0, False),
        (299.0, 0.1, True, 100.0, False),  # it ended by itself
        (301.0, 0.21, False, 100.0, True),  # promised half as much, while the best one explains too little
        (301.0, 0.21, False, 1.4, False),
    ],
)
def test_long_fits_are_gone_on_with_where_they_may_still_lead(monkeypatch, *, cost, fall, ended, level, gone_on):
    ran = []

    def estimate(start, _problem, **_options):
        ran.append(start.cost)
        return start

    monkeypatch.setattr(fits_module, "estimate", estimate)
    best = begun_fit(candidate_of("cubic_stiffness", 0.4), 100.0, level)
    other = begun_fit(candidate_of("gap_spring", fall), cost, 500.0, ended=ended)
    done = fits_module._finished([other, best], SimpleNamespace(fit=None), Budget())
    assert [fit.cost for fit in done] == [100.0, cost]
    assert ran == ([cost] if gone_on else [])


def test_a_fit_that_leads_after_all_ends_the_others(monkeypatch):
    """The leader of the first round may be an unfinished one, and far better once it is fitted to its end."""
    ran = []

    def estimate(start, _problem, **_options):
        ran.append(start.cost)
        return SimpleNamespace(cost=start.cost / 10.0, level=1.0, iterations=9)

    monkeypatch.setattr(fits_module, "estimate", estimate)
    race = [begun_fit(candidate_of(key, 0.4), cost, 500.0, ended=False) for key, cost in (("a", 100.0), ("b", 250.0))]
    assert [fit.cost for fit in fits_module._finished(race, SimpleNamespace(fit=None), Budget())] == [
        10.0,
        250.0,
    ]
    assert ran == [100.0]
