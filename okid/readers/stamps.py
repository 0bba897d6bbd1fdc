"""Stamps of a clock before each row of a text table, such as 2026-05-04T12:00:00.010, as seconds from the first one.

A column of stamps is the time whatever its header says (Datum, Date/Time, Uhrzeit). ISO 8601, its blank in place of
the T, 2026/05/04, 04.05.2026 12:00:00, and a clock without a date are read; what only a country's habit tells
(05/04/2026) is not.
The digits stay as they were written, for they say how far a stamp was rounded.
"""

import re
from datetime import date
from functools import lru_cache

__all__ = ["with_seconds"]

_DATE = rb"(?:(?P<date>\d{4}(?P<cut>[-/])\d\d(?P=cut)\d\d|\d\d?\.\d\d?\.\d{4})[T ]+)?"
_CLOCK = rb"(?P<hour>\d\d?):(?P<minute>\d\d):(?P<second>\d\d)(?:[%s](?P<digits>\d{1,9}))?(?:Z|[+-]\d\d:?\d\d)?"
_POINT, _COMMA = (
    re.compile(rb'^[ \t]*"?' + _DATE + _CLOCK % sign + rb'"?(?=[ \t,;\r\n]|\Z)', re.MULTILINE) for sign in (b".", b".,")
)
_FIRST_CELL = re.compile(rb'^[#%\s]*("[^"]*"|[^,;\t\r\n]*)')


def with_seconds(data: bytes, head: bytes | None = None) -> bytes:
    r"""The lines with their stamps as seconds, and their header as that of a time; as they are where they have none.

    Args:
        data: lines of a text table, with those above the table unless `head` is given.
        head: the first lines of the file that `data` goes on from.

    Example:
        >>> with_seconds(b"Datum,tip\n2026-05-04 23:59:59.99,1\n2026-05-05 00:00:00.00,2\n")
        b'time [s],tip\n0.99,1\n1.00,2\n'
    """
    sample = data if head is None else head
    lines = sample[: 1 << 16].splitlines()
    stamp = _COMMA if any(b";" in line or b"\t" in line for line in lines) else _POINT
    first = next((k for k, line in enumerate(lines) if stamp.match(line)), None)
    if first is None or not all(stamp.match(line) for line in lines[first:-1] if line.strip()):
        return data
    begin = stamp.match(lines[first])
    origin = _whole_seconds(begin) if begin else 0
    comma = stamp is _COMMA and any(re.search(rb"\d,\d", stamp.sub(b"", line)) for line in lines[first:])
    sign = b"," if comma else b"."  # as the numbers beside it are written

    def seconds(found: re.Match[bytes]) -> bytes:
        return b"%d%s%s" % (_whole_seconds(found) - origin, sign, found["digits"] or b"0")

    rows = stamp.sub(seconds, data)
    if head is not None or first == 0:
        return rows
    above, below = rows.splitlines(keepends=True)[:first], rows.split(b"\n", first)[first]
    cell = _FIRST_CELL.match(above[-1])
    units = first > 1 and cell is not None and cell[1].strip(b'" ')[:1] in (b"", b"[", b"(")
    names = [b"time", b"s"] if units else [b"time [s]"]
    for k, name in zip(range(first - len(names), first), names, strict=True):
        above[k] = _FIRST_CELL.sub(name, above[k], count=1)
    return b"".join(above) + below


def _whole_seconds(found: re.Match[bytes]) -> int:
    day = _day(found["date"]) if found["date"] else 0
    return 86400 * day + 3600 * int(found["hour"]) + 60 * int(found["minute"]) + int(found["second"])


@lru_cache(maxsize=64)
def _day(text: bytes) -> int:
    if b"." not in text:
        return date.fromisoformat(text.decode().replace("/", "-")).toordinal()
    day, month, year = map(int, text.split(b"."))
    return date(year, month, day).toordinal()
