"""What a finished diagnosis must still say of its records, whatever the model: nothing explained, a doubted hold."""

from dataclasses import replace

from modal.discrepancy.diagnosis import Diagnosis
from modal.discrepancy.explained import explained_words
from modal.discrepancy.hold_hint import hold_words

__all__ = ["with_cautions"]


def with_cautions(found: Diagnosis) -> Diagnosis:
    """The diagnosis with one warning more where it explains nothing, one piece of advice more where a hold is in doubt.

    Args:
        found: Of any kind of model.
    """
    nothing, hold = explained_words(found), hold_words(found)
    return replace(
        found,
        warnings=(*((nothing,) if nothing else ()), *found.warnings),
        advice=(*found.advice, *((hold,) if hold else ())),
    )
