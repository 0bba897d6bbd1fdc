import numpy as np
import pytest
import scipy.signal

from modal.quality.channels import most_white_noise
from modal.quality.check import check_quality
from okid.record import Record


def found(record, what):
    return [finding for finding in check_quality(record).findings if finding.what == what]


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


def test_white_noise_in_the_place_of_an_output_is_doubtful():
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
def test_motion_up_to_half_the_sampling_frequency_is_noted(cut, n_found):
    values = np.random.default_rng(2).standard_normal(20_000)
    values = scipy.signal.lfilter([1.0], [1, -0.5], values)
    if cut is not None:  # as an anti-alias filter leaves it
        values = scipy.signal.sosfilt(scipy.signal.butter(8, cut, output="sos"), values)
    assert len(found(only(values), "no roll-off")) == n_found


def test_a_held_input_needs_no_anti_alias_filter():
    rng = np.random.default_rng(3)
    force = rng.standard_normal(6000)
    tip = scipy.signal.lfilter([1.0], [1, -0.5], force)
    assert found(Record(force, tip, 0.01, input_hold="zero_order"), "no roll-off") == []
    assert len(found(Record(force, tip, 0.01, input_hold="band_limited"), "no roll-off")) == 1


@pytest.mark.parametrize(("periods", "n_found"), [(4, 1), (60, 0)])
def test_few_periods_without_an_input_are_doubtful(periods, n_found):
    k = np.arange(4000)
    swing = np.sin(2 * np.pi * periods * k / 4000) + 0.01 * np.random.default_rng(4).standard_normal(4000)
    assert len(found(only(swing), "too short")) == n_found
