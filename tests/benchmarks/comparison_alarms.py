"""How often `diff` sees a change where there is none, and how often it sees one that is there.

Random systems (tests/reference/random_problems.py), each measured several times with fresh noise: every pair of these
results compares a system with itself. `--kind` takes records of another kind (tests/reference/field_records.py), one
structure several times. A real change that needs no model: the same samples with a time step smaller by the share d are
a system whose frequencies are all higher by d / (1 - d) and whose damping ratios are the same.

    python tests/benchmarks/comparison_alarms.py --systems 12 --realisations 5
    python tests/benchmarks/comparison_alarms.py --kind ambient --systems 30 --realisations 3 --first 700
"""

import argparse
import itertools
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))

from field_records import KINDS, random_records
from random_problems import random_problem

from modal.comparison.changes import compare_results
from modal.comparison.shifts import summary_of
from modal.identification.pipeline import identify
from okid.record import Record

SHARES = (0.0003, 0.001, 0.003, 0.01)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", type=int, default=12)
    parser.add_argument("--realisations", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", choices=("random", *KINDS), default="random")
    options = parser.parse_args()
    counts, seen = Counter(), {share: [] for share in SHARES}
    for seed in range(options.first, options.first + options.systems):
        results = [summary_of(identify(one)) for one in records_of(options.kind, seed, options.realisations)]
        for before, after in itertools.combinations(results, 2):
            count(compare_results(before, after), counts)
        for share in SHARES:
            for before, after in itertools.pairwise(results):
                found = compare_results(before, faster(after, share))
                seen[share].append((detected(found), found.moved_together))
        print(seed, dict(counts), flush=True)
    report(counts, seen)


def records_of(kind, seed, n_records):
    """Records of one system, each with its own noise; inputs that never moved in a record left out."""
    if kind != "random":
        several = random_records(kind, seed, n_records=n_records)
        return [Record(u[:, u.any(axis=0)], y, several.dt) for u, y in several.records]
    problem = random_problem(seed)
    training = slice(0, problem.n_training)
    return [
        Record(problem.inputs[training], problem.noisy(number)[training], problem.system.dt)
        for number in range(n_records)
    ]


def faster(result, share):
    """The same samples with a shorter time step; poles and frequencies scale, nothing else moves."""
    scale = 1.0 / (1.0 - share)
    modes = tuple(
        replace(
            mode, pole=scale * mode.pole, frequency=scale * mode.frequency, frequency_std=scale * mode.frequency_std
        )
        for mode in result.modes
    )
    return replace(result, modes=modes, dt=result.dt / scale)


def count(comparison, counts):
    shifts = [shift for pair in comparison.pairs for shift in pair.shifts]
    counts["comparisons"] += 1
    counts["matched"] += len(comparison.pairs)
    counts["lost or new system modes"] += sum(
        one.mode.verdict == "system" for one in (*comparison.lost, *comparison.new)
    )
    alarm = comparison.moved_together or any(shift.verdict == "beyond chance" for shift in shifts)
    counts["with a false alarm"] += alarm
    counts["pairs not tested"] += sum(
        all(one.verdict == "not known" for one in pair.shifts) for pair in comparison.pairs
    )
    counts["together tests"] += np.isfinite(comparison.together)
    counts["together below 5 %"] += comparison.together < 0.05
    counts["together beyond chance"] += comparison.moved_together
    for what in ("frequency", "damping ratio", "shape"):
        tested = [shift for shift in shifts if shift.what == what and np.isfinite(shift.p_value)]
        counts[f"{what} tests"] += len(tested)
        counts[f"{what} below 5 %"] += sum(shift.p_value < 0.05 for shift in tested)
        counts[f"{what} beyond chance"] += sum(shift.verdict == "beyond chance" for shift in tested)


def detected(comparison):
    """(shift in joint standard deviations, seen) of every frequency."""
    return [
        (1.96 * abs(pair.frequency.change) / pair.frequency.half_width, pair.frequency.verdict == "beyond chance")
        for pair in comparison.pairs
        if np.isfinite(pair.frequency.half_width)
    ]


def report(counts, seen):
    n = counts["comparisons"]
    untested = counts["pairs not tested"]
    print(f"{n} comparisons of a system with itself, {counts['matched']} matched modes, {untested} of them not tested")
    print(f"a false alarm in {counts['with a false alarm']} of them ({100 * counts['with a false alarm'] / n:.1f} %)")
    for what in ("frequency", "damping ratio", "shape", "together"):
        tests = max(counts[f"{what} tests"], 1)
        below, beyond = counts[f"{what} below 5 %"], counts[f"{what} beyond chance"]
        print(f"{what}: {tests} tests, {100 * below / tests:.1f} % outside their interval, {beyond} beyond chance")
    print(f"lost or new modes of the system: {counts['lost or new system modes']}")
    for share, comparisons in seen.items():
        flat = [found for one, _ in comparisons for _, found in one]
        some = np.mean([any(found for _, found in one) for one, _ in comparisons])
        together = np.mean([moved for _, moved in comparisons])
        print(
            f"all frequencies up by {100 * share:g} %: seen in {100 * np.mean(flat):.0f} % of the modes, "
            f"in at least one mode of {100 * some:.0f} % of the comparisons, in all together in {100 * together:.0f} %"
        )


if __name__ == "__main__":
    main()
