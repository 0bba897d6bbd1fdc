"""What `modal-report batch` keeps and costs when its processes are killed: many small files, one worker and two.

    python tests/benchmarks/batch_benchmark.py [N_FILES] [--kills 3] [--samples 150] [--first-seed 0]

Among the files are an empty one, one that was cut within a number, and one at which its process dies of a segmentation
fault. The first run has one worker and nothing happens to it. In the second one of two workers is killed (SIGKILL)
several times, then the parent, and the same command is given once more. What both leave must be the same.

Overhead is the CPU time of all processes beyond that within the identifications (reading included): start of the
processes, passing of tasks, writing of results, tables, page and recording.
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

DT = 0.01
COMMAND = """
import os, sys, time
import modal.batch.task as task
plain = task._identified
def timed(unit, settings):
    start = time.process_time()
    try:
        return plain(unit, settings)
    finally:
        with open({log!r}, "a") as log:
            log.write(f"{{time.process_time() - start}}\\n")
task._identified = timed
if __name__ == "__main__":
    from modal.command.entry import main
    main()
else:
    def crash(event, arguments):
        if event == "open" and str(arguments[0]).endswith("crash.csv"):
            os.kill(os.getpid(), 11)
    sys.addaudithook(crash)
"""
"""Run by the parent and, by another name, at the start of each worker."""


def write_files(folder: Path, n_files: int, n_samples: int, first_seed: int) -> None:
    for number in range(n_files):
        rng = np.random.default_rng(first_seed + number)
        force = rng.standard_normal(n_samples)
        pole = np.exp((-0.02 + 1j) * 2 * np.pi * 5.0 * DT)
        tip = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], force)
        tip += 0.02 * tip.std() * rng.standard_normal(n_samples)
        table = np.column_stack([DT * np.arange(n_samples), force, tip])
        np.savetxt(folder / f"run_{number:04d}.csv", table, delimiter=",", header="time,force,tip", comments="")
    (folder / "empty.csv").write_text("")
    whole = (folder / "run_0000.csv").read_text()
    (folder / "cut.csv").write_text(whole[: len(whole) // 2].rsplit(",", 1)[0] + ",1.23")
    (folder / "crash.csv").write_text(whole + "\n")


def children(pid: int) -> list[int]:
    """The workers: children of any thread, but for the tracker that the standard library starts beside them."""
    found = [int(word) for path in Path(f"/proc/{pid}/task").glob("*/children") for word in path.read_text().split()]
    return [one for one in found if b"resource_tracker" not in Path(f"/proc/{one}/cmdline").read_bytes()]


def n_done(out: Path) -> int:
    return len(list((out / "records").glob("[!.]*"))) if (out / "records").is_dir() else 0


def watched(command: list[str], out: Path, kills: list[int], end: int | None) -> tuple[int, int, list[int]]:
    """Run a command: exit status, workers killed, and the workers that it had; kills at so many records done."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    left, own = list(kills), []
    while process.poll() is None:
        done = n_done(out)
        own = children(process.pid) or own
        if left and done >= left[0] and own:
            os.kill(own[len(left) % len(own)], signal.SIGKILL)
            left.pop(0)
        if end is not None and done >= end:
            process.kill()
            break
        time.sleep(0.05)
    errors = process.communicate()[1]
    if errors and end is None:
        print(f"stderr: {errors}")
    return process.returncode, len(kills) - len(left), own


def run(folder: Path, out: Path, workers: int, kills: list[int], end: int | None) -> None:
    script, log = out.with_suffix(".py"), out.with_suffix(".log")
    script.write_text(COMMAND.format(log=str(log)))
    order = ["--observer-order", "10", "--order", "2"]
    command = [sys.executable, str(script), "batch", str(folder), "--inputs", "force", "-o", str(out), *order]
    command += ["--workers", str(workers)]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    killed = 0
    if end is not None:
        _, killed, left = watched(command, out, kills, end)
        while any(Path(f"/proc/{one}").exists() for one in left):  # they leave by themselves
            time.sleep(0.05)
        print(f"{killed} workers killed, the parent killed at {n_done(out)} records", flush=True)
    status, _, _ = watched(command, out, [] if end is not None else kills, None)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    table = pq.read_table(out / "records.parquet").to_pydict()
    own, each = sum(table["seconds"]), np.loadtxt(log)
    print(
        f"{workers} workers: exit {status}, {table['status'].count('done')} of {len(table['status'])} done, "
        f"{n_done(out)} folders, wall {wall:.1f} s, sum of identifications (wall) {own:.1f} s, wall x workers / sum "
        f"{wall * workers / own:.3f}\n  CPU of parent and workers that it saw end {cpu:.1f} s, within "
        f"{each.size} identifications {each.sum():.1f} s, overhead {100 * (cpu / each.sum() - 1):.1f} %",
        flush=True,
    )
    for name, said, how in zip(table["record"], table["message"], table["status"], strict=True):
        if said or how == "failed":
            print(f"  {name} ({how}): {said}")


def compare(first: Path, second: Path) -> None:
    results = {}
    for out in (first, second):
        kept = [one for one in out.rglob("*") if one.name in ("result.npz", "modes.csv", "modes.parquet")]
        results[out] = {one.relative_to(out): one.read_bytes() for one in kept}
        parts = [one for one in out.rglob("*") if one.name.startswith(".")]
        print(f"{out.name}: {len(kept)} files to compare, left over: {[one.name for one in parts] or 'nothing'}")
    same = results[first] == results[second]
    print(f"result.npz, modes.csv, modes.parquet of all: {'identical' if same else 'DIFFERENT'}")
    tables = [pq.read_table(out / "records.parquet").drop_columns(["seconds"]) for out in (first, second)]
    print(f"records.parquet but for seconds: {'identical' if tables[0].equals(tables[1]) else 'DIFFERENT'}")
    names = tables[1]["record"].to_pylist()
    print(f"records: {len(names)}, each once: {len(set(names)) == len(names)}")
    paths = [str(out / "recording.rrd") for out in (first, second)]
    compared = subprocess.run([sys.executable, "-m", "rerun", "rrd", "compare", "--unordered", *paths], check=False)
    print(f"recordings: {'equal' if compared.returncode == 0 else 'DIFFERENT'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("n_files", nargs="?", type=int, default=100, help="sound files in the folder")
    parser.add_argument("--kills", type=int, default=3, help="of a worker, in the second run")
    parser.add_argument("--samples", type=int, default=150, help="of each file")
    parser.add_argument("--first-seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, one, two = (Path(name) / part for part in ("runs", "one", "two"))
        folder.mkdir()
        write_files(folder, given.n_files, given.samples, given.first_seed)
        run(folder, one, 1, [], None)
        steps = [given.n_files * (k + 1) // (given.kills + 3) for k in range(given.kills + 1)]
        run(folder, two, 2, steps[:-1], steps[-1])
        compare(one, two)


if __name__ == "__main__":
    main()
