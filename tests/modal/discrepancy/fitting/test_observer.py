"""The observer's gain against the textbook Riccati recursion, step by step."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import some_records, two_masses, with_effects

from modal.discrepancy.fitting.estimation import Problem, simulate_at
from modal.discrepancy.fitting.observer_form import observer_gain
from modal.simulation.drive import drive_of


def current_of(upsampling=1, outputs=(0, 1, 2), floor=1e-4):
    plant = two_masses()
    rows = [0, 1, 2, 3, *(4 + o for o in outputs)]
    plant = replace(
        plant,
        system=plant.system[:, rows],
        output_names=tuple(plant.output_names[o] for o in outputs),
        output_units=tuple(plant.output_units[o] for o in outputs),
    )
    drive = drive_of(some_records(plant), upsampling)
    assembly, unknowns = with_effects(plant, [], 2)
    problem = Problem(drive=drive, floor=np.full((2, len(outputs)), floor) * np.arange(1, len(outputs) + 1))
    return simulate_at(assembly, unknowns, problem), problem


def riccati(A, C, Q, R, S):
    """The one-step predictor's gain, by iterating the Riccati equation from nothing (Anderson, Moore 1979, 5.4)."""
    P = np.zeros_like(A)
    for _ in range(4000):
        K = (A @ P @ C.T + S) @ np.linalg.inv(C @ P @ C.T + R)
        F = A - K @ C  # Joseph's form: stays symmetric and positive
        P = F @ P @ F.T + Q + K @ R @ K.T - S @ K.T - K @ S.T
    return K


@pytest.mark.parametrize("outputs", [(0,), (1, 0), (2,), (0, 1, 2)])
def test_it_is_the_steady_kalman_gain(outputs):
    current, problem = current_of(outputs=outputs)
    gain = observer_gain(current, problem)
    A, C = current.scheme.Ad, current.scheme.C
    E = current.scheme.E0 + current.scheme.E1
    length = np.linalg.norm(E, axis=0)
    unit, direct = E / length, current.scheme.G / length
    floor = problem.floor[0]
    spread, power = np.zeros((4, 4)), np.eye(4)
    for _ in range(5000):
        spread += power @ unit @ unit.T @ power.T
        power = A @ power
    excess = (current.mean_square - 1.0).clip(0).mean(axis=0) * floor
    response = np.diag(C @ spread @ C.T + direct @ direct.T)
    size = np.median(excess / response)
    expected = riccati(A, C, size * unit @ unit.T, np.diag(floor) + size * direct @ direct.T, size * unit @ direct.T)
    assert np.allclose(gain, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("upsampling", [1, 2, 5])
def test_the_corrected_model_is_stable_between_and_across_samples(upsampling):
    current, problem = current_of(upsampling)
    gain = observer_gain(current, problem)
    A, C = current.scheme.Ad, current.scheme.C
    across = np.linalg.matrix_power(A, upsampling - 1) @ (A - gain @ C)
    assert np.abs(np.linalg.eigvals(across)).max() < 1.0
    fastest = np.abs(np.linalg.eigvals(np.linalg.matrix_power(A, upsampling))).max()
    assert np.abs(np.linalg.eigvals(across)).max() < fastest
    assert simulate_at(current.assembly, current.unknowns, problem, gain=gain) is not None


def test_a_model_that_fits_needs_none():
    current, problem = current_of()
    exact = replace(problem, drive=replace(problem.drive, outputs=current.trajectory.outputs))
    fitted = simulate_at(current.assembly, current.unknowns, exact)
    assert observer_gain(fitted, exact) is None


@pytest.mark.parametrize("beyond", [1e60, 1e110, np.inf])
def test_a_motion_that_escapes_has_none(beyond):
    """Nor is a foreign warning heard of it."""
    current, problem = current_of()
    assert observer_gain(replace(current, mean_square=beyond * current.mean_square), problem) is None


def test_the_nearer_the_model_the_smaller_the_gain():
    current, problem = current_of()
    gains = []
    for share in (1.0, 0.1, 0.01):
        outputs = current.trajectory.outputs + share * (problem.drive.outputs - current.trajectory.outputs)
        one = replace(problem, drive=replace(problem.drive, outputs=outputs))
        gains.append(np.linalg.norm(observer_gain(simulate_at(current.assembly, current.unknowns, one), one)))
    assert gains[0] > gains[1] > gains[2]
