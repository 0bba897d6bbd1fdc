"""One sentence of evidence and what it is about; numbers as a person writes them."""

from dataclasses import dataclass
from typing import Literal

__all__ = ["Statement", "Subject", "listed", "part", "percent", "quantity", "times"]

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


def percent(share: float) -> str:
    """A share in per cent, two digits, never rounded to all or nothing.

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


def quantity(value: float, unit: str = "") -> str:
    """Three digits and the unit.

    Example:
        >>> quantity(0.0012345, "m"), quantity(1234.5), quantity(0.0)
        ('0.00123 m', '1.23e+03', '0')
    """
    return f"{value:.3g} {unit}".rstrip()


def listed(words: list[str]) -> str:
    """Words joined as a person joins them.

    Example:
        >>> listed(["a", "b", "c"]), listed(["a"])
        ('a, b and c', 'a')
    """
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
