"""The structures of the calibration are checked by another road to the same numbers, and for what they promise."""

import ast
from pathlib import Path

import numpy as np
import pytest
import structures
from structures import EXCITATIONS, HUM_DISTANCE, mode_responses, random_excitation, random_record
from systems import structure as assembled

SEEDS = range(40)


@pytest.fixture(scope="module")
def records():
    return [random_record(seed) for seed in SEEDS]


def test_nothing_of_the_product_is_imported():
    tree = ast.parse(Path(structures.__file__).read_text(encoding="utf-8"))
    names = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert {name.split(".")[0] for name in names} <= {"numpy", "scipy", "dataclasses", "typing"}


@pytest.mark.parametrize("seed", [0, 3, 8])
def test_mode_responses_equal_a_loop(seed):
    record = random_record(seed)
    truth, inputs = record.structure, record.inputs[:200]
    for i, response in enumerate(mode_responses(truth, inputs)):
        state, expected = 0.0, np.zeros_like(response)
        for k, u in enumerate(inputs):
            expected[k] = 2 * (truth.shapes[:, i] * state).real
            state = np.exp(truth.poles[i] * truth.dt) * state + truth.participation[:, i] @ u
        np.testing.assert_allclose(response, expected, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_a_single_mass_is_sampled_as_by_the_matrix_exponential(derivative):
    """One mode with mass, damping and stiffness, against `systems.structure`: residue, and D of an accelerometer."""
    mass, ratio, natural, dt = 1.7, 0.06, 25.0, 0.02
    kind = ("displacement", "velocity", "acceleration")[derivative]
    matrices = (np.array([[mass]]), np.array([[2 * ratio * natural * mass]]), np.array([[natural**2 * mass]]))
    truth = assembled(*matrices, force_dofs=[0], sensor_dofs=[0], sensor_kinds=kind, dt=dt)
    pole = natural * (-ratio + 1j * np.sqrt(1 - ratio**2))
    g = 1 / mass
    b = g * structures.participation_of(pole, derivative, dt)
    np.testing.assert_allclose(b, truth.shapes[0, 0] * truth.participation[0, 0], rtol=1e-10)
    if derivative == 2:
        np.testing.assert_allclose(g, truth.D[0, 0], rtol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_clean_outputs_are_forced_plus_free_motion(seed):
    """What is left of `clean` lies in the space of free motions and of what an input's offset would have done."""
    record, n = random_record(seed), 400
    truth, n_outputs = record.structure, record.outputs.shape[1]
    forced = mode_responses(truth, record.inputs[:n]).sum(axis=0) + record.inputs[:n] @ truth.D.T
    decay = np.exp(np.outer(np.arange(n), truth.poles) * truth.dt)
    free = (decay[:, np.newaxis] * truth.shapes).reshape(n * n_outputs, -1)
    steps = [np.tile(unit, (n, 1)) for unit in np.eye(record.inputs.shape[1])]
    steps = [(mode_responses(truth, step).sum(axis=0) + step @ truth.D.T).ravel() for step in steps]
    basis = np.column_stack([free.real, free.imag, *steps])
    basis /= np.linalg.norm(basis, axis=0)
    rest = (record.clean[:n] - forced).ravel()
    left = rest - basis @ np.linalg.lstsq(basis, rest, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-8 * np.linalg.norm(record.clean[:n])


def test_what_makes_life_hard_is_there(records):
    traits = {word for record in records for words in record.structure.traits for word in words}
    assert traits == {"close", "weak", "local", "heavily damped", "complex"}
    assert {record.excitation for record in records} == set(EXCITATIONS)
    assert {record.noise for record in records} == {"white", "coloured", "process"}
    assert {record.inputs.shape[1] for record in records} == {1, 2, 3}
    assert {record.outputs.shape[1] for record in records} == set(range(1, 9))
    assert all(1500 <= len(record.inputs) <= 8000 for record in records)
    assert 8 <= sum(record.hum.size > 0 for record in records) <= 24
    assert any(np.abs(record.structure.D).max() == 0 for record in records)
    assert any(np.abs(record.structure.D).max() > 0 for record in records)


def test_hum_and_modes_can_be_told_apart(records):
    for record in records:
        modes = record.structure.frequencies
        assert np.all(np.abs(record.hum[:, np.newaxis] - modes) > HUM_DISTANCE * modes)
        assert np.all(record.structure.poles.imag * record.structure.dt < np.pi)


@pytest.mark.parametrize("kind", EXCITATIONS)
def test_inputs_have_unit_size_and_reach_the_modes(kind):
    inputs = random_excitation(np.random.default_rng(4), 3000, 2, kind=kind, band=(0.02, 0.1))
    np.testing.assert_allclose(inputs.std(axis=0), 1.0)
    power = np.abs(np.fft.rfft(inputs, axis=0)) ** 2
    inside = power[60:300].mean(axis=0)
    assert np.all(inside > 0.5 * power.mean(axis=0))


def test_noise_has_the_size_that_is_said(records):
    for record in records:
        if record.hum.size:
            continue
        noise = (record.outputs - record.clean).std(axis=0) / record.clean.std(axis=0)
        assert np.all(noise >= 0.69 * record.noise_share)
        assert np.all(noise <= 1.41 * record.noise_share)
