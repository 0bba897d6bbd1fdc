import numpy as np
import pytest

from modal.preparation.amplitude import constant_findings, repeat_findings, stuck_findings
from okid.record import Record


def stuck(channel, others=None):
    n = channel.n_samples
    others = np.random.default_rng(9).standard_normal(n) if others is None else others
    record = Record(others, channel.parts[0], channel.dt)
    return stuck_findings(channel, [record], np.nan)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_frozen_stretch_is_found_where_it_is(channel_of, smooth):
    values = np.random.default_rng(1).standard_normal(3000)
    if smooth:
        values = np.convolve(values, np.hanning(40), "same")
    values[1000:1100] = values[1000]
    (finding,) = stuck(channel_of(values))
    assert finding.what == "stuck"
    assert finding.level == "bad"
    ((_, start, stop),) = finding.spans
    assert (start, stop) == pytest.approx((10.0, 11.0))
    assert finding.share == pytest.approx(100 / 3000)


def test_the_same_channel_without_the_fault_is_clean(channel_of):
    values = np.random.default_rng(1).standard_normal(3000)
    assert stuck(channel_of(values)) == []


def test_less_than_a_hundredth_is_doubtful(channel_of):
    values = np.random.default_rng(1).standard_normal(3000)
    values[1000:1011] = values[1000]
    (finding,) = stuck(channel_of(values))
    assert finding.level == "doubtful"


def test_nine_equal_samples_are_not_enough(channel_of):
    values = np.random.default_rng(1).standard_normal(3000)
    values[1000:1009] = values[1000]
    assert stuck(channel_of(values)) == []


def test_a_body_that_comes_to_rest_and_starts_again_is_not_frozen(channel_of):
    t = np.linspace(0, 1, 400)
    swing = np.cos(np.pi * t)  # ends with no speed
    values = np.concatenate([swing, np.full(500, swing[-1]), swing[::-1]])
    assert stuck(channel_of(values)) == []
    frozen = np.concatenate([swing[:200], np.full(500, swing[199]), swing[200:]])  # stops at full speed
    assert [finding.what for finding in stuck(channel_of(frozen))] == ["stuck"]


def test_where_every_channel_rests_nothing_is_frozen(channel_of):
    rng = np.random.default_rng(2)
    values, force = rng.standard_normal((2, 3000))
    values[1000:1500] = 0.3
    force[1000:1500] = 0.0
    assert stuck(channel_of(values), force) == []


@pytest.mark.parametrize("bits", [6, 10, 14])
def test_the_crest_of_a_coarsely_converted_slow_sine_is_not_frozen(channel_of, bits):
    values = np.sin(np.linspace(0, 20, 20_000) + 0.3)
    step = 2.0 / 2**bits
    assert stuck(channel_of(step * np.round(values / step))) == []


def test_an_input_may_rest_at_zero_but_not_freeze_elsewhere(channel_of):
    values = np.random.default_rng(3).standard_normal(3000)
    burst = values.copy()
    burst[1000:2000] = 0.0
    assert stuck(channel_of(burst, role="input")) == []
    frozen = values.copy()
    frozen[1000:2000] = 0.7
    assert [finding.level for finding in stuck(channel_of(frozen, role="input"))] == ["doubtful"]


def test_a_constant_channel_is_dead_and_a_moving_one_is_not(channel_of):
    (finding,) = constant_findings(channel_of(np.full(100, 2.5)), 1)
    assert finding.level == "bad"
    assert "2.5" in finding.sentence
    assert constant_findings(channel_of(np.r_[np.full(99, 2.5), 2.6]), 1) == []


def test_repeated_samples_name_their_number(channel_of):
    values = np.random.default_rng(4).standard_normal(1000)
    (finding,) = repeat_findings(channel_of(np.repeat(values, 3)), 1)
    assert "3 samples" in finding.sentence
    assert repeat_findings(channel_of(values), 1) == []
