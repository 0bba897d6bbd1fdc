"""Laws and their limits: the same force along a path, and what is fitted in a law's place."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from engine_plants import some_records, two_masses, with_effects

from modal.discrepancy import nodes, simpler_laws
from modal.discrepancy.assembly import Unknowns, assemble, initial_unknowns, place_effect
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.drive import drive_of
from modal.discrepancy.effects.effect import Motion
from modal.discrepancy.estimation import Problem, estimate, simulate_at
from modal.discrepancy.nodes import Node, node_of
from modal.discrepancy.simpler_laws import LIMITS, TWINS, has_limit, with_limits, with_twins
from modal.discrepancy.structural_plant import structural_plant
from modal.structure import StructuralModel
from okid.record import Record


def force_along(law, values, displacement):
    """Force of a law along a path of straight pieces, its own state led on step by step."""
    effect, state, found = CATALOGUE[law], np.zeros((1, CATALOGUE[law].n_memory)), []

    def at(k, memory):
        rise = displacement[min(k + 1, len(displacement) - 1)] - displacement[max(k - 1, 0)]
        return Motion(
            displacement=displacement[k : k + 1],
            velocity=np.array([np.sign(rise)]),
            time=np.zeros(1),
            memory=memory,
            displacement_scale=1.0,
            velocity_scale=1.0,
        )

    for k in range(len(displacement)):
        found.append(effect.force(values, at(k, state)).value[0])
        if effect.n_memory and k + 1 < len(displacement):
            still = [Motion(**{**vars_of(at(j, state)), "velocity": np.zeros(1)}) for j in (k, k + 1)]
            state = effect.advance(values, *still, 1.0).value
    return np.array(found)


def vars_of(motion):
    return {name: getattr(motion, name) for name in motion.__dataclass_fields__}


@pytest.mark.parametrize(
    ("law", "values", "limit"),
    [
        ("slack_in_hysteresis", (3.0, 1e6, 0.4), "gap_spring"),
        ("slack_in_hysteresis", (3.0e6, 1e-6, 1e-6), "coulomb_friction"),
        ("bouc_wen_hysteresis", (3.0e6, 1e-6, 2.0), "coulomb_friction"),
    ],
)
def test_at_its_end_a_law_is_its_limit(law, values, limit):
    path = np.cumsum(np.concatenate([[0.0], np.full(9, 0.13), np.full(22, -0.11), np.full(15, 0.09)]))
    simpler = next(one for one in LIMITS[law] if one.law == limit)
    rich, simple = force_along(law, values, path), force_along(limit, simpler.values(values), path)
    inside = np.ones(len(path), dtype=bool)
    inside[[0, 9, 31, len(path) - 1]] = limit == "gap_spring"  # the sign of friction turns at a corner of the path
    np.testing.assert_allclose(rich[inside], simple[inside], rtol=1e-3, atol=1e-3)
    assert np.abs(simple).max() > 0.5


def test_which_law_has_which_limit():
    assert has_limit("slack_in_hysteresis", "gap_spring")
    assert not has_limit("gap_spring", "slack_in_hysteresis")
    assert not has_limit("cubic_stiffness", "gap_spring")


@pytest.fixture(scope="module")
def slack_at_work():
    """A model with slack that never slips beside a sensor gain, as a node; what it simulates is the record."""
    plant = two_masses()
    drive = drive_of(some_records(plant, missing=0.0))
    assembly, unknowns = with_effects(plant, ["slack_in_hysteresis", "sensor_gain"], drive.n_records)
    unknowns.common[assembly.common_of(0)] = [40.0, 1e3, 0.05]
    item = replace(assembly.placements[0], displacement_scale=0.2)
    assembly = replace(assembly, placements=(item, assembly.placements[1]))
    unknowns.local[:] = 0.0  # at rest, the slack in its middle
    floor = np.full((drive.n_records, plant.n_outputs), 1e-8)
    simulated = simulate_at(assembly, unknowns, Problem(drive=drive, floor=floor))
    records = [
        Record(one.inputs, simulated.trajectory.outputs[drive.rows_of(i)], one.dt, input_hold=one.input_hold)
        for i, one in enumerate(some_records(plant, missing=0.0))
    ]
    fit = Problem(drive=drive_of(records), floor=floor)
    held = Problem(drive=drive_of(records), floor=floor, free_common=False)
    task = SimpleNamespace(
        fit=fit, held_out=held, fine_fit=fit, fine_held_out=held, upsampling=1, catalogue=CATALOGUE, report=None
    )
    start = simulate_at(assembly, unknowns, fit)
    return node_of(estimate(start, fit, iterations=1), task), task


def test_the_limit_of_a_law_is_fitted_in_its_place(slack_at_work):
    node, task = slack_at_work
    (found,) = with_limits(node, task)
    assert found.effects == (("gap_spring", node.effects[0][1]), node.effects[1])
    assert found.fit_level < 1.0  # the record is that of a gap, without noise
    k_in, k_out, opening = found.fitted.unknowns.common[found.fitted.assembly.common_of(0)][:3]
    np.testing.assert_allclose([k_out - k_in, opening], [40.0, 0.05], rtol=1e-3)


def test_a_law_that_is_not_in_the_catalogue_is_not_tried(slack_at_work):
    node, task = slack_at_work
    small = SimpleNamespace(**{**vars(task), "catalogue": {"coulomb_friction": CATALOGUE["coulomb_friction"]}})
    assert with_limits(node, small) == []


@pytest.mark.parametrize(("size", "tried"), [(0.9, ["gap_spring"]), (1.1, ["coulomb_friction"])])
def test_only_a_limit_that_may_be_near_is_tried(slack_at_work, monkeypatch, size, tried):
    """Slack and yield displacement are 1.0 together."""
    node, task = slack_at_work
    asked = []
    monkeypatch.setattr(simpler_laws, "instead", lambda _node, _i, law, _values, _task: asked.append(law.effect.key))
    with_limits(at_scale(node, size), task)
    assert asked == tried


def at_scale(node, size):
    fitted = node.coarse
    items = (replace(fitted.assembly.placements[0], displacement_scale=size), *fitted.assembly.placements[1:])
    common = fitted.unknowns.common.copy()
    common[fitted.assembly.common_of(0)] = [40.0, 0.9, 0.1]
    changed = replace(
        fitted,
        assembly=replace(fitted.assembly, placements=items),
        unknowns=Unknowns(common=common, local=fitted.unknowns.local),
    )
    return Node(fitted=changed, held_out=None, coarse=changed)


def test_a_limit_that_is_there_already_is_not_tried(slack_at_work, monkeypatch):
    node, task = slack_at_work
    monkeypatch.setattr(simpler_laws, "instead", lambda *_args: pytest.fail("tried"))
    fitted = node.coarse
    both = replace(fitted.assembly.placements[0], effect=CATALOGUE["gap_spring"])
    twice = replace(fitted.assembly, placements=(*fitted.assembly.placements, both))
    common = np.concatenate([fitted.unknowns.common, [0.0, 1.0, 0.1]])
    changed = replace(fitted, assembly=twice, unknowns=Unknowns(common=common, local=fitted.unknowns.local))
    assert with_limits(Node(fitted=changed, held_out=None, coarse=changed), task) == []


def test_a_limit_that_cannot_be_simulated_is_no_model(slack_at_work, monkeypatch):
    node, task = slack_at_work
    monkeypatch.setattr(nodes, "simulate_at", lambda *_a, **_k: None)
    assert all(np.isinf(one.held_out_level) for one in with_limits(node, task))


@pytest.mark.parametrize(
    ("key", "twin"), [("cubic_stiffness", "sine_softening"), ("sine_softening", "cubic_stiffness")]
)
def test_a_law_and_its_twin_are_the_same_to_third_order(key, twin):
    stiffness, d = 93.0, np.array([0.01, 0.02])
    values = {"cubic_stiffness": (-31.0,), "sine_softening": (0.7,)}[key]
    name, as_twin = TWINS[key]
    assert name == twin

    def force(law, at):
        motion = Motion(
            displacement=d,
            velocity=0.0 * d,
            time=0.0 * d,
            memory=np.zeros((2, 0)),
            displacement_scale=1.0,
            velocity_scale=1.0,
            stiffness=stiffness,
        )
        return CATALOGUE[law].force(at, motion).value

    np.testing.assert_allclose(force(twin, as_twin(values, stiffness)), force(key, values), rtol=1e-3)


def test_a_hardening_spring_has_no_twin():
    assert TWINS["cubic_stiffness"][1]((31.0,), 93.0) is None


@pytest.mark.parametrize(
    ("value", "known", "asked"),
    [
        (-31.0, [], [("sine_softening", np.sqrt(93.0 / (6.0 * 31.0)))]),
        (31.0, [], []),
        (-31.0, [("sine_softening", "element_0")], []),  # the search has fitted it already
    ],
)
def test_the_twin_of_a_law_is_fitted_in_its_place_unless_it_was_already(monkeypatch, value, known, asked):
    plant = structural_plant(StructuralModel.chain([1.0], [90.0], [1.0], force_dofs=[0], sensor_dofs=[0]))
    assembly = assemble(plant, [place_effect(plant, CATALOGUE["cubic_stiffness"], "element_0")])
    unknowns = initial_unknowns(assembly, 2)
    common = unknowns.common.copy()
    common[assembly.stiffness_parameter(0)], common[assembly.common_of(0)] = 93.0, value
    fitted = SimpleNamespace(assembly=assembly, unknowns=Unknowns(common=common, local=unknowns.local))
    node = SimpleNamespace(coarse=fitted, effects=(("cubic_stiffness", assembly.placements[0].where),))
    tried = []
    monkeypatch.setattr(
        simpler_laws, "instead", lambda _node, _i, law, values, _task: tried.append((law.effect.key, values[0]))
    )
    with_twins(node, SimpleNamespace(catalogue=CATALOGUE), [SimpleNamespace(effects=known)])
    assert tried == [(key, pytest.approx(value)) for key, value in asked]
