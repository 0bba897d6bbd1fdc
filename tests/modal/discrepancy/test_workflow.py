"""The whole workflow on records from a Runge-Kutta loop: no effect, one, one beside another, other models."""

from dataclasses import asdict, replace

import control
import numpy as np
import pytest
from engine_records import experiment, nominal

from modal.discrepancy import CATALOGUE
from modal.discrepancy.diagnosis import calibrate, decide, diagnose, fit, screen
from modal.discrepancy.noise.floor import noise_floor
from okid.errors import InvalidDataError, NumericalError


def cubic(d, v, t):
    return 900.0 * d**3


def cubic_and_drag(d, v, t):
    return 900.0 * d**3 + 0.9 * v * abs(v)


@pytest.fixture(scope="module")
def records():
    return experiment(cubic, n_samples=400)


@pytest.fixture(scope="module")
def named(records):
    fit, held_out, variance = records
    said = []
    found = diagnose(nominal(), fit, held_out, progress=lambda what, share: said.append((what, share)))
    return found, variance, said


@pytest.fixture(scope="module")
def whole(named):
    return named[0]


def test_a_cubic_spring_is_named(named):
    found, variance, _ = named
    assert found.status == "named"
    (finding,) = found.findings
    assert (finding.effect, finding.where) == ("cubic_stiffness", "element_0")
    (k3,) = finding.parameters
    assert k3.unit == "N/m^3"
    assert abs(k3.value - 900.0) < 4 * k3.std
    assert k3.std < 30.0
    assert finding.evidence.log_likelihood > 1000.0
    assert finding.evidence.closed > 0.99
    assert found.closed > 0.99
    assert np.mean(found.gap_after**2) == pytest.approx(variance, rel=0.15)
    assert found.gap_before.mean() > 5 * found.gap_after.mean()


def told(item):
    return item if isinstance(item, str) else repr(asdict(item))


def test_the_linear_parameters_are_those_of_the_truth(named):
    found, _, _ = named
    for item, truth in zip(found.calibrated, (100.0, 0.6), strict=True):
        assert abs(item.value - truth) < 4 * item.std, item.name
        assert not item.at_bound
    assert found.bounds_hit == ()
    assert found.model.stiffness[0, 0] == found.calibrated[0].value
    assert [one.effect for one in found.model.effects] == ["cubic_stiffness"]


def test_the_steps_lead_from_the_model_as_given_to_the_end(named):
    found, _, said = named
    assert [step.name for step in found.steps] == ["as given", "calibrated", "cubic_stiffness at element_0"]
    levels = [step.held_out_level for step in found.steps]
    assert min(levels[:2]) > 100.0
    assert levels[2] < 1.5
    (last,) = found.steps[-1].simulated
    assert np.sqrt(np.nanmean((found.held_out[0].outputs - last) ** 2)) == pytest.approx(
        found.gap_after[0, 0], rel=1e-6
    )
    shares = [share for _, share in said]
    assert shares[0] == 0.0
    assert max(shares) <= 1.0
    assert len(said) >= 4


def test_it_is_deterministic(records, named):
    found, _, _ = named
    again = diagnose(nominal(), *records[:2])
    assert again.status == found.status
    for name in ("findings", "hypotheses", "detection_limits", "calibrated", "advice", "warnings"):
        ours, theirs = ([told(item) for item in getattr(one, name)] for one in (again, found))
        assert ours == theirs, name
    assert np.array_equal(again.gap_after, found.gap_after)
    assert np.array_equal(again.steps[-1].simulated[0], found.steps[-1].simulated[0])


@pytest.fixture(scope="module")
def nothing():
    fit, held_out, variance = experiment(None, n_samples=400)
    return diagnose(nominal(), fit, held_out), variance


def test_a_model_that_only_has_wrong_parameters_lacks_nothing(nothing):
    found, variance = nothing
    assert found.status == "none"
    assert found.findings == ()
    assert found.model.effects == ()
    assert np.mean(found.gap_after**2) == pytest.approx(variance, rel=0.2)
    limits = {(one.effect, one.where): one for one in found.detection_limits}
    assert limits["cubic_stiffness", "element_0"].value > 0.0
    assert limits["cubic_stiffness", "element_0"].unit == "N/m^3"
    assert found.advice


def test_the_detection_limit_is_one_that_can_be_found(nothing):
    """An effect of six times its detection limit gains more than 30; one of a tenth of it is not named."""
    limit = next(one.value for one in nothing[0].detection_limits if one.effect == "cubic_stiffness")
    fit, held_out, _ = experiment(lambda d, v, t: 0.1 * limit * d**3, n_samples=400)
    assert diagnose(nominal(), fit, held_out).findings == ()
    fit, held_out, _ = experiment(lambda d, v, t: 6.0 * limit * d**3, n_samples=400)
    found = diagnose(nominal(), fit, held_out)
    assert (
        max(one.log_likelihood for one in found.hypotheses if one.effects == (("cubic_stiffness", "element_0"),)) > 30.0
    )


def test_an_effect_beside_one_that_the_model_has():
    fit, held_out, variance = experiment(cubic_and_drag, n_samples=400)
    model = nominal().with_effect("cubic_stiffness", "element_0", k3=800.0)
    found = diagnose(model, fit, held_out)
    assert found.status == "named"
    (finding,) = found.findings
    assert finding.effect == "quadratic_drag"
    assert abs(finding.parameters[0].value - 0.9) < 4 * finding.parameters[0].std
    assert [one.effect for one in found.model.effects] == ["cubic_stiffness", "quadratic_drag"]
    assert found.model.effects[0].value("k3") == pytest.approx(900.0, rel=0.05)
    assert [step.name for step in found.steps][-1] == "quadratic_drag at element_0"
    assert np.mean(found.gap_after**2) == pytest.approx(variance, rel=0.2)


def test_missing_samples():
    fit, held_out, variance = experiment(cubic, missing=0.1, n_samples=400)
    found = diagnose(nominal(), fit, held_out)
    assert [(one.effect, one.where) for one in found.findings] == [("cubic_stiffness", "element_0")]
    assert abs(found.findings[0].parameters[0].value - 900.0) < 5 * found.findings[0].parameters[0].std
    assert np.mean(found.gap_after**2) == pytest.approx(variance, rel=0.25)


def test_several_inputs_and_outputs():
    plant = {"masses": (1.0, 0.8), "dampings": (0.5, 0.3), "n_inputs": 2}
    law = lambda d, v, t: 2500.0 * d**3  # noqa: E731 - one line
    fit, held_out, _ = experiment(
        law, element=1, stiffnesses=(100.0, 150.0), n_samples=350, levels=(1.0, 4.0, 3.0), **plant
    )
    found = diagnose(nominal(stiffnesses=(103.0, 147.0), **plant), fit, held_out)
    assert [(one.effect, one.where) for one in found.findings] == [("cubic_stiffness", "element_1")]
    assert found.findings[0].parameters[0].value == pytest.approx(2500.0, rel=0.1)
    assert found.gap_after.shape == (1, 2)


def test_a_state_space_model():
    fit, held_out, _ = experiment(cubic, n_samples=400)
    system = control.ss([[0, 1], [-103.0, -0.7]], [[0], [1]], [[1, 0]], [[0]])
    found = diagnose(system, fit, held_out, sensor_kind="displacement")
    assert [one.effect for one in found.findings] == ["cubic_stiffness"]
    assert found.findings[0].where == "output_0"
    assert found.closed > 0.99


def test_what_cannot_be_diagnosed_is_refused_in_a_sentence():
    fit, held_out, _ = experiment(None, n_samples=80)
    with pytest.raises(InvalidDataError, match="held-out"):
        diagnose(nominal(), fit, [])
    with pytest.raises(InvalidDataError, match="a model is a StructuralModel"):
        diagnose(3.0, fit, held_out)
    wild = nominal().with_effect("cubic_stiffness", "element_0", k3=-1e7)
    with pytest.raises(NumericalError, match="could not be simulated"):
        diagnose(wild, fit, held_out)


def test_a_catalogue_is_a_mapping():
    fit, held_out, _ = experiment(None, n_samples=80)
    with pytest.raises(InvalidDataError, match="the catalogue is a mapping from keys to effects and a list was given"):
        diagnose(nominal(), fit, held_out, catalogue=["cubic_stiffness"])


@pytest.mark.parametrize(("effect", "place"), [("input_gain", "input_0"), ("sensor_gain", "output_0")])
def test_the_gain_of_the_input_and_of_the_driven_sensor_are_told_apart_in_a_state_space(effect, place):
    """Any linear force would make them one: what else changes in y' = g y is stiffness, but no symmetric one."""
    masses, stiffnesses, dampings = (1.0, 1.4), (100.0, 80.0), (0.6, 0.5)
    fit, held_out, _ = experiment(
        masses=masses, stiffnesses=stiffnesses, dampings=dampings, levels=(3.0, 2.0), n_samples=400
    )

    def measured(record):
        if effect == "input_gain":
            return replace(record, inputs=record.inputs / 0.8)
        return replace(record, outputs=record.outputs * [0.8, 1.0])

    guess = nominal(masses=masses, stiffnesses=(104.0, 77.0), dampings=(0.5, 0.6))
    lower = -np.linalg.solve(guess.mass, np.hstack([guess.stiffness, guess.damping]))
    A = np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), lower])
    system = control.ss(A, [[0.0], [0.0], [1.0], [0.0]], np.eye(4)[:2], np.zeros((2, 1)))
    found = diagnose(
        system, [measured(one) for one in fit], [measured(one) for one in held_out], sensor_kind="displacement"
    )
    assert [(one.effect, one.where) for one in found.findings] == [(effect, place)]
    assert found.status == "named"
    assert found.findings[0].parameters[0].value == pytest.approx(0.8, abs=0.01)
    assert any("mass" in other for other in found.findings[0].ambiguous_with) == (effect == "sensor_gain")


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


@pytest.mark.parametrize("k2", [60.0, pytest.param(150.0, marks=pytest.mark.slow)])
def test_a_zero_beside_a_cubic_spring_does_not_take_the_place_of_its_square(k2):
    """The two leave hundreds of times the noise of a good circuit, and nearly nothing of the gap."""
    fit, held_out, _ = experiment(
        lambda d, v, t: 3.0 + 900.0 * d**3 + k2 * d**2, n_samples=400, levels=(3.0, 3.0, 3.0), noise=1e-3
    )
    keys = ("constant_force", "sensor_bias", "cubic_stiffness", "quadratic_stiffness", "quadratic_drag")
    found = diagnose(nominal(), fit, held_out, catalogue={key: CATALOGUE[key] for key in keys})
    values = {one.effect: one.parameters[0].value for one in found.findings}
    assert {"cubic_stiffness", "quadratic_stiffness"} <= values.keys()
    assert values["cubic_stiffness"] == pytest.approx(900.0, rel=0.01)
    moved = values.get("sensor_bias", 0.0)  # the same law about another rest point
    assert values["quadratic_stiffness"] - 3.0 * values["cubic_stiffness"] * moved == pytest.approx(k2, rel=0.03)
    assert found.steps[-1].held_out_level < 1.2
    assert found.status == "unresolved"  # three effects
