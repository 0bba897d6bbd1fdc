"""Long series kept small on disk, at two levels of detail: the extremes of each bucket of samples, and every sample.

A plot of a thousand pixels cannot show more than a smallest and a largest value a pixel, and a peak is never lost when
both are kept: the overview. Where one looks closer, at the start of a record and around the largest residual, every
sample is kept: the detail. Both levels are stretches of one series, so a view need not know about them. All channels
of a record share one time grid.

The budget: all series of a recording together take at most about `BYTES_PER_RECORDING` on disk, and no entity has more
than `SAMPLES_PER_SERIES` rows. 8 channels of a million samples make a file of less than 100 MB, written in less
than 5 s (`tests/benchmarks/recording_benchmark.py` measures both).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from okid.arrays import FloatArray

__all__ = [
    "BYTES_PER_RECORDING",
    "SAMPLES_PER_SERIES",
    "StoredStretch",
    "bucket_length",
    "places",
    "positions",
    "reduced",
    "row_budget",
    "stretches",
    "thinned",
]

SAMPLES_PER_SERIES: Final = 200_000
"""No series is stored with more rows than this."""

BYTES_PER_RECORDING: Final = 75_000_000
"""All series of a recording together, about; pictures, words and tables are a few megabytes more."""

BYTES_PER_ROW: Final = 14.0
BYTES_PER_VALUE: Final = 8.1
"""What Rerun 0.41 needs on disk for a row of an entity (its time and its identity) and for each value in the row; the
files of 200 000 rows of noise with 1, 2, 3, 5 and 8 values a row took 22.1, 30.1, 38.2, 54.2 and 78.3 bytes a row."""

DETAIL_SHARE: Final = 8
"""Each stretch of detail takes at most this part of the rows; a record has two at most, the overview has the rest."""

LONGEST_DETAIL: Final = 20_000
"""Samples of a stretch of detail, at most."""


def row_budget(n_entities: int, n_values: int) -> int:
    """Rows that each entity may have: `SAMPLES_PER_SERIES`, less when there are many entities or values in their rows.

    Args:
        n_entities: entities that hold series.
        n_values: series in all of them together.

    Example:
        >>> row_budget(8, 8), row_budget(20, 32)
        (200000, 139094)
    """
    bytes_a_row = BYTES_PER_ROW * max(1, n_entities) + BYTES_PER_VALUE * max(1, n_values)
    return max(1000, min(SAMPLES_PER_SERIES, int(BYTES_PER_RECORDING / bytes_a_row)))


def bucket_length(n_samples: int, budget: int) -> int:
    """Samples a bucket so that two values a bucket stay within the budget; 1 when every sample is kept.

    Example:
        >>> bucket_length(1000, 1000), bucket_length(1_000_000, 200_000)
        (1, 10)
    """
    return 1 if n_samples <= budget else -(-2 * n_samples // budget)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredStretch:
    """Samples of a record that are stored at one level of detail.

    Attributes:
        start: the first of them.
        stop: one past the last.
        bucket: samples a stored bucket, 1 where every sample is stored.
    """

    start: int
    stop: int
    bucket: int


def stretches(n_samples: int, budget: int, *, around: Sequence[int] = ()) -> tuple[StoredStretch, ...]:
    """How a record is stored: whole where the budget allows, else its start and what lies `around`, and buckets.

    Args:
        n_samples: of the record.
        budget: rows that it may take, at least 1000 or it is exceeded by a few.
        around: samples around which every sample is wanted; beyond two, those that come first.

    Example:
        >>> [(s.start, s.stop, s.bucket) for s in stretches(100_000, 8000, around=[50_000])]
        [(0, 1000, 1), (1000, 49500, 33), (49500, 50500, 1), (50500, 100000, 33)]
    """
    if n_samples <= budget:
        return (StoredStretch(start=0, stop=n_samples, bucket=1),)
    length = min(LONGEST_DETAIL, budget // DETAIL_SHARE)
    middles = [length // 2, *around][:2]
    details = sorted({min(max(0, middle - length // 2), n_samples - length) for middle in middles})
    # six rows to spare: each stretch of buckets may end in one that is not full
    bucket = bucket_length(n_samples - length * len(details), budget - length * len(details) - 6)
    found: list[StoredStretch] = []
    at = 0
    for start in details:
        if start > at:
            found.append(StoredStretch(start=at, stop=start, bucket=bucket))
        found.append(StoredStretch(start=max(start, at), stop=start + length, bucket=1))
        at = start + length
    if at < n_samples:
        found.append(StoredStretch(start=at, stop=n_samples, bucket=bucket))
    return tuple(found)


def thinned(values: FloatArray, kept: Sequence[StoredStretch]) -> FloatArray:
    """The values of a channel as stored: `reduced` over each stretch, one after the other."""
    return np.concatenate([reduced(values[part.start : part.stop], part.bucket) for part in kept])


def places(kept: Sequence[StoredStretch]) -> FloatArray:
    """Sample positions at which the values of `thinned` stand."""
    return np.concatenate([part.start + positions(part.stop - part.start, part.bucket) for part in kept])


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
    found = np.arange(2 * -(-n_samples // bucket), dtype=np.float64) * (bucket / 2)
    last = n_samples - bucket * (found.size // 2 - 1)  # samples in the last bucket, which need not be full
    found[-1] = found[-2] + last / 2
    return found
