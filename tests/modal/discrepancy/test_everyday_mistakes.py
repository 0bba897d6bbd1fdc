"""A zero that moves, lags, friction that falls with speed: found by name in records of an integrator of its own."""

import warnings
from dataclasses import replace

import everyday_mistakes
import numpy as np
import pytest
import scipy
from engine_records import experiment, nominal
from everyday_mistakes import mistake

import modal
import okid
from modal.discrepancy import CATALOGUE, decide, diagnose
from modal.discrepancy.fitting.estimation import estimate, simulate_at
from modal.discrepancy.fitting.nodes import node_of
from modal.discrepancy.selection.smaller_models import merged
from modal.discrepancy.setup import prepare_setup
from modal.structure.given import given_model, placed_assembly


def diagnosed(case):
    model = modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[case.force_dof], sensor_dofs=case.sensor_dofs
    )
    records = [okid.Record(u, y, case.dt) for u, y in case.records]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return diagnose(model, records[:-1], records[-1])


@pytest.mark.parametrize("kind", ["record_offset", "actuator_lag", "sensor_lag"])
def test_the_mistake_is_named(kind):
    case = mistake(kind, 1002)
    found = diagnosed(case)
    assert found.status == "named"
    assert [(one.effect, one.where) for one in found.findings] == [(kind, case.where)]
    assert found.steps[-1].held_out_level < 1.2
    assert all(one.share < 0.1 for one in found.lack_of_fit)  # of the mistake, not of what else a record may adjust
    if kind != "record_offset":
        tau = found.findings[0].parameters[0]
        assert abs(tau.value - case.size * case.dt) < max(4 * tau.std, 0.02 * tau.value)


def test_zeros_that_moved_in_the_records_to_fit_alone_are_named():
    """A held-out record without what is missing cannot show it: it must not hide it either."""
    fit, held_out, *_ = experiment(n_samples=400)
    moved = [replace(one, outputs=one.outputs + zero) for one, zero in zip(fit, (0.3, -0.8), strict=True)]
    found = diagnose(nominal(), moved, held_out)
    assert found.status == "named"
    assert [(one.effect, one.where) for one in found.findings] == [("record_offset", "output_0")]
    assert max(found.steps[-1].fit_level, found.steps[-1].held_out_level) < 1.2
    assert "nan" not in str(found)


def test_friction_found_in_two_steps_is_one_law():
    """First dry friction, then the excess beside it: together they are the law that has both."""
    case = mistake("stribeck_friction", 4101, n_samples=300)
    model = modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[case.force_dof], sensor_dofs=case.sensor_dofs
    )
    model = model.with_effect("coulomb_friction", "element_0", Fc=0.32)
    model = model.with_effect("stribeck_friction", "element_0", Fc=0.0, excess=0.24, stribeck_velocity=0.18)
    *fits, held_out = (okid.Record(u, y, case.dt) for u, y in case.records)
    setup = prepare_setup(given := given_model(model, fits), fits, (held_out,), CATALOGUE, lambda *_: None)
    drive = setup.task.fit.drive
    start = simulate_at(*placed_assembly(given.plant, given.linear, given.effects, drive, CATALOGUE), setup.task.fit)
    two = node_of(estimate(start, setup.task.fit, iterations=6), setup.task)
    one = merged(two, setup.task)
    assert one.effects == (("stribeck_friction", "element_0"),)
    assert one.held_out_level < 1.05 * max(two.held_out_level, 1.0)
    sliding, excess, _ = one.coarse.unknowns.common[one.coarse.assembly.common_of(0)]
    assert abs(sliding + excess - case.size) < 0.05 * case.size
    assert merged(one, setup.task) is None


def test_friction_without_an_excess_is_dry_friction():
    """What was found beside a richer law (a mass, a drag) was added to it alone: its limit is tried there, too."""
    rng = np.random.default_rng(11)
    masses, springs, dampers, dt = everyday_mistakes.structure(rng, 1)
    u = 3 * everyday_mistakes.drives(rng, 3)[:, :300]
    system = everyday_mistakes.continuous(masses, springs, dampers, force_dof=0, sensor_dofs=(0,), kind="displacement")
    clean = everyday_mistakes.rubbed(system, masses[0], u, dt, lambda v: 0.5 + 0 * v)
    noisy = clean + 0.01 * clean.std() * rng.standard_normal(clean.shape)
    speed = np.gradient(clean[1, :, 0], dt).std()
    plain = modal.StructuralModel.chain(masses, 1.02 * springs, dampers, force_dofs=[0], sensor_dofs=[0])
    rich = plain.with_effect("stribeck_friction", "element_0", Fc=0.4, excess=0.1, stribeck_velocity=0.01 * speed)
    *fits, held_out = (okid.Record(a[:, np.newaxis], y, dt) for a, y in zip(u, noisy, strict=True))
    found = decide([plain, rich], fits, held_out)
    assert found.status == "named"
    (one,) = found.findings
    assert (one.effect, one.where) == ("coulomb_friction", "element_0")
    assert abs(one.parameters[0].value - 0.5) < max(4 * one.parameters[0].std, 0.005)


def test_a_slow_force_that_nobody_measured_is_no_law_of_the_motion():
    """A curve has points enough to take up a little of anything: it must count as every effect must."""
    rng = np.random.default_rng([9, 26])
    masses, springs, dampers, dt = everyday_mistakes.structure(rng, 2)
    A, B, C, _ = everyday_mistakes.continuous(
        masses, springs, dampers, force_dof=0, sensor_dofs=(0, 1), kind="displacement"
    )
    unseen = np.array([[0.0], [0.0], [0.0], [1.0 / masses[1]]])
    known = everyday_mistakes.drives(rng, 3)[:, :700]
    pole = np.exp(-0.1 * np.abs(np.linalg.eigvals(A)).min() * dt)  # a tenth of the lowest mode
    shocks = rng.standard_normal((3, 2700))
    slow = 0.011 * scipy.signal.lfilter([np.sqrt(1 - pole**2)], [1, -pole], shocks)[:, 2000:]
    exact = scipy.signal.cont2discrete((A, np.hstack([B, unseen]), C, np.zeros((2, 2))), dt)[:4]
    clean = [scipy.signal.dlsim((*exact, dt), np.stack(both, axis=1))[1] for both in zip(known, slow, strict=True)]
    records = [
        okid.Record(u[:, np.newaxis], y + 0.01 * y.std(axis=0) * rng.standard_normal(y.shape), dt)
        for u, y in zip(known, clean, strict=True)
    ]
    springs, dampers = springs * rng.uniform(0.97, 1.03, 2), dampers * rng.uniform(0.8, 1.2, 2)
    model = modal.StructuralModel.chain(masses, springs, dampers, force_dofs=[0], sensor_dofs=[0, 1])
    assert diagnose(model, records[:-1], records[-1]).status == "unresolved"


def test_a_lagging_sensor_of_a_model_is_that_of_the_exact_system():
    rng = np.random.default_rng(7)
    masses, springs, dampers, dt = everyday_mistakes.structure(rng, 2)
    u = everyday_mistakes.drives(rng, 1)
    u[:, 0] = 0.0  # what the drive was before the record is not known
    exact = everyday_mistakes.continuous(masses, springs, dampers, force_dof=1, sensor_dofs=(1,), kind="displacement")
    late = everyday_mistakes.held_run(everyday_mistakes.behind_a_lag(exact, 3 * dt), u, dt)[0]
    model = modal.StructuralModel.chain(masses, springs, dampers, force_dofs=[1], sensor_dofs=[1])
    for effect, where in (("sensor_lag", "output_0"), ("actuator_lag", "input_0")):
        # in small steps: outputs go straight from one to the next
        found = modal.simulate(model.with_effect(effect, where, tau=3 * dt), np.repeat(u[0], 8), dt=dt / 8)
        assert np.abs(found.outputs[::8] - late).max() < 1e-3 * late.std()


def test_stribeck_friction_moves_as_in_small_steps():
    rng = np.random.default_rng(8)
    masses, springs, dampers, dt = everyday_mistakes.structure(rng, 1)
    u = 3 * everyday_mistakes.drives(rng, 1)[:, :400]
    system = everyday_mistakes.continuous(masses, springs, dampers, force_dof=0, sensor_dofs=(0,), kind="displacement")
    speed = 0.3 * np.gradient(everyday_mistakes.held_run(system, u, dt)[0, :, 0], dt).std()
    wanted = everyday_mistakes.rubbed(system, masses[0], u, dt, lambda v: 0.3 + 0.4 * np.exp(-((v / speed) ** 2)))[0]
    model = modal.StructuralModel.chain(masses, springs, dampers, force_dofs=[0], sensor_dofs=[0])
    model = model.with_effect("stribeck_friction", "element_0", Fc=0.3, excess=0.4, stribeck_velocity=speed)
    assert np.std(modal.simulate(model, u[0], dt=dt).outputs - wanted) < 0.005 * wanted.std()
