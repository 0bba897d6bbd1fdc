"""Modal masses of random chains whose matrices are known: how often the 95 % interval holds the true one.

    python tests/benchmarks/modal_masses.py shaker hammer --seeds 35000-35039

A chain of three to six masses between 1 kg and 1 t in all, damping 0.4 to 2 %, sensors of one kind on every mass
(hammer: on three of them at most), 1 to 5 % noise on every output. Nothing of the product makes the records:

- held: a white force at one mass, held over each sample, as a converter gives it.
- shaker: the same between two samples; force and motion run at 16 times the rate and pass one anti-aliasing filter.
- table: responses of a long such record, Hann blocks of 5 s half over each other, with coherence and their number.
- hammer: each mass is struck by half-sines of 1 to 2 samples, in a record of its own; filtered likewise.

An error counts in standard deviations as stated. The standard error of a share is that of systems, whose masses err
together. "bias" is the mean of the signed errors in deviations. A mode counts where it is a system mode within 1 % of
the true frequency and with a MAC above 0.9; "none" are those of them without a mass or without a deviation.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import scipy

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "reference"))
from systems import chain_matrices, simulate, structure

import modal
import okid

DT, OVER = 0.01, 16
UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
TAPS = scipy.signal.firwin(64 * OVER + 1, 0.45 / OVER * 2, window=("kaiser", 8.0))


def chain(rng, n_masses):
    """Mass, damping and stiffness matrix; the highest mode at a quarter to a third of the sampling frequency."""
    masses, springs = rng.uniform(0.7, 1.4, (2, n_masses))
    masses = masses * 10 ** rng.uniform(0.0, 2.0)
    matrix, _, stiffness = chain_matrices(masses, springs, springs)
    squares = scipy.linalg.eigh(stiffness, matrix, eigvals_only=True)
    springs = springs * (2 * np.pi * rng.uniform(0.2, 0.33) / DT) ** 2 / squares[-1]
    middle = np.sqrt(squares[n_masses // 2] / squares[-1]) * 2 * np.pi * 0.3 / DT
    return chain_matrices(masses, springs, springs * 2 * rng.uniform(0.004, 0.02) / middle)


def truth(matrices, sensors):
    """(n_modes,) [Hz], (n_sensors, n_modes) shapes and (n_modes,) [kg] for a largest component of 1 at the sensors."""
    mass, _, stiffness = matrices
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    shapes = shapes[list(sensors)]
    return np.sqrt(squares) / (2 * np.pi), shapes, 1 / np.abs(shapes).max(axis=0) ** 2


def of_lines(force):
    """Samples of what a force of straight lines holds below half the fine rate, where lines let 0.1 % of a mass go."""
    spectrum = np.fft.rfft(force, axis=0)
    return np.fft.irfft(
        spectrum * np.sinc(np.arange(len(spectrum)) / len(force))[:, np.newaxis] ** 2, len(force), axis=0
    )


def filtered(signals):
    """Signals at 16 times the rate through the recorder's filter, one sample in 16, the filter's ends cut off."""
    past = scipy.signal.fftconvolve(signals, TAPS[:, np.newaxis], axes=0)
    return past[TAPS.size // 2 : TAPS.size // 2 + len(signals) : OVER]


def record(rng, force, clean, sensors, kind, *, struck, hold):
    # the noise is a share of the liveliest stretch: after a blow the rest of the record is silence
    noise = rng.uniform(0.01, 0.05) * (0.2 * np.abs(clean).max(axis=0) if hold == "blow" else clean.std(axis=0))
    return okid.Record(
        force,
        clean + noise * rng.standard_normal(clean.shape),
        DT,
        input_names=[f"force {struck}"],
        input_units=["N"],
        output_names=[f"y{sensor}" for sensor in sensors],
        output_units=[UNITS[kind]] * len(sensors),
        input_hold="zero_order" if hold == "held" else "band_limited",
        name=f"point {struck}",
    )


def held(rng):
    n_masses, kind = int(rng.integers(3, 7)), str(rng.choice(list(UNITS)))
    matrices, struck = chain(rng, n_masses), int(rng.integers(n_masses))
    sensors = range(n_masses)
    system = structure(*matrices, force_dofs=[struck], sensor_dofs=sensors, sensor_kinds=kind, dt=DT)
    force = rng.standard_normal((int(rng.integers(2000, 3001)), 1))
    one = record(rng, force, simulate(system, force), sensors, kind, struck=struck, hold="held")
    return [one], struck, truth(matrices, sensors)


def shaken(rng, n_rows, *, past=100):
    n_masses, kind = int(rng.integers(3, 7)), str(rng.choice(list(UNITS)))
    matrices, struck = chain(rng, n_masses), int(rng.integers(n_masses))
    sensors = range(n_masses)
    system = structure(
        *matrices, force_dofs=[struck], sensor_dofs=sensors, sensor_kinds=kind, dt=DT / OVER, hold="linear"
    )
    force = rng.standard_normal((OVER * n_rows, 1))
    both = filtered(np.hstack([of_lines(force), simulate(system, force)]))[past:-past]
    one = record(rng, both[:, :1], both[:, 1:], sensors, kind, struck=struck, hold="shaken")
    return [one], struck, truth(matrices, sensors)


def shaker(rng):
    return shaken(rng, int(rng.integers(2000, 3001)))


def table(rng):
    (one,), struck, known = shaken(rng, 16000)
    settings = {"fs": 1 / DT, "window": "hann", "nperseg": 512}
    force = one.inputs[:, 0]
    frequencies, of_force = scipy.signal.welch(force, **settings)
    response = np.array([scipy.signal.csd(force, y, **settings)[1] / of_force for y in one.outputs.T])
    coherence = np.array([scipy.signal.coherence(force, y, **settings)[1] for y in one.outputs.T])
    kept = (frequencies > 0) & (frequencies < 0.42 / DT)
    responses = okid.FrequencyResponse(
        response.T[kept][:, :, np.newaxis],
        frequencies[kept],
        coherence=coherence.T[kept][:, :, np.newaxis],
        n_averages=len(force) // 512,
        window="hann",
        output_names=one.output_names,
        output_units=one.output_units,
        input_names=one.input_names,
        input_units=one.input_units,
    )
    return responses, struck, known


def hammer(rng):
    n_masses, kind = int(rng.integers(3, 6)), str(rng.choice(list(UNITS)))
    matrices, sensors = chain(rng, n_masses), sorted(rng.permutation(n_masses)[:3].tolist())
    records = []
    for struck in range(n_masses):
        system = structure(
            *matrices, force_dofs=[struck], sensor_dofs=sensors, sensor_kinds=kind, dt=DT / OVER, hold="linear"
        )
        force = np.zeros((OVER * 700, 1))
        width = int(OVER * rng.uniform(1.0, 2.0))
        start = OVER * 130 + int(rng.integers(OVER))
        force[start : start + width, 0] = rng.uniform(50.0, 150.0) * np.sin(np.pi * (np.arange(width) + 0.5) / width)
        both = filtered(np.hstack([of_lines(force), simulate(system, force)]))[100:-100]
        records.append(record(rng, both[:, :1], both[:, 1:], sensors, kind, struck=struck, hold="blow"))
    driven = int(rng.choice(sensors))
    return okid.join_setups(records), driven, truth(matrices, sensors)


CASES = {"held": held, "shaker": shaker, "hammer": hammer, "table": table}


def errors_of(case, seed):
    """Errors of the masses in stated deviations, relative deviations, modes without a mass, and modes in all."""
    records, driven, (frequencies, shapes, masses) = CASES[case](np.random.default_rng([seed, 20]))
    model = modal.identify(records).modes
    if not model.system:
        return [], [], 0, masses.size
    scaled = modal.normalise_shapes(model, driving_point=(f"y{driven}", f"force {driven}"))
    errors, relative, without = [], [], 0
    for mode, mass, std in zip(model.system, scaled.modal_mass, scaled.modal_mass_std, strict=True):
        k = int(np.abs(frequencies - mode.frequency).argmin())
        overlap = np.abs(mode.shape.conj() @ shapes[:, k]) ** 2
        mac = overlap / np.sum(np.abs(mode.shape) ** 2) / np.sum(shapes[:, k] ** 2)
        if abs(mode.frequency / frequencies[k] - 1) > 0.01 or mac < 0.9:
            continue
        if not np.isfinite([mass, std]).all():
            without += 1
            continue
        errors.append((mass - masses[k]) / std)
        relative.append(std / mass)
    return errors, relative, without, masses.size


def summary(case, rows):
    """Shares with their standard errors by systems, of all masses so far."""
    errors, relative, without, modes = zip(*rows, strict=True)
    every = np.concatenate([np.asarray(own, dtype=float) for own in errors])
    if not every.size:
        return f"{case:8s} no mass in {len(rows)} systems"
    inside = np.abs(every) < 1.96
    sums = [np.sum(np.abs(own) < 1.96) - len(own) * inside.mean() for own in errors]
    biases = [np.sum(own) - len(own) * every.mean() for own in errors]
    errors_of_share = 100 * np.linalg.norm(sums) / every.size
    return (
        f"{case:8s} {len(rows):4d} systems {every.size:5d} masses of {sum(modes):5d} modes, none {sum(without):3d}: "
        f"inside {100 * inside.mean():5.1f} +- {errors_of_share:3.1f} %, rms {np.sqrt(np.mean(every**2)):.2f}, "
        f"bias {every.mean():+.2f} +- {np.linalg.norm(biases) / every.size:.2f}, median deviation "
        f"{100 * np.median(np.concatenate(relative)):.2f} %"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("cases", nargs="*", help=", ".join(CASES))
    parser.add_argument("--seeds", default="35000-35009")
    arguments = parser.parse_args()
    cases = arguments.cases or list(CASES)
    first, _, last = arguments.seeds.partition("-")
    rows = {case: [] for case in cases}
    for seed in range(int(first), int(last or first) + 1):
        for case in cases:
            began = time.process_time()
            try:
                rows[case].append(errors_of(case, seed))
            except modal.IdentificationError as error:
                print(f"  {seed} {case}: {error}", flush=True)
                continue
            shown = " ".join(f"{error:+.1f}" for error in rows[case][-1][0])
            print(f"  {seed} {case}: {shown} ({time.process_time() - began:.1f} CPU s)", flush=True)
            print(summary(case, rows[case]), flush=True)


if __name__ == "__main__":
    main()
