"""Strong stops under light damping: the free run of a model that is slightly off is lost, gain by gain it is not."""

from dataclasses import replace

import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy import graded as module
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, estimate, simulate_at
from modal.discrepancy.given import given_model, placed_assembly
from modal.discrepancy.graded import graded_run
from modal.discrepancy.observer import observer_gain
from modal.discrepancy.trajectory import SHARP

STOP, GAP, STEPS = 500.0, 0.1, 4


def stops(d, v, t):
    return STOP * np.sign(d) * max(abs(d) - GAP, 0.0)


def observed(effect="gap_spring", values=(0.0, 480.0, 0.098), *, n_samples=700, seed=1):
    """A model with stops, or another effect, fitted in observer form, and its records."""
    fit, _, variance = experiment(stops, n_samples=n_samples, seed=seed, dampings=(0.2,), levels=(2.0, 4.0, 3.0))
    model = nominal(stiffnesses=(101.0,), dampings=(0.22,)).with_effect(
        effect, "element_0", **dict(zip(names(effect), values, strict=True))
    )
    given = given_model(model, tuple(fit))
    drive = drive_of(tuple(fit), STEPS)
    problem = Problem(drive=drive, floor=np.full((2, 1), variance))
    linear, start = placed_assembly(given.plant, given.linear, (), drive)
    free = simulate_at(linear, start, problem)
    gain = observer_gain(free, problem, STEPS)
    assembly, unknowns = placed_assembly(given.plant, given.linear, given.effects, drive)
    begun = simulate_at(assembly, unknowns, problem, gain=gain, smoothing=SHARP)
    return estimate(begun, problem, iterations=12), problem


def names(effect):
    return {"gap_spring": ("k_in", "k_out", "gap"), "cubic_stiffness": ("k3",)}[effect]


def test_stops_are_followed_into_the_free_run_gain_by_gain():
    fit, problem = observed()
    direct = simulate_at(fit.assembly, fit.unknowns, problem, states=fit.trajectory.states, smoothing=SHARP)
    assert estimate(direct, problem, iterations=6).level > 100.0  # or the way by the gains would not be needed
    graded = graded_run(fit, problem, smoothing=SHARP)
    assert graded.gain is None
    found = estimate(graded, problem, iterations=6)
    assert found.level < 1.2
    k_in, k_out, gap = found.unknowns.common[-3:]
    assert [k_out - k_in, gap] == pytest.approx([STOP, GAP], rel=0.02)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_wrong_law_is_given_up_on_the_way(seed, monkeypatch):
    fit, problem = observed("cubic_stiffness", (3000.0,), seed=seed)
    costs = []

    def recorded(*args, **options):
        costs.append(estimate(*args, **options))
        return costs[-1]

    monkeypatch.setattr(module, "estimate", recorded)
    assert graded_run(fit, problem, smoothing=SHARP) is None
    assert np.abs(costs[-1].gain).max() > module.SMALLEST * np.abs(fit.gain).max()  # before the smallest gain
    assert costs[-1].cost > module.LOST * fit.cost


@pytest.mark.parametrize(("share", "lost"), [(0.029, True), (0.031, False)])
def test_a_model_that_hardly_misses_anything_with_hardly_any_correction_has_lost_its_motion(share, lost):
    """Far above the noise too: a skew of a twentieth of a sample leaves half a per cent of a hard spring's motion."""
    fit, problem = observed(n_samples=200)
    moved = np.array([[problem.drive.outputs[problem.drive.rows_of(record)].var()] for record in range(2)])
    weak = replace(fit, gain=0.04 * fit.gain, mean_square=share**2 * moved / problem.floor)
    assert weak.level > module.EXPLAINED
    if lost:
        with pytest.raises(module.LostMotion):
            module._check_lost(weak, fit, problem)
        module._check_lost(replace(weak, gain=0.06 * fit.gain), fit, problem)
    else:
        module._check_lost(weak, fit, problem)


def test_an_offset_of_the_outputs_is_no_motion_that_is_followed():
    fit, problem = observed(n_samples=200)
    drive = replace(problem.drive, outputs=problem.drive.outputs + 50.0 * problem.drive.outputs.std())
    module._check_lost(
        replace(fit, gain=0.04 * fit.gain, mean_square=np.full((2, 1), 40.0)), fit, replace(problem, drive=drive)
    )


def test_without_a_gain_there_are_no_grades():
    fit, problem = observed(n_samples=200)
    assert graded_run(replace(fit, gain=None), problem, smoothing=SHARP) is None
