"""What forces erred by while a blow acted, against dense Gauss-Markov on a simulation of its own."""

import numpy as np
import pytest
import scipy

from modal.estimation.force_noise import likely_forces
from modal.estimation.modal_states import ModalParameters, blocks_of
from modal.estimation.output_error import OutputError, step_at
from okid.record import Record

N_SAMPLES, N_INPUTS, N_OUTPUTS = 300, 2, 2
BLOWS = ((20, 26), (75, 80), (130, 136), (185, 189), (240, 246))
SET_ASIDE = 1e-6


def states_of(poles, participations, force):
    x, states = np.zeros(poles.size, dtype=complex), []
    for u in force:
        states.append(x)
        x = poles * x + participations @ u
    return np.array(states)


def answer(numbers, force, n_poles):
    """All outputs for logarithms of poles, participations, shapes, feedthrough and level, in this order."""
    poles, numbers = np.exp(numbers[:n_poles] + 1j * numbers[n_poles : 2 * n_poles]), numbers[2 * n_poles :]
    b, numbers = numbers[: 2 * n_poles * N_INPUTS].reshape(2, n_poles, N_INPUTS), numbers[2 * n_poles * N_INPUTS :]
    c, numbers = numbers[: 2 * n_poles * N_OUTPUTS].reshape(2, N_OUTPUTS, n_poles), numbers[2 * n_poles * N_OUTPUTS :]
    direct, level = numbers[: N_OUTPUTS * N_INPUTS].reshape(N_OUTPUTS, N_INPUTS), numbers[N_OUTPUTS * N_INPUTS :]
    states = states_of(poles, b[0] + 1j * b[1], force)
    return (states @ (c[0] + 1j * c[1]).T).real + force @ direct.T + level


@pytest.fixture(scope="module")
def struck():
    """A struck record, the model at which it is asked, and all that a dense solution needs of both."""
    rng = np.random.default_rng(4)
    poles = np.exp(np.array([-0.01 + 0.4j, -0.03 + 1.3j]))
    b, c = (rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2)) for _ in range(2))
    direct, level = rng.standard_normal((2, 2)), rng.standard_normal(2)
    aside, force = np.zeros(N_SAMPLES, dtype=bool), np.zeros((N_SAMPLES, 2))
    for first, last in BLOWS:
        force[first:last] = rng.uniform(0.5, 1.5, (last - first, 2))
        aside[first - 2 : last + 4] = True
    deviations = np.array([0.05, 0.1])
    acted = force + deviations * rng.standard_normal(force.shape) * (force != 0.0)
    parts = (np.log(poles).real, np.log(poles).imag, b.real, b.imag, c.real, c.imag, direct, level)
    numbers = np.concatenate([np.ravel(one) for one in parts])
    sizes = np.array([0.02, 0.1])
    outputs = answer(numbers, acted, 2) + sizes * rng.standard_normal((N_SAMPLES, 2))
    record = Record(force, outputs, 1.0)
    data = OutputError(records=(record,), rows=(np.ones(N_SAMPLES, dtype=bool),), blocks=blocks_of([record], [[[]]]))
    parameters = ModalParameters(
        poles=poles, is_pair=np.ones(2, dtype=bool), inputs=b, states=np.zeros((1, 2), dtype=complex)
    )
    return data, step_at(parameters, data), numbers, aside, deviations**2


def dense(data, numbers, aside, variances):
    """(n, n) H over the noise, (n,) likeliest errors and (n, n) what they may be off by, (n,) rows and inputs."""
    force, outputs = data.records[0].inputs, data.records[0].outputs
    root = np.sqrt(np.where(aside, SET_ASIDE, 1.0))[:, np.newaxis]
    poles = np.exp(numbers[:2] + 1j * numbers[2:4])
    states = states_of(poles, numbers[4:8].reshape(2, 2) + 1j * numbers[8:12].reshape(2, 2), force)
    phi = np.hstack([states.real, states.imag, force, np.ones((len(force), 1))])
    theta = np.linalg.lstsq(root * phi, root * outputs, rcond=None)[0]
    c, d = theta[:2] - 1j * theta[2:4], theta[4:6]
    here = np.concatenate([numbers[:12], c.T.real.ravel(), c.T.imag.ravel(), d.T.ravel(), theta[6]])
    left = outputs - phi @ theta
    weights = (~aside).sum() / np.square(left[~aside]).sum(axis=0)
    size = (root * np.sqrt(weights)).ravel()
    step = 1e-5
    slopes = [
        (answer(here + step * one, force, 2) - answer(here - step * one, force, 2)) / (2 * step)
        for one in np.eye(here.size)
    ]
    jacobian = np.array([one.ravel() for one in slopes]).T * size[:, np.newaxis]
    jacobian /= np.linalg.norm(jacobian, axis=0)
    values, vectors = np.linalg.eigh(jacobian @ jacobian.T)
    kept = vectors[:, values > 1e-9 * values.max()]
    row, which = np.nonzero(force)
    pulses = []
    for k, j in zip(row, which, strict=True):
        pulse = np.zeros_like(force)
        pulse[k, j] = np.sqrt(variances[j])
        made = answer(here, pulse, 2) - here[-2:]
        made[aside] = 0.0
        pulses.append(made.ravel())
    T = np.array(pulses).T * size[:, np.newaxis]
    r = np.where(aside[:, np.newaxis], 0.0, left).ravel() * size
    T, r = T - kept @ (kept.T @ T), r - kept @ (kept.T @ r)
    n = 2 * (~aside).sum() - kept.shape[1]

    def surprise(logarithm):
        s = np.exp(logarithm)
        inner = np.linalg.inv(np.eye(T.shape[1]) + T.T @ T / s)
        _, determinant = np.linalg.slogdet(np.eye(T.shape[1]) + T.T @ T / s)
        return n * logarithm + determinant + (r @ r - (T.T @ r) @ inner @ (T.T @ r) / s) / s

    s = np.exp(scipy.optimize.minimize_scalar(surprise, bounds=(-12, 12), method="bounded", options={"xatol": 1e-9}).x)
    after = np.linalg.inv(np.eye(T.shape[1]) + T.T @ T / s)
    scale = np.sqrt(variances[which])
    return T.T @ T / s, T.T @ r / s, -scale * (after @ T.T @ r) / s, after * np.outer(scale, scale), row, which


def test_the_likeliest_forces_are_those_of_gauss_and_markov(struck):
    data, step, numbers, aside, variances = struck
    likely = likely_forces(step, data, [np.zeros((N_SAMPLES, 2))], [aside], variances[np.newaxis])
    H, b, errors, covariance, row, which = dense(data, numbers, aside, variances)
    (found,) = likely.errors(data)
    np.testing.assert_allclose(found[row, which], errors, atol=1e-4 * np.abs(errors).max())
    assert not np.delete(found.ravel(), row * 2 + which).any()
    np.testing.assert_allclose(np.sort(likely.power)[-4:], np.linalg.eigvalsh(H)[-4:], rtol=1e-3)
    (drawn,) = likely.drawn(np.random.default_rng(0), 40_000)
    np.testing.assert_allclose(np.cov(drawn), covariance, atol=0.03 * np.abs(covariance).max())
    values, vectors = np.linalg.eigh(H)
    seen = values > 1e-2  # the others are what the weight of rows aside leaves of what the model explains
    statistic = ((vectors[:, seen].T @ b) ** 2 / (values[seen] * (1.0 + values[seen]))).sum()
    assert likely.chance == pytest.approx(scipy.stats.chi2.sf(statistic, seen.sum()), rel=0.02)
    assert 1e-3 < likely.chance < 0.999


def test_what_forces_are_known_to_have_erred_by_counts(struck):
    """Asked again of data less what was found, the same errors are found, not none: the prior is of all of them."""
    data, step, _, aside, variances = struck
    none = [np.zeros((N_SAMPLES, 2))]
    first = likely_forces(step, data, none, [aside], variances[np.newaxis])
    (erred,) = first.errors(data)
    record = data.records[0]
    told = OutputError(
        records=(Record(record.inputs - erred, record.outputs, 1.0),), rows=data.rows, blocks=data.blocks
    )
    (again,) = likely_forces(step, told, [erred], [aside], variances[np.newaxis]).errors(data)
    assert np.linalg.norm(again - erred) < 0.3 * np.linalg.norm(erred)


def test_errors_larger_than_the_sensors_are_told_from_its_own(struck):
    data, step, _, aside, variances = struck
    none = [np.zeros((N_SAMPLES, 2))]
    assert likely_forces(step, data, none, [aside], variances[np.newaxis] / 100.0).chance < 1e-6
    assert likely_forces(step, data, none, [aside], variances[np.newaxis] / 100.0).times > 2.0
    assert likely_forces(step, data, none, [aside], np.zeros((1, 2))) is None


def test_what_the_model_explains_of_an_error_is_known_no_better_than_its_sensor(struck):
    """Three blows: their common size is the participation's, and draws have the sensor's own scatter there."""
    data, step, numbers, _, variances = struck
    first = data.records[0].samples(0, 184)
    aside = np.zeros(184, dtype=bool)
    for begin, end in BLOWS[:3]:
        aside[begin - 2 : end + 4] = True
    short = OutputError(records=(first,), rows=(np.ones(184, dtype=bool),), blocks=blocks_of([first], [[[]]]))
    likely = likely_forces(
        step_at(step.parameters, short), short, [np.zeros((184, 2))], [aside], variances[np.newaxis] / 40.0
    )
    (drawn,) = likely.drawn(np.random.default_rng(0), 20_000)
    _, _, _, covariance, *_ = dense(short, numbers, aside, variances / 40.0)
    np.testing.assert_allclose(np.cov(drawn), covariance, atol=0.05 * np.abs(covariance).max())


def test_errors_asked_late_are_those_of_what_no_blow_made(struck):
    """Noise that rings as the structure does is as large late as soon; what blows made has faded."""
    data, step, _, aside, variances = struck
    none = [np.zeros((N_SAMPLES, 2))]
    few = variances[np.newaxis] / 100.0
    soon, late = (likely_forces(step, data, none, [aside], few, late=share).times for share in (0.0, 0.75))
    assert soon > 2.0 * late
