"""Time series of the records: one bulk call an entity, constant style beside it, gaps kept.

A plot of a thousand pixels cannot show more than a smallest and a largest value a pixel, and a peak is never lost when
both are kept: the overview. Where one looks closer, at the start of a record and around the largest residual, every
sample is kept: the detail. Both levels are stretches of one series, so a view need not know about them. All channels
of a record share one time grid.

The budget: all series of a recording together take at most about `BYTES_PER_RECORDING` on disk, and no entity has more
than `SAMPLES_PER_SERIES` rows. 8 channels of a million samples make a file of less than 100 MB, written in less
than 5 s (`tests/benchmarks/recording_benchmark.py` measures both).

Several records share the timeline. A record keeps its own time where it starts after the one before it has ended (parts
of one long measurement do); otherwise it is moved to follow the one before it after a short pause, which stays empty in
every plot. The entity `data/records` says where each one stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from modal.recording.figure import Colour, RecordingStream, rr
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.record import Record


class DiskBudget:
    """What the series of a recording may take on disk."""

    SAMPLES_PER_SERIES: Final = 200_000
    """Store no series with more rows than this."""
    BYTES_PER_RECORDING: Final = 75_000_000
    """Store all series of a recording in about so many; pictures, words and tables are a few megabytes more."""
    BYTES_PER_ROW: Final = 14.0
    BYTES_PER_VALUE: Final = 8.1
    """Count so much on disk for a row of an entity (its time and its identity) and for each value in it: files of
    Rerun 0.41 with 200 000 rows of noise and 1, 2, 3, 5 and 8 values a row took 22.1, 30.1, 38.2, 54.2 and 78.3
    bytes a row."""


def row_budget(n_entities: int, n_values: int) -> int:
    """Rows that each entity may have: `SAMPLES_PER_SERIES`, less when there are many entities or values in their rows.

    Args:
        n_entities: entities that hold series.
        n_values: series in all of them together.

    Example:
        >>> row_budget(8, 8), row_budget(20, 32)
        (200000, 139094)
    """
    bytes_a_row = DiskBudget.BYTES_PER_ROW * max(1, n_entities) + DiskBudget.BYTES_PER_VALUE * max(1, n_values)
    return max(1000, min(DiskBudget.SAMPLES_PER_SERIES, int(DiskBudget.BYTES_PER_RECORDING / bytes_a_row)))


def bucket_length(n_samples: int, budget: int) -> int:
    """Samples a bucket so that two values a bucket stay within the budget; 1 when every sample is kept.

    Example:
        >>> bucket_length(1000, 1000), bucket_length(1_000_000, 200_000)
        (1, 10)
    """
    return 1 if n_samples <= budget else -(-2 * n_samples // budget)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredStretch:
    """Samples of a record that are stored at one level of detail."""

    start: int
    stop: int
    bucket: int


def stored_stretches(n_samples: int, budget: int, *, around: Sequence[int] = ()) -> tuple[StoredStretch, ...]:
    """How a record is stored: whole where the budget allows, else its start and what lies `around`, and buckets.

    Args:
        n_samples: of the record.
        budget: rows that it may take, at least 1000 or it is exceeded by a few.
        around: samples around which every sample is wanted; beyond two, those that come first.

    Example:
        >>> [(s.start, s.stop, s.bucket) for s in stored_stretches(100_000, 8000, around=[50_000])]
        [(0, 1000, 1), (1000, 49500, 33), (49500, 50500, 1), (50500, 100000, 33)]
    """
    if n_samples <= budget:
        return (StoredStretch(start=0, stop=n_samples, bucket=1),)
    length = min(20_000, budget // 8)  # a record has two details at most, the overview has the rest
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


LATEST: Final = 9.2e9
"""Reject times beyond this [s]: Rerun counts nanoseconds, with 63 bits."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StoredRecords:
    """Where each record stands on the timeline, and how finely it is stored.

    Attributes:
        starts: when each record begins on the timeline [s].
        stops: when each ends [s].
        levels: the stretches in which each is stored.
    """

    starts: tuple[float, ...]
    stops: tuple[float, ...]
    levels: tuple[tuple[StoredStretch, ...], ...]

    @property
    def start(self) -> float:
        """Where the timeline begins [s]."""
        return self.starts[0]

    @property
    def stop(self) -> float:
        """Where it ends [s]."""
        return self.stops[-1]


def stored_levels(
    records: Sequence[Record], budget: int, *, around: Sequence[int] = ()
) -> tuple[tuple[StoredStretch, ...], ...]:
    """How each record is stored so that all of them together keep within the budget of rows.

    Args:
        records: of one recording.
        budget: rows that each series may have, over all records.
        around: for each record, the sample around which every sample is wanted.
    """
    n_samples = sum(record.n_samples for record in records)
    if n_samples <= budget:
        return tuple(stored_stretches(record.n_samples, record.n_samples) for record in records)
    shares = [max(64, budget * record.n_samples // n_samples) for record in records]
    wanted: list[Sequence[int]] = [[sample] for sample in around] or [[]] * len(records)
    return tuple(
        stored_stretches(record.n_samples, share, around=samples)
        for record, share, samples in zip(records, shares, wanted, strict=True)
    )


def laid_out(records: Sequence[Record]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """When each record begins and ends on the common timeline [s].

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    starts, stops = _in_turn(np.array([[r.start_time, r.start_time + (r.n_samples - 1) * r.dt] for r in records]))
    furthest = max(abs(starts[0]), abs(stops[-1]))
    if not furthest <= LATEST:
        raise InvalidDataError(
            f"a recording holds times up to {LATEST:g} s (292 years), but the records reach {furthest:.3g} s; count "
            "time in a larger unit, so that dt is smaller."
        )
    return starts, stops


def _in_turn(spans: FloatArray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    lengths = spans[:, 1] - spans[:, 0]
    pause = 0.02 * float(lengths.sum())
    starts = [float(spans[0, 0])]
    stops = [float(spans[0, 1])]
    for (begin, _), length in zip(spans[1:], lengths[1:], strict=True):
        starts.append(float(begin) if begin > stops[-1] else stops[-1] + pause)
        stops.append(starts[-1] + float(length))
    return tuple(starts), tuple(stops)


TIMELINE: Final = "time"

Interpolation = Literal["Linear", "StepAfter"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Line:
    """One channel of all records, and how it is drawn."""

    channels: Sequence[FloatArray]
    name: str
    colour: Colour
    width: float = 1.2


def time_axis(records: Sequence[Record], plan: StoredRecords) -> FloatArray:
    """(n_stored,) times of the stored samples of all records on the timeline [s], one between records for the gap."""
    parts = []
    for record, start, kept in zip(records, plan.starts, plan.levels, strict=True):
        times = start + record.dt * places(kept)
        parts += [times, times[-1:] + 0.5 * record.dt]
    return np.concatenate(parts[:-1])


def log_lines(
    recording: RecordingStream,
    path: str,
    times: FloatArray,
    lines: Sequence[Line],
    *,
    plan: StoredRecords,
    interpolation: Interpolation = "Linear",
) -> None:
    """Several channels of all records as one entity, painted in their order: two in one take a third less than apart.

    Where they do not miss the same samples they become an entity each, below `path`: a row holds all of its channels
    or none.
    """
    values = np.column_stack([_stored(line.channels, plan) for line in lines])
    there = ~np.isnan(values)
    if len(lines) > 1 and (there != there[:, :1]).any():
        for number, line in enumerate(lines, start=1):
            log_lines(recording, f"{path}/{number}", times, [line], plan=plan, interpolation=interpolation)
        return
    columns = rr.Scalars.columns(scalars=values)
    if not there.all():
        # an empty row breaks the line as nan would, but equals itself when two recordings are compared
        rows = there[:, 0]
        columns = rr.Scalars.columns(scalars=values[rows].reshape(-1)).partition(rows * len(lines))
    recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=times)], columns, strict=True)
    # MinMax: with anything else the viewer averages what falls on one pixel, and a vibration is drawn as a flat line
    style = rr.SeriesLines(
        names=[line.name for line in lines],
        colors=[line.colour for line in lines],
        widths=[line.width for line in lines],
        aggregation_policy="MinMax",
        interpolation_mode=interpolation,
    )
    recording.log(path, style, static=True, strict=True)


def _stored(channels: Sequence[FloatArray], plan: StoredRecords) -> FloatArray:
    """What is kept of a channel, the records one after the other with a nan between them."""
    gap = np.array([np.nan])
    parts = [part for values, kept in zip(channels, plan.levels, strict=True) for part in (thinned(values, kept), gap)]
    return np.concatenate(parts[:-1])


def log_sequence(
    recording: RecordingStream,
    path: str,
    *,
    timeline: str,
    index: FloatArray,
    values: FloatArray,
    names: Sequence[str],
) -> None:
    """Numbers against a whole-number index: stored, and a plot of their own once that timeline is chosen.

    Args:
        recording: the stream.
        path: their entity.
        timeline: name of the index, e.g. "lag".
        index: (n,) whole numbers.
        values: (n, n_series).
        names: of the series.
    """
    recording.send_columns(
        path,
        [rr.TimeColumn(timeline, sequence=np.asarray(index, dtype=np.int64))],
        rr.Scalars.columns(scalars=values),
        strict=True,
    )
    recording.log(path, rr.SeriesLines(names=list(names), aggregation_policy="MinMax"), static=True, strict=True)
