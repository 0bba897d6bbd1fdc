"""Each stage by itself says what the whole workflow says."""

import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy.diagnosis import calibrate, decide, diagnose, fit, screen
from modal.discrepancy.noise.floor import noise_floor
from okid.errors import InvalidDataError, NumericalError


def cubic(d, v, t):
    return 900.0 * d**3


@pytest.fixture(scope="module")
def records():
    return experiment(cubic, n_samples=400)


@pytest.fixture(scope="module")
def whole(records):
    return diagnose(nominal(), records[0], records[1])


def floors(records, whole):
    """The floor before any fit, and what the diagnosis, which may find a lower one, makes of it."""
    floor = noise_floor([*records[0], *records[1]]).variance[:2]
    return floor, floor / whole.noise_floor.variance[:2]


def test_the_fit_of_the_right_model_is_the_diagnosis(records, whole):
    floor, ratio = floors(records, whole)
    found = fit(nominal().with_effect("cubic_stiffness", "element_0", k3=700.0), records[0], floor=floor)
    k3 = whole.findings[0].parameters[0]
    assert found.model.effects[0].value("k3") == pytest.approx(k3.value, abs=0.05 * k3.std)
    assert found.model.effects[0].deviations[0] == pytest.approx(k3.std, rel=0.2)
    for ours, theirs in zip(found.calibrated, whole.calibrated, strict=True):
        assert ours.value == pytest.approx(theirs.value, abs=0.05 * theirs.std)
    assert np.mean(found.mean_square * ratio) == pytest.approx(whole.steps[-1].fit_level, rel=2e-3)
    assert [one.shape for one in found.simulated] == [(400, 1), (400, 1)]
    rms = np.mean((records[0][0].outputs - found.simulated[0]) ** 2)
    assert rms / floor[0, 0] == pytest.approx(found.mean_square[0, 0])


def test_calibration_leaves_the_effects_out(records, whole):
    floor, ratio = floors(records, whole)
    found = calibrate(nominal().with_effect("cubic_stiffness", "element_0", k3=700.0), records[0], floor=floor)
    assert found.model.effects == ()
    assert np.mean(found.mean_square * ratio) == pytest.approx(whole.steps[1].fit_level, rel=2e-3)


def test_the_screen_names_the_same_effect(records):
    found = screen(nominal(), records[0])
    assert (found[0].key, found[0].where) == ("cubic_stiffness", "element_0")
    assert screen(nominal(), records[0][0])


def test_the_decision_among_models_is_that_of_the_diagnosis(records, whole):
    plain = nominal()
    right, wrong = (
        plain.with_effect("cubic_stiffness", "element_0", k3=700.0),
        plain.with_effect("quadratic_drag", "element_0", c2=0.1),
    )
    found = decide([plain, wrong, right], *records[:2])
    assert found.status == "named"
    assert found.node.effects == (("cubic_stiffness", "element_0"),)
    assert found.node.held_out_level == pytest.approx(whole.steps[-1].held_out_level, rel=1e-3)
    assert decide([plain], *records[:2]).status == "unresolved"
    with pytest.raises(InvalidDataError, match="no model"):
        decide([], *records[:2])


def test_a_model_that_escapes_is_refused(records):
    wild = nominal().with_effect("cubic_stiffness", "element_0", k3=-1e7)
    with pytest.raises(NumericalError, match="grows without bound"):
        fit(wild, records[0])
