import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import modal_system, sampled, simulate, structure

import era
from era.realisation import Realisation
from modal.preparation.drift import summed_inputs
from modal.preparation.integrators import choose_integrators, given_integrators, with_integrators
from okid.errors import InvalidDataError
from okid.record import Record


def free_masses(sensor_kind):
    """Two masses joined by a spring, free in space: one mode at 8 Hz and a rigid body."""
    squared = (2 * np.pi * 8.0) ** 2
    stiffness = squared / 1.5 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    damping = stiffness * 0.04 / (2 * np.pi * 8.0)
    return structure(
        np.diag([1.0, 2.0]), damping, stiffness, force_dofs=[0], sensor_dofs=[0, 1], sensor_kinds=sensor_kind, dt=0.01
    )


def tank():
    """A mode, and a level that sums what flows in; both in both outputs."""
    squared = (2 * np.pi * 8.0) ** 2
    A = np.array([[0.0, 1.0, 0.0], [-squared, -2.0, 0.0], [0.0, 0.0, 0.0]])
    return sampled(
        A, np.array([[0.0], [squared], [20.0]]), np.array([[1.0, 0, 1], [0.5, 0, -0.3]]), np.zeros((2, 1)), dt=0.01
    )


def record_of(rng, system, noise=0.02):
    inputs = random_inputs(rng, 3000, system.n_inputs)
    return Record(inputs, with_noise(rng, simulate(system, inputs), noise), system.dt)


@pytest.mark.parametrize(
    ("system", "number"),
    [(free_masses("velocity"), 1), (free_masses("displacement"), 2), (free_masses("acceleration"), 0), (tank(), 1)],
)
def test_integrators_are_counted(system, number):
    assert choose_integrators([record_of(np.random.default_rng(1), system).detrended()]).number == number


@pytest.mark.parametrize("drift", [0.0, 2.0])
def test_a_stable_system_has_none_even_where_a_sensor_drifts(drift):
    rng = np.random.default_rng(3)
    system = modal_system(rng, frequencies=[6.0, 21.0], damping_ratios=[0.02, 0.015], real_poles=[-1.0])
    record = record_of(rng, system)
    outputs = record.outputs + drift * record.outputs.std(axis=0) * np.linspace(-1.0, 1.0, 3000)[:, np.newaxis]
    assert choose_integrators([Record(record.inputs, outputs, 0.01).detrended()]).number == 0


@pytest.mark.parametrize("number", [0, 1, 2])
def test_the_model_with_integrators_sums_its_inputs(number):
    rng = np.random.default_rng(4)
    system = modal_system(rng, frequencies=[6.0], damping_ratios=[0.02])
    inputs = random_inputs(rng, 100, 2)
    summed = inputs
    for _ in range(number):
        summed = np.cumsum(summed, axis=0)
    truth = simulate(system, summed)
    model = with_integrators(Realisation(system.A, system.B, system.C, system.D, system.dt), number)
    outputs = era.simulate(model, Record(inputs, truth, system.dt)).outputs
    np.testing.assert_allclose(outputs, truth, atol=1e-10 * np.abs(truth).max())
    assert model.order == system.order + 2 * number
    assert (np.abs(np.linalg.eigvals(model.A) - 1.0) < 1e-6).sum() == 2 * number


def test_sums_are_of_inputs_about_their_mean():
    inputs = np.random.default_rng(5).standard_normal((40, 2)) + 3.0
    record = Record(inputs, np.zeros(40), 0.1)
    np.testing.assert_allclose(summed_inputs(record, 1).inputs[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(summed_inputs(record, 1).inputs, axis=0), (inputs - inputs.mean(axis=0))[1:])
    assert summed_inputs(record, 0) is record


def test_a_given_number_is_checked():
    assert given_integrators(2).number == 2
    with pytest.raises(InvalidDataError, match="at most 2 integrators"):
        given_integrators(3)
    with pytest.raises(InvalidDataError, match="integrators"):
        given_integrators(-1)
