"""What `modal.follow` on a growing file costs: 16 outputs x 2 inputs at 10 kHz, observer order 50, window 2 s.

    python tests/benchmarks/live_benchmark.py [npy|csv]

A process of its own appends a row every 0.1 ms, in pieces of 10 ms. Latency is the time from the moment at which the
last row of a block was written to the estimate that holds it; cost is the CPU time of the reader over the time of the
record.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import modal
from modal.tracking.live import growing_blocks

RATE, N_INPUTS, N_OUTPUTS, SECONDS, BLOCK, WINDOW, ORDER = 10_000, 2, 16, 12.0, 0.2, 2.0, 50

WRITER = """
import sys, time
import numpy as np
values = np.load(sys.argv[2])
pieces = [values[k : k + 100] for k in range(0, len(values), 100)]
if sys.argv[1].endswith("npy"):
    pieces = [piece.tobytes() for piece in pieces]
else:
    pieces = ["".join(",".join(f"{x:.8g}" for x in row) + "\\n" for row in piece).encode() for piece in pieces]
start = time.time()
print(start, flush=True)
with open(sys.argv[1], "ab", buffering=0) as file:
    for k, piece in enumerate(pieces):
        time.sleep(max(0.0, start + (k + 1) / 100 - time.time()))
        file.write(piece)
"""


def record():
    rng = np.random.default_rng(1)
    n = int(SECONDS * RATE)
    inputs = rng.standard_normal((n, N_INPUTS))
    outputs = np.zeros((n, N_OUTPUTS))
    import scipy

    for frequency in (120.0, 260.0, 430.0, 700.0, 1100.0, 1500.0):
        pole = np.exp((-0.01 + 1j) * 2 * np.pi * frequency / RATE)
        drive = inputs @ rng.standard_normal(N_INPUTS)
        state = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], drive)
        outputs += np.outer(state, rng.standard_normal(N_OUTPUTS))
    return np.hstack([inputs, outputs + 0.02 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="?", choices=("npy", "csv"), default="npy", help="of the growing file")
    kind = parser.parse_args().kind
    with tempfile.TemporaryDirectory() as folder:
        path, source = Path(folder) / f"run.{kind}", Path(folder) / "source.npy"
        values = record()
        np.save(source, values)
        names = [f"column_{k}" for k in range(N_INPUTS + N_OUTPUTS)]
        if kind == "npy":
            np.save(path, values[:0])
        else:
            path.write_text(",".join(names) + "\n")
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path), str(source)], stdout=subprocess.PIPE, text=True
        )
        began = float(writer.stdout.readline())
        cpu = time.process_time()
        late, first = [], None
        blocks = growing_blocks(path, inputs=names[:2], dt=1.0 / RATE, block=BLOCK, patience=1.0)
        for estimate in modal.follow(blocks, dt=1.0 / RATE, window=WINDOW, observer_order=ORDER, order=12):
            late.append(time.time() - began - (estimate.time + 0.5 * WINDOW))
            first = first or (time.process_time() - cpu)
        used = time.process_time() - cpu
        writer.wait()
    print(f"{kind}: {len(late)} estimates, latency median {np.median(late):.3f} s, largest {max(late):.3f} s")
    print(f"CPU {used:.2f} s for {SECONDS:.0f} s of record ({100 * used / SECONDS:.0f} % of one core)")
    print(", ".join(f"{mode.frequency:.2f} Hz" for mode in estimate.modes if mode.kind == "oscillatory"))


if __name__ == "__main__":
    main()
