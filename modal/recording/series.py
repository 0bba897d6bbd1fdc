"""Time series of the records: one bulk call a channel, constant style beside it, gaps kept."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from modal.recording.levels import positions, reduced
from modal.recording.palette import Colour
from modal.recording.plan import Tracks
from okid.arrays import FloatArray
from okid.record import Record

if TYPE_CHECKING:
    import rerun

__all__ = ["TIMELINE", "log_sequence", "log_series", "time_axis"]

TIMELINE: Final = "time"

Interpolation = Literal["Linear", "StepAfter"]


def time_axis(records: Sequence[Record], plan: Tracks) -> FloatArray:
    """(n_stored,) times of the stored samples of all records on the timeline [s], one between records for the gap."""
    parts = []
    for record, start, bucket in zip(records, plan.starts, plan.buckets, strict=True):
        times = start + record.dt * positions(record.n_samples, bucket)
        parts += [times, times[-1:] + 0.5 * record.dt]
    return np.concatenate(parts[:-1])


def log_series(
    recording: "rerun.RecordingStream",
    path: str,
    times: FloatArray,
    channels: Sequence[FloatArray],
    *,
    plan: Tracks,
    name: str,
    colour: Colour,
    width: float = 1.2,
    interpolation: Interpolation = "Linear",
) -> None:
    """One channel of all records as one entity.

    Args:
        recording: the stream.
        path: its entity.
        times: from `time_axis`.
        channels: the channel's samples in each record, nan where missing.
        plan: of the recording.
        name: as it reads in the legend.
        colour: of the line.
        width: of the line, in points.
        interpolation: "StepAfter" for an input that was held between samples.
    """
    import rerun as rr

    gap = np.array([np.nan])
    parts = [part for c, b in zip(channels, plan.buckets, strict=True) for part in (reduced(c, b), gap)]
    values = np.concatenate(parts[:-1])
    columns = rr.Scalars.columns(scalars=values)
    there = ~np.isnan(values)
    if not there.all():
        # an empty row breaks the line as nan would, but equals itself when two recordings are compared
        columns = rr.Scalars.columns(scalars=values[there]).partition(there.astype(np.int64))
    recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=times)], columns, strict=True)
    # MinMax: with anything else the viewer averages what falls on one pixel, and a vibration is drawn as a flat line
    style = rr.SeriesLines(
        names=name, colors=colour, widths=width, aggregation_policy="MinMax", interpolation_mode=interpolation
    )
    recording.log(path, style, static=True, strict=True)


def log_sequence(
    recording: "rerun.RecordingStream",
    path: str,
    *,
    timeline: str,
    index: FloatArray,
    values: FloatArray,
    names: Sequence[str],
) -> None:
    """Numbers against a whole-number index: stored, and a plot of their own once that timeline is chosen.

    Args:
        recording: the stream.
        path: their entity.
        timeline: name of the index, e.g. "lag".
        index: (n,) whole numbers.
        values: (n, n_series).
        names: of the series.
    """
    import rerun as rr

    recording.send_columns(
        path,
        [rr.TimeColumn(timeline, sequence=np.asarray(index, dtype=np.int64))],
        rr.Scalars.columns(scalars=values),
        strict=True,
    )
    recording.log(path, rr.SeriesLines(names=list(names), aggregation_policy="MinMax"), static=True, strict=True)
