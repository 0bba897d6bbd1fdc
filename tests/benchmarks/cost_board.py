"""What identification costs: CPU time, one BLAS thread, each measurement in a process of its own, least of the rounds.

- `identify`: `modal.identify` of a simulated record, nothing told.
- observer: ours fits an observer of order 50 (conditioning and refinement as by default) and recovers 200 Markov
  parameters; SLICOT's IB01MD makes the triangular factor alone, fast Cholesky, 25 block rows: the same 50 lags.
- diagram: the poles of the orders 1 to 50 of the same record, with indicators. pyOMA2: `SSI` by its own classes from
  the outputs in memory to its result, covariance driven, ordmax 50, hard and soft criteria (MPC, MPD, stability labels)
  as they default, once with 50 block rows, once with 20 as its default. Ours: observer of order 50, 100 Markov
  parameters (50 block rows), one decomposition, then `realise_from` and `extract_modes` (every indicator) for each
  order; and the same without the observer, from Markov parameters in memory.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
RECORDS = {
    "12 000 x 4": {"n_samples": 12_000, "n_inputs": 1, "n_outputs": 3, "n_modes": 5},
    "8500 x 30": {"n_samples": 8_500, "n_inputs": 2, "n_outputs": 28, "n_modes": 8},
    "16x2 / 1e5": {"n_samples": 100_000, "n_inputs": 2, "n_outputs": 16, "n_modes": 6},
    "8x2 / 2e4": {"n_samples": 20_000, "n_inputs": 2, "n_outputs": 8, "n_modes": 6},
}
LINES = (
    ("identify", "12 000 x 4", ("ours",)),
    ("identify", "8500 x 30", ("ours",)),
    ("observer", "16x2 / 1e5", ("ours", "slicot")),
    ("diagram", "8x2 / 2e4", ("ours", "ours, from Markov parameters", "pyoma2", "pyoma2, 20 block rows")),
)
SEED = 5100
SLICE = 1.0
"""[s] of CPU time in which a short call is repeated, for one round."""


def make_record(size, path):
    """The record of a size in a file."""
    inputs, outputs = simulated(size, np.random.default_rng(SEED))
    np.savez(path, u=inputs, y=outputs)


def simulated(size, rng):
    """Coloured inputs, unknown initial state, 3 % noise; a filter a mode: a loop over 1e5 rows would take long."""
    n_samples, n_inputs, n_outputs, n_modes = (size[k] for k in ("n_samples", "n_inputs", "n_outputs", "n_modes"))
    from scipy.signal import lfilter

    frequency, damping = np.geomspace(0.03, 0.35, n_modes), rng.uniform(0.005, 0.03, n_modes)
    poles = np.exp(2 * np.pi * frequency * (-damping + 1j * np.sqrt(1 - damping**2)))
    B = rng.standard_normal((n_modes, n_inputs)) + 1j * rng.standard_normal((n_modes, n_inputs))
    C = rng.standard_normal((n_outputs, n_modes)) + 1j * rng.standard_normal((n_outputs, n_modes))
    before = 1000  # the record starts in motion
    inputs = lfilter([1.0, 0.3], [1.0, -0.8], rng.standard_normal((n_samples + before, n_inputs)), axis=0)
    states = [lfilter([0, 1.0], [1.0, -p], inputs @ b) for p, b in zip(poles, B, strict=True)]
    outputs = 2 * (np.array(states).T @ C.T).real + inputs @ rng.standard_normal((n_inputs, n_outputs))
    outputs += 0.03 * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    return inputs[before:], outputs[before:]


# --- what is timed: each gives the call -----------------------------------------------------------------------------


def ours_identify(u, y):
    import modal
    import okid

    modal.identify(okid.Record(u[:1500, :1], y[:1500, :1], 0.01), observer_order=10, ridge=0.0, order=4)  # warm
    record = okid.Record(u, y, 0.01)
    return lambda: modal.identify(record)


def ours_observer(u, y):
    import okid

    record = okid.Record(u, y, 0.01)
    return lambda: okid.recover_markov(okid.fit_observer(record, order=50), n_lags=200)


def slicot_observer(u, y):
    import ctrlsys

    u, y = np.asfortranarray(u), np.asfortranarray(y)
    return lambda: ctrlsys.ib01md("M", "C", "O", "N", 25, u.shape[1], y.shape[1], u, y)


def ours_diagram_markov(u, y):
    import okid

    markov = okid.recover_markov(okid.fit_observer(okid.Record(u, y, 0.01), order=50), n_lags=100)
    return lambda: all_orders(markov)


def ours_diagram_record(u, y):
    import okid

    record = okid.Record(u, y, 0.01)
    return lambda: all_orders(okid.recover_markov(okid.fit_observer(record, order=50), n_lags=100))


def all_orders(markov):
    import era
    import modal

    decomposition = era.decompose(markov, max_order=50)
    return [modal.extract_modes(era.realise_from(decomposition, order)) for order in range(1, 51)]


def pyoma2_diagram(u, y):
    return lambda: pyoma2_orders(u, y, 50)


def pyoma2_diagram_default(u, y):
    return lambda: pyoma2_orders(u, y, 20)


def pyoma2_orders(u, y, n_rows):
    sys.path.insert(0, str(HERE / "contenders"))
    from pyoma_ssi import diagram

    return diagram(u, y, 0.01, method="cov", n_rows=n_rows, highest=50, step=1)


CALLS = {
    ("identify", "ours"): ours_identify,
    ("observer", "ours"): ours_observer,
    ("observer", "slicot"): slicot_observer,
    ("diagram", "ours, from Markov parameters"): ours_diagram_markov,
    ("diagram", "ours"): ours_diagram_record,
    ("diagram", "pyoma2"): pyoma2_diagram,
    ("diagram", "pyoma2, 20 block rows"): pyoma2_diagram_default,
}


def time_one(kind, name, path):
    """In the child: CPU seconds of a call; short calls are repeated."""
    with np.load(path) as stored:
        call = CALLS[kind, name](stored["u"], stored["y"])
    if kind != "identify":
        call()
    spent, n_calls = 0.0, 0
    while n_calls == 0 or (spent < SLICE and n_calls < 1000 and kind != "identify"):
        start = time.process_time()
        call()
        spent, n_calls = spent + time.process_time() - start, n_calls + 1
    sys.stdout.write("\n" + json.dumps(spent / n_calls))


def costs(only, work, rounds):
    """{line: {contender: [seconds a round]}}, kept in `costs.json`; rounds that are there are not run again."""
    from environments import environment, interpreter

    kept = work / "costs.json"
    seconds = json.loads(kept.read_text()) if kept.exists() else {}
    for kind, size, names in LINES:
        path = work / "problems" / f"cost_{size.replace(' ', '').replace('/', '_')}.npz"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            make_record(RECORDS[size], path)
        line = seconds.setdefault(f"{kind}, {size}", {})
        for _ in range(rounds):
            for name in names:
                who = name.split(",")[0]
                if who not in only or len(line.setdefault(name, [])) >= rounds:
                    continue
                python, problem = interpreter(who, work)
                if problem:
                    continue
                done = subprocess.run(
                    [python, __file__, kind, name, str(path)],
                    env=environment(who),
                    capture_output=True,
                    text=True,
                    check=False,
                )
                if done.returncode:
                    line.setdefault("failures", {})[name] = done.stderr.strip().splitlines()[-1][:200]
                    continue
                line[name].append(json.loads(done.stdout.splitlines()[-1]))
                kept.write_text(json.dumps(seconds, indent=1))
    return seconds


if __name__ == "__main__":
    if "--help" in sys.argv[1:]:
        sys.exit(print(__doc__))
    time_one(*sys.argv[1:])
