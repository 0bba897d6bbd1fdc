"""What one file holds, before its columns are told apart into inputs and outputs.

The time step of a table is that of its time column, what the file states, or the caller's. From a table to a record:
which columns are inputs and outputs.
"""

import difflib
import functools
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from okid.arrays import FloatArray, column_block, row_chunks, time_step
from okid.errors import IdentificationWarning, InvalidDataError
from okid.readers.clock import JITTER, NAME, date_of_stamps, uniform_step
from okid.readers.units import MAX_NAME, PARENTHESIS, UnitConversion, convert_unit, in_si, one_time

TIME_NAMES = frozenset(
    [
        *("time", "t", "timestamp", "time stamp", "elapsed time", "relative time", "time axis", "x value"),
        *("sec", "secs", "second", "seconds", "zeit", "zeitstempel", "temps", "tiempo", "tempo", "tid", "tijd"),
        *("datetime", "date time", "elapsed", "clock time", "czas", "aika", "время", "時間", "时间"),
    ]
)
TIME_SUFFIX = re.compile(r"^(?P<name>.+?)[ ,;/]*(?:\bin )?\b(?P<unit>s|sec|ms|us|µs|ns|min|h)$")
"""Read the unit of a time column where it stands behind the name without brackets: `time_ms`, `Zeit in s`."""

_INNER_CAPITAL = re.compile(r"(?<=[Tt]ime|Zeit|temp)(?=[A-Z])")  # TimeUS, timeMs

TIME_WORDS = re.compile(
    r"(?<![a-z])(?:time|temps|tiempo|tempo|uptime|millis|micros|sec|date|datum)(?![a-z])|zeit", re.IGNORECASE
)
"""Take a uniform ramp with one of these in its name for the time."""

CLOCKS_OF_BOARDS = {"millis": "ms", "micros": "us"}
"""Read these names as microcontrollers do."""

COUNTER_NAMES = frozenset(["sample", "samples", "sample number", "index", "row", "no", "no.", "#"])


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column of a file: its name, its unit as written, and the header both were read from.

    The seconds of a time count from its origin [s], which counts from 1970 where the file states a date. Where the file
    states quantity and place of a sensor, they are `measured` ("acceleration at 12X+").
    """

    name: str
    unit: str = ""
    header: str = ""
    origin: float = 0.0
    measured: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """Something in a file that is no channel, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Table:
    """Named columns of numbers on one time axis.

    Args:
        path: the file.
        format: what it is, in words.
        columns: one a column of `values`, names unique.
        values: (n_samples, n_columns); NaN where a sample is missing; a view of the file if it is mapped.
        dt: time step that the file states [s]; None if it states none (a time column is a column).
        dt_within: how far that may be off [s].
        start_time: time of the first sample that the file states [s].
        steps: names under which the file states time steps, and these [s], where it may state several.
        inputs: names of the inputs if the file tells them apart, else None.
        outputs: likewise.
        left_out: what else the file holds.
        doubts: what is doubtful of its units, one sentence each, without a full stop.
        undecided: why what the file states of inputs is not taken, likewise; to be said where nobody names them.
    """

    path: Path
    format: str
    columns: tuple[Column, ...]
    values: FloatArray
    dt: float | None = None
    dt_within: float = 0.0
    start_time: float = 0.0
    steps: tuple[tuple[str, float], ...] = ()
    inputs: tuple[str, ...] | None = None
    outputs: tuple[str, ...] | None = None
    left_out: tuple[LeftOut, ...] = ()
    doubts: tuple[str, ...] = ()
    undecided: str = ""

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return len(self.values)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(column.name for column in self.columns)

    def time_column(self) -> int | None:
        """Index of the time column, None if there is none.

        A column called time, in the languages and habits of loggers (t, Zeit, Temps, X_Value, time_ms). A capital T may
        be a torque or a temperature: it is the time only if its unit says so, and a `t` with a unit that is none of
        time is not. Where none is called so, a uniform ramp in a unit of time, or with a word of time in its name
        (Messzeit, Temps relatif, millis), is it: no sensor measures one. A clock that was read is it in any case.
        """
        if NAME.decode() in self.names:
            return self.names.index(NAME.decode())
        for index, column in enumerate(self.columns):
            if _time_name(column)[0] in TIME_NAMES and _may_be_time(column):
                return index
        for index, column in enumerate(self.columns):
            if _speaks_of_time(column) and _is_ramp(self.values[:, index]):
                return index
        return None

    def further_times(self) -> list[int]:
        """Indices of columns that give the time once more, in another unit or rounded: they too grow by equal steps."""
        first = self.time_column()
        spoken = [k for k, one in enumerate(self.columns) if first not in (None, k) and _speaks_of_time(one)]
        ramps = [k for k in spoken if _is_ramp(self.values[:, k], CONTRADICTION)]
        clock = NAME.decode() in self.names  # of whole seconds, it may span much less
        return [k for k in ramps if clock or one_time(np.ptp(self.values[:, [first or 0, k]], axis=0), CONTRADICTION)]

    def counter_column(self) -> int | None:
        """Index of a column that only counts the samples (0, 1, 2, ... or 1, 2, 3, ...), None if there is none."""
        has_headers = any(column.header for column in self.columns)
        for index, column in enumerate(self.columns):
            unnamed = has_headers and not column.header  # the index that pandas writes
            if unnamed or _plain(column.name) in COUNTER_NAMES:
                values = self.values[:, index]
                if values[0] in (0.0, 1.0) and np.array_equal(values, values[0] + np.arange(len(values))):
                    return index
        return None

    def channels(self) -> list[int]:
        """Indices of the columns that are channels: neither a time nor a sample counter."""
        no_channel = {self.time_column(), self.counter_column(), *self.further_times()}
        return [index for index in range(len(self.columns)) if index not in no_channel]


def _plain(name: str) -> str:
    return name.strip().lower().replace("_", " ")


def _time_name(column: Column) -> tuple[str, str]:
    """Name of what may be a time column, and its unit, which may stand behind the name without brackets."""
    name = _plain(column.name)
    if name in CLOCKS_OF_BOARDS and not column.unit:
        return name, CLOCKS_OF_BOARDS[name]
    if not column.unit:
        name = _plain(_INNER_CAPITAL.sub(" ", column.name))
    behind = None if column.unit or name in TIME_NAMES else TIME_SUFFIX.match(name)
    return (behind["name"].rstrip(" ,;/"), behind["unit"]) if behind else (name, column.unit.lower())  # TIME [S]


def _speaks_of_time(column: Column) -> bool:
    if column.unit:
        return _counts_time(column.unit)
    named = _time_name(column)[0] in TIME_NAMES and _may_be_time(column)
    return named or TIME_WORDS.search(column.name) is not None


def _is_ramp(values: FloatArray, share: float = 0.0) -> bool:
    """True for a grid that grows by equal steps, to the jitter of a clock or a share of the span."""
    count = len(values) - 1
    span = values[-1] - values[0] if count > 0 else 0.0
    if not np.isfinite(span) or span <= 0:
        return False
    with np.errstate(all="ignore"):
        return bool(
            np.abs((values - values[0]) / span * count - np.arange(count + 1)).max() <= max(JITTER, share * count)
        )


def _may_be_time(column: Column) -> bool:
    if not column.unit:
        return column.name != "T"
    return _plain(column.name) != "t" or _counts_time(column.unit.lower())


@functools.cache
def _counts_time(unit: str) -> bool:
    return convert_unit("time", unit).unit == "s"


def unique_names(names: Sequence[str], headers: Sequence[str]) -> list[str]:
    """The names; where several columns share one ("tip [m]", "tip [m/s^2]") their whole headers take its place.

    A column without a name is called "column_<index>".
    """
    count = Counter(names)
    return [
        (header.strip()[:MAX_NAME] if count[name] > 1 else name) or f"column_{index}"
        for index, (name, header) in enumerate(zip(names, headers, strict=True))
    ]


FEWEST_OF_A_RAMP = 10
"""Take no shorter column for a time by its numbers alone."""

DOUBTED = 1e-4
"""Warn where rounded times tell the time step no better than this: a clear mode's frequency is known as well."""

CONTRADICTION = 1e-3
"""Relative difference above which a given time step contradicts that of the file."""


def table_time_step(table: Table, dt: float | None) -> tuple[float, float]:
    """Time step and time of the first sample [s].

    Args:
        table: the file's table.
        dt: time step that the caller gives [s]; None to take the file's.

    Raises:
        InvalidDataError: the caller gives no time step, and the file has none or a time column that is no uniform grid.

    Warns:
        IdentificationWarning: the two contradict each other; the caller's is used.
    """
    if dt is not None:
        dt = time_step(dt)
    try:
        stated, start_time, within = stated_step(table)
    except InvalidDataError:
        if dt is None:
            raise
        return dt, 0.0  # what the caller knows of the time wins over stamps that are no grid
    if stated is None:
        if dt is None:
            raise InvalidDataError(
                f"{table.path.name} has no time column (its columns are {_listed(table.names)}"
                + "".join(f"; {left.name!r} was left out: {left.reason}" for left in table.left_out[:3])
                + "), so the time step must be given: pass dt in seconds (--dt)."
            )
        return float(dt), start_time
    if dt is None:
        _check_whole_stamps(table)
        if within > DOUBTED * stated:
            warnings.warn(
                f"the times of {table.path.name} are rounded, so its time step of {stated:.7g} s and with it every "
                f"frequency is known to {within / stated:.2%} only; give the time step (--dt) if you know it better.",
                IdentificationWarning,
                stacklevel=3,
            )
        return stated, start_time
    if abs(dt - stated) > CONTRADICTION * stated:
        warnings.warn(
            f"dt = {dt:.6g} s was given and is used, but the time axis of {table.path.name} has {stated:.6g} s, which "
            f"is {abs(dt / stated - 1):.2%} off; leave dt out to use the file's.",
            IdentificationWarning,
            stacklevel=3,
        )
    return float(dt), start_time


def stated_step(table: Table) -> tuple[float | None, float, float]:
    """Time step (None if the file gives none), time of the first sample, and how far the step may be off [s].

    Raises:
        InvalidDataError: as `table_time_step` says.
    """
    index = table.time_column()
    several = [step for _, step in table.steps if step > 0]
    if several and max(several) - min(several) > CONTRADICTION * min(several):
        said = ", ".join(f"{name} says {step:.6g} s" for name, step in table.steps)
        raise InvalidDataError(
            f"{table.path.name} states more than one time step ({said}); keep the right one, or give it (--dt)."
        )
    if index is None:
        if table.dt is not None and not (np.isfinite(table.dt) and table.dt > 0):
            raise InvalidDataError(
                f"{table.path.name} states a time step of {table.dt} s, which is none; correct it in the file."
            )
        return table.dt, table.start_time, table.dt_within
    column = table.columns[index]
    conversion = convert_unit("time", _time_name(column)[1])
    if conversion.unit not in {"s", ""}:
        raise InvalidDataError(
            f"column {column.name!r} of {table.path.name} is in {column.unit!r}, which is no unit of time; correct its "
            "header, or rename it if it is a channel."
        )
    stamps = np.asarray(table.values[:, index])
    factor, since = (conversion.factor, 0.0) if conversion.unit else date_of_stamps(stamps, column.name)
    name = f"the time column {column.name!r} of {table.path.name}"
    with np.errstate(all="ignore"):  # what is not finite is refused
        step, within = uniform_step(stamps, factor, name)
    if table.dt is not None and abs(step - table.dt) > CONTRADICTION * step:
        raise InvalidDataError(
            f"{name} has a step of {step:.6g} s, but the file states {table.dt:.6g} s; correct one of them."
        )
    return step, column.origin + (float(stamps[0]) - since) * factor, within


def _are_whole(stamps: FloatArray) -> bool:
    """True for whole numbers, also where a product of floats missed them by its last bits."""
    return bool(np.abs(stamps - np.rint(stamps)).max() <= 4.0 * np.spacing(np.abs(stamps).max()))


def _check_whole_stamps(table: Table) -> None:
    """Warn where whole numbers taken for seconds may count milliseconds, or give dates as such under another header."""
    index = table.time_column()
    if index is None:
        return
    column, stamps = table.columns[index], np.asarray(table.values[:, index])
    unit, name = _time_name(column)[1], _plain(column.name)
    conversion = convert_unit("time", unit)
    if (conversion.factor if conversion.unit else 1.0) != 1.0 or not _are_whole(stamps):
        return
    date = date_of_stamps(stamps, name)[0]
    known = date >= 1.0 if unit else name.startswith("sec") or date != 1.0
    if known or stamps[-1] - stamps[0] < len(stamps) - 1:
        return
    said = f"is in {unit}" if unit else "has no unit"
    if date < 1.0:
        meant = {1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}[date]
        doubt = f"but as seconds its numbers give no date of this century, as {meant} since 1970 they do"
    else:
        doubt = "and counts in whole numbers, which were taken for seconds"
    warnings.warn(
        f"the time column {column.name!r} of {table.path.name} {said} {doubt}; write the unit into its header, as in "
        "'time [ms]', or give the time step (--dt).",
        IdentificationWarning,
        stacklevel=4,
    )


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(names[:12]) + more


def _channels_of(table: Table) -> str:
    return _listed([table.columns[index].name for index in table.channels()]) or "none"


R = TypeVar("R")
Names = Sequence[str] | str | None


def as_names(names: Names) -> list[str] | None:
    """A list of names; a single name is a list of one, None stays None.

    Raises:
        InvalidDataError: something else than names.
    """
    given: Any = names  # a caller may hand on anything
    if given is None or isinstance(given, str):
        return None if given is None else [given]
    listed = list(given) if isinstance(given, Iterable) else [given]
    for name in listed:
        if not isinstance(name, str):
            raise InvalidDataError(
                f"the name of a channel must be a text, but is {name!r}; give it as the file has it."
            )
    return listed


def spread_names(tables: Sequence[Table], names: Names, *, but: Sequence[str] = ()) -> list[str] | None:
    """The channels that names stand for, in the order in which the tables have them; None stays None.

    A name stands for the channel that is called so, else for the columns of a matrix that is ("u" for u_0 and u_1),
    else, with `*` for any letters and `?` for one, for every channel that fits ("force p*") and is none of `but`. What
    stands for several gives none twice. What stands for none is kept: the message that it is missing names it.
    """
    listed = as_names(names)
    if listed is None:
        return None
    spread: list[str] = []
    of_several: set[str] = set()
    for name in listed:
        if any(name in table.names for table in tables):
            spread += [] if name in of_several else [name]
            continue
        columns = [table.columns[index] for table in tables for index in table.channels()]
        found, left = [column.name for column in columns if column.header == name], frozenset(spread)
        if not found and set(name) & set("*?"):
            pattern = re.compile(re.escape(name).replace(r"\*", ".*").replace(r"\?", "."), re.DOTALL)
            found, left = [column.name for column in columns if pattern.fullmatch(column.name)], left.union(but)
        of_several |= set(found)
        spread += [each for each in dict.fromkeys(found or [name]) if each not in left]
    return spread


def spread_roles(tables: Sequence[Table], inputs: Names, outputs: Names) -> tuple[list[str] | None, list[str] | None]:
    """The channels that the names of inputs and outputs stand for; a pattern of outputs leaves out the inputs."""
    into = spread_names(tables, inputs)
    return into, spread_names(tables, outputs, but=into or ())


def chosen_names(table: Table, inputs: Names, outputs: Names) -> tuple[list[str], list[str]]:
    """Names of the inputs and outputs, as `choose_channels` decides, not yet looked up."""
    into, out = spread_roles([table], inputs, outputs)
    if into is None and out is None and table.outputs is not None:
        return list(table.inputs or ()), list(table.outputs)
    into = into or []
    if out is None:
        taken = {index for name in into if (index := _find(table, name)) is not None}
        out = [table.columns[index].name for index in table.channels() if index not in taken]
    return into, out


def choose_channels(table: Table, inputs: Names, outputs: Names) -> tuple[list[int], list[int]]:
    """Column indices of the inputs and of the outputs, in the order of the names.

    Inputs and outputs given: these. Inputs alone: every other channel is an output. Outputs alone: no inputs. Neither:
    what the file itself states, else every channel is an output. The time column and a sample counter are no channels.

    Raises:
        InvalidDataError: no such channel, one that is both input and output or named twice, or no output left.
    """
    into, out = chosen_names(table, inputs, outputs)
    _check_once(into, out)
    indices = _indices(table, into), _indices(table, out)
    if not table.channels():
        left = [f"{left.name!r} was left out: {left.reason}" for left in table.left_out[:3]]
        why = left or ["save each channel as a column of numbers beside the time"]
        raise InvalidDataError(
            f"{table.path.name} holds {', '.join(table.names[:3])} but no channel; {'; '.join(why)}."
        )
    if not indices[1]:
        raise InvalidDataError(
            f"no output is left in {table.path.name}: its channels are {_channels_of(table)}, and all of them are "
            'inputs; name at least one output, or all (outputs="*", --outputs "*").'
        )
    return indices


def _check_once(into: list[str], out: list[str]) -> None:
    both = sorted(set(into) & set(out))
    if both:
        raise InvalidDataError(f"{', '.join(map(repr, both))} cannot be both input and output; name each channel once.")
    double = sorted(name for name, count in Counter(into + out).items() if count > 1)
    if double:
        raise InvalidDataError(f"channel {', '.join(map(repr, double))} is named more than once; name each once.")


def _find(table: Table, name: str) -> int | None:
    """A column by its name, or by its whole header."""
    for index, column in enumerate(table.columns):
        if name in {column.name, column.header}:
            return index
    return None


def _indices(table: Table, names: Sequence[str]) -> list[int]:
    places = {column.header: index for index, column in enumerate(table.columns)}
    places |= {column.name: index for index, column in enumerate(table.columns)}
    channels = set(table.channels())
    for name in names:
        if places.get(name) not in channels:
            _refuse(table, name, places.get(name))
    return [places[name] for name in names]


def _refuse(table: Table, name: str, index: int | None) -> NoReturn:
    if index is not None:
        what = "a counter of the samples" if index == table.counter_column() else "a time axis"
        raise InvalidDataError(
            f"column {name!r} of {table.path.name} is {what}, not a channel; the channels are {_channels_of(table)}."
        )
    for left in table.left_out:
        if left.name == name:
            raise InvalidDataError(f"{name!r} of {table.path.name} cannot be a channel: {left.reason}.")
    names = [table.columns[each].name for each in table.channels()]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    folded = [each for each in names if each.lower() == name.lower()]
    guess = f"did you mean {(folded or close)[0]!r}? Its" if folded or close else "its"
    raise InvalidDataError(
        f"there is no channel {name!r} in {table.path.name}; {guess} channels are {_channels_of(table)}."
    )


def to_record(
    table: Table,
    kind: Callable[..., R],
    *,
    inputs: Sequence[str] | str | None,
    outputs: Sequence[str] | str | None,
    dt: float | None,
    input_hold: str,
) -> R:
    """The record that the chosen channels of a table make up, in SI.

    Args:
        table: of a file or a data frame.
        kind: `Record`; it is passed, because records can be made of data frames and this file must not know them.
        inputs: names, None as `choose_channels` says.
        outputs: likewise.
        dt: time step [s], None to take that of the table.
        input_hold: what the inputs did between samples.

    Raises:
        InvalidDataError: as `choose_channels`, `table_time_step` and `Record` say, with the file's name before it.
    """
    into, out = choose_channels(table, inputs, outputs)
    _check_orientation(table, into, out)
    _refuse_doubled_rows(table)
    step, start_time = table_time_step(table, dt)
    if outputs is None:
        _warn_of_times(table, [*into, *out], step)
    input_units = [conversion_of(table, index) for index in into]
    output_units = [conversion_of(table, index) for index in out]
    try:
        return kind(
            in_si(column_block(table.values, into), input_units),
            in_si(column_block(table.values, out), output_units),
            step,
            input_names=tuple(unit.channel for unit in input_units),
            output_names=tuple(unit.channel for unit in output_units),
            input_units=tuple(unit.unit for unit in input_units),
            output_units=tuple(unit.unit for unit in output_units),
            input_hold=input_hold,
            name=table.path.stem,
            start_time=start_time,
        )
    except InvalidDataError as error:
        raise type(error)(f"{table.path.name}: {error}") from error


def _warn_of_times(table: Table, channels: Sequence[int], dt: float) -> None:
    """Warn of channels that nobody named and that grow by the given time step from row to row: they are the time."""
    if table.time_column() is not None or table.n_samples < FEWEST_OF_A_RAMP:
        return
    for index in channels:
        values = np.asarray(table.values[:, index])
        step = (values[-1] - values[0]) / (table.n_samples - 1)
        if abs(step - dt) <= CONTRADICTION * dt and _is_ramp(values):
            warnings.warn(
                f"channel {table.columns[index].name!r} of {table.path.name} grows by the time step from row to row, "
                "so it is the time and no channel; call it time in the file, or name the outputs (--outputs).",
                IdentificationWarning,
                stacklevel=4,
            )


def _check_orientation(table: Table, into: Sequence[int], out: Sequence[int]) -> None:
    """Refuse more channels than samples here, where the remedy is to save the file otherwise."""
    for kind, indices in (("inputs", into), ("outputs", out)):
        if len(indices) > table.n_samples:
            raise InvalidDataError(
                f"{table.path.name} holds {len(indices)} {kind} but only {table.n_samples} samples; rows must be "
                f"samples and columns channels, so save its transpose, or name fewer {kind}."
            )


def _refuse_doubled_rows(table: Table) -> None:
    """Raise where most times come again, and whole rows with them: rounded times alone would only seem finer."""
    values, index = table.values, table.time_column()
    if index is None:
        return
    again = np.flatnonzero(values[1:, index] == values[:-1, index])
    if 2 * len(again) < max(table.n_samples - 1, 2):
        return
    parts = (again[rows] for rows in row_chunks(len(again), values.shape[1]))
    if all(np.array_equal(values[part], values[part + 1], equal_nan=True) for part in parts):
        raise InvalidDataError(
            f"{len(again)} of the {table.n_samples} rows of {table.path.name} repeat the row before them, time and all;"
            " keep each row once."
        )


def conversion_of(table: Table, index: int) -> UnitConversion:
    """What becomes of a column's unit; where most names end in a unit in parentheses, another such end is spoken of."""
    column = table.columns[index]
    conversion = convert_unit(column.name, column.unit)
    inside = PARENTHESIS.match(column.name)
    if column.unit or conversion.note or not inside or not inside["name"]:
        return conversion
    ends = [each for each in table.columns if PARENTHESIS.match(each.header)]
    if 2 * sum(bool(each.unit) for each in ends) <= len(ends):
        return conversion
    note = f"{inside['unit']!r} is no unit that is known; if it is the unit, the values are kept as they are"
    return replace(conversion, note=note)
