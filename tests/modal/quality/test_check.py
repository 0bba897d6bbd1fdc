from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_records import KINDS, clean_record, with_fault
from roving import unknown_forces

from modal.preparation.channel import Finding
from modal.quality import check_quality
from modal.quality.check import DataQuality
from okid.errors import InvalidDataError
from okid.record import Record
from okid.rows import join_setups

WITHOUT_ORDER = [kind for kind in KINDS if kind != "sine"]
"""A single sine is clean and yet poor: it is told apart in test_inputs."""


def serious(quality):
    return [(finding.what, finding.sentence) for finding in quality.findings if finding.level != "note"]


def whats(quality, channel="output_0"):
    return {finding.what for finding in quality.findings if channel in finding.channels}


@pytest.mark.parametrize("kind", WITHOUT_ORDER)
def test_a_clean_record_of_any_kind_has_nothing_wrong(kind):
    inputs, outputs, dt = clean_record(np.random.default_rng([7, KINDS.index(kind)]), kind, n_samples=3000)
    quality = check_quality(Record(inputs, outputs, dt))
    assert serious(quality) == []
    assert quality.level == "good"
    assert quality.verdict.startswith("No fault was found")


@pytest.mark.parametrize(
    ("fault", "size", "what", "level"),
    [
        ("constant", 1, "constant", "bad"),
        ("stuck", 0.02, "stuck", "bad"),
        ("missing", 0.7, "missing samples", "doubtful"),
        ("clipped", 0.02, "clipped", "bad"),
        ("coarse", 3, "coarse", "doubtful"),
        ("spikes", 0.003, "spikes", "bad"),
        ("noise", 4, "low coherence", "bad"),
        ("white", 1, "white noise", "doubtful"),
        ("copy", 1, "copied channel", "bad"),
        ("negated", 1, "copied channel", "bad"),
        ("ahead", 6, "runs ahead", "bad"),
        ("drift", 2, "drift", "doubtful"),
        ("level", 8, "level changes", "doubtful"),
    ],
)
def test_each_fault_is_named_in_its_channel(fault, size, what, level):
    rng = np.random.default_rng(3)
    force = rng.standard_normal((6000, 1))
    outputs = np.empty((6000, 3))
    for i, frequency in enumerate((0.03, 0.05, 0.08)):
        state = np.exp(-2 * np.pi * frequency * 0.03) * np.exp(2j * np.pi * frequency)
        response = np.imag(state ** np.arange(400))
        outputs[:, i] = np.convolve(force[:, 0], response)[:6000]
    outputs += 0.01 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    assert serious(check_quality(Record(force, outputs, 0.004))) == []
    quality = check_quality(Record(force, with_fault(rng, outputs, 0.004, fault, size), 0.004))
    assert [
        finding.level for finding in quality.findings if finding.what == what and "output_0" in finding.channels
    ] == [level]
    assert quality.channels[1].level == level
    assert not {"constant", "stuck", "clipped", "spikes", "coarse"} & whats(quality, "output_1")


def test_an_output_that_no_record_holds_is_told_once_and_costs_the_others_nothing():
    """It was missing samples too, no coherence was measured for its gaps, and its value was "always nan"."""
    rng = np.random.default_rng(0)
    force = rng.standard_normal(4000)
    tip = np.convolve(force, [0.0, 1.0, 1.6, 1.5, 0.8])[:4000] + 0.1 * rng.standard_normal(4000)
    quality = check_quality(Record(force, np.column_stack([tip, np.full(4000, np.nan)]), 0.01))
    (finding,) = (one for one in quality.findings if "output_1" in one.channels)
    assert finding.sentence == "output 'output_1' holds no number: it was not recorded; leave it out."
    assert quality.channels[1].statistics.explained > 0.95


def test_levels_and_verdict_follow_the_worst_finding():
    def quality(*levels):
        found = tuple(Finding(level=level, what="x", where="y", sentence="z.") for level in levels)
        none = np.empty(0)
        return DataQuality(channels=(), findings=found, coherence=None, frequencies=none, densities=none)

    assert quality().level == "good"
    assert quality("note").level == "good"
    assert quality("note", "doubtful").level == "doubtful"
    assert quality("doubtful", "bad").level == "bad"
    assert "1 bad fault, and 2 doubtful points" in quality("bad", "doubtful", "doubtful").verdict
    assert "no bad fault, but 1 doubtful point to" in quality("doubtful").verdict


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1e-9, 1e6]))
def test_units_do_not_change_what_is_found(seed, scale):
    rng = np.random.default_rng(seed)
    inputs, outputs, dt = clean_record(rng, "white", n_samples=2000)
    outputs = with_fault(rng, outputs, dt, "clipped", 0.05)
    first = check_quality(Record(inputs, outputs, dt))
    second = check_quality(Record(inputs, scale * outputs, dt))
    assert [(f.level, f.what, f.channels) for f in first.findings] == [
        (f.level, f.what, f.channels) for f in second.findings
    ]


@pytest.mark.parametrize("n_samples", [1, 2, 5, 20, 100])
def test_short_records_are_looked_at_as_far_as_they_go(n_samples):
    rng = np.random.default_rng(0)
    quality = check_quality(Record(rng.standard_normal((n_samples, 1)), rng.standard_normal((n_samples, 1)), 0.01))
    assert len(quality.channels) == 2
    assert quality.densities.shape[1] == 2


def test_gaps_everywhere_are_survived():
    values = np.random.default_rng(0).standard_normal((300, 2))
    values[::2, 0] = np.nan
    values[1::2, 1] = np.nan
    quality = check_quality(Record(np.empty((300, 0)), values, 0.01))
    assert quality.level == "bad"
    assert quality.frequencies.size == 0


def test_several_records_are_one_and_places_name_the_record():
    rng = np.random.default_rng(1)
    inputs, outputs, dt = clean_record(rng, "white", n_samples=3000)
    broken = outputs.copy()
    broken[1000:1200, 0] = broken[1000, 0]
    quality = check_quality([Record(inputs, outputs, dt), Record(inputs, broken, dt)])
    (finding,) = [f for f in quality.findings if f.what == "stuck"]
    assert finding.spans == ((1, pytest.approx(1000 * dt), pytest.approx(1200 * dt)),)
    assert "record 2" in finding.where
    with pytest.raises(InvalidDataError):
        check_quality([Record(inputs, outputs, dt), Record(inputs, outputs, 2 * dt)])


def test_a_mapped_file_gives_what_the_array_gives(tmp_path):
    inputs, outputs, dt = clean_record(np.random.default_rng(2), "white", n_samples=3000)
    table = np.lib.format.open_memmap(tmp_path / "t.npy", "w+", shape=(3000, inputs.shape[1] + outputs.shape[1]))
    table[:] = np.hstack([inputs, outputs])
    table.flush()
    mapped = np.load(tmp_path / "t.npy", mmap_mode="r")
    n = inputs.shape[1]
    from_file = check_quality(Record(mapped[:, :n], mapped[:, n:], dt))
    from_memory = check_quality(Record(inputs, outputs, dt))
    assert [f.sentence for f in from_file.findings] == [f.sentence for f in from_memory.findings]
    assert np.array_equal(from_file.densities, from_memory.densities)


def test_names_from_files_are_shortened_in_sentences():
    values = np.column_stack([np.zeros(100), np.random.default_rng(0).standard_normal(100)])
    record = Record(np.empty((100, 0)), values, 0.01, output_names=["x" * 3000, "y"])
    assert max(len(finding.sentence) for finding in check_quality(record).findings) < 600


def test_without_inputs_the_spectra_have_fine_lines():
    """An eighth of 3000 rows, a power of two; a thirty-second where there are inputs that explain the outputs."""
    rng = np.random.default_rng(0)
    force = rng.standard_normal(3000)
    motion = np.convolve(force, np.hanning(9))[:3000]
    assert check_quality(Record([], motion, 0.01)).frequencies.size == 129
    assert check_quality(Record(force, motion, 0.01)).frequencies.size == 33


def test_what_another_set_up_measured_is_not_missing():
    """Nine channels of three clean set-ups were called bad, and the remedy was to leave them out."""
    setups = join_setups([unknown_forces(1, (0, 1, 2)), unknown_forces(2, (0, 3))])
    assert serious(check_quality(setups)) == []
    for quality in (check_quality(setups), check_quality(setups[::-1])):  # whatever the first set-up lacks
        statistics = {channel.name: channel.statistics for channel in quality.channels}
        assert all(np.isfinite([one.smallest, one.largest]).all() for one in statistics.values())
        assert not any("too short" in one.sentence for one in quality.findings)
    outputs = setups[1].outputs.copy()
    outputs[500:2500, 3] = np.nan
    found = check_quality([setups[0], replace(setups[1], outputs=outputs)]).findings
    assert {channel for one in found if one.what == "missing samples" for channel in one.channels} == {"y3"}


def test_the_check_goes_to_a_table_of_channels():
    quality = check_quality(Record(*clean_record(np.random.default_rng(1), "white")))
    table = quality.to_table()
    assert table.column("name").to_pylist() == [channel.name for channel in quality.channels]
    assert table.column("std").to_pylist() == [channel.statistics.std for channel in quality.channels]
    assert table.column("findings").to_pylist()[0] == [each.sentence for each in quality.channels[0].findings]
    assert table.schema.field("signal_to_noise").metadata == {b"unit": b"dB"}
