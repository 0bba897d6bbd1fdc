"""Detection limits against the covariance of a fit with the effect, and against repetition."""

import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy.catalogue import CATALOGUE
from modal.discrepancy.covariance import covariance
from modal.discrepancy.drive import drive_of
from modal.discrepancy.estimation import Problem, estimate, simulate_at
from modal.discrepancy.given import given_model, placed_assembly
from modal.discrepancy.limits import detection_limits
from modal.discrepancy.nodes import Task


@pytest.mark.parametrize(
    ("key", "name"), [("cubic_stiffness", "k3"), ("quadratic_drag", "c2"), ("constant_force", "offset")]
)
def test_the_amplitude_that_takes_away_a_tenth_of_what_is_left(key, name):
    fit, _, variance = experiment(None, n_samples=300)
    given = given_model(nominal(), fit)
    drive = drive_of(fit)
    problem = Problem(drive=drive, floor=np.full((2, 1), variance))
    assembly, unknowns = placed_assembly(given.plant, given.linear, (), drive)
    current = estimate(simulate_at(assembly, unknowns, problem), problem, iterations=10)
    task = Task(
        fit=problem, held_out=problem, upsampling=1, catalogue=CATALOGUE, report=lambda what, share: None,
        fine_fit=problem, fine_held_out=problem,
    )  # fmt: skip
    found = {(one.effect, one.where): one for one in detection_limits(current, task, given.plant)}
    limit = found[key, "element_0"]
    assert limit.parameter == name
    model = nominal().with_effect(key, "element_0", **{name: 1e-9})
    wider, values = placed_assembly(given.plant, current.unknowns.common, model.effects, drive)
    values.local[:] = current.unknowns.local
    spread = covariance(simulate_at(wider, values, problem), problem)
    n_values = 2 * 300
    expected = np.sqrt(0.1 * n_values) * np.sqrt(spread[2, 2] / max(1.0, current.level))
    assert limit.value == pytest.approx(expected, rel=0.05)
    assert not [pair for pair in found if pair[0] in {"input_delay", "input_saturation"}]
    keys = list(CATALOGUE)
    order = [keys.index(effect) for effect, _ in found]
    assert order == sorted(order)
