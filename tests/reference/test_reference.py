"""The truth itself is checked by another road to the same numbers: a fault here must not be taken for one elsewhere."""

import itertools

import numpy as np
import pytest
import scipy
from signals import random_inputs, with_noise
from systems import TruthSystem, chain_matrices, initial_state, markov, random_chain, random_system, simulate, structure
from textbook_modal import merged_subspaces, textbook_lscf


def from_modes(system: TruthSystem, n_lags: int) -> np.ndarray:
    """Pulse response as the sum over modes that `TruthSystem` promises."""
    weights = np.where(system.poles.imag > 0, 2.0, 1.0)
    rows = [((system.shapes * weights * system.discrete_poles**k) @ system.participation.T).real for k in range(n_lags)]
    return np.stack([system.D, *rows])


@pytest.mark.parametrize("hold", ["zero_order", "linear"])
@pytest.mark.parametrize("seed", range(3))
def test_modes_and_matrices_agree(seed, hold):
    rng = np.random.default_rng(seed)
    for system in (random_system(rng, n_real_poles=1, hold=hold), random_chain(rng, hold=hold)):
        direct = markov(system, 60)
        np.testing.assert_allclose(from_modes(system, 60), direct, atol=1e-10 * np.abs(direct).max())


@pytest.mark.parametrize("hold", ["zero_order", "linear"])
def test_samples_equal_those_of_a_fine_integration(hold):
    """M x'' + C x' + K x = F by a general integrator, the force held or joined by lines between samples."""
    mass, damping, stiffness = chain_matrices([1.0, 1.3, 0.8], [900.0, 1200.0, 700.0], [0.8, 0.5, 0.9])
    dt, rng = 0.02, np.random.default_rng(5)
    system = structure(
        mass,
        damping,
        stiffness,
        force_dofs=[1, 2],
        sensor_dofs=[0, 1, 2],
        sensor_kinds=["displacement", "velocity", "acceleration"],
        dt=dt,
        hold=hold,
    )
    inputs = random_inputs(rng, 40, 2)
    inputs[0] = 0.0  # the state of a triangle hold carries a share of the present input: at rest only without one
    x, v, outputs = np.zeros(3), np.zeros(3), []
    for u, following in itertools.pairwise(inputs):

        def acceleration(t, x, v, u=u, following=following):
            force = u if hold == "zero_order" else u + (following - u) * t / dt
            return np.linalg.solve(mass, np.array([0.0, *force]) - damping @ v - stiffness @ x)

        outputs.append([x[0], v[1], acceleration(0.0, x, v)[2]])
        step = scipy.integrate.solve_ivp(
            lambda t, s: np.concatenate([s[3:], acceleration(t, s[:3], s[3:])]),
            (0, dt),
            np.concatenate([x, v]),
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
        )
        x, v = step.y[:3, -1], step.y[3:, -1]
    size = np.abs(outputs).max(axis=0)
    np.testing.assert_allclose(simulate(system, inputs)[:-1] / size, np.array(outputs) / size, atol=1e-8)


def test_systems_have_what_hides_faults_when_absent():
    system = random_system(np.random.default_rng(1))
    assert np.abs(system.C @ system.B).min() > 0
    assert np.abs(system.D).max() > 0
    assert system.frequencies[1] / system.frequencies[0] == pytest.approx(1.05)
    assert np.abs(np.linalg.eigvals(system.A)).max() < 1


@pytest.mark.parametrize("kind", ["white", "coloured", "sweep", "multisine", "hits", "steps"])
def test_inputs_move_every_channel_differently(kind):
    inputs = random_inputs(np.random.default_rng(2), 2000, 2, kind=kind)
    assert inputs.shape == (2000, 2)
    np.testing.assert_allclose(inputs.std(axis=0), 1.0)
    assert abs(np.corrcoef(inputs.T)[0, 1]) < 0.5


def test_noise_has_the_size_that_was_asked_for():
    rng = np.random.default_rng(3)
    system = random_system(rng)
    inputs = random_inputs(rng, 4000, 2)
    clean = simulate(system, inputs, initial_state=initial_state(rng, system, inputs))
    noise = with_noise(rng, clean, 0.05) - clean
    np.testing.assert_allclose(noise.std(axis=0) / clean.std(axis=0), 0.05, rtol=0.05)


def test_common_denominator_poles_of_an_exact_table():
    frequencies, dt = np.arange(257) * 50.0 / 256, 0.01
    poles = np.array([-0.6 + 40.0j, -1.1 + 130.0j, -0.9 + 138.0j])
    residues = np.random.default_rng(0).standard_normal((3, 2, 2))
    z = np.exp(2j * np.pi * frequencies * dt)[:, None, None, None]
    of_all = [(residues / (z - np.exp(p * dt)[:, None, None])).sum(axis=1) for p in (poles, poles.conj())]
    found = textbook_lscf(sum(of_all), frequencies, 6)
    np.testing.assert_allclose(found[np.argsort(found.imag)], poles, rtol=1e-8)


@pytest.mark.parametrize("driven", [True, False])
def test_merged_subspaces_are_exact_on_exact_data_whatever_the_levels(driven):
    """White forces without noise, or free decays: poles and shapes over the outputs of all set-ups."""
    rng = np.random.default_rng(41)
    chain = random_chain(rng, n_masses=4, n_inputs=1, damping_ratio=0.02)
    setups = []
    for level, moving in ((1.0, 1), (30.0, 2)):
        forces = level * random_inputs(rng, 400, 1) * driven
        state = level * initial_state(rng, chain, random_inputs(rng, 100, 1))
        outputs = simulate(chain, forces, initial_state=state)[:, [0, 3, moving]]
        setups.append((forces[:, :driven], outputs))
    poles, shapes = merged_subspaces(setups, n_references=2, order=8, n_blocks=12)
    for pole, shape in zip(chain.discrete_poles, chain.shapes.T, strict=True):
        k = np.abs(poles - pole).argmin()
        assert abs(poles[k] - pole) < 1e-7
        true = shape[[0, 3, 1, 2]]
        assert abs(np.vdot(shapes[:, k], true)) == pytest.approx(np.linalg.norm(shapes[:, k]) * np.linalg.norm(true))
