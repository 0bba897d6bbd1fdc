"""A batch: every record once, whoever works; failures are results; what is finished stays."""

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.context import SpawnProcess
from pathlib import Path

import numpy as np
import pytest
from remembered import remembered

import modal
import okid
from modal.batch import Batch, ExecutorError, running, task
from modal.batch.running import WorkerDiedError, Workers
from modal.command import many
from modal.command.main import status as _status
from modal.report import folder
from okid import gram
from okid.errors import InvalidDataError, UnreadableFileError

from .conftest import QUICK, write_run, write_runs

COMMAND = "from modal.command.entry import main\nif __name__ == '__main__':\n    main()\n"
CRASH = """
import os, sys
flag = {flag!r}
def hook(event, arguments):
    if event == "open" and str(arguments[0]).endswith("crash.csv") and "spawn_main" in " ".join(sys.orig_argv):
        if not flag or not os.path.exists(flag):
            flag and os.close(os.open(flag, os.O_CREAT))
            os.kill(os.getpid(), 11)
sys.addaudithook(hook)
"""
"""As sitecustomize: a worker that opens crash.csv dies of a segmentation fault, always or once."""


def kept(folder):
    """Bytes of all that must not depend on who worked."""
    names = ("result.npz", "modes.csv", "modes.parquet")
    files = [path for path in sorted(folder.rglob("*")) if path.name in names]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def parts(folder):
    return [path for path in folder.rglob("*") if path.name.startswith(".")]


def rows(batch):
    return {row["record"]: row for row in batch.records.to_pylist()}


def command(tmp_path, *arguments, sitecustomize=""):
    (tmp_path / "command.py").write_text(COMMAND)
    (tmp_path / "site").mkdir(exist_ok=True)
    (tmp_path / "site" / "sitecustomize.py").write_text(sitecustomize)
    python_path = os.pathsep.join([str(tmp_path / "site"), *sys.path])
    quick = ("--inputs", "force", "--observer-order", "8", "--ridge", "1e-6", "--order", "2")
    return subprocess.Popen(
        [sys.executable, str(tmp_path / "command.py"), "batch", *arguments, *quick],
        env={**os.environ, "PYTHONPATH": python_path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


identified = remembered(task.identify)


@pytest.fixture
def known(monkeypatch):
    """In this process the same records are identified once: what is asked is what a batch does around that."""
    monkeypatch.setattr(task, "identify", identified)


@pytest.fixture(scope="module")
def sequential(tmp_path_factory):
    """The batch of the four runs, made once; nobody writes to it."""
    folder = tmp_path_factory.mktemp("sequential")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(task, "identify", identified)
        return modal.identify_batch(write_runs(folder / "runs"), folder / "out", **QUICK)


def test_tables_hold_every_mode_of_every_record(sequential):
    records = sequential.records.to_pylist()
    assert [row["record"] for row in records] == [f"run_{seed}" for seed in range(4)]
    assert all(row["status"] == "done" and not row["message"] and len(row["hash"]) == 64 for row in records)
    modes = sequential.modes.to_pylist()
    results = list(sequential.results())
    assert len(results) == 4
    for seed, result in enumerate(results):
        own = [row for row in modes if row["record"] == f"run_{seed}"]
        assert {row["start_time"] for row in own} == {3600.0 * seed}
        first = result.modes.system[0]
        assert own[0]["frequency"] == first.frequency == pytest.approx(3.0, rel=5e-3)
        assert own[0]["shape"] == [{"real": one.real, "imag": one.imag} for one in first.shape]
        assert (own[0]["mode"], own[0]["verdict"]) == (1, "system")
    for name in ("batch.html", "recording.rrd", "modes.csv"):
        assert (sequential.folder / name).stat().st_size > 100
    assert not parts(sequential.folder)


def test_executors_leave_the_same_bytes(known, runs, sequential, tmp_path):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        modal.identify_batch(str(runs / "*.csv"), tmp_path / "pool", executor=executor, **QUICK)
    with ThreadPoolExecutor(1) as executor:
        files = sorted(runs.iterdir(), reverse=True)
        modal.identify_batch(files, tmp_path / "threads", executor=executor, **QUICK)
    assert kept(sequential.folder) == kept(tmp_path / "pool") == kept(tmp_path / "threads")
    assert len(kept(sequential.folder)) == 2 * 4 + 2


def test_a_second_call_works_on_nothing_and_a_changed_file_anew(known, runs, tmp_path):
    sequential = modal.identify_batch(runs, tmp_path / "out", **QUICK)
    stamps = {path: path.stat().st_mtime_ns for path in sequential.folder.rglob("result.npz")}
    before = sequential.modes
    again = modal.identify_batch(runs, sequential.folder, **QUICK)
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps
    assert again.modes.equals(before)
    write_run(runs / "run_2.csv", 2, frequency=5.0)
    changed = modal.identify_batch(runs, sequential.folder, **QUICK)
    frequencies = {row["record"]: row["frequency"] for row in changed.modes.to_pylist() if row["mode"] == 1}
    assert frequencies["run_2"] == pytest.approx(5.0, rel=5e-3)
    assert frequencies["run_1"] == pytest.approx(3.0, rel=5e-3)
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps
    (outcome,) = sequential.folder.glob("records/run_1-*/outcome.json")
    told = json.loads(outcome.read_text())
    outcome.write_text(json.dumps({name: told[name] for name in told if name != "modes"}))
    assert modal.identify_batch(runs, sequential.folder, **QUICK).modes.equals(changed.modes)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with a name are of Unix")
def test_a_pipe_is_a_failure_and_not_waited_for(known, runs, tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    found = rows(modal.identify_batch([runs / "run_0.csv", tmp_path / "pipe.csv"], tmp_path / "out", **QUICK))
    assert (found["run_0"]["status"], found["pipe"]["status"]) == ("done", "failed")
    assert "is a pipe or a device, and no file" in found["pipe"]["message"]


def test_a_batch_looks_for_what_dead_runs_left_as_often_whatever_its_size(tmp_path, monkeypatch):
    """Beside each record it would see all others: a cost of their square."""
    looks, look = [], folder.sweep
    for module in (folder, running):
        monkeypatch.setattr(module, "sweep", lambda parent: looks.append(parent) or look(parent))
    (tmp_path / "out" / "records" / ".modal-report-dead").mkdir(parents=True)
    for n_files in (1, 5):
        for number in range(n_files):
            (tmp_path / f"empty_{number}.csv").write_text("")
        batch = modal.identify_batch(str(tmp_path / "*.csv"), tmp_path / "out", **QUICK)
        assert len(rows(batch)) == n_files
        assert not parts(batch.folder)
        assert len(looks) == 2
        looks.clear()


def test_failures_are_results_with_a_sentence_and_exit_1(known, runs, tmp_path, capsys, monkeypatch):
    """By the command, with a thread for its processes: those are asked where one dies."""
    monkeypatch.setattr(many, "Workers", ThreadPoolExecutor)
    (runs / "empty.csv").write_text("")
    (runs / "cut.csv").write_text((runs / "run_1.csv").read_text()[:200])
    (runs / "twin.csv").write_bytes((runs / "run_0.csv").read_bytes())
    write_run(runs / "slow.csv", 9, dt=0.04)
    write_run(runs / "unit.csv", 10, header="time,force,a [m/s],b")
    quick = ("--inputs", "force", "--observer-order", "8", "--ridge", "1e-6", "--order", "2")
    status = _status(["batch", str(runs), "-o", str(tmp_path / "out"), "--workers", "1", *quick])
    assert status == 1
    found = rows(Batch(tmp_path / "out"))
    assert {name for name, row in found.items() if row["status"] == "failed"} == {"empty", "cut", "twin"}
    assert "run_0" in found["twin"]["message"]
    assert "0 bytes" in found["empty"]["message"]
    assert "time step 0.04 s (most: 0.02 s)" in found["slow"]["message"]
    assert "without output a; with output a [m/s]" in found["unit"]["message"]
    assert all(not row["message"] for name, row in found.items() if name.startswith("run_"))
    said = capsys.readouterr().out
    assert "6 of 9 records identified" in said
    page = (tmp_path / "out" / "batch.html").read_text()
    assert "3 failed" in page
    assert "twin" in page


def test_a_crashing_file_costs_one_file(runs, sequential, tmp_path):
    write_run(runs / "crash.csv", 20)
    out = tmp_path / "out"
    process = command(tmp_path, str(runs), "-o", str(out), "--workers", "1", sitecustomize=CRASH.format(flag=""))
    _, errors = process.communicate()
    assert (process.returncode, errors) == (1, "")
    found = rows(Batch(out))
    assert found["crash"]["status"] == "failed"
    assert "died twice, the second time alone (signal 11, SIGSEGV); the file" in found["crash"]["message"]
    assert [row["status"] for row in found.values()].count("done") == 4
    ours, theirs = kept(out), kept(sequential.folder)
    assert ours == theirs
    assert not parts(out)


@pytest.mark.slow  # what `test_deaths_concern_one_task` asks of workers alone
def test_a_worker_that_dies_once_costs_nothing(runs, tmp_path):
    write_run(runs / "crash.csv", 20)
    flag = str(tmp_path / "flag")
    arguments = (str(runs / "crash.csv"), str(runs / "run_0.csv"), "-o", str(tmp_path / "out"), "--workers", "2")
    process = command(tmp_path, *arguments, sitecustomize=CRASH.format(flag=flag))
    _, errors = process.communicate()
    assert (process.returncode, errors) == (0, "")
    assert {row["status"] for row in Batch(tmp_path / "out").records.to_pylist()} == {"done"}
    assert Path(flag).exists()


def test_what_a_killed_parent_finished_is_kept(known, runs, sequential, tmp_path):
    for seed in range(4, 7):
        write_run(runs / f"run_{seed:02d}.csv", seed)
    out = tmp_path / "out"
    process = command(tmp_path, str(runs), "-o", str(out), "--workers", "1")
    deadline = time.monotonic() + 120
    while not list(out.glob("records/[!.]*/outcome.json")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    first = {path: path.stat().st_mtime_ns for path in out.glob("records/[!.]*/result.npz")}  # whole ones only
    assert 1 <= len(first) < 7
    (out / "records" / ".modal-report-left").mkdir()
    with pytest.raises(UnreadableFileError, match=r"no modes\.parquet"):
        Batch(out)
    whole = modal.identify_batch(runs, out, **QUICK)
    assert whole.records.num_rows == 7
    assert {path: path.stat().st_mtime_ns for path in first} == first
    assert not parts(out)
    ours = kept(out)
    assert all(ours[name] == content for name, content in kept(sequential.folder).items() if "run_" in name)


def test_a_broken_executor_is_one_sentence_and_finished_results_stay(known, runs, tmp_path):
    out = tmp_path / "out"
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor,
        pytest.raises(ExecutorError, match=r"the executor broke \(BrokenProcessPool: .*--workers"),
    ):
        modal.identify_batch(runs, out, executor=Breaking(executor, after=2), **QUICK)
    done = {path: path.stat().st_mtime_ns for path in out.glob("records/*/result.npz")}
    assert len(done) == 2
    modal.identify_batch(runs, out, **QUICK)
    assert {path: path.stat().st_mtime_ns for path in done} == done
    closed = ThreadPoolExecutor(1)
    closed.shutdown()
    write_run(runs / "new.csv", 30)
    with pytest.raises(ExecutorError, match="after shutdown"):
        modal.identify_batch(runs, out, executor=closed, **QUICK)


class Breaking:
    """Hands tasks on, and a deadly one after so many."""

    def __init__(self, executor, after):
        self.executor, self.after = executor, after

    def submit(self, function, *arguments):
        self.after -= 1
        if self.after >= 0:
            future = self.executor.submit(function, *arguments)
            future.result()
            return future
        return self.executor.submit(signal.raise_signal, signal.SIGKILL)


def test_groups_of_files_are_one_result_each(tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    for test in ("a", "b"):
        for part in range(2):
            write_run(folder / f"{test}_{part}.csv", 10 * ord(test) + part)
    batch = modal.identify_batch(folder, tmp_path / "out", group_by=r"([ab])_\d", **QUICK)
    assert [row["record"] for row in batch.records.to_pylist()] == ["a", "b"]
    assert [len(result.records) for result in batch.results()] == [2, 2]
    with pytest.raises(InvalidDataError, match="does not match"):
        modal.identify_batch(folder, tmp_path / "out", group_by="run_(.)", **QUICK)
    with pytest.raises(InvalidDataError, match="has no group"):
        modal.identify_batch(folder, tmp_path / "out", group_by="c", **QUICK)


def test_a_copy_is_named_and_fails_no_more_once_it_is_alone(runs, tmp_path):
    for copy in ("run_1", "run_4"):
        (runs / f"{copy}_again.csv").write_bytes((runs / "run_0.csv").read_bytes())
    found = rows(modal.identify_batch(runs, tmp_path / "out", group_by=r"run_(\d)", **QUICK))
    assert [found[name]["status"] for name in "01234"] == ["done", "failed", "done", "done", "failed"]
    assert "its file run_1_again.csv holds the same bytes as '0'" in found["1"]["message"]
    assert found["4"]["message"].startswith("it holds the same bytes as '0'")
    (runs / "run_0.csv").unlink()
    (runs / "run_1_again.csv").unlink()
    found = rows(modal.identify_batch(runs, tmp_path / "out", group_by=r"run_(\d)", **QUICK))
    assert {name: row["status"] for name, row in found.items()} == dict.fromkeys("1234", "done")


def test_records_of_one_name_in_two_folders_keep_both(tmp_path):
    for day in ("monday", "tuesday"):
        (tmp_path / day).mkdir()
        write_run(tmp_path / day / "run.csv", len(day))
    batch = modal.identify_batch([tmp_path / "monday", tmp_path / "tuesday"], tmp_path / "out", **QUICK)
    assert [row["record"] for row in batch.records.to_pylist()] == ["monday/run", "tuesday/run"]


def test_channels_that_a_record_lacks_are_nan_in_the_shapes(tmp_path):
    write_run(tmp_path / "x.csv", 1)
    write_run(tmp_path / "y.csv", 2, header="time,force,a,c")
    batch = modal.identify_batch([tmp_path / "x.csv", tmp_path / "y.csv"], tmp_path / "out", **QUICK)
    assert json.loads(batch.modes.schema.field("shape").metadata[b"outputs"]) == ["a", "b", "c"]
    shapes = {row["record"]: [one["real"] for one in row["shape"]] for row in batch.modes.to_pylist()}
    assert np.isnan(shapes["x"][2])
    assert np.isnan(shapes["y"][1])
    assert np.isfinite([*shapes["x"][:2], shapes["y"][0], shapes["y"][2]]).all()


def test_a_file_that_was_cut_off_at_a_whole_row_is_named(known, runs, tmp_path):
    cut = runs / "run_2.csv"
    cut.write_text("".join(cut.read_text().splitlines(keepends=True)[:130])[:-4])  # within the last number
    told = {name: row["message"] for name, row in rows(modal.identify_batch(runs, tmp_path / "out", **QUICK)).items()}
    assert [name for name, message in told.items() if message] == ["run_2"]
    assert "129 samples (most: 250), so its file may be cut off" in told["run_2"]


def test_a_dead_channel_is_nan_in_the_shapes_and_named(known, runs, tmp_path):
    dead = runs / "run_2.csv"
    heading, *lines = dead.read_text().splitlines()
    dead.write_text("\n".join([heading, *(f"{line.rpartition(',')[0]},0" for line in lines)]) + "\n")
    batch = modal.identify_batch(runs, tmp_path / "out", **QUICK)
    assert {row["status"] for row in batch.records.to_pylist()} == {"done"}
    shapes = {row["record"]: [one["real"] for one in row["shape"]] for row in batch.modes.to_pylist()}
    assert np.isfinite(shapes["run_1"]).all()
    assert np.isfinite(shapes["run_2"]).tolist() == [True, False]
    told = {name: row["message"] for name, row in rows(batch).items() if row["message"]}
    assert list(told) == ["run_2"]
    assert "with a dead output b" in told["run_2"]


def test_wrong_use_is_one_sentence(runs, tmp_path, capsys):
    def refused(*arguments):
        status = _status(["batch", *arguments])
        said = capsys.readouterr()
        assert (status, said.out, said.err.count("\n")) == (2, "", 1)
        return said.err

    out = str(tmp_path / "out")
    assert "holds or matches no measured file" in refused(str(tmp_path / "*.nothing"), "-o", out)
    assert "exclude each other" in refused(str(runs), "-o", out, "--workers", "1", "--scheduler", "tcp://127.0.0.1:1")
    said = refused(str(runs), "-o", out, "--scheduler", "tcp://127.0.0.1:1")
    assert "dask.distributed" in said or "no scheduler answers" in said
    (tmp_path / "file").write_text("")
    assert "cannot be a folder" in refused(str(runs), "-o", str(tmp_path / "file"), "--workers", "1")


def test_a_full_disk_stops_with_one_sentence_and_keeps_what_is_done(known, runs, tmp_path, monkeypatch):
    write, calls = task.keep_result, []

    def full(result, path, *, files):
        calls.append(path)
        if len(calls) > 2:
            raise InvalidDataError(f"{path} cannot be written (No space left on device); use another place.")
        return write(result, path, files=files)

    monkeypatch.setattr(task, "keep_result", full)
    with pytest.raises(InvalidDataError, match="No space left"):
        modal.identify_batch(runs, tmp_path / "out", **QUICK)
    assert len(list((tmp_path / "out").glob("records/*/result.npz"))) == 2
    assert not parts(tmp_path / "out")
    monkeypatch.undo()
    assert modal.identify_batch(runs, tmp_path / "out", **QUICK).records.num_rows == 4


@pytest.mark.slow  # the first case is what `test_a_full_disk_stops_with_one_sentence_and_keeps_what_is_done` asks
@pytest.mark.skipif(sys.platform == "win32", reason="the largest size of a file is a limit of Unix")
def test_a_disk_that_fills_up_for_the_command_is_one_sentence_whenever_it_does(runs, sequential, tmp_path):
    """The system itself refuses: at the first result, or at the last summary when all results are kept."""
    out = tmp_path / "out"
    largest = max(path.stat().st_size for path in sequential.folder.rglob("result.npz"))
    recording = (sequential.folder / "recording.rrd").stat().st_size
    assert recording > largest
    for size, n_kept in ((largest // 2, 0), ((largest + recording) // 2, 4)):
        limit = f"import resource as r; r.setrlimit(r.RLIMIT_FSIZE, ({size}, r.RLIM_INFINITY))"
        process = command(tmp_path, str(runs), "-o", str(out), "--workers", "1", sitecustomize=limit)
        said, errors = process.communicate()
        assert (process.returncode, said, errors.count("\n")) == (2, "", 1)
        assert "cannot be written (File too large)" in errors
        assert "kept, so make room and give the same command again" in errors
        results = list(out.glob("records/*/result.npz"))
        assert len(results) == n_kept
        assert not parts(out)
    stamps = {path: path.stat().st_mtime_ns for path in results}
    modal.identify_batch(runs, out, **QUICK)
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps
    assert kept(out) == kept(sequential.folder)


HELPERS = """
import os, signal
def leave_once(flag):
    if not os.path.exists(flag):
        open(flag, "w").close()
        os._exit(3)
    return os.getpid()
def leave_then_die(flag):
    os.kill(leave_once(flag), signal.SIGKILL)
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
        deadly = workers.submit(helpers.leave_then_die, str(tmp_path / "deadly"))
        once = workers.submit(helpers.leave_once, str(tmp_path / "once"))
        well = [workers.submit(pow, 2, exponent) for exponent in range(5)]
        wrong = workers.submit(int, "x")
        unsendable = workers.submit(lambda: 1)
        assert [future.result() for future in well] == [1, 2, 4, 8, 16]
        assert once.result() != os.getpid()
        with pytest.raises(WorkerDiedError, match="exit status 3 and signal 9, SIGKILL"):
            deadly.result()
        with pytest.raises(ValueError, match="invalid literal"):
            wrong.result()
        assert unsendable.exception() is not None
    with pytest.raises(RuntimeError, match="after shutdown"):
        workers.submit(pow, 2, 2)


def test_chunks_of_a_record_count_once_whoever_dies(monkeypatch):
    """The only process is killed in the middle of the chunks of one record."""
    monkeypatch.setattr(gram, "SENT_VALUES", 2000)
    values = np.random.default_rng(22002).standard_normal((20_000, 3))
    record = okid.Record(values[:, :1], values[:, 1:], 0.1)
    with Workers(1) as workers:
        submit = workers.submit

        def killing(function, *arguments):
            future = submit(function, *arguments)
            if next(submitted) == 20:
                os.kill(next(iter(workers._processes)).pid, signal.SIGKILL)
            return future

        submitted = itertools.count(1)
        monkeypatch.setattr(workers, "submit", killing)
        fit = okid.fit_observer(record, order=5, executor=workers)
    assert next(submitted) > 20
    alone = okid.fit_observer(record, order=5)
    assert fit.n_rows == alone.n_rows
    np.testing.assert_allclose(fit.output_coefficients, alone.output_coefficients, rtol=1e-9, atol=1e-12)


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
