"""What drives a simulation: the inputs of one or several records laid end to end, piecewise linear between samples.

Each step k -> k+1 has the input at its start and at its end: equal under a zero-order hold, the two samples under a
linear hold. A band-limited input is interpolated and each step gets the line that has the input's own mean and slope
over the step, so that the steps do not pose as a gain (a plain line loses (w dt)^2 / 12 of a sine).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.simulation.plant import Plant, plant_matrices
from okid.arrays import TINY, BoolArray, FloatArray
from okid.record import Record

IndexArray = np.ndarray[tuple[int], np.dtype[np.intp]]

SILENT = float(np.sqrt(TINY))
"""Smooth the laws of a record without any input, whose level is this, as those of the records together."""
KAISER_BETA = 9.0
"""Taper the interpolating sinc so that it passes less than 1e-4 of what is above half the sampling rate."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Drive:
    """Inputs and measured outputs of records laid end to end on the simulation's own grid.

    Attributes:
        start: (n_times, n_inputs) input at the start of the step that leaves each time.
        end: (n_times, n_inputs) input at the end of that step.
        sample: (n_times, n_inputs) input at each time, as it reaches the outputs directly.
        time: (n_times,) [s] since the start of the record.
        dt: Step [s].
        firsts: Index of the first time of each record, and n_times at the end (n_records + 1,).
        rows: Times at which outputs were measured (n_rows,).
        row_firsts: Index of each record's first row, and n_rows at the end.
        outputs: (n_rows, n_outputs) measured outputs, zero where missing.
        present: (n_rows, n_outputs) False where missing.
        level: (n_times,) size of each record's inputs (of its outputs where it has none), relative to `reference`:
            sharp laws are smoothed in proportion to it.
        reference: Size that counts as 1, that of the records to fit together.
    """

    start: FloatArray
    end: FloatArray
    sample: FloatArray
    time: FloatArray
    dt: float
    firsts: tuple[int, ...]
    rows: IndexArray
    row_firsts: tuple[int, ...]
    outputs: FloatArray
    present: BoolArray
    level: FloatArray
    reference: float

    @property
    def n_times(self) -> int:
        """Number of times of all records together."""
        return len(self.time)

    @property
    def n_records(self) -> int:
        """Number of records."""
        return len(self.firsts) - 1

    def times_of(self, record: int) -> slice:
        """The times of one record."""
        return slice(self.firsts[record], self.firsts[record + 1])

    def window(self, begin: int, end: int) -> tuple["Drive", IndexArray, IndexArray]:
        """The times begin to end (exclusive) of every record that reaches so far, their indices, and which records."""
        reach = [r for r in range(self.n_records) if self.firsts[r] + begin < self.firsts[r + 1]]
        spans = [np.arange(self.firsts[r] + begin, min(self.firsts[r] + end, self.firsts[r + 1])) for r in reach]
        index = np.concatenate(spans)
        firsts = np.concatenate([[0], np.cumsum([len(span) for span in spans])])
        rows = np.flatnonzero(np.isin(index, self.rows, assume_unique=True))
        measured = np.searchsorted(self.rows, index[rows])
        return (
            replace(
                self,
                start=self.start[index],
                end=self.end[index],
                sample=self.sample[index],
                time=self.time[index],
                level=self.level[index],
                firsts=tuple(int(first) for first in firsts),
                rows=rows,
                row_firsts=tuple(int(first) for first in np.searchsorted(rows, firsts)),
                outputs=self.outputs[measured],
                present=self.present[measured],
            ),
            index,
            np.array(reach),
        )

    def rows_of(self, record: int) -> slice:
        """The measured rows of one record."""
        return slice(self.row_firsts[record], self.row_firsts[record + 1])


def drive_of(records: Sequence[Record], upsampling: int = 1, *, reference: float | None = None) -> Drive:
    """Lay records end to end, with `upsampling` steps a sample.

    Args:
        records: Records of one time step, of the same channels.
        upsampling: Steps of the simulation per sample.
        reference: Size of inputs that counts as level 1; by default the root mean square over these records.
    """
    levels = np.array([_level(record) for record in records])
    against = max(float(np.sqrt(np.mean(levels**2))), SILENT) if reference is None else reference
    levels = np.where(levels > SILENT, levels, against)
    parts = [_one(record, upsampling) for record in records]
    firsts = np.concatenate([[0], np.cumsum([len(part[0]) for part in parts])])
    row_firsts = np.concatenate([[0], np.cumsum([record.n_samples for record in records])])
    outputs = np.concatenate([record.outputs for record in records])
    present = ~np.isnan(outputs)
    dt = records[0].dt / upsampling
    return Drive(
        start=np.concatenate([part[0] for part in parts]),
        end=np.concatenate([part[1] for part in parts]),
        sample=np.concatenate([part[2] for part in parts]),
        time=np.concatenate([np.arange(len(part[0])) * dt for part in parts]),
        dt=dt,
        firsts=tuple(int(first) for first in firsts),
        rows=np.concatenate(
            [
                first + upsampling * np.arange(record.n_samples)
                for first, record in zip(firsts[:-1], records, strict=True)
            ]
        ),
        row_firsts=tuple(int(first) for first in row_firsts),
        outputs=np.where(present, outputs, 0.0),
        present=present,
        level=np.repeat(levels / against, np.diff(firsts)),
        reference=against,
    )


def _level(record: Record) -> float:
    signals = record.inputs if record.n_inputs else record.outputs
    size = float(np.sqrt(np.nansum(np.nanvar(signals, axis=0))))
    return size if size > 0.0 else max(float(np.sqrt(np.nanmean(signals**2))), SILENT)


def _one(record: Record, upsampling: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    u = record.inputs
    n = (record.n_samples - 1) * upsampling + 1
    if record.input_hold == "zero_order":
        held = np.repeat(u, upsampling, axis=0)[:n]
        return held, held, held
    coarse = np.arange(record.n_samples, dtype=float)
    fine = np.arange(n) / upsampling
    if record.input_hold == "linear":
        sample = np.stack([np.interp(fine, coarse, column) for column in u.T], axis=1).reshape(n, u.shape[1])
        return sample, np.concatenate([sample[1:], sample[-1:]]), sample
    halves = _interpolated(u, 2 * upsampling)
    sample, between = halves[::2], halves[1::2]
    following = sample[1:]
    mean = (sample[:-1] + 4.0 * between + following) / 6.0
    half_rise = (following - sample[:-1]) / 2.0
    last = sample[-1:]
    return np.concatenate([mean - half_rise, last]), np.concatenate([mean + half_rise, last]), sample


def _interpolated(u: FloatArray, factor: int) -> FloatArray:
    """Band-limited interpolation (n - 1) factor + 1 rows, by a long windowed sinc; the ends are continued oddly."""
    half = 32  # samples on either side
    n, pad = len(u), min(half, len(u) - 1)
    before = 2.0 * u[0] - u[pad:0:-1]
    after = 2.0 * u[-1] - u[-2 : -pad - 2 : -1]
    padded = np.concatenate([before, u, after])
    taps = np.zeros(
        (2 * half + 1) * factor
    )  # in the table: row j, column r weighs sample k + half - j at k + r / factor
    taps[: 2 * half * factor + 1] = np.kaiser(2 * half * factor + 1, KAISER_BETA)
    taps *= np.sinc((np.arange(taps.size) - half * factor) / factor)
    table = taps.reshape(-1, factor) * (factor / taps.sum())
    fine = np.empty((n, factor, u.shape[1]))
    for r, j in np.ndindex(factor, u.shape[1]):
        fine[:, r, j] = np.convolve(padded[:, j], table[:, r])[half + pad : half + pad + n]
    return fine.reshape(n * factor, -1)[: (n - 1) * factor + 1]


STEPS_PER_PERIOD = 16.0
"""Take so many steps a period of the highest resonance: a force that is a straight line over each is off by
(2 pi / steps)^2 / 12 of itself there, 1.3 % at 16 steps."""


def steps_per_sample(plant: Plant, linear: FloatArray, records: Sequence[Record], *, forces: bool = True) -> int:
    """Steps a sample, so that every resonance below the Nyquist frequency gets enough steps a period.

    Args:
        plant: The plant.
        linear: Its parameters.
        records: That it runs along.
        forces: Whether forces act that depend on the motion. Where none does, the flow over a step is exact for inputs
            that are straight lines between samples.

    Returns:
        1 to 6.
    """
    dt = records[0].dt
    if not forces and records[0].input_hold != "band_limited":
        return 1
    wanted = 30.0 if records[0].input_hold == "band_limited" else STEPS_PER_PERIOD
    poles = np.linalg.eigvals(plant_matrices(plant, linear).A) if plant.n_states else np.zeros(0)
    frequencies = np.abs(poles) / (2.0 * np.pi)
    inside = frequencies[frequencies < 0.5 / dt]
    highest = float(inside.max(initial=0.0))
    return int(np.clip(np.ceil(wanted * highest * dt), 1, 6))
