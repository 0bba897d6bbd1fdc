"""How a text table is laid out: its dialect, its first line of numbers, and the names and units above it.

The dialect is the one under which the most lines after the first line of numbers are lines of as many numbers. What
stands before that line is the header (the last line of as many names), a line of units if there is one, and remarks.
"""

import csv
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from okid.errors import UnreadableFileError
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
    TAIL_BYTES: Final = 1 << 12
    """How much of a file's end is looked at first for lines that hold nothing."""


OTHERWISE = re.compile(
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
            headers = tuple(with_unit(*both, stays=units in above and not _is_letter(*both)) for both in pairs_of)
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
    if not unit or own == unit or not looks_like_unit(own) or not looks_like_unit(unit) or _is_letter(name, unit):
        return ""
    first, second = convert_unit(own_name, own), convert_unit(own_name, unit)
    if (first.unit, first.factor, first.offset) == (second.unit, second.factor, second.offset):
        return ""
    taken = split_header(header)[1]
    return f"{own_name!r} is in {own!r} by its own header and in {unit!r} by the row of units; {taken!r} was taken"


def _is_letter(name: str, unit: str | None) -> bool:
    """True where a capital in round brackets is a sensor's letter, because the row's unit is of another kind.

    Example:
        >>> [_is_letter("acc x (V)", "g"), _is_letter("acc x (V)", "mV"), _is_letter("acc x [V]", "g")]
        [True, False, False]
    """
    own_name, own = split_header(name)
    bracketed = unit and re.search(r"\([A-Z]\)\s*$", name)
    return bool(bracketed and convert_unit(own_name, own).unit != convert_unit(own_name, unit or "").unit)


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
