"""An executor of our own: a process that dies is started again, its task tried once more alone, then given up.

`ProcessPoolExecutor` loses every task that is waiting when one process dies. Here each process has a pipe of its own:
when it dies, one task is concerned, and the exit status says how. The second try waits until nothing else runs, so that
all memory is its own. A process ends by itself when its parent is gone.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import parent_process
from typing import Any

from okid.arrays import whole_number
from okid.errors import IdentificationError

__all__ = ["ExecutorError", "WorkerDiedError", "Workers", "usable_cores"]


class ExecutorError(IdentificationError):
    """What was to do the work cannot: an executor that broke, a scheduler that is not there."""


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

    Args:
        n_workers: how many.

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
