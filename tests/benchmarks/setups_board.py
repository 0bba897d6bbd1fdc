"""Set-ups against structures whose modes are known: roving sensors, driven or not, and a roving hammer.

    python tests/benchmarks/setups_board.py driven|ambient|hum|hammer --seeds 1-10

- driven: 5 set-ups of 8 sensors, 2 of them references, one force at a fixed point, levels different by up to 10, 2 %
  noise on every output; error over the joint Cramer-Rao bound of all set-ups (references' shapes shared).
- ambient: 3 set-ups of 3 velocities, 2 of them references, on a chain of 5 masses, white forces that nobody measured.
- hum: the same, and two lines that never end, as loud as the modes.
- hammer: 20 points struck, 2 sensors, 16 modes; the residues judge the modal scaling.

In the row PoSER poles and shapes are plain means of what each set-up gives by itself, shapes scaled by the references
(Reynders, Magalhaes, De Roeck, Cunha, IMAC 2009), a twin of the joint estimate. In the row PreGER the subspaces of the
set-ups are merged before poles are taken, by a textbook implementation that is told the true order
(`tests/reference/textbook_modal.py`). Where no bound is known errors are relative to the truth, in per cent.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "reference"))
from crb import information_matrix
from systems import random_chain, sampled, simulate
from textbook_modal import merged_subspaces

import modal
import okid
from modal.identification import pipeline

DT = 0.01
NEAR = 0.01
"""Take a mode for a true one within this share of its frequency."""
PAST = 60
"""Samples of past and future in the merged subspaces: a period and a half of the lowest modes."""


def beam(rng, n_modes, n_points, force_point):
    """Displacements at points of a beam on two supports, its frequencies moved at random; truth and shapes by mode."""
    frequencies = np.geomspace(2.5, 36.0, n_modes) * rng.uniform(0.93, 1.07, n_modes)
    ratios = np.exp(rng.uniform(np.log(0.004), np.log(0.02), n_modes))
    places = (np.arange(n_points) + 0.5 + rng.uniform(-0.3, 0.3, n_points)) / n_points
    shapes = np.sin(np.pi * np.outer(places, np.arange(1, n_modes + 1)))
    size = 2 * np.pi * frequencies
    A = scipy.linalg.block_diag(*([[0.0, w], [-w, -2 * z * w]] for w, z in zip(size, ratios, strict=True)))
    B, C = np.zeros((2 * n_modes, 1)), np.zeros((n_points, 2 * n_modes))
    B[1::2, 0], C[:, ::2] = shapes[force_point], shapes
    return sampled(A, B, C, np.zeros((n_points, 1)), dt=DT), shapes


def selected(system, outputs):
    chosen = list(outputs)
    return replace(system, C=system.C[chosen], D=system.D[chosen], shapes=system.shapes[chosen])


def driven(seed):
    """Records, the truth, its shapes over all points, and the bounds of frequency and damping."""
    rng = np.random.default_rng(seed)
    n_modes, n_points, n = 6, 32, 3000
    system, shapes = beam(rng, n_modes, n_points, 11)
    levels = np.geomspace(1.0, 10.0, 5)[rng.permutation(5)]
    records, total = [], 0.0
    for k, level in enumerate(levels):
        sensors = [4, 21, *[p for p in range(n_points) if p not in (4, 21)][6 * k : 6 * k + 6]]
        own = selected(system, sensors)
        force = level * rng.standard_normal((n, 1))
        clean = simulate(own, force)
        noise = 0.02 * clean.std(axis=0)
        values = clean + noise * rng.standard_normal(clean.shape)
        records.append(_record(force, values, ["force"], sensors, f"set-up {k}"))
        total = total + _shared_information(own, force, noise, n_references=2)
    scale = 1 / np.sqrt(np.diag(total))
    covariance = np.linalg.inv(total * np.outer(scale, scale)) * np.outer(scale, scale)
    bounds = []
    for k, (pole, discrete) in enumerate(zip(system.poles, system.discrete_poles, strict=True)):
        own = covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        directions = np.array([1.0, 1j]) / (discrete * DT)
        size = abs(pole)
        d_size = (pole.conjugate() * directions).real / size
        d_ratio = -directions.real / size + pole.real * d_size / size**2
        bounds.append([np.sqrt(d_size @ own @ d_size) / (2 * np.pi), np.sqrt(d_ratio @ own @ d_ratio)])
    return records, system, shapes, np.array(bounds)


def _shared_information(system, force, noise, *, n_references):
    """Information of a set-up on poles and the references' parts of the shapes, all that is its own taken out."""
    whole = information_matrix(system, force, initial_state=np.zeros(system.order), noise_std=noise, level="unknown")
    n_modes, n_outputs = system.poles.size, system.n_outputs
    each = 2 * n_outputs + 2  # to c (real parts, imaginary parts) and to x(0), a mode; the one input's part is held
    kept = list(range(2 * n_modes))
    for mode in range(n_modes):
        first = 2 * n_modes + mode * each
        # real parts of (c, x(0)), then imaginary parts
        kept += [first + part * (n_outputs + 1) + o for part in (0, 1) for o in range(n_references)]
    rest = np.setdiff1d(np.arange(whole.shape[0]), kept)
    scale = 1 / np.sqrt(np.diag(whole))
    scaled = whole * np.outer(scale, scale)
    cross = scaled[np.ix_(kept, rest)]
    marginal = scaled[np.ix_(kept, kept)] - cross @ np.linalg.solve(scaled[np.ix_(rest, rest)], cross.T)
    return marginal / np.outer(scale[kept], scale[kept])


def hum(seed):
    return ambient(seed, n_lines=2)


def ambient(seed, *, n_lines=0):
    rng = np.random.default_rng(seed)
    chain = random_chain(rng, n_masses=5, n_inputs=5, sensor_kinds="velocity", damping_ratio=0.01, dt=DT)
    records, lines, hum_shapes = [], rng.uniform(2.0, 40.0, n_lines), rng.standard_normal((n_lines, 5))
    for k, level in enumerate(np.geomspace(1.0, 10.0, 3)[rng.permutation(3)]):
        sensors = [1, 4, (0, 2, 3)[k]]
        clean = simulate(selected(chain, sensors), level * rng.standard_normal((4500, 5)))[500:]
        loud = clean.std()
        for frequency, shape in zip(lines, hum_shapes, strict=True):
            phase = 2 * np.pi * frequency * DT * np.arange(len(clean)) + rng.uniform(0.0, 2 * np.pi)
            clean = clean + loud * np.outer(np.sin(phase), shape[sensors])
        values = clean + 0.02 * clean.std(axis=0) * rng.standard_normal(clean.shape)
        records.append(_record([], values, [], sensors, f"set-up {k}"))
    return records, chain, chain.shapes, None


def hammer(seed):
    rng = np.random.default_rng(seed)
    system, shapes = beam(rng, 16, 20, 0)
    sensors, records = [3, 12], []
    for point in range(20):
        force = np.zeros((2000, 1))
        force[20:23, 0] = np.array([50.0, 100.0, 50.0]) * rng.uniform(0.7, 1.4)
        clean = simulate(replace(selected(system, sensors), B=_input_at(shapes[point], system)), force)
        values = clean + 0.002 * np.abs(clean).max(axis=0) * rng.standard_normal(clean.shape)
        records.append(_record(force, values, [f"hammer {point}"], sensors, f"point {point}"))
    return records, system, shapes, None


def _input_at(shape, system):
    """The discrete input matrix for a force at a point with these mode shapes; that of `system` is at point 0."""
    B = np.array(system.B)
    first = system.C[0, ::2]  # of point 0
    for k in range(first.size):
        B[2 * k : 2 * k + 2] *= shape[k] / first[k]
    return B


def _record(force, values, names, sensors, name):
    return okid.Record(
        force,
        values,
        DT,
        input_names=names,
        input_units=["N"] * len(names),
        output_names=[f"y{k}" for k in sensors],
        output_units=["m"] * values.shape[1],
        name=name,
        input_hold="zero_order",
    )


def assurance(first, second):
    return abs(np.vdot(first, second)) ** 2 / (np.vdot(first, first) * np.vdot(second, second)).real


def identified(records):
    """The joint result, and what each set-up gave by itself on the way."""
    own, plain = [], pipeline.identify_setups

    def keeping(joined, again, **options):
        def kept(*arguments, **named):
            own.append(again(*arguments, **named))
            return own[-1]

        return plain(joined, kept, **options)

    pipeline.identify_setups = keeping
    try:
        return modal.identify(okid.join_setups(records)), own[: len(records)]
    finally:
        pipeline.identify_setups = plain


def poser(records, results, n_points):
    """(frequency, damping ratio, shape over all points) of the modes that each set-up finds: plain means."""
    results = [result.modes.system for result in results]
    means = []
    for first in results[0]:
        own = [min(modes, key=lambda one, f=first.frequency: abs(one.frequency - f), default=None) for modes in results]
        if any(one is None or abs(one.frequency / first.frequency - 1) > NEAR for one in own):
            continue
        shape, count = np.zeros(n_points, dtype=complex), np.zeros(n_points)
        references = first.shape[:2]
        for record, one in zip(records, own, strict=True):
            scale = np.vdot(one.shape[:2], references) / np.vdot(one.shape[:2], one.shape[:2])
            points = [int(name[1:]) for name in record.output_names]
            shape[points] += scale * one.shape
            count[points] += 1
        means.append((np.mean([o.frequency for o in own]), np.mean([o.damping_ratio for o in own]), shape / count))
    return means


def preger(records, order):
    """(frequency, damping ratio, shape over all points) of the modes of the merged subspaces; sensors by number."""
    names = [record.output_names for record in records]
    poles, shapes = merged_subspaces(
        [(record.inputs, record.outputs) for record in records], n_references=2, order=order, n_blocks=PAST
    )
    points = [int(name[1:]) for name in (*names[0][:2], *(one for own in names for one in own[2:]))]
    ordered = np.argsort(points)
    continuous = np.log(poles.astype(complex)) / DT
    return [
        (abs(pole) / (2 * np.pi), -pole.real / abs(pole), shape[ordered])
        for pole, shape in zip(continuous, shapes.T, strict=True)
        if pole.imag > 0
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("driven", "ambient", "hum", "hammer"))
    parser.add_argument("--seeds", default="1-10", help="first-last")
    given = parser.parse_args()
    make = {"driven": driven, "ambient": ambient, "hum": hum, "hammer": hammer}[given.kind]
    first, last = map(int, given.seeds.split("-"))
    low: list[bool] = []
    z, over, assurances, residues = [], [], [], []
    twins = {"PoSER": ([], []), "PreGER": ([], [])}
    n_true = n_found = n_false = 0
    for seed in range(first, last + 1):
        records, truth, shapes, bounds = make(seed)
        began = time.process_time()
        try:
            result, own = identified(records)
        except okid.IdentificationError as error:
            print(f"seed {seed}: {error}", flush=True)
            n_true += truth.poles.size
            continue
        seconds = time.process_time() - began
        points = [int(name[1:]) for name in result.modes.output_names]
        said, matched = [], set()
        for k, (frequency, ratio) in enumerate(zip(truth.frequencies, truth.damping_ratios, strict=True)):
            near = [m for m in result.modes if abs(m.frequency / frequency - 1) < NEAR and m.kind == "oscillatory"]
            mode = min(near, key=lambda one, f=frequency: abs(one.frequency - f), default=None)
            called = mode is not None and mode.verdict == "system"
            if mode is not None:
                matched.add(id(mode))
            if not called:
                said.append(f"{frequency:.3g} Hz {'absent' if mode is None else f'{mode.verdict}: {mode.reason}'}")
                continue
            errors = np.array([mode.frequency - frequency, mode.damping_ratio - ratio])
            n_found += 1
            low.append(k == 0)
            z.append(errors / [mode.frequency_std, mode.damping_ratio_std])
            over.append(errors / (bounds[k] if bounds is not None else [frequency / 100.0, ratio / 100.0]))
            assurances.append(assurance(mode.shape, shapes[points, k]))
            if given.kind == "hammer":
                residue = np.outer(mode.shape, mode.participation)
                struck = truth.participation[0, k] * shapes[:, k] / shapes[0, k]
                true = np.outer(truth.shapes[points, k], struck)
                residues.append(np.linalg.norm(residue - true) / np.linalg.norm(true))
        n_true += truth.poles.size
        false = [m for m in result.modes.system if id(m) not in matched]
        n_false += len(false)
        said += [f"false {m.frequency:.3g} Hz" for m in false]
        said += [text for text in result.warnings if "left out" in text]
        print(f"seed {seed}: {seconds:.1f} s{''.join(f'; {one}' for one in said)}", flush=True)
        if given.kind != "hammer":
            made = {"PoSER": poser(records, own, len(shapes)), "PreGER": preger(records, 2 * truth.poles.size)}
            for name, found in made.items():
                for frequency, ratio, shape in found:
                    k = int(np.abs(truth.frequencies / frequency - 1).argmin())
                    true = np.array([truth.frequencies[k], truth.damping_ratios[k]])
                    if abs(frequency / true[0] - 1) < NEAR:
                        scale = bounds[k] if bounds is not None else true / 100.0
                        twins[name][0].append((np.array([frequency, ratio]) - true) / scale)
                        twins[name][1].append(assurance(shape, shapes[:, k]))
        print(f"  so far: found {n_found} of {n_true}, false {n_false}")
        if z:
            rows = {"joint": (over, assurances), **twins}
            show(np.array(z), np.array(low), rows, residues, unit="%" if bounds is None else "bound")


def show(z, low, rows, residues, *, unit):
    """What was found so far, in figures."""
    within = 100 * np.mean(np.abs(z) < 1.96, axis=0)
    print(f"  within 1.96 deviations: frequency {within[0]:.1f} %, damping {within[1]:.1f} %; rms z {_rms(z)}")
    if low.any():
        print(f"  lowest modes: damping mean z {z[low, 1].mean():.2f}, rms {_rms(z[low])}")
    if residues:
        print(f"  largest relative error of a mode's residues: {max(residues):.4f}, median {np.median(residues):.4f}")
    for name, (errors, alike) in rows.items():
        if errors:
            both = np.sqrt(np.mean(np.square(errors)))
            print(
                f"  {name}: {len(errors)} modes, rms error [{unit}] {_rms(errors)}, both {both:.3f}; assurance least "
                f"{min(alike):.5f}, below 0.999: {sum(one < 0.999 for one in alike)}"
            )
    sys.stdout.flush()


def _rms(values):
    return ", ".join(f"{one:.3f}" for one in np.sqrt(np.mean(np.square(values), axis=0)))


if __name__ == "__main__":
    main()
