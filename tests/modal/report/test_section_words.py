"""Words on uncertainty, validation, limits and the way on: each rule met on both of its sides."""

import shlex
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from modal.modes.mode import Uncertainty
from modal.sections.validation import (
    Provenance,
    coherence_sentence,
    gap_command,
    gap_sentence,
    has_intervals,
    uncertainty_sentences,
    validation_sentences,
)
from modal.sections.words import limits_class, limits_sentence, limits_short


def known(result, *, method="output error", dof=np.inf, std=0.01, fit=None):
    n = len(result.modes)
    uncertainty = Uncertainty(
        method=method,
        frequency_std=np.full(n, std),
        damping_ratio_std=np.full(n, std),
        shape_std=np.full((n, 3), std),
        markov_std=np.zeros((1, 3, 1)),
        degrees_of_freedom=dof,
    )
    modes = tuple(replace(mode, frequency_std=std) for mode in result.modes)
    result = replace(result, uncertainty=uncertainty, modes=replace(result.modes, modes=modes))
    return result if fit is None else replace(result, fit=replace(result.fit, cross_validated=np.full(3, fit)))


def words(result):
    return " ".join(uncertainty_sentences(result))


def test_without_deviations_no_interval_is_explained(identification):
    assert uncertainty_sentences(identification) == (
        "No standard deviations are known for this result, so no interval is given.",
    )
    assert not has_intervals(identification)
    assert has_intervals(known(identification))
    assert "half of a 95 % interval" in words(known(identification))
    assert "No standard deviations" in words(known(identification, std=np.nan))


@pytest.mark.parametrize(("method", "said"), [("output error", "free-run error"), ("propagation", "first order")])
def test_the_method_is_named(identification, method, said):
    others = {"free-run error", "first order", "random weight"} - {said}
    text = words(known(identification, method=method))
    assert said in text
    assert not any(other in text for other in others)


def test_the_widening_is_that_of_students_t(identification):
    """t(0.975, 10) = 2.228 (any table): 14 % above 1.96."""
    assert "widen each interval by 14 %" in words(known(identification, dof=10))
    assert "degrees of freedom" not in words(known(identification, dof=np.inf))


@pytest.mark.parametrize(("ratio", "said"), [(2.1, True), (1.9, False), (np.nan, False)])
def test_errors_that_are_not_white_are_said(identification, ratio, said):
    result = known(identification)
    result = replace(result, innovations=replace(result.residuals, whiteness_ratio=ratio))
    assert ("are not white" in words(result)) is said


def outcome(state, what="fit"):
    return SimpleNamespace(what=what, state=state)


@pytest.mark.parametrize(
    ("states", "sentence"),
    [
        ((), ""),
        (("met",), "The acceptance limit is met."),
        (("met", "met"), "All 2 acceptance limits are met."),
        (("not met",), "Of 1 acceptance limit 1 is not met (a)."),
        (("met", "not met", "not met"), "Of 3 acceptance limits 2 are not met (b, c)."),
        (("met", "cannot be told"), "Of 2 acceptance limits 1 cannot be told (b)."),
        (("not met", "cannot be told"), "Of 2 acceptance limits 1 is not met (a) and 1 cannot be told (b)."),
        (("not met",) * 5, "Of 5 acceptance limits 5 are not met (a, b, c and 2 more)."),
    ],
)
def test_limits_in_one_sentence(states, sentence):
    assert limits_sentence([outcome(state, "abcde"[i]) for i, state in enumerate(states)]) == sentence


def test_limits_in_short():
    assert limits_short([outcome("met"), outcome("not met"), outcome("cannot be told")]) == "1 of 3"
    assert [limits_class(state) for state in ("met", "cannot be told", "not met")] == ["system", "doubtful", "fault"]
    assert len(limits_sentence([outcome("not met", "x" * 9000)])) < 200


@pytest.mark.parametrize(("n_inputs", "said"), [(1, "from the inputs alone"), (0, "no input was measured")])
def test_how_the_model_was_tested(identification, n_inputs, said):
    record = identification.records[0]
    record = record if n_inputs else record.select(inputs=[])
    assert said in validation_sentences(replace(identification, records=(record,)))[0]


@pytest.mark.parametrize(
    ("folds", "said"), [([], "no rows were held out"), ([0.9], "the only fold"), ([0.9, 0.8], "each of 2 folds")]
)
def test_the_folds_are_counted(identification, folds, said):
    result = replace(identification, fit=replace(identification.fit, folds=np.array(folds)))
    assert said in validation_sentences(result)[0]


@pytest.mark.parametrize(("drop", "said"), [(0.06, ": a sign that"), (0.04, ": no sign that")])
def test_a_fit_that_drops_on_held_out_rows_is_a_sign(identification, drop, said):
    fit = replace(identification.fit, cross_validated=np.full(3, 0.9 - drop), whole=np.full(3, 0.9))
    assert said in validation_sentences(replace(identification, fit=fit))[1]
    unknown = replace(identification, fit=replace(fit, cross_validated=np.full(3, np.nan)))
    assert len(validation_sentences(unknown)) == 1


def test_coherence_is_counted_over_frequencies_and_outputs():
    coherence = np.array([[0.0, 0.0], [0.81, 0.79], [0.9, np.nan], [0.9, 0.1]])  # the first line is that of the mean
    quality = SimpleNamespace(coherence=SimpleNamespace(multiple_coherence=coherence))
    assert "at 60 % of all" in coherence_sentence(quality)
    assert coherence_sentence(None) == ""
    assert coherence_sentence(SimpleNamespace(coherence=None)) == ""
    nothing = SimpleNamespace(multiple_coherence=np.full((3, 1), np.nan))
    assert coherence_sentence(SimpleNamespace(coherence=nothing)) == ""


def test_the_way_to_a_simulation(identification):
    record = identification.records[0]
    assert "a second one" in gap_sentence(identification)
    assert "hold the others out" in gap_sentence(replace(identification, records=(record, record)))
    alone = replace(identification, records=(record.select(inputs=[]),))
    assert "none can be" in gap_sentence(alone)
    assert gap_command(alone, Provenance()) == ""


@pytest.mark.parametrize(
    ("sources", "fit", "held_out"),
    [((), "FIRST.csv", "SECOND.csv"), (("a.csv",), "a.csv", "SECOND.csv"), (("a b;rm",), "a b;rm", "SECOND.csv")],
)
def test_the_command_names_the_files(identification, sources, fit, held_out):
    said = shlex.split(gap_command(identification, Provenance(sources=sources)))
    assert said[said.index("--fit") + 1] == fit
    assert said[said.index("--held-out") + 1] == held_out
    assert said[said.index("--hold") + 1] == identification.records[0].input_hold
    assert "--dt" not in said


def test_the_files_of_one_record_are_not_torn_apart(identification):
    """Two files that are the channels of one record stay together; one file a record, the last is held out."""
    given = Provenance(sources=("force.csv", "tip.csv"), besides=("test.toml",), dt=0.01)
    said = shlex.split(gap_command(identification, given))
    assert said[said.index("--fit") :][:4] == ["--fit", "force.csv", "tip.csv", "--held-out"]
    assert said[said.index("--dt") + 1] == "0.01"
    assert "test.toml" not in said
    several = replace(identification, records=identification.records * 2)
    said = shlex.split(gap_command(several, given))
    assert said[said.index("--fit") :][:4] == ["--fit", "force.csv", "--held-out", "tip.csv"]
