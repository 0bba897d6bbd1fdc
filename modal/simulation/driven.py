"""The drive after the effects at the inputs, and which outputs it leaves unknown.

A delayed drive comes from before the record at first, where nothing is known of it. The initial state makes up for that
from then on; until then the outputs are as good as missing. Where a record starts without a drive there was none.
"""

from dataclasses import replace

import numpy as np

from modal.simulation.assembly import Assembly, Unknowns
from modal.simulation.drive import Drive
from okid.arrays import BoolArray, FloatArray

__all__ = ["drive_inputs", "per_time"]

STILL = 0.01
"""A drive that starts below this share of its root mean square was none before."""
MOST = 10
"""A record is left out up to this part of it."""


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
    present = drive.present.copy()
    for i in acting:
        item = assembly.placements[i]
        effect = item.input_effect
        values = unknowns.values(assembly, i)
        for record in range(drive.n_records):
            times = drive.times_of(record)
            at = (times, item.channel)
            _leave_out(present, drive, record, effect.unheard(values, drive.dt), started=_started(start[at]))
            felt = effect.at_samples(values, sample[at], start[at], end[at], drive.dt)
            start[at], end[at] = effect.apply(values, start[at], end[at], drive.dt)
            sample[at] = felt
    return replace(drive, start=start, end=end, sample=sample, present=present)


def _started(drive: FloatArray) -> bool:
    """Whether a record's drive has begun at its first time."""
    return bool(drive.size) and abs(float(drive[0])) > STILL * float(np.sqrt(np.mean(drive**2)))


def _leave_out(present: BoolArray, drive: Drive, record: int, unheard: tuple[int, int], *, started: bool) -> None:
    """Mark outputs at the start and at the end of a record as missing, a tenth of it at most."""
    rows, times = drive.rows_of(record), drive.times_of(record)
    length = times.stop - times.start
    early, late = (min(count, length // MOST) for count in unheard)
    at = drive.rows[rows] - times.start
    present[rows][(at < early) & started | (at >= length - late)] = False
