"""What a finished diagnosis must still say of its records, whatever the model.

Nothing is explained, outputs that come before their inputs, a hold that is in doubt.
"""

from dataclasses import replace

from modal.discrepancy.diagnosis import Diagnosis
from modal.discrepancy.explained import explained_words
from modal.discrepancy.hold_hint import hold_words
from modal.discrepancy.statements import number

__all__ = ["early_words", "with_cautions"]


def with_cautions(found: Diagnosis) -> Diagnosis:
    """The diagnosis with a warning more for what its records get wrong, and advice where a hold is in doubt.

    Args:
        found: Of any kind of model.
    """
    warnings = [words for words in (explained_words(found), early_words(found)) if words]
    hold = hold_words(found)
    return replace(
        found,
        warnings=(*warnings, *found.warnings),
        advice=(*found.advice, *((hold,) if hold else ())),
    )


def early_words(found: Diagnosis) -> str:
    """What a negative delay means: no effect answers before its cause; "" where there is none.

    Args:
        found: Of any kind of model.
    """
    delays = [(one.where, one.parameters[0].value) for one in found.findings if one.effect == "input_delay"]
    early = [(where, -delay) for where, delay in delays if delay < 0.0]
    if not early:
        return ""
    where, lead = early[0]
    samples = number(lead / found.fit[0].dt, 3)
    return (
        f"the outputs answer {where} {number(lead, 3)} s ({samples} samples) before it is recorded: no physical effect "
        "does, so the channels are skewed, or the outputs were written down a step after their inputs"
    )
