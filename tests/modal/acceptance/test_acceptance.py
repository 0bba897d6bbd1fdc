"""Each limit on both sides of it and across it, on hand-made results whose numbers are known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modal.acceptance.check import MAYBE, NO, YES, all_met, all_of, any_of, check_limits, inside, negated, uncovered
from modal.acceptance.test_file import AcceptanceLimit, Specification
from modal.modes.mode import Uncertainty
from okid.record import Record

ANSWERS = st.sampled_from([NO, MAYBE, YES])


@pytest.fixture
def measured(identification):
    """Modes at 3.67, 11.1 and 16.6 Hz with deviations of 0.01 Hz and 0.001; a doubtful pole at 23.4 Hz."""
    modes = tuple(
        replace(mode, frequency_std=0.01, damping_ratio_std=0.001, damping_resolved=mode.verdict == "system")
        for mode in identification.modes
    )
    return replace(identification, modes=replace(identification.modes, modes=modes))


def outcome(result, limit):
    (found,) = check_limits(result, Specification(limits=(limit,)))
    assert found.sentence.endswith(".")
    assert found.state in found.sentence
    assert found.met == (found.state == "met")
    return found


def state(result, limit):
    return outcome(result, limit).state


def changed(result, index, **changes):
    """The result with one mode changed; modes by frequency, as the model has them."""
    modes = list(result.modes.modes)
    modes[index] = replace(modes[index], **changes)
    return replace(result, modes=replace(result.modes, modes=tuple(modes)))


# --- one expected mode -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("band", "expected"),
    [
        ((3.6, 3.7), "met"),
        ((3.6, 3.689), "cannot be told"),  # 3.67 + 1.96 * 0.01 = 3.6896
        ((3.6, 3.690), "met"),
        ((3.651, 3.7), "cannot be told"),
        ((3.6, 3.66), "cannot be told"),  # the interval reaches in from above
        ((3.6, 3.65), "not met"),
        ((5.0, 6.0), "not met"),
        ((23.0, 24.0), "cannot be told"),  # a doubtful pole
        ((30.5, 31.5), "not met"),  # a noise pole is no mode
        ((45.0, 60.0), "cannot be told"),  # above half the sampling frequency
    ],
)
def test_a_mode_expected_in_a_band(measured, band, expected):
    assert state(measured, AcceptanceLimit(kind="mode", frequency=band)) == expected


@pytest.mark.parametrize(
    ("damping", "expected"),
    [
        ((0.010, 0.014), "met"),  # 0.012 +- 0.00196
        ((0.010, 0.0139), "cannot be told"),
        ((0.015, 0.020), "not met"),
        ((0.0, 0.009), "not met"),
    ],
)
def test_the_damping_of_an_expected_mode(measured, damping, expected):
    assert state(measured, AcceptanceLimit(kind="mode", frequency=(3.6, 3.7), damping=damping)) == expected


def test_damping_that_is_not_resolved_cannot_be_told(measured):
    limit = AcceptanceLimit(kind="mode", frequency=(3.6, 3.7), damping=(0.0, 1.0))
    found = outcome(changed(measured, 0, damping_resolved=False), limit)
    assert (found.state, "not resolved" in found.sentence) == ("cannot be told", True)
    assert state(measured, limit) == "met"


def test_an_unknown_uncertainty_cannot_be_weighed(identification):
    found = outcome(identification, AcceptanceLimit(kind="mode", name="first", frequency=(3.0, 4.0)))
    assert found.state == "cannot be told"
    assert "is not known" in found.sentence


def test_another_mode_in_the_band_may_meet_the_limit(measured):
    near = changed(measured, 1, frequency=3.68)
    limit = AcceptanceLimit(
        kind="mode", frequency=(3.6, 3.75), damping=(0.005, 0.0115)
    )  # 0.009 +- 0.002 is met by this one
    assert state(near, limit) == "met"
    assert state(measured, limit) == "cannot be told"


def test_students_interval_is_wider(measured):
    few = Uncertainty(
        method="output error",
        frequency_std=np.zeros(0),
        damping_ratio_std=np.zeros(0),
        shape_std=np.zeros((0, 3)),
        markov_std=np.zeros((1, 3, 1)),
        degrees_of_freedom=4.0,  # 2.776 instead of 1.96
    )
    limit = AcceptanceLimit(kind="mode", frequency=(3.6, 3.692))
    assert state(measured, limit) == "met"
    assert state(replace(measured, uncertainty=few), limit) == "cannot be told"


# --- a forbidden band ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("band", "expected"),
    [
        ((5.0, 6.0), "met"),
        ((3.0, 4.0), "not met"),
        ((3.685, 4.0), "cannot be told"),
        ((3.69, 4.0), "met"),
        ((22.0, 25.0), "cannot be told"),
        ((30.0, 32.0), "met"),
        ((49.5, 51.0), "cannot be told"),
    ],
)
def test_a_band_without_modes(measured, band, expected):
    assert state(measured, AcceptanceLimit(kind="no_mode", frequency=band)) == expected


def test_where_no_input_moved_no_mode_can_be_missed(measured):
    quiet = replace(measured, excitation=replace(measured.excitation, excited_bands=(((0.1, 5.2), (5.6, 20.0)),)))
    found = outcome(quiet, AcceptanceLimit(kind="no_mode", frequency=(5.0, 6.0)))
    assert (found.state, "no input moved at 5.2 to 5.6 Hz" in found.sentence) == ("cannot be told", True)
    assert state(quiet, AcceptanceLimit(kind="no_mode", frequency=(7.0, 8.0))) == "met"
    assert state(quiet, AcceptanceLimit(kind="mode", frequency=(5.0, 6.0))) == "cannot be told"
    assert state(quiet, AcceptanceLimit(kind="no_mode", frequency=(3.0, 5.4))) == "not met"  # there is one all the same


def test_above_half_the_sampling_frequency_nothing_can_be_seen(measured):
    driven = replace(measured, excitation=replace(measured.excitation, excited_bands=(((0.0, 50.0),),)))
    for band, expected in (((40.0, 50.0), "met"), ((40.0, 50.1), "cannot be told"), ((60.0, 70.0), "cannot be told")):
        found = outcome(driven, AcceptanceLimit(kind="no_mode", frequency=band))
        assert found.state == expected
        assert ("above 50 Hz, half the sampling frequency" in found.reason) == (expected != "met")


def test_without_measured_inputs_every_frequency_below_counts_as_seen(measured):
    (record,) = measured.records
    ambient = replace(measured, records=(Record(np.zeros((record.n_samples, 0)), record.outputs, record.dt),))
    ambient = replace(ambient, excitation=replace(measured.excitation, excited_bands=(), excited_share=np.zeros(0)))
    assert state(ambient, AcceptanceLimit(kind="no_mode", frequency=(5.0, 6.0))) == "met"
    assert state(ambient, AcceptanceLimit(kind="no_mode", frequency=(45.0, 60.0))) == "cannot be told"


def test_uncovered_parts_of_a_band():
    assert uncovered((1.0, 5.0), []) == ((1.0, 5.0),)
    assert uncovered((1.0, 5.0), [(0.0, 9.0)]) == ()
    assert uncovered((1.0, 5.0), [(4.0, 6.0), (0.0, 2.0)]) == ((2.0, 4.0),)
    assert uncovered((1.0, 5.0), [(6.0, 7.0)]) == ((1.0, 5.0),)


# --- the whole -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("least", "most", "expected"),
    [
        (3, math.inf, "met"),
        (4, math.inf, "cannot be told"),
        (5, math.inf, "not met"),
        (0, 4, "met"),
        (0, 3, "cannot be told"),
        (0, 2, "not met"),
        (4, 4, "cannot be told"),
    ],
)
def test_the_number_of_modes(measured, least, most, expected):
    assert state(measured, AcceptanceLimit(kind="n_modes", at_least=least, at_most=most)) == expected


@pytest.mark.parametrize(
    ("at_least", "expected"),
    [(0.90, "met"), (0.963, "met"), (0.9642, "cannot be told"), (0.9758, "cannot be told"), (0.977, "not met")],
)
def test_the_fit(measured, at_least, expected):
    """Folds of 0.971, 0.968 and 0.966: half the interval of their mean is 4.303 * 0.00252 / sqrt(3) = 0.0063."""
    result = replace(measured, fit=replace(measured.fit, cross_validated=np.full(3, 0.97)))
    assert state(result, AcceptanceLimit(kind="fit", at_least=at_least)) == expected


def test_a_fit_of_one_fold_or_none_cannot_be_told(measured):
    one = replace(measured, fit=replace(measured.fit, folds=np.array([0.97])))
    assert "one fold alone" in outcome(one, AcceptanceLimit(kind="fit", at_least=0.1)).sentence
    none = replace(measured, fit=replace(measured.fit, cross_validated=np.full(3, np.nan), folds=np.zeros(0)))
    assert outcome(none, AcceptanceLimit(kind="fit", at_least=0.1)).state == "cannot be told"


@pytest.mark.parametrize(
    ("limits", "band", "expected"),
    [
        ((0.005, math.inf), (0.0, 20.0), "met"),
        ((0.0075, math.inf), (0.0, 20.0), "cannot be told"),  # 0.009 - 0.00196
        ((0.0115, math.inf), (0.0, 20.0), "not met"),
        ((0.0115, math.inf), (0.0, 5.0), "cannot be told"),
        ((-math.inf, 0.02), (0.0, 20.0), "met"),
        ((-math.inf, 0.014), (0.0, 20.0), "cannot be told"),
        ((0.005, math.inf), None, "cannot be told"),  # the doubtful pole's damping is not resolved
        ((0.005, math.inf), (5.0, 6.0), "cannot be told"),  # no mode there
    ],
)
def test_the_damping_of_every_mode(measured, limits, band, expected):
    assert (
        state(measured, AcceptanceLimit(kind="damping", at_least=limits[0], at_most=limits[1], frequency=band))
        == expected
    )


@pytest.mark.parametrize(
    ("frequency", "damping", "expected"),
    [
        (0.006, None, "met"),  # 1.96 * 0.01 / 3.67 = 0.53 %
        (0.005, None, "not met"),
        (None, 0.22, "met"),  # 1.96 * 0.001 / 0.009 = 21.8 %
        (None, 0.21, "not met"),
        (0.006, 0.21, "not met"),
    ],
)
def test_the_uncertainty_of_every_mode(measured, frequency, damping, expected):
    assert (
        state(measured, AcceptanceLimit(kind="uncertainty", frequency_at_most=frequency, damping_at_most=damping))
        == expected
    )


def test_an_uncertainty_that_is_not_known_cannot_be_told(measured, identification):
    limit = AcceptanceLimit(kind="uncertainty", frequency_at_most=0.5, damping_at_most=0.5)
    assert state(identification, limit) == "cannot be told"
    assert state(changed(measured, 1, damping_resolved=False), limit) == "cannot be told"
    assert state(measured, replace(limit, frequency=(40.0, 45.0))) == "cannot be told"
    assert state(measured, limit) == "met"


def test_of_several_intervals_the_one_that_fails_is_shown(measured):
    limit = AcceptanceLimit(kind="uncertainty", frequency_at_most=1e-5, damping_at_most=0.5)
    part = changed(measured, 0, frequency_std=math.nan)
    found = outcome(part, limit)
    assert found.state == "not met"
    assert "not known" not in found.found
    assert "not known" in outcome(part, replace(limit, frequency_at_most=0.9)).found


def test_settled_verdicts(measured):
    assert state(measured, AcceptanceLimit(kind="settled")) == "not met"
    assert state(measured, AcceptanceLimit(kind="settled", frequency=(0.0, 20.0))) == "met"
    assert state(measured, AcceptanceLimit(kind="settled", frequency=(0.0, 23.4))) == "cannot be told"


def test_trust(measured):
    carried, care = AcceptanceLimit(kind="trust", trust="carried"), AcceptanceLimit(kind="trust", trust="with care")
    warned = replace(measured, warnings=("something",))
    doubted = tuple(replace(mode, verdict="doubtful") for mode in measured.modes)
    poor = replace(measured, modes=replace(measured.modes, modes=doubted))
    assert [state(one, carried) for one in (measured, warned, poor)] == ["met", "not met", "not met"]
    assert [state(one, care) for one in (measured, warned, poor)] == ["met", "met", "not met"]


def test_real_and_noise_poles_are_no_modes(measured):
    overdamped = changed(measured, 0, kind="real")
    assert state(overdamped, AcceptanceLimit(kind="mode", frequency=(3.6, 3.7))) == "not met"
    assert state(overdamped, AcceptanceLimit(kind="n_modes", at_least=3)) == "cannot be told"


def test_the_name_of_a_limit_is_what_it_is_about(measured):
    assert outcome(measured, AcceptanceLimit(kind="no_mode", name="rotor", frequency=(5, 6))).sentence.startswith(
        "Rotor: met."
    )
    assert outcome(measured, AcceptanceLimit(kind="no_mode", frequency=(5, 6))).what == "no mode allowed"


def test_all_are_met_or_not(measured):
    good, bad = AcceptanceLimit(kind="no_mode", frequency=(5, 6)), AcceptanceLimit(kind="no_mode", frequency=(3, 4))
    told = [check_limits(measured, Specification(limits=limits)) for limits in ((), (good,), (good, bad))]
    assert [all_met(outcomes) for outcomes in told] == [True, True, False]


# --- logic -----------------------------------------------------------------------------------------------------------


@given(st.lists(ANSWERS, min_size=1, max_size=6))
def test_kleenes_logic(answers):
    """Whatever the unknown ones turn out to be, an answer that is told stays what it is."""
    from itertools import product

    choices = [(YES, NO) if answer == MAYBE else (answer,) for answer in answers]
    for worlds, whole in ((all, all_of), (any, any_of)):
        outcomes = {worlds(one == YES for one in world) for world in product(*choices)}
        expected = MAYBE if len(outcomes) == 2 else (YES if outcomes == {True} else NO)
        assert whole(answers) == expected
    assert negated(all_of(answers)) == any_of([negated(answer) for answer in answers])


@given(st.floats(-10, 10), st.floats(0, 5), st.floats(-10, 0), st.floats(0.1, 10), st.floats(-1, 1))
def test_an_interval_inside_is_inside_wherever_the_value_is(value, half_width, low, width, share):
    answer, true = inside(value, half_width, (low, low + width)), value + share * half_width
    slack = 1e-9
    if answer == YES:
        assert low - slack <= true <= low + width + slack
    if answer == NO:
        assert not low + slack <= true <= low + width - slack
