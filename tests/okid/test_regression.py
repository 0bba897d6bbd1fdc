"""Least squares from the Gram matrix against `numpy.linalg.lstsq` on the regressors written out."""

import numpy as np
import pytest

from okid import least_squares as regression
from okid.errors import InvalidDataError
from okid.gram import lag_gram
from okid.least_squares import RegressionRows, solve
from okid.record import Record
from okid.scaling import channel_scaling

ORDERS = (1, 2, 5, 8)


def make(seed=0, n_samples=600, n_inputs=2, n_outputs=2, noise=0.05):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((n_samples, n_inputs))
    y = np.zeros((n_samples, n_outputs))
    for k in range(2, n_samples):
        y[k] = 1.2 * y[k - 1] - 0.7 * y[k - 2] + 0.3 * y[k - 1, ::-1] * 0.2
        y[k] += u[k].sum() + 0.5 * u[k - 1, :1].sum()
    return Record(u, y + noise * rng.standard_normal(y.shape) + 3.0, 0.1)


def written_out(record, scaling, order, largest):
    """(V, Y) of the scaled regression, rows from `largest` on."""
    u = (record.inputs - scaling.input_mean) / scaling.input_scale
    y = (record.outputs - scaling.output_mean) / scaling.output_scale
    z = np.hstack([u, y])
    V = np.array(
        [np.concatenate([[1.0], u[k], *[z[k - j] for j in range(1, order + 1)]]) for k in range(largest, len(z))]
    )
    return V, y[largest:]


def textbook(V, Y, order, ridge, *, n_inputs=2, n_outputs=2):
    """Ridge regression by lstsq on augmented rows: weight ridge (1 + lag) n_rows."""
    lags = np.concatenate([np.zeros(n_inputs), np.repeat(np.arange(1, order + 1), n_inputs + n_outputs)])
    weight = np.concatenate([[0.0], ridge * (1 + lags) * len(V)])
    V = np.vstack([V, np.diag(np.sqrt(weight))])
    return np.linalg.lstsq(V, np.vstack([Y, np.zeros((V.shape[1], Y.shape[1]))]), rcond=None)[0]


def as_solution(observer):
    rows = [observer.offset[np.newaxis], observer.feedthrough.T]
    for alpha, beta in zip(observer.input_coefficients, observer.output_coefficients, strict=True):
        rows += [alpha.T, beta.T]
    return np.vstack(rows)


@pytest.mark.parametrize("ridge", [0.0, 1e-4, 0.1])
def test_orders_of_one_gram_equal_lstsq(ridge):
    record = make()
    scaling = channel_scaling([record])
    gram = lag_gram([record], 8, scaling=scaling)
    for order in ORDERS:
        observer = solve(gram.truncated(order), ridge)
        V, Y = written_out(record, scaling, order, 8)
        theta = textbook(V, Y, order, ridge)
        assert np.abs(as_solution(observer) - theta).max() < 1e-10
        residual = Y - V @ theta
        covariance = residual.T @ residual / (len(V) - V.shape[1])
        assert np.abs(observer.residual_covariance - covariance).max() < 1e-11


@pytest.mark.parametrize("ridge", [0.0, 1e-3])
@pytest.mark.parametrize("path", ["cholesky", "qr", "eigh"])
def test_every_path_gives_the_least_squares_solution(monkeypatch, path, ridge):
    record = make(1)
    scaling = channel_scaling([record])
    gram = lag_gram([record], 5, scaling=scaling)
    if path != "cholesky":
        monkeypatch.setattr(regression, "_NEGLIGIBLE", 0.0)
    if path == "eigh":
        monkeypatch.setattr(regression, "_QR_OPERATIONS", 0.0)
    observer = solve(gram, ridge, source=RegressionRows(records=[record], scaling=scaling))
    V, Y = written_out(record, scaling, 5, 5)
    theta = textbook(V, Y, 5, ridge)
    residual = Y - V @ theta
    assert observer.method == path
    assert observer.rank == V.shape[1]
    assert np.abs(as_solution(observer) - theta).max() < 1e-11
    covariance = residual.T @ residual / (len(V) - V.shape[1])
    assert np.abs(observer.residual_covariance - covariance).max() < 1e-11
    if ridge == 0.0:
        assert np.linalg.cond(V) / 1.01 < observer.condition < 20 * np.linalg.cond(V)


def test_masks_leave_rows_out_on_every_path(monkeypatch):
    record = make(2)
    scaling = channel_scaling([record])
    mask = [np.random.default_rng(3).random(600) < 0.6]
    gram = lag_gram([record], 4, scaling=scaling, rows=mask)
    source = RegressionRows(records=[record], scaling=scaling, rows=mask)
    by_gram = solve(gram, 0.0, source=source)
    monkeypatch.setattr(regression, "_NEGLIGIBLE", 0.0)
    by_rows = solve(gram, 0.0, source=source)
    assert (by_gram.method, by_rows.method) == ("cholesky", "qr")
    assert np.abs(as_solution(by_gram) - as_solution(by_rows)).max() < 1e-10


def test_the_solution_of_noise_free_data_explains_them():
    record = make(4, noise=0.0)  # order 2 is exact: order 8 is rank-deficient
    scaling = channel_scaling([record])
    gram = lag_gram([record], 8, scaling=scaling)
    observer = solve(gram, 0.0)
    V, Y = written_out(record, scaling, 8, 8)
    assert np.abs(Y - V @ as_solution(observer)).max() < 1e-6
    assert observer.method == "eigh"
    assert observer.rank < observer.n_parameters


def test_a_ridge_outside_its_range_is_refused():
    record = make(5)
    gram = lag_gram([record], 4, scaling=channel_scaling([record]))
    with pytest.raises(InvalidDataError, match="at least 0, but is -1"):
        solve(gram, -1)


def test_an_observer_without_rows_is_zero():
    record = make()
    scaling = channel_scaling([record])
    gram = lag_gram([record], 3, scaling=scaling, rows=[np.zeros(record.n_samples, dtype=np.bool_)])
    for order in (1, 3):
        observer = solve(gram.truncated(order), 0.0)
        assert observer.rank == 0
        assert not observer.output_coefficients.any()
