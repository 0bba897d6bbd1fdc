"""Time series of the records: one bulk call an entity, constant style beside it, gaps kept."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from modal.recording.levels import places, thinned
from modal.recording.palette import Colour
from modal.recording.tracks import Tracks
from okid.arrays import FloatArray
from okid.record import Record

if TYPE_CHECKING:
    import rerun

__all__ = ["TIMELINE", "Line", "log_lines", "log_sequence", "log_series", "time_axis"]

TIMELINE: Final = "time"

Interpolation = Literal["Linear", "StepAfter"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Line:
    """One channel of all records, and how it is drawn.

    Attributes:
        channels: its samples in each record, nan where missing.
        name: as it reads in the legend.
        colour: of the line.
        width: of the line, in points.
    """

    channels: Sequence[FloatArray]
    name: str
    colour: Colour
    width: float = 1.2


def time_axis(records: Sequence[Record], plan: Tracks) -> FloatArray:
    """(n_stored,) times of the stored samples of all records on the timeline [s], one between records for the gap."""
    parts = []
    for record, start, kept in zip(records, plan.starts, plan.levels, strict=True):
        times = start + record.dt * places(kept)
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
    line = Line(channels=channels, name=name, colour=colour, width=width)
    log_lines(recording, path, times, [line], plan=plan, interpolation=interpolation)


def log_lines(
    recording: "rerun.RecordingStream",
    path: str,
    times: FloatArray,
    lines: Sequence[Line],
    *,
    plan: Tracks,
    interpolation: Interpolation = "Linear",
) -> None:
    """Several channels of all records as one entity, painted in their order: two in one take a third less than apart.

    Where they do not miss the same samples they become an entity each, below `path`: a row holds all of its channels
    or none.

    Args:
        recording: the stream.
        path: their entity.
        times: from `time_axis`.
        lines: the channels.
        plan: of the recording.
        interpolation: "StepAfter" for an input that was held between samples.
    """
    import rerun as rr

    values = np.column_stack([_stored(line.channels, plan) for line in lines])
    there = ~np.isnan(values)
    if len(lines) > 1 and (there != there[:, :1]).any():
        for number, line in enumerate(lines, start=1):
            log_lines(recording, f"{path}/{number}", times, [line], plan=plan, interpolation=interpolation)
        return
    columns = rr.Scalars.columns(scalars=values)
    if not there.all():
        # an empty row breaks the line as nan would, but equals itself when two recordings are compared
        rows = there[:, 0]
        columns = rr.Scalars.columns(scalars=values[rows].reshape(-1)).partition(rows * len(lines))
    recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=times)], columns, strict=True)
    # MinMax: with anything else the viewer averages what falls on one pixel, and a vibration is drawn as a flat line
    style = rr.SeriesLines(
        names=[line.name for line in lines],
        colors=[line.colour for line in lines],
        widths=[line.width for line in lines],
        aggregation_policy="MinMax",
        interpolation_mode=interpolation,
    )
    recording.log(path, style, static=True, strict=True)


def _stored(channels: Sequence[FloatArray], plan: Tracks) -> FloatArray:
    """What is kept of a channel, the records one after the other with a nan between them."""
    gap = np.array([np.nan])
    parts = [part for values, kept in zip(channels, plan.levels, strict=True) for part in (thinned(values, kept), gap)]
    return np.concatenate(parts[:-1])


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
