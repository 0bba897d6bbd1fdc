"""Odd and even lines: which laws answer where, what noise and transients do, and when nothing can be told."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nonlinear_chain import no_force, run_chain

from modal.localisation.lines import input_period, line_statements, measure_lines, periods_of
from okid.errors import InvalidDataError
from okid.record import Record

DT, PERIOD, N_PERIODS = 0.03, 512, 5
LAWS = {
    "none": no_force,
    "cubic": lambda d, v, t: 300.0 * d**3,
    "quadratic": lambda d, v, t: 60.0 * d**2,
    "bilinear": lambda d, v, t: 40.0 * np.maximum(d, 0.0),
    "drag": lambda d, v, t: 0.3 * v * np.abs(v),
    "coulomb": lambda d, v, t: 1.0 * np.sign(v),
    "cubic and quadratic": lambda d, v, t: 300.0 * d**3 + 30.0 * d**2,
}


def multisine(lines, seed=0, *, period=PERIOD, n_periods=N_PERIODS):
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    one = np.fft.irfft(spectrum, period)
    return np.tile(one / one.std(), n_periods)


@cache
def random_odd():
    """Odd lines up to a quarter of the sampling frequency, one of every three left out."""
    rng = np.random.default_rng(1)
    groups = np.arange(1, 127, 2).reshape(-1, 3)
    left_out = groups[np.arange(len(groups)), rng.integers(0, 3, len(groups))]
    return np.setdiff1d(groups.ravel(), left_out)


@cache
def answers():
    """One plain loop for all laws: each record has its own."""
    force = 20.0 * multisine(random_odd())
    laws = list(LAWS.values())

    def law(d, v, t):
        return np.array([one(d[i : i + 1], v[i : i + 1], t)[0] for i, one in enumerate(laws)])

    runs = run_chain([1.0], [400.0], [4.0], np.tile(force, (len(laws), 1)), DT, law=law, n_steps=3)
    return force, dict(zip(LAWS, runs, strict=True))


def lines_of(name, *, noise=0.002, seed=3):
    force, runs = answers()
    rng = np.random.default_rng(seed)
    seen = runs[name] + noise * runs[name].std() * rng.standard_normal(runs[name].shape)
    return measure_lines(Record(force, seen, DT))


@pytest.mark.parametrize(
    ("name", "odd", "even"),
    [
        ("none", False, False),
        ("cubic", True, False),
        ("drag", True, False),
        ("coulomb", True, False),
        ("bilinear", True, True),  # a kink is even about zero; about the displaced mean it is odd as well
        ("quadratic", False, True),
        ("cubic and quadratic", True, True),
    ],
)
def test_laws_answer_on_their_own_lines(name, odd, even):
    record = lines_of(name).records[0]
    assert record.period == PERIOD
    assert record.n_periods == N_PERIODS - 1
    assert record.counts[0] == len(random_odd())
    assert record.shows[:, 0].tolist() == [True, odd, even]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none", "noise only"),
        ("cubic", "odd in the motion"),
        ("drag", "odd in the motion"),
        ("coulomb", "odd in the motion"),
        ("quadratic", "even in the motion"),
        ("bilinear", "even in the motion"),
        ("cubic and quadratic", "neither odd nor even"),
    ],
)
def test_laws_in_words(name, words):
    (statement,) = line_statements(lines_of(name))
    assert statement.subject == "lines"
    assert words in statement.text


def test_a_square_is_measured_where_and_as_large_as_the_textbook_says():
    # (cos 3x + cos 5x)^2 = 1 + cos 2x + cos 8x + (cos 6x + cos 10x) / 2: four even lines, mean square 1/2 or 1/8
    x = 2 * np.pi * np.arange(4 * 256) / 256
    force = np.cos(3 * x) + np.cos(5 * x)
    record = measure_lines(Record(force, force + 0.1 * force**2, 0.01)).records[0]
    assert record.counts == (2, 6, 7)  # 1, 7, 9 ... 15 and 2, 4 ... 14
    assert record.power[0, 0] == pytest.approx(0.5)
    assert record.power[2, 0] == pytest.approx(0.01 * (0.5 + 0.5 + 0.125 + 0.125) / 7)
    assert record.level[1, 0] == pytest.approx(record.power[2, 0] / 0.5)
    assert record.shows[:, 0].tolist() == [True, False, True]


def test_the_third_harmonic_of_a_single_sine_counts():
    x = 2 * np.pi * np.arange(6 * 50) / 50
    record = measure_lines(Record(np.sin(x), np.sin(x) + 0.01 * np.sin(3 * x), 0.01)).records[0]
    assert record.shows[:, 0].tolist() == [True, True, False]


def test_noise_alone_shows_nothing():
    force = multisine(random_odd())
    shown = 0
    for seed in range(100):
        noise = np.random.default_rng(seed).standard_normal((force.size, 1))
        shown += int(measure_lines(Record(force, force[:, np.newaxis] + noise, DT)).records[0].shows[1:].sum())
    assert shown <= 1  # 200 tests at 1e-4


def test_the_noise_of_a_line_is_that_of_the_mean_over_the_periods():
    force = multisine(random_odd(), n_periods=9)
    noise = 0.5 * np.random.default_rng(2).standard_normal((force.size, 1))
    record = measure_lines(Record(force, force[:, np.newaxis] + noise, DT)).records[0]
    # white noise of variance 1/4: on each line 2 / PERIOD of it, over eight periods an eighth of that
    np.testing.assert_allclose(record.noise[:, 0], 0.25 * 2 / PERIOD / 8, rtol=0.25)


def test_a_transient_in_the_first_period_is_left_out():
    force, runs = answers()
    seen = np.array(runs["none"])
    seen[:PERIOD] += 10.0 * seen.std() * np.exp(-0.05 * np.arange(PERIOD))[:, np.newaxis]
    noise = 0.002 * runs["none"].std() * np.random.default_rng(1).standard_normal(seen.shape)
    assert measure_lines(Record(force, seen + noise, DT)).records[0].shows[1:].sum() == 0


def test_noise_on_the_measured_input_does_not_excite_lines():
    force, runs = answers()
    measured = force + 0.01 * force.std() * np.random.default_rng(5).standard_normal(force.size)
    record = measure_lines(
        Record(measured, runs["cubic"] + 1e-4 * np.random.default_rng(6).standard_normal(runs["cubic"].shape), DT)
    ).records[0]
    assert record.counts[0] == len(random_odd())
    assert record.shows[:, 0].tolist() == [True, True, False]


def test_lines_that_are_noise_of_the_input_alone_are_not_excited():
    force = multisine(random_odd(), n_periods=9)
    measured = force + 0.3 * np.random.default_rng(5).standard_normal(force.size)
    record = measure_lines(Record(measured, force, DT), period=PERIOD).records[0]
    # on each of eight periods 2 / PERIOD 0.09 of noise against 1 / 42 of signal: above -30 dB, but no line
    assert record is None or record.counts[0] == len(random_odd())
    assert record is not None


@pytest.mark.parametrize(
    ("record", "reason"),
    [
        (Record([], np.sin(np.arange(100.0)), DT), "no input"),
        (Record(np.random.default_rng(0).standard_normal(2000), np.zeros(2000), DT), "do not repeat"),
        (Record(multisine(random_odd(), n_periods=2), np.zeros(2 * PERIOD), DT), "holds 2 periods of 512"),
        (Record(multisine(np.arange(1, 256)), np.zeros(N_PERIODS * PERIOD), DT), "all lines of the band are excited"),
        (Record(multisine(random_odd()), np.r_[np.nan, np.zeros(N_PERIODS * PERIOD - 1)], DT), "missing"),
    ],
)
def test_where_nothing_can_be_told_a_sentence_says_why(record, reason):
    lines = measure_lines(record)
    assert lines.records == (None,)
    assert lines.measured == ()
    assert reason in lines.reasons[0]
    (statement,) = line_statements(lines)
    assert "tell nothing" in statement.text
    assert reason in statement.text


def test_a_given_period_is_taken():
    force = multisine(random_odd())
    record = measure_lines(Record(force, force, DT), period=2 * PERIOD).records
    assert record == (None,)  # two periods of 1024 samples
    assert measure_lines(Record(force, force, DT), period=PERIOD).records[0].period == PERIOD


def test_a_period_is_a_whole_number():
    with pytest.raises(InvalidDataError, match="a period must be a whole number of at least 4"):
        measure_lines(Record(np.arange(9.0), np.arange(9.0), DT), period=2)


# --- periods ---------------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.integers(8, 200), st.integers(2, 6), st.integers(0, 50), st.integers(0, 1000))
def test_the_period_of_any_repeating_input_is_found(period, n_periods, extra, seed):
    one = np.random.default_rng(seed).standard_normal((period, 2))
    inputs = np.tile(one, (n_periods + 1, 1))[: n_periods * period + min(extra, period - 1)]
    assert input_period(Record(inputs, inputs[:, 0], DT)) == period


@settings(max_examples=30, deadline=None)
@given(st.integers(16, 300), st.integers(3, 8))
def test_the_period_of_a_sine_is_not_a_step_of_it(period, n_periods):
    sine = np.sin(2 * np.pi * np.arange(n_periods * period) / period)
    assert input_period(Record(sine, sine, DT)) == period


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_period_is_found_in_noise(noise):
    force = multisine(random_odd(), n_periods=4)
    force = force + noise * np.random.default_rng(1).standard_normal(force.size)
    assert input_period(Record(force, force, DT)) == PERIOD


@pytest.mark.parametrize(
    "inputs",
    [np.random.default_rng(2).standard_normal(1000), np.arange(500.0), np.ones(100), np.r_[np.nan, np.ones(99)]],
)
def test_what_does_not_repeat_has_no_period(inputs):
    assert input_period(Record(inputs, np.arange(float(inputs.size)), DT)) is None


def test_whole_periods_are_the_last_ones():
    values = np.arange(10.0)[:, np.newaxis]
    np.testing.assert_array_equal(periods_of(values, 4)[:, :, 0], [[2, 3, 4, 5], [6, 7, 8, 9]])
