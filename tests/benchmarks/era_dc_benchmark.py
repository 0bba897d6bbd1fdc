"""ERA/DC against ERA on the same Markov parameters: what each finds, how far off, at what cost.

    python tests/benchmarks/era_dc_benchmark.py [--n-systems 20] [--n-draws 4] [--seed 71000]

Systems are drawn at random (2 inputs, 3 outputs, 4 modes, damping 0.5 to 3 %, the second mode 2 % above the first in
frequency, the last one ten times weaker than the others); every contender gets the same lags and makes models of twice
the true order. A mode is found when the nearest pole, one to one, is within 0.5 % in frequency or half the half-power
bandwidth, if that is wider. Damping error: median over the modes that all contenders found, so that who finds more is
not punished for it. CPU time of one BLAS thread, mean over the calls. Markdown on stdout.

Cases: white noise of 1, 10, 30 % of each channel's standard deviation on 200 measured lags (an impulse test); 200 lags
recovered by OKID from 3000 samples with 10 % noise; 2000 lags of lightly damped systems (0.05 to
0.3 %) with 10 % noise.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "reference")]

from systems import markov, random_system, simulate  # noqa: E402  # the path is set above

from era.balanced import (  # noqa: E402
    realise,
    realise_data_correlation,
)
from okid.markov import MarkovParameters, recover_markov  # noqa: E402
from okid.observer import fit_observer  # noqa: E402
from okid.record import Record  # noqa: E402

CONTENDERS = {
    "ERA": realise,
    "ERA/DC": realise_data_correlation,
    "ERA/DC, first lag 0": lambda m, *, order: realise_data_correlation(m, order=order, first_lag=0),
    "ERA/DC, 10 block rows": lambda m, *, order: realise_data_correlation(m, order=order, n_block_rows=10),
    "ERA/DC, 3/4 of the lags summed": lambda m, *, order: realise_data_correlation(
        m, order=order, n_block_columns=3 * m.n_lags // 4
    ),
}


def pulses_with_noise(system, n_lags, noise, rng):
    h = markov(system, n_lags)
    h[1:] += noise * h[1:].std(axis=0) * rng.standard_normal(h[1:].shape)
    return MarkovParameters(system=h, dt=system.dt)


def recovered_pulses(system, n_lags, noise, rng):
    inputs = rng.standard_normal((3000, system.n_inputs))
    outputs = simulate(system, inputs)
    outputs = outputs + noise * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    observer = fit_observer(Record(inputs, outputs, system.dt), order=40, ridge=0.0)
    return recover_markov(observer, n_lags=n_lags)


CASES = {
    "1 % on the pulses": (pulses_with_noise, 200, 0.01, (0.005, 0.03)),
    "10 % on the pulses": (pulses_with_noise, 200, 0.1, (0.005, 0.03)),
    "30 % on the pulses": (pulses_with_noise, 200, 0.3, (0.005, 0.03)),
    "OKID, 10 % on the outputs": (recovered_pulses, 200, 0.1, (0.005, 0.03)),
    "10 %, 2000 lags": (pulses_with_noise, 2000, 0.1, (0.0005, 0.003)),
}


def errors(model, truth):
    """(n_modes, 2) relative error of frequency and damping, nan where the mode was not found."""
    poles = np.log(np.linalg.eigvals(model.A).astype(complex)) / model.dt
    poles = poles[poles.imag > 0]
    result = np.full((truth.poles.size, 2), np.nan)
    distance = np.abs(np.subtract.outer(truth.poles, poles)) / np.abs(truth.poles)[:, None]
    while distance.size and np.isfinite(distance).any():
        i, j = np.unravel_index(np.nanargmin(np.where(np.isfinite(distance), distance, np.nan)), distance.shape)
        distance[i, :], distance[:, j] = np.inf, np.inf
        off = abs(abs(poles[j]) / truth.frequencies[i] / (2 * np.pi) - 1)
        if off <= max(0.005, truth.damping_ratios[i]):
            ratio = -poles[j].real / abs(poles[j])
            result[i] = off, abs(ratio / truth.damping_ratios[i] - 1)
    return result


def run_case(case, options):
    make, n_lags, noise, damping = CASES[case]
    found = {name: [] for name in CONTENDERS}
    cost = dict.fromkeys(CONTENDERS, 0.0)
    for seed in range(options.seed, options.seed + options.n_systems):
        rng = np.random.default_rng(seed)
        truth = random_system(rng, n_modes=4, close_pair=0.02, weak_mode=0.1, damping_range=damping)
        for _ in range(options.n_draws):
            parameters = make(truth, n_lags, noise, rng)
            for name, contender in CONTENDERS.items():
                start = time.process_time()
                model = contender(parameters, order=2 * truth.order)
                cost[name] += time.process_time() - start
                found[name].append(errors(model, truth))
    n_calls = options.n_systems * options.n_draws
    together = np.all([np.isfinite(np.array(e)[..., 0]) for e in found.values()], axis=0)
    for name, values in found.items():
        e = np.array(values)
        there = np.isfinite(e[..., 0])
        shares = [there[:, 2].mean(), there[:, :2].mean(), there[:, 3].mean()]  # single, close pair, weak
        medians = [np.median(e[..., k][together]) if together.any() else np.nan for k in (0, 1)]
        print(
            f"| {case} | {name} | {' | '.join(f'{100 * share:.0f}' for share in shares)} "
            f"| {100 * medians[0]:.3f} | {100 * medians[1]:.2f} | {1e3 * cost[name] / n_calls:.1f} |",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n-systems", type=int, default=20)
    parser.add_argument("--n-draws", type=int, default=4)
    parser.add_argument("--seed", type=int, default=71000)
    options = parser.parse_args()
    print("| case | contender | single mode % | close pair % | weak mode % | frequency off % | damping off % | ms |")
    print("|---|---|---|---|---|---|---|---|")
    for case in CASES:
        run_case(case, options)


if __name__ == "__main__":
    main()
