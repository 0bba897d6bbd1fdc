"""`modal-report check`: the quality of the data, without an identification."""

from pathlib import Path
from typing import Annotated

import typer

from modal.command.check_job import CheckJob, carry_out_check, check_status
from modal.command.command_options import name_list
from modal.command.job import FileSource
from modal.command.options import Dt, Hold, Inputs, Outputs, Records, Traceback, examples, faults

__all__ = ["EXAMPLES", "check"]

EXAMPLES = examples(
    "before anything else: check test.csv --inputs force",
    "several records: check day1.mat day2.mat --inputs f1,f2 --dt 0.001",
    "for another program: check test.csv --inputs force --json quality.json",
)


def check(
    files: Records,
    *,
    inputs: Inputs = None,
    outputs: Outputs = None,
    dt: Dt = None,
    hold: Hold = "band_limited",
    numbers: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the findings and their numbers into a file (replaced)."),
    ] = None,
    traceback: Traceback = False,
) -> None:
    """Look at the data of FILES only: clipping, dropouts, hum, coherence and whatever else would spoil a result.

    It takes seconds. Exit status: 0 nothing bad; 1 a finding that spoils a
    result; 2 wrong use or unreadable input.
    """
    with faults(show=traceback):
        source = FileSource(
            files=files, inputs=name_list(inputs, "inputs"), outputs=name_list(outputs, "outputs"), dt=dt, hold=hold
        )
        quality, _console = carry_out_check(CheckJob(source=source, json=numbers))
        raise typer.Exit(check_status(quality))
