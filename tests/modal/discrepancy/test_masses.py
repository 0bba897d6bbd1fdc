"""A mass that is wrong in the model: found as that mass, or left open, never an effect."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from everyday_mistakes import drives, mistake, structure, wrong_mass
from nonlinear_chain import run_chain
from outside_laws import outside_case

import modal
import okid
from modal.discrepancy import CATALOGUE, diagnose
from modal.discrepancy.fitting.estimation import estimate, simulate_at
from modal.discrepancy.fitting.nodes import node_of
from modal.discrepancy.results import Calibrated
from modal.discrepancy.selection.decision import _unproved
from modal.discrepancy.selection.form_free import curves_beside
from modal.discrepancy.selection.smaller_models import undetermined
from modal.discrepancy.setup import circumstances_of, prepare_setup, roots
from modal.discrepancy.validation.summary import _mass_words
from modal.simulation.assembly import assemble, initial_unknowns, place_effect
from modal.simulation.plant import with_masses
from modal.structure.given import given_model
from modal.structure.structural_plant import structural_plant


def model_and_records(case, **options):
    model = modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[case.force_dof], sensor_dofs=case.sensor_dofs,
        sensor_kind=case.sensor_kind, **options,
    )  # fmt: skip
    return model, [okid.Record(u, y, case.dt) for u, y in case.records]


def diagnosed(case, catalogue=CATALOGUE, **options):
    model, records = model_and_records(case, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return diagnose(model, records[:-1], records[-1], catalogue=catalogue)


FAR = (0.35, 0.45)
"""Further off than a mass may be: 1.3 times, one way or the other."""


@pytest.mark.parametrize("seed", [1002, pytest.param(1005, marks=pytest.mark.slow)])
def test_a_wrong_mass_is_that_mass_and_no_effect(seed):
    case = mistake("wrong_mass", seed)
    found = diagnosed(case)
    assert (found.status, found.findings) == ("none", ())
    masses = {one.name: one for one in found.calibrated if one.name.startswith("mass of")}
    assert len(masses) == len(case.masses)
    wrong = masses.pop(f"mass of {case.where}")
    dof = int(case.where.removeprefix("dof_"))
    true = case.masses[dof] * (1 + case.size)
    assert wrong.nominal == case.masses[dof]
    assert abs(wrong.value - true) < 4 * wrong.std < 0.05 * true
    assert all(one.value == one.nominal for one in masses.values())
    assert any(f"mass of {case.where}" in words for words in found.warnings)
    np.testing.assert_allclose(np.diag(found.model.mass)[dof], wrong.value, rtol=1e-12)


@pytest.mark.parametrize("seed", [7200, 7224, pytest.param(7203, marks=pytest.mark.slow)])
def test_a_mass_beyond_its_tolerance_is_that_mass_and_no_effect(seed):
    """Too heavy it is no gain beside other masses, too light no mass on a spring too stiff to show."""
    case = wrong_mass(seed, FAR)
    keys = ("input_gain", "missing_mode", "sensor_gain")
    found = diagnosed(case, {key: CATALOGUE[key] for key in keys})
    assert (found.status, found.findings, found.bounds_hit) == ("none", (), ())
    wrong = next(one for one in found.calibrated if one.name == f"mass of {case.where}")
    true = case.masses[int(case.where.removeprefix("dof_"))] * (1 + case.size)
    assert abs(wrong.value - true) < 4 * wrong.std < 0.05 * true
    assert any(f"mass of {case.where}" in words and "beyond the tolerance" in words for words in found.warnings)


def test_a_hung_mass_whose_spring_does_not_show_is_no_firm_name():
    """Where the masses are said to be right, what is missing of one may be found: but as a mass, not as a mode."""
    found = diagnosed(wrong_mass(7224, FAR), {"missing_mode": CATALOGUE["missing_mode"]}, mass_tolerance=0)
    assert [one.effect for one in found.findings] == ["missing_mode"]
    assert found.steps[-1].held_out_level < 1.2  # it does explain the data
    assert found.status == "unresolved"
    assert any("one of its limits explains the data as well: a mass" in words for words in found.warnings)


def with_gain(case, gain):
    """The case with inputs of the record that are so many times weaker than those that acted."""
    return replace(case, records=tuple((u / gain, y) for u, y in case.records))


def test_a_gain_beside_other_masses_is_the_scale_of_the_whole_structure():
    case = with_gain(wrong_mass(7204), 1.6)
    found = diagnosed(case, {"input_gain": CATALOGUE["input_gain"]})
    assert (found.status, [one.effect for one in found.findings]) == ("named", ["input_gain"])
    assert found.findings[0].ambiguous_with == ("scale of all masses, stiffnesses and dampings",)
    assert any("scale of all masses" in words and "weigh" in words for words in found.warnings)
    assert any("weigh" in words or "known mass added" in words for words in found.advice)


@pytest.mark.parametrize(
    ("gain", "masses", "said"), [(1.06, ["dof_0", "dof_1"], 1), (1.06, [], 0), (1.6, ["dof_0"], 0)]
)
def test_a_small_gain_beside_other_masses_is_not_determined(gain, masses, said):
    """The others are known to a tenth, not to the digits that they are held at, and with them the scale of all."""
    case = with_gain(wrong_mass(7204, (1e-9, 1e-8)), gain)
    model, (*fits, held_out) = model_and_records(case)
    given = given_model(model, fits)
    setup = prepare_setup(given, fits, (held_out,), CATALOGUE, lambda *_: None)
    plant = with_masses(given.plant, [f"mass of {dof}" for dof in masses])
    assembly = assemble(plant, [place_effect(plant, CATALOGUE["input_gain"], "input_0")])
    start = initial_unknowns(assembly, len(fits))
    start.common[-1] = gain
    start = simulate_at(assembly, start, setup.task.fit)
    node = node_of(estimate(start, setup.task.fit, iterations=8), setup.task)
    _, root = roots(setup)
    reasons = undetermined(node, root, setup.task, fits, circumstances_of(plant, fits, node))
    assert node.held_out_level < 1.2
    assert len(reasons) == said
    assert all("a gain of one, explains the data as well" in words for words in reasons)


@pytest.mark.slow
def test_a_law_beside_a_wrong_mass_is_found_with_that_mass():
    """Another law leads on held-out records as long as the mass is wrong; with other masses only the true one fits."""
    rng = np.random.default_rng(7301)
    masses, springs, dampers, dt = structure(rng, 2)
    inputs = 3 * drives(rng, 3)[:, :600]
    hard = 30 * springs[1] / np.var(run_chain(masses, springs, dampers, inputs[1:2], dt) @ [-1.0, 1.0]) / 1000
    clean = run_chain(masses, springs, dampers, inputs, dt, law=lambda d, v, t: hard * d**3, element=1)
    noisy = clean + 0.01 * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    model = modal.StructuralModel.chain(
        masses / [1.0, 0.8], 1.02 * springs, dampers, force_dofs=[0], sensor_dofs=range(2)
    )
    *fits, held_out = (okid.Record(u[:, np.newaxis], y, dt) for u, y in zip(inputs, noisy, strict=True))
    found = diagnose(
        model, fits, held_out, catalogue={key: CATALOGUE[key] for key in ("cubic_stiffness", "gap_spring")}
    )
    assert found.status == "named"
    assert [(one.effect, one.where) for one in found.findings] == [("cubic_stiffness", "element_1")]
    assert abs(found.findings[0].parameters[0].value - hard) < 4 * found.findings[0].parameters[0].std
    mass = next(one for one in found.calibrated if one.name == "mass of dof_1")
    assert abs(mass.value - masses[1]) < 4 * mass.std


@pytest.mark.parametrize(
    ("n_effects", "masses", "said"), [(1, ("mass of dof_1",), 0), (2, (), 0), (2, ("mass of dof_1",), 1), (3, (), 1)]
)
def test_other_masses_count_as_an_effect_among_what_is_named_at_once(n_effects, masses, said):
    root = SimpleNamespace(effects=(), masses=())
    best = SimpleNamespace(effects=("one",) * n_effects, masses=masses, held_out_level=1.0, fit_level=1.0)
    reasons = _unproved(best, root)
    assert len(reasons) == said
    assert all(("mass of dof_1" in words) == bool(masses) for words in reasons)


@pytest.mark.slow
def test_cross_talk_is_no_gain_beside_a_hidden_mode_and_another_mass():
    case = outside_case("cross_talk", 67204)
    model = modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[0], sensor_dofs=range(2), sensor_kind="displacement"
    )
    fit, held_out = (
        [okid.Record(one.inputs, one.outputs, one.dt) for one in part] for part in (case.fit, case.held_out)
    )
    found = diagnose(model, fit, held_out)
    assert found.status == "unresolved"
    assert any("at once fit many a law" in words for words in found.warnings)


def test_other_masses_are_no_law_of_unknown_form():
    """Of cross talk the search for curves made a model with other masses and no effect, and fell over it."""
    model, (*fits, held_out) = model_and_records(mistake("wrong_mass", 1002))
    setup = prepare_setup(given_model(model, fits), fits, (held_out,), CATALOGUE, lambda *_: None)
    _, root = roots(setup)
    assert all(node.effects for node in curves_beside(root, root, setup.task))


def test_masses_that_are_said_to_be_right_are_never_released():
    model, _ = model_and_records(mistake("wrong_mass", 1002), mass_tolerance=0)
    assert structural_plant(model).masses == ()


def test_an_inertia_whose_tolerance_is_given_is_found_although_a_gain_looks_the_same():
    """One degree of freedom with the inertia 1.6 times as large as believed, and springs known well."""
    case = mistake("record_offset", 1002)
    u = [drive for drive, _ in case.records]
    model, _ = model_and_records(case, mass_tolerance=0.5)
    heavier = modal.StructuralModel.chain(
        1.6 * case.masses, case.stiffnesses, case.dampings, force_dofs=[0], sensor_dofs=[0]
    )
    rng = np.random.default_rng(5)
    records = [modal.simulate(heavier, drive, dt=case.dt) for drive in u]
    noisy = [
        okid.Record(r.inputs, r.outputs + 0.01 * r.outputs.std() * rng.standard_normal(r.outputs.shape), r.dt)
        for r in records
    ]
    found = diagnose(model, noisy[:-1], noisy[-1])
    inertia = next(one for one in found.calibrated if one.name == "mass of dof_0")
    assert abs(inertia.value - 1.6 * case.masses[0]) < 4 * inertia.std
    assert not found.findings


def test_a_rigid_mass_is_no_rival_of_itself_on_a_stiff_spring():
    """By chance the hung mass fits better by 2 ln L of 10, at a frequency that the samples cannot show."""
    case = outside_case("wrong_mass", 4101)
    model = modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[0], sensor_dofs=[0, 1], sensor_kind="displacement"
    )
    fit, held_out = (
        [okid.Record(one.inputs, one.outputs, one.dt) for one in records] for records in (case.fit, case.held_out)
    )
    found = diagnose(model, fit, held_out, catalogue={"missing_mode": CATALOGUE["missing_mode"]})
    assert (found.status, found.findings) == ("none", ())
    heavier = next(one for one in found.calibrated if one.name == "mass of dof_0")
    assert abs(heavier.value - case.true_masses[0]) < 4 * heavier.std


def test_a_mass_that_hardly_differs_is_told_to_the_digits_that_differ():
    one = Calibrated(name="mass of dof_0", unit="kg", nominal=3.0, value=2.9984, std=1e-4, at_bound=False)
    (words,) = _mass_words([one], SimpleNamespace(masses=("mass of dof_0",)))
    assert words.startswith("the mass of dof_0 is 2.998 kg, not the 3.000 kg")


def heavier(seed, share):
    """A case in which all masses are heavier than the user believes, by one share."""
    case = wrong_mass(seed, (1e-9, 1e-8))
    return replace(case, masses=case.masses / share)


@pytest.mark.parametrize("seed", [7204, pytest.param(7211, marks=pytest.mark.slow)])
def test_a_gain_that_all_masses_would_explain_says_so(seed):
    """The records cannot tell, whether or not the masses were let go; a structure said to be weighed can."""
    case = heavier(seed, 1.04)
    keys = {"input_gain": CATALOGUE["input_gain"]}
    found = diagnosed(case, keys)
    assert found.findings[0].ambiguous_with == ("scale of all masses, stiffnesses and dampings",)
    assert any("weigh" in words for words in found.warnings)
    weighed = diagnosed(case, keys, mass_tolerance=0)
    assert (weighed.status, weighed.findings[0].ambiguous_with) == ("named", ())
    assert not any("weigh" in words for words in weighed.warnings)


@pytest.mark.parametrize(
    ("forces", "base", "one_drive"), [([0], None, True), ([0, 1], None, False), ([], [[1.0], [1.0]], False)]
)
def test_larger_masses_are_a_weaker_drive_where_one_force_drives_them(forces, base, one_drive):
    """A ground that shakes shakes larger masses more; of two forces one would tell."""
    model = modal.StructuralModel.chain(
        [1.0, 0.8], [400.0, 300.0], [0.8, 0.6], force_dofs=forces, sensor_dofs=[0, 1], base_motion=base
    )
    rng = np.random.default_rng(3)
    record = modal.simulate(model, rng.standard_normal((300, max(len(forces), 1))), dt=0.03)
    noisy = replace(record, outputs=record.outputs + 1e-4 * rng.standard_normal(record.outputs.shape))
    given = given_model(model, (noisy,))
    _, root = roots(prepare_setup(given, (noisy,), (noisy,), CATALOGUE, lambda *_: None))
    assert ("one_drive" in circumstances_of(given.plant, (noisy,), root)) == one_drive
