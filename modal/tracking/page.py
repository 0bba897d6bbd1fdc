"""The page on what was followed: alarms first, then a year on one picture, then the modes one by one."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from modal.batch.tables import part_file
from modal.plots.histories import frequencies_in_time
from modal.plots.vector import svg_text
from modal.report.pages import environment
from modal.sections.provenance import installed_version
from modal.tracking.tracks import Tracks
from modal.wording.numbers import hertz

__all__ = ["TRACK_PAGE", "TRACK_TABLE", "moment_text", "tracks_headline", "write_tracks"]

TRACK_PAGE, TRACK_TABLE = "tracks.html", "tracks.parquet"
EPOCH_FROM = 1e9
"""Read times from here on as seconds since 1970, which that is in 2001: no record lasts so long."""


def moment_text(time: float, tracks: Tracks) -> str:
    """A time as a date, as days since the first record, or as the number of a record."""
    if not tracks.clock:
        return f"record {time:.0f}"
    if time >= EPOCH_FROM:
        return datetime.fromtimestamp(time, tz=UTC).strftime("%Y-%m-%d %H:%M")
    start = min(float(one.times[0]) for one in tracks.tracks)
    return f"day {(time - start) / 86400.0:.1f}"


def tracks_headline(tracks: Tracks) -> str:
    """What was found, in one sentence."""
    modes = f"{len(tracks.tracks)} mode{'s' * (len(tracks.tracks) != 1)} followed"
    if not tracks.alarms and not tracks.enough:
        return f"{modes}; too few records to tell a change from chance."
    if not tracks.alarms:
        return f"{modes}; nothing changed beyond chance."
    n = len(tracks.alarms)
    first = moment_text(tracks.alarms[0].since, tracks)
    return f"{modes}; {n} change{'s' * (n != 1)} beyond chance, the first since {first}."


def _verdict(tracks: Tracks) -> tuple[str, str]:
    """Class of the style sheet, and words."""
    if tracks.alarms:
        return "not-carried", "Something changed"
    return ("carried", "No change beyond chance") if tracks.enough else ("with-care", "Too few records to tell")


def _explained(share: float) -> str:
    if not np.isfinite(share):
        return "–"
    return f"{100 * share:.1f} %" if share > 0.0 else "nothing"


def write_tracks(tracks: Tracks, folder: Path) -> tuple[Path, Path]:
    """Write tracks.html and tracks.parquet (the table of modes with a column "track").

    Args:
        tracks: of `track`.
        folder: that exists.

    Raises:
        InvalidDataError: the folder cannot be written.
    """
    import pyarrow.parquet as pq

    rows = []
    for one in tracks.tracks:
        middle = float(np.median(one.frequency))
        rows.append(
            (
                one.number,
                hertz(middle),
                one.frequency.size,
                f"{100 * (one.frequency.min() / middle - 1):+.2f} to {100 * (one.frequency.max() / middle - 1):+.2f} %",
                _explained(one.explained),
                "; ".join(
                    f"{word} {moment_text(time, tracks)}"
                    for word, time in (("first seen", one.born), ("last seen", one.died))
                    if time is not None
                ),
            )
        )
    chart = frequencies_in_time(tracks.tracks, [alarm.since for alarm in tracks.alarms], clock=tracks.clock)
    text = (
        environment(html=True)
        .get_template("tracks.html.j2")
        .render(
            headline=tracks_headline(tracks),
            verdict=_verdict(tracks),
            causes=", ".join(tracks.causes),
            alarms=[
                (moment_text(one.since, tracks), moment_text(one.time, tracks), one.reason) for one in tracks.alarms
            ],
            picture=svg_text(chart, name="tracks", description="Frequencies of all modes through time"),
            rows=rows,
            version=installed_version(),
        )
    )
    with part_file(folder / TRACK_PAGE) as part:
        part.write_bytes((text + "\n").encode("utf-8"))
    with part_file(folder / TRACK_TABLE) as part:
        pq.write_table(tracks.modes, part)
    return folder / TRACK_PAGE, folder / TRACK_TABLE
