"""Do the 95 % intervals of frequency and damping hold, whatever the noise? One line a kind.

    python tests/benchmarks/noise_coverage.py --kinds white,wind --systems 10 --records 2 --results noise.jsonl

Systems and noise come from `tests/reference/noise_families.py`, which imports nothing of the product. Each record is
identified by `modal.identify` with nothing chosen. A true mode counts as found where a pole that is not called noise
lies within 5 % of its frequency, one to one, nearest first. z is error over stated deviation; standard errors are by
systems, since the estimates of one structure are not independent. `--results` keeps one line of JSON a record and does
not make it again.
"""

import argparse
import json
import os
import sys
import time
import warnings
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "reference"), str(ROOT / "tests" / "benchmarks")]

import numpy as np  # noqa: E402  threads and path are set above
from noise_families import KINDS, noise_record  # noqa: E402  threads and path are set above

NEAR = 0.05


def record_line(kind, system, record):
    """What one identification says about each true mode."""
    from modal.identification.pipeline import identify
    from okid.record import Record

    case = noise_record(kind, system=system, record=record)
    began = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(Record(case.inputs, case.outputs, case.system.dt))
    modes = [mode for mode in found.modes if mode.verdict != "noise" and mode.kind == "oscillatory"]
    truth = np.column_stack([case.system.frequencies, case.system.damping_ratios])
    factor = found.uncertainty.interval_factor(0.95)
    rows = []
    for i, j in matched(truth[:, 0], np.array([mode.frequency for mode in modes])):
        mode = modes[j]
        row = {
            "error": [mode.frequency - truth[i, 0], mode.damping_ratio - truth[i, 1]],
            "std": [mode.frequency_std, mode.damping_ratio_std],
            "verdict": mode.verdict,
        }
        if case.bound is not None:
            row["bound"] = [case.bound.frequency_std[i], case.bound.damping_ratio_std[i]]
        rows.append(row)
    false = [mode.frequency for mode in found.modes.system if np.abs(mode.frequency / truth[:, 0] - 1).min() > NEAR]
    return {
        "kind": kind,
        "system": system,
        "record": record,
        "modes": len(truth),
        "found": rows,
        "false": false,
        "factor": factor,
        "cpu": time.process_time() - began,
        "warnings": list(found.warnings),
        "order": found.fitted_model.order,
        "truth": case.system.order,
        "method": method_of(found),
    }


def method_of(found):
    """How the noise was described, in the words of the result."""
    return next((choice.value for choice in found.choices if choice.what == "noise"), "")


def matched(truth, found):
    """Pairs (true, found), nearest first, one to one, within `NEAR`."""
    pairs = sorted((abs(f / t - 1), i, j) for i, t in enumerate(truth) for j, f in enumerate(found))
    done, used = {}, set()
    for distance, i, j in pairs:
        if distance <= NEAR and i not in done and j not in used:
            done[i] = j
            used.add(j)
    return sorted(done.items())


def table(lines):
    """One row a kind: intervals that hold, z, error over bound where it is known, what was missed."""
    head = ("noise", "records", "estimates", "hold f %", "hold damping %", "rms z f", "rms z damping", "error / bound")
    rows = [(*head, "missed", "no interval", "false", "CPU s", "noise model")]
    for kind in KINDS:
        own = [line for line in lines if line["kind"] == kind]
        if not own:
            continue
        cells = [kind, str(len(own)), str(sum(len(line["found"]) for line in own))]
        both = (0, 1)
        cells += [by_systems(own, lambda row, line, k=k: abs(z_of(row, k)) <= line["factor"], 100.0) for k in both]
        cells += [by_systems(own, lambda row, _, k=k: z_of(row, k) ** 2, 1.0, root=True) for k in both]
        ratio = [by_systems(own, lambda row, _, k=k: (row["error"][k] / row["bound"][k]) ** 2, 1.0, root=True)
                 for k in (0, 1)] if "bound" in own[0]["found"][0] else ["-"]  # fmt: skip
        cells.append(", ".join(ratio))
        total = sum(line["modes"] for line in own)
        cells.append(f"{total - sum(len(line['found']) for line in own)} of {total}")
        cells.append(str(sum(not np.isfinite(row["std"]).all() for line in own for row in line["found"])))
        cells.append(str(sum(len(line["false"]) for line in own)))
        cells.append(f"{np.mean([line['cpu'] for line in own]):.2f}")
        used = [line["method"] for line in own]
        cells.append(", ".join(f"{name or 'output error'} {used.count(name)}" for name in sorted(set(used))))
        rows.append(tuple(cells))
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def z_of(row, k):
    return row["error"][k] / row["std"][k]


def by_systems(lines, value, factor, *, root=False):
    """Mean over all estimates and its standard error by systems; its root where asked for."""
    sums = {}
    for line in lines:
        values = [value(row, line) for row in line["found"] if np.isfinite(row["std"]).all()]
        total, count = sums.get(line["system"], (0.0, 0))
        sums[line["system"]] = (total + float(np.sum(values)), count + len(values))
    totals, counts = np.array(list(sums.values())).T
    if not counts.sum():
        return "-"
    mean = totals.sum() / counts.sum()
    spread = np.sqrt(((totals - mean * counts) ** 2).sum()) / counts.sum()
    if root:
        mean, spread = np.sqrt(mean), spread / (2 * np.sqrt(mean))
    return f"{factor * mean:.{1 if factor > 1 else 2}f} ± {factor * spread:.{1 if factor > 1 else 2}f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--systems", type=int, default=10)
    parser.add_argument("--records", type=int, default=1, help="of each system")
    parser.add_argument("--first", type=int, default=1, help="seed of the first system; below 1000 for building")
    parser.add_argument("--results", type=Path)
    given = parser.parse_args()
    lines = []
    if given.results and given.results.exists():
        lines = [json.loads(text) for text in given.results.read_text(encoding="utf-8").splitlines()]
    have = {(line["kind"], line["system"], line["record"]) for line in lines}
    for kind in given.kinds.split(","):
        for system in range(given.first, given.first + given.systems):
            for record in range(given.records):
                if (kind, system, record) in have:
                    continue
                line = record_line(kind, system, record)
                lines.append(line)
                if given.results:
                    with given.results.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(line) + "\n")
    print(table(lines))


if __name__ == "__main__":
    main()
