"""Scores of candidates against whole Gauss-Newton steps."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from engine_plants import FORCES, some_records, two_masses, with_effects

from modal.discrepancy.assembly import Unknowns
from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.covariance import covariance
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, estimate, score_equations, simulate_at
from modal.discrepancy.screen import screen_candidates
from modal.discrepancy.sensitivity import sensitivity


def measured(keys, *, change=(), noise=0.0, floor=1e-6, lengths=(200, 150), scale=1.0):
    """A problem whose data hold these effects (first amplitude times `scale`), and the linear plant's unknowns."""
    plant = two_masses()
    drive = drive_of(some_records(plant, lengths=lengths))
    truth, unknowns = with_effects(plant, keys, 2)
    common = unknowns.common.copy()
    for i in range(len(keys)):
        common[truth.common_of(i).start] *= scale
    for index, value in change:
        common[index] = value
    problem = Problem(drive=drive, floor=np.full((2, 3), floor))
    outputs = simulate_at(truth, replace(unknowns, common=common), problem).trajectory.outputs
    outputs = outputs + noise * np.random.default_rng(3).standard_normal(outputs.shape)
    linear, start = with_effects(plant, [], 2)
    return linear, start, replace(problem, drive=replace(drive, outputs=outputs))


def predicted_fall(current, problem):
    """What a full Gauss-Newton step wins."""
    slopes = sensitivity(
        current.assembly,
        current.unknowns,
        problem.drive,
        current.trajectory,
        current.scheme,
        slopes=current.slopes,
        gain=current.gain,
    )
    gram, score = score_equations(current, problem, slopes)
    return score @ np.linalg.solve(gram, score)


@pytest.mark.parametrize(
    "key", ["cubic_stiffness", "quadratic_drag", "constant_force", "time_varying_stiffness", "quadratic_stiffness"]
)
@pytest.mark.parametrize("observed", [False, True])
def test_the_fall_is_that_of_one_gauss_newton_step(key, observed):
    linear, start, problem = measured([key], noise=1e-3, scale=0.3)
    gain = np.random.default_rng(0).standard_normal((4, 3)) * [0.05, 0.02, 0.0005] if observed else None
    current = simulate_at(linear, start, problem, gain=gain)
    found = next(
        c for c in screen_candidates(current, problem, {key: CATALOGUE[key]}, signs="free") if c.where == "ground"
    )
    level = np.maximum(current.mean_square, 1.0)
    weighed = replace(problem, floor=problem.floor * level)
    wider, _ = with_effects(linear.plant, [key], 2)
    common = np.concatenate([start.common, np.zeros(wider.n_common - wider.n_linear)])
    with_it = simulate_at(wider, Unknowns(common=common, local=start.local), weighed, gain=gain)
    without_it = simulate_at(linear, start, weighed, gain=gain)
    expected = (predicted_fall(with_it, weighed) - predicted_fall(without_it, weighed)) / without_it.squares
    # the screen takes a smooth force as a straight line between its values at both ends of a step
    assert found.fall == pytest.approx(expected, rel=2e-2)
    assert found.deviation == pytest.approx(np.sqrt(covariance_of(with_it, weighed, linear.n_linear)), rel=2e-2)


def covariance_of(current, problem, index):
    """Variance of one unknown, without the scaling by the residual."""
    free = np.zeros_like(current.at_bounds)  # zero is the bound of a drag
    one = replace(current, mean_square=np.ones_like(current.mean_square), at_bounds=free)
    return covariance(one, problem)[index, index]


@pytest.mark.parametrize(
    "key",
    [
        "cubic_stiffness",
        "quadratic_drag",
        "coulomb_friction",
        "bilinear_stiffness",
        "time_varying_stiffness",
        "input_gain",
        "sensor_gain",
        "sensor_bias",
    ],
)
def test_the_effect_that_is_there_comes_first(key):
    linear, start, problem = measured([key], noise=1e-4, scale=0.2 if key in FORCES else 1.0, floor=1e-8)
    current = estimate(simulate_at(linear, start, problem), problem, iterations=10)
    family = {name: effect for name, effect in CATALOGUE.items() if name not in {"power_law_flow", "overflow"}}
    best = screen_candidates(current, problem, family)[0]
    assert best.key == key
    assert best.fall > (0.3 if key.startswith("sensor") else 0.8)  # the other two outputs hold nothing but noise


def test_a_wrong_stiffness_is_no_effect():
    """The model is not fitted: only because the linear parameters are projected out is nothing left to explain."""
    linear, start, problem = measured([], change=[(0, 90.3), (1, 0.81)], floor=1e-10)
    current = simulate_at(linear, start, problem)
    assert current.level > 100.0
    assert max(c.fall for c in screen_candidates(current, problem, CATALOGUE, signs="free")) < 2e-3


def test_amplitudes_beyond_their_sign_are_left_out():
    linear, start, problem = measured(["quadratic_drag"], scale=-0.2, noise=1e-4)
    current = estimate(simulate_at(linear, start, problem), problem, iterations=10)
    only = {"quadratic_drag": CATALOGUE["quadratic_drag"]}
    bounded, free = (
        {c.where for c in screen_candidates(current, problem, only, signs=signs)} for signs in ("bounded", "free")
    )
    assert "ground" not in bounded
    assert "ground" in free


@pytest.mark.parametrize("key", ["sine_softening", "input_saturation"])
def test_the_opposite_of_an_effect_without_an_amplitude_is_no_effect(key):
    """Hardening is no softening, more drive no saturation."""
    linear, start, problem = measured([key], noise=1e-4, change=[(2, 2.0)] if key == "sine_softening" else ())
    calibrated = simulate_at(linear, start, problem)
    assert any(c.where in {"ground", "push"} for c in screen_candidates(calibrated, problem, {key: CATALOGUE[key]}))
    mirrored = 2 * calibrated.trajectory.outputs - problem.drive.outputs
    opposite = replace(problem, drive=replace(problem.drive, outputs=mirrored))
    current = simulate_at(linear, start, opposite)
    found = screen_candidates(current, opposite, {key: CATALOGUE[key]})
    assert not [c for c in found if c.where in {"ground", "push"} and c.fall > 0.3]


def test_the_opposite_of_a_delay_is_one_of_the_other_sign():
    linear, start, problem = measured(["input_delay"], noise=1e-4, change=[(2, 0.0273)])
    calibrated = simulate_at(linear, start, problem)
    mirrored = 2 * calibrated.trajectory.outputs - problem.drive.outputs
    for one, sign in ((problem, 1.0), (replace(problem, drive=replace(problem.drive, outputs=mirrored)), -1.0)):
        best, *_ = screen_candidates(simulate_at(linear, start, one), one, {"input_delay": CATALOGUE["input_delay"]})
        assert np.sign(best.common[0]) == sign
        assert best.fall > 0.3


def test_an_effect_that_is_there_already_is_not_tried_again():
    linear, _, problem = measured(["cubic_stiffness"], noise=1e-4)
    assembly, unknowns = with_effects(linear.plant, ["cubic_stiffness"], 2)
    current = estimate(simulate_at(assembly, unknowns, problem), problem, iterations=3)
    found = screen_candidates(current, problem, {"cubic_stiffness": CATALOGUE["cubic_stiffness"]}, signs="free")
    assert {c.where for c in found} == {"between", "anywhere"}


def test_candidates_carry_a_start_within_bounds_and_stand_in_order():
    linear, start, problem = measured(["periodic_disturbance", "gap_spring"], noise=1e-3)
    current = simulate_at(linear, start, problem)
    found = screen_candidates(current, problem, CATALOGUE)
    assert all(a.fall >= b.fall for a, b in pairwise(found))
    assert {"periodic_disturbance", "missing_mode", "input_delay", "bouc_wen_hysteresis"} <= {c.key for c in found}
    for c in found:
        item = c.placement
        assert c.common.shape == (len(item.common) + item.n_directions,)
        assert c.local.shape == (2, len(item.local))
        assert np.isfinite(c.common).all()
        for j, value in zip(item.common, c.common, strict=False):
            assert item.effect.parameters[j].lower <= value <= item.effect.parameters[j].upper
        assert c.fall <= 1.0 + 1e-9
