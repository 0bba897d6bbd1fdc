"""Every sentence of a diagnosis, on both sides of its rule."""

from dataclasses import replace

import numpy as np
import pytest

from modal.discrepancy.validation.cautions import with_cautions
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_values import (
    NAMED_WITHIN,
    beside_text,
    found_hypothesis,
    interval_text,
    size_text,
    times_text,
    value_text,
)
from modal.wording.numbers import exact_percent


def with_levels(diagnosis, *levels):
    steps = tuple(replace(s, held_out_level=level) for s, level in zip(diagnosis.steps, levels, strict=True))
    return replace(diagnosis, steps=steps)


def with_first(diagnosis, **changes):
    return replace(diagnosis, findings=(replace(diagnosis.findings[0], **changes), *diagnosis.findings[1:]))


@pytest.mark.parametrize(
    ("status", "n_effects", "start"),
    [
        ("named", 2, "The simulation lacks cubic stiffness and Coulomb friction at element_1."),
        ("named", 1, "The simulation lacks cubic stiffness at element_1."),
        ("unresolved", 1, "Not settled: the best guess is cubic stiffness at element_1."),
        ("unresolved", 0, "Something is missing, but no effect of the catalogue explains it."),
        ("none", 0, "The simulation lacks no effect that these data could show."),
    ],
)
def test_the_headline_says_no_more_than_the_status(diagnosis_of, status, n_effects, start):
    assert words.diagnosis_headline(diagnosis_of(status, n_effects)) == start


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


def test_what_remains_is_told_in_times_of_the_floor(diagnosis):
    found = with_levels(diagnosis, 2500.0, 100.0, 16.0, 1.49)
    sentence = words.remaining_sentence(found)
    assert "50.0 with the model as given, 10.0 after calibration and 1.22 with the effects, which is noise." in sentence
    assert "which is noise" not in words.remaining_sentence(with_levels(diagnosis, 2500.0, 100.0, 16.0, 1.51))


def test_a_model_that_ran_away_is_called_unbounded(diagnosis):
    sentence = words.remaining_sentence(with_levels(diagnosis, np.inf, 100.0, 16.0, 1.0))
    assert "unbounded with the model as given" in sentence
    assert "nan" not in sentence


@pytest.mark.parametrize(
    ("closed", "said"),
    [(0.75, "away 50 %"), (0.9999, "away 99"), (1.0, "away 100 %"), (0.0, "nothing"), (-3.0, "nothing")],
)
def test_what_was_closed(diagnosis, closed, said):
    assert said in words.closed_sentence(replace(diagnosis, closed=closed))


def test_nothing_is_said_to_close_where_there_was_no_gap(diagnosis_of):
    found = replace(diagnosis_of("none", 0), closed=0.99)
    assert "Calibration alone takes away 90 %" in words.closed_sentence(found)
    assert words.closed_sentence(with_levels(found, 1.45, 1.0)) == ""
    assert words.closed_sentence(replace(found, closed=np.nan)) == ""


@pytest.mark.parametrize(
    ("margin", "said"),
    [
        (9.0, "too little to tell the two apart"),
        (11.0, "the finding leads by 2 ln L = 11"),
        (np.inf, "on held-out data."),
    ],
)
def test_the_runner_up_and_its_lead(diagnosis, margin, said):
    finding = diagnosis.findings[0]
    sentence = words.runner_up_sentence(replace(finding, evidence=replace(finding.evidence, margin=margin)))
    assert sentence.startswith("Runner-up: gap spring at element_1, which leaves 4.02 times the noise floor")
    assert said in sentence
    assert ("leads" in sentence) == (margin == 11.0)


def test_without_a_runner_up_nothing_is_compared(diagnosis):
    assert words.runner_up_sentence(diagnosis.findings[1]) == "No other hypothesis was worth a fit in its place."


def test_a_runner_up_that_ran_away_has_no_size(diagnosis):
    finding = diagnosis.findings[0]
    lost = replace(finding, runner_up=replace(finding.runner_up, held_out_level=np.inf))
    assert "does not run through the held-out records" in words.runner_up_sentence(lost)


def test_what_it_cannot_be_told_from(diagnosis):
    finding = diagnosis.findings[0]
    assert "cannot be told from sine softening in these data" in words.ambiguity_sentence(finding)
    two = replace(finding, ambiguous_with=("sensor_gain", "input_gain"))
    assert "from sensor gain or input gain in" in words.ambiguity_sentence(two)
    assert words.ambiguity_sentence(diagnosis.findings[1]) == ""


@pytest.mark.parametrize(("margin", "led"), [(9.0, False), (11.0, True)])
def test_what_another_level_would_tell_is_no_matter_of_structure(diagnosis, margin, led):
    finding = replace(
        diagnosis.findings[0],
        effect="coulomb_friction",
        ambiguous_with=("quadratic_drag", "viscous damping", "constant_force"),
        evidence=replace(diagnosis.findings[0].evidence, margin=margin),
    )
    sentence = words.ambiguity_sentence(finding)
    assert "cannot be told from constant force in these data." in sentence
    assert "is easily taken for quadratic drag or viscous damping in records of one level" in sentence
    assert ("fits these better" in sentence) == led


@pytest.mark.parametrize(
    ("n_hit", "said"),
    [(0, ""), (1, "P0 sits on its bound"), (2, "P0 and p1 sit on their bound"), (5, "p2 and 2 more sit")],
)
def test_bounds_that_were_hit(diagnosis, n_hit, said):
    sentence = words.bounds_sentence(replace(diagnosis, bounds_hit=tuple(f"p{i}" for i in range(n_hit))))
    assert said in sentence
    assert bool(sentence) == (n_hit > 0)


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


def test_limits_are_told_only_where_nothing_was_found(diagnosis, diagnosis_of):
    limits = diagnosis_of("none", 0).detection_limits
    assert words.hidden_sentence(replace(diagnosis, detection_limits=limits)) == ""


def test_warnings_become_sentences(diagnosis):
    found = replace(diagnosis, warnings=("one level only; add one", "All is well."))
    assert words.read_first(found) == ("One level only; add one.", "All is well.")


def test_what_could_still_hide_is_told_where_it_is_known(diagnosis, diagnosis_of):
    assert words.hidden_sentence(diagnosis) == ""
    none = diagnosis_of("none", 0)
    sentence = words.hidden_sentence(none)
    assert "cubic stiffness at element_1 up to k3 = 3100 N/m^3" in sentence
    assert "more stand" not in sentence
    assert "; 1 more stand in the table" in words.hidden_sentence(
        replace(none, detection_limits=none.detection_limits * 2)
    )


@pytest.mark.parametrize(
    ("status", "n_effects", "start"),
    [
        ("named", 1, "Simulate with the updated model"),
        ("none", 0, "Go on with the calibrated model"),
        ("unresolved", 1, "Do not build on the named effect yet"),
        ("unresolved", 0, "Keep the model as it is"),
    ],
)
def test_what_to_do_next_ends_with_the_advice(diagnosis_of, status, n_effects, start):
    found = diagnosis_of(status, n_effects)
    first, *rest = words.next_sentences(found)
    assert first.startswith(start)
    assert tuple(rest) == found.advice


def test_the_way_of_the_floor_is_told_once_for_records_that_share_it(diagnosis):
    (sentence,) = words.floor_sentences(diagnosis)
    assert sentence.startswith("Noise floor of held out, 0.8 N and held out, 1.8 N: quiet band (18 to 25 Hz")
    floor = replace(diagnosis.noise_floor, method=("quiet band",) * 3 + ("repeated periods",))
    assert len(words.floor_sentences(replace(diagnosis, noise_floor=floor))) == 2


def test_the_floor_in_short_has_the_way_and_how_sure_it_is(diagnosis):
    (sentence,) = words.floor_summary(diagnosis)
    assert sentence == "Noise floor of held out, 0.8 N and held out, 1.8 N: quiet band, known to about 4.2 %."
    floor = replace(diagnosis.noise_floor, method=("quiet band",) * 3 + ("repeated periods",))
    assert len(words.floor_summary(replace(diagnosis, noise_floor=floor))) == 2


@pytest.mark.parametrize(("error", "limit"), [(0.29, False), (0.31, True)])
def test_a_floor_that_is_hardly_known_is_called_a_limit(diagnosis, error, limit):
    floor = replace(diagnosis.noise_floor, standard_error=np.full((4, 2), error))
    (sentence,) = words.floor_summary(replace(diagnosis, noise_floor=floor))
    assert ("rather an upper limit" in sentence) == limit


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
    assert ("nothing was compared but noise" in words.next_sentences(found)[0]) == (len(outputs) == 2)
    assert ("explains nothing of" in found.verdict) == bool(outputs)
    assert bool(words.hidden_sentence(found)) == (len(outputs) < 2)


def test_where_is_that_of_the_location(diagnosis):
    class Location:
        sentences = ("The gap lies in output 'upper'.",)

    assert words.where_sentences(replace(diagnosis, location=Location())) == Location.sentences
    assert words.where_sentences(diagnosis) == ()


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
    from modal.simulation.tolerances import NEAR_FLOOR

    assert pytest.approx(NEAR_FLOOR) == NAMED_WITHIN**2


def test_times_of_the_floor_keep_three_digits():
    for value in (0.0123, 0.5, 1.0, 1.499, 12.34, 123.4, 98765.0):
        assert float(times_text(value)) == pytest.approx(value, rel=6e-3)
        assert "e" not in times_text(value)
