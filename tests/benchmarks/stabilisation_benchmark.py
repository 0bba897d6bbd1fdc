"""Which colour of the stabilisation diagram tells true poles from the observer's: repeatability or overlap?

    python tests/benchmarks/stabilisation_benchmark.py [--seed 81000]

30 random systems (2 inputs, 3 outputs, 4 modes, a close pair and a weak one, 4000 samples, 10 % noise, observer order
40, ridge 1e-4, reruns at twice the true order). Points of the orders from 6 to 50: true within 0.5 % of a true
frequency, the nearest of its order; of the observer farther than 5 % from all; the others are left out. What the
diagram costs is measured in `cost_board.py`.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parents[1] / "reference")]

from systems import random_system, simulate  # noqa: E402 - after the path is set
from verdict_report import separation  # noqa: E402

from era.balanced import decompose, realise_from  # noqa: E402
from modal.verdict.repeatability import repeat  # noqa: E402
from modal.verdict.stabilisation import stabilisation  # noqa: E402
from okid.markov import recover_markov  # noqa: E402
from okid.observer import fit_observer  # noqa: E402
from okid.record import Record  # noqa: E402

N_SYSTEMS = 30
N_ORDERS = 50
N_LAGS = 300


def points_of_one_system(seed):
    """(n_points, 3) of the diagram of one random system: 1 true or 0 not, overlap, repeatability."""
    rng = np.random.default_rng(seed)
    truth = random_system(rng, n_modes=4)
    inputs = rng.standard_normal((4000, 2))
    outputs = simulate(truth, inputs)
    record = Record(inputs, outputs + 0.1 * outputs.std(axis=0) * rng.standard_normal(outputs.shape), truth.dt)
    observer = fit_observer(record, order=40, ridge=1e-4)
    found = decompose(recover_markov(observer, n_lags=N_LAGS), max_order=N_ORDERS)
    order = 2 * truth.order
    reruns = repeat((record,), observer_order=40, ridge=1e-4, model_order=order, decomposition=found)
    points = stabilisation(realise_from(found, N_ORDERS), orders=range(6, N_ORDERS + 1), reruns=reruns)
    rows = []
    for n in range(6, N_ORDERS + 1):
        here = [p for p in points if p.order == n]
        off = np.array([abs(p.frequency / truth.frequencies - 1) for p in here])
        nearest = {int(np.argmin(column)) for column in off.T if column.min() < 0.005}
        rows += [(1, p.overlap, p.repeatability) for i, p in enumerate(here) if i in nearest]
        rows += [(0, p.overlap, p.repeatability) for i, p in enumerate(here) if off[i].min() > 0.05]
    return np.array(rows)


def colours(seed):
    rows = np.concatenate([points_of_one_system(seed + i) for i in range(N_SYSTEMS)])
    true = rows[:, 0] == 1
    print(f"{true.sum()} true poles, {(~true).sum()} of the observer")
    for name, value in (("overlap with the order below", rows[:, 1]), ("repeatability", rows[:, 2])):
        high = [100 * np.mean(value[chosen] > 0.9) for chosen in (true, ~true)]
        low = [100 * np.mean(value[chosen] < 0.4) for chosen in (true, ~true)]
        print(
            f"{name}: AUC {separation(true, value):.4f}; above 0.9 true {high[0]:.1f} %, not {high[1]:.1f} %; "
            f"below 0.4 true {low[0]:.1f} %, not {low[1]:.1f} %"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=81000)
    colours(parser.parse_args().seed)


if __name__ == "__main__":
    main()
