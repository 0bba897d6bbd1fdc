"""What a parameter of an effect at an input adds to each step and to the outputs, the trajectory held."""

from dataclasses import replace

import numpy as np

from modal.simulation.assembly import Assembly, Unknowns
from modal.simulation.drive import Drive
from modal.simulation.driven import drive_inputs
from modal.simulation.linearisation import linearise
from modal.simulation.plant import Port
from modal.simulation.scheme import Scheme
from modal.simulation.trajectory import Trajectory
from okid.arrays import TINY, FloatArray

__all__ = ["input_forcing"]


def input_forcing(
    assembly: Assembly,
    unknowns: Unknowns,
    drive: Drive,
    trajectory: Trajectory,
    scheme: Scheme,
    *,
    placement: int,
    j: int,
) -> tuple[FloatArray, FloatArray]:
    """What parameter j of the effect at an input does by itself.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        drive: Inputs as recorded.
        trajectory: The simulated trajectory.
        scheme: Matrices of one step.
        placement: Index of the effect.
        j: Index of its parameter.

    Returns:
        (n_times, n) what a unit of it adds to the step that leaves each time, and (n_rows, n_outputs) to the outputs
        before the sensors' effects.
    """
    slopes = _input_slopes(assembly, unknowns, drive, placement, j)
    about, n = trajectory.linearisation, assembly.plant.n_states
    if any(_reads_inputs(assembly.placements[i].force_and_port[1], n) for i in assembly.forces):
        return _through_ports(assembly, unknowns, trajectory, scheme, slopes)
    start, end, sample = slopes
    flow = np.zeros_like(about.states)
    flow[:, :n] = start @ scheme.B0.T + end @ scheme.B1.T
    return flow, sample[drive.rows] @ scheme.D.T


def _reads_inputs(port: Port, n_states: int) -> bool:
    return any(row is not None and bool(row[n_states:].any()) for row in (port.displacement, port.velocity))


def _through_ports(
    assembly: Assembly, unknowns: Unknowns, trajectory: Trajectory, scheme: Scheme, slopes: tuple[FloatArray, ...]
) -> tuple[FloatArray, FloatArray]:
    """What a change of the drive does where it also moves ports, the states held: central differences of the steps."""
    about, drive = trajectory.linearisation, trajectory.drive
    largest = max(float(np.abs(slope).max(initial=0.0)) for slope in slopes)
    size = 1e-6 * max(float(np.abs(drive.sample).max(initial=0.0)), TINY) / max(largest, TINY)
    above, below = (
        linearise(
            assembly,
            unknowns,
            replace(
                drive,
                start=drive.start + step * slopes[0],
                end=drive.end + step * slopes[1],
                sample=drive.sample + step * slopes[2],
            ),
            scheme,
            about.states,
            smoothing=about.smoothing,
        )
        for step in (size, -size)
    )
    flow = np.zeros_like(about.states)
    flow[:-1] = (above.defect - below.defect)[1:] / (2.0 * size)
    return flow, (above.free - below.free) / (2.0 * size)


def _input_slopes(
    assembly: Assembly, unknowns: Unknowns, drive: Drive, placement: int, j: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives of the drive's start, end and sample by a parameter of an effect at an input."""
    position = assembly.inputs.index(placement)
    earlier = replace(assembly, placements=assembly.placements[:placement])
    later = assembly.inputs[position + 1 :]
    driven = drive_inputs(earlier, unknowns, drive)
    channel, effect = assembly.placements[placement].channel, assembly.placements[placement].input_effect
    values = unknowns.values(assembly, placement)
    slopes = np.zeros((3, *drive.start.shape))
    for record in range(drive.n_records):
        at = (drive.times_of(record), channel)
        found = effect.by_parameter(values, driven.sample[at], driven.start[at], driven.end[at], drive.dt)
        for k in range(3):
            slopes[(k, *at)] = found[k][j]
    if any(assembly.placements[i].channel == channel for i in later):
        slopes = _carried(assembly, unknowns, drive, slopes, placement)
    return slopes[0], slopes[1], slopes[2]


def _carried(assembly: Assembly, unknowns: Unknowns, drive: Drive, slopes: FloatArray, placement: int) -> FloatArray:
    """Derivatives of the drive behind one effect, carried through the effects after it by central differences."""
    before = drive_inputs(replace(assembly, placements=assembly.placements[: placement + 1]), unknowns, drive)
    size = 1e-6 * max(float(np.abs(before.sample).max(initial=0.0)), TINY)
    size /= max(float(np.abs(slopes).max(initial=0.0)), TINY)
    found = []
    for sign in (1.0, -1.0):
        moved = replace(
            before,
            start=before.start + sign * size * slopes[0],
            end=before.end + sign * size * slopes[1],
            sample=before.sample + sign * size * slopes[2],
        )
        after = drive_inputs(assembly, unknowns, moved, first=placement + 1)
        found.append(np.stack([after.start, after.end, after.sample]))
    return np.asarray((found[0] - found[1]) / (2.0 * size))
