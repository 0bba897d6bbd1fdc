"""How soon a loss of stiffness is found, and how often nothing is: years of a bridge as tables of modes.

    python tests/benchmarks/tracking_board.py --years 84 [--loss 0.005] [--error 1e-3] [--first-seed 1]

A month of the same bridge as records, to see whether identified records err as the tables assume:

    python tests/benchmarks/tracking_board.py --write-month DIR [--first-seed 1]
    modal-report batch DIR/records --outputs s0,s1,s2,s3,s4,s5 -o DIR/result
    modal-report track DIR/result --causes DIR/weather.csv
    python tests/benchmarks/tracking_board.py --judge-month DIR
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import scipy

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "reference"))
from bridge_year import DAY, HOUR, ambient_record, as_table, bridge_year, true_modes, weather

import modal

MONTH = 30.44 * DAY
N_RECORDS, N_SAMPLES, DT = 730, 6000, 0.05
NEAR = 0.03
"""Take a pole for a true mode within this share of its frequency, where the shape is also its own."""


def write_month(folder, seed):
    """A quiet month: one ambient record of five minutes an hour."""
    rng = np.random.default_rng(seed)
    temperature = weather(rng, N_RECORDS)
    frequency, shape = true_modes(temperature)
    (folder / "records").mkdir(parents=True)
    for k in range(N_RECORDS):
        values = ambient_record(rng, frequency[k], shape[k], n_samples=N_SAMPLES, dt=DT)
        table = np.column_stack([HOUR * k + DT * np.arange(N_SAMPLES), values])
        names = ",".join(["time", *(f"s{j}" for j in range(values.shape[1]))])
        path = folder / "records" / f"hour_{k:05d}.csv"
        np.savetxt(path, table, delimiter=",", header=names, comments="", fmt=["%.2f", *["%.6g"] * values.shape[1]])
    measured = temperature + 0.2 * rng.standard_normal(N_RECORDS)
    np.savetxt(folder / "weather.csv", measured, header="temperature", comments="")
    np.savez(folder / "truth.npz", temperature=temperature, frequency=frequency, shape=shape)


def judge_month(folder):
    """What the tables assume beside what the identified records show."""
    truth = np.load(folder / "truth.npz")
    table = pq.read_table(folder / "result" / "modes.parquet").to_pydict()
    seconds = np.array(pq.read_table(folder / "result" / "records.parquet").column("seconds"))
    n_records = seconds.size  # the first ones, where not all were identified
    frequency, shape = truth["frequency"][:n_records], truth["shape"][:n_records]
    n_modes = frequency.shape[1]
    z, error, std, loss = (np.full((n_records, n_modes), np.nan) for _ in range(4))
    verdicts, false = np.full((n_records, n_modes), "absent", dtype=object), []
    for row in range(len(table["record"])):
        k = int(table["record"][row][5:])
        seen = np.array([one["real"] + 1j * one["imag"] for one in table["shape"][row]])
        alike = np.abs(shape[k] @ seen) ** 2 / np.vdot(seen, seen).real
        near = np.abs(table["frequency"][row] / frequency[k] - 1.0) < NEAR
        mode = int(np.where(near, alike, -1.0).argmax())
        if not near.any() or not np.isnan(z[k, mode]):
            false.append((table["verdict"][row], table["frequency"][row]))
            continue
        verdicts[k, mode], loss[k, mode] = table["verdict"][row], 1.0 - alike[mode]
        error[k, mode] = table["frequency"][row] / frequency[k, mode] - 1.0
        std[k, mode] = table["frequency_std"][row] / table["frequency"][row]
        z[k, mode] = error[k, mode] / std[k, mode]
    found = (verdicts == "system") | (verdicts == "doubtful")
    print(f"{n_records} records, {seconds.sum() / n_records:.2f} s a record")
    print(
        "mode: system, doubtful, noise, absent [%]; rms relative error, mean stated; mean z, rms z, |z| > 1.96 [%], "
        "|z| > 4; largest; kurtosis; shape's 1 - MAC median, largest"
    )
    for mode in range(n_modes):
        share = [100 * np.mean(verdicts[:, mode] == name) for name in ("system", "doubtful", "noise", "absent")]
        own = found[:, mode]
        a = z[own, mode]
        print(
            f"  {mode}: {' '.join(f'{one:.1f}' for one in share)}; {np.sqrt(np.mean(error[own, mode] ** 2)):.2e} "
            f"{np.mean(std[own, mode]):.2e} (spread {np.std(np.log(std[own, mode])):.2f}); {a.mean():+.2f} "
            f"{np.sqrt(np.mean(a**2)):.2f} {100 * np.mean(np.abs(a) > 1.96):.1f} {np.sum(np.abs(a) > 4)}; "
            f"{np.abs(a).max():.1f}; {scipy.stats.kurtosis(a):+.2f}; {np.median(loss[own, mode]):.4f} "
            f"{loss[own, mode].max():.3f}"
        )
    kept = np.where(found, z, 0.0) / np.sqrt(np.mean(z[found] ** 2))
    pairs = found.T.astype(float) @ found
    between = kept.T @ kept / np.maximum(pairs, 1.0)
    off = between[np.triu_indices(n_modes, 1)]
    print(
        f"correlation of errors between modes: largest {off[np.abs(off).argmax()]:+.3f}, rms {np.std(off):.3f}, by "
        f"chance {1 / np.sqrt(pairs.min()):.3f}"
    )
    after = found[1:] & found[:-1]
    print(
        f"from a record to the next: {(kept[1:] * kept[:-1]).sum() / after.sum():+.3f} by chance "
        f"{1 / np.sqrt(after.sum()):.3f}"
    )
    misses = (~found).sum(axis=1)
    print(
        f"misses a record: mean {misses.mean():.3f}, variance {misses.var():.3f} (independent: "
        f"{np.sum(found.mean(axis=0) * (1 - found.mean(axis=0))):.3f})"
    )
    warm = np.abs(frequency[:, : n_modes // 2] / frequency[:, n_modes // 2 :] - 1.0).min(axis=0)
    print(f"nearest the pairs of modes come [%]: {np.round(100 * warm, 2)}")
    names = [name for name, _ in false]
    shares = [f"{name} {names.count(name) / n_records:.3f}" for name in sorted(set(names))]
    print(f"poles of no mode a record: {', '.join(shares) or 'none'}")
    path = folder / "result" / "tracks.parquet"
    if path.exists():
        owner = np.array(pq.read_table(path).column("track"))
        print(f"tracks: {owner.max() + 1}, poles in none: {np.mean(owner < 0):.3f}")


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--years", type=int, default=10)
    options.add_argument("--months", type=int, default=0, help="single quiet months of 730 records")
    options.add_argument("--loss", type=float, default=0.005)
    options.add_argument("--error", type=float, default=1e-3)
    options.add_argument("--first-seed", type=int, default=1)
    options.add_argument("--write-month", type=Path, metavar="DIR")
    options.add_argument("--judge-month", type=Path, metavar="DIR")
    given = options.parse_args()
    if given.write_month or given.judge_month:
        if given.write_month:
            write_month(given.write_month, given.first_seed)
        if given.judge_month:
            judge_month(given.judge_month)
        return
    found, delays, false_alarms, quiet_months, swapped, assigned = 0, [], 0, 0.0, 0, 0
    for seed in range(given.first_seed, given.first_seed + given.years):
        rng = np.random.default_rng(seed)
        year = bridge_year(rng, loss=given.loss, change_at=rng.uniform(0.1, 0.9), error=given.error)
        result = modal.track(as_table(year), causes=year.causes)
        times = [alarm.time for alarm in result.alarms]
        right = [time for time in times if year.change <= time <= year.change + MONTH]
        found += bool(right)
        delays += [(right[0] - year.change) / DAY] if right else []
        false_alarms += len(times) - bool(right)
        quiet_months += 11.0
        owner = result.modes.column("track").to_numpy()
        assigned += int((owner >= 0).sum())
        swapped += sum(
            int((year.truth[owner == k] != np.bincount(year.truth[owner == k] + 1).argmax() - 1).sum())
            for k in range(len(result.tracks))
        )
        print(f"seed {seed}: {len(times)} alarms, found {bool(right)}, {len(result.tracks)} tracks", flush=True)
    for seed in range(given.first_seed, given.first_seed + given.months):
        month = bridge_year(np.random.default_rng(10**6 + seed), n_records=730, error=given.error)
        false_alarms += len(modal.track(as_table(month), causes=month.causes).alarms)
        quiet_months += 1.0
    print(
        f"found within a month: {found} of {given.years}; days until then, median {np.median(delays or [np.nan]):.1f}"
    )
    print(
        f"false alarms: {false_alarms} in {quiet_months:.0f} quiet months; poles of another mode {swapped}/{assigned}"
    )


if __name__ == "__main__":
    main()
