"""Blocks of a record that another program is still writing: rows appended to a text table or to a NumPy array.

Only whole lines are read, so a row that is half written waits for its end. Stamps in a time column tell where rows are
lost or a clock was set: there a block ends, and the next one says when it begins, which is all that
`modal.tracking.live` needs to take a gap for a gap.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from okid.arrays import FloatArray, time_step
from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers.dispatch import READERS
from okid.readers.guard import check_file, foreign
from okid.readers.table import Column, Table, to_record
from okid.readers.text import more_rows, read_text, table_of_text
from okid.readers.units import convert_unit
from okid.record import InputHold, Record

__all__ = ["growing_blocks"]

POLL = 0.02
"""Look into the file again after so many seconds: a tenth of what a reader notices."""
OFF_GRID = 0.5
"""End a block where a stamp is off the grid by so many time steps: a row is missing, or the clock was set."""
HEAD_BYTES = 1 << 16
"""Tell the layout of a text table from so many bytes of its beginning."""
FEWEST_ROWS = 20
"""Wait for so many rows before the layout and the time step are told."""


def growing_blocks(
    path: str | Path,
    *,
    inputs: Sequence[str] | str | None,
    outputs: Sequence[str] | str | None = None,
    dt: float | None = None,
    input_hold: InputHold = "band_limited",
    block: float,
    patience: float = 10.0,
    tell: Callable[[str], None] = lambda _text: None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[Record]:
    """Records of about `block` seconds each, in the order in which they are written, until the file stops growing.

    Args:
        path: CSV, TSV, TXT or another text table; or NPY, to which rows are appended behind its header.
        inputs: names of the channels that drive the system.
        outputs: names of the others; all others unless given.
        dt: time step [s]; unless given, the median step of the time column.
        input_hold: what the inputs did between samples.
        block: length of a block [s]; the last one may be shorter.
        patience: seconds without a new row after which the file counts as complete.
        tell: takes a sentence for each gap, each jump of the clock, and the end.
        stop: asked while waiting; True ends as if the file had stopped.

    Raises:
        UnreadableFileError: no such file, no table, or one that was cut shorter while it was read.
        InvalidDataError: no time column and no dt, or a channel that is not there.
    """
    path = Path(path)
    check_file(path)
    source = _Numpy(path) if path.suffix.lower() == ".npy" else _Text(path)
    table: Table | None = None
    held = np.empty((0, 0))
    end: float | None = None
    last, complete = time.monotonic(), False
    while not complete:
        fresh = source.rows()
        if len(fresh):
            last = time.monotonic()
            held = fresh if not held.size else np.vstack([held, fresh])
        complete = stop() or time.monotonic() - last > patience
        if table is None:
            if len(held) < FEWEST_ROWS and not complete:
                time.sleep(POLL)
                continue
            table = source.table(held)
            step = _step(table, held, dt)
            recorded = partial(to_record, kind=Record, inputs=inputs, outputs=outputs, dt=step, input_hold=input_hold)
        n_rows = max(1, round(block / step))
        while len(held) >= n_rows or (complete and len(held)):
            first = _unbroken(table, held[:n_rows], step)
            if end is not None:
                _tell_break(table, held, end, step, tell)
            record = _record(table, held[:first], recorded, 0.0 if end is None else end)
            held = held[first:]
            if record is not None:
                end = record.start_time + record.duration
                yield record
        if not len(fresh) and not complete:
            time.sleep(POLL)
    tell(
        f"{path.name} has not grown for {patience:.3g} s, so its end was taken for the end of the measurement; "
        "give a longer --patience if it may pause."
        if not stop()
        else f"stopped while {path.name} was growing."
    )


class _Text:
    """Whole lines of a text table, as they come."""

    def __init__(self, path: Path) -> None:
        if READERS.get(path.suffix.lower()) is not read_text:
            raise UnreadableFileError(
                f"{path.name} is of type {path.suffix or 'none'}, whose rows cannot be followed while it grows; write "
                "a text table (.csv, .txt, ...) or .npy."
            )
        self._path, self._at, self._head = path, 0, b""

    def rows(self) -> FloatArray:
        size = self._path.stat().st_size
        if size < self._at:
            raise UnreadableFileError(f"{self._path.name} became shorter while it was followed; start again.")
        with self._path.open("rb") as file:
            if not self._head:
                data = file.read()
                whole = data[: data.rfind(b"\n") + 1]
                if whole.count(b"\n") < FEWEST_ROWS:
                    return np.empty((0, 0))
                self._head, self._at = whole[: whole[:HEAD_BYTES].rfind(b"\n") + 1], len(whole)
                return np.array(self._parsed(whole).values)
            file.seek(self._at)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        if not whole.strip():
            return np.empty((0, 0))
        self._at += len(whole)
        return more_rows(whole, self._head, self._path)[:, : self._n_columns]

    def table(self, values: FloatArray) -> Table:
        return replace(self._table, values=values)

    def _parsed(self, whole: bytes) -> Table:
        self._table = table_of_text(whole, self._path)
        self._n_columns = len(self._table.columns)
        return self._table


class _Numpy:
    """Rows behind the header of an array, however many the header says that there are."""

    def __init__(self, path: Path) -> None:
        with foreign(path, ".npy file"), path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, by_columns, self._dtype = read(file)
            self._at = file.tell()
        if by_columns or len(shape) != 2 or self._dtype.kind not in "iuf":
            raise UnreadableFileError(
                f"{path.name} holds an array of {self._dtype} of shape {shape}; rows can be followed in an array of "
                "real numbers with a row a sample, in C order."
            )
        self._path, self._n_columns = path, shape[1]

    def rows(self) -> FloatArray:
        size = self._path.stat().st_size
        if size < self._at:
            raise UnreadableFileError(f"{self._path.name} became shorter while it was followed; start again.")
        width = self._n_columns * self._dtype.itemsize
        count = (size - self._at) // width
        if not count:
            return np.empty((0, 0))
        with self._path.open("rb") as file:
            file.seek(self._at)
            data = file.read(count * width)
        self._at += count * width
        return np.frombuffer(data, self._dtype).reshape(count, -1).astype(np.float64)

    def table(self, values: FloatArray) -> Table:
        columns = tuple(Column(name=f"column_{index}") for index in range(self._n_columns))
        return Table(path=self._path, format="NPY", columns=columns, values=values)


def _seconds(table: Table, values: FloatArray) -> FloatArray | None:
    """The stamps of rows [s]; None where there is no time column."""
    index = table.time_column()
    if index is None:
        return None
    column = table.columns[index]
    conversion = convert_unit("time", column.unit)
    stamps: FloatArray = values[:, index] * (conversion.factor if conversion.unit == "s" else 1.0)
    return stamps


def _step(table: Table, values: FloatArray, dt: float | None) -> float:
    stamps = _seconds(table, values)
    if dt is not None:
        return time_step(dt)
    if stamps is None:
        raise InvalidDataError(f"{table.path.name} has no time column, so the time step must be given: --dt SECONDS.")
    return time_step(float(np.median(np.diff(stamps))))


def _unbroken(table: Table, values: FloatArray, step: float) -> int:
    """Rows before the first that does not follow the one before it."""
    stamps = _seconds(table, values)
    if stamps is None or len(values) < 2:
        return len(values)
    off = np.abs(np.diff(stamps) - step) > OFF_GRID * step
    return int(np.argmax(off)) + 1 if off.any() else len(values)


def _tell_break(table: Table, values: FloatArray, end: float, step: float, tell: Callable[[str], None]) -> None:
    stamps = _seconds(table, values[:1])
    if stamps is None:
        return
    late = float(stamps[0]) - end
    if late > OFF_GRID * step:
        tell(f"{late:.4g} s are missing before {stamps[0]:.6g} s; rows after the gap look back to nothing before it.")
    elif late < -OFF_GRID * step:
        tell(f"the clock jumped back by {-late:.4g} s to {stamps[0]:.6g} s; a new window begins there.")


def _record(table: Table, values: FloatArray, to: Callable[[Table], Record], end: float) -> Record | None:
    """The record of unbroken rows; None where they are fewer than the channels."""
    if len(values) < len(table.columns):
        return None
    stamps = _seconds(table, values)
    without = table.time_column()
    kept = [k for k in range(len(table.columns)) if k != without]
    record = to(replace(table, columns=tuple(table.columns[k] for k in kept), values=values[:, kept]))
    return replace(record, start_time=end if stamps is None else float(stamps[0]))
