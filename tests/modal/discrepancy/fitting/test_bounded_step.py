"""Damped steps within bounds, against the least squares that they solve."""

import numpy as np
import pytest

from modal.discrepancy.fitting.estimation import bounded_step

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
