r"""Times of samples: stamps of a clock in a text table as seconds, and the step of the grid that times stand on.

A stamp is a date and a clock in one cell or in two neighbouring ones, a clock by itself, or the minutes and seconds
that a spreadsheet leaves of it (`59:59.9`, then `00:00.0`). Read are ISO 8601, its blank in place of the T, 2026/05/04,
04.05.2026, 4-May-2026 with the months of English, German and French, AM and PM, a comma as the decimal sign where none
separates the cells, and milliseconds behind a colon. Digits stay as written: they say how far a stamp was rounded.

Whether 05/04/2026 is of May or of April, only its country knows: a number above 12 tells it, else two days that follow
each other. Where nothing does, as in 26.05.04, the clock is read as one without a date.

Seconds count from the first whole second of the table, and what that is counts from the start of 1970, UTC where the
stamps state an offset; without a date from midnight, without hours from the full hour.

Times as numbers, from any format, give one step: numbers without a unit are seconds, or what the date that they give
says (milliseconds and finer since 1970, days of spreadsheets). A grid is uniform where its times lie on it within a
part of a step. Times that were rounded to their last digit may lie further off; they tell the step between two bounds.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import lru_cache
from itertools import islice
from typing import Final, Literal

import numpy as np

from okid.arrays import ROUNDED, FloatArray
from okid.errors import InsufficientDataError, InvalidDataError

_DATE = (
    rb"(?P<date>\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?\.\d\d?\.(?:\d{4}|\d\d)|\d\d?[-/]\d\d?[-/](?:\d{4}|\d\d)"
    rb"|\d\d?\.?[- ][A-Za-z\x80-\xff]{3,10}\.?[- ]\d{4})"
)
_FRACTION = rb"(?:[%s](?P<digits>\d{1,9})|:(?P<thousandths>\d{3}))?"
_CLOCK = (
    rb"(?P<hour>\d\d?):(?P<minute>[0-5]\d):(?P<second>\d\d)" + _FRACTION + rb"(?: ?(?P<half>[AaPp]\.?[Mm]\.?))?"
    rb" ?Z?(?P<zone>[+-]\d\d:?\d\d)?"
)
_MINUTES = rb"(?P<minute>\d{1,4}):(?P<second>[0-5]\d)[%s](?P<digits>\d{1,9})"
_MIDNIGHT = rb"(?:[T ]+00:00:00(?:\.0*)?)?"
_BETWEEN = rb"(?:[Tt_]| *[-,]? +)"
_MONTHS = (
    "jan",
    "feb fev",
    "mar mrz",
    "apr avr",
    "may mai",
    "jun",
    "jul",
    "aug aou",
    "sep",
    "oct okt",
    "nov",
    "dec dez",
)
_PATTERN_OF_TIME = re.compile(
    rb"$|[\[(]|-$|s$|sec$|(?:[dmyjt]{1,4}[./-]){2}[dyja]{1,4}|[hm]{1,2}:m{0,2}", re.IGNORECASE
)
"""What a row of units holds below "Time": nothing, s, [s], or how its stamps are written (hh:mm:ss)."""

_BETWEEN_BLANKS = re.compile(rb"[^,]*|[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
"""What stands between blanks where commas are decimal signs, if anything; else commas separate the cells."""

_REMARK = re.compile(rb"[#%]+\s*")

DAY, HOUR = 86_400, 3_600
"""Seconds after which a clock begins again that shows no date, and one that shows no hours."""

FIRST_YEAR = 20
"""Two digits before a dot may be the year from this one on (26.05.04), and are the day below it (04.05.26)."""

HEAD_BYTES = 1 << 16
"""Look for a clock in so much of a text."""

NAME = b"clock_time"
"""Put this over the seconds: no other column is called so."""

EPOCH = date(1970, 1, 1).toordinal()

Kind = Literal["date, clock", "clock, date", "both", "clock", "minutes"]
KINDS: Final[tuple[Kind, ...]] = ("date, clock", "clock, date", "both", "clock", "minutes")


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """Where the stamps of a table stand and how they are written.

    Args:
        delimiter: of its cells; a blank stands for any run of blanks.
        n_before: cells of a row before its stamp.
        n_cells: cells of a row.
        kind: what the stamp's cells hold.
        first: index of the first line with a stamp.
        origin: whole seconds that the seconds of the table count from.
        dated: whether these count from 1970; else they count from midnight, or from the full hour.
        month_first: whether a date with slashes is written as in America; None where nothing tells.
        decimal: sign of the numbers beside the stamps.
    """

    delimiter: bytes
    n_before: int
    n_cells: int
    kind: Kind
    first: int
    origin: int = 0
    dated: bool = False
    month_first: bool | None = False
    decimal: bytes = b"."

    @property
    def period(self) -> int:
        """Seconds after which it begins again; 0 where it shows a date."""
        return 0 if self.dated else HOUR if self.kind == "minutes" else DAY

    def pattern(self) -> re.Pattern[bytes]:
        """Of a row up to the end of its stamp."""
        cut, blank = re.escape(self.delimiter), self.delimiter == b" "
        cell = rb'(?:"[^"\r\n]*"|\S+)[ \t]+' if blank else rb'(?: *"[^"\r\n]*" *|[^"\r\n%s]*)%s' % (cut, cut)
        cut = rb"[ \t]+" if blank else cut
        stamp = _stamps(self.delimiter)[self.kind].replace(b"\0", rb' *"? *%s *"? *' % cut)
        return re.compile(
            rb"^(?P<before>[ \t]*(?:%s){%d})" % (cell, self.n_before)
            + rb' *"? *' + stamp + rb' *"? *(?=%s|[\r\n]|\Z)' % cut,
            re.MULTILINE,
        )  # fmt: skip

    def seconds(self, data: bytes, *, goes_on: bool = False) -> bytes:
        r"""The lines with their stamps as seconds, and their header as that of a time.

        Args:
            data: lines of the table.
            goes_on: they are further lines of the file whose beginning told the clock, none of them a header.

        Raises:
            ValueError: a date that is none.

        Example:
            >>> data = b"Datum,Zeit,tip\n04.05.2026,23:59:59.99,1\n05.05.2026,00:00:00.00,2\n"
            >>> find_clock(data).seconds(data)
            b'clock_time [s],tip\n0.99,1\n1.00,2\n'
        """
        if b"\n" not in data:  # an old Macintosh ends its lines otherwise
            data = data.replace(b"\r", b"\n")
        rows = self.pattern().sub(self._writer(goes_on=goes_on), data)
        if goes_on or self.first == 0:
            return rows
        above = next(islice(re.finditer(rb"\r?\n|\r", rows), self.first - 1, None)).end()
        return b"".join(self._named(rows[:above].splitlines(keepends=True))) + rows[above:]

    def _writer(self, *, goes_on: bool) -> Callable[[re.Match[bytes]], bytes]:
        period = self.period
        last, turns = self.origin, 0

        def write(found: re.Match[bytes]) -> bytes:
            nonlocal last, turns, goes_on
            whole = self.whole(found)
            if period and (whole < last - period // 2 or (goes_on and whole < last)):  # past midnight, or the hour
                turns += 1
            last, goes_on = whole, False
            whole += turns * period - self.origin
            return b"%s%d%s%s" % (found["before"], whole, self.decimal, _digits(found))

        return write

    def whole(self, found: re.Match[bytes]) -> int:
        """The whole seconds of a stamp."""
        parts = found.groupdict()
        seconds = 60 * int(parts["minute"]) + int(parts["second"])
        if self.kind == "minutes":
            return seconds
        hour = int(parts["hour"])
        if half := parts["half"]:
            hour = hour % 12 + (12 if half[:1] in b"Pp" else 0)
        zone = (parts["zone"] or b"+0000").replace(b":", b"")
        offset = HOUR * int(zone[:3]) + 60 * int(zone[:1] + zone[3:])
        day = _day(parts["date"], month_first=bool(self.month_first)) - EPOCH if self.dated else 0
        return DAY * day + HOUR * hour + seconds - offset

    def _named(self, above: Sequence[bytes]) -> list[bytes]:
        """The lines above the first stamp, with a name of the time over it, and its unit below that if there is one."""
        named = list(above)
        filled = [k for k, line in enumerate(above) if line.strip()]
        marks = [_REMARK.match(above[k]) for k in filled]
        cells = [
            _cut(above[k].rstrip(b"\r\n")[mark.end() if mark else 0 :], self.delimiter)
            for k, mark in zip(filled, marks, strict=True)
        ]
        own = cells[-1][self.n_before].strip(b'" \t').lower() if cells and len(cells[-1]) > self.n_before else b"?"
        lower = len(cells) > 1 and len(cells[-2]) == len(cells[-1]) and _PATTERN_OF_TIME.match(own) is not None
        names = [NAME, b"s"] if lower else [NAME + b" [s]"]
        n_stamp = 2 if "," in self.kind else 1
        for at, name in zip(range(-len(names), 0), names, strict=True) if cells else ():
            k, row, mark = filled[at], cells[at], marks[at]
            surplus = n_stamp if len(row) >= self.n_cells else 1  # blanks cut "Timestamp a b" once less than its rows
            row[self.n_before : self.n_before + surplus] = [name]
            end = above[k][len(above[k].rstrip(b"\r\n")) :]
            named[k] = (mark[0] if mark else b"") + self.delimiter.join(row) + end
        return named


def find_clock(head: bytes) -> Clock | None:
    """How the first lines of a text table write a clock, None where none of their columns is one.

    Args:
        head: the first lines, with those above the table.

    Raises:
        ValueError: a date that is none.
    """
    if not may_hold_stamps(head):
        return None
    ends = len(head) <= HEAD_BYTES
    head = head[:HEAD_BYTES]
    lines = head.splitlines()
    if not head.endswith((b"\n", b"\r")):
        lines.pop()
    for delimiter in (b"\t", b";", b"|", b" ", b","):
        found = _columns_of_stamps(lines, delimiter, ends=ends)
        if found is not None:
            return found
    return None


def may_hold_stamps(head: bytes) -> bool:
    """False where no clock stands anywhere in the first lines of a text."""
    return re.search(rb"\d:[0-5]\d", head[:HEAD_BYTES]) is not None


def _stamps(delimiter: bytes) -> dict[Kind, bytes]:
    """How the cells of each kind are written; zero stands for what separates two."""
    signs = b"." if delimiter == b"," else b".,"
    clock = _CLOCK % signs
    if delimiter == b" ":  # what stands behind the next blank is a number, not a zone
        clock = clock.replace(b" ?Z?", b"Z?")
    return {
        "date, clock": _DATE + _MIDNIGHT + b"\0" + clock,
        "clock, date": clock + b"\0" + _DATE + _MIDNIGHT,
        "both": _DATE + _BETWEEN + clock,
        "clock": clock,
        "minutes": _MINUTES % signs,
    }


def _columns_of_stamps(lines: Sequence[bytes], delimiter: bytes, *, ends: bool) -> Clock | None:
    rows = [_cut(line, delimiter) for line in lines]
    filled = [row for row in rows if len(row) > 1 or row[0].strip()]
    if not any(len(row) > 1 for row in filled):
        return None
    n_cells = Counter(map(len, filled[-200:])).most_common(1)[0][0]
    stamps = {kind: re.compile(text) for kind, text in _stamps(delimiter).items()}
    last = next(row for row in filled[::-1] if len(row) == n_cells)
    for kind in KINDS:
        n_stamp = 2 if "," in kind else 1
        for k in range(n_cells - n_stamp + 1):
            if not stamps[kind].fullmatch(_stamp_in(last, k, n_stamp)):
                continue
            beside = last[:k] + last[k + n_stamp :]
            if delimiter == b" " and not (beside and all(map(_BETWEEN_BLANKS.fullmatch, beside))):
                return None
            are = [len(row) == n_cells and bool(stamps[kind].fullmatch(_stamp_in(row, k, n_stamp))) for row in rows]
            first = are.index(True)
            others = [row for is_one, row in zip(are[first:-1], rows[first:-1], strict=True) if not is_one]
            if not any(b"".join(row).strip() for row in others):
                clock = Clock(delimiter=delimiter, n_before=k, n_cells=n_cells, kind=kind, first=first)
                if (known := _with_origin(clock, lines, ends=ends)) is not None:
                    return known
    return None


def _stamp_in(row: Sequence[bytes], k: int, n_stamp: int) -> bytes:
    return b"\0".join(cell.strip(b'" ') for cell in row[k : k + n_stamp])


def _with_origin(clock: Clock, lines: Sequence[bytes], *, ends: bool) -> Clock | None:
    """The clock with what the rows tell of its dates, its beginning, and the decimal sign beside it.

    None where it is no time of the rows: it stands still to the end of the file, or shows no date and goes back.
    """
    pattern = clock.pattern()
    rows = [found for line in lines[clock.first :] if (found := pattern.match(line))]
    others = (found["before"] + found.string[found.end() :] for found in rows)
    comma = clock.delimiter != b"," and any(re.search(rb"\d,\d", other) for other in others)
    month_first = _month_first({found["date"] for found in rows}) if "date" in pattern.groupindex else None
    known = replace(clock, dated=month_first is not None, month_first=month_first, decimal=b"," if comma else b".")
    steps = np.diff([known.whole(found) + float(b"0." + _digits(found)) for found in rows])
    back = (steps < 0.0) & (steps >= -known.period / 2)
    if (ends and len(steps) and not steps.any()) or (known.period and back.any()):
        return None
    return replace(known, origin=known.whole(rows[0]))


def _digits(found: re.Match[bytes]) -> bytes:
    parts = found.groupdict()
    return parts["digits"] or parts.get("thousandths") or b"0"


def _month_first(dates: set[bytes]) -> bool | None:
    """Whether dates with slashes are American, None where nothing tells it, or where the year may stand first."""
    parts = [re.fullmatch(rb"(\d\d?)[-/](\d\d?)[-/](\d+)", text) for text in dates]
    cut = [found for found in parts if found]
    dotted = [found for text in dates if (found := re.fullmatch(rb"(\d\d)\.\d\d?\.(\d\d)", text))]
    if any(int(found[1]) >= FIRST_YEAR and int(found[2]) <= 31 for found in dotted):  # 26.05.04
        return None
    if not cut:
        return False
    if any(len(found[3]) < 4 for found in cut):  # 26/05/04 may even begin with the year
        return None
    if any(int(found[1]) > 12 for found in cut) or any(int(found[2]) > 12 for found in cut):
        return not any(int(found[1]) > 12 for found in cut)
    spans = [max(days) - min(days) for american in (False, True) if (days := [_day(each, american) for each in dates])]
    return None if spans[0] == spans[1] else spans[1] < spans[0]


@lru_cache(maxsize=64)
def _day(text: bytes, month_first: bool) -> int:
    numbers = re.findall(rb"\d+", text)
    word = re.search(rb"[A-Za-z\x80-\xff]{3,}", text)
    if word:
        plain = unicodedata.normalize("NFKD", _decoded(word[0])).encode("ascii", "ignore").decode().lower()
        short = plain[:4] if plain.startswith("jui") else plain[:3]  # juin, juillet
        named = {"juin": 6, "juil": 7} | {name: k for k, names in enumerate(_MONTHS, 1) for name in names.split()}
        if short not in named:
            raise ValueError(f"{_decoded(text)} names no month in English, German or French")
        day, month, year = int(numbers[0]), named[short], int(numbers[1])
    elif len(numbers[0]) == 4:
        year, month, day = map(int, numbers)
    else:
        day, month, year = map(int, numbers)
        day, month = (month, day) if month_first and b"." not in text else (day, month)
    return date(year + (2000 if year < 100 else 0), month, day).toordinal()


def _decoded(text: bytes) -> str:
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("cp1252", errors="replace")


def _cut(line: bytes, delimiter: bytes) -> list[bytes]:
    """The cells of a line as they stand, quotes and all."""
    if delimiter == b" ":
        return re.findall(rb'"[^"]*"(?!\S)|\S+', line) or [b""]
    cut = re.escape(delimiter)
    return [found[1] for found in re.finditer(rb'(?:^|%s)((?: *"[^"]*" *(?=%s|$))|[^%s]*)' % (cut, cut, cut), line)]


YEAR_2000, YEAR_2100 = 946_684_800.0, 4_102_444_800.0
"""Read stamps between these, seconds since 1970, as a date; a thousand times as much counts milliseconds, and so on."""

DAYS_BEFORE_1970 = (25_569.0, 719_529.0)
"""Read stamps as days where they give a date between these years: since 1900 (spreadsheets) and since the year 0."""

SHORTEST_STEP = 1e-5
"""Expect no shorter step [s] in stamps of hours and more: what looks so counts days."""

JITTER = 0.1
"""How far a sample may lie off the uniform grid, in time steps."""

ROUNDED_WIDTH = 1.25
"""Accept rounded stamps within so many of their last digit: one, and what a clock is late."""


def date_of_stamps(stamps: FloatArray, name: str) -> tuple[float, float]:
    """Seconds in one unit of stamps without a unit, and the stamp of the start of 1970; told by the date they give.

    Where they give none the unit is the second, and they count from where they count.
    """
    first, last = float(stamps[0]), float(stamps[-1])
    for thousands in (1e3, 1e6, 1e9):
        if YEAR_2000 * thousands <= first < YEAR_2100 * thousands:
            return 1.0 / thousands, 0.0
    may_be_days = "dat" in name.lower() or last - first < SHORTEST_STEP * len(stamps)
    for origin in DAYS_BEFORE_1970:
        if may_be_days and YEAR_2000 / DAY + origin <= first < YEAR_2100 / DAY + origin:
            return float(DAY), origin
    return 1.0, 0.0


def uniform_step(stamps: FloatArray, factor: float, name: str) -> tuple[float, float]:
    """Step of a uniform grid [s] and how far it may be off; the mean over the whole span, unless stamps are rounded.

    Stamps that were rounded to the digits they are written with lie off the grid by half of their last digit: they tell
    the step between two bounds.

    Args:
        stamps: (n_samples,) the times.
        factor: seconds in one unit of them.
        name: of the time, for messages.

    Raises:
        InsufficientDataError: one sample.
        InvalidDataError: a missing time, one that does not increase, or a grid that is not uniform.
    """
    time = factor * stamps
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
    off = np.abs(time - time[0] - step * np.arange(n_samples)) / (step or 1.0)
    if off.max() > ROUNDED and (rounded := _rounded_step(stamps)) is not None:
        return factor * rounded[0], factor * rounded[1]
    if step <= 0 or back.any():
        row = int(back.argmax()) + 1
        repeats = 2 * np.count_nonzero(np.diff(time) == 0) > n_samples
        remedy = (
            "most times repeat, so they were written with too few digits: write more, or give the time step (dt)"
            if repeats
            else "sort the rows, or cut the file into one file a record"
        )
        raise InvalidDataError(
            f"{name} must increase, but goes from {time[row - 1]:.12g} s to {time[row]:.12g} s at row {row + 1} of "
            f"{n_samples}; {remedy}."
        )
    worst = int(off.argmax())
    if off[worst] > JITTER:
        raise InvalidDataError(
            f"{name} is not uniform: with the mean step of {step:.6g} s, row {worst + 1} of {n_samples} lies "
            f"{off[worst]:.3g} steps off the grid (at most {JITTER} is allowed); resample the record to a uniform "
            "step, or, if samples were lost, put the lost rows back with empty cells."
        )
    return step, 0.0


def _rounded_step(stamps: FloatArray) -> tuple[float, float] | None:
    """Step of a uniform grid that was rounded to the last digit of the stamps, and how far it may be off.

    None where rounding does not explain the stamps. It leaves two neighbouring lengths of step, the rarer of them at
    regular distances, and all stamps within half a digit of the grid. One or two odd steps may as well be lost samples:
    they are not explained by it. All grids with a stamp's digits at every sample have a step between two bounds.
    """
    digit = next(
        (d for d in 10.0 ** -np.arange(-3, 13.0) if np.allclose(stamps / d, np.rint(stamps / d), 0, 1e-4)), None
    )
    if digit is None:
        return None
    ticks = np.rint(stamps / digit)
    lengths = np.diff(ticks)
    shortest, longest = lengths.min(), lengths.max()
    rarer = min(int((lengths == shortest).sum()), int((lengths == longest).sum()))
    if longest - shortest != 1 or shortest < 0 or rarer < 3:
        return None
    ticks -= ticks[0]
    last = len(ticks) - 1
    widths = (1.0, ROUNDED_WIDTH)  # a clock of a computer is late at times: its stamps are truncated, not rounded
    for width in widths:
        low, high = (_bound(ticks, ticks[-1] / last + side * 2.0 * width / last, width) for side in (-1.0, 1.0))
        if low is not None and high is not None:
            return digit * 0.5 * (low + high), digit * 0.5 * (high - low)
    return None


def _bound(ticks: FloatArray, slope: float, width: float) -> float | None:
    """The slope nearest to the given one at which all ticks lie between two lines so far apart; None if there is none.

    How far apart they must be is a convex function of the slope, made of straight pieces: Newton's steps from outside
    never pass the bound, and end on it.
    """
    count = np.arange(len(ticks), dtype=np.float64)
    side, rounding = 0.0, ROUNDED * width + 4.0 * float(np.spacing(np.abs(ticks).max()))
    for _ in range(60):  # it ends within ten unless rounding is all that is left
        rest = ticks - slope * count
        top, bottom = int(rest.argmax()), int(rest.argmin())
        excess = float(rest[top] - rest[bottom]) - width
        if excess <= rounding:
            return slope
        per_slope = float(bottom - top)
        if per_slope == 0.0 or per_slope * (side or per_slope) < 0.0:  # past the narrowest, and still too wide
            return None
        side = per_slope
        slope -= excess / per_slope
    return None
