"""A delay that is off by about half a sample may be a wrongly declared hold: the records are taken the other way too.

With many samples a period the two cannot be told apart, and what was declared stands. With few, or hardly any noise, a
wrong hold leaves a gap that no delay closes: further effects are found that only stand in for it, or none is enough.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from modal.discrepancy.results import Diagnosis
from modal.effects.effect import Effect
from modal.effects.effect_names import effects_at
from modal.simulation.tolerances import NEAR_FLOOR
from okid.record import InputHold, Record

__all__ = ["by_the_better_hold", "half_a_sample", "has_half_a_sample", "other_hold"]

HALF_A_SAMPLE = (0.25, 0.75)
"""Delays, beyond whole samples, that a wrong hold may stand behind."""

Diagnose = Callable[[Sequence[Record], Sequence[Record], Mapping[str, Effect]], Diagnosis]
"""Records to fit, held-out records and the effects to try in, the diagnosis out."""


def other_hold(declared: InputHold) -> InputHold:
    """What an input may be instead: held by its source, or measured.

    Example:
        >>> other_hold("zero_order"), other_hold("linear")
        ('band_limited', 'zero_order')
    """
    return "band_limited" if declared == "zero_order" else "zero_order"


def half_a_sample(delay: float, dt: float) -> bool:
    """Whether a delay of either sign is about half a sample off whole ones.

    Args:
        delay: [s].
        dt: Time step of the record [s].

    Example:
        >>> half_a_sample(0.006, 0.01), half_a_sample(-0.005, 0.01), half_a_sample(0.01, 0.01)
        (True, True, False)
    """
    return HALF_A_SAMPLE[0] <= delay / dt % 1.0 <= HALF_A_SAMPLE[1]


def has_half_a_sample(diagnosis: Diagnosis) -> bool:
    """Whether a delay was found that is about half a sample off whole ones."""
    delays = [one.parameters[0].value for one in diagnosis.findings if one.effect == "input_delay"]
    return any(half_a_sample(delay, diagnosis.fit[0].dt) for delay in delays)


def by_the_better_hold(found: Diagnosis, diagnose: Diagnose, catalogue: Mapping[str, Effect]) -> Diagnosis:
    """The diagnosis by the declared hold, or by the other one where that needs less to explain the records.

    Where the declared one explains them too, the other can do with fewer of the same effects, or it is no better.

    Args:
        found: By the declared hold.
        diagnose: Makes another one.
        catalogue: The effects that were tried.

    Returns:
        One of the two, the other hold's with a warning that says so.
    """
    if not has_half_a_sample(found):
        return found
    declared = found.fit[0].input_hold
    hold = other_hold(declared)

    def diagnosed(tried: Mapping[str, Effect]) -> Diagnosis:
        fit, held_out = ([replace(one, input_hold=hold) for one in some] for some in (found.fit, found.held_out))
        return diagnose(fit, held_out, tried)

    if _explains(found):
        keys = {one.effect for one in found.findings}
        if not _better(diagnosed({key: effect for key, effect in catalogue.items() if key in keys}), found):
            return found
    other = diagnosed(catalogue)
    if not _better(other, found):
        return found
    words = (
        f"the inputs are declared {declared}, but as {hold} the records need {_named(other)} instead of "
        f'{_named(found)}, so that is what was taken; declare input_hold="{hold}"'
    )
    return replace(other, warnings=(words, *other.warnings))


def _better(other: Diagnosis, found: Diagnosis) -> bool:
    return _explains(other) and (not _explains(found) or _n_besides(other) < _n_besides(found))


def _explains(found: Diagnosis) -> bool:
    return found.steps[-1].held_out_level <= NEAR_FLOOR


def _n_besides(found: Diagnosis) -> int:
    """How many effects were found beside delays."""
    return sum(one.effect != "input_delay" for one in found.findings)


def _named(found: Diagnosis) -> str:
    return effects_at([(one.effect, one.where) for one in found.findings]) or "no effect"
