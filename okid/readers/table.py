"""What one file holds, before its columns are told apart into inputs and outputs.

Names and units out of column headers such as `tip [m/s^2]` or `Time (s)`.

The time step of a table: from its time column, from what the file states, or from the caller.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from okid.arrays import FloatArray
from okid.errors import InsufficientDataError, InvalidDataError
from okid.readers.units import convert_unit

__all__ = [
    "Column",
    "LeftOut",
    "Table",
    "looks_like_unit",
    "split_header",
    "stated_step",
    "table_time_step",
    "unique_names",
]

TIME_NAMES = frozenset(["time", "t", "timestamp", "time stamp", "elapsed time"])
COUNTER_NAMES = frozenset(["sample", "samples", "sample number", "index", "row", "no", "no.", "#"])


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column of a file: its name, its unit as written, and the header both were read from."""

    name: str
    unit: str = ""
    header: str = ""


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
        start_time: time of the first sample that the file states [s].
        inputs: names of the inputs if the file tells them apart, else None.
        outputs: likewise.
        left_out: what else the file holds.
    """

    path: Path
    format: str
    columns: tuple[Column, ...]
    values: FloatArray
    dt: float | None = None
    start_time: float = 0.0
    inputs: tuple[str, ...] | None = None
    outputs: tuple[str, ...] | None = None
    left_out: tuple[LeftOut, ...] = ()

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

        A column called time (or t, timestamp, elapsed time). A capital T may be a torque or a temperature: it is the
        time only if its unit says so, and a `t` with a unit that is none of time is not.
        """
        for index, column in enumerate(self.columns):
            if _plain(column.name) in TIME_NAMES and _may_be_time(column):
                return index
        return None

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
        """Indices of the columns that are channels: neither the time nor a sample counter."""
        no_channel = {self.time_column(), self.counter_column()}
        return [index for index in range(len(self.columns)) if index not in no_channel]


def _plain(name: str) -> str:
    return name.strip().lower().replace("_", " ")


def _may_be_time(column: Column) -> bool:

    if not column.unit:
        return column.name != "T"
    return _plain(column.name) != "t" or convert_unit("time", column.unit).unit == "s"


_BRACKET = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]\s*$", re.DOTALL)
_PARENTHESIS = re.compile(r"^(?P<name>.*?)\s*\((?P<unit>(?:[^()]|\([^()]*\))*)\)\s*$", re.DOTALL)
_COMMON_UNITS = frozenset(
    [
        *("s", "ms", "us", "µs", "μs", "min", "h", "sec", "msec"),
        *("m", "mm", "cm", "km", "um", "µm", "μm", "nm", "in", "inch", "ft"),
        *("g", "mg", "gn", "kg", "lb", "lbs", "G", "gal", "Gal"),
        *("N", "mN", "kN", "MN", "lbf", "kip", "Nm", "kNm", "N·m"),
        *("Pa", "kPa", "MPa", "GPa", "bar", "psi", "ksi"),
        *("V", "mV", "µV", "uV", "A", "mA", "W", "kW", "J", "kJ"),
        *("K", "°C", "°F", "degC", "degF", "rad", "mrad", "deg", "°", "rpm", "Hz", "kHz"),
        *("counts", "count", "raw", "digits", "lsb", "LSB", "-", "%", "a.u."),
    ]
)
"""What a pair of parentheses may hold to be read as a unit, alone or as products, quotients and powers."""

_SEPARATORS = re.compile(r"[/*·^ ()²³]+|-?\d")

MAX_NAME = 200


def split_header(header: str) -> tuple[str, str]:
    """Name and unit of a column header; the unit is "" if there is none.

    What stands in square brackets is a unit. What stands in parentheses is one only if it is made of common units, so
    that "tip (left)" stays a name.

    Example:
        >>> split_header("tip [m/s^2]"), split_header("Time (s)"), split_header("tip (left)")
        (('tip', 'm/s^2'), ('Time', 's'), ('tip (left)', ''))
    """
    header = "".join(letter if letter.isprintable() else " " for letter in header).strip()
    match = _BRACKET.match(header)
    if match and match["name"]:
        return match["name"][:MAX_NAME], match["unit"].strip()[:MAX_NAME]
    match = _PARENTHESIS.match(header)
    if match and match["name"] and looks_like_unit(match["unit"].strip()):
        return match["name"][:MAX_NAME], match["unit"].strip()
    return header[:MAX_NAME], ""


def looks_like_unit(text: str) -> bool:
    """True if `text` is a common unit, or a product, quotient or power of common units."""
    if text in _COMMON_UNITS:
        return True
    parts = [part for part in _SEPARATORS.split(text) if part]
    return bool(parts) and all(part in _COMMON_UNITS for part in parts)


def unique_names(names: Sequence[str], headers: Sequence[str]) -> list[str]:
    """The names; where several columns share one ("tip [m]", "tip [m/s^2]") their whole headers take its place.

    A column without a name is called "column_<index>".
    """
    count = Counter(names)
    return [
        (header.strip()[:MAX_NAME] if count[name] > 1 else name) or f"column_{index}"
        for index, (name, header) in enumerate(zip(names, headers, strict=True))
    ]


JITTER = 0.1
"""How far a sample may lie off the uniform grid, in time steps."""

SHORTEST, LONGEST = 1e-12, 1e9
"""Time steps [s] that an experiment can have; beyond them the arithmetic of frequencies overflows."""

CONTRADICTION = 1e-3
"""Relative difference above which a given time step contradicts that of the file."""


def table_time_step(table: Table, dt: float | None) -> tuple[float, float]:
    """Time step and time of the first sample [s].

    Args:
        table: the file's table.
        dt: time step that the caller gives [s]; None to take the file's.

    Raises:
        InvalidDataError: neither the file nor the caller gives a time step, the two contradict each other, or the time
            column is no uniform grid.
    """
    if dt is not None and not (np.isfinite(dt) and dt > 0):
        raise InvalidDataError(f"dt must be a positive time step in seconds, but is {dt}.")
    if dt is not None and not SHORTEST <= dt <= LONGEST:
        raise InvalidDataError(
            f"dt must be a time step between {SHORTEST:g} and {LONGEST:g} s, but is {dt:g}; count the time in another "
            "unit."
        )
    stated, start_time = stated_step(table)
    if stated is None:
        if dt is None:
            raise InvalidDataError(
                f"{table.path.name} has no time column (its columns are {_listed(table.names)}), so the time step must "
                "be given: pass dt in seconds (--dt)."
            )
        return float(dt), start_time
    if dt is None:
        return stated, start_time
    if abs(dt - stated) > CONTRADICTION * stated:
        raise InvalidDataError(
            f"dt = {dt:.6g} s was given, but the time axis of {table.path.name} has {stated:.6g} s, which is "
            f"{abs(dt / stated - 1):.2%} off; leave dt out, or correct the file."
        )
    return float(dt), start_time


def stated_step(table: Table) -> tuple[float | None, float]:
    """Time step (None if the file gives none) and time of the first sample [s]; as `table_time_step` raises."""
    index = table.time_column()
    if index is None:
        if table.dt is not None and not (np.isfinite(table.dt) and table.dt > 0):
            raise InvalidDataError(
                f"{table.path.name} states a time step of {table.dt} s, which is none; correct it in the file."
            )
        return table.dt, table.start_time
    column = table.columns[index]
    conversion = convert_unit("time", column.unit)
    if conversion.unit not in {"s", ""}:
        raise InvalidDataError(
            f"column {column.name!r} of {table.path.name} is in {column.unit!r}, which is no unit of time; correct its "
            "header, or rename it if it is a channel."
        )
    name = f"the time column {column.name!r} of {table.path.name}"
    step = _uniform_step(np.asarray(table.values[:, index]) * conversion.factor, name)
    if table.dt is not None and abs(step - table.dt) > CONTRADICTION * step:
        raise InvalidDataError(
            f"{name} has a step of {step:.6g} s, but the file states {table.dt:.6g} s; correct one of them."
        )
    return step, float(table.values[0, index]) * conversion.factor


def _uniform_step(time: FloatArray, name: str) -> float:
    """Mean step over the whole span, checked to be a uniform grid."""
    n_samples = len(time)
    if n_samples < 2:
        raise InsufficientDataError(f"{name} holds {n_samples} sample; a time step needs at least 2.")
    bad = ~np.isfinite(time)
    if bad.any():
        raise InvalidDataError(
            f"{name} is missing in {int(bad.sum())} of {n_samples} rows, the first of them row {int(bad.argmax()) + 1};"
            " every sample needs its time."
        )
    step = float(time[-1] - time[0]) / (n_samples - 1)
    back = np.diff(time) <= 0
    if step <= 0 or back.any():
        row = int(back.argmax()) + 1
        raise InvalidDataError(
            f"{name} must increase, but goes from {time[row - 1]:.9g} s to {time[row]:.9g} s at row {row + 1} of "
            f"{n_samples}; sort the rows, or cut the file into one file a record."
        )
    off = np.abs(time - time[0] - step * np.arange(n_samples)) / step
    worst = int(off.argmax())
    if off[worst] > JITTER:
        raise InvalidDataError(
            f"{name} is not uniform: with the mean step of {step:.6g} s, row {worst + 1} of {n_samples} lies "
            f"{off[worst]:.3g} steps off the grid (at most {JITTER} is allowed); resample the record to a uniform "
            "step, or, if samples were lost, put the lost rows back with empty cells."
        )
    return step


def _listed(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(names[:12]) + more
