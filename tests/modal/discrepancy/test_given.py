"""From a model to a plant with effects, and back."""

from dataclasses import replace

import control
import numpy as np
import pytest
from engine_plants import VALUES
from engine_records import experiment, nominal

from modal.discrepancy.drive import drive_of
from modal.discrepancy.given import given_model, placed_assembly, returned_model
from modal.discrepancy.plant_model import PlantModel
from modal.structure import StructuralModel
from okid.errors import InvalidDataError
from okid.record import Record


def records():
    fit, _, _ = experiment(None, n_samples=200)
    return fit


def test_a_structural_model_keeps_its_plant_and_effects():
    model = nominal().with_effect("cubic_stiffness", "element_0", k3=5.0)
    found = given_model(model, records())
    assert found.model is model
    assert found.effects == model.effects
    assert np.array_equal(found.linear, found.plant.nominal)


def test_a_state_space_becomes_a_plant_with_the_records_names():
    named = [replace(r, output_names=("tip",), output_units=("m/s^2",), input_units=("N",)) for r in records()]
    system = control.ss([[0, 1], [-100.0, -1.0]], [[0], [1]], [[-100.0, -1.0]], [[1]])
    found = given_model(system, named)
    assert isinstance(found.model, PlantModel)
    assert found.plant.output_names == ("tip",)
    assert found.plant.output_units == ("m/s^2",)
    again = given_model(found.model, named)
    assert again.plant is found.plant


@pytest.mark.parametrize(
    ("unit", "rows_of"),
    [
        ("m", "displacement"),
        ("mm/s", "velocity"),
        ("m/s^2", "acceleration"),
        ("g", "acceleration"),
        ("", "displacement"),
    ],
)
def test_the_unit_tells_what_an_output_is(unit, rows_of):
    named = [replace(r, output_units=(unit,)) for r in records()]
    D = [[1.0]] if rows_of == "acceleration" else [[0.0]]
    C = {"displacement": [[1, 0]], "velocity": [[0, 1]], "acceleration": [[-100.0, -1.0]]}[rows_of]
    system = control.ss([[0, 1], [-100.0, -1.0]], [[0], [1]], C, D)
    guessed, told = given_model(system, named), given_model(system, named, sensor_kind=rows_of)
    for ours, theirs in zip(guessed.plant.ports, told.plant.ports, strict=True):
        assert ours.name == theirs.name
        assert np.allclose(ours.displacement, theirs.displacement)


def test_what_is_no_model_is_refused():
    with pytest.raises(InvalidDataError, match="a dict was given"):
        given_model({"A": 1}, records())


def test_effects_stand_at_their_values_and_scales():
    model = (
        nominal()
        .with_effect("bouc_wen_hysteresis", "element_0", a=30.0, yield_displacement=0.01, n=1.5)
        .with_effect("periodic_disturbance", "element_0", amplitude=2.0, frequency=3.0, phase=0.5)
        .with_effect("input_delay", "input_0", tau=0.01)
    )
    given = given_model(model, records())
    drive = drive_of(records())
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, drive)
    assert [float(v) for v in unknowns.values(assembly, 0)] == [30.0, 0.01, 1.5]
    amplitude, frequency, phase = unknowns.values(assembly, 1)
    assert (amplitude, frequency) == (2.0, 3.0)
    assert np.array_equal(phase, [0.5, 0.5])
    assert unknowns.values(assembly, 2)[0] == 0.01
    moved = np.concatenate([r.outputs for r in records()]).std()
    assert assembly.placements[0].displacement_scale == pytest.approx(moved, rel=0.15)
    assert assembly.placements[0].velocity_scale == pytest.approx(moved * 10, rel=0.3)


def test_initial_states_count_for_the_scale():
    given = given_model(nominal().with_effect("coulomb_friction", "element_0", Fc=0.1), records())
    silent = drive_of([replace(r, inputs=0 * r.inputs) for r in records()])
    start = np.array([[0.2, 0.0], [0.1, 0.0]])
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, silent, initial=start)
    assert np.array_equal(unknowns.local, start)
    assert 0.1 < assembly.placements[0].velocity_scale < 2.0
    assembly, _ = placed_assembly(given.plant, given.linear, given.effects, silent)
    assert assembly.placements[0].velocity_scale == 1.0


def test_there_and_back_again():
    keys = {"cubic_stiffness": "element_0", "periodic_disturbance": "element_0", "sensor_gain": "output_0"}
    model = nominal()
    for key, where in keys.items():
        effect_names = {
            "cubic_stiffness": ("k3",),
            "periodic_disturbance": ("amplitude", "frequency", "phase"),
            "sensor_gain": ("gain",),
        }
        model = model.with_effect(key, where, **dict(zip(effect_names[key], VALUES[key], strict=True)))
    given = given_model(model, records())
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, drive_of(records()))
    common = unknowns.common.copy()
    common[0] = 98.0
    deviations = np.arange(1.0, assembly.n_common + 1)
    found = returned_model(given, assembly, replace(unknowns, common=common), deviations)
    assert isinstance(found, StructuralModel)
    assert found.stiffness[0, 0] == pytest.approx(98.0)
    assert found.damping[0, 0] == pytest.approx(0.7)
    for ours, theirs in zip(found.effects, model.effects, strict=True):
        assert (ours.effect, ours.where, ours.names) == (theirs.effect, theirs.where, theirs.names)
        assert np.allclose(ours.values, theirs.values)
    assert found.effects[0].deviations == (3.0,)
    assert found.effects[1].deviations[:2] == (4.0, 5.0)
    assert np.isnan(found.effects[1].deviations[2])
    assert found.effects[1].local_values[2] == (0.4, 0.4)
    assert model.stiffness[0, 0] == 103.0


def two_outputs(**names):
    return StructuralModel.chain([1.0, 1.0], [9.0, 9.0], [0.1, 0.1], force_dofs=[0], sensor_dofs=[0, 1], **names)


def record_of_two(**names):
    values = np.random.default_rng(1).standard_normal((50, 3))
    return Record(values[:, :1], values[:, 1:], 0.1, **names)


def test_a_model_without_names_is_called_as_the_records_are():
    model = two_outputs().with_effect("sensor_gain", "output_1", gain=0.9)
    record = record_of_two(input_names=["shaker"], output_names=["floor", "roof"])
    found = given_model(model, [record])
    assert (found.plant.input_names, found.plant.output_names) == (("shaker",), ("floor", "roof"))
    assert [one.where for one in found.effects] == ["roof"]
    assert found.model.effects == found.effects


@pytest.mark.parametrize(
    ("own", "theirs", "kept"),
    [
        (("a", "b"), ("floor", "roof"), ("a", "b")),  # it has names
        (None, ("element_0", "roof"), ("output_0", "output_1")),  # an element is called so
        (None, ("dof_1", "roof"), ("output_0", "output_1")),  # a place is called so
        (None, ("output_0", "output_1"), ("output_0", "output_1")),
        (None, ("input_0x", "output_0"), ("input_0x", "output_0")),
    ],
)
def test_names_that_mean_something_stay(own, theirs, kept):
    model = two_outputs(output_names=own or ())
    found = given_model(model, [record_of_two(output_names=theirs)])
    assert found.plant.output_names == kept
    assert (found.model is model) == (found.plant.output_names == model.output_names)


def test_records_of_another_number_of_channels_name_nothing():
    model = two_outputs()
    record = Record(np.ones(50) + np.arange(50), np.arange(50.0), 0.1, output_names=["only"])
    assert given_model(model, [record]).model is model
