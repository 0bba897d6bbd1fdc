"""How often the data check is wrong about clean records, and how large a fault must be to be found.

    python tests/benchmarks/quality_benchmark.py [clean] [faults] [--repeats 12]

Clean records are of 26 kinds (tests/reference/made_records.py): white, coloured, narrow band, sweeps, multisines,
hammers, steps, bursts, two-level, quantised, tiny and huge units, decays, with feedthrough. A sine is clean but poor
excitation, and is said to be; it is left out of the rate.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "reference"))

from made_records import KINDS, Fault, clean_record, with_fault

from modal.quality.check import check_quality
from okid.record import Record

SIZES: dict[Fault, tuple[str, tuple[float, ...], str]] = {
    "stuck": ("stuck", (0.001, 0.002, 0.005, 0.02, 0.1), "share of the samples"),
    "clipped": ("clipped", (0.0005, 0.001, 0.002, 0.005, 0.02, 0.2), "share of the samples"),
    "coarse": ("coarse", (20, 8, 5, 3, 1), "levels a standard deviation"),
    "spikes": ("spikes", (0.0002, 0.001, 0.01), "share of the samples, 5 standard deviations high"),
    "hum": ("mains hum", (0.005, 0.01, 0.02, 0.05, 0.2), "rms over that of the channel"),
    "noise": ("low coherence", (0.2, 0.5, 1, 3), "rms over that of the channel"),
    "ahead": ("runs ahead", (2, 3, 4, 8, 12), "samples, of outputs that answer one sample late"),
    "drift": ("drift", (0.05, 0.1, 0.3, 1), "rms over that of the channel"),
    "level": ("level changes", (2, 4, 5, 8), "factor"),
    "copy": ("copied channel", (1,), "-"),
    "white": ("white noise", (1,), "-"),
    "constant": ("constant", (1,), "-"),
}


def clean(repeats: int) -> None:
    """Records with nothing wrong: how many are said to have something, and what."""
    n_records, wrong, notes, what = 0, 0, 0, Counter[str]()
    for kind in KINDS:
        if kind == "sine":
            continue
        for seed in range(repeats):
            inputs, outputs, dt = clean_record(np.random.default_rng([seed, KINDS.index(kind)]), kind, n_samples=4000)
            quality = check_quality(Record(inputs, outputs, dt))
            serious = [finding for finding in quality.findings if finding.level != "note"]
            n_records += 1
            wrong += bool(serious)
            notes += len(quality.findings) - len(serious)
            what.update(f"{kind}: {finding.what}" for finding in serious)
    print(f"clean: {wrong} of {n_records} records with a false alarm; {notes / n_records:.2f} notes a record; {what}")


def faults(repeats: int) -> None:
    """One fault in one channel: share of the records in which it is named there."""
    for fault, (what, sizes, unit) in SIZES.items():
        shares = []
        for size in sizes:
            named = 0
            for seed in range(repeats):
                rng = np.random.default_rng([99, seed])
                inputs, outputs, dt = clean_record(rng, "coloured" if seed % 2 else "white", n_samples=12_000)
                if outputs.shape[1] == 1:
                    outputs = np.hstack([outputs, np.roll(outputs, 1) + 0.1 * rng.standard_normal(outputs.shape)])
                dt = min(dt, 0.005)
                record = Record(inputs, with_fault(rng, outputs, dt, fault, size), dt)
                named += any(f.what == what and "output_0" in f.channels for f in check_quality(record).findings)
            shares.append(f"{size:g}: {100 * named / repeats:.0f} %")
        print(f"{fault} ({unit}): {', '.join(shares)}")


def main() -> None:
    """Run the parts that were asked for, all unless any is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=["clean", "faults", []], default=[])
    parser.add_argument("--repeats", type=int, default=12)
    options = parser.parse_args()
    parts = options.parts or ["clean", "faults"]
    if "clean" in parts:
        clean(options.repeats)
    if "faults" in parts:
        faults(options.repeats)


if __name__ == "__main__":
    main()
