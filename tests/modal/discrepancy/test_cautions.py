"""Warnings and hints that every diagnosis gets, each on both sides of its rule."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnosis_by_hand import make_diagnosis

from modal.discrepancy.cautions import free_words, spoiled_words, with_cautions
from modal.discrepancy.explained import explained_shares, explained_words, unexplained_outputs
from modal.discrepancy.hold_hint import highest_frequency, hold_words
from okid.record import Record


@cache
def none():
    return replace(make_diagnosis(status="none", n_effects=0), warnings=(), advice=())


def with_share(share, *, output=1):
    """The diagnosis with a gap that leaves so much of an output explained."""
    found = none()
    after = np.array(found.gap_after)
    after[:, output] = [np.sqrt((1.0 - share) * record.outputs[:, output].var()) for record in found.held_out]
    return replace(found, gap_after=after)


@pytest.mark.parametrize("share", [-0.5, 0.0, 0.05, 0.15, 0.99])
def test_the_share_explained_is_that_of_the_variance(share):
    shares = explained_shares(with_share(share))
    assert shares[1] == pytest.approx(share)
    assert shares[0] > 0.99


def test_a_missing_sample_counts_neither_way():
    found = with_share(0.4)
    holes = [record.outputs.copy() for record in found.held_out]
    for values in holes:
        values[::7] = np.nan
    records = tuple(replace(record, outputs=values) for record, values in zip(found.held_out, holes, strict=True))
    assert explained_shares(replace(found, held_out=records))[1] == pytest.approx(0.4, abs=0.02)


@pytest.mark.parametrize(("share", "said"), [(0.09, True), (0.11, False), (-2.0, True)])
def test_an_output_of_which_nothing_is_explained_is_a_warning(share, said):
    found = with_share(share)
    assert unexplained_outputs(found) == (("upper",) if said else ())
    assert bool(explained_words(found)) == said
    warned = with_cautions(found)
    assert warned.status == "none"
    assert any("explains nothing of upper" in words for words in warned.warnings) == said
    assert ("explains nothing of upper" in warned.verdict) == said


@pytest.mark.parametrize(("status", "said"), [("none", True), ("unresolved", False)])
def test_no_praise_is_taken_back_where_none_was_given(status, said):
    found = replace(with_share(0.0), status=status)
    assert ("does not say that the model is right" in explained_words(found)) == said


def test_many_outputs_are_not_all_named():
    found = none()
    many = tuple(
        Record(one.inputs, np.random.default_rng(i).standard_normal((one.n_samples, 6)), one.dt)
        for i, one in enumerate(found.held_out)
    )
    words = explained_words(replace(found, held_out=many, gap_after=np.ones((2, 6))))
    assert "output_3 and 2 more" in words
    assert "output_4" not in words


# --- hold ------------------------------------------------------------------------------------------------------------


def sine(frequency, *, dt=0.01, noise=0.0, n=2000):
    time = np.arange(n) * dt
    values = np.sin(2 * np.pi * frequency * time) + noise * np.random.default_rng(2).standard_normal(n)
    return Record(values, values, dt)


@pytest.mark.parametrize("frequency", [1.3, 7.0, 31.0])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_the_highest_frequency_is_that_of_the_motion_not_of_the_noise(frequency, noise):
    found = highest_frequency((sine(frequency, noise=noise),), np.array([[noise**2]]))
    assert found == pytest.approx(frequency, rel=0.06)


def test_records_of_rest_have_none():
    still = Record(np.zeros(100) + np.arange(100), np.ones(100), 0.01)
    assert highest_frequency((still,), np.zeros((1, 1))) == 0.0


def with_motion(samples_a_period, *, level=9.0, hold="zero_order", **changes):
    """A diagnosis that leaves `level` times the floor, of a motion with so many samples a period."""
    found = none()
    one = replace(sine(1.0 / (samples_a_period * 0.01)), input_hold=hold)
    steps = (*found.steps[:-1], replace(found.steps[-1], held_out_level=level))
    floor = replace(found.noise_floor, variance=np.full((4, 1), 1e-6))
    return replace(found, fit=(one, one), steps=steps, noise_floor=floor, **changes)


@pytest.mark.parametrize(("share", "small"), [(0.1, True), (0.2, False), (np.nan, True), (np.inf, False)])
@pytest.mark.parametrize(("level", "gap"), [(1.6, True), (1.4, False), (np.inf, True), (np.nan, True)])
def test_a_hold_is_doubted_where_a_gap_is_left_that_it_could_explain(share, small, level, gap):
    """At 20 samples a period half a sample is pi / 20 = 0.157 of the motion."""
    found = with_motion(20.0, level=level)
    motion = np.sqrt([record.outputs.var(axis=0) for record in found.held_out])
    found = replace(found, gap_after=share * motion)
    assert bool(hold_words(found)) == (small and gap)
    assert any("Check the hold" in words for words in with_cautions(found).advice) == (small and gap)


@pytest.mark.parametrize(
    ("declared", "instead"), [("zero_order", "band_limited"), ("band_limited", "zero_order"), ("linear", "zero_order")]
)
def test_the_other_hold_is_the_one_to_declare(declared, instead):
    words = hold_words(with_motion(6.0, hold=declared))
    assert f"declared {declared}" in words
    assert f'declare input_hold="{instead}"' in words


@pytest.mark.parametrize(("samples_of_delay", "said"), [(0.1, False), (0.5, True), (1.0, False)])
def test_half_a_sample_of_delay_is_doubted_though_no_gap_is_left(samples_of_delay, said):
    (finding,) = make_diagnosis(status="named", n_effects=1).findings
    tau = replace(finding.parameters[0], name="tau", value=samples_of_delay * 0.01, unit="s")
    delay = replace(finding, effect="input_delay", where="force", parameters=(tau,))
    assert bool(hold_words(with_motion(6.0, level=1.0, status="named", findings=(delay,)))) == said


@pytest.mark.parametrize(("samples_of_delay", "said"), [(0.4, False), (0.0, False), (-1.03, True)])
def test_outputs_that_come_before_their_inputs_are_a_warning(samples_of_delay, said):
    (finding,) = make_diagnosis(status="named", n_effects=1).findings
    tau = replace(finding.parameters[0], name="tau", value=samples_of_delay * 0.01, unit="s")
    delay = replace(finding, effect="input_delay", where="force", parameters=(tau,))
    found = with_cautions(with_motion(6.0, level=1.0, status="named", findings=(delay,)))
    assert any("answer force 0.0103 s (1.03 samples) before" in words for words in found.warnings) == said


def test_without_inputs_there_is_no_hold():
    found = with_motion(6.0)
    free = tuple(record.select(inputs=()) for record in found.fit)
    assert hold_words(replace(found, fit=free)) == ""


def test_a_clipped_output_is_a_warning_whatever_was_found():
    """No sensor's limit is in the catalogue: without the word, a gap spring may stand for it."""
    found = none()
    clipped = [replace(one, outputs=np.clip(one.outputs, -0.7 * one.outputs.std(), np.inf)) for one in found.fit]
    assert not any("spoiled" in words for words in with_cautions(found).warnings)
    warned = with_cautions(replace(found, fit=tuple(clipped)))
    assert any(
        "the records to fit are spoiled: output 'upper' stands at its limit" in words for words in warned.warnings
    )


def test_records_whose_channels_are_named_differently_are_looked_at_all_the_same():
    found = none()
    other = replace(found.fit[0], output_names=("a", "b"))
    assert with_cautions(replace(found, fit=(*found.fit, other))).status == "none"


def test_what_a_law_or_a_test_makes_of_a_record_does_not_spoil_it():
    """A decay whose input column is zero, and play that takes away coherence, are no faults of a channel."""
    found = none()
    still = tuple(replace(one, inputs=np.zeros_like(one.inputs)) for one in found.fit)
    assert spoiled_words(replace(found, fit=still)) == []


@pytest.mark.parametrize(("name", "said"), [("internal force 1 by modal state 2", True), ("stiffness of leg", False)])
def test_a_calibration_that_is_free_in_everything_may_hide_a_gain(name, said):
    found = none()
    one = replace(found.calibrated[0], name=name)
    words = free_words(replace(found, calibrated=(one,) * 24))
    assert (len(words) == 1 and "free in 24 numbers" in words[0]) if said else words == []
