"""Modes followed through many records, as a recording: a mode is a series, a record is a moment of it.

Three pages: all modes with what changed in them beside what was measured besides; each frequency with its interval, and
what causes and levels explain of it; each damping ratio. The timeline is that of the records.

An interval is an upright stroke: two values at the time of the record, then a row without any, which ends the line.
The viewer counts that row as 0 when it chooses what an axis shows, so a view with strokes has its limits told. It
paints points over lines, so the line of what is explained has points of its own, or a year of records would hide it.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from modal.plots.panels import IN_TURN, STYLE
from modal.recording.figure import (
    Colour,
    Palette,
    RecordingStream,
    document_view,
    drawable,
    role_colour,
    rr,
    rrb,
    series_view,
    tabs,
)
from modal.recording.plan import Views, bullets, cell, label, log_table, log_text, path_parts, table
from modal.recording.series import LATEST, TIMELINE, bucket_length, row_budget
from modal.recording.stream import GLOBAL_AXIS, write_stream
from modal.wording.text import NINETY_FIVE, hertz
from okid.arrays import FloatArray

IndexArray = npt.NDArray[np.intp]

Clock = Literal["date", "seconds", "record"]
"""What times are: seconds since 1970, seconds since some moment, numbers of records."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FollowedMode:
    """One mode through the records; nan where a number is not known.

    Attributes:
        number: of the mode.
        times: (n_found,) of the records in which it was found, rising.
        frequency: (n_found,) [Hz].
        frequency_std: (n_found,) standard deviation [Hz].
        damping_ratio: (n_found,).
        damping_ratio_std: (n_found,).
        explained: (n_found,) frequency that causes and levels explain [Hz].
        left: (n_means, 2) time, and mean of neighbours of the relative frequency without the causes [%].
        level: (n_levels, 3) from when to when on which level that is [%].
        share: of its variance that the causes explain; nan without causes.
        row: cells of the table of modes.
        moments: when it was seen first or last, where that is not the start or end of the records, and in words.
    """

    number: int
    times: FloatArray
    frequency: FloatArray
    frequency_std: FloatArray
    damping_ratio: FloatArray
    damping_ratio_std: FloatArray
    explained: FloatArray
    left: FloatArray
    level: FloatArray
    share: float
    row: tuple[str, ...]
    moments: tuple[tuple[float, str], ...]

    @property
    def name(self) -> str:
        """Its number and its usual frequency."""
        return f"track {self.number}, {hertz(float(np.median(self.frequency)))} Hz"

    @property
    def frequency_limits(self) -> tuple[float, float]:
        """Of an axis that shows its frequencies [Hz]."""
        return limits(np.concatenate([self.frequency, self.explained]), NINETY_FIVE * self.frequency_std)

    @property
    def damping_limits(self) -> tuple[float, float]:
        """Of an axis that shows its damping ratios [%]."""
        return limits(100.0 * self.damping_ratio, 100.0 * NINETY_FIVE * self.damping_ratio_std)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RecordedChange:
    """A change beyond chance.

    Attributes:
        since: when it began.
        seen: when it was beyond chance.
        p_value: chance of it where nothing changed.
        sentence: when and what, in words.
        shifts: (n_modes,) relative change of each frequency; nan where it is not known.
        shifts_std: (n_modes,) their standard deviations.
    """

    since: float
    seen: float
    p_value: float
    sentence: str
    shifts: FloatArray
    shifts_std: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FollowedModes:
    """What a recording of modes through time shows.

    Attributes:
        headline: what was found, in a sentence.
        head: of the table of modes.
        modes: every mode.
        changes: by time.
        times: (n_records,) of all records, rising.
        causes: (n_records,) of each that was measured, by name.
        remarks: sentences on how causes are felt; none where none helps.
        clock: what times are.
    """

    headline: str
    head: tuple[str, ...]
    modes: tuple[FollowedMode, ...]
    changes: tuple[RecordedChange, ...]
    times: FloatArray
    causes: Mapping[str, FloatArray]
    remarks: tuple[str, ...]
    clock: Clock


WORDS: Final = "words"
LOG: Final = "log"
MODES: Final = "modes"
CHANGES: Final = "changes"
SHIFTS: Final = "shifts"
ALL: Final = "all"
CAUSES: Final = "causes"
FREQUENCY: Final = "frequency"
DAMPING: Final = "damping"
PER_MODE: Final = 12
"""Count so many rows for a mode in a record: twice a value, an interval of three and what is explained, and means."""


class _Axis:
    """The timeline of the records: dates, time since the first, or their numbers where neither can be shown.

    Attributes:
        times: (n_records,) of all records, rising.
        kind: what it shows.
        name: of the timeline.
    """

    def __init__(self, times: FloatArray, clock: Clock) -> None:
        self.times, self._start = times, float(times[0]) if times.size else 0.0
        self.kind: Clock = clock
        if clock == "record" or np.abs(times - (self._start if clock == "seconds" else 0.0)).max(initial=0.0) > LATEST:
            self.kind = "record"
        self._is_counted = self.kind == "record" and clock != "record"  # Rerun cannot hold the times
        self.name = "record" if self.kind == "record" else TIMELINE

    def places(self, times: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Nanoseconds, or numbers."""
        at = np.asarray(times, dtype=np.float64)
        if self.kind == "record":
            return (np.searchsorted(self.times, at) + 1 if self._is_counted else np.rint(at)).astype(np.int64)
        return np.rint(1e9 * (at - (self._start if self.kind == "seconds" else 0.0))).astype(np.int64)

    def column(self, times: npt.ArrayLike) -> Any:
        """Rerun's own column of these times."""
        places = self.places(times)
        if self.kind == "record":
            return rr.TimeColumn(self.name, sequence=places)
        if self.kind == "date":
            return rr.TimeColumn(self.name, timestamp=places.astype("datetime64[ns]"))
        return rr.TimeColumn(self.name, duration=places.astype("timedelta64[ns]"))

    def span(self) -> Any:
        """All of it, with a little room before and that of a key behind."""
        low, high = (int(place) for place in self.places(self.times[[0, -1]])) if self.times.size else (0, 1)
        margin = max(1, round(0.01 * (high - low)))
        behind = max(1, round(0.25 * (high - low)))
        at, key = rrb.TimeRangeBoundary, "seq" if self.kind == "record" else "nanos"
        return rrb.TimeRange(
            start=at.absolute(**{key: low - margin}),
            end=at.absolute(**{key: high + behind}),
        )


def limits(values: FloatArray, around: FloatArray | None = None) -> tuple[float, float]:
    """Of an axis that shows all values, and of what lies around them as much as is usual.

    Example:
        >>> limits(np.array([1.0, 2.0, np.nan]))
        (0.95, 2.05)
    """
    there = values[np.isfinite(values)]
    if not there.size:
        return 0.0, 1.0
    half = np.zeros(0) if around is None else around[np.isfinite(around)]
    more = float(np.median(half)) if half.size else 0.0
    low, high = float(there.min()) - more, float(there.max()) + more
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def save_tracks_recording(found: FollowedModes, path: Path) -> Path:
    """Write the recording of modes through time; the same modes give the same recording.

    Raises:
        OSError: the file cannot be written.
    """
    digest = hashlib.blake2b(found.headline.encode("utf-8", "backslashreplace"), digest_size=12)
    for mode in found.modes:
        digest.update(mode.times.tobytes() + mode.frequency.tobytes())
    for name, cause in found.causes.items():
        digest.update(name.encode("utf-8", "backslashreplace") + cause.tobytes())
    return write_stream(path, digest.hexdigest(), "modes through time", lambda recording: _log(found, recording))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Pen:
    """Draws what is known of values over time.

    Attributes:
        recording: the stream.
        axis: its timeline.
        dot: radius of a dot [points].
    """

    recording: RecordingStream
    axis: _Axis
    dot: float

    def line(
        self,
        path: str,
        times: FloatArray,
        values: FloatArray,
        *,
        name: str,
        colour: Colour,
        width: float = 1.5,
        dot: float = 0.0,
        is_whole: bool = False,
    ) -> None:
        """A line, with dots on it or without; `is_whole` where nothing of it may be summed up to fit a pixel."""
        policy = "Off" if is_whole else "MinMax"
        style = rr.SeriesLines(names=drawable(name), colors=colour, widths=width, aggregation_policy=policy)
        if self._sent(path, times, values, style) and dot:
            self.recording.log(path, _dots(name, colour, dot), static=True, strict=True)

    def dots(self, path: str, times: FloatArray, values: FloatArray, *, name: str, colour: Colour) -> None:
        """A dot a value."""
        self._sent(path, times, values, _dots(name, colour, self.dot))

    def ends(self, path: str, mode: FollowedMode, values: FloatArray) -> None:
        """A diamond at the record in which a mode was seen first, or last."""
        when = np.array([time for time, _ in mode.moments])
        style = _dots("first or last seen", Palette.GOLD, 7.0, marker="diamond")
        self._sent(path, when, values[np.searchsorted(mode.times, when)], style)

    def intervals(self, path: str, times: FloatArray, low: FloatArray, high: FloatArray) -> None:
        """A stroke from the low to the high end of each."""
        self._strokes(path, times, np.column_stack([low, high]), name="95 % interval", colour=Palette.DIM_BLUE)

    def changes(self, path: str, since: FloatArray, shown: tuple[float, float]) -> None:
        """A stroke through the whole view at each."""
        self._strokes(path, since, np.tile(shown, (since.size, 1)), name="change", colour=Palette.RED, width=2.0)

    def _strokes(
        self, path: str, times: FloatArray, ends: FloatArray, *, name: str, colour: Colour, width: float = 1.0
    ) -> None:
        there = np.isfinite(ends).all(axis=1)
        if not there.any():
            return
        lengths = np.tile([1, 1, 0], int(there.sum()))
        scalars = rr.Scalars.columns(scalars=ends[there].reshape(-1)).partition(lengths)
        column = self.axis.column(np.repeat(times[there], 3))
        self.recording.send_columns(path, [column], scalars, strict=True)
        style = rr.SeriesLines(names=drawable(name), colors=colour, widths=width, aggregation_policy="MinMax")
        self.recording.log(path, style, static=True, strict=True)

    def _sent(self, path: str, times: FloatArray, values: FloatArray, style: Any) -> bool:
        there = np.isfinite(values)
        if not there.any():
            return False
        column = self.axis.column(times[there])
        self.recording.send_columns(path, [column], rr.Scalars.columns(scalars=values[there]), strict=True)
        self.recording.log(path, style, static=True, strict=True)
        return True


def _dots(name: str, colour: Colour, size: float, *, marker: str = "circle") -> Any:
    return rr.SeriesPoints(names=drawable(name), colors=colour, markers=marker, marker_sizes=size)


def _log(found: FollowedModes, recording: RecordingStream) -> None:
    axis = _Axis(found.times, found.clock)
    n_rows = PER_MODE * len(found.modes) + len(found.causes)
    budget = row_budget(n_rows, n_rows)
    pen = _Pen(recording=recording, axis=axis, dot=float(np.clip(1000.0 / max(1, found.times.size), 1.5, 4.0)))
    for mode, part in zip(found.modes, _parts(found), strict=True):
        _draw_frequency(pen, f"{FREQUENCY}/{part}", mode, found, budget)
        _draw_damping(pen, f"{DAMPING}/{part}", mode, found, budget)
    for (name, cause), part in zip(found.causes.items(), path_parts(list(found.causes)), strict=True):
        rows = extreme_rows(cause, budget)
        pen.line(f"{CAUSES}/{part}", found.times[rows], cause[rows], name=label(name), colour=Palette.GOLD)
    _draw_all(pen, found, budget)
    _log_words(recording, axis, found, is_thinned=any(mode.times.size > budget for mode in found.modes))
    _log_numbers(recording, found)
    recording.send_blueprint(_blueprint(found, axis))


def _parts(found: FollowedModes) -> list[str]:
    """Of a path, in the order of the numbers."""
    width = len(str(len(found.modes)))
    return [f"{mode.number:0{width}d}" for mode in found.modes]


def _since(found: FollowedModes, mode: FollowedMode) -> FloatArray:
    """Of the changes that say something on a mode."""
    return np.array([change.since for change in found.changes if np.isfinite(change.shifts[mode.number])])


def _draw_frequency(pen: _Pen, path: str, mode: FollowedMode, found: FollowedModes, budget: int) -> None:
    rows = extreme_rows(mode.frequency, budget)
    times, values, half = mode.times[rows], mode.frequency[rows], NINETY_FIVE * mode.frequency_std[rows]
    pen.intervals(f"{path}/0_interval", times, values - half, values + half)
    pen.dots(f"{path}/1_found", times, values, name="found", colour=Palette.BLUE)
    name = "causes and level" if found.remarks else "level"
    at = f"{path}/2_explained"
    pen.line(at, times, mode.explained[rows], name=name, colour=Palette.ORANGE, dot=1.0)
    pen.changes(f"{path}/3_changes", _since(found, mode), mode.frequency_limits)
    pen.ends(f"{path}/4_first_or_last", mode, mode.frequency)


def _draw_damping(pen: _Pen, path: str, mode: FollowedMode, found: FollowedModes, budget: int) -> None:
    values = 100.0 * mode.damping_ratio
    rows = extreme_rows(values, budget)
    if not rows.size:
        return
    times, half = mode.times[rows], 100.0 * NINETY_FIVE * mode.damping_ratio_std[rows]
    low = np.where(values[rows] >= 0.0, np.maximum(values[rows] - half, 0.0), values[rows] - half)
    pen.intervals(f"{path}/0_interval", times, low, values[rows] + half)
    pen.dots(f"{path}/1_found", times, values[rows], name="found", colour=Palette.BLUE)
    pen.changes(f"{path}/3_changes", _since(found, mode), mode.damping_limits)
    pen.ends(f"{path}/4_first_or_last", mode, values)


def _draw_all(pen: _Pen, found: FollowedModes, budget: int) -> None:
    """Every mode in a colour of its own, what is left of it as means and, where something changed, as levels."""
    for place, (mode, part) in enumerate(zip(found.modes, _parts(found), strict=True)):
        role = IN_TURN[place % len(IN_TURN)]
        rows = extreme_rows(mode.frequency, budget)
        values = mode.frequency[rows]
        pen.dots(f"{ALL}/frequency/{part}", mode.times[rows], values, name=mode.name, colour=role_colour(role))
        colour = role_colour(role, STYLE.half if found.changes else 1.0)
        pen.line(f"{ALL}/left/0_means/{part}", *mode.left.T, name=mode.name, colour=colour)
        pen.line(
            f"{ALL}/left/1_levels/{part}",
            mode.level[:, :2].reshape(-1),
            np.repeat(mode.level[:, 2], 2),
            name=f"level of {mode.name}",
            colour=role_colour(role),
            width=3.0,
            is_whole=True,
        )
    since = np.array([change.since for change in found.changes])
    for what, shown in _limits_of_all(found).items():
        pen.changes(f"{ALL}/{what}/2_changes", since, shown)


def _limits_of_all(found: FollowedModes) -> dict[str, tuple[float, float]]:
    nothing = np.zeros(0)
    left = [part for mode in found.modes for part in (mode.left[:, 1], mode.level[:, 2])]
    return {
        "frequency": limits(np.concatenate([nothing, *(mode.frequency for mode in found.modes)])),
        "left": limits(np.concatenate([nothing, *left])),
    }


def extreme_rows(values: FloatArray, budget: int) -> IndexArray:
    """Rows that are kept: all that are numbers, or the smallest and the largest of each stretch.

    Args:
        values: (n,) nan where nothing is known.
        budget: rows that may be kept, about.

    Example:
        >>> extreme_rows(np.array([3.0, 1.0, 2.0, np.nan, 5.0, 4.0, 6.0, 7.0, 8.0]), 8).tolist()
        [0, 1, 2, 4, 5, 6, 7, 8]
        >>> extreme_rows(np.array([3.0, 1.0, 2.0, 5.0, 4.0, 6.0]), 4).tolist()
        [0, 1, 4, 5]
    """
    there = np.flatnonzero(np.isfinite(values))
    bucket = bucket_length(there.size, budget)
    if bucket == 1:
        return there
    stretch = np.arange(there.size) // bucket
    order = there[np.lexsort((values[there], stretch))]
    last = np.append(np.flatnonzero(np.diff(stretch)), there.size - 1)
    first = np.append(0, last[:-1] + 1)
    return np.unique(order[np.concatenate([first, last])])


def _log_words(recording: RecordingStream, axis: _Axis, found: FollowedModes, *, is_thinned: bool) -> None:
    parts = [f"### {cell(found.headline)}"]
    parts += bullets([change.sentence for change in found.changes])
    if found.modes:
        parts.append(table(found.head, [[cell(text, 80) for text in mode.row] for mode in found.modes]))
    parts += bullets(found.remarks)
    if len(found.modes) > Views.OUTPUTS:
        parts.append(f"Views are shown for the first {Views.OUTPUTS} of {len(found.modes)} modes; all are stored.")
    if is_thinned:
        parts.append("Of many records the smallest and the largest of each stretch are shown; tracks.parquet has all.")
    log_text(recording, WORDS, "\n\n".join(parts))
    said = _said(found)
    if said:
        columns = rr.TextLog.columns(
            text=[drawable(words) for _, words, _ in said], level=[level for *_, level in said]
        )
        recording.send_columns(LOG, [axis.column([time for time, *_ in said])], columns, strict=True)


def _said(found: FollowedModes) -> list[tuple[float, str, str]]:
    """When what is to be told, and how urgently, by time."""
    said = [(change.since, change.sentence, "WARN") for change in found.changes]
    said += [(time, words, "INFO") for mode in found.modes for time, words in mode.moments]
    return sorted(said, key=lambda one: one[0])


def _tables(found: FollowedModes) -> list[tuple[str, str, dict[str, list[object]]]]:
    """Path, name and columns of what is told in numbers."""
    modes: dict[str, list[object]] = {
        "track": [mode.number for mode in found.modes],
        "frequency_median": [float(np.median(mode.frequency)) for mode in found.modes],
        "frequency_lowest": [float(mode.frequency.min()) for mode in found.modes],
        "frequency_highest": [float(mode.frequency.max()) for mode in found.modes],
        "damping_ratio_median": [_median(mode.damping_ratio) for mode in found.modes],
        "n_found": [mode.times.size for mode in found.modes],
        "explained": [mode.share for mode in found.modes],
        "remarks": ["; ".join(words for _, words in mode.moments) for mode in found.modes],
    }
    names = ("since", "seen", "p_value", "sentence")
    changes: dict[str, list[object]] = {name: [getattr(one, name) for one in found.changes] for name in names}
    known = [
        (change, mode, float(one.shifts[mode]), float(one.shifts_std[mode]))
        for change, one in enumerate(found.changes)
        for mode in np.flatnonzero(np.isfinite(one.shifts)).tolist()
    ]
    columns = zip(*known, strict=True) if known else [()] * 4
    told = zip(("change", "track", "shift", "shift_std"), columns, strict=True)
    shifts: dict[str, list[object]] = {name: list(values) for name, values in told}
    return [(MODES, "Modes", modes), (CHANGES, "Changes", changes), (SHIFTS, "Shifts", shifts)]


def _median(values: FloatArray) -> float:
    there = values[np.isfinite(values)]
    return float(np.median(there)) if there.size else float("nan")


def _log_numbers(recording: RecordingStream, found: FollowedModes) -> None:
    for path, _, columns in _tables(found):
        n_rows = len(next(iter(columns.values())))
        log_table(recording, path, f"{path}_row", np.arange(n_rows), columns)


def _blueprint(found: FollowedModes, axis: _Axis) -> Any:
    pages = [_overview(found, axis)]
    shown = list(zip(found.modes, _parts(found), strict=True))[: Views.OUTPUTS]
    frequencies = [
        _view(f"{FREQUENCY}/{part}", f"{mode.name}: frequency [Hz]", axis, mode.frequency_limits)
        for mode, part in shown
    ]
    damping = [
        _view(f"{DAMPING}/{part}", f"{mode.name}: damping ratio [%]", axis, mode.damping_limits)
        for mode, part in shown
        if np.isfinite(mode.damping_ratio).any()
    ]
    for views, name in ((frequencies, "Frequencies"), (damping, "Damping")):
        if views:
            pages.append(rrb.Grid(*views, grid_columns=1 if len(views) < 3 else 2, name=name))
    pages.append(_numbers(found))
    return rrb.Blueprint(
        rrb.Tabs(*pages, active_tab=0),
        rrb.TimePanel(timeline=axis.name, state="collapsed", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _overview(found: FollowedModes, axis: _Axis) -> Any:
    what = "What is left without the causes [%]" if found.remarks else "Frequencies, off their first level [%]"
    shown = _limits_of_all(found)
    views = [
        _view(f"{ALL}/frequency", "All frequencies [Hz]", axis, shown["frequency"]),
        _view(f"{ALL}/left", what, axis, shown["left"], legend=False),
    ]
    views[0].id = GLOBAL_AXIS
    if found.causes:
        parts = path_parts(list(found.causes))
        causes = [
            _view(f"{CAUSES}/{part}", label(name), axis, limits(cause), legend=False)
            for (name, cause), part in zip(found.causes.items(), parts, strict=True)
        ]
        views.append(tabs(causes, "Causes"))
    words = [document_view(WORDS, "What was found")]
    if _said(found):
        columns = rrb.TextLogColumns(timeline_columns=[axis.name], text_log_columns=["LogLevel", "Body"])
        words.append(rrb.TextLogView(origin=LOG, name="When", columns=columns))
    return rrb.Horizontal(
        rrb.Vertical(*views, row_shares=[1.2, 1.2, 0.7][: len(views)], name="Modes through time"),
        rrb.Vertical(*words, row_shares=[2.0, 1.0][: len(words)], name="Words"),
        column_shares=[1.6, 1.0],
        name="Overview",
    )


def _view(origin: str, name: str, axis: _Axis, shown: tuple[float, float], *, legend: bool = True) -> Any:
    view = series_view(origin, name, ["$origin/**"], legend=legend)
    view.properties["TimeAxis"] = rrb.TimeAxis(link="LinkToGlobal", view_range=axis.span())
    view.properties["ScalarAxis"] = rrb.ScalarAxis(range=shown)
    return view


def _numbers(found: FollowedModes) -> Any:
    views = []
    for path, name, columns in _tables(found):
        if len(next(iter(columns.values()))):
            order = [f"{path}_row", *(f"/{path}:{column}" for column in columns)]
            query = rrb.archetypes.DataframeQuery(timeline=f"{path}_row", select=order)
            views.append(rrb.DataframeView(origin=path, name=name, query=query))
    return tabs(views, "Numbers") if views else document_view(WORDS, "Numbers")
