"""One sentence of evidence and what it is about; numbers as a person writes them."""

import math
from dataclasses import dataclass
from typing import Literal

from modal.wording.numbers import percent

__all__ = ["Statement", "Subject", "number", "part", "quantity", "times", "times_floor_text"]

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
