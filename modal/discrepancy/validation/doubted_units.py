"""Gains that look like something else: a wrong unit, a turned or dead channel, or the error of a simulation."""

from dataclasses import replace

from modal.discrepancy.selection.decision import Decision
from modal.wording.statements import number

__all__ = ["doubted_units"]

PLAUSIBLE_GAIN = (0.3, 3.0)
"""Gains that may be an effect; beyond them a unit is wrong (a thousand, g, degrees)."""
SLIGHT = 0.01
"""A gain that differs from one by less is no finding."""
HARDLY_FOLLOWS = 0.03
"""Size of a gain below which a channel may as well be dead, or another one."""


def doubted_units(decision: Decision) -> Decision:
    """The decision, not firm where a gain far from one was found, a wrong unit, or one that hardly differs from one."""
    assembly = decision.node.coarse.assembly
    reasons = list(decision.reasons)
    for i, item in enumerate(assembly.placements):
        if item.effect.key in {"input_gain", "sensor_gain"}:
            gain = float(decision.node.coarse.unknowns.common[assembly.common_of(i).start])
            if not PLAUSIBLE_GAIN[0] <= gain <= PLAUSIBLE_GAIN[1]:
                reasons.append(_doubted_gain(gain, item.where))
            elif abs(gain - 1.0) < SLIGHT:
                reasons.append(
                    f"a gain of {number(gain, 4)} at {item.where} is within a hundredth of one, which no gauge is sure "
                    "of and errors of a simulation look like"
                )
    if len(reasons) == len(decision.reasons):
        return decision
    return replace(decision, status="unresolved", reasons=tuple(reasons))


def _doubted_gain(gain: float, where: str) -> str:
    """What a gain far from one looks like; a thousandth may be a unit or a dead channel, so both are named."""
    words = f"a gain of {number(gain)} at {where} looks like"
    if abs(gain) < HARDLY_FOLLOWS:
        return f"{words} a dead or wrong channel, or a wrong unit: check the wiring and the units of the records"
    if PLAUSIBLE_GAIN[0] <= -gain <= PLAUSIBLE_GAIN[1]:
        return f"{words} a turned direction: check the sign of the channel"
    return f"{words} a wrong unit: check the units of the records"
