"""Order and number of steps chosen together: scored on rows that the refinement did not see, stopped where it loses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from systems import initial_state, modal_system, simulate
from textbook_output_error import LoopModel, loop_run

from modal.estimation.cross_validation import Trial, corner, prepare_ground, training_decomposition
from modal.estimation.modal_parameters import starting_parameters
from modal.estimation.output_error import refine
from modal.identification import order_search
from modal.identification import refined_search as refined_choice
from modal.identification.order_search import MOST_STEPS, search
from modal.identification.refined_search import output_error_data, refined_search
from okid.record import Record


def linear_record(seed, *, n_samples=1200, noise=0.1, frequencies=(6.0, 17.0), damping_ratios=(0.02, 0.03)):
    rng = np.random.default_rng(seed)
    truth = modal_system(rng, frequencies=frequencies, damping_ratios=damping_ratios, n_inputs=1, n_outputs=2)
    u = rng.standard_normal((n_samples, 1))
    y = simulate(truth, u, initial_state=initial_state(rng, truth, u))
    return centred(u, y + noise * y.std(axis=0) * rng.standard_normal(y.shape), truth.dt)


def friction_record(seed, *, n_samples=1500, friction=0.5, noise=0.01):
    """Two masses, Coulomb friction on the first, by small steps of a loop (semi-implicit Euler)."""
    rng = np.random.default_rng(seed)
    dt, n_small = 0.05, 20
    u = np.repeat(rng.standard_normal(-(-n_samples // 2)), 2)[:n_samples]
    x, v = np.zeros(2), np.zeros(2)
    y = np.empty((n_samples, 2))
    for k in range(n_samples):
        y[k] = x
        for _ in range(n_small):
            spring = 60.0 * (x[1] - x[0]) + 0.3 * (v[1] - v[0])
            force = np.array([u[k] - 40.0 * x[0] - 0.2 * v[0] - friction * np.tanh(50 * v[0]) + spring, -spring])
            v = v + dt / n_small * force
            x = x + dt / n_small * v
    return centred(u[:, np.newaxis], y + noise * y.std(axis=0) * rng.standard_normal(y.shape), dt)


def centred(u, y, dt):
    return Record(u - u.mean(axis=0), y - y.mean(axis=0), dt)


def both_searches(record, **given):
    found = search([record], **given)
    return found.ground, found, refined_search(found)


@pytest.fixture(scope="module")
def linear():
    return both_searches(linear_record(1), observer_order=30)


@pytest.fixture(scope="module")
def friction():
    return both_searches(friction_record(2))


def test_every_row_is_in_one_block_with_the_fold_that_holds_it_out():
    rng = np.random.default_rng(3)
    outputs = rng.standard_normal((300, 2))
    outputs[40:47, 0] = np.nan
    inputs = rng.standard_normal((300, 1))
    records = [Record(inputs, outputs, 0.1), Record(inputs[:200] + 1, outputs[:200] + 1, 0.1)]
    ground = prepare_ground(records)
    data = output_error_data(ground)
    for r, record in enumerate(records):
        np.testing.assert_array_equal(data.rows[r], ~np.isnan(record.outputs).any(axis=1))
        labels = np.concatenate([np.full(b.last - b.first, b.label) for b in data.blocks if b.record == r])
        for fold, held_out in enumerate(ground.folds):
            np.testing.assert_array_equal(labels == fold, held_out[r])


def scored_by_a_loop(ground, trial, fold):
    """(n_outputs,) squared error on the fold's rows of the model refined on the others, run by a loop."""
    data = output_error_data(ground)
    training = training_decomposition(ground, trial.observer_order, trial.ridge, fold, 40)
    start = starting_parameters(corner(training, trial.model_order), data, held_out=fold)
    n_steps = trial.refinement_steps
    last = refine(start, data, held_out=fold, n_steps=n_steps, least_gain=refined_choice.STANDS_STILL)[-1]
    n, m, theta = last.layout.n_poles, last.layout.n_inputs, last.linear.coefficients
    model = LoopModel(
        poles=last.parameters.poles,
        is_pair=last.parameters.is_pair,
        b=last.parameters.inputs,
        starts=last.parameters.states,
        c=last.linear.shapes,
        D=theta[2 * n : 2 * n + m].T,
        levels=theta[2 * n + m :],
    )
    error = 0.0
    for r, record in enumerate(ground.scaled):
        missed = (record.outputs - loop_run(model, r, record.inputs))[ground.held_out[fold][r]]
        error = error + np.square(missed).sum(axis=0)
    return error


@pytest.mark.parametrize("case", ["linear", "friction"])
def test_trials_say_the_error_on_rows_that_were_not_refined_on(request, case):
    ground, _, refined = request.getfixturevalue(case)
    # up to the first three steps: there the path does not depend on where it was interrupted
    trial = next(trial for trial in refined.trials if trial.refinement_steps == 2)
    expected = np.array([scored_by_a_loop(ground, trial, fold) for fold in range(len(ground.folds))])
    np.testing.assert_allclose(trial.squared_errors, expected, rtol=1e-6)
    power = ground.power.sum(axis=0)
    assert trial.error == pytest.approx(np.sqrt(expected.sum(axis=0) / power).mean(), rel=1e-6)


def test_a_linear_system_with_white_noise_runs_until_it_stands_still(linear):
    _, found, refined = linear
    assert refined.chosen.refinement_steps == MOST_STEPS
    assert refined.chosen.model_order == 4
    assert refined.chosen.error <= found.chosen.error


@pytest.mark.parametrize("seed", [5, 6])
def test_a_refined_model_needs_few_spare_states(seed):
    """A large ridge bends the model of order 4; unrefined, many more states make up for a part of it."""
    record = linear_record(seed, noise=0.05, damping_ratios=(0.01, 0.01))
    _, found, refined = both_searches(record, observer_order=20, ridge=0.03)
    assert found.chosen.model_order >= 20
    assert refined.chosen.model_order <= 8
    assert refined.chosen.error < 0.3 * found.chosen.error
    # noise of 5 % is what no model can explain
    assert refined.chosen.error == pytest.approx(0.05, abs=0.005)


def test_friction_is_not_followed_at_the_cost_of_held_out_rows(friction):
    _, found, refined = friction
    assert refined.chosen.error <= 1.021 * min(trial.error for trial in (*refined.trials, *found.trials))
    own = [
        trial
        for trial in refined.trials
        if trial.refinement_steps
        and (trial.observer_order, trial.ridge, trial.model_order)
        == (refined.chosen.observer_order, refined.chosen.ridge, refined.chosen.model_order)
    ]
    assert all(refined.chosen.error <= 1.021 * trial.error for trial in own)


def test_trials_of_both_kinds_stand_best_first(linear):
    _, found, refined = linear
    errors = [trial.error for trial in refined.trials]
    assert errors == sorted(errors)
    assert {id(trial) for trial in found.trials} <= {id(trial) for trial in refined.trials}
    assert refined.limits is found.limits
    pairs = {(trial.observer_order, trial.ridge) for trial in refined.trials if trial.refinement_steps}
    assert 1 <= len(pairs) <= 2


def test_a_given_order_is_kept_and_progress_is_told():
    record = linear_record(4, n_samples=600)
    found = search([record], observer_order=15, ridge=1e-4, model_order=6)
    shares = []
    refined = refined_search(found, progress=shares.append)
    assert {trial.model_order for trial in refined.trials} == {6}
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


# --- the rule by itself ----------------------------------------------------------------------------------------------


def a_trial(order, steps, errors, observer=10):
    """A trial whose ten blocks have these errors (one number: all the same)."""
    blocks = np.broadcast_to(np.asarray(errors, dtype=float), (10,)) / 10
    total = float(np.sqrt(blocks.sum()))
    return Trial(
        observer_order=observer,
        ridge=1e-4,
        model_order=order,
        squared_errors=np.full((3, 1), total**2 / 3),
        block_errors=blocks,
        error=total,
        refinement_steps=steps,
    )


def choose(*trials):
    return order_search.chosen_refined(sorted(trials, key=lambda trial: trial.error))


def test_of_equal_trials_the_smallest_order_and_the_longest_refinement():
    noisy = 0.01 * (1 + 0.02 * np.sin(np.arange(10)))
    best, smaller = a_trial(8, 3, 0.01), a_trial(4, 2, noisy)
    until_still = a_trial(4, MOST_STEPS, 0.01 * (1 + 0.03 * np.cos(np.arange(10))))
    assert choose(best, smaller, until_still) is until_still
    assert choose(best, smaller) is smaller
    # worse in every block: an early stop
    lost = a_trial(4, MOST_STEPS, 0.0102)
    assert choose(a_trial(4, 2, 0.01), lost).refinement_steps == 2
    # as good as the best of all, yet worse in every block than an earlier stop of the same order
    wavy = a_trial(8, 3, 0.01 * (1 + 0.05 * np.cos(np.pi * np.arange(10))))
    earlier, later = a_trial(4, 2, 0.01003), a_trial(4, MOST_STEPS, 0.01005)
    assert wavy.error < earlier.error
    assert choose(wavy, later) is later
    assert choose(wavy, earlier, later) is earlier
    # worse by more than 2 %: neither order nor steps
    assert choose(best, replace(smaller, error=0.2), replace(until_still, error=0.2)) is best
    # another observer's refinement does not stand in
    other = a_trial(4, MOST_STEPS, noisy, observer=20)
    assert choose(a_trial(4, 2, 0.00999), other).observer_order == 10


def test_a_loss_that_estimating_explains_is_no_reason_to_leave_the_refinement():
    """Worse in every block, yet by less than the numbers of the model cost: no other estimate is better by more."""
    best, lost = a_trial(4, 0, 0.01), a_trial(4, MOST_STEPS, 0.01002, observer=20)
    for share, chosen in ((0.0021, lost), (0.0019, best)):
        assert order_search.chosen_refined([best, lost], lambda order, share=share: share * order / 4) is chosen


def test_what_estimating_costs_is_counted():
    """Numbers of a model in modal form, over the values that one of the folds leaves to fit."""
    ground = search([linear_record(4, n_samples=600)], observer_order=15, ridge=1e-4, model_order=6).ground
    n, m, q = 6, ground.scaled[0].n_inputs, ground.scaled[0].n_outputs
    n_folds = len(ground.folds)
    assert order_search.estimation_share(ground, n) == pytest.approx(
        (n + n * q + (n * m - n) + m * q) / (q * 600 * (n_folds - 1) / n_folds), rel=0.05
    )


def test_orders_are_mostly_smaller_whole_pairs_above_a_few(linear):
    _, found, _ = linear
    for best in (1, 4, 12, 30):
        limits = replace(found.limits, model_orders=tuple(range(1, 60)))
        trial = replace(found.trials[0], model_order=best)
        orders = refined_choice._orders(replace(found, trials=(trial,), chosen=trial, limits=limits))
        assert best in orders
        assert orders == sorted(set(orders))
        assert all(n % 2 == 0 for n in orders if n > 8)
        assert orders[-1] <= 1.5 * best + 2
    assert refined_choice._between([4, 8, 16], 8) == [7, 10, 12]
    assert refined_choice._between([12, 24, 40], 24) == [18, 22, 26, 32]
    assert refined_choice._between([1], 1) == [2]


def test_as_many_modes_as_there_are_beyond_the_grid_of_orders():
    """Orders ended at 64 states: of more modes than 32 pairs became one, far from either and certain."""
    rng = np.random.default_rng(5)
    n_modes, n_samples, n_outputs, dt = 36, 3000, 6, 0.01
    angular = 2 * np.pi * dt * np.sort(rng.uniform(1.0, 44.0, n_modes))
    poles = np.exp(angular * (1j - rng.uniform(0.006, 0.02, n_modes)))
    u = rng.standard_normal((n_samples, 2))
    y = np.zeros((n_samples, n_outputs))
    for pole in poles:
        motion = lfilter([0.0, 1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], u @ rng.standard_normal(2))
        y += np.outer(rng.uniform(0.4, 1.0) * motion / motion.std(), rng.standard_normal(n_outputs))
    record = centred(u, y + 0.02 * y.std(axis=0) * rng.standard_normal(y.shape), dt)
    _, found, refined = both_searches(record, observer_order=64)
    assert found.chosen.model_order >= 2 * n_modes - 2
    assert {64, 72, 80} <= {trial.model_order for trial in found.trials}  # coarse ones, and one between them
    assert refined.chosen.model_order in (2 * n_modes, 2 * n_modes + 2)
    assert refined.chosen.error == pytest.approx(0.02, rel=0.05)


def test_beyond_the_grid_what_is_left_is_asked_before_a_larger_cut(monkeypatch):
    record = linear_record(4, noise=0.03, frequencies=(6.0, 17.0, 29.0), damping_ratios=(0.02, 0.03, 0.02))
    ground, found, _ = both_searches(record, observer_order=30)
    small = tuple(trial for trial in found.trials if trial.model_order <= 4)
    lacking = replace(found, trials=small, chosen=small[0], ground=ground)
    assert small[0].model_order == 4
    monkeypatch.setattr(refined_choice, "ORDER_SHARES", (0.5, 1.0, 2.0))
    cut = refined_search(lacking)
    monkeypatch.setattr(refined_choice, "MODEL_ORDERS", (4,))
    grown = refined_search(lacking)
    tried = [
        {trial.model_order for trial in each.trials if trial.refinement_steps and not trial.weak_modes}
        for each in (cut, grown)
    ]
    assert max(tried[0]) >= 8
    assert max(tried[1]) < 8
    assert (grown.chosen.model_order, grown.chosen.weak_modes) == (6, 1)
    assert grown.chosen.error == pytest.approx(0.03, rel=0.1)
