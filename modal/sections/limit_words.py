"""Whether the acceptance limits are met, in one sentence and one word."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from modal.wording.names import shorten

if TYPE_CHECKING:
    from modal.acceptance.check import LimitOutcome

__all__ = ["limits_class", "limits_sentence", "limits_short"]

LONGEST_NAME = 60
"""Letters of the name of a limit in a sentence; the table has the whole of it."""

MOST_NAMED = 3
"""Limits that a sentence names; the table has all of them."""


def limits_sentence(outcomes: "Sequence[LimitOutcome]") -> str:
    """How many limits are met, and which are not; "" where no limit was set."""
    if not outcomes:
        return ""
    missed = [one for one in outcomes if one.state == "not met"]
    unknown = [one for one in outcomes if one.state == "cannot be told"]
    if not missed and not unknown:
        return (
            "The acceptance limit is met." if len(outcomes) == 1 else f"All {len(outcomes)} acceptance limits are met."
        )
    parts = [f"Of {len(outcomes)} acceptance limit{'s' * (len(outcomes) > 1)}"]
    if missed:
        parts.append(f" {len(missed)} {'is' if len(missed) == 1 else 'are'} not met ({_names(missed)})")
    if unknown:
        also = " and" if missed else ""
        parts.append(f"{also} {len(unknown)} cannot be told ({_names(unknown)})")
    return "".join(parts) + "."


def limits_short(outcomes: "Sequence[LimitOutcome]") -> str:
    """For the row of facts, e.g. "2 of 3"."""
    return f"{sum(one.state == 'met' for one in outcomes)} of {len(outcomes)}"


def limits_class(state: str) -> str:
    """The colour that a state has in the tables: that of a system mode, a doubtful one, or a fault."""
    return {"met": "system", "cannot be told": "doubtful"}.get(state, "fault")


def _names(outcomes: "Sequence[LimitOutcome]") -> str:
    names = [shorten(one.what, LONGEST_NAME) for one in outcomes[:MOST_NAMED]]
    rest = f" and {len(outcomes) - MOST_NAMED} more" if len(outcomes) > MOST_NAMED else ""
    return ", ".join(names) + rest
