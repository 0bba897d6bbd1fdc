"""Text tables: CSV, TSV and whatever else programs write as rows of numbers.

The layout is found from the first megabyte; the numbers are then read by pyarrow, in several threads. Only where that
fails is the text looked through line by line, to say which cell is at fault.

The dialect is the one under which the most lines after the first line of numbers are lines of as many numbers. What
stands before that line is the header (the last line of as many names), a line of units if there is one, and remarks.

A column of stamps of a clock is the time whatever its header says (Datum, Date/Time, Uhrzeit), and so are a column of
dates and one of a clock beside it (`okid.readers.clock`).
"""

import codecs
import contextlib
import csv
import io
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import numpy as np

from okid.arrays import FloatArray
from okid.errors import UnreadableFileError
from okid.readers.clock import NAME, Clock, find_clock
from okid.readers.guard import check_channel_count, check_memory, first_line
from okid.readers.table import Column, LeftOut, Table, unique_names
from okid.readers.units import convert_unit, looks_like_unit, split_header, with_unit

MISSING = (
    *("", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None"),
    *("nan(ind)", "-nan(ind)", "1.#QNAN", "-1.#IND"),
)
"""Spellings of a missing value that programs write."""

COMMENTS = frozenset(["comment", "comments", "kommentar", "commentaire", "comentario"])
"""Let these stand over a last column that holds nothing, as LabVIEW writes them."""

_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf|Inf|INF|infinity|Infinity)"),
    ",": re.compile(r"[+-]?(?:\d+,?\d*|,\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf|Inf|INF)"),
}


@dataclass(frozen=True, slots=True)
class Dialect:
    """Delimiter (" " stands for any run of blanks) and decimal sign of a text table."""

    delimiter: Literal[",", ";", "\t", "|", " "]
    decimal: Literal[".", ","]


def split_cells(line: str, dialect: Dialect) -> list[str]:
    """The cells of one line, without quotes and surrounding blanks."""
    if dialect.delimiter == " ":
        return line.split()
    try:
        cells = next(csv.reader([line], delimiter=dialect.delimiter, skipinitialspace=dialect.delimiter != "\t"), [])
    except csv.Error:  # a cell beyond the module's limit of 128 KiB: no table
        return [line]
    return [cell.strip() for cell in cells]


def is_number(cell: str, dialect: Dialect) -> bool:
    """True for a number as the dialect writes it."""
    return _NUMBER[dialect.decimal].fullmatch(cell) is not None


def is_missing(cell: str) -> bool:
    """True for an empty cell and the spellings of `MISSING`."""
    return cell in MISSING


# In order of trust; the first of equals wins.
DIALECTS = (
    *(Dialect(",", "."), Dialect(";", "."), Dialect(";", ","), Dialect("\t", "."), Dialect("\t", ",")),
    *(Dialect("|", "."), Dialect(" ", "."), Dialect(" ", ","), Dialect(",", ",")),
)


class TextLimits:
    """How much of a text is looked at."""

    MAX_REMARKS: Final = 1000
    """Lines that may stand before the first number."""
    SAMPLE_BYTES: Final = 1 << 20
    """How much of a file is looked at to find its layout; no line may be longer."""
    BLOCK_BYTES: Final = 8 << 20


_OTHERWISE = re.compile(
    r"[+-]?(?:\d{1,3}(?:[.,'\s]\d{3})+(?:[.,]\d*)?|\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?\s?(?:[^\W\d_]\S*|[%°]\S*)?"
)
"""Read a cell like this as a number that is written otherwise: `1.234,5`, `0.125 N`, `0x1F`."""
_UNITS_WORD = re.compile(r"units?|einheit(?:en)?|unités?|unidad(?:es)?", re.IGNORECASE)
_UNITS_ARE = rf"(?:{_UNITS_WORD.pattern})\s*[:=]\s*"
_COMMENT = re.compile(rf"^\s*(?:(?:#|%|!|//|\*)+\s*(?:{_UNITS_ARE})?|{_UNITS_ARE})", re.IGNORECASE)
_TIME_UNITS = frozenset(["s", "sec", "second", "seconds", "ms", "msec", "us", "µs", "μs", "min", "h"])
_TIME_HEADER = re.compile(r"\s*(?:clock_time|time|t|timestamp|elapsed time|zeit|temps|tiempo|tempo)\b", re.IGNORECASE)
_HEADER_WORD = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?")


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLayout:
    """How to read a text table.

    Args:
        dialect: delimiter and decimal sign.
        first_line: index of the first line of numbers.
        headers: one a column, with their units; () if the table has no header.
        n_columns: number of columns.
        doubts: one sentence for each unit in a row of units that is another than the one in the name's brackets.
    """

    dialect: Dialect
    first_line: int
    headers: tuple[str, ...]
    n_columns: int
    doubts: tuple[str, ...] = ()


def find_layout(lines: Sequence[str], *, file_name: str) -> TextLayout:
    """The layout of a text table from its first lines.

    Raises:
        UnreadableFileError: no line of numbers, or a header that does not fit the numbers below it.
    """
    found = [
        (_score(lines, dialect, start), dialect, start) for dialect in DIALECTS if (start := _start(lines, dialect))
    ]
    if not found:
        _refuse_text_column(lines, file_name)
        shown = next((line.strip() for line in lines if line.strip()), "")[:60]
        n_lines = min(len(lines), TextLimits.MAX_REMARKS)
        searched = "in its only line" if n_lines == 1 else f"among its first {n_lines} lines"
        raise UnreadableFileError(
            f"{file_name} holds no row of numbers {searched} (it begins with {shown!r}); a record is a table "
            "of numbers, one row a sample, one column a channel; export the samples themselves."
        )
    _, dialect, (first_line, n_columns) = max(found, key=lambda candidate: candidate[0])
    headers, doubts = _headers(lines, first_line, n_columns, dialect, file_name)
    return TextLayout(dialect=dialect, first_line=first_line, headers=headers, n_columns=n_columns, doubts=doubts)


def _start(lines: Sequence[str], dialect: Dialect) -> tuple[int, int] | None:
    """First line of numbers only that is followed by one like it (or by none), and its number of cells."""
    for index, line in enumerate(lines[: TextLimits.MAX_REMARKS]):
        cells = split_cells(line, dialect)
        if not _all_numbers(cells, dialect):
            continue
        after = next((later for later in lines[index + 1 :] if later.strip()), None)
        below = cells if after is None else split_cells(after, dialect)
        if len(below) == len(cells) and any(is_number(cell, dialect) or is_missing(cell) for cell in below):
            return index, len(cells)
    return None


def _all_numbers(cells: Sequence[str], dialect: Dialect) -> bool:
    numbers = [is_number(cell, dialect) for cell in cells]
    return any(numbers) and all(number or is_missing(cell) for number, cell in zip(numbers, cells, strict=True))


def _score(lines: Sequence[str], dialect: Dialect, start: tuple[int, int]) -> tuple[int, bool, int]:
    first, n_columns = start
    alike = 0
    for line in lines[first : first + 200]:
        cells = split_cells(line, dialect)
        alike += len(cells) == n_columns and _all_numbers(cells, dialect)
    above = [line for line in lines[:first] if line.strip()]
    return alike, bool(above) and _fits(above[-1], n_columns, dialect), n_columns


def _headers(
    lines: Sequence[str], first_line: int, n_columns: int, dialect: Dialect, file_name: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The headers, and what is doubtful of their units."""
    above = [(number, line) for number, line in enumerate(lines[:first_line], start=1) if line.strip()]
    if not above:
        return (), ()
    number, last = above[-1]
    names = _names_in(last, n_columns, dialect)
    cells = split_cells(last, dialect)
    if len(cells) != n_columns and len(cells) > 1 and _all_numbers(cells, dialect):
        raise UnreadableFileError(
            f"line {number} of {file_name} holds {len(cells)} cells, but the rows below it hold {n_columns}; every row "
            "must have as many, and the cell of a missing sample is left empty."
        )
    if names is None:
        count = len(cells)
        if count > 1 and n_columns > 1 and not _COMMENT.match(last):
            raise UnreadableFileError(
                f"line {number} of {file_name} names {count} columns, but the rows below it hold {n_columns} numbers; "
                "give every column a name."
            )
        return (), ()
    if any(is_number(cell, dialect) and not cell.isdigit() for cell in names):  # a damaged row, and no names
        _refuse_text(cells, [f"column_{index}" for index in range(n_columns)], number, dialect, file_name)
    rows = [names, *(_names_in(line, n_columns, dialect) for _, line in above[-2::-1])]
    if rows[1:] and rows[1] and _is_header(rows[1], dialect) and not _is_header(names, dialect):
        _refuse_text(names, rows[1], number, dialect, file_name)
    return _with_units(rows, dialect) if _is_header(names, dialect) else (tuple(names), ())


def _with_units(rows: Sequence[list[str] | None], dialect: Dialect) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The headers that rows of names and units make up, the lowest first, and what is doubtful of them.

    Below the units sensors may be named.
    """
    pairs = [(low, high) for low, high in itertools.pairwise(rows[:3]) if low and high and _is_header(low, dialect)]
    lowest = rows[0] or []  # or above the names, in a row or a remark: a unit of time over a time, or nothing there
    above = [row for row in rows[1:] if lowest and row and len(row) > 1 and all(map(_stands_over, lowest, row))]
    for units, titles in (*pairs, *((row, lowest) for row in above)):
        if _is_units_row(titles, units):
            cells = [None if _UNITS_WORD.fullmatch(cell) else cell.strip("[]() ") for cell in units]
            pairs_of = list(zip(titles, cells, strict=True))
            headers = tuple(with_unit(*both, stays=units in above) for both in pairs_of)
            said = (_unit_doubt(*both, header) for both, header in zip(pairs_of, headers, strict=True))
            return headers, tuple(doubt for doubt in said if doubt)
    for low, high in pairs[:1]:
        times = [_is_time(*split_header(cell)) and not sensor for cell, sensor in zip(high, low, strict=True)]
        if any(times) and all(split_header(cell)[1] for cell in high):
            return tuple(high), ()
    return tuple(lowest), ()


def _unit_doubt(name: str, unit: str | None, header: str) -> str:
    """What a reader must know where a row of units contradicts the unit in a name's brackets; "" where it does not.

    Example:
        >>> _unit_doubt("tip [mm]", "m", "tip [mm] [m]")
        "'tip' is in 'mm' by its own header and in 'm' by the row of units; 'm' was taken"
        >>> _unit_doubt("tip [mm]", "Millimeter", "tip [mm] [Millimeter]")
        ''
    """
    own_name, own = split_header(name)
    if not unit or own == unit or not looks_like_unit(own) or not looks_like_unit(unit):
        return ""
    first, second = convert_unit(own_name, own), convert_unit(own_name, unit)
    if (first.unit, first.factor, first.offset) == (second.unit, second.factor, second.offset):
        return ""
    taken = split_header(header)[1]
    return f"{own_name!r} is in {own!r} by its own header and in {unit!r} by the row of units; {taken!r} was taken"


def _is_header(cells: Sequence[str], dialect: Dialect) -> bool:
    return not any(is_number(cell, dialect) for cell in cells)


def _is_time(name: str, unit: str) -> bool:
    return _TIME_HEADER.match(name) is not None and unit.strip("[]() ").lower() in _TIME_UNITS


def _stands_over(name: str, unit: str) -> bool:
    return _TIME_HEADER.match(name) is None or not unit.strip() or _is_time(name, unit)


def _is_units_row(titles: Sequence[str], row: Sequence[str]) -> bool:
    """True if `row` are the units of `titles`: a unit of time under "time", or units and nothing else."""
    if any(map(_is_time, titles, row)):
        return True
    units = [unit.strip("[]() ") for unit in row if unit]
    if len(units) > 1 and _UNITS_WORD.fullmatch(units[0]):  # the row says what it holds
        units.pop(0)
    # a title of one letter, F or A, is no unit where one of the units is longer
    short = any(len(unit) > 1 for unit in units) and not all(map(looks_like_unit, titles))
    names = [title for title in titles if len(title) > short]
    return bool(units) and all(map(looks_like_unit, units)) and not any(map(looks_like_unit, names))


def _names_in(line: str, n_columns: int, dialect: Dialect) -> list[str] | None:
    """The line's cells if they can be names of `n_columns` columns."""
    text = _COMMENT.sub("", line).rstrip("\r\n")
    if n_columns == 1:
        return [text.strip().strip('"')]
    trials = [dialect, *DIALECTS]
    if dialect.delimiter == " ":  # numpy writes "# time, u, y" above columns cut by blanks
        trials.append(trials.pop(0))
    for trial in trials:
        cells = _HEADER_WORD.findall(text) if trial.delimiter == " " else split_cells(text, trial)
        if len(cells) == n_columns:
            return list(cells)
        if len(cells) == n_columns - 1 and trial == dialect and trial.delimiter != " ":
            return [*cells, ""]  # rows that end with a delimiter have one empty cell more
        if len(cells) == n_columns + 1 and cells[-1].lower() in COMMENTS:
            return list(cells[:-1])
    return None


def _fits(line: str, n_columns: int, dialect: Dialect) -> bool:
    """True if the line names as many columns, cut by the dialect's own delimiter."""
    text = _COMMENT.sub("", line).rstrip("\r\n")
    if n_columns == 1:
        return len(split_cells(text, Dialect(",", "."))) == 1
    return len(_HEADER_WORD.findall(text) if dialect.delimiter == " " else split_cells(text, dialect)) == n_columns


def _refuse_text(cells: Sequence[str], header: Sequence[str], number: int, dialect: Dialect, file_name: str) -> None:
    for name, cell in zip(header, cells, strict=False):
        if not is_number(cell, dialect) and not is_missing(cell):
            raise UnreadableFileError(
                f"line {number}, column {name!r} of {file_name} holds {cell[:40]!r} where a number is expected; "
                "correct it, or leave the cell empty if the sample is missing."
            )


def _refuse_text_column(lines: Sequence[str], file_name: str) -> None:
    """Name the column of text (dates, labels) in a table that is numbers but for it."""
    for dialect in DIALECTS[:-1]:
        for number, (line, below) in enumerate(itertools.pairwise(lines[: TextLimits.MAX_REMARKS]), start=1):
            cells, cells_below = split_cells(line, dialect), split_cells(below, dialect)
            numbers = [is_number(cell, dialect) for cell in cells]
            if any(numbers) and numbers == [is_number(cell, dialect) for cell in cells_below]:
                header = _names_in(lines[number - 2], len(cells), dialect) if number > 1 else None
                names = header or [f"column_{index}" for index in range(len(cells))]
                _refuse_text(cells, names, number, dialect, file_name)


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
        clock = find_clock(head)
        if clock is not None:
            check_memory(path, COPIES_OF_TEXT * size)
            file.seek(0)
            data = clock.seconds(file.read())
    if clock is None:
        return _read_cells(file, head, path)
    return _with_time(_read_cells(io.BytesIO(data), data[: TextLimits.SAMPLE_BYTES], path), clock)


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
        measured = any(2 * sum(map(bool, map(_OTHERWISE.fullmatch, column))) > len(column) for column in cells)
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
    file.seek(sum(map(len, raw_lines[: layout.first_line])))
    values = _numbers(file, layout, names, path)
    values = _without_empty_end(values)
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


def _without_empty_end(values: FloatArray) -> FloatArray:
    """The rows up to the last one that holds a number: a sheet is saved with lines of delimiters below its table."""
    n_rows = len(values)
    while n_rows > 1 and np.isnan(values[n_rows - 1]).all():
        n_rows -= 1
    return values[:n_rows]


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
        clock = find_clock(head)
        if clock is not None:
            data, head = clock.seconds(data, goes_on=True), clock.seconds(head)
    layout = find_layout([_line(raw) for raw in head.splitlines(keepends=True)], file_name=path.name)
    names = [split_header(header)[0] for header in layout.headers] or [str(k) for k in range(layout.n_columns)]
    return _numbers(io.BytesIO(data), replace(layout, first_line=n_lines), names, path)


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
