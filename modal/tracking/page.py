"""What was found of modes through time, to read and to look at: a page, a recording, the table with its tracks.

The page shows alarms first, then a year on one picture, then the modes one by one; the recording has the same, each
record a moment of it.
"""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from modal.batch.tables import part_file
from modal.plots.histories import frequencies_in_time, levels_between, neighbour_means
from modal.recording.series import LATEST
from modal.recording.tracks import Clock, FollowedMode, FollowedModes, RecordedChange, save_tracks_recording
from modal.report.pages import environment, inline
from modal.report.pictures import drawn
from modal.sections.validation import installed_version
from modal.tracking.tracks import Track, Tracks
from modal.wording.text import hertz, shorten
from okid.arrays import FloatArray
from okid.readers.clock import DAY

TRACK_PAGE, TRACK_TABLE, TRACK_RECORDING = "tracks.html", "tracks.parquet", "tracks.rrd"
EPOCH_FROM = 1e9
"""Read times from here on as seconds since 1970, which that is in 2001: no record lasts so long."""


def moment_text(time: float, tracks: Tracks) -> str:
    """A time as a date, as days since the first record, or as the number and name of a record."""
    if not tracks.clock:
        name = tracks.records[int(time) - 1] if 0 < time <= len(tracks.records) else ""
        return f"record {time:.0f}{f' ({shorten(name, 40)})' if name else ''}"
    if EPOCH_FROM <= time <= LATEST:
        return datetime.fromtimestamp(time, tz=UTC).strftime("%Y-%m-%d %H:%M")
    start = min(float(one.times[0]) for one in tracks.tracks)
    return f"day {(time - start) / DAY:.1f}"


def tracks_headline(tracks: Tracks) -> str:
    """What was found, in one sentence."""
    modes = f"{len(tracks.tracks)} mode{'s' * (len(tracks.tracks) != 1)} followed"
    if not tracks.alarms and not tracks.enough:
        return f"{modes}; too few records to tell a change from chance."
    if not tracks.alarms:
        return f"{modes}; nothing changed beyond chance."
    n = len(tracks.alarms)
    first = moment_text(tracks.alarms[0].since, tracks)
    return f"{modes}; {n} change{'s' * (n != 1)} beyond chance, {'the first ' * (n != 1)}since {first}."


def _verdict(tracks: Tracks) -> tuple[str, str]:
    """Class of the style sheet, and words."""
    if tracks.alarms:
        return "not-carried", "Something changed"
    return ("carried", "No change beyond chance") if tracks.enough else ("with-care", "Too few records to tell")


def _explained(share: float) -> str:
    if not np.isfinite(share):
        return "–"
    return f"{100 * share:.1f} %" if share > 0.0 else "nothing"


def _caption(tracks: Tracks) -> str:
    causes = ", ".join(tracks.causes)
    less = f" less what the causes explain, {causes}" if causes else " (no cause was given, or none helps)"
    marked = " Upright lines: since when something changed; level ones: how far." if tracks.alarms else ""
    return (
        f"Above, a dot for each mode in each record; below, each frequency{less}, against its level before the first "
        f"change, as means of neighbouring records.{marked}"
    )


HEAD = ("track", "median, Hz", "found in records", "range about the median", "explained by causes", "remarks")


class WrittenTracks(NamedTuple):
    """The files that were written."""

    page: Path
    table: Path
    recording: Path


def write_tracks(tracks: Tracks, folder: Path) -> WrittenTracks:
    """Write tracks.html, tracks.parquet (the table of modes with a column "track") and tracks.rrd, a recording.

    What stands there already is replaced; none of the three is ever there in part.

    Raises:
        InvalidDataError: the folder cannot be written.
    """
    import pyarrow.parquet as pq

    rows = [_row(one, tracks) for one in tracks.tracks]
    chart = frequencies_in_time(tracks.tracks, [(one.since, one.shifts) for one in tracks.alarms], clock=tracks.clock)
    text = (
        environment(html=True)
        .get_template("tracks.html.j2")
        .render(
            headline=tracks_headline(tracks),
            verdict=_verdict(tracks),
            alarms=[
                (moment_text(one.since, tracks), moment_text(one.time, tracks), one.reason) for one in tracks.alarms
            ],
            pictures={"tracks": inline(drawn(chart, "tracks", _caption(tracks)))},
            clock=tracks.clock,
            rows=rows,
            remarks=any(row[-1] for row in rows),
            head=HEAD,
            version=installed_version(),
        )
    )
    written = WrittenTracks(folder / TRACK_PAGE, folder / TRACK_TABLE, folder / TRACK_RECORDING)
    with part_file(written.page) as part:
        part.write_bytes((text + "\n").encode("utf-8"))
    with part_file(written.table) as part:
        pq.write_table(tracks.modes, part)
    with part_file(written.recording) as part:
        save_tracks_recording(_recorded(tracks), part)
    return written


def _row(one: Track, tracks: Tracks) -> tuple[str, ...]:
    """Cells of the table of modes, as `HEAD` names them."""
    middle = float(np.median(one.frequency))
    return (
        str(one.number),
        hertz(middle),
        f"{one.frequency.size} of {len(tracks.records)}",
        f"{100 * (one.frequency.min() / middle - 1):+.2f} to {100 * (one.frequency.max() / middle - 1):+.2f} %",
        _explained(one.explained),
        "; ".join(f"{word} {moment_text(time, tracks)}" for word, time in _ends(one)),
    )


def _ends(one: Track) -> Iterator[tuple[str, float]]:
    """When it came and went, where it did."""
    for word, time in (("first seen", one.born), ("last seen", one.died)):
        if time is not None:
            yield word, time


def _moments(one: Track, tracks: Tracks) -> Iterator[tuple[float, str]]:
    """When it came and went, and in words."""
    name = f"track {one.number} ({hertz(float(np.median(one.frequency)))} Hz)"
    for word, time in _ends(one):
        yield time, f"{name} {word} {moment_text(time, tracks)}"


def alarm_text(number: int, tracks: Tracks) -> str:
    """What an alarm says, with its times."""
    one = tracks.alarms[number]
    when = "on" if tracks.clock else "in"
    return f"since {moment_text(one.since, tracks)}, seen {when} {moment_text(one.time, tracks)}: {one.reason}"


def _recorded(tracks: Tracks) -> FollowedModes:
    clock: Clock = "record"
    if tracks.clock:
        clock = "date" if tracks.times[0] >= EPOCH_FROM and tracks.times[-1] <= LATEST else "seconds"
    columns = {name: _column(tracks, name) for name in ("frequency_std", "damping_ratio", "damping_ratio_std")}
    number = {name: float(place) for place, name in enumerate(tracks.records, start=1)}
    times = _column(tracks, "start_time")
    if not tracks.clock:
        times = np.array([number[name] for name in tracks.modes.column("record").to_pylist()])
    owner = tracks.modes.column("track").to_numpy()
    modes = []
    for one in tracks.tracks:
        rows = np.flatnonzero(owner == one.number)
        rows = rows[np.argsort(times[rows], kind="stable")]
        shifts = [(alarm.since, float(alarm.shifts[one.number])) for alarm in tracks.alarms]
        levels = levels_between(one.times, one.times, shifts)
        steps = levels[np.searchsorted(levels[:, 0], one.times, side="right") - 1, 2] if len(levels) else 0.0
        in_percent = (1.0, 1.0, 100.0)
        modes.append(
            FollowedMode(
                number=one.number,
                times=one.times,
                frequency=one.frequency,
                explained=one.frequency * np.exp(steps - one.left),
                left=neighbour_means(one.times, one.left) * in_percent[1:],
                level=levels * in_percent,
                share=one.explained,
                row=_row(one, tracks)[:-1],
                moments=tuple(_moments(one, tracks)),
                **{name: values[rows] for name, values in columns.items()},
            )
        )
    changes = [
        RecordedChange(
            since=one.since,
            seen=one.time,
            p_value=one.p_value,
            sentence=alarm_text(number, tracks),
            shifts=one.shifts,
            shifts_std=one.shifts_std,
        )
        for number, one in enumerate(tracks.alarms)
    ]
    return FollowedModes(
        headline=tracks_headline(tracks),
        head=HEAD[:-1],
        modes=tuple(modes),
        changes=tuple(changes),
        times=tracks.times,
        causes=tracks.measured,
        remarks=tuple(f"Taken off the frequencies: what follows {cause}." for cause in tracks.causes),
        clock=clock,
    )


def _column(tracks: Tracks, name: str) -> FloatArray:
    """(n_rows,) of the table of modes; nan where it has none."""
    import pyarrow as pa

    if name not in tracks.modes.column_names:
        return np.full(tracks.modes.num_rows, np.nan)
    return np.asarray(tracks.modes.column(name).cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
