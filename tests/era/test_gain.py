"""The gain by maximum likelihood: against Riccati, against the Cramer-Rao bound, and on data that have none to give."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
import systems
from containers import realisation_of
from noisy import noisy_data, noisy_system
from systems import random_system

from era.gain import estimate_gain, gain_from_innovations, riccati_gain
from era.kalman import check_innovations, innovations
from era.realisation import Realisation
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record


def record_of(rng, noisy, n_samples, **options):
    u, y = noisy_data(rng, noisy, n_samples, **options)
    return Record(u, y, noisy.system.dt)


def distances(seeds, n_samples):
    """Relative error of K a seed, and its root mean square by the Cramer-Rao bound."""
    errors, bounds = [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        noisy = noisy_system(rng)
        found = estimate_gain(realisation_of(noisy.system), record_of(rng, noisy, n_samples)).gain
        size = np.linalg.norm(noisy.K)
        errors.append(np.linalg.norm(found - noisy.K) / size)
        traces = np.trace(np.linalg.inv(noisy.information)) * np.trace(np.linalg.inv(noisy.covariance))
        bounds.append(np.sqrt(traces / n_samples) / size)
    return np.array(errors), np.array(bounds)


def test_the_error_falls_to_the_riccati_gain_at_the_cramer_rao_bound():
    medians = []
    for n_samples in (1000, 5000):
        errors, bounds = distances(range(400, 412), n_samples)
        ratio = np.sqrt(np.mean((errors / bounds) ** 2))
        assert 0.75 < ratio < 1.25, ratio  # 12 norms of 8 numbers each, spread some 10 %
        medians.append(np.median(errors))
    assert medians[0] / medians[1] == pytest.approx(np.sqrt(5), rel=0.35)


@pytest.mark.slow
def test_the_error_of_the_gain_by_length():
    for n_samples in (1000, 10_000, 100_000):
        errors, bounds = distances(range(5000, 5040), n_samples)
        ratio = np.sqrt(np.mean((errors / bounds) ** 2))
        print(f"N = {n_samples}: median error {np.median(errors):.1%}, RMSE over bound {ratio:.3f}")
        assert 0.85 < ratio < 1.15


def test_standard_deviations_and_covariance_are_right():
    """Normalised errors of all entries over 20 records have unit spread; R is unbiased."""
    rng = np.random.default_rng(7)
    noisy = noisy_system(rng, n_outputs=3)
    scores, covariances = [], []
    for _ in range(20):
        found = estimate_gain(realisation_of(noisy.system), record_of(rng, noisy, 3000))
        scores.append((found.gain - noisy.K) / found.gain_std)
        covariances.append(found.innovation_covariance)
    assert 0.85 < np.sqrt(np.mean(np.square(scores))) < 1.15
    np.testing.assert_allclose(np.mean(covariances, axis=0), noisy.covariance, atol=0.02 * noisy.covariance.max())


def test_pure_measurement_noise_gets_no_gain():
    for seed in range(10, 20):
        rng = np.random.default_rng(seed)
        system = random_system(rng)
        u = rng.standard_normal((2000, 2))
        y = systems.simulate(system, u, initial_state=rng.standard_normal(6)) + rng.standard_normal((2000, 3))
        found = estimate_gain(realisation_of(system), Record(u, y, system.dt))
        assert not found.gain.any()
        assert not found.gain_std.any()
        assert "no better than the free run" in found.reason
        np.testing.assert_allclose(found.innovation_covariance, np.eye(3), atol=0.15)


def test_several_records_offsets_gaps_and_starts():
    rng = np.random.default_rng(21)
    noisy = noisy_system(rng, n_modes=3, n_outputs=3)
    n = noisy.system.order
    records = []
    for length in (3000, 500, 6000):
        u, y = noisy_data(rng, noisy, length, initial_state=20 * rng.standard_normal(n))
        y += 5 * rng.standard_normal(3)
        y[rng.random(y.shape) < 0.01] = np.nan
        y[length // 2 : length // 2 + 50] = np.nan
        records.append(Record(u, y, noisy.system.dt))
    found = estimate_gain(realisation_of(noisy.system), records)
    scores = (found.gain - noisy.K) / found.gain_std
    assert np.sqrt(np.mean(scores**2)) < 1.6  # of 18 numbers
    np.testing.assert_allclose(found.innovation_covariance, noisy.covariance, rtol=0.1, atol=0.05)


def test_many_short_records_do_not_hide_the_process_noise():
    """From a zero gain alone the climb ends in a false optimum here: each start explains its record's drift."""
    rng = np.random.default_rng(22)
    noisy = noisy_system(rng, n_modes=3, n_outputs=3)
    records = [record_of(rng, noisy, 60) for _ in range(50)]
    found = estimate_gain(realisation_of(noisy.system), records).gain
    assert np.linalg.norm(found - noisy.K) < 0.4 * np.linalg.norm(noisy.K)


def test_noise_with_a_zero_on_the_unit_circle_gets_a_gain_that_forgets():
    """v = (1 - z^-1) / (1 - 0.9 z^-1) e: the likeliest gain, -0.1, never forgets what it started from."""
    rng = np.random.default_rng(30)
    e = rng.standard_normal(800)
    y, x = np.empty(800), 0.0
    for k in range(800):
        y[k], x = x + e[k], 0.9 * x - 0.1 * e[k]
    model = Realisation([[0.9]], np.empty((1, 0)), [[1.0]], np.empty((1, 0)), 0.1)
    found = estimate_gain(model, Record([], y, 0.1)).gain
    assert abs(0.9 - found[0, 0]) <= 1 - 20 / 800 + 1e-6


def test_units_permutations_and_similarity():
    rng = np.random.default_rng(23)
    noisy = noisy_system(rng, n_outputs=3)
    system, record = noisy.system, record_of(rng, noisy, 2000)
    plain = estimate_gain(realisation_of(system), record)
    T, units, turn = rng.standard_normal((4, 4)) + 3 * np.eye(4), np.array([1e6, 1.0, 1e-4]), [2, 0, 1]
    other = Realisation(
        T @ system.A @ np.linalg.inv(T),
        T @ system.B,
        ((system.C * units[:, np.newaxis]) @ np.linalg.inv(T))[turn],
        (system.D * units[:, np.newaxis])[turn],
        system.dt,
    )
    found = estimate_gain(other, Record(record.inputs, (record.outputs * units)[:, turn], system.dt))
    expected = (T @ plain.gain / units)[:, turn]
    np.testing.assert_allclose(found.gain * units[turn], expected * units[turn], atol=1e-4 * np.abs(T).max())
    np.testing.assert_allclose(
        found.innovation_covariance,
        (plain.innovation_covariance * np.outer(units, units))[np.ix_(turn, turn)],
        rtol=1e-4,
    )


def likelihood(model, K, record):
    e = innovations(realisation_of(model, K), record)
    return np.linalg.slogdet(e.T @ e / len(e))[1]


def test_no_small_change_of_the_gain_predicts_better():
    rng = np.random.default_rng(24)
    noisy = noisy_system(rng)
    record = record_of(rng, noisy, 20_000)
    model = realisation_of(noisy.system)
    found = estimate_gain(model, record)
    best = likelihood(model, found.gain, record)
    for _ in range(20):
        change = 0.5 * found.gain_std * rng.standard_normal(found.gain.shape)
        assert likelihood(model, found.gain + change, record) > best


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda u, y: (u[:7], y[:7]), "too few"),
        (lambda u, y: (u, np.where(np.arange(len(y))[:, np.newaxis] % 2 == [[0, 1]], np.nan, y)), "0 complete rows"),
        (lambda u, y: (u[:25], y[:25]), "no better"),
    ],
)
def test_data_that_give_no_gain_say_so(change, words):
    rng = np.random.default_rng(25)
    noisy = noisy_system(rng)
    u, y = change(*noisy_data(rng, noisy, 400))
    found = estimate_gain(realisation_of(noisy.system), Record(u, y, noisy.system.dt))
    assert not found.gain.any()
    assert words in found.reason
    assert (np.linalg.eigvalsh(found.innovation_covariance) > 0).all()


def test_noise_free_records_and_order_zero_give_no_gain():
    rng = np.random.default_rng(11)
    system = random_system(rng)
    u = rng.standard_normal((500, 2))
    record = Record(u, systems.simulate(system, u, initial_state=rng.standard_normal(6)), system.dt)
    found = estimate_gain(realisation_of(system), record)
    assert not found.gain.any()
    assert "to rounding" in found.reason
    through = Realisation(np.empty((0, 0)), np.empty((0, 2)), np.empty((3, 0)), system.D, system.dt)
    assert gain_from_innovations(through, record).shape == (0, 3)


def test_one_noise_free_output_and_one_that_repeats_another():
    rng = np.random.default_rng(26)
    noisy = noisy_system(rng)
    record, system = record_of(rng, noisy, 4000), noisy.system
    plain = estimate_gain(realisation_of(system), record)
    C, D = np.vstack([system.C, np.zeros((1, 4))]), np.vstack([system.D, [[1.0, 0.0]]])
    exact = Record(record.inputs, np.hstack([record.outputs, record.inputs[:, :1]]), system.dt)
    found = estimate_gain(Realisation(system.A, system.B, C, D, system.dt), exact)
    np.testing.assert_allclose(found.gain, np.hstack([plain.gain, np.zeros((4, 1))]), atol=1e-9)
    assert not found.innovation_covariance[2].any()
    twice = [0, 1, 0]
    doubled = Realisation(system.A, system.B, system.C[twice], system.D[twice], system.dt)
    found = estimate_gain(doubled, Record(record.inputs, record.outputs[:, twice], system.dt))
    joined = np.column_stack([found.gain[:, 0] + found.gain[:, 2], found.gain[:, 1]])
    np.testing.assert_allclose(joined, plain.gain, atol=1e-3 * np.abs(plain.gain).max())


def test_poles_on_the_unit_circle():
    """A seen integrator gets its gain; one that no output shows is left alone."""
    rng = np.random.default_rng(27)
    noisy = noisy_system(rng)
    system, record = noisy.system, record_of(rng, noisy, 3000)
    A, B = scipy.linalg.block_diag(system.A, [[1.0]]), np.vstack([system.B, np.zeros((1, 2))])
    walk = np.cumsum(0.3 * rng.standard_normal((3000, 1)), axis=0)
    seen = Realisation(A, B, np.hstack([system.C, np.ones((2, 1))]), system.D, system.dt)
    found = estimate_gain(seen, Record(record.inputs, record.outputs + walk, system.dt))
    assert found.gain[4].sum() > 0.1
    assert np.abs(np.linalg.eigvals(seen.A - found.gain @ seen.C)).max() < 1
    hidden = Realisation(A, B, np.hstack([system.C, np.zeros((2, 1))]), system.D, system.dt)
    found = estimate_gain(hidden, record).gain
    np.testing.assert_allclose(found[:4], estimate_gain(realisation_of(system), record).gain, atol=1e-3)
    assert not found[4].any()


def test_a_model_that_cannot_run_freely_gets_no_gain():
    wild = Realisation([[2.0]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    rng = np.random.default_rng(28)
    found = estimate_gain(wild, Record(rng.standard_normal(3000), rng.standard_normal(3000), 0.1))
    assert not found.gain.any()
    assert "cannot be made" in found.reason


def test_wrong_use():
    rng = np.random.default_rng(29)
    noisy = noisy_system(rng)
    record = record_of(rng, noisy, 100)
    with pytest.raises(InvalidDataError, match="2 inputs and 2 outputs, but the record has 1 inputs"):
        estimate_gain(realisation_of(noisy.system), record.select(inputs=[0]))


@pytest.mark.parametrize("seed", range(3))
def test_riccati_mirrors_an_unstable_gain(seed):
    """A gain of the same innovation spectrum: zeros outside the unit circle are mirrored into it."""
    system = noisy_system(np.random.default_rng(20 + seed)).system
    rng = np.random.default_rng(seed)
    wild = 3 * rng.standard_normal((4, 2))
    mended = riccati_gain(system.A, system.C, wild @ wild.T, np.eye(2), wild)
    poles, zeros = np.linalg.eigvals(system.A - mended @ system.C), np.linalg.eigvals(system.A - wild @ system.C)
    mirrored = np.where(np.abs(zeros) > 1, 1 / zeros.conj(), zeros)
    assert np.abs(zeros).max() > 1
    assert np.abs(np.subtract.outer(mirrored, poles)).min(axis=1).max() < 1e-8


def case(seed, n_samples=2000, n_outputs=2):
    rng = np.random.default_rng(seed)
    noisy = noisy_system(rng, n_outputs=n_outputs)
    u, y = noisy_data(rng, noisy, n_samples, initial_state=5 * rng.standard_normal(4))
    system = noisy.system
    return noisy, realisation_of(system), Record(u, y, system.dt)


def test_fitted_gains_leave_white_innovations_free_of_the_inputs():
    """30 systems: the mean ratio is 1 within its spread, rejections at 1 % stay rare."""
    checks = []
    for seed in range(30):
        _, model, record = case(seed)
        checks.append(check_innovations(replace(model, K=estimate_gain(model, record).gain), record))
    ratios = [check.whiteness_ratio for check in checks]
    assert abs(np.mean(ratios) - 1) < 0.08  # 80 degrees of freedom: 0.16 a ratio, 0.03 for the mean
    assert sum(check.whiteness_p_value < 0.01 for check in checks) <= 3
    assert abs(np.mean([check.input_correlation_ratio for check in checks]) - 1) < 0.1
    assert "are white" in checks[0].messages[0] or "nearly white" in checks[0].messages[0]


def test_the_statistic_is_hoskings():
    noisy, model, record = case(40)
    from era.kalman import innovations

    e = innovations(replace(model, K=noisy.K), record)[200:]
    e = e - e.mean(axis=0)
    n, lags = len(e), 30
    C = [e[lag:].T @ e[: n - lag] / n for lag in range(lags + 1)]
    inverse = np.linalg.inv(C[0])
    Q = n**2 * sum(np.trace(C[lag].T @ inverse @ C[lag] @ inverse) / (n - lag) for lag in range(1, lags + 1))
    check = check_innovations(replace(model, K=noisy.K), record, n_lags=lags)
    assert check.whiteness_ratio == pytest.approx(Q / (4 * lags - 8), rel=0.1)  # the first samples are not the same


def test_half_a_gain_none_and_a_missed_input_are_found_out():
    noisy, model, record = case(50, 4000)
    for K in (0.5 * noisy.K, 0 * noisy.K):
        check = check_innovations(replace(model, K=K), record)
        assert check.whiteness_ratio > 2
        assert "not white" in check.messages[0]
    late = Record(np.roll(record.inputs, -1, axis=0), record.outputs, record.dt)
    check = check_innovations(replace(model, K=noisy.K), late)
    assert check.input_correlation_ratio > 2
    assert "inputs up to" in check.messages[-1]


def test_several_records_offsets_and_gaps_change_little():
    noisy, model, record = case(60, 6000)
    y = record.outputs + np.array([3.0, -2.0])
    y[np.random.default_rng(0).random(y.shape) < 0.01] = np.nan
    right = replace(model, K=noisy.K)
    check = check_innovations(right, Record(record.inputs, y, record.dt).split(0.3))
    assert check.whiteness_ratio < 1.4
    assert check.input_correlation_ratio < 1.4


def test_without_inputs_and_without_noise():
    y = np.random.default_rng(1).standard_normal(500)
    silent = Realisation([[0.5]], np.empty((1, 0)), [[1.0]], np.empty((1, 0)), 0.1, K=[[0.0]])
    check = check_innovations(silent, Record([], y, 0.1))
    assert np.isnan(check.input_correlation_ratio)
    assert check.whiteness_ratio < 1.7
    exact = Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1, K=[[0.0]])
    u = np.random.default_rng(2).standard_normal(500)
    x = np.zeros(500)
    for k in range(499):
        x[k + 1] = 0.5 * x[k] + u[k]
    assert "level of rounding" in check_innovations(exact, Record(u, x, 0.1)).messages[0]


def test_innovation_check_wrong_use():
    noisy, model, record = case(70, 100)
    with pytest.raises(InvalidDataError, match="innovations need a gain K"):
        check_innovations(model, record)
    with pytest.raises(InvalidDataError, match=r"n_lags .* at least 3"):
        check_innovations(replace(model, K=noisy.K), record, n_lags=2)
    with pytest.raises(InsufficientDataError, match="needs at least 120 residuals, but 100 are left"):
        check_innovations(replace(model, K=noisy.K), record, n_lags=60)
