"""Gap against time: what grows, what only builds up, what the excitation does."""

from functools import cache

import numpy as np
import pytest
from nonlinear_chain import no_force, run_chain
from signals import random_inputs

from modal.discrepancy.gap import measure_gap
from okid.record import Record

DT, N = 0.03, 2048
K, C = 400.0, 0.8


@cache
def inputs(seed=5):
    rng = np.random.default_rng(seed)
    return np.array([10 * level * random_inputs(rng, N, 1, kind="coloured")[:, 0] for level in (0.5, 1.0, 2.0)])


def runs(law=no_force, *, stiffness=K, force=None):
    return run_chain([1.0], [stiffness], [C], inputs() if force is None else force, DT, law=law, n_steps=3)


@cache
def linear(stiffness=K):
    return runs(stiffness=stiffness)


def trend_of(measured, simulated, *, noise=0.002, n_windows=8):
    rng = np.random.default_rng(6)
    floor = (noise * measured.std(axis=1)) ** 2
    measured = measured + np.sqrt(floor)[:, np.newaxis] * rng.standard_normal(measured.shape)
    records = [[Record(u, y, DT) for u, y in zip(inputs(), runs_, strict=True)] for runs_ in (measured, simulated)]
    return measure_gap(*records, floor, n_windows=n_windows).time_trend


@cache
def softening_in_time(rate=0.1):
    return runs(lambda d, v, t: -rate * t * d)


def test_a_stiffness_that_drifts_makes_the_gap_grow():
    trend = trend_of(softening_in_time(), linear())
    assert trend.direction == "grows"
    # the gap is as large as the time: (7.5 / 0.5)^2 = 225 from the middle of the first window to that of the last,
    # but for the time that it takes to build up
    assert 30 < trend.end_ratio < 1500


def test_fitted_as_a_constant_the_drift_is_seen_at_both_ends():
    middle = K - 0.1 * DT * N / 2
    trend = trend_of(softening_in_time(), linear(middle))
    assert trend.direction == "both ends"
    assert trend.middle_ratio > 4


def test_a_wrong_constant_only_builds_up():
    trend = trend_of(linear(1.02 * K), linear())
    assert trend.direction == "steady"


def test_a_wrong_constant_of_a_lightly_damped_structure_only_builds_up():
    # the first mode remembers 12 s of the 61 s: without leaving out the first quarter half of these grow
    rng = np.random.default_rng(77)
    force = np.array(
        [10 * a * random_inputs(rng, N, 1, kind="coloured")[:, 0] for a in (0.3, 1.0, 3.0) for _ in range(8)]
    )
    wrong, right = (run_chain([1.0] * 3, [k, 400.0, 400.0], [0.8] * 3, force, DT, n_steps=3) for k in (410.0, 400.0))
    sets = [[i, 8 + i, 16 + i] for i in range(8)]
    assert [trend_of(wrong[one], right[one]).direction for one in sets] == ["steady"] * 8


def test_a_wrong_initial_state_dies_out():
    start = np.zeros((3, 2))
    start[:, 0] = 3.0 * linear()[:, :, 0].std(axis=1)
    free = run_chain([1.0], [K], [C], inputs(), DT, start=start, n_steps=3)
    assert trend_of(free, linear()).direction == "falls"


def test_an_excitation_that_grows_is_not_a_gap_that_grows():
    ramp = np.linspace(0.2, 2.0, N)
    force = inputs() * ramp
    trend = trend_of(runs(stiffness=1.02 * K, force=force), runs(force=force))
    assert trend.direction == "steady"


def test_a_drift_of_a_sensor_grows():
    drift = 0.2 * linear().std() * np.linspace(0.0, 1.0, N)[:, np.newaxis]
    assert trend_of(linear() + drift, linear()).direction == "grows"


@pytest.mark.parametrize("seed", range(20))
def test_a_gap_without_a_trend_is_steady(seed):
    rng = np.random.default_rng(seed)
    trend = trend_of(linear() + 0.1 * linear().std() * rng.standard_normal(linear().shape), linear())
    assert trend.direction == "steady"


@pytest.mark.parametrize(("n_windows", "known"), [(5, False), (6, True)])
def test_fewer_than_six_windows_tell_nothing(n_windows, known):
    assert (trend_of(linear(1.02 * K), linear(), n_windows=n_windows) is not None) == known


def test_two_equal_records_have_no_trend():
    records = [Record(u, y, DT) for u, y in zip(inputs(), linear(), strict=True)]
    assert measure_gap(records, records, 0.0).time_trend is None
