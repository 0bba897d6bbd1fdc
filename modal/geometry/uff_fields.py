"""Numbers on a line of a universal file: Fortran fields of a fixed width, or parted by spaces as many write them."""

import math

__all__ = ["numbers", "whole_numbers"]

WIDTH = 10


def whole_numbers(line: str, at_least: int = 0) -> list[int]:
    """The whole numbers on a line, in fields of ten characters or parted by spaces.

    Raises:
        ValueError: fewer than `at_least`, or a field that is no whole number.

    Example:
        >>> whole_numbers("         1         2"), whole_numbers("12345678901234567890", 2)
        ([1, 2], [1234567890, 1234567890])
    """
    fields = line.split()
    if len(fields) < at_least or any(len(field) > WIDTH for field in fields):
        fields = _cut(line, WIDTH)
    if len(fields) < at_least:
        raise ValueError(f"{len(fields)} whole numbers on a line that has {at_least}")
    try:
        return [int(field) for field in fields]
    except ValueError:
        raise ValueError(f"{line.strip()[:40]!r} where whole numbers stand") from None


def numbers(line: str, count: int, *, width: int) -> list[float]:
    """The first `count` numbers on a line, in fields of `width` characters or parted by spaces; `D` marks an exponent.

    Raises:
        ValueError: fewer numbers, or a field that is none.

    Example:
        >>> numbers("  1.50000D+00 -2.00000D+00", 2, width=13)
        [1.5, -2.0]
    """
    fields = line.split()
    if len(fields) < count or any(len(field) > width for field in fields):
        fields = _cut(line, width)
    if len(fields) < count:
        raise ValueError(f"{len(fields)} numbers on a line that has {count}")
    try:
        found = [float(field.replace("D", "E").replace("d", "e")) for field in fields[:count]]
    except ValueError:
        raise ValueError(f"{line.strip()[:40]!r} where numbers stand") from None
    if not all(map(math.isfinite, found)):
        raise ValueError("a number that is not finite")
    return found


def _cut(line: str, width: int) -> list[str]:
    fields = [line[start : start + width].strip() for start in range(0, len(line), width)]
    return [field for field in fields if field]
