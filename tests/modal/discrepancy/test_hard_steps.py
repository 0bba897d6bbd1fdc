"""Sizes of hard limits: stepped in their reciprocal, up to a wall."""

from dataclasses import replace

import numpy as np
import pytest
from brim_problem import DT, LIMIT, P, Tank, tank_with
from brim_tank import levels, staircase
from hypothesis import given
from hypothesis import strategies as st

from modal.discrepancy.assembly import Unknowns, assemble, initial_unknowns, place_effect
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.covariance import covariance
from modal.discrepancy.drive import drive_of
from modal.discrepancy.effects.stiff_step import WALL
from modal.discrepancy.estimation import Problem, estimate, simulate_at
from modal.discrepancy.hard_steps import REACH, moved_by_reciprocals, reach_of, walls
from modal.discrepancy.state_space_plant import state_space_plant
from okid.record import Record


def test_only_the_rate_of_a_brim_has_a_wall():
    assembly, unknowns, problem = tank_with("constant_force", "overflow", "sensor_gain")
    found = walls(assembly, unknowns, problem.drive.dt)
    rate = assembly.common_of(1).start
    np.testing.assert_allclose(found[rate], WALL / DT)  # a flow of 1 takes away dt of the level in a step
    assert np.isinf(np.delete(found, rate)).all()


@given(size=st.floats(1e-3, 1e3), share=st.floats(-5.0, REACH))
def test_a_step_is_a_straight_one_in_the_reciprocal(size, share):
    step = share * size
    (found,) = moved_by_reciprocals(np.array([size]), np.array([step]), np.array([1e12]))
    assert 1.0 / found == pytest.approx(1.0 / size - step / size**2, rel=1e-9)
    assert found > 0.0


def test_what_is_no_limit_moves_straight_and_a_limit_at_most_to_the_wall():
    found = moved_by_reciprocals(
        np.array([2.0, 2.0, 2.0, 0.0]), np.array([5.0, 5.0, -1.0, 3.0]), np.array([np.inf, 9.0, 9.0, 9.0])
    )
    np.testing.assert_allclose(found, [7.0, 9.0, 2.0 / 1.5, 3.0])


def test_a_limit_reaches_a_share_of_its_size_and_nothing_beyond_the_wall():
    found = reach_of(np.array([2.0, 2.0, 9.0, 0.0]), np.array([np.inf, 9.0, 9.0, 9.0]))
    np.testing.assert_allclose(found, [np.inf, 1.8, 0.0, np.inf])


def test_from_a_soft_brim_a_fit_finds_the_wall_and_holds_it():
    assembly, unknowns, problem = tank_with("overflow", noise=0.01)
    found = estimate(simulate_at(assembly, unknowns, problem), problem, iterations=25)
    rate, limit = found.unknowns.common[assembly.common_of(0)]
    assert found.level < 1.1
    assert 1.0 / rate < 0.02
    harder = replace(found.unknowns, common=np.array([*found.unknowns.common[:-2], WALL / DT, limit]))
    wall = estimate(simulate_at(assembly, harder, problem), problem, iterations=5)
    assert wall.at_bounds[assembly.common_of(0)].tolist() == [True, False]
    deviation = np.sqrt(np.diag(covariance(wall, problem))[assembly.common_of(0)])
    assert deviation[0] == 0.0
    assert 0.0 < abs(wall.unknowns.common[-1] - LIMIT) < 3.0 * deviation[1]
    assert deviation[1] < 0.01 / np.sqrt(100)  # more than a hundred samples stand at the brim


def test_a_fit_may_start_from_no_overflow_at_all():
    assembly, unknowns, problem = tank_with("overflow", rate=0.0, noise=0.01)
    found = estimate(simulate_at(assembly, unknowns, problem), problem, iterations=25)
    assert found.unknowns.common[assembly.common_of(0)][0] > 50.0
    assert found.level < 1.1


def test_a_soft_brim_is_not_taken_for_a_wall():
    assembly, unknowns, problem = tank_with("overflow", rate=30.0, noise=0.002, true_rate=3.0)
    found = estimate(simulate_at(assembly, unknowns, problem), problem, iterations=25)
    assert found.level < 1.2
    spread = np.sqrt(np.diag(covariance(found, problem)))[assembly.common_of(0)]
    assert not found.at_bounds.any()
    np.testing.assert_array_less(np.abs(found.unknowns.common[assembly.common_of(0)] - [3.0, LIMIT]), 4.0 * spread)
    assert spread[0] < 0.1


@pytest.mark.parametrize("rate", [3.0, 100.0, 1e4, 1e12])
def test_a_level_from_rest_is_that_of_exact_steps_however_hard_the_brim(rate):
    """Newton's method on the whole trajectory settles from a tank that is empty throughout."""
    plant = state_space_plant(Tank, sensor_kind="displacement")
    inflow = staircase(1500, 3)
    drive = drive_of([Record(inflow[:, None], np.zeros((1500, 1)), DT)])
    assembly = assemble(plant, [place_effect(plant, CATALOGUE["overflow"], "output_0", displacement_scale=0.7)])
    unknowns = initial_unknowns(assembly, 1)
    common = unknowns.common.copy()
    common[assembly.common_of(0)] = rate, LIMIT
    problem = Problem(drive=drive, floor=np.ones((1, 1)))
    found = simulate_at(assembly, Unknowns(common=common, local=unknowns.local), problem, smoothing=1e-4)
    expected = levels(inflow, DT, p=P, limit=LIMIT, rate=rate)
    assert (expected > LIMIT - 1e-3).mean() > 0.2
    assert (expected < LIMIT - 0.2).mean() > 0.2
    rise = DT * inflow.max()  # in a step; the corner is met somewhere within one
    assert np.abs(found.trajectory.outputs[:, 0] - expected).max() < (0.05 if rate < 1e4 else 2e-3) * rise
