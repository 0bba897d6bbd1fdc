"""Modes from frequency responses against the truth: bias of damping, coverage of the intervals, verdicts.

    python tests/benchmarks/response_benchmark.py --systems 30 --seed 100 --cases hann-512 hann-1024 uniform-1024

Cases are WINDOW-SAMPLES, with "-shaker" for a shaker that the structure loads, and "-bare" for tables without coherence
and number of averages. Meaning of the figures: MEASURES.md; damping bias is that of the mean ratio to the truth, p90
the 90th percentile of the size of the relative error. Last, the same two of a textbook LSCF of order 60, whose poles
nearest to the true frequencies are taken.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "reference"))
from response_tables import table_of
from textbook_modal import textbook_lscf

import modal
import okid

CASES = ("hann-512", "hann-1024", "hann-4096", "uniform-1024", "hann-1024-shaker", "hann-1024-bare")


def main():
    """Print one line a case."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--systems", type=int, default=4)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--cases", nargs="*", default=CASES)
    parser.add_argument("--show", action="store_true", help="a line a system")
    arguments = parser.parse_args()
    print(
        "case                  found  called false  bias   s.e.    p90    f in  d in   f z    d z    AUC   CPU s   LSCF"
        "    p90"
    )
    for case in arguments.cases:
        print(line_of(case, range(arguments.seed, arguments.seed + arguments.systems), arguments.show), flush=True)


def line_of(case, seeds, show=False):
    """The figures of one case; the standard error of the bias is by systems."""
    window, samples, *rest = case.split("-")
    f_errors, d_errors, ratios, scores, truths, twin, of_system = [], [], [], [], [], [], []
    n_modes = n_called = n_false = 0
    began = time.process_time()
    for seed in seeds:
        test = table_of(seed, window=window, n_samples=int(samples), kind="shaker" if "shaker" in rest else "white")
        known = {} if "bare" in rest else {"coherence": test.coherence, "n_averages": test.n_averages}
        table = okid.FrequencyResponse(test.response, test.frequencies, window=window, **known)
        result = modal.identify(table)
        poles = textbook_lscf(test.response, test.frequencies, 60)
        left = [mode for mode in result.modes if mode.kind == "oscillatory"]
        first = len(ratios)
        for f, d in zip(test.true_frequencies, test.true_damping, strict=True):
            n_modes += 1
            nearest = poles[np.abs(np.abs(poles) - 2 * np.pi * f).argmin()]
            twin.append(-nearest.real / abs(nearest) / d - 1)
            tolerance = max(0.005 * f, 0.5 * d * f)
            near = [mode for mode in left if abs(mode.frequency - f) <= tolerance and mode.verdict != "noise"]
            if not near:
                continue
            mode = min(near, key=lambda each: abs(each.frequency - f))
            left.remove(mode)
            n_called += mode.verdict == "system"
            scores.append(mode.probability)
            truths.append(True)
            f_errors.append((mode.frequency - f) / mode.frequency_std)
            d_errors.append((mode.damping_ratio - d) / mode.damping_ratio_std)
            ratios.append(mode.damping_ratio / d - 1)
        for mode in left:
            away = np.abs(mode.frequency / test.true_frequencies - 1).min() > 0.05
            n_false += bool(away and mode.verdict == "system")
            if away:
                scores.append(mode.probability)
                truths.append(False)
        of_system.append(ratios[first:])
        if show:
            errors = " ".join(
                f"{100 * r:+.1f}({z:+.1f})" for r, z in zip(ratios[first:], d_errors[first:], strict=True)
            )
            verdicts = [(round(mode.frequency, 2), mode.verdict) for mode in result.modes if mode.verdict != "system"]
            print(f"  {seed}: damping errors, % (deviations): {errors}; not system {verdicts}", flush=True)
    if not ratios:
        return f"{case:20s}  nothing found"
    inside = [100 * np.mean(np.abs(errors) < 1.96) for errors in (f_errors, d_errors)]
    bias = np.mean(ratios)
    sums = [sum(own) - len(own) * bias for own in of_system]
    error = np.sqrt(np.sum(np.square(sums))) / len(ratios)
    sizes = [np.sqrt(np.mean(np.square(errors))) for errors in (f_errors, d_errors)]
    return (
        f"{case:20s} {100 * len(ratios) / n_modes:5.1f}% {100 * n_called / n_modes:5.1f}% {n_false:4d}  "
        f"{100 * bias:+5.2f}% {100 * error:5.2f}% {100 * np.quantile(np.abs(ratios), 0.9):5.1f}%  {inside[0]:4.0f}% "
        f"{inside[1]:4.0f}% {sizes[0]:5.2f}  {sizes[1]:5.2f}  {auc(np.array(scores), np.array(truths)):.3f} "
        f"{(time.process_time() - began) / len(seeds):6.1f}  "
        f"{100 * np.mean(twin):+8.2f}% {100 * np.quantile(np.abs(twin), 0.9):5.0f}%"
    )


def auc(scores, truths):
    """Share of pairs of a true and a false pole in which the true one has the higher probability."""
    true, false = scores[truths], scores[~truths]
    if not false.size:
        return float("nan")
    return float(np.mean(true[:, None] > false) + 0.5 * np.mean(true[:, None] == false))


if __name__ == "__main__":
    main()
