"""Eight everyday data sets of one plate, each identified by one command: modes found, false ones, errors, terminal.

    python tests/benchmarks/everyday_plate.py --seed 35 --folder DIR [--above 2] [KIND ...]

A plate on four supports, six modes below 0.4 of the sampling frequency, `--above` so many far above it (the next that
are 1.6 times as high as the sixth), drawn anew for each seed; accelerometers on a grid of twelve points with 1 % noise.
Forces and motion run at 16 times the rate and pass one anti-aliasing filter, and nothing of the product makes the
files. The command is `modal-report run FILES`, with `--inputs` where a force was measured; what it prints is kept
beside its folder, and its lines are counted. An error counts in standard deviations as `modes.csv` states them.
"""

import argparse
import csv
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import scipy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from modal_masses import OVER, filtered, of_lines

DT, POINTS = 1 / 512, 12
PLACES = np.stack(np.meshgrid([0.13, 0.37, 0.61, 0.89], [0.17, 0.48, 0.86], indexing="ij"), axis=-1).reshape(-1, 2)


class Plate:
    """Frequencies [Hz], damping ratios and (n_points, n_modes) shapes of a plate with supported edges."""

    def __init__(self, rng, *, n_above):
        m, n = (grid.ravel() for grid in np.meshgrid([1, 2, 3, 4], [1, 2, 3], indexing="ij"))
        while True:  # no two modes of the six closer than 4 %
            values = (m / rng.uniform(1.0, 1.7)) ** 2 + n**2
            order = np.argsort(values)
            six = values[order[:6]]
            if (six[1:] / six[:-1] > 1.04).all():
                break
        kept = [*order[:6], *order[np.flatnonzero(values[order] > 1.6 * six[-1])][:n_above]]
        self.frequencies = values[kept] * rng.uniform(0.32, 0.39) / DT / six[-1]
        self.damping = np.exp(rng.uniform(np.log(0.004), np.log(0.015), len(kept)))
        x, y = PLACES.T
        self.shapes = np.sin(np.pi * np.outer(x, m[kept])) * np.sin(np.pi * np.outer(y, n[kept])) / np.sqrt(2.0)  # 8 kg

    def motion(self, forces, points, sensors, *, start=None):
        """Accelerations at the fine rate to forces joined by lines, exactly, mode by mode."""
        step = DT / OVER
        outputs = np.zeros((len(forces), len(sensors)))
        for k, frequency in enumerate(self.frequencies):
            size = 2 * np.pi * frequency
            A = np.array([[0.0, 1.0], [-(size**2), -2 * self.damping[k] * size]])
            pole = size * complex(-self.damping[k], np.sqrt(1 - self.damping[k] ** 2))
            drive = forces @ self.shapes[points, k]
            # x' = pole x + drive, drive a line in each step
            z = pole * step
            first = (np.exp(z) - 1) / z
            second = (first - 1) / z
            pushes = step * ((first - second) * drive[:-1] + second * drive[1:])
            state = np.zeros(len(forces), dtype=complex)
            begin = 0.0 if start is None else start[k]
            state[0] = begin
            state[1:], _ = scipy.signal.lfilter([1.0], [1.0, -np.exp(z)], pushes, zi=[np.exp(z) * begin])
            displacement = state.imag / pole.imag
            velocity = (pole * state).imag / pole.imag
            acceleration = A[1, 0] * displacement + A[1, 1] * velocity + drive
            outputs += np.outer(acceleration, self.shapes[sensors, k])
        return outputs


def recorded(rng, forces, motion):
    """What the recorder keeps of both: filtered, one row in 16, 1 % noise on the motion."""
    both = filtered(np.hstack([of_lines(forces), motion]))[100:-100]
    force, clean = both[:, : forces.shape[1]], both[:, forces.shape[1] :]
    return force, clean + 0.01 * clean.std(axis=0) * rng.standard_normal(clean.shape)


def blows(rng, n_rows, n_blows):
    force = np.zeros((OVER * n_rows, 1))
    for blow in range(n_blows):
        width = int(OVER * rng.uniform(1.5, 2.2))
        start = OVER * (110 + blow * (n_rows - 200) // n_blows + int(rng.integers(20))) + int(rng.integers(OVER))
        force[start : start + width, 0] = rng.uniform(50, 150) * np.sin(np.pi * (np.arange(width) + 0.5) / width)
    return force


def named(points):
    return [f"p{point + 1:02d}" for point in points]


def written(path, columns, values, *, dt=DT):
    with path.open("w") as file:
        file.write(",".join(["time [s]", *columns]) + "\n")
        for k, row in enumerate(values):
            file.write(",".join([f"{k * dt:.9f}", *(f"{value:.8e}" for value in row)]) + "\n")
    return path


EVERY = list(range(POINTS))
UNITS = [f"{name} [m/s^2]" for name in named(EVERY)]
FIXED = [0, 7]
"""Sensors that stay where others or the hammer rove."""


def shaken(rng, plate, n_rows, sensors):
    force = rng.standard_normal((OVER * n_rows, 1)) * 20
    return recorded(rng, force, plate.motion(force, [0], sensors))


def shaker(rng, plate, folder):
    values = np.hstack(shaken(rng, plate, 6000, EVERY))
    return [written(folder / "shaker.csv", ["force [N]", *UNITS], values)], ["--inputs", "force"]


def hammer(rng, plate, folder):
    files = []
    for hit in range(3):
        force = blows(rng, 3000, 1)
        values = np.hstack(recorded(rng, force, plate.motion(force, [0], EVERY)))
        files.append(written(folder / f"hit_{hit + 1}.csv", ["force [N]", *UNITS], values))
    return files, ["--inputs", "force"]


def roving(rng, plate, folder):
    files = []
    for point in EVERY:
        force = blows(rng, 2000, 1)
        values = np.hstack(recorded(rng, force, plate.motion(force, [point], FIXED)))
        columns = [f"force {named([point])[0]} [N]", *(UNITS[sensor] for sensor in FIXED)]
        files.append(written(folder / f"struck_{point + 1:02d}.csv", columns, values))
    return files, ["--inputs", "force p*"]


def setups(rng, plate, folder):
    files = []
    for k, moved in enumerate(([1, 2, 3, 4, 5], [6, 8, 9, 10, 11])):
        sensors = [*FIXED, *moved]
        values = np.hstack(shaken(rng, plate, 5000, sensors))
        columns = ["force [N]", *(UNITS[sensor] for sensor in sensors)]
        files.append(written(folder / f"setup_{k + 1}.csv", columns, values))
    return files, ["--inputs", "force"]


def decay(rng, plate, folder):
    files, rest = [], np.zeros((OVER * 2500, 1))
    for release in range(3):
        start = 1e-3 * plate.shapes[rng.integers(POINTS)] * rng.uniform(0.5, 1.5, plate.frequencies.size)
        values = recorded(rng, rest[:, :0], plate.motion(rest, [0], EVERY, start=start))[1]
        files.append(written(folder / f"release_{release + 1}.csv", UNITS, values))
    return files, []


def ambient(rng, plate, folder):
    force = rng.standard_normal((OVER * 15000, POINTS))
    values = recorded(rng, force[:, :0], plate.motion(force, EVERY, EVERY))[1]
    return [written(folder / "ambient.csv", UNITS, values)], []


def matrices(rng, plate, folder):
    force, motion = shaken(rng, plate, 6000, EVERY)
    scipy.io.savemat(folder / "test.mat", {"u": force, "y": motion, "dt": DT})
    return [folder / "test.mat"], ["--inputs", "u"]


def table(rng, plate, folder):
    force, motion = shaken(rng, plate, 30000, EVERY)
    settings = {"fs": 1 / DT, "window": "hann", "nperseg": 1024}
    frequencies, of_force = scipy.signal.welch(force[:, 0], **settings)
    columns, rows = [], [frequencies]
    for name, channel in zip(named(EVERY), motion.T, strict=True):
        response = scipy.signal.csd(force[:, 0], channel, **settings)[1] / of_force
        coherence = scipy.signal.coherence(force[:, 0], channel, **settings)[1]
        columns += [f"{name}/force re [m/s^2/N]", f"{name}/force im [m/s^2/N]", f"{name}/force coherence"]
        rows += [response.real, response.imag, coherence]
    kept = (frequencies > 1.0) & (frequencies < 0.44 / DT)
    path = folder / "responses.csv"
    with path.open("w") as file:
        file.write(",".join(["frequency [Hz]", *columns]) + "\n")
        for row in np.array(rows).T[kept]:
            file.write(",".join(f"{value:.8e}" for value in row) + "\n")
    return [path], []


KINDS = (shaker, hammer, roving, setups, decay, ambient, table, matrices)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("kinds", nargs="*", help=", ".join(kind.__name__ for kind in KINDS))
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--above", type=int, default=0)
    parser.add_argument("--folder", type=Path, required=True)
    arguments = parser.parse_args()
    for k, files_of in enumerate(KINDS):
        kind = files_of.__name__
        if arguments.kinds and kind not in arguments.kinds:
            continue
        began = time.perf_counter()
        folder = arguments.folder / f"{arguments.seed}_{kind}"
        plate, done = commanded(k, arguments.seed, folder, n_above=arguments.above)
        (folder / "terminal.txt").write_text(done.stdout + done.stderr)
        print(f"{kind:9s} {told(plate, folder / 'result', done)} ({time.perf_counter() - began:.0f} s)", flush=True)


def commanded(k, seed, folder, *, n_above=0):
    """The plate of a seed, and what the command says to its files of the k-th kind; the report is `folder / result`."""
    folder.mkdir(parents=True, exist_ok=True)
    plate = Plate(np.random.default_rng([seed, 8]), n_above=n_above)
    files, options = KINDS[k](np.random.default_rng([seed, k]), plate, folder)
    command = [str(Path(sys.executable).parent / "modal-report"), "run", *map(str, files), *options]
    return plate, subprocess.run(
        [*command, "-o", str(folder / "result"), "--overwrite"],
        capture_output=True, text=True, check=False, env=dict(os.environ, COLUMNS="80"),
    )  # fmt: skip


def errors_of(plate, folder):
    """(n_found, 2) errors of frequency and damping in deviations, as `modes.csv` states them, and the false modes."""
    with (folder / "modes.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["verdict"] == "system"]
    errors, false, left = [], [], list(plate.frequencies[:6])
    for row in rows:
        frequency = float(row["frequency"])
        near = [one for one in left if abs(frequency / one - 1) < 0.01]
        if not near:
            false.append(f"{frequency:.2f} Hz")
            continue
        true = min(near, key=lambda one: abs(one - frequency))
        left.remove(true)
        k = int(np.flatnonzero(plate.frequencies == true)[0])
        damping, own = float(row["damping_ratio"]), (row["frequency_std"], row["damping_ratio_std"])
        stds = [float(text) if text else np.nan for text in own]
        errors.append([(frequency - true) / stds[0], (damping - plate.damping[k]) / stds[1]])
    return np.array(errors).reshape(-1, 2), false


def told(plate, folder, done):
    """Modes found within three deviations and false ones; lines of the terminal."""
    if not (folder / "modes.csv").is_file():
        return f"refused: {done.stderr.strip().splitlines()[-1]}"
    errors, false = errors_of(plate, folder)
    shown = " ".join(f"{f:+.1f}/{d:+.1f}" for f, d in errors)
    lines = done.stdout.rstrip("\n").splitlines()
    inside, widest = np.sum(np.all(np.abs(errors) <= 3, axis=1)), max(map(len, lines), default=0)
    return (
        f"{len(errors)} of 6 found, {inside} within 3 deviations (f/damping {shown}), false {false or 'none'}; "
        f"terminal {len(lines)} lines of {widest} columns, exit {done.returncode}"
    )


if __name__ == "__main__":
    main()
