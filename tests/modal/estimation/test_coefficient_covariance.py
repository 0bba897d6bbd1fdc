"""Covariance of a ridge regression against the matrices written out."""

import numpy as np
import pytest

from modal.estimation.propagation import coefficient_covariance
from okid.gram import lag_gram
from okid.record import Record
from okid.scaling import channel_scaling

ORDER, N_INPUTS, N_OUTPUTS = 5, 2, 1


def regressors(record, scaling):
    z = np.hstack(
        [
            (record.inputs - scaling.input_mean) / scaling.input_scale,
            (record.outputs - scaling.output_mean) / scaling.output_scale,
        ]
    )
    rows = [
        np.concatenate([[1.0], z[k, :N_INPUTS], *[z[k - j] for j in range(1, ORDER + 1)]]) for k in range(ORDER, len(z))
    ]
    return np.array(rows)


@pytest.mark.parametrize("ridge", [0.0, 1e-2])
def test_products_are_those_of_the_inverse_written_out(ridge):
    rng = np.random.default_rng(0)
    record = Record(rng.standard_normal((300, N_INPUTS)), rng.standard_normal(300), 0.1)
    scaling = channel_scaling([record])
    V = regressors(record, scaling)
    lags = np.concatenate([np.zeros(N_INPUTS), np.repeat(np.arange(1, ORDER + 1), N_INPUTS + N_OUTPUTS)])
    inverse = np.linalg.inv(V.T @ V + np.diag(np.concatenate([[0.0], ridge * (1 + lags) * len(V)])))
    covariance = coefficient_covariance(lag_gram([record], ORDER, scaling=scaling), ridge)
    assert covariance.effective_unknowns == pytest.approx(np.trace(inverse @ V.T @ V), rel=1e-10)
    assert np.abs(covariance.solve(np.eye(V.shape[1])) - inverse).max() < 1e-12 * np.abs(inverse).max()


def test_directions_without_information_have_no_variance():
    """Two equal outputs: their difference is never seen, the fit leaves it at 0, and so does its covariance."""
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal((2, 400))
    record = Record(u, np.column_stack([y, y]), 0.1)
    covariance = coefficient_covariance(lag_gram([record], 2, scaling=channel_scaling([record])), 0.0)
    assert covariance.factor is None
    assert covariance.effective_unknowns == pytest.approx(6)
    difference, total = np.zeros((8, 1)), np.zeros((8, 1))
    difference[[3, 4], 0], total[[3, 4], 0] = (1.0, -1.0), (1.0, 1.0)
    assert np.abs(covariance.solve(difference)).max() < 1e-6
    assert (total * covariance.solve(total)).sum() == pytest.approx(1 / 398, rel=0.05)
