"""A table of the modes of many records followed through time: tracks, what causes explain, alarms."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from modal.batch.tables import Batch
from modal.comparison.shifts import Shift
from modal.comparison.words import percent_text
from modal.tracking.alarms import LEVEL, LevelChange, find_changes
from modal.tracking.environment import explain
from modal.tracking.following import followed
from modal.wording.numbers import hertz
from okid.arrays import ComplexArray, FloatArray, frozen
from okid.errors import InvalidDataError

__all__ = ["Alarm", "Track", "Tracks", "track"]

COLUMNS = ("record", "start_time", "frequency", "verdict", "shape")
MOST_NAMED = 4
"""Name so many modes in a reason, those that moved most surely."""
NINETY_FIVE = 1.96
"""Name a mode in a reason where zero is not within its 95 % interval of so many deviations."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Track:
    """One mode through the records.

    Attributes:
        number: from 0 by median frequency; the column "track" of `Tracks.modes`.
        frequency: (n_found,) [Hz].
        times: (n_found,) of the records in which it was found [s], or their numbers where they have no times.
        left: (n_found,) of ln f, less what the causes explain: zero in the mean before the first change.
        explained: share of the variance of ln f that the causes explain on held-out months; nan without causes.
        born: its first time, None where it may have been there from the start.
        died: its last time, None where it may still be there.
    """

    number: int
    frequency: FloatArray
    times: FloatArray
    left: FloatArray
    explained: float
    born: float | None
    died: float | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Alarm:
    """A change that neither the causes nor chance explain.

    Attributes:
        time: from which on the records say so beyond chance [s], or number of the record.
        since: when the change began, as near as the records tell.
        reason: which modes moved how far, in words.
        p_value: chance of a change so large anywhere in the table where nothing changed.
        shifts: (n_tracks,) relative change of each frequency; nan where it is not known.
        shifts_std: (n_tracks,) their standard deviations.
    """

    time: float
    since: float
    reason: str
    p_value: float
    shifts: FloatArray
    shifts_std: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Tracks:
    """The modes of many records, followed.

    Attributes:
        modes: pyarrow.Table, the rows of the table of modes with a column "track", -1 for a pole that belongs to none.
        tracks: by median frequency.
        alarms: by time.
        causes: what the frequencies were found to depend on, in words; empty where no cause was given or helps.
        clock: times are seconds; else numbers of records, because they have no times of their own.
    """

    modes: Any
    tracks: tuple[Track, ...]
    alarms: tuple[Alarm, ...]
    causes: tuple[str, ...]
    clock: bool

    def __repr__(self) -> str:
        return f"Tracks({len(self.tracks)} modes in {self.modes.num_rows} poles, {len(self.alarms)} alarms)"


def track(batch_or_table: Any, *, causes: Mapping[str, npt.ArrayLike] | None = None) -> Tracks:
    """Follow every mode through many records; say what changed beyond what the causes and chance explain.

    Args:
        batch_or_table: of `modal.identify_batch`, or a table of modes (anything that pyarrow takes) with the columns
            record, start_time, frequency, verdict and shape.
        causes: what was measured besides, such as a temperature: a value a record, in the order of the records (of
            `Batch.records`, or as a table names them first).

    Returns:
        Tracks and alarms. A false alarm has a chance of at most 1 in 400 a month.

    Raises:
        InvalidDataError: a column that is missing, a cause with another number of values or one that is not finite.

    Example:
        >>> import pyarrow as pa
        >>> shape = [{"real": 1.0, "imag": 0.0}, {"real": 0.5, "imag": 0.0}]
        >>> rows = [{"record": f"{k}", "start_time": float(k), "frequency": 2.0 + 1e-3 * (k % 2), "verdict": "system",
        ...          "shape": shape} for k in range(8)]
        >>> track(pa.Table.from_pylist(rows))
        Tracks(1 modes in 8 poles, 0 alarms)
    """
    table, names = _table_of(batch_or_table)
    record = _numbers(table, names)
    starts = np.zeros(len(names))
    starts[record] = table.column("start_time").to_numpy(zero_copy_only=False)
    given = _given(causes or {}, len(names))
    seen = np.unique(record)  # a record without a mode has no time either
    clock = bool(np.unique(starts[seen]).size == seen.size > 1)
    order = seen[np.argsort(starts[seen], kind="stable")] if clock else seen
    place = np.full(len(names), -1, dtype=np.intp)
    place[order] = np.arange(order.size)
    times: FloatArray = starts[order] if clock else order.astype(np.float64) + 1.0
    frequency = np.asarray(table.column("frequency").to_numpy(zero_copy_only=False), dtype=np.float64)
    verdict = np.asarray(table.column("verdict").to_pylist(), dtype=np.str_)
    owner = np.full(frequency.size, -1, dtype=np.intp)
    rows = np.flatnonzero((verdict != "noise") & np.isfinite(frequency) & (frequency > 0.0))
    rows = rows[np.argsort(place[record[rows]], kind="stable")]
    if not rows.size:
        return Tracks(modes=_with_tracks(table, owner), tracks=(), alarms=(), causes=(), clock=clock)
    owner[rows] = followed(place[record[rows]], frequency[rows], _shapes(table)[rows], verdict[rows] == "doubtful")
    n_tracks = int(owner.max(initial=-1)) + 1
    values = np.full((order.size, n_tracks), np.nan)
    mine = owner >= 0
    values[place[record[mine]], owner[mine]] = np.log(frequency[mine])
    environment = explain(values, {name: cause[order] for name, cause in given.items()}, times, clock=clock)
    changes = find_changes(values, environment.terms, times, clock=clock)
    first = changes[0].since if changes else order.size
    steps = np.array([np.arange(order.size) >= change.since for change in changes], dtype=np.float64)
    design = np.column_stack([np.ones(order.size), environment.terms, *steps])
    tracks = tuple(
        _track(k, values[:, k], times, _left(values[:, k], design, environment.terms, first), environment.explained[k])
        for k in range(n_tracks)
    )
    return Tracks(
        modes=_with_tracks(table, owner),
        tracks=tracks,
        alarms=tuple(_alarm(change, tracks, times, given=bool(given)) for change in changes),
        causes=environment.names,
        clock=clock,
    )


def _table_of(batch_or_table: Any) -> tuple[Any, list[str]]:
    """The table of modes and the names of all records."""
    import pyarrow as pa

    if isinstance(batch_or_table, Batch):
        return batch_or_table.modes, batch_or_table.records.column("record").to_pylist()
    try:
        table = batch_or_table if isinstance(batch_or_table, pa.Table) else pa.table(batch_or_table)
    except (TypeError, ValueError, pa.ArrowException) as error:
        raise InvalidDataError(
            f"track takes a Batch of modal.identify_batch or a table of modes, not {type(batch_or_table).__name__}."
        ) from error
    missing = [name for name in COLUMNS if name not in table.column_names]
    if missing:
        raise InvalidDataError(
            f"a table of modes needs the columns {', '.join(COLUMNS)}, but this one lacks {', '.join(missing)}; "
            "modal.identify_batch writes one."
        )
    return table, list(dict.fromkeys(table.column("record").to_pylist()))


def _numbers(table: Any, names: Sequence[str]) -> npt.NDArray[np.intp]:
    number = {name: place for place, name in enumerate(names)}
    return np.array([number[name] for name in table.column("record").to_pylist()], dtype=np.intp)


def _shapes(table: Any) -> ComplexArray:
    """(n_rows, n_outputs), nan where a row has fewer."""
    listed = table.column("shape").to_pylist()
    n_outputs = max((len(shape or ()) for shape in listed), default=0)
    shapes = np.full((len(listed), n_outputs), np.nan, dtype=np.complex128)
    for row, shape in zip(shapes, listed, strict=True):
        for k, one in enumerate(shape or ()):
            row[k] = complex(one["real"], one["imag"]) if isinstance(one, dict) else one
    return shapes


def _given(causes: Mapping[str, npt.ArrayLike], n_records: int) -> dict[str, FloatArray]:
    given = {}
    for name, values in causes.items():
        cause = np.asarray(values, dtype=np.float64)
        if cause.shape != (n_records,):
            raise InvalidDataError(
                f"the cause {name!r} has the shape {cause.shape}, but there are {n_records} records; give one value a "
                "record, in their order."
            )
        if not np.isfinite(cause).all():
            raise InvalidDataError(
                f"the cause {name!r} is missing in {int((~np.isfinite(cause)).sum())} of {n_records} records; fill "
                "the gaps, or leave these records out."
            )
        given[name] = frozen(cause, name=name, shape=(n_records,))
    return given


def _left(values: FloatArray, design: FloatArray, terms: FloatArray, first: int) -> FloatArray:
    """(n_found,) less the causes, as they are fitted beside the changes; its level is that before record `first`."""
    there = ~np.isnan(values)
    coefficients = np.linalg.lstsq(design[there], values[there] - np.nanmean(values), rcond=1e-10)[0]
    left: FloatArray = values[there] - terms[there] @ coefficients[1 : 1 + terms.shape[1]]
    before = np.flatnonzero(there) < first
    return left - left[before if before.any() else slice(None)].mean()


def _track(number: int, values: FloatArray, times: FloatArray, left: FloatArray, explained: float) -> Track:
    found = np.flatnonzero(~np.isnan(values))
    life = found[-1] - found[0] + 1
    missed = 1.0 - found.size / life
    # how often chance alone would miss it so many times in a row, at its own rate
    born = missed ** int(found[0]) < LEVEL / 2
    died = missed ** int(values.size - 1 - found[-1]) < LEVEL / 2
    return Track(
        number=number,
        frequency=np.exp(values[found]),
        times=times[found],
        left=left,
        explained=float(explained),
        born=float(times[found[0]]) if born and found[0] else None,
        died=float(times[found[-1]]) if died and found[-1] < values.size - 1 else None,
    )


def _alarm(change: LevelChange, tracks: Sequence[Track], times: FloatArray, *, given: bool) -> Alarm:
    z = np.abs(change.steps / change.deviations)
    order = [int(k) for k in np.argsort(-np.nan_to_num(z)) if z[k] > NINETY_FIVE] or [int(np.nanargmax(z))]
    moved = [
        f"{hertz(float(np.median(tracks[k].frequency)))} Hz by "
        + percent_text(
            Shift(
                what="frequency",
                before=1.0,
                after=1.0 + change.steps[k],
                change=float(change.steps[k]),
                half_width=float(NINETY_FIVE * change.deviations[k]),
                p_value=change.p_value,
            )
        )
        for k in order[:MOST_NAMED]
    ]
    more = f", and {len(order) - MOST_NAMED} more" if len(order) > MOST_NAMED else ""
    besides = "what the causes explain" if given else "chance (no cause was given that might explain it)"
    return Alarm(
        time=float(times[change.noticed]),
        since=float(times[change.since]),
        reason=f"the {len(tracks)} modes together moved beyond {besides}: {', '.join(moved)}{more}",
        p_value=change.p_value,
        shifts=np.expm1(change.steps),
        shifts_std=change.deviations,
    )


def _with_tracks(table: Any, owner: npt.NDArray[np.intp]) -> Any:
    import pyarrow as pa

    kept = table.drop_columns(["track"]) if "track" in table.column_names else table
    return kept.append_column("track", pa.array(owner.astype(np.int32)))
