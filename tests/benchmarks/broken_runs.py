"""Whole runs of `modal-report` that are broken off or meet: nothing half-written, nothing lost, nothing left over.

    python tests/benchmarks/broken_runs.py [--pairs 50] [--kills 100] [--stops 200] [--seed 0]

pairs: two runs into one folder at a time: one succeeds, the other says that the folder is taken, and the folder is
whole. kills: kill -9 at a random time, with and without --overwrite: the folder is absent, the old one or the new one,
and the next run (after every tenth kill) leaves nothing else. stops: Ctrl-C at a random time from the first line of the
entry point on: no traceback; exit status 130 and nothing written, or a run that ended as usual. A result is whole if
all its files are there and name the record that it was made of.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
START = (
    "import sys; sys.stdin.close(); "
    "from modal.command.entry import main; from modal.command.stopping import Requests; "
    "Requests.listen(); print('ready', flush=True); main()"
)
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
KNOWN = ("first.csv", "second.csv", "out", "kept")
FILES = {
    *("report.html", "report.md", "report.json", "report.schema.json"),
    *("modes.csv", "modes.uff", "result.npz", "recording.rrd"),
}


def make_records(folder):
    """Two short records of one system of two modes, with names of their own."""
    import numpy as np
    import scipy

    rng = np.random.default_rng(1)
    for name in ("first", "second"):
        force, tip = rng.standard_normal(600), np.zeros(600)
        for frequency, damping in ((4.0, 0.01), (11.0, 0.02)):
            pole = np.exp(2 * np.pi * frequency * complex(-damping, (1 - damping**2) ** 0.5) * 0.01)
            tip += scipy.signal.lfilter([0.0, 1.0], [1.0, -2 * pole.real, abs(pole) ** 2], force)
        tip += 0.02 * tip.std() * rng.standard_normal(600)
        rows = "".join(f"{0.01 * row:.2f},{force[row]:.6g},{tip[row]:.6g}\n" for row in range(600))
        (folder / f"{name}.csv").write_text(f"time,force,tip\n{rows}")


def begun(folder, record, *more):
    """A run that has just come to the first line of our entry point."""
    choices = ("--observer-order", "12", "--ridge", "0", "--order", "4")
    arguments = ("run", f"{record}.csv", "--inputs", "force", "-o", "out", *choices, *more)
    process = subprocess.Popen(
        [sys.executable, "-c", START, *arguments],
        cwd=folder,
        env=ENVIRONMENT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.readline()
    return process


def record_of(folder):
    """The record of the result in the folder, "absent", or what is wrong with it."""
    out = folder / "out"
    if not out.exists():
        return "absent"
    missing = FILES - {path.name for path in out.iterdir()}
    if missing:
        return f"lacks {sorted(missing)}"
    named = {name for name in ("first", "second") if f"{name}.csv" in (out / "report.json").read_text()}
    also = {name for name in ("first", "second") if f"{name}.csv" in (out / "report.html").read_text()}
    return named.pop() if len(named) == 1 and named == also else f"names {named} and {also}"


def left_over(folder):
    return sorted(path.name for path in folder.iterdir() if path.name not in KNOWN)


def pair(folder):
    shutil.rmtree(folder / "out", ignore_errors=True)
    processes = [begun(folder, "first"), begun(folder, "second")]
    ends = [(process.communicate()[1], process.returncode) for process in processes]
    won = [status in (0, 1) for _, status in ends]
    told = [words for (words, status), good in zip(ends, won, strict=True) if not good and status == 2]
    if sum(won) != 1 or len(told) != 1 or "already holds" not in told[0]:
        return f"not one winner: {ends}"
    whole = record_of(folder) == ("first", "second")[won.index(True)] and not left_over(folder)
    return "one wins, the other says so" if whole else f"{record_of(folder)}, {left_over(folder)}"


def kill(folder, rng, longest, *, old, last):
    """One kill; `old` is a folder to replace, None for none; with `last` a whole run follows and must sweep all."""
    shutil.rmtree(folder / "out", ignore_errors=True)
    if old is not None:
        shutil.copytree(old, folder / "out")
    before = record_of(folder)
    process = begun(folder, "second", *(["--overwrite"] if old is not None else []))
    time.sleep(rng.uniform(0.0, longest))
    process.kill()
    process.communicate()
    found = record_of(folder)
    if found not in (before, "second"):
        return f"after the kill: {found}"
    if last:
        words = begun(folder, "first", "--overwrite").communicate()[1]
        if record_of(folder) != "first" or left_over(folder):
            return f"after the next run: {record_of(folder)}, {left_over(folder)}: {words}"
    return f"{'absent' if found == 'absent' else 'old' if found == before else 'new'}{', swept' if last else ''}"


def stop(folder, rng, longest):
    shutil.rmtree(folder / "out", ignore_errors=True)
    process = begun(folder, "first")
    time.sleep(rng.uniform(0.0, longest))
    twice = rng.random() < 0.3
    process.send_signal(signal.SIGINT)
    if twice:
        time.sleep(rng.uniform(0.0, 0.3))
        process.send_signal(signal.SIGINT)
    printed, words = process.communicate()
    found, status = record_of(folder), process.returncode
    if "Traceback" in words or "Exception ignored" in words:
        return f"traceback: {words[-400:]}"
    if left_over(folder):
        return f"left over: {left_over(folder)}"
    if status in (130, -signal.SIGINT) and found == "absent":
        return "stopped" if "stopped" in words else f"stopped without a word: {words!r}"
    if found == "first" and ("recording.rrd" in printed or twice):
        return "finished and told" if status in (0, 1) else f"finished, told, status {status}"
    return f"status {status}, {found}: {words[-300:]!r}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=50)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--stops", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = random.Random(options.seed)  # noqa: S311 - no secret
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_records(folder)
        start = time.monotonic()
        begun(folder, "first").communicate()
        longest = 1.05 * (time.monotonic() - start)
        kept = Path(shutil.copytree(folder / "out", folder / "kept"))
        print(f"a run takes about {longest:.1f} s: {record_of(folder)}", flush=True)
        for what, times, once in (
            ("pairs", options.pairs, lambda _: pair(folder)),
            (
                "kills",
                options.kills,
                lambda number: kill(folder, rng, longest, old=[kept, None][number % 2], last=number % 10 == 9),
            ),
            ("stops", options.stops, lambda _: stop(folder, rng, longest)),
        ):
            for outcome, count in Counter(once(number) for number in range(times)).most_common():
                print(f"{what:6} {count:4} {outcome}", flush=True)


if __name__ == "__main__":
    main()
