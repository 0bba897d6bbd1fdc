"""`modal-report track`: the modes of a batch followed through time, what causes explain of them, and what changed."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from modal.batch.tables import Batch
from modal.command.options import Traceback, examples, faults
from modal.command.terminal import listing, plain, show_paths
from modal.tracking.page import TRACK_PAGE, TRACK_TABLE, moment_text, tracks_headline, write_tracks
from modal.tracking.tracks import track as follow_modes
from okid.arrays import FloatArray
from okid.readers.dispatch import read_table

__all__ = ["EXAMPLES", "track"]

EXAMPLES = examples(
    "what batch wrote: track year_result",
    "with a table of temperatures, one row a record: track year_result --causes weather.csv",
)


def track(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that modal-report batch wrote.")],
    *,
    causes: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Table of what was measured besides (temperature, ...), one row a record in their order.",
        ),
    ] = None,
    traceback: Traceback = False,
) -> None:
    """Follow every mode through the records of a batch; write tracks.html and tracks.parquet beside them.

    Exit status: 0 nothing changed beyond chance; 1 something did; 2
    wrong use or unreadable input.
    """
    with faults(show=traceback):
        batch = Batch(folder)
        found = follow_modes(batch, causes={} if causes is None else _read_causes(causes))
        write_tracks(found, folder)
        console = Console(highlight=False)
        console.print()
        console.print(plain(tracks_headline(found), "bold"))
        reasons = [
            f"since {moment_text(one.since, found)}, seen {moment_text(one.time, found)}: {one.reason}"
            for one in found.alarms
        ]
        listing(console, "Changes", reasons, "yellow")
        listing(console, "Causes", found.causes, "")
        show_paths(console, (folder / TRACK_PAGE, "to read"), (folder / TRACK_TABLE, "the modes with their tracks"))
        raise typer.Exit(1 if found.alarms else 0)


def _read_causes(path: Path) -> dict[str, FloatArray]:
    """Every column of numbers but the time."""
    table = read_table(path)
    return {table.columns[k].name: np.array(table.values[:, k], dtype=np.float64) for k in table.channels()}
