"""The record: what it refuses, how it is cut, and that nothing it does changes the relation of output to input."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record


@pytest.fixture
def rng():
    return np.random.default_rng(20)


def ramp(n_samples=20, n_inputs=1, n_outputs=2, **options):
    outputs = np.arange(n_samples * n_outputs, dtype=float).reshape(n_samples, n_outputs)
    return Record(-np.arange(n_samples * n_inputs, dtype=float).reshape(n_samples, n_inputs), outputs, 0.1, **options)


def test_what_is_not_given_gets_a_name():
    record = ramp()
    assert record.input_names == ("input_0",)
    assert record.output_names == ("output_0", "output_1")
    assert record.output_units == ("", "")
    assert (record.n_samples, record.n_inputs, record.n_outputs) == (20, 1, 2)
    assert record.duration == pytest.approx(2.0)
    assert record.sampling_frequency == pytest.approx(10.0)
    np.testing.assert_allclose(record.time, 0.1 * np.arange(20))


@pytest.mark.parametrize("inputs", [[], (), np.empty((4, 0)), np.empty(0)])
def test_no_inputs(inputs):
    record = Record(inputs, np.ones((4, 1)), 1.0)
    assert record.inputs.shape == (4, 0)
    assert record.n_inputs == 0
    assert record.complete_rows().all()


def test_a_record_cannot_be_changed():
    record = ramp()
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.dt = 2.0
    with pytest.raises(ValueError, match="read-only"):
        record.outputs[0, 0] = 1.0


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (([0.0] * 4, np.ones((5, 1)), 1.0), {}, "4 samples and outputs 5"),
        (([], np.ones((5, 0)), 1.0), {}, "at least one output"),
        (([], [], 1.0), {}, "at least one output and one sample"),
        ((np.ones((1, 5)), np.ones((2, 5)), 1.0), {}, r"5 channels but only 1 samples.*inputs\.T"),
        (([], np.ones((2, 5)), 1.0), {}, r"5 channels but only 2 samples.*outputs\.T"),
        ((np.ones((3, 4)), np.ones(3), 1.0), {}, r"4 channels but only 3 samples.*inputs\.T"),
        (([], np.ones(4), 0.0), {}, "positive time step"),
        (([], np.ones(4), float("nan")), {}, "positive time step"),
        (([], np.ones(4), None), {}, "positive time step"),
        (([], np.ones(4), "0.01"), {}, "positive time step"),
        (([], np.ones(4), [0.01]), {}, "positive time step"),
        (([], np.ones(4), 1.0), {"start_time": None}, "start_time"),
        (([[1.0], [2.0, 3.0]], np.ones(2), 1.0), {}, "inputs must be an array of real numbers"),
        (([], np.ones(4), 1.0), {"output_names": 3}, "output names must be a sequence of words"),
        (([], np.ones(4), 1.0), {"start_time": float("inf")}, "start_time"),
        (([], np.ones(4), 1.0), {"input_hold": "first_order"}, "zero_order, linear, band_limited"),
        (([], np.ones((4, 2)), 1.0), {"output_names": ["a"]}, "1 output names were given for 2 outputs"),
        (([], np.ones((4, 2)), 1.0), {"output_units": ["m"] * 3}, "3 output units were given for 2 outputs"),
        ((np.ones(4), np.ones(4), 1.0), {"input_names": "a", "output_names": "a"}, "'a' stand more than once"),
        (([], [[np.nan]] * 4, 1.0), {}, "output 'output_0' holds no number in any of its 4 samples"),
        (([], [[np.nan, np.nan]] * 4, 1.0), {}, "outputs 'output_0', 'output_1' hold no number in any of their 4"),
        (([np.nan] * 4, np.ones(4), 1.0), {}, "'input_0' holds no number"),
        (([], [1.0, np.inf, 0.0], 1.0), {}, "infinite"),
        (([], [1.0, 1j, 0.0], 1.0), {}, "complex"),
    ],
)
def test_what_is_no_record(arguments, options, message):
    with pytest.raises(InvalidDataError, match=message):
        Record(*arguments, **options)


def test_options_are_keywords_and_misspelt_ones_are_refused():
    with pytest.raises(TypeError):
        Record([], np.ones(4), 1.0, ["a"])
    with pytest.raises(TypeError):
        Record([], np.ones(4), 1.0, outputs_names=["a"])


@given(st.integers(1, 30), st.data())
def test_samples_count_as_python_slices(n_samples, data):
    record = ramp(n_samples, 1, 1)
    start = data.draw(st.integers(-40, 40))
    stop = data.draw(st.none() | st.integers(-40, 40))
    expected = np.arange(n_samples)[start:stop]
    if expected.size == 0:
        with pytest.raises(InsufficientDataError, match=f"record of {n_samples} samples"):
            record.samples(start, stop)
        return
    part = record.samples(start, stop)
    np.testing.assert_array_equal(part.outputs[:, 0], expected)
    np.testing.assert_array_equal(part.inputs[:, 0], -expected)
    np.testing.assert_allclose(part.time, record.time[start:stop], atol=1e-12)


def test_seconds_take_in_the_start_and_leave_out_the_stop():
    record = ramp(n_outputs=1, start_time=5.0)
    np.testing.assert_allclose(record.seconds(5.3, 5.6).time, [5.3, 5.4, 5.5])
    assert record.seconds(stop=5.1).n_samples == 1
    assert record.seconds(start=6.85).n_samples == 1
    assert record.seconds(0.0, 100.0).n_samples == 20
    assert record.seconds(5.3).seconds(5.4).start_time == pytest.approx(5.4)
    with pytest.raises(InsufficientDataError):
        record.seconds(0.0, 4.0)
    with pytest.raises(InsufficientDataError):
        record.seconds(9.0)


@given(st.lists(st.floats(0.05, 1.0), min_size=1, max_size=5))
def test_split_parts_follow_each_other_and_lose_nothing(shares):
    record = ramp(200, 1, 1)
    if sum(shares) > 1:
        with pytest.raises(InvalidDataError, match="at most 1 together"):
            record.split(*shares)
        return
    parts = record.split(*shares)
    np.testing.assert_array_equal(np.concatenate([part.outputs for part in parts]), record.outputs)
    for part, share in zip(parts, shares, strict=False):
        assert abs(part.n_samples - 200 * share) <= 1


def test_a_part_shorter_than_its_channels_is_too_short():
    with pytest.raises(InsufficientDataError, match="samples 3 to 5 are 2 rows, fewer than the 4 channels"):
        ramp(n_outputs=4).samples(3, 5)


@pytest.mark.parametrize("shares", [(), (0.0, 0.5), (-0.1,)])
def test_split_refuses_shares_that_are_none(shares):
    with pytest.raises(InvalidDataError, match="positive"):
        ramp().split(*shares)


def test_select_by_name_and_index_keeps_names_and_units_together():
    record = ramp(n_inputs=2, n_outputs=3, output_names=["a", "b", "c"], output_units=["m", "N", "V"])
    chosen = record.select(inputs=[1], outputs=["c", 0])
    assert chosen.output_names == ("c", "a")
    assert chosen.output_units == ("V", "m")
    assert chosen.input_names == ("input_1",)
    np.testing.assert_array_equal(chosen.outputs, record.outputs[:, [2, 0]])
    np.testing.assert_array_equal(chosen.inputs, record.inputs[:, [1]])
    assert record.select(inputs=[]).n_inputs == 0
    assert record.select(outputs="b").output_names == ("b",)
    assert record.select().n_outputs == 3


@pytest.mark.parametrize("outputs", [["d"], [3], [-1], []])
def test_select_refuses_what_is_not_there(outputs):
    with pytest.raises(InvalidDataError, match=r"the outputs are a, b, c|at least one output"):
        ramp(n_outputs=3, output_names=["a", "b", "c"]).select(outputs=outputs)


def test_complete_rows_look_at_inputs_and_outputs():
    outputs = np.ones((5, 2))
    outputs[1, 0] = np.nan
    inputs = np.ones((5, 1))
    inputs[3, 0] = np.nan
    np.testing.assert_array_equal(Record(inputs, outputs, 1.0).complete_rows(), [True, False, True, False, True])


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_detrending_takes_a_polynomial_away_exactly_and_passes_over_gaps(degree, rng):
    time = np.linspace(0.0, 1.0, 300)
    trend = np.polynomial.Polynomial(rng.standard_normal(degree + 1) * 1e3)(time)
    outputs = np.column_stack([trend, trend])
    outputs[100:150, 1] = np.nan
    left = Record(trend, outputs, 1.0).detrended(degree)
    np.testing.assert_allclose(left.inputs, 0.0, atol=1e-8)
    np.testing.assert_allclose(left.outputs[~np.isnan(outputs)], 0.0, atol=1e-8)
    np.testing.assert_array_equal(np.isnan(left.outputs), np.isnan(outputs))


def test_detrending_is_the_textbook_mean(rng):
    outputs = rng.standard_normal((50, 3)) + 7.0
    np.testing.assert_allclose(Record([], outputs, 1.0).detrended().outputs, outputs - outputs.mean(axis=0), atol=1e-13)
    with pytest.raises(InvalidDataError, match="degree"):
        ramp().detrended(-1)


def steady_state(A, B, C, D, inputs, *, n_periods):
    """The periodic answer to periodic inputs, by running the textbook loop until the transient has died."""
    state = np.zeros(len(A))
    outputs = []
    for sample in np.tile(inputs, (n_periods, 1)):
        outputs.append(C @ state + D @ sample)
        state = A @ state + B @ sample
    return np.array(outputs)


@pytest.mark.parametrize("factor", [2, 5])
def test_decimation_keeps_the_relation_of_output_to_input(factor, rng):
    """A multisine below the new Nyquist frequency through a random system: the response at each line stays the same."""
    period, lines = 200 * factor, np.arange(1, 60)
    A = np.array([[0.8, 0.5, 0.0], [-0.5, 0.8, 0.1], [0.0, 0.0, 0.6]]) * 0.95
    B, C, D = rng.standard_normal((3, 1)), rng.standard_normal((2, 3)), rng.standard_normal((2, 1))
    time = np.arange(period)
    phases = rng.uniform(0, 2 * np.pi, lines.size)
    inputs = np.cos(2 * np.pi * np.outer(time, lines) / period + phases).sum(axis=1)[:, np.newaxis]
    n_periods = 8
    outputs = steady_state(A, B, C, D, inputs, n_periods=n_periods)
    record = Record(np.tile(inputs, (n_periods, 1)), outputs, 0.01, input_hold="zero_order").samples(4 * period)
    small = record.decimated(factor)
    assert small.dt == pytest.approx(0.01 * factor)
    assert small.input_hold == "band_limited"
    assert small.start_time == pytest.approx(record.start_time + 10 * factor * 0.01)
    n_lines = period // factor
    spectra = np.fft.fft(np.hstack([small.inputs, small.outputs])[:n_lines], axis=0)[lines]
    z = np.exp(2j * np.pi * lines / period)
    truth = np.array([(C @ np.linalg.solve(each * np.eye(3) - A, B) + D)[:, 0] for each in z])
    np.testing.assert_allclose(spectra[:, 1:] / spectra[:, :1], truth, rtol=1e-9)


@pytest.mark.parametrize("chunk_values", [1 << 21, 50])
def test_decimation_is_the_textbook_convolution(chunk_values, rng, monkeypatch):
    import scipy.signal

    monkeypatch.setattr("okid.arrays.CHUNK_VALUES", chunk_values)
    factor, half = 3, 30
    outputs = rng.standard_normal((400, 2))
    outputs[200, 1] = np.nan
    small = Record([], outputs, 1.0).decimated(factor)
    taps = scipy.signal.firwin(2 * half + 1, 0.75 / factor, window=("kaiser", 8.0))
    centres = range(half, 400 - half, factor)
    expected = np.array([taps @ outputs[centre - half : centre + half + 1] for centre in centres])
    np.testing.assert_allclose(small.outputs, expected, atol=1e-13)
    assert 0 < np.isnan(small.outputs[:, 1]).sum() <= 21
    np.testing.assert_allclose(small.time, list(centres))


def test_decimation_passes_low_and_stops_high_frequencies():
    time = np.arange(4000)
    for cycles, gain in ((0.05, 1.0), (0.13, 0.0), (0.33, 0.0)):  # new Nyquist frequency: 0.1 cycles a sample
        wave = Record([], np.sin(2 * np.pi * cycles * time + 0.3), 1.0).decimated(5)
        np.testing.assert_allclose(wave.outputs[:, 0], gain * np.sin(2 * np.pi * cycles * wave.time + 0.3), atol=4e-4)


def test_decimation_refuses_what_it_cannot_do():
    with pytest.raises(InvalidDataError, match="at least 1"):
        ramp().decimated(0)
    with pytest.raises(InvalidDataError, match="whole number"):
        ramp().decimated(1.5)
    with pytest.raises(InsufficientDataError, match="has 20"):
        ramp().decimated(4)
    record = ramp()
    assert record.decimated(1) is record


@pytest.fixture
def mapped(tmp_path, rng):
    """A file of 68 channels (34 MB), mapped."""
    path = tmp_path / "record.npy"
    np.save(path, rng.standard_normal((62_500, 68)))
    return np.load(path, mmap_mode="r")


def test_a_mapped_file_is_never_copied(mapped):
    tracemalloc.start()
    try:
        record = Record(mapped[:, :4], mapped[:, 4:], 0.01)
        part = record.samples(1000, 60_000).select(outputs=list(range(3, 40)))
        halves = record.split(0.5)
        later = record.seconds(100.0, 200.0)
        assert record.complete_rows().all()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    for each in (record, part, later, *halves):
        assert np.shares_memory(each.inputs, mapped)
        assert np.shares_memory(each.outputs, mapped)
        assert not each.outputs.flags.writeable
    assert peak < 8e6  # a fourth of the file: one chunk of Booleans at a time


def test_decimating_a_mapped_file_needs_memory_for_the_result_and_a_chunk(mapped, monkeypatch):
    monkeypatch.setattr("okid.arrays.CHUNK_VALUES", 1 << 17)
    import scipy.signal  # noqa: F401 - its import is not to be counted

    record = Record([], mapped[:, 4:], 0.01)
    tracemalloc.start()
    try:
        small = record.decimated(10)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < small.outputs.nbytes * 2 + 8e6


def test_masked_samples_are_missing_and_not_what_lies_under_the_mask():
    under = np.array([1.0, 999.0, 3.0, 4.0])
    record = Record([], np.ma.masked_array(under, mask=[False, True, False, False]), 1.0)
    np.testing.assert_array_equal(record.outputs[:, 0], [1.0, np.nan, 3.0, 4.0])


def test_an_endless_stretch_of_time_ends_with_the_record():
    record = ramp()
    assert record.seconds(0.0, np.inf).n_samples == record.n_samples
    with pytest.raises(InvalidDataError, match="a time must be a number of seconds"):
        record.seconds(0.0, np.nan)
    with pytest.raises(InvalidDataError, match="shares must be positive"):
        record.split(np.nan)


class Frame:
    """What a data frame of pandas and polars has in common here: columns with names, and an array of their numbers."""

    def __init__(self, columns, values):
        self.columns, self.values = columns, values

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values, dtype=dtype)


class Series(Frame):
    def to_frame(self):
        return Frame(self.columns, np.array(self.values)[:, np.newaxis])


def test_frames_keep_the_names_of_their_columns():
    force, tips = Series(["force"], [1.0, 2.0, 3.0]), Frame(["a", "b"], np.eye(3)[:, :2])
    record = Record(force, tips, 0.01)
    assert (record.input_names, record.output_names) == (("force",), ("a", "b"))
    assert Record(force, tips, 0.01, output_names=["x", "y"]).output_names == ("x", "y")
    assert Record([], Frame([0, 1], np.eye(3)[:, :2]), 0.01).output_names == ("output_0", "output_1")
    with pytest.raises(InvalidDataError, match="'a' stand more than once; rename them"):
        Record(force, Frame(["a", "a"], np.eye(3)[:, :2]), 0.01)


def test_a_whole_number_beyond_all_floats_is_one_of_our_errors():
    with pytest.raises(InvalidDataError, match="outputs must be an array of real numbers"):
        Record([], [1, 10**400], 0.01)
