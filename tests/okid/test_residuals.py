"""One-step residuals against the equation, the portmanteau test against its definition and its distribution."""

import numpy as np
import pytest

from okid.errors import InsufficientDataError, InvalidDataError
from okid.observer import fit_observer
from okid.record import Record
from okid.residuals import check_residuals, one_step_residuals


def arx_record(seed, n_samples=3000, *, noise_memory=0.0):
    """Order 2, two outputs, two inputs; white equation noise, or noise with a memory that no short ARX has."""
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal((n_samples, 2)), 0.3 * rng.standard_normal((n_samples, 2))
    y = np.zeros((n_samples, 2))
    for k in range(2, n_samples):
        y[k] = np.array([[1.1, 0.2], [-0.1, 0.9]]) @ y[k - 1] - 0.5 * y[k - 2]
        y[k] += u[k - 1] @ np.array([[1.0, 0.3], [0.2, -1.0]]) + e[k] + noise_memory * e[k - 1]
    return Record(u, y, 0.1)


def test_residuals_are_what_the_equation_leaves():
    record = arx_record(1, 60)
    y = np.array(record.outputs)
    y[30, 1] = np.nan
    record = Record(record.inputs, y, 0.1)
    fit = fit_observer(record, order=3)
    found = one_step_residuals(fit, record)
    for k in range(60):
        if k < 3 or 30 <= k <= 33:
            assert np.isnan(found[k]).any()
            continue
        expected = y[k] - fit.offset - fit.feedthrough @ record.inputs[k]
        for i in range(1, 4):
            expected = expected - fit.input_coefficients[i - 1] @ record.inputs[k - i]
            expected = expected - fit.output_coefficients[i - 1] @ y[k - i]
        assert np.abs(found[k] - expected).max() < 1e-12
    degrees = fit.n_rows - fit.n_parameters
    assert np.allclose(np.nansum(found[:, 0] ** 2) / degrees, fit.residual_covariance[0, 0], rtol=0.2)


def test_statistic_is_hoskings():
    record = arx_record(2, 1000)
    fit = fit_observer(record, order=2)
    e = one_step_residuals(fit, record)[2:]
    e = e - e.mean(axis=0)
    n, lags = len(e), 12
    C = [e[lag:].T @ e[: n - lag] / n for lag in range(lags + 1)]
    inverse = np.linalg.inv(C[0])
    Q = n**2 * sum(np.trace(C[lag].T @ inverse @ C[lag] @ inverse) / (n - lag) for lag in range(1, lags + 1))
    check = check_residuals(fit, record, n_lags=lags)
    assert check.whiteness_ratio == pytest.approx(Q / (4 * (lags - 2)), rel=1e-9)
    assert check.autocorrelation[:, 1] == pytest.approx([c[1, 1] / C[0][1, 1] for c in C], abs=1e-12)


def test_white_noise_passes_at_about_its_level():
    """40 records, nominal level 1 %: the mean ratio is 1 within its spread, and rejections stay rare."""
    checks = []
    for seed in range(40):
        record = arx_record(100 + seed, 800)
        checks.append(check_residuals(fit_observer(record, order=2), record))
    ratios = np.array([check.whiteness_ratio for check in checks])
    assert abs(ratios.mean() - 1) < 0.1  # 5 standard errors of the mean of 40 chi-squares with 80 degrees of freedom
    assert sum(check.whiteness_p_value < 0.01 for check in checks) <= 5
    # Below 1: the residual is orthogonal to past outputs, and these carry older inputs.
    assert 0.8 < np.mean([check.input_correlation_ratio for check in checks]) < 1.05


def test_too_short_an_observer_is_found_out():
    record = arx_record(3, noise_memory=0.9)
    check = check_residuals(fit_observer(record, order=2), record)
    assert check.whiteness_ratio > 2
    assert "not white" in check.messages[0]
    old = Record(record.inputs, np.roll(record.outputs, 8, axis=0), 0.1)  # the input acts eight samples later
    check = check_residuals(fit_observer(old, order=2), old)
    assert check.input_correlation_ratio > 2
    assert "inputs more than 2 samples old" in check.messages[-1]


def test_rounding_is_not_tested():
    u = np.random.default_rng(4).standard_normal(300)
    record = Record(u, np.convolve(u, [0.0, 1.0, 0.5])[:300], 0.1)
    check = check_residuals(fit_observer(record, order=2), record)
    assert np.isnan(check.whiteness_ratio)
    assert "level of rounding" in check.messages[0]


def test_wrong_use():
    record = arx_record(5, 100)
    fit = fit_observer(record, order=2)
    with pytest.raises(InvalidDataError, match=r"above the observer order 2.* whole number of at least 3, but is 2"):
        check_residuals(fit, record, n_lags=2)
    with pytest.raises(InsufficientDataError, match="at least 180 residuals, but 98 are left"):
        check_residuals(fit, record, n_lags=90)
    with pytest.raises(InvalidDataError, match="2 inputs and 2 outputs, but has 0 and 2"):
        one_step_residuals(fit, record.select(inputs=[]))


def test_a_short_record_is_tested_at_as_many_lags_as_it_carries():
    record = arx_record(5, 40)
    check = check_residuals(fit_observer(record, order=4), record)
    assert check.autocorrelation.shape[0] - 1 == 18
    assert np.isfinite(check.whiteness_ratio)
