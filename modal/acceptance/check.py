"""Limits of acceptance: met, not met, or not to be told, because the interval of a value straddles its limit.

Three answers need a logic of three values (Kleene): no < cannot be told < yes, "and" is the least, "or" the greatest of
the parts, "not" turns the order round. A value is weighed by its 95 % interval: wholly inside the limits is yes, wholly
outside is no, anything else cannot be told, and so is a value whose uncertainty is not known. A pole whose verdict is
doubtful may or may not be a mode. And where nothing was driven, or nothing could be seen, no mode can be missed.

References:
    Kleene, Introduction to Metamathematics, North-Holland, 1952, section 64 (strong three-valued logic).
    JCGM 106:2012, Evaluation of measurement data - The role of measurement uncertainty in conformity assessment, 8.3
    (guarded acceptance: what is not surely inside is not accepted).

Limits on single modes: one expected, one forbidden, damping, uncertainty, settled verdicts.

Only vibration modes count: an overdamped pole has no frequency to lie in a band. Noise poles do not exist here; a
doubtful one may.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from modal.acceptance.limits import (
    DampingRange,
    FitAtLeast,
    Limit,
    ModeCount,
    ModeExpected,
    ModeForbidden,
    Range,
    SettledVerdicts,
    TrustAtLeast,
    UncertaintyAtMost,
)
from modal.acceptance.test_file import Specification
from modal.acceptance.weighing import (
    MAYBE,
    NO,
    YES,
    Answer,
    Weighed,
    all_of,
    any_of,
    band_text,
    blind_part,
    check_count,
    check_fit,
    check_trust,
    inside,
    interval_factor,
    negated,
    range_text,
)
from modal.identification.result import Identification
from modal.identification.words import damping_text, frequency_text
from modal.modes.mode import Mode

__all__ = [
    "LimitOutcome",
    "LimitState",
    "all_met",
    "check_damping",
    "check_expected",
    "check_forbidden",
    "check_limits",
    "check_settled",
    "check_uncertainty",
]

MOST_NAMED = 3
"""Modes named in a sentence."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Candidate:
    """A pole that may be a mode, with what is asked of it.

    Attributes:
        mode: itself.
        exists: whether it is a mode of the system.
        in_band: whether its frequency lies in the band.
        in_range: whether its damping ratio lies in the range.
    """

    mode: Mode
    exists: Answer
    in_band: Answer
    in_range: Answer

    @property
    def present(self) -> Answer:
        """Whether there is a mode in the band here."""
        return all_of((self.exists, self.in_band))


def check_expected(limit: ModeExpected, result: Identification) -> Weighed:
    """A mode of the system in the band, with its damping in the range."""
    damping = limit.damping or (-math.inf, math.inf)
    several = _candidates(result, limit.frequency, damping)
    answer = any_of(all_of((one.present, one.in_range)) for one in several)
    near = [one for one in several if one.present != NO]
    best = max(near, key=lambda one: (one.present, one.in_range), default=None)
    reason = ""
    if best is None:
        blind = blind_part(result, limit.frequency)
        answer, reason = (MAYBE, blind) if blind else (NO, "")
    elif answer == MAYBE:
        reason = _why_maybe(best)
    elif answer == NO:
        reason = "its damping ratio is outside the range"
    required = f"a mode in {band_text(limit.frequency)}"
    return Weighed(
        what="mode expected",
        required=required + (f" with a damping ratio of {range_text(damping)}" if limit.damping else ""),
        found=_named(near, "no mode there", with_damping=limit.damping is not None),
        answer=answer,
        reason=reason,
    )


def check_forbidden(limit: ModeForbidden, result: Identification) -> Weighed:
    """No mode of the system in the band; where nothing could be seen, that cannot be told."""
    several = _candidates(result, limit.frequency, (-math.inf, math.inf))
    answer = negated(any_of(one.present for one in several))
    near = [one for one in several if one.present != NO]
    reason = _why_maybe(max(near, key=lambda one: one.present)) if answer == MAYBE else ""
    blind = blind_part(result, limit.frequency)
    if answer == YES and blind:
        answer, reason = MAYBE, blind
    return Weighed(
        what="no mode allowed",
        required=f"no mode in {band_text(limit.frequency)}",
        found=_named(near, "none"),
        answer=answer,
        reason=reason,
    )


def check_damping(limit: DampingRange, result: Identification) -> Weighed:
    """The damping ratio of every mode in the band."""
    several = [one for one in _candidates(result, limit.frequency, limit.damping) if one.present != NO]
    answer = all_of(any_of((negated(one.present), one.in_range)) for one in several)
    wrong = [one for one in several if any_of((negated(one.present), one.in_range)) == answer]
    reason = ""
    if not several:
        answer, reason = MAYBE, "there is no mode to weigh"
    elif answer == MAYBE:
        reason = _why_maybe(wrong[0])
    shown = several if answer == YES else wrong
    return Weighed(
        what="damping",
        required=f"damping ratio of every mode at {band_text(limit.frequency)} {range_text(limit.damping)}",
        found=_named(shown, "no mode there", with_damping=True),
        answer=answer,
        reason=reason,
    )


def check_uncertainty(limit: UncertaintyAtMost, result: Identification) -> Weighed:
    """Half the 95 % interval of every mode of the system in the band, as a share of the value."""
    factor = interval_factor(result)
    several = _candidates(result, limit.frequency, (-math.inf, math.inf))
    modes = [one.mode for one in several if one.exists == YES and one.in_band != NO]
    worst: list[tuple[float, str]] = []
    for mode in modes:
        frequency = _share(factor * mode.frequency_std, mode.frequency)
        damping = _share(factor * mode.damping_ratio_std, mode.damping_ratio) if mode.damping_resolved else math.nan
        for share, most, what in (
            (frequency, limit.frequency_share, "frequency"),
            (damping, limit.damping_share, "damping"),
        ):
            if most is not None:
                worst.append((math.nan if math.isnan(share) else share - most, _share_text(share, what, mode)))
    answer, reason = MAYBE, "there is no mode of the system to weigh"
    if worst:
        answer = all_of(MAYBE if math.isnan(over) else YES if over <= 0 else NO for over, _ in worst)
        reason = "an interval is not known" if answer == MAYBE else ""
    if answer == NO:
        worst = [one for one in worst if one[0] > 0]  # what is surely too wide, before what is not known
    found = max(worst, key=lambda one: math.inf if math.isnan(one[0]) else one[0], default=(0.0, "none"))[1]
    parts = ((limit.frequency_share, "the frequency"), (limit.damping_share, "the damping ratio"))
    shares = " and ".join(f"{100 * share:g} % of {what}" for share, what in parts if share is not None)
    return Weighed(
        what="uncertainty",
        required=f"half the 95 % interval at most {shares} for every mode at {band_text(limit.frequency)}",
        found=found,
        answer=answer,
        reason=reason,
    )


def check_settled(limit: SettledVerdicts, result: Identification) -> Weighed:
    """No doubtful pole in the band."""
    several = _candidates(result, limit.frequency, (-math.inf, math.inf))
    doubtful = [one for one in several if one.exists == MAYBE and one.in_band != NO]
    answer = negated(any_of(one.in_band for one in doubtful))
    return Weighed(
        what="settled verdicts",
        required=f"no doubtful pole at {band_text(limit.frequency)}",
        found=_named(doubtful, "none"),
        answer=answer,
        reason="the interval of its frequency reaches into the band" if answer == MAYBE else "",
    )


def _candidates(result: Identification, band: Range | None, damping: Range) -> list[_Candidate]:
    factor = interval_factor(result)
    return [
        _Candidate(
            mode=mode,
            exists=YES if mode.verdict == "system" else MAYBE,
            in_band=inside(mode.frequency, factor * mode.frequency_std, band or (-math.inf, math.inf)),
            in_range=_damping_inside(mode, factor, damping),
        )
        for mode in result.modes
        if mode.kind == "oscillatory" and mode.verdict != "noise"
    ]


def _damping_inside(mode: Mode, factor: float, limits: Range) -> Answer:
    std = mode.damping_ratio_std if mode.damping_resolved else math.nan
    return inside(mode.damping_ratio, factor * std, limits)


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


def _share(half_width: float, value: float) -> float:
    return half_width / abs(value) if value else math.nan


def _share_text(share: float, what: str, mode: Mode) -> str:
    size = f"{100 * share:.2g} %" if math.isfinite(share) else "not known"
    return f"{what} of the mode at {frequency_text(mode)} Hz: {size}"


LimitState = Literal["met", "not met", "cannot be told"]

_STATES: dict[int, LimitState] = {1: "met", 0: "cannot be told", -1: "not met"}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LimitOutcome:
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
    return tuple(_outcome(limit, result) for limit in specification.limits)


def all_met(outcomes: tuple[LimitOutcome, ...]) -> bool:
    """Whether every limit is surely met; true where there is none.

    Example:
        >>> all_met(())
        True
    """
    return all(outcome.met for outcome in outcomes)


def _outcome(limit: Limit, result: Identification) -> LimitOutcome:
    weighed = _weigh(limit, result)
    state = _STATES[weighed.answer]
    what = limit.name or weighed.what
    because = f", because {weighed.reason}" if weighed.reason else ""
    return LimitOutcome(
        what=what,
        required=weighed.required,
        found=weighed.found,
        state=state,
        sentence=f"{what[:1].upper()}{what[1:]}: {state}{because}. Wanted: {weighed.required}; found: {weighed.found}.",
        reason=weighed.reason,
    )


def _weigh(limit: Limit, result: Identification) -> Weighed:
    match limit:
        case ModeExpected():
            weighed = check_expected(limit, result)
        case ModeForbidden():
            weighed = check_forbidden(limit, result)
        case ModeCount():
            weighed = check_count(limit, result)
        case DampingRange():
            weighed = check_damping(limit, result)
        case FitAtLeast():
            weighed = check_fit(limit, result)
        case UncertaintyAtMost():
            weighed = check_uncertainty(limit, result)
        case SettledVerdicts():
            weighed = check_settled(limit, result)
        case TrustAtLeast():
            weighed = check_trust(limit, result)
    return weighed
