"""A model with its last effect as strong as it can be simulated: a first guess may let the motion escape."""

from typing import Literal

from modal.discrepancy.assembly import Assembly, Unknowns
from modal.discrepancy.estimation import Estimate, simulate_at
from modal.discrepancy.nodes import Task
from okid.arrays import FloatArray

__all__ = ["amplitudes", "scaled", "within_reach"]

STRENGTHS = (1.0, 0.5, 0.2)
"""Shares of a first guess of an effect's strength that are tried until the model can be simulated."""


def within_reach(
    assembly: Assembly,
    unknowns: Unknowns,
    task: Task,
    states: FloatArray,
    *,
    smoothing: float,
    gain: FloatArray | None = None,
) -> Estimate | None:
    """The model with its last effect at the largest share of its strength at which it can be simulated.

    Args:
        assembly: The model.
        unknowns: Values to start from.
        task: Records to fit.
        states: (n_times, n_all) near which the trajectory is sought.
        smoothing: Width of sharp laws, as a share of the motion's scale.
        gain: (n_all, n_outputs) of the observer form; free run unless given.

    Returns:
        The model along the records; None where it escapes at every share.
    """
    for share in STRENGTHS if amplitudes(assembly) else STRENGTHS[:1]:
        tried = scaled(assembly, unknowns, share)
        start: Literal["far", "near"] = "far" if share == 1.0 else "near"
        found = simulate_at(assembly, tried, task.fit, states=states, gain=gain, smoothing=smoothing, start=start)
        if found is not None:
            return found
    return None


def scaled(assembly: Assembly, unknowns: Unknowns, share: float) -> Unknowns:
    """The unknowns with the last effect's amplitudes at a share of theirs.

    Args:
        assembly: The model.
        unknowns: Its unknowns.
        share: Of each amplitude's distance from its neutral value.
    """
    common = unknowns.common.copy()
    for index, neutral in amplitudes(assembly):
        common[index] = neutral + share * (common[index] - neutral)
    return Unknowns(common=common, local=unknowns.local)


def amplitudes(assembly: Assembly) -> list[tuple[int, float]]:
    """Where the amplitudes of the last effect stand among the common unknowns, and their neutral values."""
    last = len(assembly.placements) - 1
    effect, begin = assembly.placements[last].effect, assembly.common_of(last).start
    return [
        (begin + position, effect.neutral[j])
        for position, j in enumerate(assembly.placements[last].common)
        if effect.parameters[j].role == "amplitude"
    ]
