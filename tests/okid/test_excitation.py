"""The excitation check against what is known of the inputs."""

import numpy as np
import pytest

from okid.errors import InvalidDataError
from okid.excitation import _bridged, check_excitation
from okid.record import Record


def record(inputs, **options):
    return Record(inputs, np.random.default_rng(99).standard_normal(len(inputs)), 0.01, **options)


@pytest.mark.parametrize("n_sines", [1, 2, 4])
def test_sines_have_twice_their_number(n_sines):
    k = np.arange(3000)
    u = sum(np.sin(0.35 * (j + 1) * k + j) for j in range(n_sines))
    check = check_excitation(record(u), order=12)
    assert check.persistency_order == 2 * n_sines
    assert f"effects of {2 * n_sines} successive samples apart, and 12 are needed" in check.messages[0]


def test_white_inputs_carry_all_that_is_asked():
    u = np.random.default_rng(1).standard_normal((3000, 2))
    check = check_excitation(record(u), order=30)
    z = u - u.mean(axis=0)
    hankel = np.array([z[k - 29 : k + 1][::-1].ravel() for k in range(29, 3000)])
    hankel = np.linalg.svd((hankel - hankel.mean(axis=0)) / np.tile(u.std(axis=0), 30), compute_uv=False)
    assert check.persistency_order == check.needed_order == 30
    assert check.condition == pytest.approx(hankel[0] / hankel[-1], rel=1e-6)
    assert check.messages == ()
    assert check.excited_share.tolist() == [1.0, 1.0]


def test_the_band_that_an_input_moves_in_is_named():
    rng = np.random.default_rng(2)
    spectrum = np.fft.rfft(rng.standard_normal(8192))
    frequency = np.fft.rfftfreq(8192, 0.01)
    spectrum[(frequency < 10) | (frequency > 20)] = 0
    u = np.column_stack([np.fft.irfft(spectrum), rng.standard_normal(8192)])
    check = check_excitation(record(u, input_names=["shaker", "hammer"]), order=5)
    (low, high), *others = check.excited_bands[0]
    assert others == []
    assert (low, high) == pytest.approx((10, 20), abs=0.6)
    assert any("'shaker' moves in" in text for text in check.messages)
    assert not any("'hammer' moves in" in text for text in check.messages)


def test_constant_and_equal_inputs_are_named():
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, 1000))
    names = ["a", "still", "twice", "b", "sum"]
    check = check_excitation(
        record(np.column_stack([a, np.full(1000, 4.0), -2 * a, b, a + b]), input_names=names), order=3
    )
    text = " ".join(check.messages)
    assert check.persistency_order == 0
    assert "input 'still' never moves (always 4)" in text
    assert "'twice' = -2 times 'a'" in text
    assert "inputs 'a', 'b', 'sum' are dependent" in text or "inputs 'a', 'b', 'sum' are linearly dependent" in text


def test_gaps_and_several_records():
    rng = np.random.default_rng(4)
    u = rng.standard_normal(1000)
    u[300] = np.nan
    check = check_excitation([record(u), record(rng.standard_normal(200))], order=10)
    assert check.persistency_order == 10


def test_no_input_and_a_wrong_order():
    output_only = Record([], np.arange(10.0), 0.1)
    assert "no input was measured" in check_excitation(output_only, order=3).messages[0]
    with pytest.raises(InvalidDataError, match="whole number of at least 1, but is 0"):
        check_excitation(output_only, order=0)


def test_a_numpy_count_is_a_count():
    record = Record(np.random.default_rng(0).standard_normal(200), np.ones(200), 0.1)
    assert check_excitation(record, order=np.int64(3)).persistency_order == 3
    with pytest.raises(InvalidDataError, match="whole number"):
        check_excitation(record, order=np.nan)


def test_bands_that_all_but_touch_are_told_as_one():
    bands = [(0.0, 10.0), (10.3, 20.0), (25.0, 30.0)]
    assert _bridged(bands, 0.5) == [(0.0, 20.0), (25.0, 30.0)]
    assert _bridged(bands, 0.1) == bands


@pytest.mark.parametrize(("n_bands", "words"), [(4, None), (5, "and 1 narrower band)"), (7, "and 3 narrower bands)")])
def test_bands_beyond_the_fourth_are_counted(n_bands, words):
    """Sines ten hertz apart, one a band."""
    k = np.arange(20_000)
    force = sum(np.sin(2 * np.pi * (5.0 + 10.0 * i) * 0.005 * k + i) for i in range(n_bands))
    (text,) = [one for one in check_excitation(Record(force, force, 0.005), order=5).messages if "moves in" in one]
    assert ("narrower" in text) is (words is not None)
    assert words is None or words in text


@pytest.mark.parametrize("row", [0, 1, 500, 998, 999])
def test_a_blow_moves_everywhere_wherever_in_the_record_it_falls(row):
    """At its ends no window saw it, and what was left was the mean that had been taken off."""
    force = np.zeros(1000)
    force[row] = 1.0
    assert check_excitation(Record(force - force.mean(), np.cos(np.arange(1000.0)), 0.01), order=5).excited_share == 1.0


@pytest.mark.parametrize("n_samples", [4000, 5000, 6000])
@pytest.mark.parametrize("turned", [False, True])
def test_a_sweep_moves_up_to_where_it_ends(n_samples, turned):
    """Windows were blind to the last samples, in which a logarithmic sweep passes a fifth of its band."""
    time = np.arange(n_samples) / n_samples
    wave = np.sin(2 * np.pi * 0.0025 * n_samples * (160.0**time - 1.0) / np.log(160.0))  # up to 0.4 cycles a sample
    bands = check_excitation(record(wave[::-1] if turned else wave), order=5).excited_bands[0]
    assert any(low <= 39.5 <= high for low, high in bands)  # of 40 Hz
    assert not any(low <= 43.0 <= high for low, high in bands)


@pytest.mark.parametrize(("n_samples", "most"), [(300, 0.3), (1000, 0.24)])
def test_a_tone_of_few_samples_moves_no_more_of_the_band_for_windows_at_its_ends(n_samples, most):
    tone = np.sin(2 * np.pi * 0.05 * np.arange(n_samples))
    assert check_excitation(record(tone), order=5).excited_share < most
