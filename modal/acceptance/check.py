"""Limits of acceptance: met, not met, or not to be told, because the interval of a value straddles its limit.

Three answers need a logic of three values (Kleene): no < cannot be told < yes, "and" is the least, "or" the greatest of
the parts, "not" turns the order round. A value is weighed by its 95 % interval: wholly inside the limits is yes, wholly
outside is no, anything else cannot be told, and so is a value whose uncertainty is not known. A pole whose verdict is
doubtful may or may not be a mode. And where nothing was driven, or nothing could be seen, no mode can be missed.

References:
    Kleene, Introduction to Metamathematics, North-Holland, 1952, section 64 (strong three-valued logic).
    JCGM 106:2012, Evaluation of measurement data - The role of measurement uncertainty in conformity assessment, 8.3
    (guarded acceptance: what is not surely inside is not accepted).
"""

from dataclasses import dataclass
from typing import Literal

from modal.acceptance.acceptance_modes import (
    check_damping,
    check_expected,
    check_forbidden,
    check_settled,
    check_uncertainty,
)
from modal.acceptance.acceptance_values import check_count, check_fit, check_trust
from modal.acceptance.limits import (
    DampingRange,
    FitAtLeast,
    Limit,
    ModeCount,
    ModeExpected,
    ModeForbidden,
    SettledVerdicts,
    TrustAtLeast,
    UncertaintyAtMost,
)
from modal.acceptance.test_file import Specification
from modal.acceptance.weighing import Weighed
from modal.identification.result import Identification

__all__ = ["LimitOutcome", "LimitState", "all_met", "check_limits"]

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
