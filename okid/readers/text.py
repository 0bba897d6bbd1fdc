"""Text tables: CSV, TSV and whatever else programs write as rows of numbers.

The layout is found from the first megabyte; the numbers are then read by pyarrow, in several threads. Only where that
fails is the text looked through line by line, to say which cell is at fault.

Where no column of numbers is the time, a column of stamps of a clock is it whatever its header says (Datum, Date/Time,
Uhrzeit), and so are a column of dates and one of a clock beside it (`okid.readers.clock`); else stamps are text.
"""

import codecs
import contextlib
import functools
import io
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from okid.arrays import FloatArray
from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers.clock import HEAD_BYTES, NAME, Clock, find_clock, may_hold_stamps
from okid.readers.guard import check_channel_count, check_memory, first_line
from okid.readers.layout import (
    DIALECTS,
    MISSING,
    OTHERWISE,
    Dialect,
    TextLayout,
    TextLimits,
    find_layout,
    is_missing,
    is_number,
    split_cells,
)
from okid.readers.table import Column, LeftOut, Table, stated_step, unique_names
from okid.readers.units import split_header

COPIES_OF_TEXT, COPIES_OF_TABLE = 3.0, 1.25
"""Expect so many: of a text that is changed before it is read, and of the table of float64 while it is put together."""

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_BLANKS = re.compile(rb"[ \t]+")
_LINE_ENDS = re.compile(rb"^ | (?=[\r\n]|\Z)", re.MULTILINE)


def read_text(path: Path) -> Table:
    """The table of a text file: delimiter, decimal sign, header and units are found.

    Raises:
        UnreadableFileError: binary data, rows of different lengths, or text where a number is expected.
    """
    with path.open("rb") as file:
        head = file.read(TextLimits.SAMPLE_BYTES)
    if head.startswith(_UTF16):
        check_memory(path, COPIES_OF_TEXT * path.stat().st_size)
        text = _decoded(path.read_bytes(), "utf-16", path)
        data = io.BytesIO(text.encode())
        head = data.getbuffer()[: TextLimits.SAMPLE_BYTES].tobytes()
        return _read(data, head, path)
    if b"\0" in head:
        raise UnreadableFileError(
            f"{path.name} holds binary data, not text; give it the extension of its format, or export it as CSV."
        )
    with path.open("rb") as file:
        return _read(file, head, path)


def _read(file: BinaryIO, head: bytes, path: Path) -> Table:
    size = file.seek(0, io.SEEK_END)
    with _dates_of(path):
        clock = _clock_of(head, path)
        if clock is not None:
            check_memory(path, COPIES_OF_TEXT * size)
            file.seek(0)
            data = clock.seconds(file.read())
    if clock is None:
        return _read_cells(file, head, path)
    return _with_time(_read_cells(io.BytesIO(data), data[: TextLimits.SAMPLE_BYTES], path), clock)


def _clock_of(head: bytes, path: Path) -> Clock | None:
    """The clock of a table none of whose columns of numbers is a time with a uniform grid."""
    lines = head[: max(head.rfind(end, 0, HEAD_BYTES) for end in (b"\n", b"\r")) + 1]
    if may_hold_stamps(head):
        with contextlib.suppress(InvalidDataError):
            if stated_step(_read_cells(io.BytesIO(lines), lines, path))[0] is not None:
                return None
    return find_clock(head)


def _with_time(table: Table, clock: Clock) -> Table:
    """The table whose time says what it counts from; it has a name where the file has no header."""
    name = NAME.decode()
    index = table.names.index(name) if name in table.names else clock.n_before
    header = f"{name} [s]" if any(column.header for column in table.columns) else ""
    time = Column(name=name, unit="s", header=header, origin=float(clock.origin))
    return replace(table, columns=(*table.columns[:index], time, *table.columns[index + 1 :]))


@contextlib.contextmanager
def _dates_of(path: Path) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise UnreadableFileError(f"a time stamp in {path.name} is no date ({error}); correct it.") from error


def _read_cells(file: BinaryIO, head: bytes, path: Path) -> Table:
    size = file.seek(0, io.SEEK_END)
    try:
        return _read_numbers(file, head, path)
    except UnreadableFileError:
        check_memory(path, COPIES_OF_TEXT * size)
        file = io.BytesIO(file.getvalue()) if isinstance(file, io.BytesIO) else path.open("rb")
        with file:
            whole = file.read()
        if (text := _text_columns(head)) is None:
            raise
    blanked = _without(whole, *text, path.name)
    table = _read_numbers(io.BytesIO(blanked), blanked[: TextLimits.SAMPLE_BYTES], path)
    left = [LeftOut(name=table.columns[k].name, reason="it holds text") for k in text[1] if k < len(table.columns)]
    keep = [k for k in range(len(table.columns)) if k not in text[1]]
    columns = tuple(table.columns[k] for k in keep)
    return replace(table, columns=columns, values=table.values[:, keep], left_out=tuple(left))


def _text_columns(head: bytes) -> tuple[Dialect, tuple[int, ...]] | None:
    """Columns of text in rows that hold numbers otherwise (messages, labels), and the dialect under which they are so.

    A column that holds a number anywhere in the sample is none: a text in it is a damaged cell. Nor is one that mostly
    holds numbers written otherwise, with a unit or signs of thousands: they were measured.
    """
    lines = [_line(raw) for raw in head.splitlines()[:-1]]
    for dialect in DIALECTS[:5]:
        rows = [split_cells(line, dialect) for line in lines]
        width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
        first = next((k for k, row in enumerate(rows) if any(is_number(cell, dialect) for cell in row)), 0)
        named = [row for row in rows[:first] if any(row)]
        rows = [row for row in rows if len(row) == width]
        if not named or len(named[-1]) != width:
            continue
        holds = [any(is_number(row[k], dialect) for row in rows) for k in range(width)]
        numbers = [k for k in range(width) if holds[k]]
        full = [row for row in rows if all(is_number(row[k], dialect) or is_missing(row[k]) for k in numbers)]
        full = [row for row in full if any(is_number(row[k], dialect) for k in numbers)]
        text = tuple(k for k in range(width) if not holds[k] and any(not is_missing(row[k]) for row in full))
        cells = [[row[k] for row in full if not is_missing(row[k])] for k in text]
        measured = any(2 * sum(map(bool, map(OTHERWISE.fullmatch, column))) > len(column) for column in cells)
        if text and numbers and not measured and len(full) >= len(rows) - 4:  # lines of names and units
            return dialect, text
    return None


def _without(data: bytes, dialect: Dialect, columns: tuple[int, ...], file_name: str) -> bytes:
    """The lines with these columns left empty in every row of numbers; refused where one holds numbers further on."""
    out = []
    for number, raw in enumerate(data.splitlines(keepends=True), start=1):
        cells = split_cells(_line(raw), dialect)
        if any(is_number(cell, dialect) for cell in cells) and len(cells) > max(columns):
            for k in columns:
                if is_number(cells[k], dialect):
                    raise UnreadableFileError(
                        f"column {k + 1} of {file_name} begins with text, but holds the number {cells[k][:40]!r} in "
                        f"line {number}; leave the cells of text empty if samples are missing, or take the column out."
                    )
                cells[k] = ""
            out.append(dialect.delimiter.join(cells).encode() + b"\n")
        else:
            out.append(raw)
    return b"".join(out)


def _read_numbers(file: BinaryIO, head: bytes, path: Path) -> Table:
    size = file.seek(0, io.SEEK_END)
    raw_lines = head.splitlines(keepends=True)
    if len(head) == TextLimits.SAMPLE_BYTES:
        if len(raw_lines) == 1:
            raise UnreadableFileError(
                f"the first line of {path.name} is longer than {TextLimits.SAMPLE_BYTES} bytes; a record is a table, "
                "one row a sample."
            )
        raw_lines.pop()  # cut off in its middle
    lines = [_line(raw) for raw in raw_lines]
    layout = find_layout(lines, file_name=path.name)
    check_channel_count(path, layout.n_columns)
    headers = layout.headers or ("",) * layout.n_columns
    split = [split_header(header) for header in headers]
    names = unique_names([name for name, _ in split], headers)
    rows = raw_lines[layout.first_line :]
    text = COPIES_OF_TEXT * size if layout.dialect.delimiter == " " else 0.0
    table = size / max(1, sum(map(len, rows))) * len(rows) * layout.n_columns * np.dtype(float).itemsize
    check_memory(path, text + COPIES_OF_TABLE * table)
    n_empty = _empty_at_end(file, layout.dialect.delimiter.encode())
    file.seek(sum(map(len, raw_lines[: layout.first_line])))
    values = _numbers(file, layout, names, path)
    while n_empty and len(values) > 1 and np.isnan(values[-1]).all():
        values, n_empty = values[:-1], n_empty - 1
    columns = [
        Column(name=name, unit=unit, header=header)
        for name, (_, unit), header in zip(names, split, headers, strict=True)
    ]
    if layout.headers and not headers[-1] and not np.isnan(values[:, -1]).all():
        raise UnreadableFileError(
            f"{path.name} names {layout.n_columns - 1} columns, but its rows hold {layout.n_columns} numbers, so a "
            "name may stand over the wrong column; give every column a name, the first one too."
        )
    if layout.headers:  # a column without a name that holds nothing: rows end with delimiters, or a sheet has a gap
        keep = [k for k, header in enumerate(headers) if header or not np.isnan(values[:, k]).all()]
        if len(keep) < len(headers):
            columns, values = [columns[k] for k in keep], values[:, keep]
    return Table(path=path, format="text table", columns=tuple(columns), values=values, doubts=layout.doubts)


def _empty_at_end(file: BinaryIO, delimiter: bytes) -> int:
    """How many lines of empty cells end the file: a sheet is saved with lines of delimiters below its table."""
    empty = re.compile(rb'[%s\s"]*' % re.escape(delimiter))
    size, width = file.seek(0, io.SEEK_END), TextLimits.TAIL_BYTES
    while True:
        file.seek(max(0, size - width))
        lines = file.read().splitlines()
        found = list(itertools.takewhile(empty.fullmatch, reversed(lines)))
        if len(found) < len(lines) or width >= size:
            return sum(bool(line.strip() if delimiter == b" " else line) for line in found)  # nothing at all is no row
        width *= 8


def table_of_text(data: bytes, path: Path) -> Table:
    """The table of whole lines that were read from a file already; errors as in `read_text`."""
    return _read(io.BytesIO(data), data[: TextLimits.SAMPLE_BYTES], path)


def more_rows(data: bytes, head: bytes, path: Path, *, n_lines: int) -> FloatArray:
    """The numbers of lines that were appended to a text table, laid out as its first lines are.

    Args:
        data: whole lines.
        head: the first lines of the file.
        path: of the file, for messages.
        n_lines: that stand before them in the file, for messages.
    """
    with _dates_of(path):
        clock = _clock_of(head, path)
        if clock is not None:
            data, head = clock.seconds(data, goes_on=True), clock.seconds(head)
    text: tuple[int, ...] = ()
    try:
        layout = _layout_of(head, path.name)
    except UnreadableFileError:
        if (found := _text_columns(head)) is None:
            raise
        text = found[1]
        data, head = _without(data, *found, path.name), _without(head, *found, path.name)
        layout = _layout_of(head, path.name)
    names = [split_header(header)[0] for header in layout.headers] or [str(k) for k in range(layout.n_columns)]
    return np.delete(_numbers(io.BytesIO(data), replace(layout, first_line=n_lines), names, path), text, axis=1)


@functools.lru_cache(maxsize=8)  # of files that grow: their first lines are asked about with each piece
def _layout_of(head: bytes, file_name: str) -> TextLayout:
    return find_layout([_line(raw) for raw in head.splitlines(keepends=True)], file_name=file_name)


def _numbers(file: BinaryIO, layout: TextLayout, names: list[str], path: Path) -> FloatArray:
    import pyarrow as pa
    from pyarrow import csv

    start = file.tell()
    source: Any = file
    if (delimiter := layout.dialect.delimiter) == " ":
        source = io.BytesIO(_LINE_ENDS.sub(b"", _BLANKS.sub(b" ", file.read())))
    keys = [str(index) for index in range(layout.n_columns)]
    blanks = [" " * width for width in range(1, 33)]
    parts: list[FloatArray] = []
    try:
        with csv.open_csv(
            source,
            read_options=csv.ReadOptions(column_names=keys, block_size=TextLimits.BLOCK_BYTES),
            parse_options=csv.ParseOptions(delimiter=delimiter),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(keys, pa.float64()),
                null_values=[*MISSING, *blanks],
                quoted_strings_can_be_null=True,
                decimal_point=layout.dialect.decimal,
            ),
        ) as reader:
            parts.extend(
                np.column_stack([column.to_numpy(zero_copy_only=False) for column in batch.columns]) for batch in reader
            )
    except (pa.ArrowException, ValueError) as error:
        # pyarrow may still be reading ahead in this very file
        with io.BytesIO(file.getvalue()) if isinstance(file, io.BytesIO) else path.open("rb") as again:
            again.seek(start)
            bytewise = io.TextIOWrapper(again, encoding="latin-1")  # each line by itself says how it is written
            _raise_fault((_line(line.encode("latin-1")) for line in bytewise), layout, names, path)
        raise UnreadableFileError(f"{path.name} cannot be read as a table of numbers ({first_line(error)}).") from error
    values = np.empty((sum(len(part) for part in parts), layout.n_columns))
    last = len(values)
    while parts:  # each is let go once it is copied, so that the table never stands twice
        part = parts.pop()
        values[last - len(part) : last] = part
        last -= len(part)
    return values


def _raise_fault(lines: Iterable[str], layout: TextLayout, names: list[str], path: Path) -> None:
    """Say which line and column is at fault; return if none is found."""
    for number, line in enumerate(lines, start=layout.first_line + 1):
        if not line.strip():
            continue
        cells = split_cells(line, layout.dialect)
        if len(cells) != layout.n_columns:
            raise UnreadableFileError(
                f"line {number} of {path.name} holds {len(cells)} cells, but the table has {layout.n_columns} columns; "
                "every row must have as many, and the cell of a missing sample is left empty."
            )
        for name, cell in zip(names, cells, strict=True):
            if not is_number(cell, layout.dialect) and not is_missing(cell):
                shown = cell if len(cell) <= 40 else cell[:37] + "..."
                raise UnreadableFileError(
                    f"line {number}, column {name!r} of {path.name} holds {shown!r} where a number is expected; "
                    "correct it, or leave the cell empty if the sample is missing." + _hint(cell, layout.dialect)
                )


def _hint(cell: str, dialect: Dialect) -> str:
    other = Dialect(dialect.delimiter, "," if dialect.decimal == "." else ".")
    return f" (The rows above write {dialect.decimal!r} as the decimal sign.)" if is_number(cell, other) else ""


def _line(raw: bytes) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:  # an older program on Windows: degree and micro signs are one byte
        return raw.decode("cp1252", errors="replace")


def _decoded(data: bytes, encoding: str, path: Path) -> str:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise UnreadableFileError(f"{path.name} is marked as {encoding} text but is damaged ({error}).") from error
