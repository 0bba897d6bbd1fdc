"""Size and time of the recording of a long record, each beside its budget.

    python tests/benchmarks/recording_benchmark.py [--samples 1000000] [--inputs 2] [--outputs 6] [--folder DIR]

The budget, stated in modal/recording/series.py: 8 channels of a million samples make a file of less than 100 MB,
written in less than 5 s; the look at the data quality is part of it. Exit status 1 where either is not met. Judged is
the processor time of all threads, which is what the clock shows where nothing else runs. What is recorded is made by
hand in tests/modal/recording/conftest.py, so nothing else is timed.
"""

import argparse
import importlib.util
import sys
import tempfile
import time
from pathlib import Path

MEGABYTES = 100.0
SECONDS = 5.0


def build_identification(**options):
    """The hand-made identification of the tests of the recording."""
    path = Path(__file__).parents[1] / "modal" / "recording" / "conftest.py"
    spec = importlib.util.spec_from_file_location("recording_conftest", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.build_identification(**options)


def main():
    """Write it three times: the first run pays for the imports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--inputs", type=int, default=2)
    parser.add_argument("--outputs", type=int, default=6)
    parser.add_argument("--folder", type=Path, default=None)
    given = parser.parse_args()
    from modal.recording import save_recording
    from modal.recording.plan import planned

    found = build_identification(n_samples=given.samples, n_inputs=given.inputs, n_outputs=given.outputs, n_modes=4)
    stored = planned(found).data.levels[0]
    coarsest = max(part.bucket for part in stored)
    exact = sum(part.stop - part.start for part in stored if part.bucket == 1)
    print(f"{given.inputs} inputs, {given.outputs} outputs, {given.samples} samples: ", end="")
    print(f"one of {coarsest} samples kept twice (extremes), every sample of {exact}")
    best = float("inf")
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        for run in (1, 2, 3):
            began, busy = time.perf_counter(), time.process_time()
            size = save_recording(found, Path(folder) / f"{run}.rrd").stat().st_size / 1e6
            seconds, processor = time.perf_counter() - began, time.process_time() - busy
            best = min(best, processor)
            print(f"run {run}: {size:.1f} MB in {seconds:.2f} s ({processor:.2f} s of processor time)")
    met = size < MEGABYTES and best < SECONDS
    print(f"budget {MEGABYTES:g} MB and {SECONDS:g} s: {'met' if met else 'NOT met'}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
