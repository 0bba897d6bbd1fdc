"""Long series kept small on disk: the smallest and the largest value of each bucket instead of every sample.

A plot of a thousand pixels cannot show more than a smallest and a largest value a pixel, and a peak is never lost.
All channels reduced with the same budget share one time grid.
"""

from typing import Final

import numpy as np

from okid.arrays import FloatArray

__all__ = ["SAMPLES_PER_SERIES", "VALUES_PER_RECORDING", "bucket_length", "positions", "reduced", "series_budget"]

SAMPLES_PER_SERIES: Final = 200_000
"""No series is stored with more samples than this."""

VALUES_PER_RECORDING: Final = 3_000_000
"""All series of a recording together; at the 22 bytes a sample that Rerun 0.41 needs, about 66 MB."""


def series_budget(n_series: int) -> int:
    """Samples that each of `n_series` series may have: `SAMPLES_PER_SERIES`, less when there are many.

    Example:
        >>> series_budget(4), series_budget(60)
        (200000, 50000)
    """
    return max(1000, min(SAMPLES_PER_SERIES, VALUES_PER_RECORDING // max(1, n_series)))


def bucket_length(n_samples: int, budget: int) -> int:
    """Samples a bucket so that two values a bucket stay within the budget; 1 when every sample is kept.

    Example:
        >>> bucket_length(1000, 1000), bucket_length(1_000_000, 200_000)
        (1, 10)
    """
    return 1 if n_samples <= budget else -(-2 * n_samples // budget)


def reduced(values: FloatArray, bucket: int) -> FloatArray:
    """The smallest and the largest value of each bucket, in the order in which they came.

    Args:
        values: (n_samples,) one channel; nan is a missing sample.
        bucket: samples a bucket, at least 1; 1 returns the values themselves.

    Returns:
        (2 ceil(n_samples / bucket),); a bucket without any number gives nan, so longer gaps stay gaps.

    Example:
        >>> reduced(np.array([0.0, 3.0, 1.0, 5.0, 4.0, np.nan]), 3)
        array([0., 3., 5., 4.])
    """
    if bucket == 1:
        return values
    n_buckets = -(-values.size // bucket)
    padded = np.full(n_buckets * bucket, np.nan)
    padded[: values.size] = values
    rows = padded.reshape(n_buckets, bucket)
    missing = np.isnan(rows)
    low, high = np.where(missing, np.inf, rows), np.where(missing, -np.inf, rows)
    first_low, first_high = low.argmin(axis=1), high.argmax(axis=1)
    every = np.arange(n_buckets)
    smallest, largest = rows[every, first_low], rows[every, first_high]
    rising = (first_low <= first_high)[:, np.newaxis]
    pairs = np.where(rising, np.column_stack([smallest, largest]), np.column_stack([largest, smallest]))
    pairs[missing.all(axis=1)] = np.nan
    return pairs.reshape(-1)


def positions(n_samples: int, bucket: int) -> FloatArray:
    """Sample positions, as fractions of a sample allow, at which the values of `reduced` stand.

    Example:
        >>> positions(6, 3)
        array([0. , 1.5, 3. , 4.5])
    """
    if bucket == 1:
        return np.arange(n_samples, dtype=np.float64)
    return np.arange(2 * -(-n_samples // bucket), dtype=np.float64) * (bucket / 2)
