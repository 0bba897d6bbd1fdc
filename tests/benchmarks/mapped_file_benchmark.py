"""A mapped file of a million samples: CPU time and memory beyond the file of the check, the fit and its recovery.

    python tests/benchmarks/mapped_file_benchmark.py [--samples 1000000] [--outputs 64] [--inputs 4] [--order 40]

Memory is the process's anonymous memory (RssAnon of /proc/self/status, sampled every 5 ms): pages of the mapped file
belong to the file cache. What the interpreter and its libraries hold before the first stage is told apart. One BLAS
thread.
"""

import argparse
import os
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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--outputs", type=int, default=64)
    parser.add_argument("--inputs", type=int, default=4)
    parser.add_argument("--order", type=int, default=40)
    parser.add_argument("--folder", help="where to put the file; a temporary folder unless given")
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
        _, *told_of_check = measured(lambda: modal.check_quality(record))
        observer, *told_of_fit = measured(lambda: okid.fit_observer(record, order=options.order))
        _, *told_of_recovery = measured(lambda: okid.recover_markov(observer, n_lags=N_LAGS))
        stages = {"record": told, "check": told_of_check, "fit": told_of_fit, "recovery": told_of_recovery}
        for stage, (seconds, peak) in stages.items():
            print(f"{stage}: {seconds:.2f} s, {peak - before:.0f} MiB more")


if __name__ == "__main__":
    main()
