"""Simulating a model with its effects, against a Runge-Kutta loop."""

from dataclasses import replace

import control
import numpy as np
import pytest
from engine_records import DT, held_noise, run

from modal.structure.given import simulate
from modal.structure.structural_model import StructuralModel
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record


def chain(**options):
    return StructuralModel.chain(
        [1.0, 0.8], [100.0, 150.0], [0.5, 0.3], force_dofs=[0, 1], sensor_dofs=[0, 1], **options
    )


PUSH = held_noise(200, 2, 3) * 3.0


def truth(law=None, element=0):
    return run(np.array([1.0, 0.8]), [100.0, 150.0], [0.5, 0.3], PUSH, law=law, element=element, n_steps=20)


def test_a_linear_structure():
    found = simulate(chain(), PUSH, dt=DT)
    assert np.abs(found.outputs - truth()).max() < 1e-6 * truth().std()
    assert found.dt == DT
    assert found.output_names == ("output_0", "output_1")
    assert np.array_equal(found.inputs, PUSH)


def test_with_effects():
    model = chain().with_effect("cubic_stiffness", "element_1", k3=3000.0)
    expected = truth(lambda d, v, t: 3000.0 * d**3, element=1)
    assert np.abs(simulate(model, PUSH, dt=DT).outputs - expected).max() < 2e-3 * expected.std()
    gained = simulate(model.with_effect("sensor_gain", "output_1", gain=1.1), PUSH, dt=DT)
    assert np.allclose(gained.outputs[:, 1], 1.1 * simulate(model, PUSH, dt=DT).outputs[:, 1])


def test_a_record_brings_its_inputs_hold_and_time_step():
    record = Record(PUSH, np.full((200, 2), 7.0), DT, input_hold="linear", output_names=("a", "b"), name="run")
    found = simulate(chain(), record)
    assert found.name == "run"
    assert found.input_hold == "linear"
    assert not np.allclose(found.outputs, simulate(chain(), PUSH, dt=DT).outputs)
    assert np.array_equal(found.outputs, simulate(chain(), replace(record, outputs=0 * record.outputs + 1.0)).outputs)


def test_an_initial_state_without_any_input():
    model = StructuralModel.chain([1.0], [100.0], [1.0], force_dofs=[0], sensor_dofs=[0])
    found = simulate(model, np.zeros((100, 1)), dt=DT, initial_state=[0.2, 0.0]).outputs[:, 0]
    t = np.arange(100) * DT
    w = np.sqrt(100.0 - 0.25)
    assert np.allclose(found, 0.2 * np.exp(-0.5 * t) * (np.cos(w * t) + 0.5 / w * np.sin(w * t)), atol=1e-12)
    rubbed = simulate(
        model.with_effect("coulomb_friction", "element_0", Fc=0.5), np.zeros((200, 1)), dt=DT, initial_state=[0.2, 0.0]
    )
    assert np.abs(rubbed.outputs[150:]).max() < 0.011
    assert np.abs(rubbed.outputs[:10]).max() > 0.15


def test_a_state_space_model_and_a_callable():
    system = control.ss([[0, 1], [-100.0, -1.0]], [[0], [1]], [[1, 0]], [[0]])
    model = StructuralModel.chain([1.0], [100.0], [1.0], force_dofs=[0], sensor_dofs=[0])
    one = PUSH[:, :1]
    expected = simulate(model, one, dt=DT).outputs
    assert np.allclose(simulate(system, one, dt=DT).outputs, expected, atol=1e-10)
    found = simulate(lambda record: replace(record, outputs=2 * record.inputs), one, dt=DT)
    assert np.array_equal(found.outputs, 2 * one)
    with pytest.raises(InvalidDataError, match="callable"):
        simulate(lambda record: record.inputs, one, dt=DT)


def test_what_does_not_match_is_refused_in_a_sentence():
    with pytest.raises(InvalidDataError, match="pass dt"):
        simulate(chain(), PUSH)
    with pytest.raises(InvalidDataError, match="2 inputs and the record has 1"):
        simulate(chain(), PUSH[:, :1], dt=DT)
    with pytest.raises(InvalidDataError, match="4 states and 3"):
        simulate(chain(), PUSH, dt=DT, initial_state=[0.0, 0.0, 0.0])
    with pytest.raises(InvalidDataError):
        simulate(3, PUSH, dt=DT)
    with pytest.raises(NumericalError, match="grows without bound"):
        simulate(chain().with_effect("cubic_stiffness", "element_0", k3=-1e6), PUSH, dt=DT)
