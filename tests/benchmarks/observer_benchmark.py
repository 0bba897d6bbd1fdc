"""Observer fit at order 50 plus Markov parameters, against modred's OKID: CPU time, one BLAS thread, own process each.

    python tests/benchmarks/observer_benchmark.py --peer-python PATH

PATH is an interpreter in which `modred` is installed (pip install "setuptools<81" cython numpy, then
pip install --no-build-isolation modred); without it only our side is timed. Both start from data in memory (a
`Record`, two arrays). We recover 200 lags of system and gain; modred ties the number of lags to the order and returns
the first 50 of the system.
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

ORDER = 50
N_LAGS = 200
CASES = {"2x2 / 5e3": (2, 2, 5_000, 18), "8x2 / 2e4": (8, 2, 20_000, 60), "16x2 / 1e5": (16, 2, 100_000, 150)}
"""outputs, inputs, samples, required ratio"""


def make_case(n_outputs, n_inputs, n_samples, path):
    """Six modes, every channel driven, from rest (modred knows no initial state), 1 % white noise on the outputs."""
    rng = np.random.default_rng(20240611)
    frequency, damping = np.linspace(0.03, 0.42, 6), rng.uniform(0.01, 0.03, 6)
    pole = np.exp(2 * np.pi * frequency * (-damping + 1j * np.sqrt(1 - damping**2)))
    B = rng.standard_normal((6, n_inputs)) + 1j * rng.standard_normal((6, n_inputs))
    C = rng.standard_normal((n_outputs, 6)) + 1j * rng.standard_normal((n_outputs, 6))
    D = rng.standard_normal((n_outputs, n_inputs))
    u = rng.standard_normal((n_samples, n_inputs))
    driven, state = u @ B.T, np.zeros((n_samples, 6), dtype=complex)
    for k in range(1, n_samples):
        state[k] = pole * state[k - 1] + driven[k - 1]
    y = 2 * (state @ C.T).real + u @ D.T
    y += 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
    truth = [D] + [2 * ((C * pole ** (k - 1)) @ B).real for k in range(1, N_LAGS + 1)]
    np.savez(path, u=u, y=y, truth=np.array(truth))


def ours(u, y):
    from okid.markov import recover_markov
    from okid.observer import fit_observer
    from okid.record import Record

    record = Record(u, y, 0.01)
    return lambda: recover_markov(fit_observer(record, order=ORDER), n_lags=N_LAGS).system


def modred(u, y):
    import modred

    inputs, outputs = u.T.copy(), y.T.copy()
    return lambda: modred.OKID(inputs, outputs, ORDER)


CONTENDERS = {"okid": ours, "modred": modred}


def contend(name, path, result):
    """Time one contender in this process: least CPU time of several calls."""
    data = np.load(path)
    call = CONTENDERS[name](data["u"], data["y"])
    spent, least = 0.0, np.inf
    for _ in range(1000):
        start = time.process_time()
        markov = call()
        elapsed = time.process_time() - start
        least, spent = min(least, elapsed), spent + elapsed
        if spent > 2.0:
            break
    np.save(result, markov)
    print(json.dumps(least))


def run(python, name, path, result):
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    root = str(Path(__file__).resolve().parents[2])
    command = [python, __file__, "--contender", name, "--data", str(path), "--result", str(result)]
    environment = {**os.environ, **threads, **({"PYTHONPATH": root} if name == "okid" else {})}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{name} failed in {python}:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-python", help="interpreter with modred")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--contender", choices=CONTENDERS, help=argparse.SUPPRESS)
    parser.add_argument("--data", help=argparse.SUPPRESS)
    parser.add_argument("--result", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.contender:
        contend(options.contender, options.data, options.result)
        return
    pythons = {"okid": sys.executable} | ({"modred": options.peer_python} if options.peer_python else {})
    print(
        f"{'outputs x inputs / samples':28}{'okid ms':>10}{'modred ms':>12}{'ratio':>8}{'wanted':>8}   error of h: "
        "okid, modred; apart"
    )
    with tempfile.TemporaryDirectory() as folder:
        for case, (n_outputs, n_inputs, n_samples, wanted) in CASES.items():
            path = Path(folder) / "case.npz"
            make_case(n_outputs, n_inputs, n_samples, path)
            least = dict.fromkeys(pythons, np.inf)
            for _ in range(options.rounds):
                for name, python in pythons.items():
                    least[name] = min(least[name], run(python, name, path, Path(folder) / f"{name}.npy"))
            truth = np.load(path)["truth"][:ORDER]
            markov = {name: np.load(Path(folder) / f"{name}.npy")[:ORDER] for name in pythons}
            size = np.abs(truth).max()
            errors = {name: np.abs(values - truth).max() / size for name, values in markov.items()}
            row = f"{case:28}{1e3 * least['okid']:10.2f}"
            if "modred" in pythons:
                apart = np.abs(markov["okid"] - markov["modred"]).max() / size
                row += f"{1e3 * least['modred']:12.1f}{least['modred'] / least['okid']:8.1f}{wanted:8d}"
                row += f"   {errors['okid']:.1e}, {errors['modred']:.1e}; {apart:.1e}"
                if apart > 0.2 * max(errors.values()) + 2e-3:
                    sys.exit(f"{row}\nthe two disagree")
            print(row, flush=True)


if __name__ == "__main__":
    main()
