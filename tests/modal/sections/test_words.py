"""Each sentence comes from a rule, and here each rule is met on both of its sides."""

import datetime as dt
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from modal.acceptance.test_file import SensorNote, Specification
from modal.identification.words import (
    caution_sentence,
    damping_sentence,
    damping_shown,
    damping_text,
    doubtful_sentence,
    fit_sentence,
    frequency_text,
    trust_of,
)
from modal.sections.validation import about_lines, channel_rows, fingerprints, sensor_columns
from modal.sections.words import INDICATORS, data_sentences, fit_word, judgement_of, modes_headline, next_sentences
from modal.verdict import judgement as verdict
from modal.wording.text import fit_text, hertz, ratio_text, with_interval
from okid.errors import InvalidDataError
from okid.record import Record


def with_fit(result, fit):
    return replace(result, fit=replace(result.fit, cross_validated=np.array([fit, fit + 0.02, fit + 0.04]) - 0.02))


def with_system(result, count):
    return replace(result, modes=replace(result.modes, modes=result.modes.modes[:count] + result.modes.modes[3:]))


@pytest.mark.parametrize(
    ("count", "beginning"),
    [(0, "No mode of the system was found."), (1, "One mode of the system was found, at 3.67 Hz."), (3, "Three modes")],
)
def test_headline_counts_the_system_modes_alone(identification, count, beginning):
    assert modes_headline(with_system(identification, count)).startswith(beginning)


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (0, "between 3.67 and 16.6 Hz."),
        (1, "between 3.67 and 11.1 Hz, and one overdamped pole."),
        (2, "at 3.67 Hz, and two overdamped poles."),
        (3, "but three overdamped poles of the system."),
    ],
)
def test_overdamped_poles_are_not_called_vibration_modes(identification, count, words):
    modes = tuple(
        replace(mode, kind="real") if i >= 3 - count else mode for i, mode in enumerate(identification.modes.system)
    )
    result = replace(identification, modes=replace(identification.modes, modes=modes))
    assert modes_headline(result).endswith(words)
    assert [damping_text(mode) for mode in modes].count("overdamped") == count


@pytest.mark.parametrize(("value", "text"), [(0.00072371, "0.0007237"), (999.96, "1000"), (27470.63, "27470.6")])
def test_frequencies_are_written_without_powers_of_ten(identification, value, text):
    assert hertz(value) == text
    modes = (replace(identification.modes.modes[0], frequency=value, damping_resolved=False),)
    result = replace(identification, modes=replace(identification.modes, modes=modes))
    for sentence in (modes_headline(result), damping_sentence(result)):
        assert f"at {text} Hz" in sentence


@pytest.mark.parametrize(
    ("fit", "word"), [(0.49, "poor"), (0.5, "fair"), (0.79, "fair"), (0.8, "good"), (np.nan, "not known")]
)
def test_fit_words(fit, word):
    assert fit_word(fit) == word


@pytest.mark.parametrize(
    ("fit", "text", "share"),
    [
        (0.4987, "0.49", "49 %"),
        (0.5, "0.50", "50 %"),
        (0.7647, "0.76", "76 %"),
        (0.9999, "1.00", "99 %"),
        (-0.0012, "0.00", "0 %"),
        (-0.4, "-0.40", "0 %"),
    ],
)
def test_a_fit_is_rounded_but_never_over_the_limit(identification, fit, text, share):
    assert fit_text(fit) == text
    even = replace(identification, fit=replace(identification.fit, cross_validated=np.full(3, fit)))
    assert f" {share} of data kept aside" in fit_sentence(even)


def test_a_long_name_does_not_drown_the_sentence(make_result, identification):
    result = make_result(names=("x" * 9000, "b", "c"))
    worst = replace(result, fit=replace(result.fit, cross_validated=np.array([0.6, 0.9, 0.9])))
    assert len(fit_sentence(worst)) < 300


def test_what_is_a_warning_is_not_said_again(make_result, identification):
    sentence = "input 'ground' moves in 20 % of the band."
    excitation = replace(identification.excitation, messages=(sentence, "the inputs repeat."))
    assert data_sentences(replace(identification, excitation=excitation)) == excitation.messages
    warned = replace(make_result(warnings=(sentence,)), excitation=excitation)
    assert data_sentences(warned) == ("the inputs repeat.",)


def test_fit_sentence_names_the_worst_output(identification):
    result = replace(identification, fit=replace(identification.fit, cross_validated=np.array([0.9, 0.6, 0.8])))
    assert "worst channel floor_2: 60 %" in fit_sentence(result)
    even = replace(identification, fit=replace(identification.fit, cross_validated=np.full(3, 0.9)))
    assert "least of" not in fit_sentence(even)


def test_an_unknown_fit_is_said_to_be_unknown(identification):
    result = replace(identification, fit=replace(identification.fit, cross_validated=np.full(3, np.nan)))
    assert "No data were kept aside" in fit_sentence(result)
    assert trust_of(result).trust == "with care"


def test_without_inputs_nothing_is_said_about_inputs(identification):
    record = identification.records[0].select(inputs=[])
    sentence = fit_sentence(replace(identification, records=(record,)))
    assert "inputs alone" not in sentence
    assert "From the samples before" in sentence


@pytest.mark.parametrize(
    ("fit", "n_system", "warnings", "trust"),
    [
        (0.97, 3, (), "carried"),
        (0.97, 3, ("Something is off.",), "with care"),
        (0.6, 3, (), "with care"),
        (0.49, 3, (), "with care"),
        (0.97, 0, (), "not carried"),
    ],
)
def test_trust(identification, fit, n_system, warnings, trust):
    result = replace(with_system(with_fit(identification, fit), n_system), warnings=warnings)
    assert trust_of(result).trust == trust


def test_unresolved_damping_is_said_and_not_quoted(identification):
    assert damping_sentence(identification) == ""
    first, *others = identification.modes.modes
    unresolved = replace(first, damping_resolved=False)
    result = replace(identification, modes=replace(identification.modes, modes=(unresolved, *others)))
    assert "3.67 Hz" in damping_sentence(result)
    assert damping_text(unresolved) == "not resolved"
    assert damping_text(first) == "1.20 %"
    assert damping_sentence(result) in trust_of(result).reasons


@pytest.mark.parametrize(("count", "words"), [(0, ""), (1, "One more pole, at 23.4 Hz"), (5, "Five more poles")])
def test_doubtful_poles_are_counted(identification, count, words):
    system, doubtful = identification.modes.modes[:3], identification.modes.modes[3]
    result = replace(identification, modes=replace(identification.modes, modes=(*system, *[doubtful] * count)))
    assert doubtful_sentence(result).startswith(words)
    assert bool(doubtful_sentence(result)) == bool(count)
    assert (" and 2 more" in doubtful_sentence(result)) == (count == 5)
    alone = replace(identification, modes=replace(identification.modes, modes=(doubtful,) * count))
    assert "more pole" not in doubtful_sentence(alone)


def test_caution_about_the_classical_indicators(identification):
    def with_caution(value):
        return replace(identification, modes=replace(identification.modes, indicator_caution=value))

    assert caution_sentence(with_caution(0.3)) == ""
    assert caution_sentence(with_caution(np.nan)) == ""
    assert "0.31" in caution_sentence(with_caution(0.31))
    missing = replace(identification.modes, indicators_missing="the model did not come from data.")
    assert "did not come from data" in caution_sentence(replace(identification, modes=missing))


@pytest.mark.parametrize(
    ("value", "half_width", "text"),
    [
        (512.0, 1345397.0, "about 510"),
        (3.66971, 0.0123, "3.670 ± 0.012"),
        (123.456, 12.3, "123 ± 12"),
        (0.5, 0.0, "0.5"),
        (2.0, np.nan, "2"),
    ],
)
def test_interval_is_written_to_its_second_digit(value, half_width, text):
    assert with_interval(value, half_width) == text


def test_intervals_are_shown_when_known(identification):
    mode = replace(identification.modes.modes[0], frequency_std=0.01, damping_ratio_std=0.0005)
    assert frequency_text(mode) == "3.670 ± 0.020"
    assert damping_text(mode) == "1.200 ± 0.098 %"
    assert ratio_text(np.nan) == "–"


def test_certain_modes_are_quoted_beside_doubtful_poles(identification):
    """And no second record is asked for where the doubtful pole lies where no record shows a mode."""
    first, second, third = identification.modes.system

    def said(doubtful):
        modes = replace(identification.modes, modes=(first, second, replace(doubtful, verdict="doubtful")))
        return " ".join(next_sentences(replace(identification, modes=modes, warnings=())))

    nyquist = 0.5 / identification.modes.dt
    assert said(third).startswith("You can quote these modes")
    assert "may settle the doubtful poles" in said(third)
    assert "doubtful" not in said(replace(third, frequency=1.03 * nyquist))
    assert "doubtful" not in said(replace(third, kind="real"))


def test_data_to_mend_leave_nothing_called_reliable(identification):
    """The word beside the headline contradicted what was to be done next."""
    sound = with_fit(replace(identification, warnings=()), 0.99)
    lost = SimpleNamespace(level="bad", what="missing samples", where="force", channels=())
    dead = SimpleNamespace(level="bad", what="constant", where="a dead one", channels=("a dead one",))
    assert judgement_of(sound, None).label == judgement_of(sound, SimpleNamespace(findings=(dead,))).label == "Reliable"
    assert judgement_of(sound, SimpleNamespace(findings=(lost,))).label == "Use with care"
    none = with_system(sound, 0)
    assert judgement_of(none, SimpleNamespace(findings=(lost,))).label == trust_of(none).label == "Not reliable"


def test_what_comes_next_is_one_thing_that_waits_for_no_other(identification):
    warned = replace(with_system(identification, 0), warnings=("Look.", "Look again."))
    lost = SimpleNamespace(level="bad", what="missing samples", where="force", channels=())
    left_out = SimpleNamespace(level="bad", what="constant", where="a dead one", channels=("a dead one",))
    (mend,) = next_sentences(warned, SimpleNamespace(findings=(left_out, lost)))
    assert mend.startswith("Mend or replace the data (missing samples, force)")
    (again,) = next_sentences(warned)
    assert again.startswith("Quote nothing")
    assert (
        next_sentences(replace(identification, warnings=("Look.",)))[0] == "Read the warning before you quote a number."
    )


def test_a_pole_on_the_negative_real_axis_is_shown_at_half_the_sampling_frequency(identification):
    mode = identification.modes.modes[0]
    at_nyquist = replace(mode, kind="nyquist", pole=complex(-650.0, 50 * 2 * np.pi), frequency=114.7, frequency_std=9.0)
    assert frequency_text(at_nyquist) == "50"
    assert "±" not in damping_shown(at_nyquist)


@pytest.mark.parametrize(
    ("spread", "advice"),
    [
        (0.05, ""),
        (0.21, "For the damping at 3.67 Hz measure about five times as long a record."),
        (0.5, "For the damping at 3.67 Hz drive harder there or measure it better, not only longer."),
        (np.nan, ""),
    ],
)
def test_how_much_longer_to_measure_is_told_from_the_spread_of_the_damping(identification, spread, advice):
    first, *others = identification.modes.modes
    mode = replace(first, damping_resolved=spread < 0.1, damping_ratio_std=spread * first.damping_ratio)
    result = replace(identification, warnings=(), modes=replace(identification.modes, modes=(mode, *others)))
    said = " ".join(next_sentences(result))
    assert advice in said
    assert ("For the damping" in said) == bool(advice)


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ("with the level of motion", "keep to one level of motion"),
        ("during the record", "identify early and late parts"),
    ],
)
def test_damping_that_changes_asks_for_no_longer_record(identification, changes, advice):
    first, *others = identification.modes.modes
    told = {"damping_resolved": False, "damping_ratio_std": 0.3 * first.damping_ratio}
    mode = replace(first, reason=f"it changes {changes}: 2 % damping here, 3 % damping there", **told)
    result = replace(identification, warnings=(), modes=replace(identification.modes, modes=(mode, *others)))
    (said,) = [words for words in next_sentences(result) if "For the damping" in words]
    assert advice in said


def test_what_a_force_would_add_is_told_where_none_or_too_little_was_measured(identification):
    quiet = replace(identification, warnings=())
    assert "force" not in " ".join(next_sentences(with_fit(quiet, 0.99)))
    assert next_sentences(with_fit(quiet, 0.3))[-1] == "Measure what else drives it, where you can."
    record = quiet.records[0]
    alone = Record(np.zeros((record.n_samples, 0)), record.outputs, record.dt, output_names=record.output_names)
    ambient = next_sentences(replace(quiet, records=(alone,)))
    assert ambient[-1] == "For modal masses and frequency responses measure a force as well."
    assert next_sentences(replace(with_fit(quiet, 0.3), record_kind="decay"))[-1] == ambient[-1]


COLUMNS = {column.key: column for column in INDICATORS}


def test_the_words_name_the_limits_that_the_verdict_has():
    groups = {"halves of the data": 0.9, "other observer order and ridge": 0.9, "other model orders": 0.9}

    def called(p, least):
        return verdict._verdict(p, 100.0, {**groups, "other model orders": least}, dict.fromkeys(groups, ""))[0]

    least_p = COLUMNS["probability"].limit
    least_part = float(COLUMNS["repeatability"].meaning.removesuffix(".").rpartition(" ")[2])
    assert called(least_p, least_part) == "system"
    assert called(least_p - 0.001, least_part) == "doubtful"
    assert called(least_p, least_part - 0.001) == "doubtful"
    assert COLUMNS["repeatability"].limit is None  # a mean above any number may hide a part that is too low


@pytest.mark.parametrize("column", [column for column in INDICATORS if column.limit is not None], ids=lambda c: c.key)
def test_a_number_is_beyond_its_limit_on_one_side_of_it(identification, column):
    mode = identification.modes.system[0]
    worse = -0.001 if column.better == "high" else 0.001
    assert column.beyond(replace(mode, **{column.key: column.limit + worse}))
    assert not column.beyond(replace(mode, **{column.key: column.limit}))
    assert not column.beyond(replace(mode, **{column.key: np.nan}))


def test_the_hash_is_that_of_the_standard(tmp_path):
    """FIPS 180-4, example of one block: SHA-256 of "abc"."""
    path = tmp_path / "a b.csv"
    path.write_bytes(b"abc")
    (file,) = fingerprints([path])
    assert (file.name, file.size) == (str(path), 3)
    assert file.sha256 == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_a_file_that_is_gone_is_named(tmp_path):
    with pytest.raises(InvalidDataError, match=r"gone\.csv' cannot be read again for its hash"):
        fingerprints([tmp_path / "gone.csv"])


NOTES = (
    SensorNote(channel="floor_2", kind="accelerometer", calibrated=dt.date(2026, 1, 10)),
    SensorNote(channel="elsewhere", serial="9"),
)


def test_only_what_the_test_file_says_is_shown():
    assert about_lines(None) == ()
    assert about_lines(Specification()) == ()
    said = about_lines(Specification(article="frame", date=dt.date(2026, 5, 4)))
    assert said == (("Article", "frame"), ("Date", "2026-05-04"))


def test_columns_are_those_that_at_least_one_sensor_has():
    assert sensor_columns(None) == ()
    assert sensor_columns(Specification(sensors=NOTES)) == ("sensor", "serial", "calibrated")


def test_each_channel_has_the_note_of_its_name(identification):
    rows = channel_rows(identification, Specification(sensors=NOTES))
    notes = {(row.name, row.role): row.notes for row in rows}
    assert notes["floor_2", "output"] == ("accelerometer", "–", "2026-01-10")
    assert notes["floor_1", "output"] == ("–", "–", "–")
    assert ("ground", "input") in notes
    assert {row.notes for row in channel_rows(identification)} == {()}


def test_the_channel_that_is_reproduced_least_comes_first(identification):
    fit = replace(identification.fit, cross_validated=np.array([0.9, 0.6, 0.8]))
    rows = channel_rows(replace(identification, fit=fit))
    assert [row.name for row in rows] == ["floor_2", "floor_3", "floor_1", "ground"]
    assert [row.fit for row in rows][:3] == [0.6, 0.8, 0.9]


def test_bands_are_written_out_up_to_a_limit(identification):
    def bands(*bands):
        excitation = replace(identification.excitation, excited_bands=(bands,))
        return channel_rows(replace(identification, excitation=excitation))[-1].bands

    assert bands() == "nowhere"
    assert bands((0.1, 4.0)) == "0.1 to 4"
    assert bands(*[(i, i + 0.5) for i in range(9)]).endswith("5 to 5.5 and 3 more bands")
    assert channel_rows(identification)[0].bands == ""
    alone = replace(
        identification,
        records=(identification.records[0].select(inputs=[]),),
        excitation=replace(identification.excitation, excited_bands=()),
    )
    assert [row.role for row in channel_rows(alone)] == ["output"] * 3
