"""What a change of an input in each bin of it does to the model: hats of the input as inputs of their own."""

from dataclasses import replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem
from modal.discrepancy.validation.law_points import Bins
from modal.simulation.drive import Drive
from modal.simulation.driven import drive_inputs
from modal.simulation.sensitivity import Source
from okid.arrays import TINY, FloatArray

__all__ = ["drive_before", "input_sources"]

RELATIVE_STEP = 1e-6


def drive_before(fitted: Estimate, problem: Problem, placement: int) -> Drive:
    """The drive as it reaches an effect at an input: after the effects before it."""
    earlier = replace(fitted.assembly, placements=fitted.assembly.placements[:placement])
    return drive_inputs(earlier, fitted.unknowns, problem.drive)


def input_sources(fitted: Estimate, placement: int, before: Drive, bins: Bins) -> list[Source]:
    """What a unit of each bin's hat, added to the input behind the effect, does by itself.

    Args:
        fitted: The model.
        placement: The effect at the input.
        before: The drive as it reaches the effect (`drive_before`).
        bins: Bins of the input before the effect.

    Returns:
        One source a bin.
    """
    channel = fitted.assembly.placements[placement].channel
    hats = [bins.hats(signal[:, channel])[0] for signal in (before.start, before.end, before.sample)]
    found = []
    for bin_ in range(len(bins.knots)):
        slopes = np.zeros((3, *before.start.shape))
        for k in range(3):
            slopes[k, :, channel] = hats[k][:, bin_]
        found.append(_source(fitted, *_carried(fitted, placement, before, slopes)))
    return found


def _carried(
    fitted: Estimate, placement: int, before: Drive, slopes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Changes behind the effect, carried through the effects after it on the same input by central differences."""
    assembly = fitted.assembly
    channel = assembly.placements[placement].channel
    if not any(i > placement and assembly.placements[i].channel == channel for i in assembly.inputs):
        return slopes[0], slopes[1], slopes[2]
    first = replace(assembly, placements=assembly.placements[: placement + 1])
    behind = drive_inputs(first, fitted.unknowns, before, first=placement)
    size = RELATIVE_STEP * max(float(np.abs(behind.sample).max()), TINY)
    after = []
    for step in (size, -size):
        moved = replace(
            behind,
            start=behind.start + step * slopes[0],
            end=behind.end + step * slopes[1],
            sample=behind.sample + step * slopes[2],
        )
        last = drive_inputs(assembly, fitted.unknowns, moved, first=placement + 1)
        after.append((last.start, last.end, last.sample))
    start, end, sample = ((above - below) / (2.0 * size) for above, below in zip(*after, strict=True))
    return start, end, sample


def _source(fitted: Estimate, start: FloatArray, end: FloatArray, sample: FloatArray) -> Source:
    """What a change of the drive does: to the plant, and to the forces at ports that the inputs move."""
    assembly, scheme, about = fitted.assembly, fitted.scheme, fitted.trajectory.linearisation
    rows, n = fitted.trajectory.drive.rows, assembly.plant.n_states
    flow = np.zeros_like(about.states)
    flow[:, :n] = start @ scheme.B0.T + end @ scheme.B1.T
    outputs = sample[rows] @ scheme.D.T
    for position, i in enumerate(assembly.forces):
        port, force = assembly.placements[i].port, about.forces[position]
        if port is None:
            continue
        moved = np.zeros(len(flow))
        if port.displacement is not None:
            moved += force.by_displacement * (sample @ port.displacement[n:])
        if port.velocity is not None:
            moved += force.by_velocity * (sample @ port.velocity[n:])
        columns, direction = list(port.columns), fitted.unknowns.directions(assembly, i)
        flow[:, :n] += moved[:, None] * (scheme.E0[:, columns] @ direction)
        flow[:-1, :n] += moved[1:, None] * (scheme.E1[:, columns] @ direction)
        outputs = outputs + moved[rows, None] * about.G[:, position]
    return Source(flow=flow, outputs=outputs)
