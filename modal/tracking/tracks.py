"""A table of the modes of many records followed through time: tracks, what causes explain, alarms.

Which pole of a record continues which mode is decided by frequency and shape together, over all modes at once:

    cost = min(|d ln f| / (6 s), 1) / 2 + |d ln f| / 0.3 + (1 - assurance) / 0.5 + doubt

with d ln f from the last frequencies of the mode and s the usual change from one record to the next, which the table
itself tells. What follows 0.3 and 0.5 is the cost of `modal.comparison` between two results, by which a frequency may
jump where the shape stays; the first term lets the nearer of two modes of one shape win. A pair is worth no more than
1; what has no partner begins a mode, and a mode without a partner waits for the next record. Poles of a record are
assigned together, so two modes that cross keep their shapes and do not swap.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from modal.batch.tables import Batch
from modal.comparison.shifts import DOUBT, POLE_SCALE, SHAPE_SCALE, TOO_FAR, Shift
from modal.comparison.words import percent_text
from modal.tracking.alarms import LEVEL, USUAL, LevelChange, enough_records, explain, find_changes
from modal.wording.text import NINETY_FIVE, hertz, listed, shorten
from okid.arrays import BoolArray, ComplexArray, FloatArray, frozen
from okid.display import Displayed
from okid.errors import InvalidDataError

IndexArray = npt.NDArray[np.intp]

COLUMNS = ("record", "start_time", "frequency", "verdict", "shape")
MOST_NAMED = 4
"""Name so many modes in a reason, those that moved most surely."""


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Track(Displayed):
    """One mode through the records.

    Attributes:
        number: from 0 by median frequency; the column "track" of `Tracks.modes`.
        frequency: (n_found,) [Hz].
        times: (n_found,) of the records in which it was found [s], or their numbers where they have no times.
        left: (n_found,) of ln f, less what the causes explain and the level before the first change, in the fit that
            gave the alarms their shifts.
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


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Alarm(Displayed):
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


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Tracks(Displayed):
    """The modes of many records, followed.

    Attributes:
        modes: pyarrow.Table, the rows of the table of modes with a column "track", -1 for a pole that belongs to none.
        tracks: by median frequency.
        alarms: by time.
        causes: what the frequencies were found to depend on, in words; empty where no cause was given or helps.
        clock: times are seconds; else numbers of records from 1, because they have no times of their own.
        records: names of all records, in their order.
        enough: there are enough records to tell a change from chance; no alarm says nothing where there are not.
        times: (n_seen,) of the records with poles, rising [s], or their numbers.
        measured: (n_seen,) of each cause that was given, by its name, at these times.
    """

    modes: Any
    tracks: tuple[Track, ...]
    alarms: tuple[Alarm, ...]
    causes: tuple[str, ...]
    clock: bool
    records: tuple[str, ...] = ()
    enough: bool = False
    times: FloatArray = field(default_factory=lambda: np.zeros(0))
    measured: Mapping[str, FloatArray] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Tracks({len(self.tracks)} modes in {self.modes.num_rows} poles, {len(self.alarms)} alarms)"


def track(batch_or_table: Any, *, causes: Mapping[str, npt.ArrayLike] | None = None) -> Tracks:
    """Follow every mode through many records; say what changed beyond what the causes and chance explain.

    Args:
        batch_or_table: of `modal.identify_batch`, or a table of modes (anything that pyarrow takes) with the columns
            record, start_time, frequency, verdict and shape.
        causes: what was measured besides, such as a temperature: a value a record, in the order of the records (of
            `Batch.records`, or as a table names them first); not looked at where a record has no mode.

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
    seen = np.unique(record)  # a record without a mode has no time either
    given = _given(causes or {}, names, seen)
    clock = bool(np.unique(starts[seen]).size == seen.size > 1)
    order = seen[np.argsort(starts[seen], kind="stable")] if clock else seen
    place = np.full(len(names), -1, dtype=np.intp)
    place[order] = np.arange(order.size)
    times: FloatArray = starts[order] if clock else order.astype(np.float64) + 1.0
    causes_in_order = {name: cause[order] for name, cause in given.items()}
    frequency = np.asarray(table.column("frequency").to_numpy(zero_copy_only=False), dtype=np.float64)
    verdict = np.asarray(table.column("verdict").to_pylist(), dtype=np.str_)
    owner = np.full(frequency.size, -1, dtype=np.intp)
    rows = np.flatnonzero((verdict != "noise") & np.isfinite(frequency) & (frequency > 0.0))
    rows = rows[np.argsort(place[record[rows]], kind="stable")]
    if not rows.size:
        modes = _with_tracks(table, owner)
        return Tracks(
            modes=modes,
            tracks=(),
            alarms=(),
            causes=(),
            clock=clock,
            records=tuple(names),
            times=times,
            measured=causes_in_order,
        )
    owner[rows] = followed(place[record[rows]], frequency[rows], _shapes(table)[rows], verdict[rows] == "doubtful")
    n_tracks = int(owner.max(initial=-1)) + 1
    values = np.full((order.size, n_tracks), np.nan)
    mine = owner >= 0
    values[place[record[mine]], owner[mine]] = np.log(frequency[mine])
    environment = explain(values, causes_in_order, times, clock=clock)
    changes, left = find_changes(values, environment.terms, times, clock=clock)
    if changes and environment.terms.size:  # a large step bends how the causes seem to be felt, and so hides itself
        environment = explain(_without(values, changes), causes_in_order, times, clock=clock)
        changes, left = find_changes(values, environment.terms, times, clock=clock)
    tracks = tuple(_track(k, values[:, k], times, left[:, k], environment.explained[k]) for k in range(n_tracks))
    return Tracks(
        modes=_with_tracks(table, owner),
        tracks=tracks,
        alarms=tuple(_alarm(change, tracks, times, given=bool(given)) for change in changes),
        causes=environment.names,
        enough=enough_records(times, clock=clock),
        clock=clock,
        records=tuple(names),
        times=times,
        measured=causes_in_order,
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
    import pyarrow as pa
    import pyarrow.compute as pc

    column = table.column("shape").combine_chunks()
    if pa.types.is_null(column.type):
        return np.empty((len(column), 0), dtype=np.complex128)
    counts = pc.fill_null(pc.list_value_length(column), 0).to_numpy()
    values = pc.list_flatten(column)
    if pa.types.is_struct(values.type):
        real, imag = (pc.struct_field(values, part).to_numpy(zero_copy_only=False) for part in ("real", "imag"))
        values = real + 1j * imag
    place = np.arange(counts.max(initial=0)) < counts[:, np.newaxis]
    shapes = np.full(place.shape, np.nan, dtype=np.complex128)
    shapes[place] = values
    return shapes


def _given(causes: Mapping[str, npt.ArrayLike], names: Sequence[str], seen: IndexArray) -> dict[str, FloatArray]:
    given = {}
    for name, values in causes.items():
        cause = np.array(values, dtype=np.float64)
        if cause.shape != (len(names),):
            raise InvalidDataError(
                f"the cause {name!r} has the shape {cause.shape}, but there are {len(names)} records; give one value a "
                "record, in their order."
            )
        lacking = [names[k] for k in seen if not np.isfinite(cause[k])]
        if lacking:
            raise InvalidDataError(
                f"the cause {name!r} is missing in {len(lacking)} of {len(seen)} records "
                f"({shorten(listed(lacking), 80)}); fill the gaps, or leave these records out."
            )
        given[name] = frozen(np.nan_to_num(cause), name=name, shape=(len(names),))
    return given


def _without(values: FloatArray, changes: Sequence[LevelChange]) -> FloatArray:
    """(n_records, n_modes) with every change taken off."""
    levels = values.copy()
    for change in changes:
        levels[change.since :] -= np.nan_to_num(change.steps)
    return levels


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
        left=left[found],
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


FAR = 6.0
"""Count a change of this many usual ones as one that chance does not make."""
SHAPE_MEMORY, FREQUENCY_MEMORY = 0.1, 0.4
"""Let a new record count so much in what is remembered of a mode: ten records of its shape, the last few of its
frequency, which temperature moves within hours."""
LEAST_SHARE = 0.01
"""Call no mode what is in less than this share of the records."""
LEAST_DENSITY = 0.25
"""Nor what is in less than this share of the records between its first and its last."""
LEAST_COUNT = 3
"""Nor what fewer records than these found, or called a mode of the system."""
UNKNOWN_SHAPE = 0.25
"""Take this loss of assurance where fewer than two outputs are shared: such a mode jumps by chance only."""


@dataclass(slots=True, eq=False)
class _Followed:
    """What is remembered of the modes so far, one entry each."""

    number: IndexArray
    frequency: FloatArray
    shape: ComplexArray
    last: IndexArray
    count: IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class _Poles:
    """Of one record, or of all: ln f, shapes with zero for what is not known, what is known, doubts."""

    log_frequency: FloatArray
    unit: ComplexArray
    known: BoolArray
    doubtful: BoolArray

    def rows(self, chosen: "IndexArray | slice") -> "_Poles":
        """Some of them."""
        return _Poles(self.log_frequency[chosen], self.unit[chosen], self.known[chosen], self.doubtful[chosen])


def followed(record: IndexArray, frequency: FloatArray, shapes: ComplexArray, doubtful: BoolArray) -> IndexArray:
    """(n_rows,) number of the mode that each pole belongs to, from 0 by frequency; -1 for none.

    Args:
        record: (n_rows,) number of the record in the order of time, not falling.
        frequency: (n_rows,) [Hz].
        shapes: (n_rows, n_outputs), nan where a record lacks the output.
        doubtful: (n_rows,) poles of less certainty.

    Example:
        >>> followed(np.array([0, 0, 1, 1, 2, 2]), np.array([1.0, 2.0, 1.01, 2.0, 1.0, 2.01]),
        ...        np.array([[1, 1], [1, -1], [1, 1], [1, -1], [1, 1], [1, -1]]), np.zeros(6, bool)).tolist()
        [0, 1, 0, 1, 0, 1]
    """
    known = ~np.isnan(shapes)
    poles = _Poles(np.log(frequency), np.where(known, shapes, 0.0), known, doubtful)
    edges = np.searchsorted(record, np.arange(record.max(initial=-1) + 2))
    usual = _usual_change(edges, poles)
    n_outputs = shapes.shape[1]
    empty = np.empty(0, dtype=np.intp)
    active = _Followed(
        number=empty,
        frequency=np.empty(0),
        shape=np.empty((0, n_outputs), dtype=np.complex128),
        last=empty,
        count=empty,
    )
    owner = np.full(record.size, -1, dtype=np.intp)
    n_modes = 0
    for k, (first, last) in enumerate(pairwise(edges)):
        rows = np.arange(first, last)
        here = poles.rows(rows)
        own = _assigned(active, here, usual)
        new = np.flatnonzero(own < 0)
        seen = np.flatnonzero(own >= 0)
        _remember(active, own[seen], here.rows(seen), k)
        owner[rows[seen]] = active.number[own[seen]]
        owner[rows[new]] = n_modes + np.arange(new.size)
        kept = (active.count >= LEAST_COUNT) | (k - active.last < 48)  # records
        active = _Followed(
            number=np.append(active.number[kept], owner[rows[new]]),
            frequency=np.append(active.frequency[kept], here.log_frequency[new]),
            shape=np.concatenate([active.shape[kept], _normalised(here.unit[new])]),
            last=np.append(active.last[kept], np.full(new.size, k)),
            count=np.append(active.count[kept], np.ones(new.size, dtype=np.intp)),
        )
        n_modes += new.size
    return _numbered(owner, record, frequency, doubtful, n_modes)


def _normalised(shapes: ComplexArray) -> ComplexArray:
    size = np.linalg.norm(shapes, axis=1, keepdims=True)
    return shapes / np.where(size > 0.0, size, 1.0)


def _loss(first: ComplexArray, second: ComplexArray, known: BoolArray) -> FloatArray:
    """(n_first, n_second) 1 - assurance over the outputs that the second has."""
    powers = (np.abs(first) ** 2 @ known.T) * (np.abs(second) ** 2).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = np.abs(first.conj() @ second.T) ** 2 / powers
    compared = (np.abs(first) > 0.0).astype(np.float64) @ known.T >= 2
    return np.where(compared & np.isfinite(alike), 1.0 - alike, UNKNOWN_SHAPE)


def _usual_change(edges: IndexArray, poles: _Poles) -> float:
    """Standard deviation of the change from a record to the next, among poles that choose each other."""
    changes = []
    for first, middle, last in zip(edges[:-2], edges[1:-1], edges[2:], strict=True):
        if middle in (first, last):
            continue
        one, other = poles.rows(slice(first, middle)), poles.rows(slice(middle, last))
        distance = np.abs(np.subtract.outer(one.log_frequency, other.log_frequency))
        cost = distance / POLE_SCALE + _loss(one.unit, other.unit, other.known) / SHAPE_SCALE
        best, back = cost.argmin(axis=1), cost.argmin(axis=0)
        mutual = np.flatnonzero(back[best] == np.arange(best.size))
        changes.append(distance[mutual, best[mutual]])
    middle_change = float(np.median(np.concatenate(changes))) if changes else 0.0
    return max(USUAL * middle_change, np.finfo(np.float64).eps)


def _assigned(active: _Followed, poles: _Poles, usual: float) -> IndexArray:
    """(n_rows,) index of the active mode that each pole continues, -1 for none."""
    own = np.full(poles.log_frequency.size, -1, dtype=np.intp)
    if not (active.number.size and own.size):
        return own
    distance = np.abs(np.subtract.outer(active.frequency, poles.log_frequency))
    cost = 0.5 * np.minimum(distance / (FAR * usual), 1.0) + distance / POLE_SCALE
    cost += _loss(active.shape, poles.unit, poles.known) / SHAPE_SCALE + DOUBT * poles.doubtful
    # a mode that was seen once only is a worse partner than one that is known
    cost += DOUBT * (active.count < LEAST_COUNT)[:, np.newaxis]
    capped = np.minimum(cost, TOO_FAR)
    for i, j in zip(*scipy.optimize.linear_sum_assignment(capped), strict=True):
        if capped[i, j] < TOO_FAR:
            own[j] = i
    return own


def _remember(active: _Followed, own: IndexArray, poles: _Poles, k: int) -> None:
    active.last[own] = k
    active.count[own] += 1
    share = np.maximum(FREQUENCY_MEMORY, 1.0 / active.count[own])
    active.frequency[own] += share * (poles.log_frequency - active.frequency[own])
    new = _normalised(poles.unit)
    old = active.shape[own]
    phase = np.einsum("ij,ij->i", new.conj(), old)
    new = new * (np.where(phase == 0, 1.0, phase) / np.where(phase == 0, 1.0, np.abs(phase)))[:, np.newaxis]
    part = np.maximum(SHAPE_MEMORY, 1.0 / active.count[own])[:, np.newaxis]
    active.shape[own] = np.where(poles.known, (1.0 - part) * old + part * new, old)


def _numbered(
    owner: IndexArray, record: IndexArray, frequency: FloatArray, doubtful: BoolArray, n_modes: int
) -> IndexArray:
    """The modes that last and that records were sure of, numbered by their median frequency."""
    n_records = int(record.max(initial=-1)) + 1
    several = min(LEAST_COUNT, n_records)
    least = max(several, LEAST_SHARE * n_records)
    count, sure = np.bincount(owner, minlength=n_modes), np.bincount(owner[~doubtful], minlength=n_modes)
    begins, ends = np.full(n_modes, n_records), np.full(n_modes, -1)
    np.minimum.at(begins, owner, record)
    np.maximum.at(ends, owner, record)
    dense = count >= LEAST_DENSITY * (ends - begins + 1)
    lasting = np.flatnonzero((count >= least) & (sure >= several) & dense)
    medians = [float(np.median(frequency[owner == number])) for number in lasting]
    final = np.full(n_modes, -1, dtype=np.intp)
    final[lasting[np.argsort(medians, kind="stable")]] = np.arange(lasting.size)
    numbered: IndexArray = final[owner]
    return numbered
