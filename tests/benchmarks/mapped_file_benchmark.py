"""A mapped file of a million samples: CPU time and memory beyond the file of the fit and 200 Markov parameters.

    python tests/benchmarks/mapped_file_benchmark.py [--samples 1000000] [--outputs 64] [--inputs 4] [--order 40]

Wanted: about 2 s of one core and less than 250 MB. Memory is the process's anonymous memory (RssAnon of
/proc/self/status, sampled every 5 ms): pages of the mapped file belong to the file cache. The interpreter with its
libraries is included.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

N_LAGS = 200


def make_file(path, n_samples, n_inputs, n_outputs):
    """White inputs through eight modes, 1 % noise, written in pieces: inputs in the first columns."""
    rng = np.random.default_rng(7)
    pole = np.exp(2 * np.pi * np.linspace(0.02, 0.4, 8) * (-0.01 + 1j))
    B = rng.standard_normal((8, n_inputs)) + 1j * rng.standard_normal((8, n_inputs))
    C = rng.standard_normal((n_outputs, 8)) + 1j * rng.standard_normal((n_outputs, 8))
    data = np.memmap(path, dtype=np.float64, mode="w+", shape=(n_samples, n_inputs + n_outputs))
    state = np.zeros(8, dtype=complex)
    for start in range(0, n_samples, 50_000):
        stop = min(start + 50_000, n_samples)
        u = rng.standard_normal((stop - start, n_inputs))
        driven, states = u @ B.T, np.empty((stop - start, 8), dtype=complex)
        for k in range(stop - start):
            states[k] = state
            state = pole * state + driven[k]
        y = 2 * (states @ C.T).real
        data[start:stop, :n_inputs] = u
        data[start:stop, n_inputs:] = y + 0.05 * rng.standard_normal(y.shape)
    data.flush()


def anonymous_megabytes():
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("RssAnon"):
            return int(line.split()[1]) / 1024
    return float("nan")


def measure(path, n_samples, n_inputs, n_outputs, order):
    from okid.markov import recover_markov
    from okid.observer import fit_observer
    from okid.record import Record

    peak, done = [anonymous_megabytes()], threading.Event()
    before = peak[0]

    def watch():
        while not done.wait(0.005):
            peak[0] = max(peak[0], anonymous_megabytes())

    watcher = threading.Thread(target=watch)
    watcher.start()
    data = np.memmap(path, dtype=np.float64, mode="r", shape=(n_samples, n_inputs + n_outputs))
    started = time.process_time()
    record = Record(data[:, :n_inputs], data[:, n_inputs:], 0.001)
    loaded = time.process_time()
    fit = fit_observer(record, order=order)
    fitted = time.process_time()
    recover_markov(fit, n_lags=N_LAGS)
    finished = time.process_time()
    done.set()
    watcher.join()
    print(
        json.dumps(
            {
                "record_s": loaded - started,
                "fit_s": fitted - loaded,
                "recovery_s": finished - fitted,
                "import_mb": before,
                "peak_mb": peak[0],
                "method": fit.method,
            }
        )
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--outputs", type=int, default=64)
    parser.add_argument("--inputs", type=int, default=4)
    parser.add_argument("--order", type=int, default=40)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--folder", help="where to put the file; a temporary folder unless given")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    options = parser.parse_args()
    sizes = [options.samples, options.inputs, options.outputs]
    if options.measure:
        measure(options.measure, *sizes, options.order)
        return
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = str(Path(__file__).resolve().parents[2])
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        path = str(Path(folder) / "samples.bin")
        make_file(path, *sizes)
        print(f"{Path(path).stat().st_size / 2**20:.0f} MiB in the file; seconds of one core, MiB of anonymous memory")
        for _ in range(options.rounds):
            command = [sys.executable, __file__, "--measure", path, *(a for a in sys.argv[1:] if a != "--measure")]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
            if done.returncode:
                sys.exit(done.stderr)
            found = json.loads(done.stdout.splitlines()[-1])
            print(
                f"record {found['record_s']:.2f}  fit {found['fit_s']:.2f}  recovery {found['recovery_s']:.2f} s   "
                f"peak {found['peak_mb']:.0f}, after import {found['import_mb']:.0f}   {found['method']}",
                flush=True,
            )


if __name__ == "__main__":
    main()
