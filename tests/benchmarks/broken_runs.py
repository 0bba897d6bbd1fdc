"""Whole runs of `modal-report` that are broken off or meet: nothing half-written, nothing lost, nothing left over.

    python tests/benchmarks/broken_runs.py [--pairs 50] [--kills 100] [--stops 200] [--places 10] [--seed 0]

pairs: two runs into one folder at a time: one succeeds, the other says that the folder is taken, and the folder is
whole. kills: kill -9 at a random time, with and without --overwrite: the folder is absent, the old one or the new one,
and the next run (after every tenth kill) leaves nothing else. stops: Ctrl-C at a random time from the first line of the
entry point on: no traceback; exit status 130 and nothing written, or a run that ended as usual. places: full disks of
so many sizes (a tmpfs where mounting is allowed, and a limit on the size of a file), a file system and a folder that
are read only, a folder of somebody else's (these as the user nobody), and a folder that is removed during the run:
one sentence, exit status 2, nothing written. A result is whole if all its files are there and name the record that it
was made of.
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
MOST = 1 << 20
"""Bytes of the largest file of a run, about: a disk may be smaller or larger."""

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


def begun(folder, record, *more, out="out", before=()):
    """A run that has just come to the first line of our entry point; `before` stands before the interpreter."""
    choices = ("--observer-order", "12", "--ridge", "0", "--order", "4")
    arguments = ("run", f"{record}.csv", "--inputs", "force", "-o", str(out), *choices, *more)
    process = subprocess.Popen(
        [*before, sys.executable, "-c", START, *arguments],
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


def refused(process, parent, there):
    """What a run in a poor place came to: refused in one sentence with nothing written, done, or what is wrong."""
    words, status = process.communicate()[1], process.returncode
    found = sorted(str(path) for path in parent.rglob("*")) if parent.exists() else []
    if status in (0, 1) and {Path(name).name for name in found} >= FILES and ".modal-report" not in str(found):
        return "done"
    if status != 2 or words.count("\n") != 1 or not words.endswith(".\n") or found != there:
        return f"status {status}, {found}: {words[-1500:]}"
    reason = words[words.find("(") : words.find(")") + 1] or words[:80]
    return f"refused {reason}"


def places(folder, rng, count, longest):
    """Each poor place, and what a run into it came to."""
    target = folder / "place"
    nobody = () if os.name == "nt" or os.geteuid() else ("setpriv", "--reuid", "nobody", "--clear-groups")
    for number in range(count):
        size = int(rng.uniform(0.0, 1.4) * MOST / 1024)
        yield f"files of at most {size} KiB", _limited(folder, target, size)
        if nobody:
            target.mkdir()
            subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={max(size, 4)}k", "tmpfs", target], check=True)
            try:
                yield f"a disk of {size} KiB", refused(begun(folder, "first", out=target / "out"), target, [])
            finally:
                subprocess.run(["umount", target], check=True)
                target.rmdir()
        yield f"removed during the run ({number % 2})", _removed(folder, target, rng, longest, number % 2)
    target.mkdir()
    for mode, what in ((0o555, "a folder that is read only"), (0o000, "a folder that is closed")):
        target.chmod(mode)
        yield what, refused(begun(folder, "first", out=target / "out", before=nobody), target, [])
        yield (
            f"{what}, further down",
            refused(begun(folder, "first", out=target / "a" / "b", before=nobody), target, []),
        )
    target.chmod(0o755)
    if nobody:
        yield "a folder of another user", refused(begun(folder, "first", out=target / "out", before=nobody), target, [])
        subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", target], check=True)
        try:
            yield "a file system that is read only", refused(begun(folder, "first", out=target / "out"), target, [])
        finally:
            subprocess.run(["umount", target], check=True)
    target.rmdir()


def _limited(folder, target, size):
    target.mkdir()
    try:
        before = ("prlimit", f"--fsize={1024 * size}")
        return refused(begun(folder, "first", out=target / "out", before=before), target, [])
    finally:
        shutil.rmtree(target)


def _removed(folder, target, rng, longest, within):
    """The folder above the target is removed: the target's own, which is given, or one further up."""
    parent = target / "above" if within else target
    parent.mkdir(parents=True)
    process = begun(folder, "first", out=parent / "out")
    time.sleep(rng.uniform(0.2, 0.9) * longest)
    ended, written = process.poll(), (parent / "out").exists()
    shutil.rmtree(target, ignore_errors=True)
    try:
        if ended is not None:
            return f"the run had ended, status {ended}"
        if written:
            process.communicate()
            return f"the result had been written, status {process.returncode}"
        return refused(process, target, [])
    finally:
        shutil.rmtree(target, ignore_errors=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=50)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--stops", type=int, default=200)
    parser.add_argument("--places", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = random.Random(options.seed)  # noqa: S311 - no secret
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in the background, and so would a run
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
        folder.chmod(0o755)  # the user nobody reads the record
        for what, outcome in places(folder, rng, options.places, longest) if options.places else ():
            print(f"places {what}: {outcome}", flush=True)


if __name__ == "__main__":
    main()
