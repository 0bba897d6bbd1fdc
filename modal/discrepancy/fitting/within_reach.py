"""A model with its last effect as strong as it can be simulated: a first guess may let the motion escape."""

from typing import Literal

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, simulate_at
from modal.discrepancy.fitting.nodes import Task
from modal.simulation.assembly import Assembly, Unknowns
from okid.arrays import FloatArray

__all__ = ["amplitudes", "scaled", "within_reach"]

ESCAPED = 100.0
"""A motion escapes where the error is so many times that of no motion at all, in mean squares."""
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
        The model along the records; None where it cannot be simulated at any share.
    """
    silent = float(np.sum((task.fit.drive.outputs * task.fit.weights) ** 2))
    escaped: Estimate | None = None
    for share in STRENGTHS if amplitudes(assembly) else STRENGTHS[:1]:
        tried = scaled(assembly, unknowns, share)
        start: Literal["far", "near"] = "far" if share == 1.0 else "near"
        found = simulate_at(assembly, tried, task.fit, states=states, gain=gain, smoothing=smoothing, start=start)
        if found is not None and found.squares <= ESCAPED * silent:
            return found
        escaped = found if escaped is None else escaped
    return escaped


def scaled(assembly: Assembly, unknowns: Unknowns, share: float) -> Unknowns:
    """The unknowns with the last effect's amplitudes at a share of theirs, and what vanishes at infinity further out.

    Args:
        assembly: The model.
        unknowns: Its unknowns.
        share: Of each amplitude's distance from its neutral value.
    """
    common = unknowns.common.copy()
    for index, neutral in amplitudes(assembly):
        common[index] = common[index] / share if np.isinf(neutral) else neutral + share * (common[index] - neutral)
    return Unknowns(common=common, local=unknowns.local)


def amplitudes(assembly: Assembly) -> list[tuple[int, float]]:
    """Where the strengths of the last effect stand among the common unknowns, and their neutral values.

    These are its amplitudes, and a shape at whose infinite value it vanishes (a limit, a length scale).
    """
    last = len(assembly.placements) - 1
    effect, begin = assembly.placements[last].effect, assembly.common_of(last).start
    return [
        (begin + position, effect.neutral[j])
        for position, j in enumerate(assembly.placements[last].common)
        if effect.parameters[j].role == "amplitude" or np.isinf(effect.neutral[j])
    ]
