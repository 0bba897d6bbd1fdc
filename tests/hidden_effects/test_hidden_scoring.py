"""The score of the confusion benchmark on results made by hand, and its tables by counting."""

from types import SimpleNamespace

import hidden_scoring
import numpy as np
import pytest
from hidden_cases import hidden_case
from hidden_types import HiddenEffect


@pytest.fixture(scope="module")
def gain_case():
    """An input gain on three degrees of freedom with displacement sensors."""
    return hidden_case("3dof_displacement", 15)


@pytest.fixture(scope="module")
def pair_case():
    return hidden_case("motor_propeller", 3)


def found(effect, where, **parameters):
    numbers = [SimpleNamespace(name=name, value=value, std=std) for name, (value, std) in parameters.items()]
    return SimpleNamespace(effect=effect, where=where, parameters=numbers)


def diagnosis(case, *findings, status="named", left=1.0):
    variance = np.array([r.noise_variance for r in case.held_out])
    floor = SimpleNamespace(variance=2 * np.array([r.noise_variance for r in case.fit + case.held_out]))
    return SimpleNamespace(status=status, findings=findings, gap_after=np.sqrt(left * variance), noise_floor=floor)


def test_the_right_name_in_the_right_place(gain_case):
    gain = gain_case.effects[0].parameters["gain"]
    line = hidden_scoring.outcome(
        gain_case,
        diagnosis(gain_case, found("input_gain", "input_0", gain=(1.03 * gain, 0.02 * gain)), left=1.2),
        seconds=3.0,
    )
    assert line["named_right"]
    assert line["place_right"]
    assert line["firm"]
    assert line["held_out_to_floor"] == pytest.approx(1.2)
    assert line["floor_to_truth"] == [2.0] * 3 * (len(gain_case.fit) + 1)
    assert line["parameters"][0]["relative_error"] == pytest.approx(0.03)
    assert line["parameters"][0]["deviations"] == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("findings", "status", "expected"),
    [
        ([("input_delay", "input_0")], "named", (False, False)),
        ([("input_delay", "input_0"), ("input_gain", "input_0")], "named", (False, False)),  # the first one counts
        ([("input_gain", "input_0"), ("input_delay", "input_0")], "named", (True, True)),
        ([("input_gain", "input_1")], "named", (True, False)),
        ([("sensor_gain", "output_0")], "named", (False, False)),  # one of three sensors is something else
        ([("input_gain", "input_0")], "unresolved", (True, True)),
        ([], "unresolved", (False, False)),
        ([], "none", (False, False)),
    ],
)
def test_wrong_names_and_places(gain_case, findings, status, expected):
    given = [found(effect, where) for effect, where in findings]
    line = hidden_scoring.outcome(gain_case, diagnosis(gain_case, *given, status=status), seconds=1.0)
    assert (line["named_right"], line["place_right"]) == expected
    assert line["firm"] is (status == "named")


def test_two_effects_in_any_order_and_no_third(pair_case):
    drag, delay = (found(e.effect, e.place) for e in pair_case.effects)
    score = hidden_scoring.outcome
    assert score(pair_case, diagnosis(pair_case, delay, drag), seconds=1.0)["named_right"]
    assert score(pair_case, diagnosis(pair_case, delay, drag), seconds=1.0)["place_right"]
    assert not score(pair_case, diagnosis(pair_case, drag), seconds=1.0)["named_right"]
    third = found("input_saturation", "input_0")
    assert not score(pair_case, diagnosis(pair_case, drag, delay, third), seconds=1.0)["named_right"]
    twice = found("quadratic_drag", "element_0")
    assert not score(pair_case, diagnosis(pair_case, drag, twice), seconds=1.0)["named_right"]


def test_nothing_hidden_and_a_firm_name_is_false():
    case = hidden_case("none", 0)
    score = hidden_scoring.outcome
    assert score(case, diagnosis(case, status="none"), seconds=1.0)["named_right"]
    assert score(case, diagnosis(case, status="unresolved"), seconds=1.0)["named_right"]
    assert not score(case, diagnosis(case, found("cubic_stiffness", "element_0")), seconds=1.0)["named_right"]


def test_classes_that_no_data_can_split():
    names = hidden_scoring.allowed_names
    one = {"n_dofs": 1, "n_outputs": 1, "sensor_kind": "displacement", "velocity_reverses": True}
    assert names("input_gain", **one) == {"input_gain", "sensor_gain"}
    assert names("input_gain", **{**one, "n_dofs": 3}) == {"input_gain"}
    assert names("coulomb_friction", **one) == {"coulomb_friction"}
    assert names("coulomb_friction", **{**one, "velocity_reverses": False}) == {"coulomb_friction", "constant_force"}
    assert names("constant_force", **one) == {"constant_force", "sensor_bias"}
    assert names("sensor_bias", **one) == {"sensor_bias"}
    assert names("gap_spring", **one) == {"gap_spring"}


@pytest.mark.parametrize(
    ("first", "second", "effect", "same"),
    [
        ("dof_0", "element_0", "missing_mode", True),
        ("dof_1", "element_1", "missing_mode", False),
        ("output_0-output_1", "output_1-output_0", "cubic_stiffness", True),
        ("output_0", "output_0-output_1", "cubic_stiffness", False),
        ("output_0 level", "output_0", "overflow", True),
        ("input_0", "output_0", "input_gain", True),
        ("input_0", "output_1", "input_gain", False),
        ("output_0", "element_0", "constant_force", True),
        ("output_0", "element_0", "coulomb_friction", False),
    ],
)
def test_places(first, second, effect, same):
    assert hidden_scoring.same_place(first, second, effect) is same
    assert hidden_scoring.same_place(second, first, effect) is same


def test_of_a_gap_spring_the_step_in_stiffness_counts():
    hidden = HiddenEffect(
        effect="gap_spring", place="element_0", parameters={"k_in": -100.0, "k_out": 0.0, "gap": 0.01}
    )
    got = found("gap_spring", "element_0", k_in=(-60.0, 3.0), k_out=(44.0, 4.0), gap=(0.0102, 1e-4))
    step, gap = hidden_scoring.parameter_scores(got, hidden)[::-1]
    assert step["name"] == "gap_spring.k_out - k_in"
    assert step["relative_error"] == pytest.approx(0.04)
    assert step["deviations"] == pytest.approx(0.8)
    assert gap["relative_error"] == pytest.approx(0.02)
    assert hidden_scoring.parameter_scores(found("cubic_stiffness", "element_0"), hidden) == []


def test_tables_count(gain_case):
    score = hidden_scoring.outcome
    gain = found("input_gain", "input_0", gain=(gain_case.effects[0].parameters["gain"] * 1.2, 0.1))
    lines = [
        score(gain_case, diagnosis(gain_case, gain), seconds=2.0),
        score(gain_case, diagnosis(gain_case, gain), seconds=4.0),
        score(gain_case, diagnosis(gain_case, found("input_delay", "input_0"), left=9.0), seconds=6.0),
        {**hidden_scoring.describe(gain_case), "error": "ValueError: no", "seconds": 1.0},
    ]
    text = hidden_scoring.report(lines)
    row = next(line for line in text.splitlines() if line.startswith("| 3dof_displacement | 4 "))
    assert "| 2 of 4, 50.0 % (97 %) | 2 of 2, 100.0 % (99 %) | 3 of 3, 100.0 % (85 %) | 1 of 3 (0) |" in row
    assert "1.000 (" in row
    assert "4.0 (5.6), 6.0 (10)" in row
    assert "| input_gain | 3 | input_gain 2, input_delay 1 |" in text
    assert "| input_gain.gain | 2 | 0 of 2, 0.0 %" in text
    assert text.count("ValueError: no") == 1
    assert text.count("| input_delay at input_0 | named | 9 |") == 1
