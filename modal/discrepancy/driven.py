"""The drive after the effects at the inputs."""

from dataclasses import replace

import numpy as np

from modal.discrepancy.assembly import Assembly, Unknowns
from modal.discrepancy.drive import Drive
from okid.arrays import FloatArray

__all__ = ["drive_inputs", "per_time"]


def per_time(value: FloatArray, drive: Drive) -> FloatArray:
    """A parameter's value at every time: a number stays one, one value a record is spread over its times."""
    if np.ndim(value) == 0:
        return value
    return np.repeat(value, np.diff(drive.firsts))


def drive_inputs(assembly: Assembly, unknowns: Unknowns, drive: Drive, *, first: int = 0) -> Drive:
    """The drive after the effects at the inputs, from the placement `first` on."""
    acting = [i for i in assembly.inputs if i >= first]
    if not acting:
        return drive
    start, end, sample = drive.start.copy(), drive.end.copy(), drive.sample.copy()
    for i in acting:
        item = assembly.placements[i]
        effect = item.input_effect
        values = unknowns.values(assembly, i)
        for record in range(drive.n_records):
            times = drive.times_of(record)
            at = (times, item.channel)
            felt = effect.at_samples(values, sample[at], start[at], end[at], drive.dt)
            start[at], end[at] = effect.apply(values, start[at], end[at], drive.dt)
            sample[at] = felt
    return replace(drive, start=start, end=end, sample=sample)
