import numpy as np
import pytest
import scipy.signal

from modal.quality.channels import hum_findings, mains_lines

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
    (finding,) = hum_findings(channel, lines, [], 1)
    assert finding.level == level
    assert "50 Hz" in finding.sentence
    assert finding.share == pytest.approx(size / np.sqrt(1 + size**2), rel=0.1)


def test_a_driven_resonance_at_50_hz_is_no_hum(channel_of):
    for seed in range(20):
        channel = channel_of(resonance(seed=seed), dt=DT)
        assert hum_findings(channel, mains_lines(channel), [], 1) == []


def test_a_line_elsewhere_is_not_of_the_mains(channel_of):
    channel = channel_of(resonance(20.0) + hum(0.3, 43.0), dt=DT)
    assert hum_findings(channel, mains_lines(channel), [], 1) == []


def test_harmonics_are_named_and_60_hz_by_itself(channel_of):
    channel = channel_of(resonance(20.0) + hum(0.1, 60.01) + hum(0.1, 180.03), dt=DT)
    (finding,) = hum_findings(channel, mains_lines(channel), [], 1)
    assert "60 Hz mains (60, 180 Hz)" in finding.sentence


def test_a_line_that_the_input_holds_is_its_answer(channel_of):
    force = channel_of(np.random.default_rng(2).standard_normal(20_000) + hum(0.3), dt=DT, role="input")
    quiet = channel_of(np.random.default_rng(2).standard_normal(20_000), dt=DT, role="input")
    channel = channel_of(resonance(20.0) + hum(0.3), dt=DT)
    lines = mains_lines(channel)
    assert hum_findings(channel, lines, [mains_lines(force)], 1) == []
    assert len(hum_findings(channel, lines, [mains_lines(quiet)], 1)) == 1


def test_a_band_below_50_hz_and_a_second_of_data_say_nothing(channel_of):
    slow = channel_of(np.random.default_rng(0).standard_normal(5000), dt=0.02)
    assert mains_lines(slow).frequencies.size == 0
    short = channel_of(hum(1.0, n=900), dt=DT)
    assert hum_findings(short, mains_lines(short), [], 1) == []
