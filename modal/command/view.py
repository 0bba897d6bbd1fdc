"""`modal-report view`: the recording of a result in the Rerun viewer."""

from pathlib import Path
from typing import Annotated

import typer

from modal.command.options import Traceback, complain, examples, faults
from modal.command.view_job import open_recording, recording_of

__all__ = ["EXAMPLES", "view"]

EXAMPLES = examples("what run or gap wrote: view result", "a recording by itself: view result/recording.rrd")


def view(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder that run, demo or gap wrote, or a recording (.rrd).")
    ],
    *,
    traceback: Traceback = False,
) -> None:
    """Open the recording of RESULT in the Rerun viewer.

    Exit status: 0 the viewer is open; 1 there is no viewer or no display here
    (it says the command that opens it elsewhere); 2 wrong use or no recording.
    """
    with faults(show=traceback):
        problem = open_recording(recording_of(result))
        if problem:
            complain(problem)
        raise typer.Exit(1 if problem else 0)
