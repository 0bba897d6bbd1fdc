"""What one waits for: CPU time of a whole run by stage, and its peak memory, at six sizes.

    python tests/benchmarks/whole_run_benchmark.py [--sizes 5000x3,12000x4] [--rounds 3] [--reference DIR]
        [--write README.md]

A run is what `modal-report run` does: read a CSV file, identify with nothing told, look at the quality of the data,
write report and recording. Each is a process of its own with one BLAS thread, its clock the CPU time from the start of
the interpreter; of several rounds the one that cost least counts. `--reference` runs another checkout of the
repository, such as `git worktree add DIR COMMIT`, in alternation with this one and prints the ratios. A size is any
samples x channels; `--sizes 1500x2` is done in seconds. `--write` puts the table in the place of the last one.

Stages are timed by wrapping functions of the packages wherever they are called (`STAGES`); what belongs to none is
"rest". "start" is the interpreter and all imports up to the reading of the file.
"""

import argparse
import contextlib
import importlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
SIZES = ("5000x3", "12000x4", "8500x30", "100000x8", "100000x60", "1000000x8")
DT = 0.01
STAGES = {
    "read": ("okid.", "read_records"),
    "quality": ("modal.", "check_quality"),
    "identify": ("modal.", "identify"),
    "preparation": ("modal.preparation.steps", "prepare"),
    "search": ("modal.", "search"),
    "refinement": ("modal.", "refined_search", "fit_all_rows"),
    "verdict": ("modal.", "repeat", "judge", "driven_gain"),
    "report": ("modal.report", "write_report"),
    "pictures": ("modal.report", "draw_pictures"),
    "recording": ("modal.recording", "save_recording"),
}
"""Stage: the start of the name of the module that defines its functions, and their names."""
SHOWN = (
    "start",
    "read",
    "quality",
    "preparation",
    "search",
    "refinement",
    "verdict",
    "pictures",
    "report",
    "recording",
)
ROOMS = (
    "modal.report",
    "modal.recording",
    "modal.plots",
    "modal.identification.pipeline",
    "modal.quality",
    "modal.identification.result",
)
"""Imported before the functions are wrapped, where a checkout has them; a command imports them as it goes."""


def made_record(size):
    """(inputs, outputs) of a size such as "5000x3": one input up to 4 channels, two up to 30, then four."""
    import numpy as np
    from cost_board import simulated

    n_samples, n_channels = map(int, size.split("x"))
    n_inputs = 1 if n_channels <= 4 else 2 if n_channels <= 30 else 4
    n_modes = min(8, 2 + n_channels // 2)
    record = {"n_samples": n_samples, "n_inputs": n_inputs, "n_outputs": n_channels - n_inputs, "n_modes": n_modes}
    return simulated(record, np.random.default_rng(n_channels))


def write_record(size, path):
    """The record as a CSV file with names and time."""
    import numpy as np
    from pyarrow import csv
    from pyarrow import table as arrow_table

    inputs, outputs = made_record(size)
    columns = {"time": DT * np.arange(len(inputs))}
    columns |= {f"force_{i}": column for i, column in enumerate(inputs.T)}
    columns |= {f"place_{i}": column for i, column in enumerate(outputs.T)}
    csv.write_csv(arrow_table(columns), path)
    return [name for name in columns if name.startswith("force")]


# --- in the child ----------------------------------------------------------------------------------------------------


class Clock:
    """CPU seconds by stage; a stage inside another stops the other's clock."""

    def __init__(self):
        self.seconds, self.open, self.since = {"start": 0.0}, ["start"], 0.0

    def switch(self):
        now = time.process_time()
        stage = self.open[-1]
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self.since
        self.since = now

    def timed(self, stage, function):
        def run(*arguments, **options):
            self.switch()
            self.open.append(stage)
            try:
                return function(*arguments, **options)
            finally:
                self.switch()
                self.open.pop()

        return run


def wrapped(clock):
    """Put the timed functions in the place of the plain ones, in every module that has them; stages without one."""
    import modal
    import okid

    for package in (okid, modal):
        for name in package.__all__:  # loaded when they are asked for
            getattr(package, name)
    for room in ROOMS:
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module(room)
    missing = []
    for stage, (room, *names) in STAGES.items():
        there = False
        for module in [m for n, m in sys.modules.items() if n.split(".")[0] in {"okid", "era", "modal"} and m]:
            for name in names:
                function = vars(module).get(name)
                if callable(function) and str(getattr(function, "__module__", "")).startswith(room):
                    setattr(module, name, clock.timed(stage, function))
                    there = True
        if not there:
            missing.append(stage)
    return missing


def child(path, inputs, folder):
    """One run, its seconds by stage on the last line."""
    import modal
    import okid

    clock = Clock()
    missing = wrapped(clock)
    clock.switch()
    clock.open[-1] = "rest"
    records = okid.read_records([path], inputs=inputs)
    result = modal.identify(records)
    quality = modal.check_quality(records)
    modal.write_report(result, folder, quality=quality)
    clock.switch()
    seconds = clock.seconds
    seconds["rest"] = seconds.get("rest", 0.0) + seconds.pop("identify", 0.0)
    found = {"seconds": seconds, "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "missing": missing}
    sys.stdout.write("\n" + json.dumps({**found, "modes": [mode.frequency for mode in result.modes.system]}) + "\n")


# --- in the parent ---------------------------------------------------------------------------------------------------


def run_once(checkout, path, inputs):
    """What the child of that checkout says."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, __file__, "--child", str(path), *inputs, str(Path(folder) / "report")],
            env={**os.environ, **threads, "PYTHONPATH": str(checkout)},
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode:
        raise SystemExit(f"the run in {checkout} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def best(runs):
    return min(runs, key=lambda run: sum(run["seconds"].values()))


def measure(size, *, rounds, reference, work):
    """(own, reference or None): the cheapest run of each."""
    path = work / f"{size}.csv"
    inputs = write_record(size, path)
    checkouts = [REPOSITORY, *([] if reference is None else [reference.resolve()])]
    runs = [[] for _ in checkouts]
    for _ in range(rounds):
        for checkout, own in zip(checkouts, runs, strict=True):
            own.append(run_once(checkout, path, inputs))
    path.unlink()
    return tuple(map(best, runs))


def whole(run):
    return sum(run["seconds"].values())


def identification(run):
    return sum(run["seconds"].get(stage, 0.0) for stage in ("preparation", "search", "refinement", "verdict", "rest"))


def row(size, run):
    """Cells of one line: seconds, then shares of them."""
    shares = [run["seconds"].get(stage, 0.0) / whole(run) for stage in (*SHOWN, "rest")]
    n_samples, n_channels = map(int, size.split("x"))
    cells = [f"{n_samples:,} x {n_channels}".replace(",", " "), f"{whole(run):.1f}", f"{identification(run):.1f}"]
    return [*cells, *(f"{100 * share:.0f}" for share in shares), f"{run['peak']:.0f}"]


def table(lines):
    head = ["samples x channels", "run, CPU s", "identify", *(f"{stage} %" for stage in SHOWN), "rest %", "peak MiB"]
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows)


def ratios(size, own, other):
    stages = [
        f"{stage} {own['seconds'].get(stage, 0.0) / seconds:.2f}"
        for stage, seconds in other["seconds"].items()
        if seconds > 0.01 * whole(other)
    ]
    same = len(own["modes"]) == len(other["modes"]) and all(
        abs(a / b - 1) < 1e-4 for a, b in zip(own["modes"], other["modes"], strict=True)
    )
    return (
        f"{size}, times the reference: run {whole(own) / whole(other):.2f} ({whole(own):.2f} / {whole(other):.2f} s), "
        f"identify {identification(own) / identification(other):.2f} ({identification(own):.2f} / "
        f"{identification(other):.2f} s), peak memory {own['peak'] / other['peak']:.2f}; {', '.join(stages)}; "
        f"{'the same modes' if same else 'OTHER MODES'}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default=",".join(SIZES), help="samples x channels, with commas between")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--reference", type=Path, help="another checkout, run in alternation with this one")
    parser.add_argument("--write", type=Path, help="Markdown file that holds the table of this command")
    options = parser.parse_args()
    lines = []
    with tempfile.TemporaryDirectory() as work:
        for size in options.sizes.split(","):
            found = measure(size, rounds=options.rounds, reference=options.reference, work=Path(work))
            lines.append(row(size, found[0]))
            for stage in found[0]["missing"]:
                sys.stderr.write(f"nothing is called {STAGES[stage][1:]} any more: {stage} is part of another stage\n")
            print(ratios(size, *found) if options.reference else table(lines[-1:]), flush=True)
    print(table(lines))
    if options.write:
        from stamps import write_figures

        own = "" if options.sizes == ",".join(SIZES) else f" --sizes {options.sizes}"
        write_figures(options.write, f"python tests/benchmarks/whole_run_benchmark.py{own}", table(lines))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2], sys.argv[3:-1], sys.argv[-1])
    else:
        main()
