"""Mutated files of every sort: each must be read right or refused by one of our errors, whatever its bytes.

    python tests/benchmarks/fuzz.py [--sorts npy mat5] [--seed 0] [--count 10000] [--keep FOLDER]

Counted are foreign exceptions, processes that die, readings above 5 CPU seconds, readings that take more than 1 GiB,
words of a library on stderr, refusals that are no sentence, and wrong numbers: a mutated file that is read must give
what the format's own library gives when it is called by hand. Files are read in child processes, so that one that dies
costs one file. File `i` of seed `s` is the same on every run; --keep writes the files at fault into a folder.
"""

import argparse
import contextlib
import json
import os
import random
import resource
import select
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from fuzz_own import LONGEST  # noqa: E402 - this checkout, whatever is installed
from fuzz_sorts import SORTS  # noqa: E402 - this checkout, whatever is installed

SLOW, STUCK = 5.0, 60.0
FAT = 1 << 20
"""KiB that one reading may add to the process's peak."""

ADDRESS_SPACE = 6 << 30
EXTREMES = (0, 1, 2, 7, 8, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 40, (1 << 64) - 1)
WORDS = (
    *(
        b"nan",
        b"-1",
        b"1e999",
        b"1e-320",
        b"inf",
        b"9" * 40,
        b"[",
        b"]",
        b"{",
        b"}",
        b"(" * 50,
        b"[" * 3000,
        b'"',
        b"''",
    ),
    *(b",", b";", b"\n", b"\r", b"\t", b"\0", b"\x1b[2J", b"\xff\xfe", b"\xe2\x80\xae", b"\x9b31m", b"true", b"None"),
    *(b"    -1\n", b"0x10", b"1_0", b"\\x", b"<f4", b">f8", b"|O", b"M8[s]", b"'descr'", b"2026-01-01T00:00:00"),
)


def changed(data, rng):
    """The bytes with one to four faults, half of them near the ends, where formats keep their tables."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        size = len(data)
        if size == 0:
            return b"\0"
        near = rng.choice((size, size, min(size, 600), -min(size, 600)))
        place = rng.randrange(near) if near > 0 else size + rng.randrange(near, 0)
        length = min(rng.choice((1, 2, 4, 8, 16, 100, 1000)), size)
        kind = rng.randrange(11)
        if kind == 0:
            data[place] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[place] = rng.randrange(256)
        elif kind == 2:
            data[place] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, 0x30, 0x39, 0x2D))
        elif kind == 3:
            del data[place : place + length]
        elif kind == 4:
            data[place:place] = data[place : place + length]
        elif kind == 5:
            data[place:place] = rng.randbytes(length)
        elif kind == 6:
            del data[place:]
        elif kind in (7, 8):
            width = rng.choice((1, 2, 4, 8))
            value = rng.choice((*EXTREMES, size, size + 1)) & ((1 << 8 * width) - 1)
            start = place - place % width if kind == 7 else place
            data[start : start + width] = value.to_bytes(width, rng.choice(("little", "little", "big")))
        elif kind == 9:
            word = rng.choice(WORDS)
            data[place : place + rng.choice((0, len(word)))] = word
        else:
            other = rng.randrange(size)
            data[place : place + length], data[other : other + length] = (
                bytes(data[other : other + length]),
                bytes(data[place : place + length]),
            )
    return bytes(data)


def mutated(sort, sound, seed, index):
    """File number `index` of a seed: its bytes and the sound file it was made of."""
    rng = random.Random(f"{seed} {index}")  # noqa: S311 - no secret
    source = rng.choice(sound)
    data = source.read_bytes()
    if sort.inner is not None and rng.random() < 0.4:
        with contextlib.suppress(Exception):
            return sort.inner(data, lambda inner: changed(inner, rng)), source
    return changed(data, rng), source


def child(name, folder, seed, start, stop):
    """Read the files from `start` on, one line of JSON before and one after each."""
    from okid.errors import IdentificationError

    sort = SORTS[name]
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    said = os.fdopen(os.dup(1), "w", buffering=1)
    noise = Path(folder) / f"noise_{os.getpid()}"
    errors = os.dup(2)
    quiet = os.open(noise, os.O_RDWR | os.O_CREAT | os.O_APPEND)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    sound = sorted((Path(folder) / "sound" / name).iterdir())
    os.dup2(errors, 2)
    for source in sound:  # the libraries are imported before the clock starts, and sound files are read
        why = sort.wrong(source, sort.read(source), source)
        if why:
            raise SystemExit(f"{source}: {why}")
    os.dup2(quiet, 2)
    heard = noise.stat().st_size
    for index in range(start, stop):
        data, source = mutated(sort, sound, seed, index)
        path = Path(folder) / f"file_{os.getpid()}{sort.suffix or source.suffix}"
        path.write_bytes(data)
        print(json.dumps({"at": index}), file=said)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        begin = time.process_time()
        outcome, detail, what = "read", "", None
        try:
            what = sort.read(path)
        except IdentificationError as error:
            outcome, text = "refused", str(error)
            if "\n" in text or len(text) > LONGEST or not text.isprintable():
                outcome, detail = "no sentence", text
        except Exception as error:  # noqa: BLE001 - that is what is looked for
            outcome, detail = "foreign", f"{type(error).__name__}: {error}"
        seconds = time.process_time() - begin
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak
        sys.stdout.flush()
        sys.stderr.flush()
        if noise.stat().st_size > heard:
            outcome, detail = "noise", noise.read_bytes()[heard:][:300].decode("latin-1")
        elif seconds > SLOW:
            outcome, detail = "slow", f"{seconds:.1f} s"
        elif grown > FAT:
            outcome, detail = "fat", f"{grown >> 10} MiB"
        elif outcome == "read":
            print(json.dumps({"checking": index}), file=said)
            try:
                detail = sort.wrong(path, what, source)
            except Exception as error:  # noqa: BLE001 - it cannot be read by hand, and we have read it
                detail = f"by hand: {type(error).__name__}: {error}"
            outcome = "wrong" if detail else "read"
        print(json.dumps({"done": index, "outcome": outcome, "detail": detail[:300]}), file=said)
        heard = noise.stat().st_size
        path.unlink()


def fuzz(name, folder, *, seed, count, start=0):
    """Outcomes of so many files: a count of each, and (index, outcome, detail) of those at fault."""
    counts, faults = Counter(), []
    stop = start + count
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    while start < stop:
        command = [sys.executable, str(Path(__file__)), "--child", name, str(folder), str(seed), str(start), str(stop)]
        at, begun, word = None, False, {}
        errors = Path(folder) / "child_errors"
        with (
            errors.open("wb") as said,
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, env=environment) as process,
        ):
            for line in _lines(process):
                word, begun = json.loads(line), True
                at = word.get("at", at)
                if "done" in word:
                    counts[word["outcome"]] += 1
                    start, at = word["done"] + 1, None
                    if word["outcome"] not in ("read", "refused"):
                        faults.append((word["done"], word["outcome"], word["detail"]))
        status = process.returncode
        if status and not (begun and at is not None):
            raise RuntimeError(f"the child of {name} ended with {status}: {errors.read_text()[-2000:]}")
        if at is not None:
            outcome = "stuck" if status == -9 else "dead"
            counts[outcome] += 1
            by = "the library called by hand" if "checking" in word else "our reader"
            faults.append((at, outcome, f"status {status} in {by}"))
            start = at + 1
    return counts, faults


def _lines(process):
    """Lines of a process, which is killed when it says nothing for a minute."""
    rest = b""
    while True:
        ready, _, _ = select.select([process.stdout], [], [], STUCK)
        if not ready:
            process.kill()
            return
        piece = os.read(process.stdout.fileno(), 1 << 16)
        if not piece:
            return
        *lines, rest = (rest + piece).split(b"\n")
        yield from lines


def make_sound(name, folder):
    """The sound files of a sort, made once."""
    place = Path(folder) / "sound" / name
    place.mkdir(parents=True)
    return sorted(SORTS[name].make(place))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sorts", nargs="+", choices=SORTS, default=list(SORTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    total = 0
    for name in options.sorts:
        with tempfile.TemporaryDirectory() as folder:
            sound = make_sound(name, folder)
            counts, faults = fuzz(name, folder, seed=options.seed, count=options.count, start=options.start)
            if options.keep is not None:
                options.keep.mkdir(parents=True, exist_ok=True)
                for index, outcome, _ in faults[:50]:
                    data, source = mutated(SORTS[name], sound, options.seed, index)
                    suffix = SORTS[name].suffix or source.suffix
                    (options.keep / f"{name}_{options.seed}_{index}_{outcome.replace(' ', '_')}{suffix}").write_bytes(
                        data
                    )
        total += len(faults)
        print(f"{name:12}", ", ".join(f"{counts[key]} {key}" for key in sorted(counts)), flush=True)
        kinds = Counter((outcome, detail[:110]) for _, outcome, detail in faults)
        first = {(outcome, detail[:110]): index for index, outcome, detail in reversed(faults)}
        for (outcome, detail), number in kinds.most_common(12):
            print(f"    {number:5} {outcome}: {detail!r} (first: file {first[outcome, detail]})", flush=True)
    return 1 if total else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(*sys.argv[2:4], int(sys.argv[4]), int(sys.argv[5]), int(sys.argv[6]))
    else:
        sys.exit(main())
