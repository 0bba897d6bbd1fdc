"""The array checks: read-only in fact, views where that is safe, one sentence where not."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from okid.arrays import (
    CHUNK_VALUES,
    column_block,
    frozen,
    frozen_complex,
    listener,
    real_number,
    row_chunks,
    time_major,
    time_step,
    whole_number,
)
from okid.errors import InvalidDataError


def test_frozen_copies_what_somebody_else_can_write():
    mine = np.ones((2, 2))
    taken = frozen(mine, name="A")
    mine[0, 0] = 5.0
    assert taken[0, 0] == 1.0
    assert not taken.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        taken[0, 0] = 2.0


def test_frozen_copies_a_read_only_view_of_a_writeable_array():
    mine = np.ones((4, 2))
    view = mine[1:]
    view.flags.writeable = False
    taken = time_major(view, name="outputs")
    mine[1, 0] = 5.0
    assert taken[0, 0] == 1.0


def test_read_only_contiguous_arrays_stay_views():
    values = np.ones((5, 2))
    values.flags.writeable = False
    assert np.shares_memory(frozen(values, name="A"), values)
    assert np.shares_memory(time_major(values[1:4], name="outputs"), values)


def test_columns_of_a_plain_array_become_contiguous():
    values = np.arange(12.0).reshape(4, 3)
    values.flags.writeable = False
    taken = time_major(values[:, 1:], name="outputs")
    assert taken.flags.c_contiguous
    np.testing.assert_array_equal(taken, [[1, 2], [4, 5], [7, 8], [10, 11]])


@pytest.mark.parametrize("dtype", [np.float32, np.int16, np.uint8, np.bool_, ">f8"])
def test_any_real_number_becomes_float64(dtype):
    taken = time_major(np.array([[0, 1], [1, 0]], dtype=dtype), name="outputs")
    assert taken.dtype == np.float64
    np.testing.assert_array_equal(taken, [[0.0, 1.0], [1.0, 0.0]])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([[1j]], "complex"),
        (["a", "b"], "real numbers"),
        ([[1.0, np.inf]], "sample 0 of channel 1"),
        (np.zeros((2, 2, 2)), "3 axes"),
        ([[1.0], [1.0, 2.0]], "real numbers"),
    ],
)
def test_time_major_refuses(values, message):
    with pytest.raises(InvalidDataError, match=message):
        time_major(values, name="outputs")


def test_infinite_value_in_a_later_chunk_is_found():
    values = np.zeros((CHUNK_VALUES // 2 + 10, 2))
    values[-3, 1] = -np.inf
    with pytest.raises(InvalidDataError, match=f"sample {len(values) - 3} of channel 1"):
        time_major(values, name="inputs")


def test_frozen_refuses_nan_and_wrong_shapes():
    with pytest.raises(InvalidDataError, match="1 of its 2 values"):
        frozen([1.0, np.nan], name="D")
    with pytest.raises(InvalidDataError, match=r"shape \(2, any\)"):
        frozen(np.zeros((3, 2)), name="D", shape=(2, None))
    with pytest.raises(InvalidDataError, match="finite"):
        frozen_complex([1j * np.nan], name="shape")


def test_frozen_complex_is_a_copy():
    mine = np.array([1j, 2.0])
    taken = frozen_complex(mine, name="shape")
    mine[0] = 0
    assert taken[0] == 1j
    assert not taken.flags.writeable


@given(st.integers(0, 10_000_000), st.integers(0, 5000))
def test_row_chunks_cover_every_row_once(n_samples, n_channels):
    chunks = list(row_chunks(n_samples, n_channels)) if n_samples * max(n_channels, 1) < 2_000_000_000 else []
    if chunks:
        assert chunks[0].start == 0
        assert chunks[-1].stop == n_samples
        assert all(one.stop == other.start for one, other in pairwise(chunks))
        assert all((one.stop - one.start) * max(n_channels, 1) <= max(CHUNK_VALUES, n_channels) for one in chunks)


@given(st.lists(st.integers(0, 5), max_size=6))
def test_column_block_is_fancy_indexing(indices):
    table = np.arange(24.0).reshape(4, 6)
    np.testing.assert_array_equal(column_block(table, indices), table[:, np.array(indices, dtype=int)])


@pytest.mark.parametrize(("indices", "is_view"), [([0, 1, 2], True), ([1, 3, 5], True), ([2], True), ([2, 1], False)])
def test_column_block_is_a_view_where_columns_are_evenly_spaced(indices, is_view):
    table = np.arange(24.0).reshape(4, 6)
    assert np.shares_memory(column_block(table, indices), table) is is_view


@pytest.mark.parametrize(
    "values",
    [
        ["1.0", "2.0"],
        np.array([b"1", b"2"]),
        np.array(["1.0", 2.0], dtype=object),
        np.array(["2026-01-01", "2026-01-02"], dtype="M8[s]"),
        np.array([1, 2], dtype="m8[s]"),
        [np.datetime64("2026-01-01"), np.datetime64("2026-01-02")],
    ],
)
def test_texts_and_times_are_no_numbers(values):
    for check in (time_major, frozen):
        with pytest.raises(InvalidDataError, match="must be real numbers, but holds texts or times"):
            check(values, name="outputs")


@pytest.mark.parametrize("dt", [1e-320, 1e-13, 1e10, np.timedelta64(5, "s"), np.array([0.1])])
def test_absurd_time_steps_are_refused(dt):
    with pytest.raises(InvalidDataError, match="dt must be a"):
        time_step(dt)


@pytest.mark.parametrize("dt", [0, -0.1, np.nan, np.inf, None, "0.01", [0.01], True, 10**400])
def test_what_is_no_time_step(dt):
    with pytest.raises(InvalidDataError, match=r"^dt must be a positive time step in seconds, but is "):
        time_step(dt)


@pytest.mark.parametrize("value", [3, 3.0, np.int64(3), np.float32(3), np.array(3)])
def test_a_count_of_any_type_is_an_int(value):
    count = whole_number(value, name="n_lags", least=1)
    assert type(count) is int
    assert count == 3


@pytest.mark.parametrize("value", [0, -1, 2.5, True, None, "3", [3], np.array([3]), np.nan, np.inf, 1 + 0j, b"3"])
def test_what_is_no_count(value):
    with pytest.raises(InvalidDataError, match=r"^n_lags must be a whole number of at least 1, but is .*\.$"):
        whole_number(value, name="n_lags", least=1)


def test_a_count_beyond_the_digits_of_a_float_stays_exact():
    assert whole_number(2**53 + 1, name="n", least=0) == 2**53 + 1


def test_the_other_choice_is_named():
    with pytest.raises(InvalidDataError, match='of at least 0 or "auto", but is -1'):
        whole_number(-1, name="order", least=0, otherwise='or "auto"')


def test_a_number_is_a_float():
    assert real_number(np.float32(0.5)) == 0.5
    assert np.isnan(real_number(None))


def test_progress_is_told_to_a_function_or_to_nobody():
    told = []
    listener(lambda *said: told.append(said))("fit", 0.5)
    listener(None)("fit", 0.5)
    assert told == [("fit", 0.5)]
    with pytest.raises(InvalidDataError, match=r"progress must be a function .*, but 3 was given"):
        listener(3)
