"""StructuralModel: what it holds, what it refuses, and the numbers that it derives."""

from dataclasses import replace

import control
import numpy as np
import pytest
from engine_records import DT, held_noise, run
from systems import chain_matrices, structure

from modal.structure import structural_model
from modal.structure.given import simulate
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_plant import Element
from okid.errors import InvalidDataError, NumericalError
from okid.record import Record

MASSES, SPRINGS, DAMPERS = [1.5, 0.8, 1.1], [900.0, 700.0, 400.0], [0.9, 0.4, 0.3]


def chain(**options: object) -> StructuralModel:
    return StructuralModel.chain(MASSES, SPRINGS, DAMPERS, **{"force_dofs": [2], "sensor_dofs": [0, 2], **options})


def matrices(**options: object) -> StructuralModel:
    given = {"force_map": np.eye(3)[:, [2]], "sensor_map": np.eye(3)[[0, 2]], "sensor_kind": "displacement"}
    return StructuralModel(*chain_matrices(MASSES, SPRINGS, DAMPERS), **{**given, **options})


def test_a_chain_is_its_matrices() -> None:
    built, given = chain(), matrices()
    for name in ("mass", "damping", "stiffness", "force_map", "sensor_map"):
        np.testing.assert_allclose(getattr(built, name), getattr(given, name), rtol=1e-15)
        assert not getattr(built, name).flags.writeable
    assert [e.name for e in built.elements] == [e.name for e in given.elements]
    assert (built.n_dofs, built.n_inputs, built.n_outputs) == (3, 1, 2)


def test_names_and_units() -> None:
    model = chain(sensor_kind=("velocity", "acceleration"))
    assert (model.input_names, model.output_names) == (("input_0",), ("output_0", "output_1"))
    assert (model.input_units, model.output_units) == (("N",), ("m/s", "m/s^2"))
    turned = chain(length_unit="rad", force_unit="N m", output_units=("deg", "deg"))
    assert (turned.input_units, turned.output_units) == (("N m",), ("deg", "deg"))


def test_numbers_stand_for_one_mass() -> None:
    model = StructuralModel.chain(2.0, 50.0, 0.1, force_dofs=0, sensor_dofs=0, sensor_kind="velocity")
    assert model.stiffness.tolist() == [[50.0]]
    assert model.elements == (Element(name="element_0", start=0, end=None, stiffness=50.0, damping=0.1),)


def test_free_decay_needs_no_input() -> None:
    model = StructuralModel.chain([1.0], [9.0], [0.1], force_dofs=(), sensor_dofs=[0])
    assert model.n_inputs == 0
    assert model.input_names == ()


def test_a_base_acceleration_stands_after_the_forces() -> None:
    model = chain(base_motion=np.column_stack([np.zeros(3), np.ones(3)]))
    assert model.force_map.shape == (3, 2)
    assert model.input_units == ("N", "m/s^2")
    with pytest.raises(InvalidDataError, match="input 0 has a column in force_map and in base_motion"):
        chain(base_motion=np.ones((3, 1)))


def test_frequencies_and_damping_are_those_of_the_poles() -> None:
    truth = structure(
        *chain_matrices(MASSES, SPRINGS, DAMPERS), force_dofs=[2], sensor_dofs=[0], sensor_kinds="velocity", dt=0.01
    )
    model = chain()
    np.testing.assert_allclose(model.natural_frequencies, truth.frequencies, rtol=1e-9)
    np.testing.assert_allclose(model.damping_ratios, truth.damping_ratios, rtol=1e-9)


def test_rigid_body_motion_is_no_mode_and_a_real_pole_is_one() -> None:
    free = StructuralModel.chain([1.0, 1.0], [0.0, 50.0], [0.0, 0.1], force_dofs=0, sensor_dofs=0)
    np.testing.assert_allclose(free.natural_frequencies, [np.sqrt(100.0) / (2 * np.pi)], rtol=1e-3)
    shaft = StructuralModel([[2.0]], [[0.5]], [[0.0]], force_map=[[1.0]], sensor_map=[[1.0]], sensor_kind="velocity")
    np.testing.assert_allclose(shaft.natural_frequencies, [0.25 / (2 * np.pi)])
    np.testing.assert_allclose(shaft.damping_ratios, [1.0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sensor_kind": "strain"}, "sensor_kind must be displacement or velocity or acceleration, but is 'strain'"),
        ({"sensor_kind": ("velocity",)}, "1 sensor kinds were given for 2 outputs"),
        ({"force_map": np.eye(2)}, r"force_map must have shape \(3, any\), but has \(2, 2\)"),
        ({"sensor_map": np.eye(4)}, r"sensor_map must have shape \(any, 3\)"),
        ({"sensor_map": np.zeros((0, 3))}, "at least one output"),
        ({"input_names": ("a", "b")}, "2 input names were given for 1 inputs"),
        ({"input_names": ("a",), "output_names": ("a", "b")}, "names must be unique, but 'a'"),
        ({"stiffness_tolerance": 0.0}, "stiffness_tolerance must be a positive relative deviation"),
        ({"damping_tolerance": "much"}, "damping_tolerance must be a positive relative deviation"),
        ({"sensor_map": np.full((1, 3), np.nan)}, "sensor_map must be finite"),
        ({"elements": [(0, 7)]}, "joins two of the DOFs 0 to 2"),
    ],
)
def test_refuses_parts(change: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidDataError, match=words) as caught:
        matrices(**change)
    assert str(caught.value).count(". ") == 0


@pytest.mark.parametrize(
    ("mass", "damping", "stiffness", "words"),
    [
        ([[1.0, 0.2], [0.0, 1.0]], None, None, r"mass must be symmetric, but entry \(0, 1\) is 0\.2"),
        ([[1.0, 0.0], [0.0, 0.0]], None, None, "mass must be positive definite, but its eigenvalues reach from 0 to 1"),
        ([[1.0, 2.0], [2.0, 1.0]], None, None, "mass must be positive definite"),
        (None, None, [[1.0, -3.0], [-3.0, 1.0]], "stiffness must be positive semidefinite.* lowest eigenvalue is -2"),
        (None, [[-0.1, 0.0], [0.0, 0.1]], None, "damping must be positive semidefinite"),
        (None, np.eye(3), None, r"damping must have shape \(2, 2\), but has \(3, 3\)"),
        (np.zeros((0, 0)), None, None, "at least one degree of freedom"),
        ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], None, None, r"mass must have shape \(2, 2\), but has \(2, 3\)"),
    ],
)
def test_refuses_matrices(mass: object, damping: object, stiffness: object, words: str) -> None:
    two = np.eye(2)
    with pytest.raises(InvalidDataError, match=words):
        StructuralModel(
            two if mass is None else mass,
            two if damping is None else damping,
            two if stiffness is None else stiffness,
            force_map=two,
            sensor_map=two,
            sensor_kind="displacement",
        )


def test_singular_stiffness_is_a_free_structure_not_an_error() -> None:
    rounding = np.array([[1.0, -1.0], [-1.0, 1.0 - 1e-13]])
    StructuralModel(
        np.eye(2), np.zeros((2, 2)), rounding, force_map=np.eye(2), sensor_map=np.eye(2), sensor_kind="velocity"
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"force_dofs": [3]}, "force_dofs must be DOF numbers from 0 to 2, but holds 3"),
        ({"sensor_dofs": [0.5]}, r"sensor_dofs must be DOF numbers from 0 to 2, but holds 0\.5"),
        ({"sensor_dofs": []}, "at least one output"),
    ],
)
def test_chain_refuses(options: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidDataError, match=words):
        chain(**options)


def test_chain_needs_one_entry_a_mass() -> None:
    with pytest.raises(InvalidDataError, match="has 2 masses and 1 dampings"):
        StructuralModel.chain([1.0, 1.0], [1.0, 1.0], [1.0], force_dofs=0, sensor_dofs=0)


def test_with_effect_adds_and_leaves_the_first_alone() -> None:
    plain = chain()
    rubbing = plain.with_effect("coulomb_friction", "element_1", Fc=0.5)
    both = rubbing.with_effect("input_delay", "input_0", tau=0.01)
    assert plain.effects == ()
    assert [(one.effect, one.where, one.values) for one in both.effects] == [
        ("coulomb_friction", "element_1", (0.5,)),
        ("input_delay", "input_0", (0.01,)),
    ]
    assert plain.with_effect("cubic_stiffness", "dof_0", k3=1.0).effects[0].where == "element_0"
    assert "coulomb_friction at element_1" in repr(rubbing)
    assert "element_1" in rubbing.equations()


@pytest.mark.parametrize(
    ("effect", "where", "values", "words"),
    [
        ("stiction", "element_1", {}, "no effect 'stiction' in the catalogue; it holds cubic_stiffness"),
        ("cubic_stiffness", "element_9", {"k3": 1.0}, "no place 'element_9'; cubic_stiffness can act at element_0"),
        ("cubic_stiffness", "output_0", {"k3": 1.0}, "cubic_stiffness cannot act at 'output_0'; cubic_stiffness can"),
        (
            "missing_mode",
            "element_1",
            {},
            "missing_mode cannot act at 'element_1'; missing_mode can act at element_0, dof_1",
        ),
        ("input_delay", "dof_1", {"tau": 0.1}, "input_delay can act at input_0"),
        ("coulomb_friction", "element_1", {}, "coulomb_friction lacks Fc; its parameters are Fc: friction force"),
        ("coulomb_friction", "element_1", {"Fc": 1.0, "mu": 2.0}, "coulomb_friction has no parameter mu"),
        ("coulomb_friction", "element_1", {"Fc": -1.0}, "must be at least 0, but is -1"),
        ("coulomb_friction", "element_1", {"Fc": float("nan")}, "must be a number, but is nan"),
        ("coulomb_friction", "element_1", {"Fc": [1.0, 2.0]}, "Fc of coulomb_friction is one number for all records"),
    ],
)
def test_with_effect_refuses(effect: str, where: str, values: dict[str, float], words: str) -> None:
    with pytest.raises(InvalidDataError, match=words):
        chain().with_effect(effect, where, **values)


def test_a_chain_beyond_the_memory_is_refused_before_its_matrices_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(structural_model, "memory_budget", lambda: (2**31, "the container leaves"))
    many = np.ones(20_000)
    with pytest.raises(
        InvalidDataError, match=r"matrices of 20000 masses need about 35\.8 GiB, more than 80% of the 2"
    ):
        StructuralModel.chain(many, many, many, force_dofs=[0], sensor_dofs=[0])


def long_chain(**options):
    return StructuralModel.chain(
        [1.0, 0.8], [100.0, 150.0], [0.5, 0.3], force_dofs=[0, 1], sensor_dofs=[0, 1], **options
    )


PUSH = held_noise(200, 2, 3) * 3.0


def truth(law=None, element=0):
    return run(np.array([1.0, 0.8]), [100.0, 150.0], [0.5, 0.3], PUSH, law=law, element=element, n_steps=20)


def test_a_linear_structure():
    found = simulate(long_chain(), PUSH, dt=DT)
    assert np.abs(found.outputs - truth()).max() < 1e-6 * truth().std()
    assert found.dt == DT
    assert found.output_names == ("output_0", "output_1")
    assert np.array_equal(found.inputs, PUSH)


def test_with_effects():
    model = long_chain().with_effect("cubic_stiffness", "element_1", k3=3000.0)
    expected = truth(lambda d, v, t: 3000.0 * d**3, element=1)
    assert np.abs(simulate(model, PUSH, dt=DT).outputs - expected).max() < 2e-3 * expected.std()
    gained = simulate(model.with_effect("sensor_gain", "output_1", gain=1.1), PUSH, dt=DT)
    assert np.allclose(gained.outputs[:, 1], 1.1 * simulate(model, PUSH, dt=DT).outputs[:, 1])


def test_a_record_brings_its_inputs_hold_and_time_step():
    record = Record(PUSH, np.full((200, 2), 7.0), DT, input_hold="linear", output_names=("a", "b"), name="run")
    found = simulate(long_chain(), record)
    assert found.name == "run"
    assert found.input_hold == "linear"
    assert not np.allclose(found.outputs, simulate(long_chain(), PUSH, dt=DT).outputs)
    assert np.array_equal(
        found.outputs, simulate(long_chain(), replace(record, outputs=0 * record.outputs + 1.0)).outputs
    )


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
        simulate(long_chain(), PUSH)
    with pytest.raises(InvalidDataError, match="2 inputs and the record has 1"):
        simulate(long_chain(), PUSH[:, :1], dt=DT)
    with pytest.raises(InvalidDataError, match="4 states and 3"):
        simulate(long_chain(), PUSH, dt=DT, initial_state=[0.0, 0.0, 0.0])
    with pytest.raises(InvalidDataError):
        simulate(3, PUSH, dt=DT)
    with pytest.raises(InvalidDataError, match=r"missing \(NaN\) at 1 of 200 samples, first at number 41"):
        simulate(long_chain(), np.where(np.arange(200)[:, np.newaxis] == 40, np.nan, np.ones((200, 2))), dt=DT)
    with pytest.raises(NumericalError, match="grows without bound"):
        simulate(long_chain().with_effect("cubic_stiffness", "element_0", k3=-1e6), PUSH, dt=DT)
