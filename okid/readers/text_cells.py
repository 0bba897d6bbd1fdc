"""Cells of a text table: how a line is cut, and what is a number, a missing value, or text."""

import csv
import re
from dataclasses import dataclass
from typing import Literal

__all__ = ["MISSING", "Dialect", "is_missing", "is_number", "split_cells"]

MISSING = (
    *("", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None"),
    *("nan(ind)", "-nan(ind)", "1.#QNAN", "-1.#IND"),
)
"""Spellings of a missing value that programs write."""

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
