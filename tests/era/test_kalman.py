"""The identified gain: filterpy runs it, Riccati knows it."""

import numpy as np
import pytest
import scipy
import systems
from systems import random_system

from era.kalman import innovations, kalman_filter
from era.realisation import Realisation
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record


def noisy_case(seed, n_samples, n_outputs=2):
    """A system with process and measurement noise, its Riccati predictor gain, and a record."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, n_modes=2, n_outputs=n_outputs, weak_mode=None)
    Q, R = 0.05 * np.eye(4), 0.5 * np.eye(n_outputs)
    P = scipy.linalg.solve_discrete_are(system.A.T, system.C.T, Q, R)
    covariance = system.C @ P @ system.C.T + R
    K = system.A @ P @ system.C.T @ np.linalg.inv(covariance)
    u = rng.standard_normal((n_samples, 2))
    process = np.sqrt(0.05) * rng.standard_normal((n_samples, 4))
    y = systems.simulate(system, u, process_noise=process) + np.sqrt(0.5) * rng.standard_normal((n_samples, n_outputs))
    return system, K, covariance, Record(u, y, system.dt)


def realisation(system, K=None):
    return Realisation(system.A, system.B, system.C, system.D, system.dt, K=K)


def test_filterpy_gives_our_innovations():
    system, K, _, record = noisy_case(1, 400)
    model = realisation(system, K)
    filter_ = kalman_filter(model)
    found = np.empty_like(record.outputs)
    for k in range(record.n_samples):
        filter_.update_steadystate(record.outputs[k] - model.D @ record.inputs[k])
        found[k] = filter_.y
        filter_.predict_steadystate(record.inputs[k])
    np.testing.assert_allclose(innovations(model, record), found, atol=1e-9 * np.abs(found).max())
    assert filter_.x.shape == (4,)


def test_innovations_of_the_riccati_gain_have_its_covariance_and_are_white():
    system, K, covariance, record = noisy_case(2, 20_000)
    e = innovations(realisation(system, K), record)
    np.testing.assert_allclose(np.cov(e, rowvar=False), covariance, atol=0.06 * np.abs(covariance).max())
    lagged = np.abs(e[1:].T @ e[:-1]) / len(e) / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert lagged.max() < 5 / np.sqrt(len(e))


def test_missing_outputs_have_no_innovation():
    system, K, _, record = noisy_case(3, 100)
    y = np.array(record.outputs)
    y[50, 1] = np.nan
    e = innovations(realisation(system, K), Record(record.inputs, y, system.dt))
    assert np.isnan(e[50, 1])
    assert np.isnan(e).sum() == 1


def test_no_gain_no_state_or_a_singular_a_are_errors():
    with pytest.raises(InvalidDataError, match=r"needs a gain K .*gain_from_innovations"):
        kalman_filter(Realisation([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    delay = Realisation([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], 0.1, K=[[0.1], [0.1]])
    with pytest.raises(NumericalError, match=r"invertible A, .* era\.innovations"):
        kalman_filter(delay)
    through = Realisation(np.empty((0, 0)), np.empty((0, 1)), np.empty((1, 0)), [[1.0]], 0.1, K=np.empty((0, 1)))
    with pytest.raises(InvalidDataError, match="at least one state"):
        kalman_filter(through)
