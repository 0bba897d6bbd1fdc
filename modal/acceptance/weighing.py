"""Three-valued answers, and the words in which a limit is weighed.

Limits on the result as a whole: number of modes, fit, trust.

Where a mode could have been seen at all: below half the sampling frequency, and where some input moved.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from modal.acceptance.limits import FitAtLeast, ModeCount, Range, TrustAtLeast
from modal.identification.result import Identification
from modal.identification.words import trust_of
from modal.wording.numbers import fit_text, hertz

__all__ = [
    "MAYBE",
    "NO",
    "YES",
    "Answer",
    "Weighed",
    "all_of",
    "any_of",
    "band_text",
    "blind_part",
    "check_count",
    "check_fit",
    "check_trust",
    "inside",
    "interval_factor",
    "negated",
    "range_text",
    "uncovered",
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


_RANK = {"not carried": 0, "with care": 1, "carried": 2}


def check_count(limit: ModeCount, result: Identification) -> Weighed:
    """Number of vibration modes of the system; each doubtful pole may be one more."""
    n_sure = sum(mode.kind == "oscillatory" and mode.verdict == "system" for mode in result.modes)
    n_doubtful = sum(mode.kind == "oscillatory" and mode.verdict == "doubtful" for mode in result.modes)
    if limit.at_least <= n_sure and n_sure + n_doubtful <= limit.at_most:
        answer: Answer = YES
    elif n_sure + n_doubtful < limit.at_least or n_sure > limit.at_most:
        answer = NO
    else:
        answer = MAYBE
    poles = "pole" if n_doubtful == 1 else "poles"
    return Weighed(
        what="number of modes",
        required=_count_text(limit),
        found=f"{n_sure} of the system" + (f", {n_doubtful} doubtful {poles}" if n_doubtful else ""),
        answer=answer,
        reason="a doubtful pole may or may not be a mode" if answer == MAYBE else "",
    )


def check_fit(limit: FitAtLeast, result: Identification) -> Weighed:
    """Cross-validated fit; its interval is that of the mean over folds (Student's t)."""
    value, half_width = result.fit.mean, _fold_interval(result)
    answer = inside(value, half_width, (limit.at_least, math.inf))
    found = f"{fit_text(value)}" if math.isfinite(value) else "no fit on held-out data is known"
    if math.isfinite(half_width) and math.isfinite(value):
        found = f"{value:.4f} ± {half_width:.4f}"
    reason = "its interval over the folds straddles the limit" if answer == MAYBE else ""
    if answer == MAYBE and not math.isfinite(half_width):
        reason = "one fold alone tells no interval" if math.isfinite(value) else "there is no value to weigh"
    return Weighed(
        what="cross-validated fit",
        required=f"at least {limit.at_least:g}",
        found=found,
        answer=answer,
        reason=reason,
    )


def check_trust(limit: TrustAtLeast, result: Identification) -> Weighed:
    """How far the data carry the result as a whole."""
    judgement = trust_of(result)
    met = _RANK[judgement.trust] >= _RANK[limit.at_least]
    wanted = 'the data carry it ("carried")' if limit.at_least == "carried" else 'at least "with care"'
    return Weighed(
        what="trust in the result",
        required=wanted,
        found=f'"{judgement.trust}"',
        answer=YES if met else NO,
    )


def _count_text(limit: ModeCount) -> str:
    least, most = f"{limit.at_least:g}", f"{limit.at_most:g}"
    if math.isinf(limit.at_most):
        return f"at least {least}"
    if not limit.at_least:
        return f"at most {most}"
    return f"{least}" if limit.at_least == limit.at_most else f"{least} to {most}"


def _fold_interval(result: Identification) -> float:
    """Half the 95 % interval of the mean fit, from the spread over the folds; nan where there are fewer than two."""
    folds = result.fit.folds[np.isfinite(result.fit.folds)]
    if folds.size < 2:
        return math.nan
    return float(scipy.special.stdtrit(folds.size - 1, 0.975) * folds.std(ddof=1) / math.sqrt(folds.size))


def blind_part(result: Identification, band: Range) -> str:
    """Why a mode in the band could have been missed; "" where every part of it was seen.

    Args:
        result: of `modal.identify`.
        band: [Hz].
    """
    nyquist = 0.5 / result.records[0].dt
    if band[1] > nyquist:
        return f"the band reaches above {nyquist:.4g} Hz, half the sampling frequency of the identified record"
    if not result.records[0].n_inputs:
        return ""  # what drove the structure is not known; it is for the verdicts to doubt
    dark = uncovered(band, (pair for bands in result.excitation.excited_bands for pair in bands))
    return f"no input moved at {band_text(dark[0])}" if dark else ""


def uncovered(band: Range, pieces: Iterable[Range]) -> tuple[Range, ...]:
    """The parts of a band that no piece covers, from low to high.

    Example:
        >>> uncovered((1.0, 5.0), [(0.0, 2.0), (3.0, 4.0), (1.5, 2.5)])
        ((2.5, 3.0), (4.0, 5.0))
    """
    low, high = band
    parts = []
    for start, end in sorted(pieces):
        if start > low:
            parts.append((low, min(start, high)))
        low = max(low, end)
        if low >= high:
            break
    if low < high:
        parts.append((low, high))
    return tuple(parts)
