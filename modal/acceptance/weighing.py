"""Three-valued answers, and the words in which a limit is weighed."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from modal.acceptance.limits import Range
from modal.identification.result import Identification
from modal.wording.numbers import hertz

__all__ = [
    "MAYBE",
    "NO",
    "YES",
    "Answer",
    "Weighed",
    "all_of",
    "any_of",
    "band_text",
    "inside",
    "interval_factor",
    "negated",
    "range_text",
]

Answer = Literal[-1, 0, 1]
"""No, cannot be told, yes."""

NO: Answer = -1
MAYBE: Answer = 0
YES: Answer = 1


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Weighed:
    """What a rule says of a limit.

    Attributes:
        what: the limit is about, where it has no name.
        required: in words.
        found: in words, with the interval.
        answer: yes, no, cannot be told.
        reason: why it is not met or cannot be told; "" where that needs no word.
    """

    what: str
    required: str
    found: str
    answer: Answer
    reason: str = ""


def all_of(answers: Iterable[Answer]) -> Answer:
    """Yes where all are, no where one is.

    Example:
        >>> all_of([YES, MAYBE]), all_of([NO, MAYBE]), all_of([])
        (0, -1, 1)
    """
    return min(answers, default=YES)


def any_of(answers: Iterable[Answer]) -> Answer:
    """Yes where one is, no where all are.

    Example:
        >>> any_of([YES, MAYBE]), any_of([NO, MAYBE]), any_of([])
        (1, 0, -1)
    """
    return max(answers, default=NO)


def negated(answer: Answer) -> Answer:
    """No for yes, yes for no.

    Example:
        >>> negated(YES), negated(MAYBE)
        (-1, 0)
    """
    return YES if answer == NO else NO if answer == YES else MAYBE


def inside(value: float, half_width: float, limits: Range) -> Answer:
    """Whether value ± half width lies inside the limits; an end of the interval on the limit is inside.

    Args:
        value: best estimate.
        half_width: of its interval; nan where that is not known.
        limits: lowest and highest, either may be infinite.

    Example:
        >>> inside(5.0, 0.1, (4.0, 6.0)), inside(5.95, 0.1, (4.0, 6.0)), inside(7.0, 0.1, (4.0, 6.0))
        (1, 0, -1)
    """
    low, high = limits
    if not (math.isfinite(value) and math.isfinite(half_width)):
        return YES if math.isinf(low) and math.isinf(high) else MAYBE
    if low <= value - half_width and value + half_width <= high:
        return YES
    return NO if value + half_width < low or value - half_width > high else MAYBE


def interval_factor(result: Identification) -> float:
    """Half the 95 % interval in standard deviations."""
    return 1.96 if result.uncertainty is None else result.uncertainty.interval_factor(0.95)


def band_text(band: Range | None) -> str:
    """A frequency band as it stands in a sentence.

    Example:
        >>> band_text((3.5, 3.9)), band_text(None)
        ('3.5 to 3.9 Hz', 'any frequency')
    """
    return "any frequency" if band is None else f"{hertz(band[0])} to {hertz(band[1])} Hz"


def range_text(limits: Range) -> str:
    """The range of a damping ratio, in percent.

    Example:
        >>> range_text((0.005, 0.02)), range_text((0.02, math.inf)), range_text((-math.inf, 0.03))
        ('0.5 to 2 %', 'at least 2 %', 'at most 3 %')
    """
    low, high = (100 * value for value in limits)
    if math.isinf(low):
        return f"at most {high:g} %"
    return f"at least {low:g} %" if math.isinf(high) else f"{low:g} to {high:g} %"
