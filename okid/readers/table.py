"""What one file holds, before its columns are told apart into inputs and outputs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from okid.arrays import FloatArray

__all__ = ["Column", "LeftOut", "Table"]

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
    from okid.readers.units import convert_unit

    if not column.unit:
        return column.name != "T"
    return _plain(column.name) != "t" or convert_unit("time", column.unit).unit == "s"
