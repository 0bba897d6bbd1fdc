"""Random records of each kind that the field brings: driven, struck, ringing down, ambient; truth and bound beside.

Nothing here imports okid, era or modal. A mode with pole s, shape c and input vector g answers a held input exactly as
in `structures.py`; what a structure does by itself is the sum of Re(c x0 exp(s t)). The bound of a decay (poles, shapes
common to the records, the state that each record starts from, and a level of each output and record unknown; white
noise of known size) is the inverse of the information J' R^-1 J, with the scale that shapes and states share held.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.signal import lfilter
from structures import OfPoles, log_uniform, participation_of, random_excitation

RecordKind = Literal["driven", "transient", "decay", "ambient"]

KINDS: tuple[RecordKind, ...] = ("driven", "transient", "decay", "ambient")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class KindRecords(OfPoles):
    """Records of one structure.

    `poles` (n_modes,) [1/s], one of each pair; `records`: pairs of inputs (n_samples, n_inputs) and outputs
    (n_samples, n_outputs); `excitable` (n_modes,): the answer of the mode alone stands above the noise of some output
    in its own half-power band; `frequency_std`, `damping_ratio_std`: the bound, None where there is none.
    """

    kind: RecordKind
    poles: np.ndarray
    shapes: np.ndarray
    records: tuple[tuple[np.ndarray, np.ndarray], ...]
    dt: float
    noise_std: np.ndarray
    excitable: np.ndarray
    words: str
    frequency_std: np.ndarray | None = None
    damping_ratio_std: np.ndarray | None = None


def random_records(kind: RecordKind, seed: int, *, n_records: int | None = None, cell: float = 0.0) -> KindRecords:
    """Records of this kind; all follows from the seed. The sensors of force add white noise, `cell` of their peaks."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    several = int(rng.choice([1, 1, 1, 2, 3, 4, 6, 10])) if n_records is None else n_records
    made = {"driven": _driven, "transient": _struck, "decay": _decaying, "ambient": _ambient}[kind](rng, several)
    if not cell:
        return made
    rng, peak = np.random.default_rng([seed, 77]), max(np.abs(u).max() for u, _ in made.records)
    return replace(made, records=tuple((u + cell * peak * rng.standard_normal(u.shape), y) for u, y in made.records))


# --- the four kinds --------------------------------------------------------------------------------------------------


def _struck(rng, n_records):
    """One blow a record, anywhere: 0.1 to 3 % noise of each output's peak, an answer that fills 3 to 100 % of it."""
    n_samples, dt = int(log_uniform(rng, 1000, 6000)), log_uniform(rng, 1e-4, 1e-2)
    answer = log_uniform(rng, 0.03, 1.0) * n_samples
    poles, shapes = _structure(rng, max(answer, 80.0), dt)
    n_inputs = 2 if n_records > 2 and rng.random() < 0.3 else 1
    forces, derivative = rng.standard_normal((n_inputs, poles.size)), int(rng.integers(3))
    participation = forces * participation_of(poles, derivative, dt)
    participation /= np.abs(participation).max(axis=0) / log_uniform(rng, 0.3, 1.0, poles.size)
    # an accelerometer answers at once, as large as its modes together
    D = np.zeros((shapes.shape[0], n_inputs)) if derivative < 2 else shapes.real @ participation.real.T
    cleans, inputs, own = [], [], []
    for r in range(n_records):
        length = int(rng.integers(2, 8))
        start = int(rng.integers(0, 20)) if rng.random() < 0.3 else int(rng.integers(0, 0.6 * n_samples))
        u = np.zeros((n_samples, n_inputs))
        u[start : start + length, r % n_inputs] = rng.uniform(0.5, 1.5) * np.sin(
            np.pi * (np.arange(length) + 1) / (length + 1)
        )
        answers = np.stack([_answer(p, c, u @ b, dt) for p, c, b in zip(poles, shapes.T, participation.T, strict=True)])
        own.append(answers)
        cleans.append(answers.sum(axis=0) + u @ D.T)
        inputs.append(u)
    share = log_uniform(rng, 0.001, 0.03)
    std = share * np.max([np.abs(clean).max(axis=0) for clean in cleans], axis=0)
    pairs = tuple((u, clean + std * rng.standard_normal(clean.shape)) for u, clean in zip(inputs, cleans, strict=True))
    words = f"{n_records} x {n_samples}, answer {100 * answer / n_samples:.0f} %, noise {100 * share:.2g} %"
    return KindRecords(
        kind="transient",
        poles=poles,
        shapes=shapes,
        records=pairs,
        dt=dt,
        noise_std=std,
        excitable=_above_noise(own, poles, std, dt),
        words=words,
    )


def _decaying(rng, n_records):
    """Free motion from an unknown state, some of it with a resting level: 0.1 to 3 % noise of each output's start."""
    n_samples, dt = int(log_uniform(rng, 800, 5000)), log_uniform(rng, 1e-4, 1e-2)
    poles, shapes = _structure(rng, log_uniform(rng, 0.1, 1.0) * n_samples, dt, most_outputs=12)
    time = np.arange(n_samples) * dt
    states = rng.uniform(0.2, 1.0, (n_records, poles.size)) * np.exp(2j * np.pi * rng.random((n_records, poles.size)))
    own = [
        np.einsum("km,om,m->mko", np.exp(np.outer(time, poles)), shapes, state, optimize=True).real for state in states
    ]
    share = log_uniform(rng, 0.001, 0.03)
    std = share * np.max([np.abs(one.sum(axis=0)).max(axis=0) for one in own], axis=0)
    level = rng.choice([0.0, 3.0]) * std / share * rng.standard_normal(shapes.shape[0])
    empty = np.empty((n_samples, 0))
    pairs = tuple((empty, one.sum(axis=0) + level + std * rng.standard_normal(one.shape[1:])) for one in own)
    words = f"{n_records} x {n_samples}, {shapes.shape[0]} outputs, noise {100 * share:.2g} %"
    bound = _decay_bound(poles, shapes, states, std=std, n_samples=n_samples, dt=dt)
    return KindRecords(
        kind="decay",
        poles=poles,
        shapes=shapes,
        records=pairs,
        dt=dt,
        noise_std=std,
        excitable=_above_noise(own, poles, std, dt),
        words=words,
        frequency_std=bound[0],
        damping_ratio_std=bound[1],
    )


def _ambient(rng, n_records):
    """White forces that nobody measures, 1 to 20 % sensor noise; the records begin in the middle of the motion."""
    n_samples, dt = int(log_uniform(rng, 3000, 12000)), log_uniform(rng, 1e-3, 1e-1)
    poles, shapes = _structure(rng, n_samples / log_uniform(rng, 12, 100), dt)
    pairs, share = [], log_uniform(rng, 0.01, 0.2)
    for _ in range(min(n_records, 3)):
        lead = int(5 / (-poles.real.max() * dt))
        forces = rng.standard_normal((lead + n_samples, poles.size))
        answers = sum(
            _answer(p, c, f, dt) * np.sqrt(-p.real) for p, c, f in zip(poles, shapes.T, forces.T, strict=True)
        )
        clean = answers[lead:]
        std = share * clean.std(axis=0)
        pairs.append((np.empty((n_samples, 0)), clean + std * rng.standard_normal(clean.shape)))
    words = f"{len(pairs)} x {n_samples}, noise {100 * share:.2g} %"
    return KindRecords(
        kind="ambient",
        poles=poles,
        shapes=shapes,
        records=tuple(pairs),
        dt=dt,
        noise_std=std,
        excitable=np.ones(poles.size, dtype=bool),
        words=words,
    )


def _driven(rng, n_records):
    """Forces that move throughout, of every sort, with bursts and steps among them; 0.5 to 10 % noise."""
    n_samples, dt = int(log_uniform(rng, 1500, 6000)), log_uniform(rng, 1e-3, 1e-1)
    poles, shapes = _structure(rng, n_samples / log_uniform(rng, 8, 60), dt)
    cycles = np.abs(poles) * dt / (2 * np.pi)
    kind = str(rng.choice(["white", "coloured", "sweep", "multisine", "steps", "burst", "earthquake"]))
    pairs, own, share = [], [], log_uniform(rng, 0.005, 0.1)
    forces = rng.standard_normal((1, poles.size))
    for _ in range(min(n_records, 3)):
        if kind == "steps":
            hold = int(rng.integers(3, 30))
            u = np.repeat(rng.standard_normal((n_samples // hold + 1, 1)), hold, axis=0)[:n_samples]
        elif kind in ("burst", "earthquake"):
            k = np.arange(n_samples)[:, np.newaxis] / n_samples
            envelope = (k % 0.25 < 0.12) if kind == "burst" else k * np.exp(-8.0 * k)
            u = envelope * rng.standard_normal((n_samples, 1))
        else:
            u = random_excitation(rng, n_samples, 1, kind=kind, band=(cycles.min(), cycles.max()))
        participation = forces * participation_of(poles, 0, dt) / np.abs(participation_of(poles, 0, dt))
        answers = np.stack([_answer(p, c, u @ b, dt) for p, c, b in zip(poles, shapes.T, participation.T, strict=True)])
        clean = answers.sum(axis=0)
        std = share * clean.std(axis=0)
        own.append(answers)
        pairs.append((u, clean + std * rng.standard_normal(clean.shape)))
    words = f"{len(pairs)} x {n_samples}, {kind}, noise {100 * share:.2g} %"
    return KindRecords(
        kind="driven",
        poles=poles,
        shapes=shapes,
        records=tuple(pairs),
        dt=dt,
        noise_std=std,
        excitable=_above_noise(own, poles, std, dt),
        words=words,
    )


# --- parts -----------------------------------------------------------------------------------------------------------


def _structure(rng, memory, dt, *, most_outputs=4):
    """2 to 5 modes whose slowest has fallen to 5 % after `memory` samples; neighbours at least two bandwidths apart."""
    n_modes = int(rng.integers(2, 6))
    decay = 3.0 / memory * np.r_[1.0, rng.uniform(1.0, 3.0, n_modes - 1)]
    lowest = max(0.02, 6.0 / memory)
    while True:
        cycles = np.sort(rng.uniform(lowest, max(0.4, lowest + 0.05 * n_modes), n_modes))
        apart = np.diff(2 * np.pi * cycles)
        if np.all(apart > np.maximum(4 * decay[1:], 0.05)) and cycles[-1] < 0.46:
            break
        decay *= 0.97
    poles = (-decay + 2j * np.pi * cycles) / dt
    n_outputs = int(rng.integers(1, most_outputs + 1))
    shapes = rng.standard_normal((n_outputs, n_modes)) + 0j
    return poles, shapes / np.abs(shapes).max(axis=0)


def _answer(pole, shape, drive, dt):
    state = lfilter([0.0, 1.0], [1.0, -np.exp(pole * dt)], drive)
    return 2 * np.outer(state, shape).real


def _above_noise(own, poles, std, dt):
    """(n_modes,) whether a mode's own answer, over all records, is above some output's noise in its half-power band."""
    signal, noise = 0.0, 0.0
    n_samples = own[0].shape[1]
    frequencies = np.fft.rfftfreq(n_samples, dt)
    for answers in own:
        spectra = np.abs(np.fft.rfft(answers, axis=1)) ** 2
        band = [
            np.abs(frequencies - abs(p) / (2 * np.pi)) <= max(-p.real / (2 * np.pi), 0.5 / (n_samples * dt))
            for p in poles
        ]
        signal = signal + np.array([one[inside].sum(axis=0) for one, inside in zip(spectra, band, strict=True)])
        noise = noise + np.array([inside.sum() for inside in band])[:, np.newaxis] * n_samples * std**2
    return (signal > noise).any(axis=1)


def _decay_bound(poles, shapes, states, *, std, n_samples, dt):
    """Standard deviations of frequency and damping ratio; see the module."""
    n_modes, n_records, n_outputs = poles.size, len(states), std.size
    k = np.arange(n_samples)[:, np.newaxis]
    powers = np.exp(k * poles * dt)
    sizes = [2 * n_modes, 2 * n_modes * n_outputs, 2 * n_modes * (n_records - 1), n_records * n_outputs]
    first = np.cumsum([0, *sizes])
    information = np.zeros((first[-1], first[-1]))
    for r, x in enumerate(states):
        for o in range(n_outputs):
            J = np.zeros((n_samples, first[-1]))
            slope = k * powers * shapes[o] * x  # to ln(lambda)
            J[:, 0:n_modes], J[:, n_modes : 2 * n_modes] = slope.real, -slope.imag
            at = first[1] + 2 * n_modes * o
            J[:, at : at + n_modes], J[:, at + n_modes : at + 2 * n_modes] = (powers * x).real, -(powers * x).imag
            if r:
                at = first[2] + 2 * n_modes * (r - 1)
                moved = powers * shapes[o]
                J[:, at : at + n_modes], J[:, at + n_modes : at + 2 * n_modes] = moved.real, -moved.imag
            J[:, first[3] + r * n_outputs + o] = 1.0
            information += J.T @ J / std[o] ** 2
    size = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    s = np.log(np.exp(poles * dt))
    to_size = np.zeros((n_modes, 2 * n_modes))
    to_damping = np.zeros((n_modes, 2 * n_modes))
    for i, pole in enumerate(s):
        to_size[i, [i, n_modes + i]] = pole.real / abs(pole), pole.imag / abs(pole)
        to_damping[i] = pole.real / abs(pole) ** 2 * to_size[i]
        to_damping[i, i] -= 1 / abs(pole)
    own = covariance[: 2 * n_modes, : 2 * n_modes]
    return (
        np.sqrt(np.einsum("ij,jk,ik->i", to_size, own, to_size)) / (2 * np.pi * dt),
        np.sqrt(np.einsum("ij,jk,ik->i", to_damping, own, to_damping)),
    )
