import numpy as np
import pytest
import scipy.signal

from modal.preparation.channel import channels_of, named, when
from modal.quality.channels import hum_findings, mains_lines, most_white_noise
from modal.quality.check import check_quality
from modal.wording.text import percent
from okid.record import Record
from okid.scaling import channel_scaling


def test_channels_come_inputs_first_with_their_samples_and_numbers():
    rng = np.random.default_rng(0)
    inputs, outputs = rng.standard_normal((50, 2)), rng.standard_normal((50, 11))
    outputs[7, 3] = np.nan
    records = [Record(inputs, outputs, 0.1, start_time=2.0), Record(inputs[:20], outputs[:20], 0.1)]
    channels = list(channels_of(records, channel_scaling(records)))
    assert [channel.name for channel in channels] == [*records[0].input_names, *records[0].output_names]
    for channel in channels:
        values = (inputs if channel.role == "input" else outputs)[:, channel.index]
        both = np.concatenate([values, values[:20]])
        assert np.array_equal(channel.parts[0], values, equal_nan=True)
        assert np.array_equal(channel.parts[1], values[:20], equal_nan=True)
        assert channel.mean == pytest.approx(np.nanmean(both))
        assert channel.std == pytest.approx(np.nanstd(both))
        assert (channel.smallest, channel.largest) == (np.nanmin(both), np.nanmax(both))
        assert channel.n_missing == np.isnan(both).sum()
    assert channels[0].span(0, 3, 5) == (0, pytest.approx(2.3), pytest.approx(2.5))


def test_words_for_names_shares_and_times():
    assert named(["a"]) == "'a'"
    assert named(["a", "b", "c", "d", "e"]) == "'a', 'b', 'c', 'd' and 1 more"
    assert len(named("x" * 500)) < 50
    assert (percent(0.5), percent(0.999), percent(1.0)) == ("50 %", "99.9 %", "100 %")
    assert when([(1, 0.0, 2.0)], 2) == "0 to 2 s of record 2"
    assert when([], 1) == "whole record"


DT = 0.001


def resonance(frequency=50.0, damping=0.01, n=20_000, seed=0):
    """Answer of one mode to white noise: a peak at its frequency that is no line."""
    radius = np.exp(-2 * np.pi * frequency * damping * DT)
    poles = [1.0, -2 * radius * np.cos(2 * np.pi * frequency * DT), radius**2]
    values = scipy.signal.lfilter([1.0], poles, np.random.default_rng(seed).standard_normal(n))
    return values / values.std()


def hum(size, frequency=50.0, n=20_000):
    return size * np.sqrt(2.0) * np.sin(2 * np.pi * frequency * DT * np.arange(n) + 0.7)


@pytest.mark.parametrize(("size", "level"), [(0.005, "note"), (0.1, "doubtful"), (2.0, "bad")])
def test_hum_is_found_with_its_size(channel_of, size, level):
    white = np.random.default_rng(1).standard_normal(200_000)
    channel = channel_of(white * (0.01 if level == "note" else 1.0) + 0 + hum(size, 49.97, 200_000), dt=DT)
    if level == "note":  # the line in slow motion a hundred times as large
        slow = scipy.signal.lfilter(*scipy.signal.butter(2, 0.01), white)
        channel = channel_of(slow / slow.std() + hum(size, 49.97, 200_000), dt=DT)
    lines = mains_lines(channel)
    (finding,) = hum_findings(channel, lines, [])
    assert finding.level == level
    assert "50 Hz" in finding.sentence
    assert finding.share == pytest.approx(size / np.sqrt(1 + size**2), rel=0.1)


def test_a_driven_resonance_at_50_hz_is_no_hum(channel_of):
    for seed in range(20):
        channel = channel_of(resonance(seed=seed), dt=DT)
        assert hum_findings(channel, mains_lines(channel), []) == []


def test_a_line_elsewhere_is_not_of_the_mains(channel_of):
    channel = channel_of(resonance(20.0) + hum(0.3, 43.0), dt=DT)
    assert hum_findings(channel, mains_lines(channel), []) == []


def test_harmonics_are_named_and_60_hz_by_itself(channel_of):
    channel = channel_of(resonance(20.0) + hum(0.1, 60.01) + hum(0.1, 180.03), dt=DT)
    (finding,) = hum_findings(channel, mains_lines(channel), [])
    assert "60 Hz mains (60, 180 Hz)" in finding.sentence


def test_a_line_that_the_input_holds_is_its_answer(channel_of):
    force = channel_of(np.random.default_rng(2).standard_normal(20_000) + hum(0.3), dt=DT, role="input")
    quiet = channel_of(np.random.default_rng(2).standard_normal(20_000), dt=DT, role="input")
    channel = channel_of(resonance(20.0) + hum(0.3), dt=DT)
    lines = mains_lines(channel)
    assert hum_findings(channel, lines, [mains_lines(force)]) == []
    assert len(hum_findings(channel, lines, [mains_lines(quiet)])) == 1


def test_a_band_below_50_hz_and_a_second_of_data_say_nothing(channel_of):
    slow = channel_of(np.random.default_rng(0).standard_normal(5000), dt=0.02)
    assert mains_lines(slow).frequencies.size == 0
    short = channel_of(hum(1.0, n=900), dt=DT)
    assert hum_findings(short, mains_lines(short), []) == []


def only(outputs, dt=0.01):
    return Record(np.empty((len(outputs), 0)), outputs, dt)


@pytest.mark.parametrize("size", [0.01, 0.1])
def test_the_noise_floor_bounds_the_noise_that_was_added(size):
    rng = np.random.default_rng(0)
    force = rng.standard_normal(60_000)
    tip = scipy.signal.lfilter([1, 2, 1], [1, -1.8, 0.95], force)
    tip = tip / tip.std() + size * rng.standard_normal(60_000)
    numbers = check_quality(Record(force, tip, 0.01)).channels[1].statistics
    assert numbers.noise_floor == pytest.approx(size, rel=0.3)
    assert numbers.signal_to_noise == pytest.approx(-20 * np.log10(size), abs=3.0)
    assert np.isnan(most_white_noise(np.linspace(0, 1, 8), np.ones(8)))


def test_white_noise_in_the_place_of_an_output_is_doubtful(found):
    rng = np.random.default_rng(1)
    force = rng.standard_normal(6000)
    tip = scipy.signal.lfilter([0, 1], [1, -1.8, 0.95], force)
    record = Record(force, np.column_stack([tip, rng.standard_normal(6000)]), 0.01)
    (finding,) = found(record, "white noise")
    assert finding.channels == ("output_1",)
    assert found(record, "low coherence") == []  # said once
    static = Record(force, np.column_stack([tip, 2.0 * np.roll(force, 1)]), 0.01)  # white, but the input's doing
    assert found(static, "white noise") == []


@pytest.mark.parametrize(("cut", "n_found"), [(None, 1), (0.8, 0)])
def test_motion_up_to_half_the_sampling_frequency_is_noted(cut, n_found, found):
    values = np.random.default_rng(2).standard_normal(20_000)
    values = scipy.signal.lfilter([1.0], [1, -0.5], values)
    if cut is not None:  # as an anti-alias filter leaves it
        values = scipy.signal.sosfilt(scipy.signal.butter(8, cut, output="sos"), values)
    assert len(found(only(values), "no roll-off")) == n_found


def test_a_held_input_needs_no_anti_alias_filter(found):
    rng = np.random.default_rng(3)
    force = rng.standard_normal(6000)
    tip = scipy.signal.lfilter([1.0], [1, -0.5], force)
    assert found(Record(force, tip, 0.01, input_hold="zero_order"), "no roll-off") == []
    assert len(found(Record(force, tip, 0.01, input_hold="band_limited"), "no roll-off")) == 1


@pytest.mark.parametrize(("periods", "n_found"), [(4, 1), (60, 0)])
def test_few_periods_without_an_input_are_doubtful(periods, n_found, found):
    k = np.arange(4000)
    swing = np.sin(2 * np.pi * periods * k / 4000) + 0.01 * np.random.default_rng(4).standard_normal(4000)
    assert len(found(only(swing), "too short")) == n_found
