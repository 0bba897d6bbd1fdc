"""What a finished diagnosis must still say of its records and numbers, whatever the model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.nodes import Node
from modal.discrepancy.results import Diagnosis, explained_words
from modal.discrepancy.selection.decision import doubted_gain
from modal.discrepancy.validation.other_hold import hold_words
from modal.preparation.faults import spoiled_channels
from modal.structure.reciprocity import INTERNAL_FORCE
from modal.wording.numbers import number
from okid.arrays import FloatArray
from okid.readers.units import unit_error
from okid.record import Record

__all__ = ["early_words", "free_words", "grid_error", "spoiled_words", "unit_words", "with_cautions"]


def with_cautions(found: Diagnosis) -> Diagnosis:
    """The diagnosis with a warning more for what its records get wrong, and advice where a hold is in doubt."""
    warnings = [words for words in (explained_words(found), early_words(found)) if words]
    units, vague = unit_words(found)
    warnings += spoiled_words(found) + free_words(found) + units
    hold = hold_words(found)
    return replace(
        found,
        warnings=(*warnings, *(words for words in found.warnings if words not in vague)),
        advice=(*found.advice, *((hold,) if hold else ())),
    )


def spoiled_words(found: Diagnosis) -> list[str]:
    """What spoils the records themselves: a clipped output, spikes, a dead output.

    No effect of a model explains these, and one may be found that only stands for them; friction does hold a mass
    still, and play takes away coherence.
    """
    sentences: dict[tuple[str, tuple[str, ...]], str] = {}
    for name, records in (("to fit", found.fit), ("held out", found.held_out)):
        for one in spoiled_channels(_alike(records)):
            if one.level == "bad" and set(one.channels) <= set(records[0].output_names):
                sentences.setdefault((one.what, one.channels), f"the records {name} are spoiled: {one.sentence}")
    return list(sentences.values())


def free_words(found: Diagnosis) -> list[str]:
    """What a calibration may take up that is free in every force between the states of a state space."""
    free = [one for one in found.calibrated if one.name.startswith(INTERNAL_FORCE)]
    gains = any(one.effect in {"input_gain", "sensor_gain"} for one in found.findings)
    if not free or gains:
        return []
    words = (
        f"the state space is not recognised as a structure, so its calibration is free in {len(free)} numbers, which "
        "can take up the gain of a sensor or an input: whether a gain is wrong is not known; pass M, C and K to know"
    )
    return [words]


def unit_words(found: Diagnosis) -> tuple[list[str], list[str]]:
    """Sentences on gains that look like a certain conversion of units, and those of the decision that say less."""
    sentences, vague = [], []
    for one in found.findings:
        if one.effect in {"input_gain", "sensor_gain"}:
            gain = one.parameters[0]
            if words := unit_error(gain.value, gain.std):
                sentences.append(
                    f"{one.where} reads {number(gain.value, 4)} times what the model expects, which is {words}; look "
                    "at the units of this channel, in the file and in the model, before anything else"
                )
                vague.append(doubted_gain(gain.value, one.where))
    return sentences, vague


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
    """What a negative delay means: no effect answers before its cause; "" where there is none."""
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


LEAST_RATIO = 2.0
"""Take the grid's own error for as unknown as if it had been halved where only the smoothing was sharpened."""


def grid_error(node: Node) -> FloatArray:
    """Deviation of each common unknown that the steps of time may have left.

    Fitted on two grids, one `r` times as fine as the other, an unknown whose error is in proportion to the step still
    has 1 / (r - 1) of its change from one to the other as its error.

    Returns:
        (n_common,) in the unknowns' units; zero where there was one grid only, and
        for what is held at a bound.

    References:
        Richardson, Gaunt, The deferred approach to the limit, Phil. Trans. R. Soc. A 226, 1927,
        https://doi.org/10.1098/rsta.1927.0008
    """
    fine, coarse = node.fitted, node.coarse
    change = np.where(fine.at_bounds, 0.0, np.abs(fine.unknowns.common - coarse.unknowns.common))
    ratio = coarse.trajectory.drive.dt / fine.trajectory.drive.dt
    return np.asarray(change / (max(ratio, LEAST_RATIO) - 1.0))
