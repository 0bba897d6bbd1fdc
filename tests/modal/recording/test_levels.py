"""Min-max reduction against a plain loop, and its invariants."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modal.recording.levels import (
    SAMPLES_PER_SERIES,
    VALUES_PER_RECORDING,
    bucket_length,
    positions,
    reduced,
    series_budget,
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


@given(arrays(float, st.integers(1, 60), elements=numbers), st.integers(2, 9))
def test_equals_a_plain_loop(values, bucket):
    np.testing.assert_array_equal(reduced(values, bucket), loop(values.tolist(), bucket))
    assert positions(values.size, bucket).size == reduced(values, bucket).size


@given(st.integers(1, 10**9), st.integers(1, 500))
def test_budgets_hold(n_samples, n_series):
    budget = series_budget(n_series)
    bucket = bucket_length(n_samples, budget)
    stored = n_samples if bucket == 1 else 2 * -(-n_samples // bucket)
    assert stored <= budget + 2
    assert budget <= SAMPLES_PER_SERIES
    assert n_series * budget <= max(VALUES_PER_RECORDING, 1000 * n_series)


def test_a_short_series_is_kept_sample_by_sample():
    values = np.arange(5.0)
    assert reduced(values, bucket_length(5, 5)) is values
    assert positions(5, 1).tolist() == [0, 1, 2, 3, 4]
