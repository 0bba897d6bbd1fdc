"""The bound itself, by finite differences of the outputs and by a Monte Carlo of a maximum-likelihood estimate."""

import numpy as np
import pytest
import scipy
from crb import cramer_rao_bound, information_matrix
from random_problems import random_problem
from signals import random_inputs
from systems import TruthSystem, initial_state, modal_system, simulate


def small_problem(*, real_poles=(), n_outputs=2, n_samples=80):
    rng = np.random.default_rng(11)
    system = modal_system(
        rng,
        frequencies=[6.0, 17.0],
        damping_ratios=[0.02, 0.05],
        real_poles=real_poles,
        n_inputs=2,
        n_outputs=n_outputs,
    )
    inputs = random_inputs(rng, n_samples, 2, kind="coloured")
    return system, inputs, initial_state(rng, system, inputs), rng.uniform(0.5, 2.0, n_outputs)


def real_modal_form(system: TruthSystem, start: np.ndarray):
    """The same system on blocks [[re, im], [-im, re]]: an own road to its parameters."""
    values, vectors = np.linalg.eig(system.A)
    columns = []
    for discrete in system.discrete_poles:
        vector = vectors[:, np.argmin(np.abs(values - discrete))]
        columns += [vector.real, vector.imag] if abs(discrete.imag) > 1e-12 else [vector.real]
    T = np.array(columns).T
    return np.linalg.solve(T, system.B), system.C @ T, np.linalg.solve(T, start)


def played(inputs, *, poles, B, C, D, start, level):
    """(n_samples, n_outputs) from continuous poles [Re s, Im s] or [s], one sample after the other."""
    A = scipy.linalg.block_diag(
        *[
            np.exp(p[0]) * np.array([[np.cos(p[1]), np.sin(p[1])], [-np.sin(p[1]), np.cos(p[1])]])
            if len(p) == 2
            else np.exp([[p[0]]])
            for p in poles
        ]
    )
    outputs, state = [], start
    for u in inputs:
        outputs.append(C @ state + D @ u + level)
        state = A @ state + B @ u
    return np.array(outputs)


def numerical_bound(system, inputs, start, noise_std, level):
    """Differences of the outputs to every entry of B, C, D, x(0) and the poles; scales of modes are not fixed, so the
    pseudo-inverse of the information, whose pole block is that of every fixed scale."""
    B, C, x0 = real_modal_form(system, start)
    kinds = [2 if pole.imag > 0 else 1 for pole in system.poles]
    logs = [[(p * system.dt).real, (p * system.dt).imag][:n] for p, n in zip(system.poles, kinds, strict=True)]
    parts = [np.concatenate(logs), B.ravel(), C.ravel(), system.D.ravel(), x0, np.zeros(system.n_outputs)]
    edges = np.cumsum([part.size for part in parts])[:-1]
    theta = np.concatenate(parts)

    def outputs(values):
        poles, b, c, d, x, shift = np.split(values, edges)
        split = np.split(poles, np.cumsum(kinds)[:-1])
        B_now, C_now, D_now = b.reshape(B.shape), c.reshape(C.shape), d.reshape(system.D.shape)
        return played(inputs, poles=split, B=B_now, C=C_now, D=D_now, start=x, level=shift)

    np.testing.assert_allclose(outputs(theta), simulate(system, inputs, initial_state=start), atol=1e-9)
    n_free = theta.size if level == "unknown" else theta.size - system.n_outputs
    steps = 1e-6 * np.maximum(np.abs(theta), 0.1)[:n_free]
    J = np.array(
        [
            ((outputs(theta + h * e) - outputs(theta - h * e)) / (2 * h * noise_std)).ravel()
            for h, e in zip(steps, np.eye(theta.size), strict=False)
        ]
    )
    weights = 1 / np.linalg.norm(J, axis=1)
    # of each mode's scale (c T, T^-1 b) one complex or real direction is not seen
    scaled = (weights[:, np.newaxis] * J) @ (weights[:, np.newaxis] * J).T
    values, vectors = np.linalg.eigh(scaled)
    seen = values > 1e-9 * values[-1]
    assert (~seen).sum() == sum(kinds)
    covariance = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T * np.outer(weights, weights)
    frequency, damping, first = [], [], 0
    for pole, n_own in zip(system.poles, kinds, strict=True):
        own = covariance[first : first + n_own, first : first + n_own] / system.dt**2
        pair = np.array([pole.real, pole.imag])[:n_own]
        d_size = pair / abs(pole)
        d_ratio = -np.array([1.0, 0.0])[:n_own] / abs(pole) + pole.real * d_size / abs(pole) ** 2
        frequency.append(np.sqrt(d_size @ own @ d_size) / (2 * np.pi))
        damping.append(np.sqrt(d_ratio @ own @ d_ratio) if n_own == 2 else np.nan)
        first += n_own
    return np.array(frequency), np.array(damping)


@pytest.mark.parametrize("level", ["known", "unknown"])
@pytest.mark.parametrize("real_poles", [(), (-20.0,)])
def test_bound_equals_one_by_finite_differences(real_poles, level):
    system, inputs, start, noise_std = small_problem(real_poles=real_poles)
    bound = cramer_rao_bound(system, inputs, initial_state=start, noise_std=noise_std, level=level)
    frequency, damping = numerical_bound(system, inputs, start, noise_std, level)
    np.testing.assert_allclose(bound.frequency_std, frequency, rtol=1e-4)
    np.testing.assert_allclose(bound.damping_ratio_std, damping, rtol=1e-4)
    assert np.isnan(bound.damping_ratio_std).sum() == len(real_poles)


def test_an_unknown_level_costs_information():
    system, inputs, start, noise_std = small_problem()
    known, unknown = (
        cramer_rao_bound(system, inputs, initial_state=start, noise_std=noise_std, level=level)
        for level in ("known", "unknown")
    )
    assert (unknown.frequency_std > known.frequency_std).all()


def test_bound_scales_with_the_noise_and_information_is_positive():
    system, inputs, start, noise_std = small_problem()
    one = cramer_rao_bound(system, inputs, initial_state=start, noise_std=noise_std)
    three = cramer_rao_bound(system, inputs, initial_state=start, noise_std=3 * noise_std)
    np.testing.assert_allclose(three.frequency_std, 3 * one.frequency_std, rtol=1e-8)
    information = information_matrix(system, inputs, initial_state=start, noise_std=noise_std)
    np.testing.assert_allclose(information, information.T, atol=1e-9 * np.abs(information).max())
    assert np.linalg.eigvalsh(information)[0] > 0


def test_least_squares_of_one_mode_reaches_the_bound():
    """One mode, one input, one output: 300 estimates by a general optimiser scatter as the bound says.

    The standard deviation of a standard deviation from 300 draws is 4 %; the limits are three of them.
    """
    rng = np.random.default_rng(12)
    system = modal_system(rng, frequencies=[9.0], damping_ratios=[0.03], n_inputs=1, n_outputs=1)
    inputs = random_inputs(rng, 300, 1, kind="coloured")
    start = initial_state(rng, system, inputs)
    clean = simulate(system, inputs, initial_state=start)
    noise_std = 0.05 * clean.std(axis=0)
    bound = cramer_rao_bound(system, inputs, initial_state=start, noise_std=noise_std)
    true = np.array([system.frequencies[0], system.damping_ratios[0]])
    estimates = np.array(
        [_estimate(clean + noise_std * rng.standard_normal(clean.shape), inputs, true, system.dt) for _ in range(300)]
    )
    scatter = estimates.std(axis=0)
    wanted = np.array([bound.frequency_std[0], bound.damping_ratio_std[0]])
    np.testing.assert_allclose(scatter / wanted, 1.0, atol=0.125)
    assert (np.abs(estimates.mean(axis=0) - true) < 4 * wanted / np.sqrt(300)).all()


def _estimate(outputs, inputs, guess, dt):
    """Frequency and damping by least squares; the linear parameters are eliminated at every step."""

    def residual(values):
        size = 2 * np.pi * values[0]
        pole = np.exp(size * (-values[1] + 1j * np.sqrt(1 - values[1] ** 2)) * dt)
        state = scipy.signal.lfilter([0.0, 1.0], [1.0, -pole], inputs[:, 0].astype(complex))
        decay = pole ** np.arange(len(inputs))
        regressors = np.column_stack([state.real, state.imag, decay.real, decay.imag, inputs[:, 0]])
        coefficients = np.linalg.lstsq(regressors, outputs[:, 0], rcond=None)[0]
        return outputs[:, 0] - regressors @ coefficients

    return scipy.optimize.least_squares(residual, guess, x_scale=[guess[0] * 1e-3, 1e-3], xtol=1e-10, ftol=1e-10).x


# --- the problems ----------------------------------------------------------------------------------------------------


def test_problems_are_as_promised():
    sizes = set()
    for seed in range(1000, 1012):
        problem = random_problem(seed)
        system = problem.system
        sizes.add((len(system.poles), system.n_inputs, system.n_outputs))
        assert 2 <= len(system.poles) <= 8
        assert 1 <= system.n_inputs <= 3
        assert 1 <= system.n_outputs <= 6
        assert 3000 <= problem.n_training <= 6000
        assert problem.n_training / len(problem.inputs) == pytest.approx(0.75, abs=1e-3)
        assert 0.01 <= problem.noise_share <= 0.1
        assert np.abs(system.C @ system.B).min() > 0
        assert np.abs(system.D).min() > 0
        assert 1.02 <= system.frequencies[1] / system.frequencies[0] <= 1.08
        assert np.abs(problem.initial_state).max() > 0
    assert len(sizes) > 8


def test_noise_is_white_of_the_size_that_is_kept_and_the_same_at_each_call():
    problem = random_problem(1003)
    noise = problem.noisy(2) - problem.clean
    np.testing.assert_array_equal(noise, problem.noisy(2) - problem.clean)
    np.testing.assert_allclose(noise.std(axis=0), problem.noise_std, rtol=0.06)
    assert np.abs(noise - (problem.noisy(3) - problem.clean)).max() > 0
    next_to = (noise[1:] * noise[:-1]).mean(axis=0) / noise.var(axis=0)
    assert np.abs(next_to).max() < 0.06


@pytest.mark.parametrize("realisation", [0, 1])
def test_noise_is_independent_of_the_inputs(realisation):
    """What 120 samples of the inputs before and after explain of it is what chance explains."""
    problem = random_problem(1006)
    noise = problem.noisy(realisation)[:, 0] - problem.clean[:, 0]
    n_samples, reach = len(noise), 120
    shifted = [np.roll(problem.inputs, lag, axis=0) for lag in range(-reach, reach + 1)]
    regressors = np.hstack(shifted)[reach : n_samples - reach]
    wanted = noise[reach : n_samples - reach]
    left = wanted - regressors @ np.linalg.lstsq(regressors, wanted, rcond=None)[0]
    explained = 1 - left.var() / wanted.var()
    chance = regressors.shape[1] / len(wanted)
    assert explained < chance + 4 * np.sqrt(2 * chance / len(wanted))
