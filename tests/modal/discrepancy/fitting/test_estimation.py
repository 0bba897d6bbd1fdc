"""Fitting: exact recovery without noise, bounds, missing samples, weights, and the covariance against repetition."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import some_records, two_masses, with_effects

from modal.discrepancy.fitting.estimation import (
    Problem,
    bounded_step,
    covariance,
    estimate,
    score_equations,
    sensitivity_of,
    simulate_at,
    weighted_residual,
    weights_along,
)
from modal.discrepancy.fitting.nodes import loaded
from modal.simulation.drive import drive_of
from modal.simulation.scheme import Budget
from modal.simulation.trajectory import sensitivity

KEYS = ["cubic_stiffness", "quadratic_drag", "periodic_disturbance", "sensor_gain"]


def problem_of(keys, *, missing=0.0, noise=0.0, seed=0, change=(), lengths=(120, 90), floor=1e-8):
    """Records of a model with these effects, and its unknowns; `change` (index, value) of the truth."""
    plant = two_masses()
    drive = drive_of(some_records(plant, lengths=lengths, missing=missing))
    assembly, unknowns = with_effects(plant, keys, 2)
    common = unknowns.common.copy()
    common[: assembly.n_linear] = [93.0, 1.1]
    for index, value in change:
        common[index] = value
    local = unknowns.local.copy()
    unknowns = replace(unknowns, common=common, local=local)
    variance = np.full((2, plant.n_outputs), floor)
    problem = Problem(drive=drive, floor=variance)
    exact = simulate_at(assembly, unknowns, problem).trajectory.outputs
    rng = np.random.default_rng(seed)
    measured = exact + noise * rng.standard_normal(exact.shape)
    return assembly, unknowns, replace(problem, drive=replace(drive, outputs=np.where(drive.present, measured, 0.0)))


def a_link(displacement, velocity, load):
    """A link that slips at 0.15, in records that begin so; the truth, and the problem of what each record begins at."""
    assembly, unknowns, problem = problem_of(["slack_in_hysteresis"], floor=1e-6)
    local = np.zeros_like(unknowns.local)
    local[:, [0, 2, -1]] = displacement, velocity, load
    truth = replace(unknowns, local=local)
    outputs = simulate_at(assembly, truth, problem).trajectory.outputs
    return assembly, truth, replace(problem, drive=replace(problem.drive, outputs=outputs), free_common=False)


def test_a_link_that_is_loaded_to_the_other_side_is_found_there():
    assembly, truth, problem = a_link(0.4, 3.0, 0.15)
    turned = truth.local * np.array([*[1.0] * (assembly.n_local - 1), -1.0])
    start = simulate_at(assembly, replace(truth, local=turned), problem)
    stuck = estimate(start, problem, iterations=20)
    assert stuck.level > 100.0  # no step leads from one end to the other
    assert loaded(stuck, problem).level < 1e-3


def test_a_link_that_begins_at_rest_is_not_loaded():
    """Else one that never slips would be a constant force of each record, and explain a zero that moves."""
    assembly, truth, problem = a_link(0.0, 0.0, 0.1)
    start = simulate_at(assembly, replace(truth, local=np.zeros_like(truth.local)), problem)
    found = estimate(start, problem, iterations=12)
    assert np.abs(found.unknowns.local[:, -1]).max() < 0.03
    assert found.level > 100.0


def away(assembly, unknowns):
    rng = np.random.default_rng(1)
    common = unknowns.common * rng.uniform(0.93, 1.07, len(unknowns.common))
    return replace(unknowns, common=common, local=unknowns.local + 0.02 * rng.standard_normal(unknowns.local.shape))


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_exact_recovery(missing):
    assembly, truth, problem = problem_of(KEYS, missing=missing, floor=1e-12)
    start = simulate_at(assembly, away(assembly, truth), problem)
    found = estimate(start, problem, iterations=40, standstill=0.0)
    assert np.abs(found.unknowns.common / truth.common - 1.0).max() < 1e-6
    assert np.abs(found.unknowns.local - truth.local).max() < 1e-6
    assert found.level < 1e-3
    assert found.cost < start.cost
    assert not found.at_bounds.any()
    assert found.iterations > 0


def test_a_fit_ends_when_its_budget_is_spent():
    assembly, truth, problem = problem_of(KEYS)
    start = simulate_at(assembly, away(assembly, truth), problem)
    found = estimate(start, problem, iterations=40, budget=Budget(0.0))
    assert found.iterations == 1
    assert found.cost < start.cost


def test_what_a_record_shows_before_its_delayed_drive_arrives_is_not_judged():
    assembly, unknowns, problem = problem_of(["input_delay"], noise=1e-3, floor=1e-6)
    at = assembly.common_of(0)
    unknowns.common[at] = 3.4 * problem.drive.dt
    first = problem.drive.row_firsts[1]

    def cost(row):
        outputs = problem.drive.outputs.copy()
        outputs[row] += 100.0
        return simulate_at(assembly, unknowns, replace(problem, drive=replace(problem.drive, outputs=outputs))).cost

    untouched = simulate_at(assembly, unknowns, problem)
    assert [cost(row) == untouched.cost for row in (0, 3, 4, first, first + 3, first + 4)] == [True, True, False] * 2
    gram, _ = score_equations(untouched, problem, sensitivity_of(untouched, problem))
    weights = weights_along(problem, untouched.trajectory)
    assert not weights[first : first + 4].any()
    assert weights[first + 4].all()
    slopes = sensitivity_of(untouched, problem).common * weights
    prior = assembly.prior()[1] ** -2.0
    np.testing.assert_allclose(np.diag(gram)[: assembly.n_common], np.sum(slopes**2, axis=(1, 2)) + prior)


def test_recovery_in_observer_form():
    assembly, truth, problem = problem_of(["cubic_stiffness", "bouc_wen_hysteresis"], floor=1e-12)
    gain = np.random.default_rng(0).standard_normal((4, 3)) * [0.05, 0.02, 0.0005]
    start = simulate_at(assembly, away(assembly, truth), problem, gain=gain)
    found = estimate(start, problem, iterations=40, standstill=0.0)
    assert np.abs(found.unknowns.common / truth.common - 1.0).max() < 1e-5
    assert np.shares_memory(found.gain, gain)


def test_a_bound_is_held_and_reported():
    """The truth has a negative drag and a stiffness beyond its upper bound of 120."""
    assembly, truth, problem = problem_of(["quadratic_drag"], change=[(0, 131.0), (2, -0.1)])
    start = simulate_at(assembly, replace(truth, common=np.array([95.0, 1.0, 0.3])), problem)
    found = estimate(start, problem, iterations=30)
    assert found.unknowns.common[0] == 120.0
    assert found.unknowns.common[2] == 0.0
    assert found.unknowns.common[1] > 0.0
    assert np.array_equal(found.at_bounds, [True, False, True])
    spread = covariance(found, problem)
    assert not spread[[0, 2]].any()
    assert spread[1, 1] > 0.0


def test_held_out_records_fit_only_what_is_their_own():
    assembly, truth, problem = problem_of(KEYS)
    start = simulate_at(assembly, away(assembly, truth), replace(problem, free_common=False))
    found = estimate(start, replace(problem, free_common=False), iterations=10)
    assert np.array_equal(found.unknowns.common, start.unknowns.common)
    assert not np.array_equal(found.unknowns.local, start.unknowns.local)
    assert found.cost < start.cost


def test_missing_samples_carry_no_weight():
    assembly, truth, problem = problem_of(["cubic_stiffness"], missing=0.3)
    assert np.array_equal(problem.weights == 0.0, ~problem.drive.present)
    wild = replace(
        problem, drive=replace(problem.drive, outputs=np.where(problem.drive.present, problem.drive.outputs, 99.0))
    )
    start = away(assembly, truth)
    ours, theirs = (estimate(simulate_at(assembly, start, one), one, iterations=5) for one in (problem, wild))
    assert np.array_equal(ours.unknowns.common, theirs.unknowns.common)
    absent = replace(problem.drive, present=problem.drive.present & np.array([True, False, True]))
    found = simulate_at(assembly, truth, replace(problem, drive=absent))
    assert np.isnan(found.mean_square[:, 1]).all()
    assert np.isfinite(found.level)


def test_each_record_and_output_is_weighed_by_its_own_floor():
    _, _, problem = problem_of([])
    floor = np.array([[1.0, 4.0, 9.0], [16.0, 25.0, 36.0]])
    problem = replace(problem, floor=floor)
    assert np.array_equal(problem.weights[5], [1.0, 1 / 2, 1 / 3])
    assert np.array_equal(problem.weights[130], [1 / 4, 1 / 5, 1 / 6])


def test_a_noisy_record_hardly_counts():
    """Two records of two stiffnesses: the estimate is that of the quieter one."""
    assembly, truth, problem = problem_of([], floor=1e-6)
    other = simulate_at(assembly, replace(truth, common=np.array([97.0, 1.1])), problem).trajectory.outputs
    rows = problem.drive.rows_of(1)
    outputs = problem.drive.outputs.copy()
    outputs[rows] = other[rows]
    for quiet, expected in ((0, 93.0), (1, 97.0)):
        floor = np.full((2, 3), 1.0)
        floor[quiet] = 1e-8
        mixed = replace(problem, drive=replace(problem.drive, outputs=outputs), floor=floor)
        found = estimate(simulate_at(assembly, truth, mixed), mixed, iterations=20)
        assert found.unknowns.common[0] == pytest.approx(expected, abs=1e-3)


def test_data_that_say_nothing_leave_the_prior():
    assembly, truth, problem = problem_of([], floor=1e8)
    found = estimate(simulate_at(assembly, truth, problem), problem, iterations=20, standstill=0.0)
    assert np.allclose(found.unknowns.common, [90.0, 0.8], atol=1e-3)


def test_the_normal_equations_are_those_of_the_stacked_residual():
    assembly, truth, problem = problem_of(["periodic_disturbance", "bouc_wen_hysteresis"], noise=1e-3, floor=1e-6)
    current = simulate_at(assembly, away(assembly, truth), problem)
    slopes = sensitivity(
        assembly, current.unknowns, problem.drive, current.trajectory, current.scheme, slopes=current.slopes
    )
    gram, score = score_equations(current, problem, slopes)
    drive, n_local = problem.drive, assembly.n_local
    columns = [one * problem.weights for one in slopes.common]
    for record in range(2):
        for one in slopes.local:
            own = np.zeros_like(one)
            own[drive.rows_of(record)] = one[drive.rows_of(record)]
            columns.append(own * problem.weights)
    jacobian = np.array(columns).reshape(len(columns), -1)
    residual = weighted_residual(problem, current.trajectory).ravel()
    centre, deviation = assembly.prior()
    own = assembly.local_deviation()
    prior = np.diag(np.concatenate([deviation**-2.0, np.tile(own**-2.0, 2)]))
    off = np.concatenate([centre - current.unknowns.common, -current.unknowns.local.ravel()])
    assert len(gram) == assembly.n_common + 2 * n_local
    assert np.allclose(gram, jacobian @ jacobian.T + prior, rtol=1e-9, atol=1e-6)
    assert np.allclose(score, jacobian @ residual + prior @ off, rtol=1e-9, atol=1e-6)


def test_the_covariance_is_the_scatter_of_repetitions():
    """40 repetitions, 4 parameters: the mean of the squared standardised errors is 1 within its 4 deviations."""
    noise, errors = 0.003, []
    for seed in range(40):
        assembly, truth, problem = problem_of(
            ["cubic_stiffness", "quadratic_drag"], noise=noise, seed=seed, floor=noise**2
        )
        found = estimate(simulate_at(assembly, truth, problem), problem, iterations=4)
        spread = np.sqrt(np.diag(covariance(found, problem))[: assembly.n_common])
        errors.append((found.unknowns.common - truth.common) / spread)
    squares = np.array(errors) ** 2
    assert abs(squares.mean() - 1.0) < 4 * np.sqrt(2 / squares.size)
    assert np.all(squares.mean(axis=0) < 1 + 4 * np.sqrt(2 / 40))
    assert np.all(squares.mean(axis=0) > 0.35)


def test_a_model_that_cannot_be_simulated_gives_none():
    assembly, truth, problem = problem_of(["cubic_stiffness"])
    wild = replace(truth, common=np.array([90.0, 0.8, -1e5]))
    assert simulate_at(assembly, wild, problem) is None


def test_a_residual_beyond_the_range_of_numbers_gives_none_and_no_warning():
    """A motion may escape so far that its square is no number any more."""
    assembly, unknowns, problem = problem_of(["cubic_stiffness"])
    assert simulate_at(assembly, unknowns, problem) is not None
    drive = replace(problem.drive, outputs=problem.drive.outputs + 1e160)
    assert simulate_at(assembly, unknowns, replace(problem, drive=drive)) is None


FAR, ZERO = np.full(3, np.inf), np.zeros(3)


def problem(seed=0):
    rng = np.random.default_rng(seed)
    J, r = rng.standard_normal((20, 3)), rng.standard_normal(20)
    return J, r, J.T @ J, J.T @ r


def step_of(gram, score, *, damping=0.0, at=ZERO, lower=-FAR, upper=FAR, reach=FAR):
    return bounded_step(gram, score, damping, at=at, lower=lower, upper=upper, reach=reach)


def test_without_bounds_it_is_that_of_least_squares():
    J, r, gram, score = problem()
    np.testing.assert_allclose(step_of(gram, score), np.linalg.lstsq(J, r)[0], rtol=1e-10)
    damped = step_of(gram, score, damping=0.5)
    np.testing.assert_allclose((gram + 0.5 * np.diag(np.diag(gram))) @ damped, score, rtol=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_what_would_go_too_far_goes_as_far_as_it_reaches_and_the_others_make_the_best_of_it(seed):
    J, r, gram, score = problem(seed)
    free = step_of(gram, score)
    first = int(np.argmax(free))
    reach = FAR.copy()
    reach[first] = 0.3 * free[first]
    found = step_of(gram, score, reach=reach)
    others = [j for j in range(3) if j != first]
    assert found[first] == reach[first]
    expected = np.linalg.lstsq(J[:, others], r - J[:, first] * reach[first])[0]
    np.testing.assert_allclose(found[others], expected, rtol=1e-9)
    reach[first] = 1.1 * free[first]
    np.testing.assert_allclose(step_of(gram, score, reach=reach), free)


def test_what_sits_at_a_bound_and_would_cross_it_stays_and_what_comes_to_one_stops_there():
    J, r, gram, score = problem()
    free = step_of(gram, score)
    first = int(np.argmax(np.abs(free)))
    side = np.sign(free[first])
    bound = FAR.copy()
    bound[first] = 0.0
    lower, upper = (-FAR, bound) if side > 0 else (-bound, FAR)
    found = step_of(gram, score, lower=lower, upper=upper)
    others = [j for j in range(3) if j != first]
    assert found[first] == 0.0
    np.testing.assert_allclose(found[others], np.linalg.lstsq(J[:, others], r)[0], rtol=1e-9)
    bound[first] = 0.5 * abs(free[first])
    lower, upper = (-FAR, bound) if side > 0 else (-bound, FAR)
    assert step_of(gram, score, lower=lower, upper=upper)[first] == pytest.approx(0.5 * free[first])
