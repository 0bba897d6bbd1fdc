"""How soon a loss of stiffness is found, and how often nothing is: years of a bridge as tables of modes.

python tests/benchmarks/tracking_board.py --years 84 [--loss 0.005] [--error 1e-3] [--first-seed 1]
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "reference"))
from bridge_year import DAY, as_table, bridge_year

import modal

MONTH = 30.44 * DAY


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--years", type=int, default=10)
    options.add_argument("--months", type=int, default=0, help="single quiet months of 730 records")
    options.add_argument("--loss", type=float, default=0.005)
    options.add_argument("--error", type=float, default=1e-3)
    options.add_argument("--first-seed", type=int, default=1)
    given = options.parse_args()
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
