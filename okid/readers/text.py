"""Text tables: CSV, TSV and whatever else programs write as rows of numbers.

The layout is found from the first megabyte; the numbers are then read by pyarrow, in several threads. Only where that
fails is the text looked through line by line, to say which cell is at fault.
"""

import codecs
import io
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from okid.arrays import FloatArray
from okid.errors import UnreadableFileError
from okid.readers.guard import check_channel_count, check_memory, first_line
from okid.readers.headers import split_header, unique_names
from okid.readers.table import Column, Table
from okid.readers.text_cells import MISSING, Dialect, is_missing, is_number, split_cells
from okid.readers.text_layout import TextLayout, find_layout

__all__ = ["read_text"]

SAMPLE_BYTES = 1 << 20
"""How much of a file is looked at to find its layout; no line may be longer."""

BLOCK_BYTES = 8 << 20
MEMORY_A_BYTE = 4.0
"""Memory needed for one byte of text, about: the text, pyarrow's columns and the table of float64."""

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_BLANKS = re.compile(rb"[ \t]+")
_LINE_ENDS = re.compile(rb"^ | (?=[\r\n]|\Z)", re.MULTILINE)


def read_text(path: Path) -> Table:
    """The table of a text file: delimiter, decimal sign, header and units are found.

    Raises:
        UnreadableFileError: binary data, rows of different lengths, or text where a number is expected.
    """
    check_memory(path, MEMORY_A_BYTE * path.stat().st_size)
    with path.open("rb") as file:
        head = file.read(SAMPLE_BYTES)
    if head.startswith(_UTF16):
        text = _decoded(path.read_bytes(), "utf-16", path)
        data = io.BytesIO(text.encode())
        head = data.getbuffer()[:SAMPLE_BYTES].tobytes()
        return _read(data, head, path)
    if b"\0" in head:
        raise UnreadableFileError(
            f"{path.name} holds binary data, not text; give it the extension of its format, or export it as CSV."
        )
    with path.open("rb") as file:
        return _read(file, head, path)


def _read(file: BinaryIO, head: bytes, path: Path) -> Table:
    raw_lines = head.splitlines(keepends=True)
    if len(head) == SAMPLE_BYTES:
        if len(raw_lines) == 1:
            raise UnreadableFileError(
                f"the first line of {path.name} is longer than {SAMPLE_BYTES} bytes; a record is a table, one row a "
                "sample."
            )
        raw_lines.pop()  # cut off in its middle
    lines = [_line(raw) for raw in raw_lines]
    layout = find_layout(lines, file_name=path.name)
    check_channel_count(path, layout.n_columns)
    headers = layout.headers or ("",) * layout.n_columns
    split = [split_header(header) for header in headers]
    names = unique_names([name for name, _ in split], headers)
    file.seek(sum(map(len, raw_lines[: layout.first_line])))
    values = _numbers(file, layout, names, path)
    columns = [
        Column(name=name, unit=unit, header=header)
        for name, (_, unit), header in zip(names, split, headers, strict=True)
    ]
    if not headers[-1] and layout.headers and np.isnan(values[:, -1]).all():  # rows that end with a delimiter
        columns, values = columns[:-1], values[:, :-1]
    return Table(path=path, format="text table", columns=tuple(columns), values=values)


def _numbers(file: BinaryIO, layout: TextLayout, names: list[str], path: Path) -> FloatArray:
    import pyarrow as pa
    from pyarrow import csv

    start = file.tell()
    source: Any = file
    delimiter = layout.dialect.delimiter
    if delimiter == " ":
        source = io.BytesIO(_LINE_ENDS.sub(b"", _BLANKS.sub(b" ", file.read())))
    keys = [str(index) for index in range(layout.n_columns)]
    blanks = [" " * width for width in range(1, 33)]
    try:
        table = csv.read_csv(
            source,
            read_options=csv.ReadOptions(column_names=keys, block_size=BLOCK_BYTES),
            parse_options=csv.ParseOptions(delimiter=delimiter),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(keys, pa.float64()),
                null_values=[*MISSING, *blanks],
                quoted_strings_can_be_null=True,
                decimal_point=layout.dialect.decimal,
            ),
        )
    except (pa.ArrowException, ValueError) as error:
        file.seek(start)
        _raise_fault(io.TextIOWrapper(file, encoding="latin-1"), layout, names, path)
        raise UnreadableFileError(f"{path.name} cannot be read as a table of numbers ({first_line(error)}).") from error
    values = np.empty((table.num_rows, layout.n_columns))
    for index, column in enumerate(table.itercolumns()):
        values[:, index] = column.to_numpy()
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
                raise UnreadableFileError(
                    f"line {number}, column {name!r} of {path.name} holds {_shown(cell)} where a number is expected; "
                    "correct it, or leave the cell empty if the sample is missing." + _hint(cell, layout.dialect)
                )


def _shown(cell: str) -> str:
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")


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
