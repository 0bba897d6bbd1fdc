"""Laws and their limits: the same force along a path, and what is fitted in a law's place."""

from types import SimpleNamespace

import numpy as np
import pytest
from engine_plants import some_records, two_masses, with_effects

from modal.discrepancy import nodes
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.drive import drive_of
from modal.discrepancy.effects.effect import Motion
from modal.discrepancy.estimation import Problem, estimate, simulate_at
from modal.discrepancy.nodes import node_of
from modal.discrepancy.simpler_laws import LIMITS, has_limit, with_limits
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


def test_the_limits_of_a_law_are_fitted_in_its_place(slack_at_work):
    node, task = slack_at_work
    found = with_limits(node, task)
    assert [one.effects[0][0] for one in found] == ["gap_spring", "coulomb_friction"]
    assert all(one.effects[1] == node.effects[1] for one in found)
    assert all(one.effects[0][1] == node.effects[0][1] for one in found)
    gap, friction = found
    assert gap.fit_level < 1.0 < friction.fit_level  # the record is that of a gap, without noise
    k_in, k_out, opening = gap.fitted.unknowns.common[gap.fitted.assembly.common_of(0)][:3]
    np.testing.assert_allclose([k_out - k_in, opening], [40.0, 0.05], rtol=1e-3)


def test_a_law_that_is_not_in_the_catalogue_is_not_tried(slack_at_work):
    node, task = slack_at_work
    small = SimpleNamespace(**{**vars(task), "catalogue": {"coulomb_friction": CATALOGUE["coulomb_friction"]}})
    assert [one.effects[0][0] for one in with_limits(node, small)] == ["coulomb_friction"]


def test_a_limit_that_cannot_be_simulated_is_no_model(slack_at_work, monkeypatch):
    node, task = slack_at_work
    monkeypatch.setattr(nodes, "simulate_at", lambda *_a, **_k: None)
    assert all(np.isinf(one.held_out_level) for one in with_limits(node, task))
