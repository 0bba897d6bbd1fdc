"""Calibration of the verdict: how far "system", "noise" and the probability can be believed, on random structures.

    python tests/benchmarks/verdict_calibration.py --seeds 10000-10199 --jobs 2 --results verdict.jsonl --write-docs

Each seed gives one structure and one record (`tests/reference/structures.py`, which imports nothing of the product). It
is identified twice by `modal.identify`: once with nothing chosen ("automatic") and once with 1.5 to 2 times the model
order that came out ("larger"), where noise poles must appear; that is what a user does who looks for a weak mode, and
without it too few noise poles would be seen to calibrate anything. Both count alike, and both are shown apart.
`--forced-order N` asks for N states instead. One line of JSON an identification; lines that are there are not made
again (`--restart` empties the file), so an interrupted run goes on where it stopped.

Every pole gets a label. "system": one to one with a true mode, nearest pole first, frequency within 0.5 % or half the
half-power bandwidth. "hum": within 1 % of a hum line. "grey": within 5 % of a true mode's frequency, but not the pole
that was matched with it; shown apart, not used in the calibration. "noise": the rest.
"""

import argparse
import hashlib
import json
import os
import re
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "reference"), str(ROOT / "tests" / "benchmarks")]

import numpy as np  # noqa: E402  threads and path are set above
from stamps import seeds_from, write_figures  # noqa: E402  threads and path are set above
from structures import random_record  # noqa: E402  threads and path are set above
from verdict_report import report  # noqa: E402

FREQUENCY_TOLERANCE = 0.005
GREY = 0.05
HUM_TOLERANCE = 0.01
LARGER = (1.5, 2.0)
INDICATORS = ("emac", "amplitude_coherence", "cmi", "phase_collinearity", "msv")
KEPT = (
    *("frequency", "damping_ratio", "kind", "frequency_std", "damping_ratio_std", "mpd", *INDICATORS),
    *("repeatability", "probability", "verdict", "damping_resolved", "reason"),
    "gain",  # where the mode carries it
)


def identify_seed(seed, orders, forced_order):
    """The lines of one seed, those of `orders` ("automatic", "larger") that are asked for."""
    warnings.simplefilter("ignore")
    case = random_record(seed)
    automatic = identified(case, "auto") if "automatic" in orders or forced_order is None else {}
    lines = [{"run": "automatic", "asked": "auto", **automatic}] if "automatic" in orders else []
    if "larger" in orders and (forced_order is not None or "order" in automatic):
        share = np.random.default_rng((seed, 7)).uniform(*LARGER)
        order = forced_order or 2 * round(share * max(2, automatic["order"]) / 2)
        lines.append({"run": "larger", "asked": order, **identified(case, order)})
    return [{"seed": seed, "code": code_version(), **describe(case), **line} for line in lines]


def identified(case, order):
    """What `modal.identify` makes of the record: its choices and its labelled poles, or the error."""
    import modal
    from okid.record import Record

    record, started = Record(case.inputs, case.outputs, case.structure.dt), time.process_time()
    try:
        found = modal.identify(record, order=order)
    except Exception as error:  # noqa: BLE001  an identification that fails is a figure of its own, not the end
        return {"error": f"{type(error).__name__}: {error}", "seconds": round(time.process_time() - started, 2)}
    return {
        "seconds": round(time.process_time() - started, 2),
        "order": found.realisation.order,
        "observer_order": found.observer.order,
        "ridge": found.observer.ridge,
        "decimation": round(found.realisation.dt / record.dt),
        "fit": round(found.fit.mean, 4),
        "caution": found.realisation.order / (found.observer.order * record.n_outputs),
        "poles": labelled(found.modes.modes, case, dt=found.realisation.dt),
    }


def describe(case):
    """What the record is, and its true modes."""
    modes = zip(case.structure.frequencies, case.structure.damping_ratios, case.mode_to_noise, strict=True)
    return {
        "excitation": case.excitation,
        "noise": case.noise,
        "noise_share": round(case.noise_share, 4),
        "shape": [*case.inputs.shape, case.outputs.shape[1]],
        "dt": case.structure.dt,
        "hum": case.hum.tolist(),
        "hum_to_noise": case.hum_to_noise.round(2).tolist(),
        "modes": [
            {"frequency": f, "damping_ratio": z, "mode_to_noise": round(ratio, 3), "traits": list(traits)}
            for (f, z, ratio), traits in zip(modes, case.structure.traits, strict=True)
        ],
    }


def labelled(found, case, *, dt):
    """One dictionary a pole: its label, the true mode it stands for (-1: none) and all that is said about it."""
    truth = case.structure
    wanted, frequency = truth.frequencies, np.array([mode.frequency for mode in found])
    partner = match(np.array([mode.pole for mode in found]), truth.poles, frequency)
    hum_tolerance = HUM_TOLERANCE * case.hum
    poles = []
    for i, mode in enumerate(found):
        apart = np.abs(mode.frequency - wanted)
        if partner[i] >= 0:
            label = "system"
        elif np.any(np.abs(mode.frequency - case.hum) <= hum_tolerance):
            label = "hum"
        elif np.any(apart <= np.maximum(GREY, truth.damping_ratios) * wanted):
            label = "grey"
        else:
            label = "noise"
        near = partner[i] if partner[i] >= 0 else int(np.argmin(apart / wanted))
        said = {key: _plain(getattr(mode, key, np.nan)) for key in KEPT}
        poles.append(
            {
                "label": label,
                "true_mode": int(partner[i]),
                "overlap_with_truth": round(overlap_with_truth(mode, case, near, dt=dt), 4),
                "parts": parts_in_words(mode.reason),
                **said,
            }
        )
    return poles


def match(found, true, frequency):
    """(n_found,) true mode of each pole, -1 where it has none: one to one, nearest pole first."""
    natural = np.abs(true)
    tolerance = np.maximum(FREQUENCY_TOLERANCE, -true.real / natural) * natural / (2 * np.pi)
    distance = np.abs(found[:, np.newaxis] - true) / natural
    distance[np.abs(frequency[:, np.newaxis] - natural / (2 * np.pi)) > tolerance] = np.inf
    partner = np.full(found.size, -1)
    while distance.size and np.isfinite(distance.min()):
        i, j = np.unravel_index(np.argmin(distance), distance.shape)
        partner[i] = j
        distance[i], distance[:, j] = np.inf, np.inf
    return partner


def overlap_with_truth(mode, case, index, *, dt):
    """Overlap in [0, 1] of the pulse response with that of a true mode: the same mode, or only its frequency?

        |<R1, R2>| / |s1 + conj s2| over the larger of |R|^2 / (2 |Re s|)

    with residues R = c b' s / (exp(s dt) - 1) in continuous time, so that a decimated record can be compared.
    """
    truth, residues, poles = case.structure, [], []
    true = (truth.poles[index], truth.shapes[:, index], truth.participation[:, index], truth.dt)
    for pole, c, b, step in ((mode.pole, mode.shape, mode.participation, dt), true):
        R = np.outer(c / case.outputs.std(axis=0), b * case.inputs.std(axis=0))
        residues.append(R * pole / np.expm1(pole * step) if abs(pole) > 0 else R)
        poles.append(complex(pole))
    energy = [(np.abs(R) ** 2).sum() / max(2 * abs(s.real), 1e-12) for R, s in zip(residues, poles, strict=True)]
    both = abs((residues[0] * residues[1].conj()).sum()) / max(abs(poles[0] + poles[1].conjugate()), 1e-12)
    return min(1.0, float(both / max(energy)))


def parts_in_words(reason):
    """Overlaps of the kinds of change, as far as the reason tells them."""
    names = {
        "halves": "halves of the data",
        "observer": "other observer order and ridge",
        "orders": "other model orders",
    }
    found = {key: re.search(rf"{words} (\d\.\d\d)", reason) for key, words in names.items()}
    return {key: float(hit[1]) for key, hit in found.items() if hit}


def _plain(value):
    """For JSON: no numpy, six digits, None for nan."""
    if isinstance(value, (bool, np.bool_, str)):
        return value if isinstance(value, str) else bool(value)
    return None if np.isnan(value) else float(f"{value:.6g}")


def code_version():
    """Short digest of the sources that were run: figures of two versions must not be mixed in silence."""
    digest = hashlib.sha256()
    for package in ("okid", "era", "modal"):
        for path in sorted((ROOT / package).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds_from, default=seeds_from("10000-10199"))
    parser.add_argument("--orders", default="automatic,larger", help="automatic, larger, or both (as given by default)")
    parser.add_argument("--forced-order", type=int, help='number of states of the "larger" run')
    parser.add_argument("--jobs", type=int, default=1, help="worker processes, one BLAS thread each")
    parser.add_argument("--results", type=Path, default=Path("verdict_calibration.jsonl"))
    parser.add_argument("--restart", action="store_true", help="empty the file of results first")
    parser.add_argument("--report-only", action="store_true", help="no identification: figures of the lines there are")
    parser.add_argument("--write-docs", action="store_true", help="put the tables into modal/docs/verdict.md")
    options = parser.parse_args()
    if options.restart:
        options.results.unlink(missing_ok=True)
    orders, wanted = tuple(options.orders.split(",")), set(options.seeds)
    lines = [json.loads(line) for line in options.results.read_text().splitlines()] if options.results.exists() else []
    if not options.report_only:
        done = {(line["seed"], line["run"]) for line in lines}
        missing = {seed: tuple(run for run in orders if (seed, run) not in done) for seed in options.seeds}
        missing = {seed: runs for seed, runs in missing.items() if runs}
        with ProcessPoolExecutor(options.jobs) as pool, options.results.open("a") as file:
            jobs = [pool.submit(identify_seed, seed, runs, options.forced_order) for seed, runs in missing.items()]
            for i, job in enumerate(as_completed(jobs)):
                for line in job.result():
                    lines.append(line)
                    file.write(json.dumps(line) + "\n")
                file.flush()
                print(f"{i + 1} of {len(jobs)} records", end="\r", file=sys.stderr, flush=True)
    chosen = [line for line in lines if line["seed"] in wanted and line["run"] in orders]
    if not chosen:
        sys.exit("no identification to report on")
    tables = report(chosen)
    print(tables)
    if options.write_docs:
        seeds = f"{min(wanted)}-{max(wanted)}"
        command = f"python tests/benchmarks/verdict_calibration.py --seeds {seeds} --results FILE --write-docs"
        write_figures(ROOT / "modal" / "docs" / "verdict.md", command, tables)


if __name__ == "__main__":
    main()
