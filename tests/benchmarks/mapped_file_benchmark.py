"""A mapped file of a million samples: CPU time and memory beyond the file of the check, the fit and its recovery.

    python tests/benchmarks/mapped_file_benchmark.py [--samples 1000000] [--outputs 64] [--inputs 4] [--order 40]
                                                     [--chunks]

With `--chunks` the fit alone, in this process and by two workers of which one is killed (SIGKILL) in the middle.

Memory is the process's anonymous memory (RssAnon of /proc/self/status, sampled every 5 ms): pages of the mapped file
belong to the file cache. What the interpreter and its libraries hold before the first stage is told apart. One BLAS
thread.
"""

import argparse
import os
import signal
import tempfile
import threading
import time
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402 - after the threads are set
from cost_board import simulated  # noqa: E402

import modal  # noqa: E402
import okid  # noqa: E402
import okid.scaling  # noqa: E402
from modal.batch import Workers  # noqa: E402
from okid import gram  # noqa: E402

N_LAGS = 200
PIECE = 50_000


def make_file(path, options):
    """Eight modes under 3 % noise, the same stretch again and again: inputs in the first columns."""
    sizes = {"n_inputs": options.inputs, "n_outputs": options.outputs, "n_modes": 8}
    piece = np.hstack(simulated({"n_samples": min(PIECE, options.samples), **sizes}, np.random.default_rng(7)))
    data = np.memmap(path, dtype=np.float64, mode="w+", shape=(options.samples, piece.shape[1]))
    for start in range(0, options.samples, PIECE):
        data[start : start + PIECE] = piece[: options.samples - start]
    data.flush()


def anonymous_megabytes():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("RssAnon"))


def measured(call):
    """(result, CPU seconds, largest anonymous memory in MiB) of a call."""
    peak, done = [anonymous_megabytes()], threading.Event()

    def watch():
        while not done.wait(0.005):
            peak[0] = max(peak[0], anonymous_megabytes())

    watcher = threading.Thread(target=watch)
    watcher.start()
    start = time.process_time()
    result = call()
    seconds = time.process_time() - start
    done.set()
    watcher.join()
    return result, seconds, peak[0]


class Killed(Workers):
    """Two processes, the first of which is killed after so many tasks; counts tasks."""

    def __init__(self, after):
        super().__init__(2)
        self.after, self.n_tasks = after, 0

    def submit(self, function, *arguments):
        self.n_tasks += 1
        if self.n_tasks >= self.after and self._processes:
            self.after = np.inf
            os.kill(min(process.pid for process in self._processes), signal.SIGKILL)
        return super().submit(function, *arguments)


def by_chunks(record, order, before):
    """The fit in one pass and by chunks: cost, memory, and how far apart."""
    scaling, *told = measured(lambda: okid.scaling.channel_scaling([record]))
    print(f"scaling: {told[0]:.2f} s, {told[1] - before:.0f} MiB more")
    whole, *told = measured(lambda: gram.lag_gram([record], order, scaling=scaling))
    print(f"Gram in one pass: {told[0]:.2f} s, {told[1] - before:.0f} MiB more")
    n_chunks = -(-record.n_samples * (record.n_inputs + record.n_outputs) // gram.SENT_VALUES)
    spent, start = sum(os.times()[:4]), time.perf_counter()
    with Killed(n_chunks // 2) as workers:
        parts, *told = measured(lambda: gram.chunked_gram([record], order, scaling=scaling, executor=workers))
        n_tasks = workers.n_tasks
    spent, wall = sum(os.times()[:4]) - spent, time.perf_counter() - start
    apart = np.abs(parts.matrix - whole.matrix).max() / np.abs(whole.matrix).max()
    print(
        f"Gram by two workers, one killed: {n_tasks} chunks, {parts.n_rows - whole.n_rows} rows too many, {wall:.1f} s "
        f"of wall, {spent:.1f} s of CPU, {told[1] - before:.0f} MiB more in the parent; apart by {apart:.1e}"
    )
    fit, *told = measured(lambda: okid.fit_observer(record, order=order))
    print(f"fit_observer: {told[0]:.2f} s, {told[1] - before:.0f} MiB more, {fit}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--outputs", type=int, default=64)
    parser.add_argument("--inputs", type=int, default=4)
    parser.add_argument("--order", type=int, default=40)
    parser.add_argument("--folder", help="where to put the file; a temporary folder unless given")
    parser.add_argument("--chunks", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        path = Path(folder) / "samples.bin"
        make_file(path, options)
        n_inputs, shape = options.inputs, (options.samples, options.inputs + options.outputs)
        data = np.memmap(path, dtype=np.float64, mode="r", shape=shape)
        small = okid.Record(data[:2000, :n_inputs], data[:2000, n_inputs:], 0.001)
        modal.check_quality(small)  # imports
        before = anonymous_megabytes()
        print(f"{path.stat().st_size / 2**20:.0f} MiB in the file, {before:.0f} MiB of memory before the first stage")
        record, *told = measured(lambda: okid.Record(data[:, :n_inputs], data[:, n_inputs:], 0.001))
        if options.chunks:
            by_chunks(record, options.order, before)
            return
        _, *told_of_check = measured(lambda: modal.check_quality(record))
        observer, *told_of_fit = measured(lambda: okid.fit_observer(record, order=options.order))
        _, *told_of_recovery = measured(lambda: okid.recover_markov(observer, n_lags=N_LAGS))
        stages = {"record": told, "check": told_of_check, "fit": told_of_fit, "recovery": told_of_recovery}
        for stage, (seconds, peak) in stages.items():
            print(f"{stage}: {seconds:.2f} s, {peak - before:.0f} MiB more")


if __name__ == "__main__":
    main()
