"""What `modal-report batch` costs beyond its identifications, with one worker and two, one of them killed on the way.

    python tests/benchmarks/batch_benchmark.py [N_FILES]

`records.parquet` states how long each file took in its worker; what the workers' time holds beyond that is overhead:
start of the processes, passing of tasks, tables and pages.
"""

import argparse
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import scipy

DT, N_SAMPLES = 0.01, 600
START = "from modal.command.entry import main; main()"


def write_files(folder: Path, n_files: int) -> None:
    for number in range(n_files):
        rng = np.random.default_rng(number)
        force = rng.standard_normal(N_SAMPLES)
        pole = np.exp((-0.02 + 1j) * 2 * np.pi * 5.0 * DT)
        tip = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], force)
        tip += 0.02 * tip.std() * rng.standard_normal(N_SAMPLES)
        table = np.column_stack([DT * np.arange(N_SAMPLES), force, tip])
        np.savetxt(folder / f"run_{number:03d}.csv", table, delimiter=",", header="time,force,tip", comments="")


def children(pid: int) -> list[int]:
    """The workers: children of any thread, but for the tracker that the standard library starts beside them."""
    found = [int(word) for path in Path(f"/proc/{pid}/task").glob("*/children") for word in path.read_text().split()]
    return [one for one in found if b"resource_tracker" not in Path(f"/proc/{one}/cmdline").read_bytes()]


def run(folder: Path, out: Path, workers: int, *, kill_after: int | None) -> None:
    command = [sys.executable, "-c", START, "batch", str(folder), "--inputs", "force", "-o", str(out)]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    process = subprocess.Popen(
        [*command, "--workers", str(workers)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    killed = False
    while process.poll() is None:
        done = len(list((out / "records").glob("*"))) if (out / "records").is_dir() else 0
        if kill_after is not None and not killed and done >= kill_after:
            os.kill(children(process.pid)[0], signal.SIGKILL)
            killed = True
        time.sleep(0.05)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    table = pq.read_table(out / "records.parquet").to_pydict()
    done = table["status"].count("done")
    own = sum(table["seconds"])
    print(
        f"{workers} workers{', one killed' if killed else ''}: exit {process.returncode}, {done} of "
        f"{len(table['status'])} done, wall {wall:.1f} s, CPU {cpu:.1f} s, sum of identifications {own:.1f} s (wall), "
        f"wall x workers / sum = {wall * workers / own:.3f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("n_files", nargs="?", type=int, default=100, help="files in the folder")
    n_files = parser.parse_args().n_files
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "runs"
        folder.mkdir()
        write_files(folder, n_files)
        run(folder, Path(name) / "one", 1, kill_after=None)
        run(folder, Path(name) / "two", 2, kill_after=n_files // 2)
        for table in ("modes.parquet", "modes.csv"):
            same = (Path(name) / "one" / table).read_bytes() == (Path(name) / "two" / table).read_bytes()
            print(f"{table}: {'identical' if same else 'DIFFERENT'}")


if __name__ == "__main__":
    main()
