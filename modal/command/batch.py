"""`modal-report batch`: many files identified, each once, by several processes or a cluster; one table of all modes."""

import contextlib
import logging
import shlex
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Annotated

import typer

from modal.batch import Batch, ExecutorError, Workers, identify_batch
from modal.batch.running import usable_cores
from modal.batch.tables import MODE_CSV, MODE_TABLE, PAGE, RECORD_TABLE
from modal.command.options import (
    Dt,
    Hold,
    Inputs,
    Outputs,
    Traceback,
    examples,
    faults,
    name_list,
    number_or_auto,
    whole_or_auto,
)
from modal.command.terminal import Screen, listing, plain, progress_bar, show_paths
from modal.wording.text import shorten
from okid.errors import InvalidDataError

EXAMPLES = examples(
    "a folder: batch runs --inputs force -o result",
    "a year of a bridge, on four processes: batch 'year/*.mat' -o result --workers 4",
    "groups of files, one result each: batch runs -o result --group-by '(test[0-9]+)_'",
    "a cluster of dask workers that see the same files: batch 'runs/*.csv' -o result --scheduler tcp://host:8786",
)
LISTED = 10
"""List so many records that failed or differ; the page has more."""


def batch(
    sources: Annotated[
        list[str], typer.Argument(metavar="FILE", help="Files, folders, or patterns in quotes: 'runs/*.csv'.")
    ],
    *,
    folder: Annotated[Path, typer.Option("-o", "--out", metavar="FOLDER", help="Folder for the results.")],
    inputs: Inputs = None,
    outputs: Outputs = None,
    dt: Dt = None,
    hold: Hold = "band_limited",
    group_by: Annotated[
        str | None,
        typer.Option(metavar="PATTERN", help="Regular expression; its first group names the record of a file."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Processes; as many as there are cores unless given.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Of a dask scheduler whose workers see the same files.")
    ] = None,
    observer_order: Annotated[str, typer.Option(metavar="N", help="Past samples the observer uses, or auto.")] = "auto",
    ridge: Annotated[str, typer.Option(metavar="NUMBER", help="Regularisation of the observer fit, or auto.")] = "auto",
    order: Annotated[str, typer.Option(metavar="N", help="Model order (number of states), or auto.")] = "auto",
    traceback: Traceback = False,
) -> None:
    """Identify each of many records once; give the same command again to take up what is missing.

    Exit status: 0 all identified; 1 a record failed, or is not like
    the others in time step, length, channels or units; 2 wrong use.
    """
    with faults(show=traceback):
        if workers is not None and scheduler is not None:
            raise InvalidDataError("--workers and --scheduler exclude each other; give one of them.")
        with progress_bar() as tell, _executor(workers, scheduler) as executor:
            result = identify_batch(
                sources,
                folder,
                executor=executor,
                group_by=group_by,
                inputs=name_list(inputs, "inputs"),
                outputs=name_list(outputs, "outputs"),
                dt=dt,
                input_hold=hold,
                observer_order=whole_or_auto(observer_order, "observer order"),
                ridge=number_or_auto(ridge, "ridge"),
                order=whole_or_auto(order, "model order"),
                progress=tell,
            )
        raise typer.Exit(_show(result))


@contextlib.contextmanager
def _executor(workers: int | None, scheduler: str | None) -> Iterator[Executor]:
    if scheduler is None:
        with Workers(workers or usable_cores()) as own:
            yield own
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise ExecutorError(
            "--scheduler needs dask.distributed, which is not installed; install it with pip install "
            "'okid-modal[dask]', or use --workers."
        ) from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters comes as an error, in one sentence
    try:
        client = Client(scheduler, timeout=10.0)  # a few round trips of the slowest network
    except (OSError, ValueError) as error:  # no answer, or no address
        said = shorten(" ".join(str(error).split()), 200)
        raise ExecutorError(
            f"no scheduler answers at {scheduler!r} ({said}); start one with dask scheduler, or use --workers."
        ) from error
    with client:
        # a worker that dies takes tasks with it that were merely waiting: they are tried again elsewhere
        yield client.get_executor(retries=3, pure=False)


def _show(result: Batch) -> int:
    """Print what became of the batch; the exit status."""
    console = Screen(highlight=False)
    rows = result.records.select(["record", "status", "message"]).to_pylist()
    failed = [row for row in rows if row["status"] == "failed"]
    odd = [row for row in rows if row["status"] == "done" and row["message"]]
    console.print()
    console.print(plain(f"{len(rows) - len(failed)} of {len(rows)} records identified.", "bold"))
    for heading, several in (("Failed", failed), ("Not like the other records", odd)):
        lines = [f"{row['record']}: {row['message']}" for row in several[:LISTED]]
        more = [f"and {len(several) - LISTED} more, see {PAGE}"] if len(several) > LISTED else []
        listing(console, heading, [*lines, *more], "yellow")
    at = result.folder
    show_paths(
        console,
        (at / PAGE, "to read"),
        (at / MODE_TABLE, "one row a pole and record"),
        (at / MODE_CSV, "the same without shapes"),
        (at / RECORD_TABLE, "one row a record"),
        (at / "recording.rrd", f"to look at: modal-report view {shlex.quote(str(at))}"),
    )
    console.print(plain(f"To follow each mode through the records: modal-report track {shlex.quote(str(at))}", ""))
    return 1 if failed or odd else 0
