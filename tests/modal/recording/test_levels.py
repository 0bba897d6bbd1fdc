"""Min-max reduction against a plain loop, and its invariants."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modal.recording.series import (
    DiskBudget,
    bucket_length,
    places,
    positions,
    reduced,
    row_budget,
    stored_stretches,
    thinned,
)

numbers = st.one_of(st.just(np.nan), st.floats(-1e6, 1e6))


def loop(values, bucket):
    found = []
    for start in range(0, len(values), bucket):
        part = [v for v in values[start : start + bucket] if not np.isnan(v)]
        if not part:
            found += [np.nan, np.nan]
        elif part.index(min(part)) <= part.index(max(part)):
            found += [min(part), max(part)]
        else:
            found += [max(part), min(part)]
    return found


@settings(deadline=None)  # the first run pays for the imports
@given(arrays(float, st.integers(1, 60), elements=numbers), st.integers(2, 9))
def test_equals_a_plain_loop(values, bucket):
    np.testing.assert_array_equal(reduced(values, bucket), loop(values.tolist(), bucket))
    assert positions(values.size, bucket).size == reduced(values, bucket).size


@given(st.integers(1, 500), st.integers(1, 5))
def test_many_series_have_fewer_rows(n_entities, values_each):
    budget = row_budget(n_entities, n_entities * values_each)
    assert 1000 <= budget <= DiskBudget.SAMPLES_PER_SERIES
    # RERUN.md: 22 bytes a sample apart, 78 bytes for eight in a row
    bytes_a_row = n_entities * (22 + 8 * (values_each - 1))
    assert budget * bytes_a_row <= max(1.02 * DiskBudget.BYTES_PER_RECORDING, 1000 * bytes_a_row)


@given(st.integers(1, 10**9), st.integers(1000, 10**6), st.lists(st.integers(0, 10**9), max_size=3))
def test_stretches_cover_the_record_once_within_the_budget(n_samples, budget, around):
    around = [min(sample, n_samples - 1) for sample in around]
    kept = stored_stretches(n_samples, budget, around=around)
    assert kept[0].start == 0
    assert kept[-1].stop == n_samples
    assert all(first.stop == second.start for first, second in itertools.pairwise(kept))
    assert all(part.stop > part.start for part in kept)
    rows = sum(
        part.stop - part.start if part.bucket == 1 else 2 * -(-(part.stop - part.start) // part.bucket) for part in kept
    )
    assert rows <= budget
    detail = [part for part in kept if part.bucket == 1]
    assert any(part.start == 0 for part in detail)
    if around:
        assert any(part.start <= around[0] < part.stop for part in detail)


def test_detail_is_kept_sample_by_sample_and_the_rest_by_its_extremes():
    values = np.random.default_rng(1).standard_normal(50_000)
    kept = stored_stretches(values.size, 4000, around=[30_000])
    stored, where = thinned(values, kept), places(kept)
    assert stored.size == where.size <= 4000
    assert (np.diff(where) > 0).all()
    close = (where >= 29_800) & (where < 30_200)
    np.testing.assert_array_equal(stored[close], values[29_800:30_200])
    np.testing.assert_array_equal(stored[:400], values[:400])
    assert stored.max() == values.max()
    assert stored.min() == values.min()


def test_a_short_series_is_kept_sample_by_sample():
    values = np.arange(5.0)
    assert reduced(values, bucket_length(5, 5)) is values
    assert positions(5, 1).tolist() == [0, 1, 2, 3, 4]
