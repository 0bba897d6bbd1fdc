"""A batch from its sources to its tables, by any executor.

Every record is a task that leaves its own result behind, so nothing of a record comes back but a few words, and a
call that ended anywhere is taken up by the next one with the same arguments.

An executor of our own: a process that dies is started again, its task tried once more alone, then given up.

`ProcessPoolExecutor` loses every task that is waiting when one process dies. Here each process has a pipe of its own:
when it dies, one task is concerned, and the exit status says how. The second try waits until nothing else runs, so that
all memory is its own. A process ends by itself when its parent is gone.
"""

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import parent_process
from pathlib import Path
from typing import Any, Literal

from modal.batch.tables import PLACES, Batch, part_file, with_oddities, write_page, write_tables
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
from modal.recording.stream import save_batch_recording
from modal.report.folder import refuse_names, sweep
from okid.arrays import listener, whole_number
from okid.errors import ExecutorError, IdentificationError, InvalidDataError
from okid.record import InputHold


class WorkerDiedError(ExecutorError):
    """A process died twice at one task, the second time alone."""


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Task:
    future: "Future[Any]"
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    deaths: tuple[str, ...] = ()


class Workers(Executor):
    """Processes that are started again when they die.

    Example:
        >>> with Workers(1) as workers:
        ...     workers.submit(pow, 2, 10).result()
        1024
    """

    def __init__(self, n_workers: int) -> None:
        """Start as many threads; each starts its process with its first task."""
        number = whole_number(n_workers, name="a number of workers", least=1)
        self._ready = threading.Condition()
        self._waiting: deque[_Task] = deque()
        self._alone: deque[_Task] = deque()
        self._busy = 0
        self._closed = self._cancelled = False
        self._processes: set[Any] = set()
        self._threads = [threading.Thread(target=self._serve, daemon=True) for _ in range(number)]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> "Future[Any]":  # type: ignore[override]
        """Put a task in the line; function and arguments must be picklable (keywords: bind them by a partial)."""
        task = _Task(future=Future(), function=fn, arguments=args)
        with self._ready:
            if self._closed:
                raise RuntimeError("cannot schedule new futures after shutdown")
            self._waiting.append(task)
            self._ready.notify_all()
        return task.future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the line run empty; with `cancel_futures`, stop the processes and cancel what waits."""
        with self._ready:
            self._closed = True
            self._cancelled |= cancel_futures
            if cancel_futures:
                for task in (*self._waiting, *self._alone):
                    task.future.cancel()
                self._waiting.clear()
                self._alone.clear()
                for process in self._processes:
                    process.kill()
            self._ready.notify_all()
        if wait:
            for thread in self._threads:
                thread.join()

    def __exit__(self, kind: object, value: object, trace: object) -> None:
        """Stop at once where the block was left by an error or by Ctrl-C."""
        self.shutdown(cancel_futures=kind is not None)

    def _next(self) -> _Task | None:
        """The next task, None when there will be none; one that killed a process waits until nothing else runs."""
        with self._ready:
            while True:
                if self._waiting:
                    self._busy += 1
                    return self._waiting.popleft()
                if self._alone and not self._busy:
                    self._busy += 1
                    return self._alone.popleft()
                if self._closed and not self._alone and not self._busy:
                    self._ready.notify_all()
                    return None
                self._ready.wait()

    def _serve(self) -> None:
        """A thread: one process after the other, as they die."""
        worker: _Process | None = None
        while (task := self._next()) is not None:
            try:
                if not (task.deaths or task.future.set_running_or_notify_cancel()):
                    continue
                if task.deaths and worker is not None:  # the second try has a process of its own
                    self._stop(worker)
                    worker = None
                worker = worker or self._start()
                answer = _ask(worker, task)
                if isinstance(answer, str):
                    with self._ready:
                        self._processes.discard(worker.process)
                    worker = None
                    self._again(task, answer)
                elif answer[0]:
                    task.future.set_result(answer[1])
                else:
                    task.future.set_exception(answer[1])
            except Exception as error:  # noqa: BLE001 - the caller gets it, this thread goes on
                task.future.set_exception(error)
            finally:
                with self._ready:
                    self._busy -= 1
                    self._ready.notify_all()
        if worker is not None:
            self._stop(worker)

    def _start(self) -> "_Process":
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs,), daemon=True)
        process.start()
        theirs.close()
        with self._ready:
            self._processes.add(process)
            if self._cancelled:  # while it was being started: nobody else would stop it
                process.kill()
        return _Process(process=process, connection=ours)

    def _stop(self, worker: "_Process") -> None:
        worker.connection.close()  # the process reads the end of the pipe and leaves
        worker.process.join()
        with self._ready:
            self._processes.discard(worker.process)

    def _again(self, task: _Task, death: str) -> None:
        deaths = (*task.deaths, death)
        if len(deaths) == 1:
            with self._ready:
                if not self._cancelled:
                    self._alone.append(replace(task, deaths=deaths))
                    return
        how = " and ".join(dict.fromkeys(deaths))
        task.future.set_exception(
            WorkerDiedError(f"the process at work on it died twice, the second time alone ({how})")
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Process:
    process: Any
    connection: "Connection"


def _ask(worker: _Process, task: _Task) -> tuple[bool, Any] | str:
    """Whether it went well with what the process answered, or how it died."""
    process, connection = worker.process, worker.connection
    with contextlib.suppress(OSError, EOFError):
        connection.send((task.function, task.arguments))
        wait([connection, process.sentinel])
        if connection.poll():
            answer: tuple[bool, Any] = connection.recv()
            return answer
    process.join()
    connection.close()
    return _death(process.exitcode)


def _death(status: int | None) -> str:
    if status is not None and status < 0:
        with contextlib.suppress(ValueError):
            return f"signal {-status}, {signal.Signals(-status).name}"
    return f"exit status {status}"


def _work(connection: Connection) -> None:
    """A process: tasks until the pipe ends. Ctrl-C is the parent's business; it dies with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        while True:
            function, arguments = connection.recv()
            try:
                answer = (True, function(*arguments))
            except Exception as error:  # noqa: BLE001 - handed to the caller
                answer = (False, error)
            connection.send(answer)


def _leave_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)


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
    tell = listener(progress)
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
    with part_file(target / "recording.rrd") as part:
        save_batch_recording([one.record for one in outcomes], modes, batch.records, part)


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
            while left and len(running) < 1000:  # enough for hundreds of workers
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
        how = " ".join(str(error).split()).rstrip(".")
        dead = Outcome(
            record=unit.record,
            paths=unit.paths,
            hash=unit.hash,
            status="failed",
            message=f"{how}; the file may be damaged, or its record too large for the memory.",
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
