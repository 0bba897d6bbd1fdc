"""The test of innovations: its distribution for right gains, its power against wrong ones."""

from dataclasses import replace

import numpy as np
import pytest
from noisy import noisy_data, noisy_system

from era.gain import estimate_gain
from era.kalman import check_innovations
from era.realisation import Realisation
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record


def case(seed, n_samples=2000, n_outputs=2):
    rng = np.random.default_rng(seed)
    noisy = noisy_system(rng, n_outputs=n_outputs)
    u, y = noisy_data(rng, noisy, n_samples, initial_state=5 * rng.standard_normal(4))
    system = noisy.system
    return noisy, Realisation(system.A, system.B, system.C, system.D, system.dt), Record(u, y, system.dt)


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


def test_wrong_use():
    noisy, model, record = case(70, 100)
    with pytest.raises(InvalidDataError, match="innovations need a gain K"):
        check_innovations(model, record)
    with pytest.raises(InvalidDataError, match=r"n_lags .* at least 3"):
        check_innovations(replace(model, K=noisy.K), record, n_lags=2)
    with pytest.raises(InsufficientDataError, match="needs at least 120 residuals, but 100 are left"):
        check_innovations(replace(model, K=noisy.K), record, n_lags=60)
