"""What the calibration of a linear chain costs: CPU time and memory of one process each, BLAS on one thread.

    python tests/benchmarks/calibration_board.py

Displacements of every mass, white force on the last, 1 % noise, stiffnesses drawn 2 % off the model's. The truth comes
from the exponential of the whole chain, and the error told is that of the largest squared natural frequency, relative.
"""

import json
import resource
import subprocess
import sys
import time

import numpy as np
import scipy

SIZES = ((3, 2000), (10, 2000), (3, 100_000), (30, 2000))
"""Degrees of freedom, and samples of each of three records."""
SEED, DT, NOISE = 7300, 0.02, 0.01


def chained(sizes):
    """(n, n) of springs or dampers between the ground, the first mass, and so on."""
    matrix = np.diag(sizes).astype(float)
    for i in range(1, len(sizes)):
        matrix[i - 1, i - 1] += sizes[i]
        matrix[i, i - 1] = matrix[i - 1, i] = -sizes[i]
    return matrix


def measured(rng, stiffness, damping, n_samples):
    """Force (n_samples, 1) and displacements of unit masses, from rest, the force held between samples."""
    n = len(stiffness)
    whole = np.zeros((2 * n + 1, 2 * n + 1))
    whole[:n, n : 2 * n] = np.eye(n)
    whole[n : 2 * n, :n], whole[n : 2 * n, n : 2 * n] = -chained(stiffness), -chained(damping)
    whole[2 * n - 1, 2 * n] = 1.0
    step = scipy.linalg.expm(whole * DT)
    force = rng.standard_normal((n_samples, 1))
    state, outputs = np.zeros(2 * n), np.empty((n_samples, n))
    for k in range(n_samples):
        outputs[k] = state[:n]
        state = step[: 2 * n, : 2 * n] @ state + step[: 2 * n, 2 * n] * force[k]
    return force, outputs + NOISE * outputs.std(axis=0) * rng.standard_normal(outputs.shape)


def cost_of(n, n_samples):
    """CPU seconds, megabytes beyond what imports and records take, mean square over the noise floor, and the error."""
    from modal.discrepancy.diagnosis import calibrate
    from modal.structure.structural_model import StructuralModel
    from okid.record import Record

    rng = np.random.default_rng((SEED, n))
    stiffness, damping = np.full(n, 2000.0), np.full(n, 0.8)
    true = stiffness * (1.0 + 0.02 * rng.standard_normal(n))
    records = [Record(*measured(rng, true, damping, n_samples), DT) for _ in range(3)]
    model = StructuralModel.chain(np.ones(n), stiffness, damping, force_dofs=[n - 1], sensor_dofs=list(range(n)))
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    found = calibrate(model, records)
    seconds = time.process_time() - start
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    highest, wanted = (np.linalg.eigvalsh(one)[-1] for one in (found.model.stiffness, chained(true)))
    return {"seconds": seconds, "megabytes": memory, "level": found.level, "error": float(highest / wanted - 1.0)}


if __name__ == "__main__":
    if "--help" in sys.argv[1:]:
        sys.exit(print(__doc__))
    if len(sys.argv) == 3:
        print(json.dumps(cost_of(int(sys.argv[1]), int(sys.argv[2]))))
    else:
        print("| DOF | samples | CPU s | MB | mean square / floor | error of w^2 |\n|---|---|---|---|---|---|")
        for n, n_samples in SIZES:
            run = subprocess.run(
                [sys.executable, __file__, str(n), str(n_samples)], capture_output=True, text=True, check=True
            )
            cost = json.loads(run.stdout)
            print(
                f"| {n} | 3 x {n_samples} | {cost['seconds']:.1f} | {cost['megabytes']:.0f} | {cost['level']:.3f} | "
                f"{cost['error']:.1e} |",
                flush=True,
            )
