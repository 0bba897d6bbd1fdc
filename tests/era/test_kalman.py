"""The identified gain: filterpy runs it, Riccati knows it, innovations find it again."""

import numpy as np
import pytest
import scipy
import systems
from systems import random_system

from era.kalman import gain_from_innovations, innovations, kalman_filter, stabilised_gain
from era.realisation import Realisation
from okid.errors import InsufficientDataError, InvalidDataError, NumericalError
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
    with pytest.raises(NumericalError, match=r"invertible A, .* era\.kalman\.innovations"):
        kalman_filter(delay)
    through = Realisation(np.empty((0, 0)), np.empty((0, 1)), np.empty((1, 0)), [[1.0]], 0.1, K=np.empty((0, 1)))
    with pytest.raises(InvalidDataError, match="at least one state"):
        kalman_filter(through)


@pytest.mark.parametrize("n_outputs", [1, 2, 3])
def test_gain_from_innovations_predicts_nearly_as_well_as_the_riccati_gain(n_outputs):
    system, K, _, record = noisy_case(4 + n_outputs, 20_000, n_outputs)
    found = gain_from_innovations(realisation(system), record)
    size = [np.mean(innovations(realisation(system, gain), record) ** 2) for gain in (K, found, 0 * K)]
    assert size[1] < 1.005 * size[0]
    assert size[2] > 2 * size[0]  # so the free run would not have passed


def test_gain_from_several_records_and_missing_outputs():
    system, K, _, record = noisy_case(9, 20_000)
    y = np.array(record.outputs)
    y[3000:3010, 0] = np.nan
    parts = Record(record.inputs, y, system.dt).split(0.4)
    found = gain_from_innovations(realisation(system), parts)
    size = [np.mean(innovations(realisation(system, gain), record) ** 2) for gain in (K, found)]
    assert size[1] < 1.01 * size[0]


def test_white_measurement_noise_alone_gets_next_to_no_gain():
    rng = np.random.default_rng(10)
    system = random_system(rng)
    u = rng.standard_normal((4000, 2))
    y = systems.simulate(system, u) + rng.standard_normal((4000, 3))
    record = Record(u, y, system.dt)
    gain = gain_from_innovations(realisation(system), record)
    size = [np.mean(innovations(realisation(system, K), record) ** 2) for K in (gain, 0 * gain)]
    assert 0.97 * size[1] < size[0] <= size[1]


def test_noise_free_records_and_order_zero_give_no_gain():
    rng = np.random.default_rng(11)
    system = random_system(rng)
    u = rng.standard_normal((500, 2))
    record = Record(u, systems.simulate(system, u, initial_state=rng.standard_normal(6)), system.dt)
    assert not gain_from_innovations(realisation(system), record).any()
    through = Realisation(np.empty((0, 0)), np.empty((0, 2)), np.empty((3, 0)), system.D, system.dt)
    assert gain_from_innovations(through, record).shape == (0, 3)


def test_too_short_records_are_an_error_with_numbers():
    rng = np.random.default_rng(12)
    system = random_system(rng, n_modes=10, n_outputs=1)
    record = Record(rng.standard_normal((60, 2)), rng.standard_normal((60, 1)), system.dt)
    with pytest.raises(InsufficientDataError, match=r"order 20 with 1 outputs .* have 60 samples, enough for order 11"):
        gain_from_innovations(realisation(system), record)


@pytest.mark.parametrize("seed", range(3))
def test_riccati_leaves_a_stable_gain_and_mends_an_unstable_one(seed):
    """A gain of the same innovation spectrum: zeros outside the unit circle are mirrored into it."""
    system, K, covariance, _ = noisy_case(20 + seed, 50)
    model = realisation(system)
    assert stabilised_gain(model, K, covariance) is K
    rng = np.random.default_rng(seed)
    wild = 3 * rng.standard_normal((4, 2))
    mended = stabilised_gain(model, wild, np.eye(2))
    poles, zeros = np.linalg.eigvals(system.A - mended @ system.C), np.linalg.eigvals(system.A - wild @ system.C)
    mirrored = np.where(np.abs(zeros) > 1, 1 / zeros.conj(), zeros)
    assert np.abs(zeros).max() > 1
    assert np.abs(np.subtract.outer(mirrored, poles)).min(axis=1).max() < 1e-8
