"""The stabilisation diagram of 50 orders: ours against pyOMA-2 on the same Hankel matrix.

    python tests/benchmarks/stabilisation_benchmark.py [--peer-python PATH]
    python tests/benchmarks/stabilisation_benchmark.py --colours [--seed 81000]

8 outputs, 2 inputs, 300 lags with 2 % noise, 100 x 200 blocks, 50 orders; CPU time of one BLAS thread, a process of its
own for each side, least of five after a warm-up. Ours gives for every pole frequency, damping, EMAC (taken from the
data), overlap with the order below and repeatability over three reruns (their modes are given; the verdict needs them
anyway). pyOMA-2 (`pip install pyOMA-2` in an environment of its own; its Python is given by --peer-python) gives
frequency, damping, shape, phase collinearity and deviation as limits, and the "stable" flag by its three tolerances:
`SSI_fast`, `SSI_poles`, `HC_MPC`, `HC_MPD`, `SC_apply`, as its `SSI.run` calls them with its default criteria, fed with
the same Hankel matrix; it is written for output-only data, but what is timed does not know where the matrix came from.
Two ratios of that: the diagram alone (after the singular value decomposition), and both.

Then from the record to the diagram, 20 000 samples of the same channels: ours fits an observer of order 40, recovers
300 lags and goes on as above (without reruns); pyOMA-2 correlates the outputs over its default of 20 block rows, and
over 100, which is what the 200 columns above correspond to.

With --colours: which colour tells true poles from the observer's better, over 30 random systems (2 inputs, 3 outputs,
4 modes, a close pair and a weak one, 4000 samples, 10 % noise, observer order 40, ridge 1e-4, reruns at twice the true
order). Points of the orders from 6 to 50: true within 0.5 % of a true frequency, the nearest of its order; of the
observer farther than 5 % from all; the others are left out.

Exit status 1 when the diagram of the same matrix is less than 20 times as fast, or the modes differ.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

N_ORDERS = 50
N_LAGS = 300
ROWS, COLUMNS = 100, 200
N_OUTPUTS, N_INPUTS = 8, 2
DT = 0.01
NOISE = 0.02
NEEDED = 20.0
N_RERUNS = 3
N_SAMPLES = 20_000


def make_pulses(seed):
    """(N_LAGS + 1, 8, 2) pulse responses of six modes, and as many with other noise as there are reruns."""
    rng = np.random.default_rng(seed)
    frequency, damping = np.linspace(0.03, 0.42, 6), rng.uniform(0.005, 0.03, 6)
    pole = np.exp(2 * np.pi * frequency * (-damping + 1j * np.sqrt(1 - damping**2)))
    B = rng.standard_normal((6, N_INPUTS)) + 1j * rng.standard_normal((6, N_INPUTS))
    C = rng.standard_normal((N_OUTPUTS, 6))  # real shapes: pyOMA-2 rejects others by default
    h = np.array([np.zeros((N_OUTPUTS, N_INPUTS))] + [2 * ((C * pole**k) @ B).real for k in range(N_LAGS)])
    spread = NOISE * h[1:].std(axis=0)
    return [h + spread * rng.standard_normal(h.shape) for _ in range(1 + N_RERUNS)]


def make_record(seed):
    """White inputs and the outputs of `make_pulses`, by convolution; 5 % noise."""
    rng = np.random.default_rng(seed)
    h = make_pulses(seed)[0]
    inputs = rng.standard_normal((N_SAMPLES, N_INPUTS))
    outputs = sum(np.pad(inputs, ((k, 0), (0, 0)))[:N_SAMPLES] @ h[k].T for k in range(1, N_LAGS + 1))
    return inputs, outputs + 0.05 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)


def least(call, n_rounds=5):
    """Result, and least CPU time in ms of one call after a warm-up."""
    result = call()
    times = []
    for _ in range(n_rounds):
        start = time.process_time()
        result = call()
        times.append(time.process_time() - start)
    return result, 1e3 * min(times)


def ours(path):
    from era.balanced import decompose, realise_from
    from modal.modes.extraction import extract_modes
    from modal.verdict.judgement import Rerun, Reruns
    from modal.verdict.stabilisation import stabilisation
    from okid.markov import MarkovParameters, recover_markov
    from okid.observer import fit_observer
    from okid.record import Record

    with np.load(path) as stored:
        pulses = list(stored["pulses"])
        record = Record(stored["inputs"], stored["outputs"], DT)

    def decomposed(h):
        markov = MarkovParameters(system=h, dt=DT)
        return decompose(markov, n_block_rows=ROWS, n_block_columns=COLUMNS, max_order=N_ORDERS)

    def from_the_record():
        markov = recover_markov(fit_observer(record, order=40, ridge=0.0), n_lags=N_LAGS)
        return stabilisation(realise_from(decompose(markov, max_order=N_ORDERS), N_ORDERS))

    runs = [
        Rerun(label=str(i), change=change, modes=extract_modes(realise_from(decomposed(h), 14)))
        for i, (change, h) in enumerate(zip(("data", "data", "observer"), pulses[1:], strict=True))
    ]
    scales = {"output_scale": np.ones(N_OUTPUTS), "input_scale": np.ones(N_INPUTS)}
    reruns = Reruns(runs=tuple(runs), n_steps=ROWS + COLUMNS, **scales)
    found, decomposing = least(lambda: decomposed(pulses[0]))
    model = realise_from(found, N_ORDERS)
    _, bare = least(lambda: stabilisation(model))
    points, diagram = least(lambda: stabilisation(model, reruns=reruns))
    _, eigenvalues = least(lambda: [np.linalg.eig(model.A[:n, :n]) for n in range(1, N_ORDERS + 1)])
    _, whole = least(from_the_record, n_rounds=3)
    poles = [p.frequency for p in points if p.order == N_ORDERS and min(p.overlap, p.repeatability) > 0.9]
    return {
        "decomposition": decomposing,
        "diagram": diagram,
        "without reruns": bare,
        "LAPACK eig alone": eigenvalues,
        "from the record": whole,
        "points": len(points),
        "frequencies": poles,
    }


def peer(path):
    import logging

    from pyoma2.functions import gen, ssi

    logging.disable(logging.CRITICAL)
    quiet = lambda *arguments, **_: range(*arguments)  # noqa: E731  # its progress bars cost time and print
    ssi.trange = quiet
    with np.load(path) as stored:
        h, outputs = stored["pulses"][0], stored["outputs"]
    H = np.block([[h[1 + i + j] for j in range(COLUMNS)] for i in range(ROWS)])
    (Obs, A, C, _), decomposing = least(lambda: ssi.SSI_fast(H, ROWS, N_ORDERS), n_rounds=2)

    def diagram(Obs, A, C, H):
        # `SSI.run` from here on, with the criteria that it takes when none are given
        Fn, Xi, Phi, poles, *none = ssi.SSI_poles(Obs, A, C, N_ORDERS, DT, calc_unc=False, H=H, T=None, xi_max=0.2)
        for criterion, limit in ((gen.HC_MPC, 0.5), (gen.HC_MPD, 0.5)):
            mask = criterion(Phi, limit)
            Fn, Xi, Phi, poles, *none = gen.applymask([Fn, Xi, Phi, poles, *none], mask, Phi.shape[2])
        return Fn, gen.SC_apply(Fn, Xi, Phi, 0, N_ORDERS, 1, 0.05, 0.1, 0.05)

    def from_the_record(br):
        Y = outputs.T
        H, _ = ssi.build_hank(Y=Y, Yref=Y, br=br, method="cov", calc_unc=False, nb=50, U=None)
        Obs, A, C, _ = ssi.SSI_fast(H, br, N_ORDERS)
        return diagram(Obs, A, C, H)

    (Fn, label), drawn = least(lambda: diagram(Obs, A, C, H), n_rounds=3)
    whole = {br: least(lambda br=br: from_the_record(br), n_rounds=1)[1] for br in (20, 100)}
    stable = Fn[:, -1][label[:, -1] == 1]
    return {
        "decomposition": decomposing,
        "diagram": drawn,
        "from the record": whole,
        "points": int(np.isfinite(Fn).sum()),
        "frequencies": np.unique(np.round(stable, 9)).tolist(),
    }


def points_of_one_system(seed):
    """(n_points, 3) of the diagram of one random system: 1 true or 0 not, overlap, repeatability."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "reference"))
    from systems import random_system, simulate

    from era.balanced import decompose, realise_from
    from modal.verdict.repeatability import repeat
    from modal.verdict.stabilisation import stabilisation
    from okid.markov import recover_markov
    from okid.observer import fit_observer
    from okid.record import Record

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
    rows = np.concatenate([points_of_one_system(seed + i) for i in range(30)])
    true = rows[:, 0] == 1
    print(f"{true.sum()} true poles, {(~true).sum()} of the observer")
    for name, value in (("overlap with the order below", rows[:, 1]), ("repeatability", rows[:, 2])):
        ranks = np.empty(value.size)
        ranks[np.argsort(value, kind="stable")] = np.arange(value.size)
        area = (ranks[true].sum() - true.sum() * (true.sum() - 1) / 2) / (true.sum() * (~true).sum())
        high = [100 * np.mean(value[chosen] > 0.9) for chosen in (true, ~true)]
        low = [100 * np.mean(value[chosen] < 0.4) for chosen in (true, ~true)]
        print(
            f"{name}: AUC {area:.4f}; above 0.9 true {high[0]:.1f} %, not {high[1]:.1f} %; "
            f"below 0.4 true {low[0]:.1f} %, not {low[1]:.1f} %"
        )


def run(python, side, path):
    environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
    environment["PYTHONPATH"] = str(Path(__file__).resolve().parents[2]) if side == "ours" else ""
    command = [python, __file__, "--side", side, str(path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{side} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-python", help="Python of an environment with pyOMA-2")
    parser.add_argument("--colours", action="store_true", help="measure the two colours instead of the time")
    parser.add_argument("--seed", type=int, default=81000)
    parser.add_argument("--side", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.side:
        side, path = options.side
        sys.stdout.write("\n" + json.dumps({"ours": ours, "peer": peer}[side](path)))
        return 0
    if options.colours:
        colours(options.seed)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.npz"
        inputs, outputs = make_record(20262)
        np.savez(path, pulses=make_pulses(20261), inputs=inputs, outputs=outputs)
        own = run(sys.executable, "ours", path)
        print(f"{N_ORDERS} orders, {N_OUTPUTS} outputs x {N_INPUTS} inputs, {ROWS} x {COLUMNS} blocks, ms of CPU")
        print(f"ours: decomposition {own['decomposition']:.1f}, diagram {own['diagram']:.1f} for {own['points']} poles")
        print(f"      (without reruns {own['without reruns']:.1f}; LAPACK eig alone {own['LAPACK eig alone']:.1f})")
        if not options.peer_python:
            return 0
        other = run(options.peer_python, "peer", path)
    both = [side["decomposition"] + side["diagram"] for side in (own, other)]
    ratio = other["diagram"] / own["diagram"]
    print(
        f"pyOMA-2: decomposition {other['decomposition']:.0f}, diagram {other['diagram']:.0f}, {other['points']} poles"
    )
    print(f"ratio: diagram {ratio:.1f}, with the decomposition {both[1] / both[0]:.1f} (wanted {NEEDED:g})")
    for br, spent in other["from the record"].items():
        print(
            f"from a record of {N_SAMPLES} samples: ours {own['from the record']:.0f}, pyOMA-2 with {br} block rows "
            f"{spent:.0f}, ratio {spent / own['from the record']:.1f}"
        )
    off = [min(abs(f / g - 1) for g in other["frequencies"]) for f in own["frequencies"]]
    print(f"the {len(off)} modes of order {N_ORDERS} differ by at most {max(off):.1e} in frequency")
    return 0 if ratio >= NEEDED and max(off) < 0.01 else 1


if __name__ == "__main__":
    sys.exit(main())
