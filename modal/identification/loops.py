"""What feedback of the outputs into the inputs does to a result, and whether a model of the noise allows for it.

A direct method tells the system from what feeds it back where something else moves the inputs too, the outputs follow
that, and the loop takes a sample at least: then the innovation form is consistent. Where nothing else shows, the joint
motion of inputs and outputs is that of one loop under the noise, and any split of it into system and controller that
has the same loop explains the record as well.

References:
    Gustavsson, Ljung, Soderstrom, Automatica 13(1), 1977, 59-75, doi 10.1016/0005-1098(77)90009-5; Forssell, Ljung,
    Automatica 35(7), 1999, 1215-1241, doi 10.1016/S0005-1098(99)00022-9.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.identification.covariance import NO_INTERVAL, NOT_UNDERSTOOD
from modal.identification.result import Identification
from modal.modes.mode import Choice, Mode
from modal.preparation.band import FOLLOWS, chance_at_modes
from modal.verdict.judgement import DOUBTED, doubted
from modal.wording.text import hertz, listed
from okid.arrays import BoolArray, FloatArray
from okid.record import Record

FOUND = "the past of the outputs tells more about the inputs than their own does"
WHY_TOLD = "something feeds them back, or the inputs move between their samples as only the outputs show"
MOVED = "the inputs follow the outputs as in a loop, which may move it by several of its deviations"
ALONE = "nothing that moves the inputs from outside the loop shows in it: may be a mode of the loop, not of the system"


def with_feedback(result: Identification, moved: FloatArray | None, free: Sequence[Record] = ()) -> Identification:
    """The result with what feedback does to it: a mode that it may move far is not certain, harmless feedback a remark.

    Nor is a mode that only the noise moves: of all modes where a model of the noise should allow for feedback, else
    where that holds of each that was found.

    Args:
        result: of records with feedback.
        moved: (n_modes,) how many of its deviations feedback moves each mode by; None for a model with its noise.
        free: the records with what moves the inputs from outside a loop (`modal.estimation.feedback.from_outside`);
            none where that was not asked.
    """
    told = np.array([mode.kind == "oscillatory" and mode.verdict != "noise" for mode in result.modes], dtype=np.bool_)
    alone = told & (chance_at_modes(result.modes, free) > FOLLOWS) if free else np.zeros_like(told)
    if not alone.any() or (moved is not None and (told & ~alone).any()):
        return _allowed_for(result, told=bool(told.any())) if moved is None else _as_moved(result, moved)
    result = _in_a_loop(result, alone)
    return _allowed_for(result, rest=True) if (told & ~alone).any() else result


def _in_a_loop(result: Identification, alone: BoolArray) -> Identification:
    """These modes doubtful, which nothing from outside a loop moves, and a sentence about them."""
    where = listed([hertz(mode.frequency) for mode, own in zip(result.modes, alone, strict=True) if own])
    said = (
        f"{FOUND.capitalize()}: {WHY_TOLD}. At {where} Hz the outputs follow nothing that moves the inputs from "
        "outside such a loop: what is found there may belong to the closed loop or to what feeds back, and no model of "
        "the noise can tell. Move the inputs by a signal of their own that shows in the outputs, or identify the "
        "closed loop from the outputs alone."
    )
    modes = tuple(_alone(mode) if own else mode for mode, own in zip(result.modes, alone, strict=True))
    return replace(result, modes=replace(result.modes, modes=modes), warnings=(*result.warnings, said))


def _alone(mode: Mode) -> Mode:
    if mode.verdict == "system":
        return doubted(mode, ALONE)
    return replace(mode, probability=min(mode.probability, DOUBTED), reason=f"{ALONE}; {mode.reason}")


def _allowed_for(result: Identification, *, told: bool = True, rest: bool = False) -> Identification:
    """A sentence that the model of the noise allows for feedback, where any mode was told, or the rest of the modes."""
    allows = "which allows for that as long as what feeds back takes a sample or more"
    said = f"{FOUND.capitalize()}: {WHY_TOLD}; the model has its noise{f', {allows}' if told else ''}."
    if rest:
        said = f"The other modes follow what moves the inputs from outside, and the model has its noise, {allows}."
    return replace(result, warnings=(*result.warnings, said))


def _as_moved(result: Identification, moved: FloatArray) -> Identification:
    """A model without its noise: what feedback moves far is doubtful, and where it moves nothing that is a remark."""
    wider = np.hypot(1.0, moved)
    own = [(mode, by) for mode, by in zip(result.modes, wider.tolist(), strict=True) if mode.verdict == "system"]
    far = ", ".join(hertz(mode.frequency) for mode, by in own if by > NO_INTERVAL)
    most = max((by for mode, by in own if by <= NO_INTERVAL and not np.isnan(mode.frequency_std)), default=1.0)
    if not far and most <= NOT_UNDERSTOOD:
        why = f"{FOUND}, but that makes no interval of a mode of the system more than {most:.2g} times wider"
        return replace(result, choices=(*result.choices, Choice(what="feedback", value="harmless", reason=why)))
    said = f"{FOUND.capitalize()}: {WHY_TOLD}, and no model of the noise leaves white errors."
    if most > NOT_UNDERSTOOD:
        said += f" The intervals have the bias by that in them, which makes them up to {most:.1f} times wider."
    said += f" It may move what is found at {far} Hz by several deviations, so that is doubtful." if far else ""
    modes = tuple(
        doubted(mode, MOVED) if by > NO_INTERVAL else mode
        for mode, by in zip(result.modes, wider.tolist(), strict=True)
    )
    return replace(result, modes=replace(result.modes, modes=modes), warnings=(*result.warnings, said))
