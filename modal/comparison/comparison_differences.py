"""What two results were made from and how: channels, units, sampling, settings, fit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from modal.comparison.source import Channel, ResultSummary
from modal.wording.numbers import fit_text

__all__ = ["Difference", "differences_of"]

SAME_STEP = 1e-9
"""Relative difference of two time steps that are the same."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Difference:
    """Something that is not the same in the two results.

    Attributes:
        kind: "channel", "unit", "sampling", "setting" or "fit".
        what: it is, e.g. "output tip" or "model order".
        before: in the first result, "" where it is not there.
        after: in the second.
    """

    kind: Literal["channel", "unit", "sampling", "setting", "fit"]
    what: str
    before: str
    after: str


def differences_of(before: ResultSummary, after: ResultSummary) -> tuple[Difference, ...]:
    """Everything that differs but the modes, in this order: channels, units, sampling, settings, fit."""
    found = [
        *_channels("input", before.inputs, after.inputs),
        *_channels("output", before.outputs, after.outputs),
    ]
    if abs(before.dt - after.dt) > SAME_STEP * before.dt:
        found.append(_difference("sampling", "time step", f"{before.dt:.6g} s", f"{after.dt:.6g} s"))
    lengths = [", ".join(map(str, one.n_samples)) for one in (before, after)]
    if lengths[0] != lengths[1]:
        found.append(_difference("sampling", "samples", *lengths))
    settings = [{choice.what: choice.value for choice in one.choices} for one in (before, after)]
    for what in dict.fromkeys((*settings[0], *settings[1])):
        values = [one.get(what, "") for one in settings]
        if values[0] != values[1]:
            found.append(_difference("setting", what, *values))
    fits = [fit_text(one.fit) for one in (before, after)]
    if fits[0] != fits[1]:
        found.append(_difference("fit", "cross-validated fit", *fits))
    if before.trust != after.trust:
        found.append(_difference("fit", "trust", before.trust, after.trust))
    return tuple(found)


def _channels(role: str, before: Sequence[Channel], after: Sequence[Channel]) -> list[Difference]:
    units = [{channel.name: channel.unit for channel in one} for one in (before, after)]
    found = []
    for name in dict.fromkeys((*units[0], *units[1])):
        there = [name in one for one in units]
        if all(there) and units[0][name] != units[1][name]:
            found.append(_difference("unit", f"{role} {name}", units[0][name], units[1][name]))
        elif not all(there):
            words = ["measured" if one else "" for one in there]
            found.append(_difference("channel", f"{role} {name}", *words))
    return found


def _difference(
    kind: Literal["channel", "unit", "sampling", "setting", "fit"], what: str, before: str, after: str
) -> Difference:
    return Difference(kind=kind, what=what, before=before, after=after)
