"""Our executor: processes that die are started again, a task that kills twice is given up, nothing else is lost."""

import os
import signal
import sys
import threading
from multiprocessing.context import SpawnProcess

import pytest

from modal.batch.running import WorkerDiedError, Workers

HELPERS = """
import os, signal
def die(number):
    os.kill(os.getpid(), number)
def die_once(flag):
    if not os.path.exists(flag):
        open(flag, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()
def leave():
    os._exit(3)
"""


@pytest.fixture
def helpers(tmp_path, monkeypatch):
    (tmp_path / "deadly_helpers.py").write_text(HELPERS)
    monkeypatch.syspath_prepend(str(tmp_path))
    import deadly_helpers

    yield deadly_helpers
    sys.modules.pop("deadly_helpers")


def test_deaths_concern_one_task(helpers, tmp_path):
    with Workers(1) as workers:
        deadly = workers.submit(helpers.die, signal.SIGKILL)
        leaving = workers.submit(helpers.leave)
        once = workers.submit(helpers.die_once, str(tmp_path / "flag"))
        well = [workers.submit(pow, 2, exponent) for exponent in range(5)]
        wrong = workers.submit(int, "x")
        unsendable = workers.submit(lambda: 1)
        assert [future.result() for future in well] == [1, 2, 4, 8, 16]
        assert once.result() != os.getpid()
        with pytest.raises(WorkerDiedError, match="signal 9, SIGKILL"):
            deadly.result()
        with pytest.raises(WorkerDiedError, match="exit status 3"):
            leaving.result()
        with pytest.raises(ValueError, match="invalid literal"):
            wrong.result()
        assert unsendable.exception() is not None
    with pytest.raises(RuntimeError, match="after shutdown"):
        workers.submit(pow, 2, 2)


def test_leaving_by_an_error_stops_at_once(helpers):
    futures = []

    def leave_early():
        with Workers(1) as workers:
            futures.extend(workers.submit(signal.pause) for _ in range(3))
            while not futures[0].running():
                pass
            raise KeyError

    with pytest.raises(KeyError):
        leave_early()
    assert futures[2].cancelled()
    assert all(future.done() for future in futures)


def test_a_process_that_is_being_started_when_all_is_cancelled_is_ended(monkeypatch):
    started, cancelled = threading.Event(), threading.Event()
    start = SpawnProcess.start

    def slow_start(process):
        start(process)
        started.set()
        assert cancelled.wait(30.0)

    monkeypatch.setattr(SpawnProcess, "start", slow_start)
    workers = Workers(1)
    future = workers.submit(signal.pause)
    assert started.wait(30.0)
    workers.shutdown(wait=False, cancel_futures=True)
    cancelled.set()
    assert isinstance(future.exception(30.0), WorkerDiedError)
    workers.shutdown()
