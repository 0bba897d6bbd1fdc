"""Limits of acceptance: met, not met, or not to be told, because the interval of a value straddles its limit.

Three answers need a logic of three values (Kleene): no < cannot be told < yes, "and" is the least, "or" the greatest of
the parts, "not" turns the order round. A value is weighed by its 95 % interval: wholly inside the limits is yes, wholly
outside is no, anything else cannot be told, and so is a value whose uncertainty is not known. A pole whose verdict is
doubtful may or may not be a mode. And where nothing was driven, or nothing could be seen, no mode can be missed.

Only vibration modes count: an overdamped pole has no frequency to lie in a band. Noise poles do not exist here; a
doubtful one may.

References:
    Kleene, Introduction to Metamathematics, North-Holland, 1952, section 64 (strong three-valued logic).
    JCGM 106:2012, Evaluation of measurement data - The role of measurement uncertainty in conformity assessment, 8.3
    (guarded acceptance: what is not surely inside is not accepted).
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from modal.acceptance.test_file import AcceptanceLimit, Range, Specification
from modal.identification.result import Identification
from modal.identification.words import damping_text, frequency_text, trust_of
from modal.modes.mode import Mode
from modal.wording.text import MOST_NAMED, fit_text, hertz
from okid.display import Displayed

LEVEL = 0.95
"""Weigh a value by the interval that holds it with this probability."""

ANY: Range = (-math.inf, math.inf)

Answer = Literal[-1, 0, 1]
"""No, cannot be told, yes."""

NO: Answer = -1
MAYBE: Answer = 0
YES: Answer = 1

LimitState = Literal["met", "not met", "cannot be told"]

_STATES: dict[int, LimitState] = {1: "met", 0: "cannot be told", -1: "not met"}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class LimitOutcome(Displayed):
    """What became of one limit.

    Attributes:
        what: the limit's name, or what it is about.
        required: what it asks for, in words.
        found: what the result has, with its interval.
        state: "met", "not met" or "cannot be told".
        sentence: all of it, with the reason.
        reason: why it is not met or cannot be told; "" where the numbers say so themselves.
    """

    what: str
    required: str
    found: str
    state: LimitState
    sentence: str
    reason: str = ""

    @property
    def met(self) -> bool:
        """Whether the limit is surely met."""
        return self.state == "met"


def check_limits(result: Identification, specification: Specification) -> tuple[LimitOutcome, ...]:
    """Weigh a result against every limit of a specification.

    Args:
        result: of `modal.identify`.
        specification: of `modal.acceptance.test_file.read_specification`.

    Returns:
        One outcome a limit, in the order of the specification.
    """
    return tuple(_RULES[limit.kind][1](limit, result) for limit in specification.limits)


def all_met(outcomes: tuple[LimitOutcome, ...]) -> bool:
    """Whether every limit is surely met; true where there is none.

    Example:
        >>> all_met(())
        True
    """
    return all(outcome.met for outcome in outcomes)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Candidate:
    """A pole that may be a mode, with what is asked of it."""

    mode: Mode
    exists: Answer
    in_band: Answer
    in_range: Answer

    @property
    def present(self) -> Answer:
        """Whether there is a mode in the band here."""
        return all_of((self.exists, self.in_band))


def _candidates(result: Identification, band: Range | None = None, damping: Range = ANY) -> list[_Candidate]:
    """The vibration modes and doubtful poles of a result, each with what is asked of it."""
    factor = interval_factor(result)
    return [
        _Candidate(
            mode=mode,
            exists=YES if mode.verdict == "system" else MAYBE,
            in_band=inside(mode.frequency, factor * mode.frequency_std, band or ANY),
            in_range=inside(
                mode.damping_ratio, factor * (mode.damping_ratio_std if mode.damping_resolved else math.nan), damping
            ),
        )
        for mode in result.modes
        if mode.kind == "oscillatory" and mode.verdict != "noise"
    ]


def _why_maybe(one: _Candidate) -> str:
    """The first of the parts that cannot be told."""
    if one.exists == MAYBE:
        return "the data do not settle whether that pole is a mode"
    if one.in_band == MAYBE:
        known = math.isfinite(one.mode.frequency_std)
        return f"the interval of its frequency {'straddles the edge of the band' if known else 'is not known'}"
    if not one.mode.damping_resolved:
        return "its damping is not resolved"
    known = math.isfinite(one.mode.damping_ratio_std)
    return f"the interval of its damping ratio {'straddles the limit' if known else 'is not known'}"


def _named(several: Sequence[_Candidate], none: str, *, with_damping: bool = False) -> str:
    """The modes with their intervals, the surest first."""
    if not several:
        return none
    ordered = sorted(several, key=lambda one: -one.exists)
    words = []
    for one in ordered[:MOST_NAMED]:
        kind = "a mode" if one.exists == YES else "a doubtful pole"
        damping = f", damping {damping_text(one.mode)}" if with_damping else ""
        words.append(f"{kind} at {frequency_text(one.mode)} Hz{damping}")
    more = f" and {len(ordered) - MOST_NAMED} more" if len(ordered) > MOST_NAMED else ""
    return "; ".join(words) + more


def _expected(limit: AcceptanceLimit, result: Identification) -> LimitOutcome:
    """A mode of the system in the band, with its damping in the range."""
    band, damping = limit.frequency or ANY, limit.damping or ANY
    several = _candidates(result, band, damping)
    answer = any_of(all_of((one.present, one.in_range)) for one in several)
    near = [one for one in several if one.present != NO]
    best = max(near, key=lambda one: (one.present, one.in_range), default=None)
    reason = ""
    if best is None:
        reason = blind_part(result, band)
        answer = MAYBE if reason else NO
    elif answer != YES:
        reason = _why_maybe(best) if answer == MAYBE else "its damping ratio is outside the range"
    with_damping = f" with a damping ratio of {range_text(damping)}" if limit.damping else ""
    return _outcome(
        limit,
        required=f"a mode in {band_text(band)}{with_damping}",
        found=_named(near, "no mode there", with_damping=limit.damping is not None),
        answer=answer,
        reason=reason,
    )


def _forbidden(limit: AcceptanceLimit, result: Identification) -> LimitOutcome:
    """No mode of the system in the band; where nothing could be seen, that cannot be told."""
    band = limit.frequency or ANY
    near = [one for one in _candidates(result, band) if one.present != NO]
    answer = negated(any_of(one.present for one in near))
    reason = _why_maybe(max(near, key=lambda one: one.present)) if answer == MAYBE else ""
    blind = blind_part(result, band)
    if answer == YES and blind:
        answer, reason = MAYBE, blind
    return _outcome(
        limit, required=f"no mode in {band_text(band)}", found=_named(near, "none"), answer=answer, reason=reason
    )


def _count(limit: AcceptanceLimit, result: Identification) -> LimitOutcome:
    """Number of vibration modes of the system; each doubtful pole may be one more."""
    several = _candidates(result)
    n_sure = sum(one.exists == YES for one in several)
    n_doubtful = len(several) - n_sure
    answer = inside(n_sure + 0.5 * n_doubtful, 0.5 * n_doubtful, (limit.at_least, limit.at_most))
    poles = "pole" if n_doubtful == 1 else "poles"
    return _outcome(
        limit,
        required=_count_text(limit),
        found=f"{n_sure} of the system" + (f", {n_doubtful} doubtful {poles}" if n_doubtful else ""),
        answer=answer,
        reason="a doubtful pole may or may not be a mode" if answer == MAYBE else "",
    )


def _damping(limit: AcceptanceLimit, result: Identification) -> LimitOutcome:
    """The damping ratio of every mode in the band."""
    limits = limit.at_least, limit.at_most
    several = [one for one in _candidates(result, limit.frequency, limits) if one.present != NO]
    answer = all_of(any_of((negated(one.present), one.in_range)) for one in several)
    wrong = [one for one in several if any_of((negated(one.present), one.in_range)) == answer]
    reason = _why_maybe(wrong[0]) if answer == MAYBE else ""
    if not several:
        answer, reason = MAYBE, "there is no mode to weigh"
    return _outcome(
        limit,
        required=f"damping ratio of every mode at {band_text(limit.frequency)} {range_text(limits)}",
        found=_named(several if answer == YES else wrong, "no mode there", with_damping=True),
        answer=answer,
        reason=reason,
    )


def _fit(limit: AcceptanceLimit, result: Identification) -> LimitOutcome:
    """Cross-validated fit; its interval is that of the mean over folds (Student's t)."""
    value, half_width = result.fit.mean, _fold_interval(result)
    answer = inside(value, half_width, (limit.at_least, math.inf))
    found = f"{fit_text(value)}" if math.isfinite(value) else "no fit on held-out data is known"
    reason = "its interval over the folds straddles the limit" if answer == MAYBE else ""
    if math.isfinite(half_width) and math.isfinite(value):
        found = f"{value:.4f} ± {half_width:.4f}"
    elif answer == MAYBE:
        reason = "one fold alone tells no interval" if math.isfinite(value) else "there is no value to weigh"
    return _outcome(limit, required=f"at least {limit.at_least:g}", found=found, answer=answer, reason=reason)


def _uncertainty(limit: AcceptanceLimit, result: Identification) -> LimitOutcome:
    """Half the 95 % interval of every mode of the system in the band, as a share of the value."""
    factor = interval_factor(result)
    parts = ((limit.frequency_at_most, "frequency"), (limit.damping_at_most, "damping"))
    weighed: list[tuple[float, str]] = []  # how far a share is above what is allowed, and the share in words
    for one in _candidates(result, limit.frequency):
        mode = one.mode
        if one.exists != YES or one.in_band == NO:
            continue
        damping_std = mode.damping_ratio_std if mode.damping_resolved else math.nan
        stds = ((mode.frequency_std, mode.frequency), (damping_std, mode.damping_ratio))
        for (most, what), (std, value) in zip(parts, stds, strict=True):
            if most is not None:
                share = factor * std / abs(value) if value else math.nan
                size = f"{100 * share:.2g} %" if math.isfinite(share) else "not known"
                weighed.append((share - most, f"{what} of the mode at {frequency_text(mode)} Hz: {size}"))
    answer, reason = MAYBE, "there is no mode of the system to weigh"
    if weighed:
        answer = all_of(MAYBE if math.isnan(over) else YES if over <= 0 else NO for over, _ in weighed)
        reason = "an interval is not known" if answer == MAYBE else ""
    if answer == NO:
        weighed = [one for one in weighed if one[0] > 0]  # what is surely too wide, before what is not known
    found = max(weighed, key=lambda one: math.inf if math.isnan(one[0]) else one[0], default=(0.0, "none"))[1]
    names = {"frequency": "the frequency", "damping": "the damping ratio"}
    shares = " and ".join(f"{100 * most:g} % of {names[what]}" for most, what in parts if most is not None)
    return _outcome(
        limit,
        required=f"half the 95 % interval at most {shares} for every mode at {band_text(limit.frequency)}",
        found=found,
        answer=answer,
        reason=reason,
    )


def _settled(limit: AcceptanceLimit, result: Identification) -> LimitOutcome:
    """No doubtful pole in the band."""
    several = _candidates(result, limit.frequency)
    doubtful = [one for one in several if one.exists == MAYBE and one.in_band != NO]
    answer = negated(any_of(one.in_band for one in doubtful))
    return _outcome(
        limit,
        required=f"no doubtful pole at {band_text(limit.frequency)}",
        found=_named(doubtful, "none"),
        answer=answer,
        reason="the interval of its frequency reaches into the band" if answer == MAYBE else "",
    )


def _trust(limit: AcceptanceLimit, result: Identification) -> LimitOutcome:
    """How far the result as a whole can be relied on."""
    found = trust_of(result).trust
    met = found in ("carried", limit.trust)
    wanted = 'the result reliable ("carried")' if limit.trust == "carried" else 'at least "with care"'
    return _outcome(limit, required=wanted, found=f'"{found}"', answer=YES if met else NO)


_RULES: dict[str, tuple[str, Callable[[AcceptanceLimit, Identification], LimitOutcome]]] = {
    "mode": ("mode expected", _expected),
    "no_mode": ("no mode allowed", _forbidden),
    "n_modes": ("number of modes", _count),
    "damping": ("damping", _damping),
    "fit": ("cross-validated fit", _fit),
    "uncertainty": ("uncertainty", _uncertainty),
    "settled": ("settled verdicts", _settled),
    "trust": ("trust in the result", _trust),
}
"""What each kind of limit is about, where it has no name, and how it is weighed."""


def _outcome(limit: AcceptanceLimit, *, required: str, found: str, answer: Answer, reason: str = "") -> LimitOutcome:
    state, what = _STATES[answer], limit.name or _RULES[limit.kind][0]
    because = f", because {reason}" if reason else ""
    return LimitOutcome(
        what=what,
        required=required,
        found=found,
        state=state,
        sentence=f"{what[:1].upper()}{what[1:]}: {state}{because}. Wanted: {required}; found: {found}.",
        reason=reason,
    )


def _count_text(limit: AcceptanceLimit) -> str:
    least, most = f"{limit.at_least:g}", f"{limit.at_most:g}"
    if math.isinf(limit.at_most):
        return f"at least {least}"
    if limit.at_least <= 0:
        return f"at most {most}"
    return f"{least}" if limit.at_least == limit.at_most else f"{least} to {most}"


def _fold_interval(result: Identification) -> float:
    """Half the 95 % interval of the mean fit, from the spread over the folds; nan where there are fewer than two."""
    folds = result.fit.folds[np.isfinite(result.fit.folds)]
    if folds.size < 2:
        return math.nan
    return float(scipy.special.stdtrit(folds.size - 1, 0.5 * (1 + LEVEL)) * folds.std(ddof=1) / math.sqrt(folds.size))


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
    if result.uncertainty is None:
        return float(scipy.special.ndtri(0.5 * (1 + LEVEL)))
    return result.uncertainty.interval_factor(LEVEL)


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


def blind_part(result: Identification, band: Range) -> str:
    """Why a mode in the band could have been missed; "" where every part of it was seen."""
    nyquist = 0.5 / result.realisation.dt
    if band[1] > nyquist:
        return f"the band reaches above {nyquist:.4g} Hz, half the sampling frequency of the identified record"
    if not result.channels.n_inputs:
        return ""  # what drove the structure is not known; it is for the verdicts to doubt
    if result.response is not None:
        f = result.response.frequencies
        dark = uncovered(band, [(float(f[0]), float(f[-1]))])
        return f"the table has no lines at {band_text(dark[0])}" if dark else ""
    excited = () if result.excitation is None else result.excitation.excited_bands
    dark = uncovered(band, (pair for bands in excited for pair in bands))
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
