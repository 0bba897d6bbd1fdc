"""A sensor's gain in a state space that is free inside, on data by scipy: only the model as given shows it."""

import control
import numpy as np
import pytest
import scipy

from modal.discrepancy import CATALOGUE, diagnose
from okid.record import Record

DT, N = 0.02, 400
MASSES = np.array([1.0, 1.4, 0.9])


def system(stiffnesses, dampings):
    """Three masses in a row, driven at the second, displacements of the first and the last."""
    chain = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
    K, C = (chain.T @ np.diag(values) @ chain for values in (stiffnesses, dampings))
    inverse = np.diag(1.0 / MASSES)
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ K, -inverse @ C]])
    B = np.concatenate([np.zeros(3), inverse[:, 1]])[:, np.newaxis]
    return A, B, np.eye(6)[[0, 2]], np.zeros((2, 1))


def as_given(rng, stiffnesses=(970.0, 1240.0, 810.0)):
    """The same with stiffness some per cent wrong, in other coordinates."""
    A, B, C, D = system(stiffnesses, [1.2, 0.8, 0.9])
    T = rng.standard_normal((6, 6)) + 3.0 * np.eye(6)
    return control.ss(np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, D)


def records(rng, gain):
    A, B, C, D = system([1000.0, 1200.0, 800.0], [1.0, 1.0, 1.0])
    Ad, Bd, *_ = scipy.signal.cont2discrete((A, B, C, D), DT)
    for level in (1.0, 5.0, 3.0):
        u, x = level * rng.standard_normal((N, 1)), np.zeros(6)
        y = np.empty((N, 2))
        for k in range(N):
            y[k] = C @ x
            x = Ad @ x + Bd @ u[k]
        y[:, 1] *= gain
        y += 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
        yield Record(u, y, DT)


def test_a_gain_that_a_free_calibration_takes_up_is_told_but_not_firm():
    gain = 0.7
    rng = np.random.default_rng(7)
    model = as_given(rng)
    first, second, held_out = records(rng, gain)
    catalogue = {key: CATALOGUE[key] for key in ("sensor_gain", "input_gain", "sensor_bias", "cubic_stiffness")}
    found = diagnose(model, [first, second], held_out, sensor_kind="displacement", catalogue=catalogue)
    assert any(one.name.startswith("internal force") for one in found.calibrated)
    assert found.status == "unresolved"
    [finding] = found.findings
    assert (finding.effect, finding.where) == ("sensor_gain", "output_1")
    assert finding.parameters[0].value == pytest.approx(gain, rel=0.1)
    assert any("by internal forces" in reason for reason in found.warnings)
