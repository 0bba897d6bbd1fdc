"""Every sentence of a diagnosis, on both sides of its rule."""

from dataclasses import replace

import numpy as np
import pytest

from modal.discrepancy.results import in_words
from modal.discrepancy.validation.summary import with_cautions
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import (
    NAMED_WITHIN,
    beside_text,
    found_hypothesis,
    interval_text,
    size_text,
    value_text,
)
from modal.wording.text import exact_percent


def with_first(diagnosis, **changes):
    return replace(diagnosis, findings=(replace(diagnosis.findings[0], **changes), *diagnosis.findings[1:]))


@pytest.mark.parametrize(
    ("status", "n_effects", "start"),
    [
        ("named", 2, "The simulation lacks cubic stiffness and Coulomb friction at element_1."),
        ("named", 1, "The simulation lacks cubic stiffness at element_1."),
        ("unresolved", 1, "Not settled: the best guess is cubic stiffness at element_1."),
        ("unresolved", 0, "Something is left that no effect that was tried explains."),
        ("none", 0, "The simulation lacks no effect that these data could show."),
    ],
)
def test_the_headline_says_no_more_than_the_status(diagnosis_of, status, n_effects, start):
    assert words.diagnosis_headline(diagnosis_of(status, n_effects)) == start


def test_masses_that_explain_the_records_are_the_best_guess(diagnosis_of):
    found = diagnosis_of("unresolved", 0)
    mass = replace(found.calibrated[0], name="mass of dof_0", nominal=1.0, value=1.2)
    found = replace(
        found,
        calibrated=(*found.calibrated, mass),
        steps=(*found.steps[:-1], replace(found.steps[-1], held_out_level=1.01)),
        warnings=("missing mode at dof_0 explains the data as well as mass of dof_0",),
    )
    assert words.diagnosis_headline(found) == "Not settled: the best guess is another mass of dof_0."
    assert found.verdict.startswith("Unresolved: the best guess is another mass of lower; ")
    assert "mass of dof_0" in words.next_steps(found)[0]


@pytest.mark.parametrize(
    ("effect", "where", "gain", "told"),
    [
        (
            "sensor_gain",
            "a1",
            1 / 9.80665,
            "the output a1 reads 0.1020 times what the model expects, which looks like g",
        ),
        (
            "sensor_gain",
            "a1",
            9.80665,
            "the output a1 reads 9.807 times what the model expects, which looks like m/s^2",
        ),
        (
            "input_gain",
            "force",
            4.44822,
            "the input force acts as 4.448 times its numbers, which looks like pound-force",
        ),
        ("input_gain", "force", 1 / 4.44822, "which looks like newton taken for pound-force, a factor of 4.44822"),
    ],
)
def test_a_gain_of_a_conversion_says_what_was_taken_for_what_and_comes_first(diagnosis_of, effect, where, gain, told):
    """An output in g that is taken for m/s^2 reads a tenth; a force in pounds acts as four times its numbers."""
    found = diagnosis_of("unresolved", 1)
    value = replace(found.findings[0].parameters[0], value=gain, std=1e-4 * gain)
    found = with_cautions(with_first(found, effect=effect, where=where, parameters=(value,)))
    assert any(told in warning for warning in found.warnings)
    assert words.next_steps(found)[0] == f"Look at the units of {where} first, in the file and in the model."


def test_masses_are_told_wherever_they_were_changed(diagnosis_of):
    """Not as calibration alone, nor as no effect."""
    found = diagnosis_of("none", 0)
    mass = replace(found.calibrated[0], name="mass of dof_0", nominal=1.0, value=1.2)
    last = replace(found.steps[-1], name="mass of dof_0", held_out_level=1.0)
    heavier = replace(diagnosis_of("named", 1).hypotheses[0], effects=(), masses=("mass of dof_0",))
    found = replace(
        found,
        calibrated=(*found.calibrated, mass),
        steps=(*found.steps, last),
        hypotheses=(replace(heavier, masses=()), heavier),
    )
    assert words.diagnosis_headline(found).endswith("could show: another mass of dof_0 explains them.")
    assert "with another mass of" in found.verdict
    assert "1.00 with another mass of dof_0, which is noise" in words.remaining_sentence(found)
    assert words.closed_sentence(found).startswith("Calibration with another mass of dof_0 takes")
    assert found_hypothesis(found) is heavier
    finding = replace(diagnosis_of("named", 1).findings[0], runner_up=heavier)
    assert words.runner_up_sentence(finding).startswith("Runner-up: another mass of dof_0, which leaves")


@pytest.mark.parametrize(
    ("status", "n_effects", "trust", "label"),
    [
        ("named", 2, "carried", "Proved on held-out data"),
        ("unresolved", 1, "not carried", "Not proved"),
        ("unresolved", 0, "not carried", "Not proved"),
        ("none", 0, "carried", "Nothing missing"),
    ],
)
def test_trust_follows_the_status(diagnosis_of, status, n_effects, trust, label):
    found = diagnosis_of(status, n_effects)
    findings = tuple(replace(one, ambiguous_with=()) for one in found.findings)
    judged = words.judge_diagnosis(replace(found, findings=findings, bounds_hit=(), warnings=()))
    assert (judged.trust, judged.label) == (trust, label)


@pytest.mark.parametrize("doubt", [{"warnings": ("One level only.",)}, {"bounds_hit": ("stiffness of element_0",)}])
@pytest.mark.parametrize(("status", "n_effects"), [("named", 1), ("none", 0), ("unresolved", 1)])
def test_any_doubt_asks_for_care_but_proves_nothing(diagnosis_of, status, n_effects, doubt):
    found = replace(diagnosis_of(status, n_effects), bounds_hit=(), warnings=())
    found = with_first(found, ambiguous_with=()) if n_effects else found
    assert words.judge_diagnosis(found).trust != "with care"
    found = replace(found, **doubt)
    expected = "not carried" if status == "unresolved" else "with care"
    assert words.judge_diagnosis(found).trust == expected


def test_what_cannot_be_told_apart_asks_for_care(diagnosis_of):
    found = replace(diagnosis_of("named", 1), bounds_hit=(), warnings=())
    assert words.judge_diagnosis(with_first(found, ambiguous_with=("sine_softening",))).trust == "with care"
    assert words.judge_diagnosis(with_first(found, ambiguous_with=())).trust == "carried"


def test_without_a_runner_up_nothing_is_compared(diagnosis):
    assert words.runner_up_sentence(diagnosis.findings[1]) == "No other hypothesis was worth a fit in its place."


def test_a_bound_that_a_warning_names_is_not_told_again(diagnosis):
    found = replace(diagnosis, bounds_hit=("p0", "p1"), warnings=("p0, p1 sits on its bound; check it",))
    assert words.bounds_sentence(found) == ""
    assert words.bounds_sentence(replace(found, warnings=("p0 alone is odd",))) != ""


def test_what_the_diagnosis_settled_on_is_found_among_the_hypotheses(diagnosis, diagnosis_of):
    assert found_hypothesis(diagnosis) is diagnosis.hypotheses[0]
    nothing = replace(diagnosis, findings=())
    assert found_hypothesis(replace(nothing, status="unresolved")) is None
    assert found_hypothesis(replace(nothing, status="none")) is diagnosis.hypotheses[-1]
    assert found_hypothesis(diagnosis_of("none", 0)) is None
    # a model that was given with an effect: every hypothesis has it, the findings do not
    known = ("input_delay", "force")
    more = tuple(replace(one, effects=(known, *one.effects)) for one in diagnosis.hypotheses)
    assert found_hypothesis(replace(diagnosis, hypotheses=more)) is more[0]


def test_what_could_still_hide_is_told_where_nothing_was_found(diagnosis, diagnosis_of):
    assert words.hidden_sentence(diagnosis) == ""
    assert "cubic stiffness at element_1 up to k3 = 3100 N/m^3" in words.hidden_sentence(diagnosis_of("none", 0))


def test_the_floor_in_short_has_the_way_and_how_sure_it_is(diagnosis):
    (sentence,) = words.floor_summary(diagnosis)
    assert sentence == "Noise floor of held out, 0.8 N and held out, 1.8 N: quiet band, known to about 4.2 %."
    floor = replace(diagnosis.noise_floor, method=("quiet band",) * 3 + ("repeated periods",))
    assert len(words.floor_summary(replace(diagnosis, noise_floor=floor))) == 2


def with_noise_for(found, outputs):
    """The diagnosis of records of which some outputs are noise, by another generator than the rest."""
    rng = np.random.default_rng(11)
    held_out = []
    for record in found.held_out:
        values = record.outputs.copy()
        for j in outputs:
            values[:, j] = rng.standard_normal(len(values))
        held_out.append(replace(record, outputs=values))
    after = np.array(found.gap_after)
    after[:, outputs] = 1.0
    return replace(found, held_out=tuple(held_out), gap_after=after, warnings=(), bounds_hit=())


@pytest.mark.parametrize(
    ("outputs", "start", "label"),
    [
        ([], "The simulation lacks no effect that these data could show.", "Nothing missing"),
        ([1], "The simulation lacks no effect that these data could show, but explains nothing of upper.", None),
        ([0, 1], "These data tell nothing of the simulation: it explains nothing of lower and upper.", None),
    ],
)
def test_none_is_no_praise_of_a_model_that_explains_nothing(diagnosis_of, outputs, start, label):
    found = with_cautions(with_noise_for(diagnosis_of("none", 0), outputs))
    assert found.status == "none"
    assert words.diagnosis_headline(found) == start
    judged = words.judge_diagnosis(found)
    assert (judged.trust == "carried") == (not outputs)
    assert label is None or judged.label == label
    assert (judged.label == "Nothing explained") == (len(outputs) == 2)
    assert ("nothing was compared but noise" in words.next_steps(found)[0]) == (len(outputs) == 2)
    assert ("explains nothing of" in found.verdict) == bool(outputs)
    assert bool(words.hidden_sentence(found)) == (len(outputs) < 2)


def test_a_finding_in_one_sentence(diagnosis):
    assert words.finding_sentence(diagnosis.findings[1]) == (
        "Coulomb friction at element_1: f = Fc sign(v), Fc = 0.05960 ± 0.00060 N."
    )


@pytest.mark.parametrize(
    ("given", "fitted", "std", "text"),
    [
        (400.0, 403.21, 0.6, "400"),
        (0.00093, 0.0012406, 7e-7, "0.93e-3"),
        (3.1e5, 403000.0, 4100.0, "3.1e5"),
        (0.0, 2e-7, 1e-9, "0"),
        (1e-5, 0.3, 0.01, "1.000e-5"),
    ],
)
def test_a_given_value_is_written_as_the_fitted_one_beside_it(given, fitted, std, text):
    assert beside_text(given, fitted, std) == text


@pytest.mark.parametrize("value", [1e-5, 2.5e-7, 0.00012, 0.0012, 0.5, 12.0, 1234.5, 99999.0, 4.2e6])
def test_no_number_reads_as_zero_or_with_a_padded_exponent(value):
    for text in (value_text(value), value_text(value, 0.01 * value), size_text(value), beside_text(value, value, 0.1)):
        assert "e-0" not in text
        assert "e+" not in text
        assert any(digit in text.split("±")[0] for digit in "123456789")


@pytest.mark.parametrize("power", range(-12, 13))
@pytest.mark.parametrize("share", [0.3, 0.02, 1e-4])
def test_values_and_intervals_read_back_to_two_digits_of_the_deviation(power, share):
    value = -3.7654321 * 10.0**power
    std = share * abs(value)
    text = value_text(value, std)
    mantissa, _, exponent = text.partition(")e")
    middle, spread = (float(part.strip("(")) * 10.0 ** int(exponent or 0) for part in mantissa.split(" ± "))
    assert abs(middle - value) <= 0.051 * std
    assert abs(spread - std) <= 0.051 * std
    ends, _, exponent = interval_text(value, std).partition(")e")
    low, high = (float(end.strip("(")) * 10.0 ** int(exponent or 0) for end in ends.split(" to "))
    assert abs(low - (value - 1.96 * std)) <= 0.051 * std
    assert abs(high - (value + 1.96 * std)) <= 0.051 * std


@pytest.mark.parametrize("std", [np.nan, 0.0, np.inf])
def test_a_deviation_that_is_not_known_is_not_written(std):
    assert "±" not in value_text(2.0, std)
    assert interval_text(2.0, std) == "–"
    assert value_text(np.nan, std) == "–"


@pytest.mark.parametrize("share", [0.0, 1e-9, 0.123, 0.98999, 0.99, 0.9999, 1 - 1e-12, 1.0, 2.0])
def test_a_share_never_reads_as_all_unless_it_is(share):
    assert (exact_percent(share) == "100 %") == (share >= 1.0)
    assert float(exact_percent(share).split()[0]) <= 100.0 * share * 1.005


def test_the_limits_of_the_words_are_those_of_the_decision():
    from modal.simulation import NEAR_FLOOR

    assert pytest.approx(NEAR_FLOOR) == NAMED_WITHIN**2


def test_places_that_nobody_named_are_told_by_what_they_join(make_gap):
    found = make_gap(warnings=("look at element_1, not at element_10 or my element_1-a",))
    told = in_words(found)
    assert "at the link lower-upper;" in found.verdict
    assert [one.where for one in told.findings] == ["the link lower-upper"] * 2
    assert told.calibrated[0].name == "stiffness of the link lower-ground"
    assert told.warnings == ("look at the link lower-upper, not at element_10 or my element_1-a",)
    assert told.steps[2].name == "cubic_stiffness at the link lower-upper"
    assert told.model is found.model


def test_a_name_that_somebody_gave_stays(make_gap):
    found = make_gap(where="joint")
    elements = [replace(one, name="joint") if one.end else one for one in found.model.elements]
    told = in_words(replace(found, model=replace(found.model, elements=tuple(elements))))
    assert {one.where for one in told.findings} == {"joint"}
