"""Many records: `modal-report batch` identifies each once, `track` follows their modes, `live` those of a growing file.

A batch runs on several processes or a cluster, and makes one table of all modes.
"""

import codecs
import contextlib
import itertools
import logging
import re
import shlex
import textwrap
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from modal.batch import ExecutorError, Workers, identify_batch
from modal.batch.running import usable_cores
from modal.batch.tables import MODE_CSV, MODE_TABLE, PAGE, RECORD_TABLE, Batch
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
from modal.command.stopping import Requests
from modal.command.terminal import Screen, listing, plain, progress_bar, show_paths
from modal.identification.order_search import choose_orders
from modal.recording.live import estimate_recording, live_recording, log_estimate
from modal.tracking.live import LiveEstimate, follow, growing_blocks
from modal.tracking.page import alarm_text, tracks_headline, write_tracks
from modal.tracking.tracks import track as follow_modes
from modal.wording.text import listed, shorten
from okid.arrays import FloatArray
from okid.errors import InvalidDataError
from okid.readers.dispatch import READERS, read_table
from okid.readers.guard import check_memory
from okid.readers.table import Table
from okid.readers.text import read_text, table_of_text
from okid.record import Record

BATCH_EXAMPLES = examples(
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
        raise typer.Exit(_show_batch(result))


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


def _show_batch(result: Batch) -> int:
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


TRACK_EXAMPLES = examples(
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
            help="Table of what was measured besides (temperature, ...): a row a record, by its name in a column "
            "'record', else in their order.",
        ),
    ] = None,
    traceback: Traceback = False,
) -> None:
    """Follow every mode through the records of a batch; write tracks.html, tracks.parquet, tracks.rrd.

    Exit status: 0 nothing changed beyond chance; 1 something did; 2
    wrong use or unreadable input.
    """
    with faults(show=traceback):
        batch = Batch(folder)
        found = follow_modes(batch, causes={} if causes is None else _read_causes(causes, batch))
        written = write_tracks(found, folder)
        console = Screen(highlight=False)
        console.print()
        console.print(plain(tracks_headline(found), "bold"))
        listing(console, "Changes", [alarm_text(number, found) for number in range(len(found.alarms))], "yellow")
        listing(console, "Causes", found.causes, "")
        show_paths(
            console,
            (written.page, "to read"),
            (written.table, "the modes with their tracks"),
            (written.recording, f"to look at: modal-report view {shlex.quote(str(written.recording))}"),
        )
        raise typer.Exit(1 if found.alarms else 0)


_FIRST_CELL = re.compile(rb'(?m)^[ \t]*(?:"((?:[^"\r\n]|"")*)"|([^,;\t\r\n" ][^,;\t\r\n"]*))')
"""The first cell of each line, in quotes or not."""


def _read_causes(path: Path, batch: Batch) -> dict[str, FloatArray]:
    """Every column of numbers but the time, a value a record; nan where a table that names records lacks one."""
    records = batch.records.column("record").to_pylist()
    table, named = _named_rows(path)
    columns = [k for k in table.channels() if table.columns[k].name.lower() != "record"]
    values = table.values[:, columns]
    if named is None:
        if len(values) != len(records):
            status = batch.records.column("status").to_pylist()
            failed = [name for name, how in zip(records, status, strict=True) if how == "failed"]
            raise InvalidDataError(
                f"{path.name} has {len(values)} rows, but the batch has {len(records)} records"
                f"{f', failed ones included ({shorten(listed(failed), 80)})' if failed else ''}; give a row for each, "
                "or name them in a first column 'record'."
            )
        found = values
    else:
        place = {name: row for row, name in enumerate(named)}
        if len(place) < len(named):
            twice = next(name for row, name in enumerate(named) if place[name] != row)
            raise InvalidDataError(f"{path.name} names the record {twice!r} twice; leave one row for each.")
        of_files = {Path(name).stem: row for name, row in place.items()}
        rows = [place.get(name, of_files.get(name, -1)) for name in records]
        if max(rows) < 0:
            raise InvalidDataError(
                f"{path.name} names none of the records of the batch ({shorten(listed(records), 120)}); write their "
                "names, as batch lists them, into its column 'record'."
            )
        found = np.array([values[row] if row >= 0 else np.full(len(columns), np.nan) for row in rows])
    return {table.columns[k].name: np.array(found[:, i], dtype=np.float64) for i, k in enumerate(columns)}


def _named_rows(path: Path) -> tuple[Table, list[str] | None]:
    """The table, and the names of its rows where the first column of a text is headed 'record'."""
    text = path.is_file() and READERS.get(path.suffix.lower()) is read_text
    if text:
        check_memory(path, 4.0 * path.stat().st_size)
    data = path.read_bytes().removeprefix(codecs.BOM_UTF8) if text else b""
    cells = [(one[1] or one[2] or b"").decode(errors="replace").strip() for one in _FIRST_CELL.finditer(data)]
    if not cells or cells[0].lower() != "record":
        return read_table(path), None
    numbers = itertools.count(-1)
    table = table_of_text(_FIRST_CELL.sub(lambda one: b"%d" % k if (k := next(numbers)) >= 0 else one[0], data), path)
    return table, [cells[1 + int(k)] if k >= 0 else "" for k in table.values[:, table.names.index(cells[0])]]


LIVE_EXAMPLES = examples(
    "a logger that appends to a CSV: live run.csv --inputs force --window 5",
    "into a recording, without a viewer: live run.csv --inputs force --recording live.rrd",
    "an array without a time column, orders given: live run.npy --inputs column_0 --dt 0.001 --observer-order 50",
)
BLOCKS = 10
"""Cut a window into so many blocks: an estimate is then new by a tenth of what it is made of."""


def live(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Text table (CSV, ...) or NPY that still grows.")],
    *,
    inputs: Inputs = None,
    outputs: Outputs = None,
    dt: Dt = None,
    hold: Hold = "band_limited",
    window: Annotated[float, typer.Option(metavar="SECONDS", help="Length of the sliding window.")] = 10.0,
    observer_order: Annotated[
        int | None, typer.Option(metavar="N", help="Past samples the observer uses; chosen on the first window.")
    ] = None,
    order: Annotated[
        int | None, typer.Option(metavar="N", help="Number of states; chosen on the first window.")
    ] = None,
    patience: Annotated[
        float, typer.Option(metavar="SECONDS", help="Without a new row for so long, the file is complete.")
    ] = 10.0,
    recording: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="Write a recording instead of opening a viewer.")
    ] = None,
    traceback: Traceback = False,
) -> None:
    """Follow the modes of a sliding window while a file grows; each is stamped at its window's middle.

    Exit status: 0 the file stopped growing; 1 it did before the first window was full; 2
    wrong use or unreadable input; 130 stopped.
    """
    with faults(show=traceback):
        console = Screen(highlight=False)

        def tell(text: str) -> None:
            console.print(plain(text, "yellow"))

        blocks = growing_blocks(
            file,
            inputs=name_list(inputs, "inputs") or (),
            outputs=name_list(outputs, "outputs"),
            dt=dt,
            input_hold=hold,
            block=window / BLOCKS,
            patience=patience,
            tell=tell,
            stop=lambda: Requests.asked > 0,
        )
        began = list(itertools.islice(blocks, BLOCKS))
        Requests.check()
        if not began:
            raise InvalidDataError(f"{file.name} holds fewer rows than channels; write more, or wait longer.")
        if observer_order is None or order is None:
            chosen = choose_orders(
                _unbroken(began),
                observer_order=observer_order or "auto",
                order=order or "auto",
            )
            observer_order, order = chosen.observer_order, chosen.order
            console.print(
                plain(f"observer order {observer_order}, model order {order}, chosen on the first window", "")
            )
        estimates = follow(
            itertools.chain(began, blocks), dt=began[0].dt, window=window, observer_order=observer_order, order=order
        )
        n_estimates = _show(estimates, console, recording, tell)
        Requests.check()
        if not n_estimates:
            tell(f"{file.name} ended before the first window of {window:.3g} s was full; give a shorter --window.")
        raise typer.Exit(0 if n_estimates else 1)


def _unbroken(blocks: list[Record]) -> list[Record]:
    """The blocks as one record where none is missing, else those that are longest without a gap."""
    joined = [[blocks[0]]]
    for before, block in itertools.pairwise(blocks):
        on_time = abs(block.start_time - before.start_time - before.duration) <= 0.5 * block.dt
        joined = [*joined[:-1], [*joined[-1], block]] if on_time else [*joined, [block]]
    return [
        Record(
            np.vstack([one.inputs for one in part]),
            np.vstack([one.outputs for one in part]),
            part[0].dt,
            input_names=part[0].input_names,
            output_names=part[0].output_names,
            input_units=part[0].input_units,
            output_units=part[0].output_units,
            input_hold=part[0].input_hold,
        )
        for part in joined
    ]


def _estimate_lines(estimate: LiveEstimate, *, width: int) -> list[str]:
    """A time and its modes, wrapped between modes only, below where the modes begin."""
    bound = "\u00a0"  # where no line ends
    modes = [
        f"{mode.frequency:.5g} Hz {100 * mode.damping_ratio:.2g} %".replace(" ", bound)
        for mode in estimate.modes
        if mode.kind == "oscillatory"
    ]
    when = f"{round(estimate.time, 3):10.15g} s:"
    lines = textwrap.wrap(", ".join(modes) or "no mode", max(20, width - len(when) - 1), break_long_words=False)
    heads = [when, *[" " * len(when)] * (len(lines) - 1)]
    return [f"{head} {line}".replace(bound, " ") for head, line in zip(heads, lines, strict=True)]


def _show(estimates: Iterator[LiveEstimate], console: Console, path: Path | None, tell: Callable[[str], None]) -> int:
    """Every estimate as a line and in the recording or viewer; how many there were."""
    count = 0
    with contextlib.ExitStack() as stack:
        if path is None:
            viewer = stack.enter_context(live_recording(tell=tell))
            stream = None if viewer is None else viewer.stream
        else:
            stream = stack.enter_context(estimate_recording(path))
        for estimate in estimates:
            if not count:
                console.print(plain("middle of the window: frequency and damping ratio of each mode", "bold"))
            count += 1
            for line in _estimate_lines(estimate, width=console.width):
                console.print(plain(line, ""))
            for text in estimate.warnings:
                tell(text)
            if stream is not None:
                log_estimate(estimate.time, estimate.modes, estimate.warnings, stream)
    return count
