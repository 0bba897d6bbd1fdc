"""Numbers, lists, plurals and sentences as a person writes them, and foreign text made harmless for where it is shown.

Every text for a reader, in the report, the recording and the terminal, takes its numbers from here; no type of ours is
known here. Channel names, units and file names are written by others: in a terminal a control character moves the
cursor, in a spreadsheet a leading "=" is a formula, in Markdown a bracket is a link, and a right-to-left override turns
the words around it. HTML is escaped by the template engine; the rest is done here.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from okid.errors import visible

NINETY_FIVE = 1.96
"""Take so many standard deviations on either side as a 95 % interval, the quantile of a normal distribution."""

MOST_NAMED = 3
"""Name so many things in a sentence and count the others: a table has them all."""

LEAST_FIT = 0.5
"""Say below this cross-validated fit that the model explains less than it leaves: of noise, or of what drives it."""

NONLINEAR, WITH_LEVEL, IN_TIME = "Something is not linear", "with the level of motion", "during the record"
"""Begin the warning so where errors follow powers of the motion, and say so of what changes with it or in time: other
sentences depend on all three."""

GOOD_FIT = 0.8
"""Say that the model explains the record well from this cross-validated fit on."""


def listed(words: Sequence[str]) -> str:
    """The words with commas and an "and" before the last.

    Example:
        >>> listed(["a"]), listed(["a", "b", "c"])
        ('a', 'a, b and c')
    """
    return " and ".join(words) if len(words) < 3 else f"{', '.join(words[:-1])} and {words[-1]}"


def clipped(text: str, most: int) -> str:
    """The beginning of a text that is too long: to the end of a clause where one ends in its second half.

    Example:
        >>> clipped("The inputs hardly move: say so, and drive them more.", 40)
        'The inputs hardly move: say so …'
    """
    room = most - 2
    ends = [found.start() for found in re.finditer(r"[.;:,]? ", text[: room + 1])]
    clauses = [found.start() for found in re.finditer(r"[.;:,] ", text[: room + 1]) if found.start() > room / 2]
    end = clauses[-1] if clauses else ends[-1] if ends else room
    return f"{text[:end]} …"


def ranges(numbers: Sequence[int]) -> str:
    """Rising whole numbers, three and more in a row as a range.

    Example:
        >>> ranges([1, 2, 4, 5, 6, 9])
        '1, 2, 4–6, 9'
    """
    runs: list[list[int]] = []
    for each in numbers:
        if runs and each == runs[-1][-1] + 1:
            runs[-1].append(each)
        else:
            runs.append([each])
    return ", ".join(f"{run[0]}–{run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)


def counted(number: int) -> str:
    """A number of things, up to twelve as a word.

    Example:
        >>> counted(0), counted(7), counted(40)
        ('no', 'seven', '40')
    """
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
    return words[number] if number < len(words) else str(number)


def hertz(frequency: float) -> str:
    """A frequency to four digits, from 1000 Hz on to a tenth: never in powers of ten that a reader must work out.

    Example:
        >>> hertz(3.66971), hertz(27470.63)
        ('3.67', '27470.6')
    """
    return f"{frequency:.4g}" if frequency < 1000 else f"{frequency:.1f}"


def fit_text(fit: float) -> str:
    """A fit to two digits, a dash where it is not known; one below 0.5 or 0.8 is never rounded up to it.

    Example:
        >>> fit_text(0.4987), fit_text(0.7989), fit_text(0.7647), fit_text(-0.0012)
        ('0.49', '0.79', '0.76', '0.00')
    """
    if not math.isfinite(fit):
        return "–"
    shown = round(fit, 2)
    if any(fit < limit <= shown for limit in (LEAST_FIT, GOOD_FIT)):
        shown = math.floor(100 * fit) / 100
    return f"{shown + 0.0:.2f}"  # + 0.0 makes a negative zero positive


def reproduced(fit: float) -> str:
    """A fit as the share of data kept aside that the model reproduces: no limit is rounded up to, below none is 0 %.

    Example:
        >>> reproduced(0.9712), reproduced(0.7989), reproduced(0.9999), reproduced(-0.3), reproduced(math.nan)
        ('97 %', '79 %', '99 %', '0 %', '–')
    """
    return whole_percent(float(fit_text(fit)) if fit < 0.99 else fit) if math.isfinite(fit) else "–"


def with_interval(value: float, half_width: float) -> str:
    """Value ± half width, both to the second digit of the half width, which is no number where it exceeds the value.

    Example:
        >>> with_interval(3.66971, 0.0123), with_interval(512.0, 1345397.0)
        ('3.670 ± 0.012', 'about 510')
    """
    if not half_width > 0:
        return f"{value:.4g}"
    if half_width >= abs(value):
        return f"about {number(value, 2)}"
    digits = max(0, 1 - math.floor(math.log10(half_width)))
    return f"{value:.{digits}f} ± {half_width:.{digits}f}"


def ratio_text(ratio: float, std: float = math.nan) -> str:
    """A damping ratio in percent, with its 95 % interval where that is known; from nothing on it has an end alone.

    Example:
        >>> ratio_text(0.0123), ratio_text(0.0123, 0.0004), ratio_text(0.002, 0.003), ratio_text(0.002, 40.0)
        ('1.23 %', '1.230 ± 0.078 %', 'under 0.79 %', 'not known')
    """
    if not math.isfinite(ratio):
        return "–"
    half = NINETY_FIVE * std
    if half >= abs(ratio):
        return f"under {percent(ratio + half)}" if 0 <= ratio + half < 1 else "not known"
    return f"{100 * ratio:.2f} %" if not math.isfinite(std) else f"{with_interval(100 * ratio, 100 * half)} %"


def percent(share: float) -> str:
    """A share to two digits, never rounded to all or nothing.

    Example:
        >>> percent(0.861), percent(0.0412), percent(0.9991), percent(12.3)
        ('86 %', '4.1 %', '99.9 %', '1230 %')
    """
    value = 100.0 * share
    if 0.0 < share < 1e-4:
        return "under 0.01 %"
    if 99.5 <= value < 100.0:
        return f"{min(value, 99.9):.1f} %"
    return f"{value:.0f} %" if abs(value) >= 9.95 else f"{value:.2g} %"


def whole_percent(share: float) -> str:
    """A share in whole percent, a dash where it is not known; 100 % is all of it, and chance below nothing is 0 %.

    Example:
        >>> whole_percent(0.999), whole_percent(1.0), whole_percent(-0.001), whole_percent(0.236)
        ('99 %', '100 %', '0 %', '24 %')
    """
    if not math.isfinite(share):
        return "–"
    whole = round(100 * share)
    return f"{99 if whole == 100 and share < 1 else max(0, whole)} %"


def exact_percent(share: float) -> str:
    """A share to three digits, more near a whole that it does not reach.

    Example:
        >>> exact_percent(0.9312), exact_percent(0.99996), exact_percent(1.0000002), exact_percent(-0.2)
        ('93.1 %', '99.99 %', '100 %', '0 %')
    """
    if not math.isfinite(share):
        return "–"
    value = 100.0 * min(max(share, 0.0), 1.0)
    if value in (0.0, 100.0):
        return f"{value:.0f} %"
    if value > 99.0:
        return f"{math.floor(100.0 * value) / 100.0:.2f} %"
    return f"{value:.3g} %"


Subject = Literal["size", "output", "band", "constant", "line", "level", "coherence", "time", "lines", "modes"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Statement:
    """One sentence.

    Attributes:
        subject: what it is about.
        text: the sentence.
    """

    subject: Subject
    text: str


def part(share: float) -> str:
    """A part of a whole in per cent: what is below one is not told apart.

    Example:
        >>> part(0.861), part(0.0004)
        ('86 %', 'under 1 %')
    """
    return percent(share) if share >= 0.0095 else "under 1 %"


def times(ratio: float) -> str:
    """A factor, two digits.

    Example:
        >>> times(3271.3), times(1.234), times(17.9)
        ('3 300 times', '1.2 times', '18 times')
    """
    return f"{float(f'{ratio:.2g}'):,.0f} times".replace(",", " ") if ratio >= 9.95 else f"{ratio:.2g} times"


def number(value: float, digits: int = 3) -> str:
    """So many significant digits; a power of ten only below a thousandth and from a hundred thousand on.

    Example:
        >>> number(0.0012345), number(1234.5), number(403000.0), number(-2.4e-7, 2), number(0.0)
        ('0.00123', '1230', '4.03e5', '-2.4e-7', '0')
    """
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "–"
    rounded = float(f"{value:.{digits - 1}e}")
    power = math.floor(math.log10(abs(rounded)))
    if -4 < power < 5:
        return f"{rounded:.{max(0, digits - 1 - power)}f}"
    return f"{rounded / 10.0**power:.{digits - 1}f}e{power}"


def quantity(value: float, unit: str = "") -> str:
    """Three digits and the unit.

    Example:
        >>> quantity(0.0012345, "m"), quantity(1234.5), quantity(0.0)
        ('0.00123 m', '1230', '0')
    """
    return f"{number(value)} {unit}".rstrip()


def times_floor_text(level: float) -> str:
    """Root mean square over that of the noise, three digits, from a mean square in units of the floor.

    Everything that a person reads is in these units; mean squares are what the engine compares.

    Example:
        >>> times_floor_text(1.0478), times_floor_text(2494.0), times_floor_text(float("inf"))
        ('1.02', '49.9', 'unbounded')
    """
    if not 0.0 <= level < math.inf:
        return "unbounded"
    size = math.sqrt(level)
    return f"{float(f'{size:.3g}'):.0f}" if size >= 100.0 else f"{size:#.3g}"


_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
_MARKDOWN_ALWAYS = re.compile(r"([\\`*\[\]|~$#!@])")
_MARKDOWN_UNDERSCORE = re.compile(r"(?<![^\W_])_|_(?![^\W_])")


def shorten(text: str, limit: int = 40) -> str:
    """At most `limit` characters, for a name in a sentence unless given; the middle goes: its end may carry a number.

    Example:
        >>> shorten("acceleration of the third floor", 15)
        'acceler…d floor'
    """
    if len(text) <= limit:
        return text
    tail = (limit - 1) // 2
    return text[: limit - 1 - tail] + "…" + text[len(text) - tail :]


def plot_label(text: str, *, limit: int = 28) -> str:
    """A name for a picture: visible and short."""
    return shorten(visible(text), limit)


def escape_markdown(text: str) -> str:
    r"""The text as Markdown that renders as itself: no link, no emphasis, no HTML, no table cell.

    Example:
        >>> print(escape_markdown("floor_1 <b> [x](y) |"))
        floor_1 &lt;b&gt; \[x\](y) \|
    """
    escaped = _MARKDOWN_ALWAYS.sub(r"\\\1", visible(text))
    escaped = _MARKDOWN_UNDERSCORE.sub(r"\\_", escaped)
    escaped = re.sub(r"&", "&amp;", escaped).replace("<", "&lt;").replace(">", "&gt;")
    return escaped.replace("://", r"\://").replace("www.", r"www\.")


def csv_cell(text: str) -> str:
    """The text as a spreadsheet cell that is never run as a formula (OWASP: a quote before = + - @).

    Example:
        >>> csv_cell("=1+1")
        "'=1+1"
    """
    if text.startswith(_FORMULA_STARTS) or visible(text).lstrip(" ").startswith(_FORMULA_STARTS):
        return "'" + visible(text)
    return visible(text)
