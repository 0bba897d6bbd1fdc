"""A batch from its sources to its tables, by any executor.

Every record is a task that leaves its own result behind, so nothing of a record comes back but a few words, and a
call that ended anywhere is taken up by the next one with the same arguments.
"""

import contextlib
import queue
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any, Literal

from modal.batch.tables import PLACES, Batch, with_oddities, write_page, write_tables
from modal.batch.task import (
    Outcome,
    Settings,
    Sources,
    Unit,
    folder_of,
    kept_outcome,
    run_unit,
    units_of,
    write_failure,
)
from modal.batch.workers import ExecutorError, WorkerDiedError, Workers
from modal.recording.records import save_batch_recording
from modal.report.folder import refuse_names, sweep
from okid.errors import IdentificationError, InvalidDataError
from okid.record import InputHold

__all__ = ["identify_batch"]

IN_FLIGHT = 1000
"""Hand so many tasks to an executor at once: enough for hundreds of workers, and little to remember."""


def identify_batch(
    sources: Sources,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    group_by: str | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    dt: float | None = None,
    input_hold: InputHold = "band_limited",
    observer_order: int | Literal["auto"] = "auto",
    ridge: float | Literal["auto"] = "auto",
    order: int | Literal["auto"] = "auto",
    progress: Callable[[str, float], None] | None = None,
) -> Batch:
    """Identify every record in many files, each exactly once; what stopped half-way is taken up by the next call.

    A record that cannot be read or identified is a result too: "failed", with a sentence. A result is kept as soon as
    it is complete and taken as it is while files, settings and version stay the same.

    Args:
        sources: a file, a folder, a pattern ("runs/*.csv"), or several of them.
        folder: for the results; made if it does not exist.
        executor: who does the work: None for this process, any `concurrent.futures.Executor` (a process pool,
            `distributed.Client.get_executor()`), or `modal.batch.Workers`, whose processes are started again when they
            die. Its processes must see the same files.
        group_by: regular expression that is searched in the path of each file below their common folder; its first
            group names the record that the file belongs to. Unless given, each file is a record.
        inputs: names of the inputs, as in `okid.read_record`.
        outputs: names of the outputs.
        dt: time step [s], where the files have none.
        input_hold: what the inputs did between samples.
        observer_order: as in `modal.identify`.
        ridge: as in `modal.identify`.
        order: as in `modal.identify`.
        progress: called as `progress(what, share_done)`, the share of what is left to do when the call begins.

    Returns:
        The tables of all records and modes. The folder holds them too (records.parquet, modes.parquet, modes.csv),
        with batch.html, recording.rrd and a folder for each record.

    Raises:
        InvalidDataError: no file, a pattern that does not fit, or a folder that cannot be written.
        ExecutorError: the executor broke, or another batch works in the folder; finished results are kept.
    """
    target = Path(folder)
    settings = Settings(
        inputs=None if inputs is None else tuple(inputs),
        outputs=None if outputs is None else tuple(outputs),
        dt=dt,
        input_hold=input_hold,
        observer_order=observer_order,
        ridge=ridge,
        order=order,
    )
    tell = progress or (lambda _what, _share: None)
    tell("looking at the files", 0.0)
    units = units_of(sources, settings, group_by=group_by, beside=target)
    records = target / PLACES
    refuse_names(records, (), "refuse")
    try:
        records.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidDataError(f"{str(target)!r} cannot be made ({error.strerror or error}).") from error
    with _alone_in(target):
        _clear_parts(target)
        known = {unit.record: kept for unit in units if (kept := kept_outcome(folder_of(unit, records))) is not None}
        left = [unit for unit in units if unit.record not in known]
        try:
            for done, outcome in enumerate(_outcomes(left, settings, records, executor), start=1):
                known[outcome.record] = outcome
                tell(f"{len(known)} of {len(units)} records", done / (len(left) + 1))
        except BaseException:
            if isinstance(executor, Workers):
                executor.shutdown(cancel_futures=True)  # or they would leave parts behind after the next line
            raise
        finally:
            _clear_parts(target)
        tell("writing tables, page and recording", len(left) / (len(left) + 1))
        _write_summary(units, known, target)
    tell("done", 1.0)
    return Batch(target)


def _write_summary(units: Sequence[Unit], known: Mapping[str, Outcome], target: Path) -> None:
    outcomes = with_oddities([known[unit.record] for unit in units])
    write_tables(outcomes, [folder_of(unit, target / PLACES) for unit in units], target)
    batch = Batch(target)
    modes = batch.modes
    write_page(outcomes, modes, target)
    save_batch_recording([one.record for one in outcomes], modes, batch.records, target / "recording.rrd")


def _outcomes(units: Sequence[Unit], settings: Settings, records: Path, executor: Executor | None) -> Iterator[Outcome]:
    """What becomes of each record, as it becomes known."""
    if executor is None:
        yield from (run_unit(unit, settings, str(records)) for unit in units)
        return
    finished: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
    left, running = deque(units), dict[Future[Any], Unit]()
    done = 0
    try:
        while left or running:
            while left and len(running) < IN_FLIGHT:
                future = executor.submit(run_unit, left[0], settings, str(records))
                running[future] = left.popleft()
                future.add_done_callback(finished.put)
            future = finished.get()
            unit = running.pop(future)
            yield _settled(future, unit, records)
            done += 1
    except (IdentificationError, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # a broken pool, cancelled futures, submitting after shutdown, a lost scheduler
        raise _broken(error, done, len(units)) from error
    finally:
        for future in running:
            future.cancel()


def _settled(future: "Future[Any]", unit: Unit, records: Path) -> Outcome:
    try:
        outcome: Outcome = future.result()
    except Exception as error:
        if not (isinstance(error, WorkerDiedError) or type(error).__name__ == "KilledWorker"):  # the latter is dask's
            raise
        dead = Outcome(
            record=unit.record,
            paths=unit.paths,
            hash=unit.hash,
            status="failed",
            message=f"{' '.join(str(error).split())}; the file may be damaged, or its record too large for the memory.",
            lasting=False,
        )
        return write_failure(dead, folder_of(unit, records))
    return outcome


def _broken(error: BaseException, done: int, n_units: int) -> ExecutorError:
    why = f"{type(error).__name__}: {' '.join(str(error).split()) or 'no reason given'}"
    return ExecutorError(
        f"the executor broke ({why}) after {done} of {n_units} records; what is finished is kept, so call again with a "
        "new executor, or with modal.batch.Workers (--workers), which starts a dead process again."
    )


def _clear_parts(target: Path) -> None:
    """Remove what a killed process left half-written."""
    sweep(target / PLACES)
    for part in target.glob(".*.part"):
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder for one batch at a time; the system lets go of it when the process ends, however it ends."""
    try:
        import fcntl
    except ImportError:  # Windows refuses to replace files that another process holds open
        yield
        return
    lock = folder / ".batch.lock"
    with lock.open("w") as handle:
        try:
            fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # not inherited by the workers of a pool
        except OSError as error:
            raise ExecutorError(
                f"another batch is at work in {str(folder)!r}; wait for it, or choose another folder."
            ) from error
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)
