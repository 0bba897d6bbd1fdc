"""What a finished diagnosis must still say of its records, whatever the model.

Nothing is explained, a channel is spoiled, outputs come before their inputs, a hold is in doubt.
"""

from collections.abc import Sequence
from dataclasses import replace

from modal.discrepancy.explained import explained_words
from modal.discrepancy.results import Diagnosis
from modal.discrepancy.validation.hold_hint import hold_words
from modal.quality.check import spoiled_channels
from modal.structure.internal_changes import INTERNAL_FORCE
from modal.wording.statements import number
from okid.record import Record

__all__ = ["early_words", "free_words", "spoiled_words", "with_cautions"]


def with_cautions(found: Diagnosis) -> Diagnosis:
    """The diagnosis with a warning more for what its records get wrong, and advice where a hold is in doubt.

    Args:
        found: Of any kind of model.
    """
    warnings = [words for words in (explained_words(found), early_words(found)) if words]
    warnings += spoiled_words(found) + free_words(found)
    hold = hold_words(found)
    return replace(
        found,
        warnings=(*warnings, *found.warnings),
        advice=(*found.advice, *((hold,) if hold else ())),
    )


def spoiled_words(found: Diagnosis) -> list[str]:
    """What spoils the records themselves: a clipped output, spikes, a dead output.

    No effect of a model explains these, and one may be found that only stands for them; friction does hold a mass
    still, and play takes away coherence.

    Args:
        found: Of any kind of model.
    """
    sentences: dict[tuple[str, tuple[str, ...]], str] = {}
    for name, records in (("to fit", found.fit), ("held out", found.held_out)):
        for one in spoiled_channels(_alike(records)):
            if one.level == "bad" and set(one.channels) <= set(records[0].output_names):
                sentences.setdefault((one.what, one.channels), f"the records {name} are spoiled: {one.sentence}")
    return list(sentences.values())


def free_words(found: Diagnosis) -> list[str]:
    """What a calibration may take up that is free in every force between the states of a state space.

    Args:
        found: Of any kind of model.
    """
    free = [one for one in found.calibrated if one.name.startswith(INTERNAL_FORCE)]
    gains = any(one.effect in {"input_gain", "sensor_gain"} for one in found.findings)
    if not free or gains:
        return []
    words = (
        f"the state space is not recognised as a structure, so its calibration is free in {len(free)} numbers, which "
        "can take up the gain of a sensor or an input: whether a gain is wrong is not known; pass M, C and K to know"
    )
    return [words]


def _alike(records: Sequence[Record]) -> list[Record]:
    """The records with the channel names and units of the first: a diagnosis goes by the order of the channels."""
    first = records[0]
    return [
        replace(
            record,
            input_names=first.input_names,
            output_names=first.output_names,
            input_units=first.input_units,
            output_units=first.output_units,
            input_hold=first.input_hold,
        )
        for record in records
    ]


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
