"""The identified gain: filterpy runs it, Riccati knows it."""

import doctest
import re
from pathlib import Path

import numpy as np
import pytest
import scipy
import systems
from containers import realisation_of
from noisy import noisy_data, noisy_system
from systems import random_system

from era.gain import estimate_gain
from era.kalman import forecast, innovations, kalman_filter
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


def test_filterpy_gives_our_innovations():
    system, K, _, record = noisy_case(1, 400)
    model = realisation_of(system, K)
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
    e = innovations(realisation_of(system, K), record)
    np.testing.assert_allclose(np.cov(e, rowvar=False), covariance, atol=0.06 * np.abs(covariance).max())
    lagged = np.abs(e[1:].T @ e[:-1]) / len(e) / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert lagged.max() < 5 / np.sqrt(len(e))


def test_missing_outputs_have_no_innovation():
    system, K, _, record = noisy_case(3, 100)
    y = np.array(record.outputs)
    y[50, 1] = np.nan
    e = innovations(realisation_of(system, K), Record(record.inputs, y, system.dt))
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


DOCUMENT = Path(__file__).resolve().parents[2] / "modal" / "docs" / "kalman.md"


def test_the_sessions_print_what_they_show():
    text = DOCUMENT.read_text(encoding="utf-8")
    sessions = "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    assert sessions.count(">>>") > 15
    test = doctest.DocTestParser().get_doctest(sessions, {}, DOCUMENT.name, str(DOCUMENT), 0)
    assert doctest.DocTestRunner().run(test).failed == 0


def model_of(noisy, K=None):
    return realisation_of(noisy.system, noisy.K if K is None else K)


def textbook(model, R, u, y, *, steps, P0):
    """Means and variances of every sample from `steps` before, by the time-varying filter and a fresh run each time."""
    A, B, C, D, K = model.A, model.B, model.C, model.D, model.K
    n, means, variances = len(y), np.full(y.shape, np.nan), np.full(y.shape, np.nan)
    x, P = np.zeros(model.order), P0
    for origin in range(n):
        z, S = x, P
        for j in range(origin, n):
            at_end = j - origin == steps - 1
            if at_end or (origin == 0 and j < steps - 1):
                means[j] = C @ z + D @ u[j]
                variances[j] = np.diag(C @ S @ C.T + R)
            if at_end:
                break
            z, S = A @ z + B @ u[j], A @ S @ A.T + K @ R @ K.T
        seen = np.flatnonzero(~np.isnan(y[origin]))
        size = C[seen] @ P @ C[seen].T + R[np.ix_(seen, seen)]
        L = (A @ P @ C[seen].T + K @ R[:, seen]) @ np.linalg.inv(size)
        e = y[origin, seen] - C[seen] @ x - D[seen] @ u[origin]
        x, P = A @ x + B @ u[origin] + L @ e, A @ P @ A.T + K @ R @ K.T - L @ size @ L.T
    return means, variances


@pytest.mark.parametrize("through", ["filterpy", "recursion"])
@pytest.mark.parametrize("steps", [1, 2, 7, 400])
def test_complete_records_as_the_textbook(steps, through):
    rng = np.random.default_rng(1)
    noisy = noisy_system(rng)
    model, (u, y) = model_of(noisy), noisy_data(rng, noisy, 150)
    means, variances = textbook(model, noisy.covariance, u, y, steps=steps, P0=np.zeros((4, 4)))
    found = forecast(
        model, Record(u, y, model.dt), innovation_covariance=noisy.covariance, steps=steps, through=through
    )
    np.testing.assert_allclose(found.means, means, atol=1e-9 * np.abs(means).max())
    np.testing.assert_allclose(found.standard_deviations**2, variances, rtol=1e-9)
    assert found.through == through


@pytest.mark.parametrize("steps", [1, 3, 12])
def test_gaps_and_an_uncertain_start_as_the_textbook(steps):
    rng = np.random.default_rng(2)
    noisy = noisy_system(rng, n_outputs=3)
    model, (u, y) = model_of(noisy), noisy_data(rng, noisy, 400)
    y[rng.random(y.shape) < 0.02] = np.nan
    y[200:240] = np.nan
    P0 = np.diag(rng.uniform(1, 5, 4))
    means, variances = textbook(model, noisy.covariance, u, y, steps=steps, P0=P0)
    found = forecast(
        model, Record(u, y, model.dt), innovation_covariance=noisy.covariance, steps=steps, initial_covariance=P0
    )
    # a covariance below 1e-9 of one sample's noise counts as none
    np.testing.assert_allclose(found.means, means, atol=1e-4 * np.abs(means).max())
    np.testing.assert_allclose(found.standard_deviations**2, variances, rtol=1e-6)
    # within the gap no origin knows more, so the interval grows
    assert (found.standard_deviations[239] > 1.2 * found.standard_deviations[199]).all()


def test_outputs_left_out_at_the_end_are_forecast_on_and_on():
    rng = np.random.default_rng(3)
    noisy = noisy_system(rng)
    model, (u, y) = model_of(noisy), noisy_data(rng, noisy, 300)
    y[250:] = np.nan
    found = forecast(model, Record(u, y, model.dt), innovation_covariance=noisy.covariance)
    single = forecast(model, Record(u, y, model.dt), innovation_covariance=noisy.covariance, steps=20)
    np.testing.assert_allclose(found.means[269], single.means[269], rtol=1e-9)
    np.testing.assert_allclose(found.standard_deviations[269], single.standard_deviations[269], rtol=1e-9)


def test_a_singular_model_runs_by_the_recursion():
    delay = Realisation([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], 0.1, K=[[0.2], [0.1]])
    rng = np.random.default_rng(4)
    record = Record(rng.standard_normal((80, 1)), rng.standard_normal((80, 1)), 0.1)
    found = forecast(delay, record, innovation_covariance=[[2.0]], steps=3)
    means, variances = textbook(delay, np.array([[2.0]]), record.inputs, record.outputs, steps=3, P0=np.zeros((2, 2)))
    assert found.through == "recursion"
    np.testing.assert_allclose(found.means, means, atol=1e-12)
    np.testing.assert_allclose(found.standard_deviations**2, variances, rtol=1e-12)
    with pytest.raises(NumericalError, match="invertible A"):
        forecast(delay, record, innovation_covariance=[[2.0]], through="filterpy")


def test_no_inputs_and_no_states():
    rng = np.random.default_rng(5)
    y = rng.standard_normal((60, 1))
    free = Realisation([[0.9]], np.empty((1, 0)), [[1.0]], np.empty((1, 0)), 0.1, K=[[0.3]])
    for through in ("filterpy", "recursion"):
        found = forecast(free, Record([], y, 0.1), innovation_covariance=[[1.0]], steps=4, through=through)
        np.testing.assert_allclose(
            found.means, textbook(free, np.eye(1), np.empty((60, 0)), y, steps=4, P0=np.zeros((1, 1)))[0], atol=1e-12
        )
    through = Realisation(np.empty((0, 0)), np.empty((0, 1)), np.empty((1, 0)), [[2.0]], 0.1, K=np.empty((0, 1)))
    found = forecast(through, Record(y, y, 0.1), innovation_covariance=[[4.0]], steps=5, probability=0.5)
    np.testing.assert_allclose(found.means, 2 * y)
    np.testing.assert_allclose(found.upper - found.means, 2 * 0.6744897501960817)


def test_a_missing_input_leaves_what_depends_on_it_unknown():
    rng = np.random.default_rng(6)
    noisy = noisy_system(rng, process=1.0)
    model, (u, y) = model_of(noisy), noisy_data(rng, noisy, 400)
    gap = np.array(u)
    gap[100, 0] = np.nan
    for steps in (1, 6):
        found = forecast(model, Record(gap, y, model.dt), innovation_covariance=noisy.covariance, steps=steps)
        whole = forecast(model, Record(u, y, model.dt), innovation_covariance=noisy.covariance, steps=steps)
        unknown = np.isnan(found.means).any(axis=1)
        np.testing.assert_allclose(found.means[:100], whole.means[:100])
        assert unknown[100 : 100 + steps].all()
        assert not unknown[-1]
        np.testing.assert_allclose(found.means[-1], whole.means[-1], rtol=1e-2)


def test_wrong_use():
    model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, K=[[0.1]])
    record = Record([1.0, 0.0, 0.0], [0.0, 2.5, 0.0], 0.01)
    with pytest.raises(InvalidDataError, match=r"needs a gain K .*estimate_gain"):
        forecast(Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01), record, innovation_covariance=[[1.0]])
    with pytest.raises(InvalidDataError, match=r"innovation covariance must have shape \(1, 1\)"):
        forecast(model, record, innovation_covariance=[1.0])
    with pytest.raises(InvalidDataError, match="without negative eigenvalues"):
        forecast(model, record, innovation_covariance=[[-1.0]])
    with pytest.raises(InvalidDataError, match="between 0 and 1, but is 95"):
        forecast(model, record, innovation_covariance=[[1.0]], probability=95)
    with pytest.raises(InvalidDataError, match="steps must be a whole number of at least 1"):
        forecast(model, record, innovation_covariance=[[1.0]], steps=0)
    with pytest.raises(InvalidDataError, match="through must be"):
        forecast(model, record, innovation_covariance=[[1.0]], through="kalman")
    wild = Realisation([[3.0]], [[1.0]], [[1.0]], [[0.0]], 0.01, K=[[0.0]])
    with pytest.raises(NumericalError, match="grows beyond all numbers"):
        forecast(wild, Record(np.ones(2000), np.ones(2000), 0.01), innovation_covariance=[[1.0]])


def covered(seeds, n_samples, *, missing):
    """Share of fresh samples within 95 % intervals by steps; gain and covariance from another record."""
    hits = {1: [], 5: [], 20: []}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        n_modes, n_outputs = int(rng.integers(1, 6)), int(rng.integers(1, 5))
        noisy = noisy_system(rng, n_modes=n_modes, n_outputs=n_outputs, process=10 ** rng.uniform(-2, 0))
        u, y = noisy_data(rng, noisy, n_samples)
        found = estimate_gain(model_of(noisy), Record(u, y, noisy.system.dt))
        u, y = noisy_data(rng, noisy, n_samples)
        gapped = np.where(rng.random(y.shape) < missing, np.nan, y)
        record = Record(u, gapped, noisy.system.dt)
        for steps, found_in in hits.items():
            ahead = forecast(
                model_of(noisy, found.gain),
                record,
                innovation_covariance=found.innovation_covariance,
                steps=steps,
                through="recursion",
            )
            found_in.append((y > ahead.lower) & (y < ahead.upper))
    return {steps: float(np.mean(np.concatenate([hit.ravel() for hit in parts]))) for steps, parts in hits.items()}


def test_intervals_cover():
    """Some 50 000 samples a line; k = 20 has some 2000 independent ones, standard error 0.5 %."""
    shares = covered(range(900, 908), 2500, missing=0.0)
    assert all(0.93 < share < 0.97 for share in shares.values()), shares


def test_intervals_cover_across_gaps():
    shares = covered(range(910, 914), 1500, missing=0.05)
    assert all(0.925 < share < 0.975 for share in shares.values()), shares


@pytest.mark.slow
@pytest.mark.parametrize("missing", [0.0, 0.03])
def test_intervals_cover_over_many_systems(missing):
    shares = covered(range(3000, 3060), 5000, missing=missing)
    print(f"missing {missing:.0%}: " + ", ".join(f"k = {k}: {share:.2%}" for k, share in shares.items()))
    assert all(0.93 < share < 0.97 for share in shares.values()), shares
