"""A folder of small measured files: one mode, struck by noise, as CSV with time."""

import numpy as np
import pytest
import scipy

QUICK = {"inputs": ["force"], "observer_order": 8, "ridge": 1e-6, "order": 2}


def write_run(path, seed, *, dt=0.02, header="time,force,a,b", frequency=3.0):
    rng = np.random.default_rng(seed)
    force = rng.standard_normal(250)
    pole = np.exp((-0.02 + 1j) * 2 * np.pi * frequency * dt)
    motion = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], force)
    outputs = np.outer(motion, (1.0, -0.5)) + 0.02 * rng.standard_normal((250, 2))
    time = 3600.0 * seed + dt * np.arange(250)
    np.savetxt(path, np.column_stack([time, force, outputs]), delimiter=",", header=header, comments="", fmt="%.10g")


def write_runs(folder):
    folder.mkdir()
    for seed in range(4):
        write_run(folder / f"run_{seed}.csv", seed)
    return folder


@pytest.fixture
def runs(tmp_path):
    return write_runs(tmp_path / "runs")
