"""Random structures with random records, for the calibration of the verdict; nothing here imports okid, era or modal.

What a structure may have: modes that are weak, close, local (seen by one sensor), heavily damped (up to 20 %) or
complex; sensors of displacement, velocity or acceleration; a feedthrough. What a record may have: white, coloured,
swept, multisine or hammer inputs, an unknown initial state, offsets, 0.1 to 30 % of noise that is white, coloured or
comes from unmeasured forces, and hum: lines, with harmonics or without, that no input drives. All follows from the
seed.

A mode with pole s, real or complex shape c and input vector g answers a held input exactly by

    x(k+1) = lambda x(k) + b' u(k),   y(k) = 2 Re(c x(k)),   lambda = exp(s dt),   b = g s^d (lambda - 1) / (2 i w_d s)

with d = 0, 1, 2 for displacement, velocity, acceleration and w_d = Im s; acceleration also has D = sum of Re(c) g'.
Arrays are time-major: (n_samples, n_channels).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

ExcitationKind = Literal["white", "coloured", "sweep", "multisine", "hits"]
NoiseKind = Literal["white", "coloured", "process"]

EXCITATIONS: tuple[ExcitationKind, ...] = ("white", "coloured", "sweep", "multisine", "hits")
LEAST_SEPARATION = 1.08
"""Ratio of neighbouring frequencies that are not meant to be a close pair."""
HUM_DISTANCE = 0.06
"""Share of the frequency by which hum stays away from every mode: nearer, nobody could say which of them was found."""


class OfPoles:
    """Frequencies and damping ratios of whatever has `poles` [1/s], one of each pair."""

    __slots__ = ()

    @property
    def frequencies(self) -> np.ndarray:
        """(n_modes,) |pole| / 2 pi [Hz]."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        return -self.poles.real / np.abs(self.poles)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Structure(OfPoles):
    """Modes by rising |pole|; Markov parameter k is 2 Re sum c b' lambda^(k-1), parameter 0 is D.

    `poles` (n_modes,) [1/s], one of each pair; `shapes` (n_outputs, n_modes); `participation` (n_inputs, n_modes);
    `D` (n_outputs, n_inputs); `traits`: what is special about each mode, e.g. ("weak", "local").
    """

    poles: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray
    D: np.ndarray
    dt: float
    traits: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StructureRecord:
    """A record and the truth behind it.

    `clean` is what inputs and initial state alone give; `mode_to_noise` (n_modes,) the largest ratio over outputs of
    the standard deviation of a mode's own response to that of the noise; `hum` (n_lines,) frequencies [Hz] and
    `hum_to_noise` the same ratio for each line.
    """

    structure: Structure
    inputs: np.ndarray
    outputs: np.ndarray
    clean: np.ndarray
    mode_to_noise: np.ndarray
    hum: np.ndarray
    hum_to_noise: np.ndarray
    excitation: ExcitationKind
    noise: NoiseKind
    noise_share: float


def random_record(seed: int) -> StructureRecord:
    """A random structure with a random record of 1500 to 8000 samples, 1 to 8 outputs, 1 to 3 inputs."""
    rng = np.random.default_rng(seed)
    n_samples, n_inputs, n_outputs = int(log_uniform(rng, 1500, 8000)), rng.integers(1, 4), rng.integers(1, 9)
    dt = log_uniform(rng, 1e-3, 0.3)
    poles, traits = _poles(rng, n_samples, dt)
    excitation = EXCITATIONS[rng.integers(len(EXCITATIONS))]
    cycles = np.abs(poles) * dt / (2 * np.pi)
    inputs = random_excitation(rng, n_samples, n_inputs, kind=excitation, band=(cycles.min(), cycles.max()))
    structure = _structure(rng, poles, traits, inputs=inputs, n_outputs=n_outputs, dt=dt)
    forced = mode_responses(structure, inputs)
    free = rng.choice([0.0, 0.3, 2.0]) * rng.standard_normal(poles.size) * _free_size(structure, forced)
    start = free * np.exp(2j * np.pi * rng.random(poles.size))
    decay = np.exp(np.outer(np.arange(n_samples), poles) * dt) * start
    responses = forced + 2 * np.einsum("km,om->mko", decay, structure.shapes).real
    clean = responses.sum(axis=0) + inputs @ structure.D.T
    size = clean.std(axis=0)
    share = log_uniform(rng, 0.001, 0.3)
    kind: NoiseKind = rng.choice(["white", "white", "white", "coloured", "process"])
    noise = _noise(rng, structure, n_samples, kind) * share * size * rng.uniform(0.7, 1.4, n_outputs)
    hum, lines = _hum(rng, structure, n_samples, size)
    offset = rng.choice([0.0, 3.0]) * size * rng.standard_normal(n_outputs)
    return StructureRecord(
        structure=structure,
        inputs=inputs + rng.choice([0.0, 1.0]) * rng.standard_normal(n_inputs),
        outputs=clean + noise + lines.sum(axis=0) + offset,
        clean=clean,
        mode_to_noise=(responses.std(axis=1) / noise.std(axis=0)).max(axis=1),
        hum=hum,
        hum_to_noise=(lines.std(axis=1) / noise.std(axis=0)).max(axis=1),
        excitation=excitation,
        noise=kind,
        noise_share=share,
    )


def mode_responses(structure: Structure, inputs: np.ndarray) -> np.ndarray:
    """(n_modes, n_samples, n_outputs): what each mode alone answers from rest."""
    import scipy.signal

    responses = []
    for pole, c, b in zip(structure.poles, structure.shapes.T, structure.participation.T, strict=True):
        state = scipy.signal.lfilter([0.0, 1.0], [1.0, -np.exp(pole * structure.dt)], inputs @ b)
        responses.append(2 * np.outer(state, c).real)
    return np.stack(responses)


def participation_of(poles, derivative, dt):
    """b for a unit force and shape, held between samples; the module's equation."""
    return poles**derivative * (np.exp(poles * dt) - 1) / (2j * poles.imag * poles)


# --- structure -------------------------------------------------------------------------------------------------------


def _poles(rng, n_samples, dt):
    """Poles by rising frequency with their traits; the band ends low in every fourth record, as if sampled too fast."""
    n_modes = int(rng.integers(1, 8))
    lowest, highest = max(0.004, 12 / n_samples), rng.choice([0.42, 0.42, 0.42, 0.09])
    evenly = rng.random()
    while True:
        crowded = log_uniform(rng, lowest, highest, n_modes)  # low modes closer to each other, as in a beam
        cycles = np.sort(crowded if evenly < 0.5 else rng.uniform(lowest, highest, n_modes))
        if np.all(cycles[1:] >= LEAST_SEPARATION * cycles[:-1]):
            break
    traits: list[list[str]] = [[] for _ in cycles]
    damping = log_uniform(rng, 0.003, 0.03) * log_uniform(rng, 0.5, 2.0, n_modes)
    for i in np.flatnonzero(rng.random(n_modes) < 0.08):
        damping[i] = rng.uniform(0.05, 0.2)
        traits[i].append("heavily damped")
    if n_modes > 1 and rng.random() < 0.35:
        i = int(rng.integers(n_modes - 1))
        cycles[i + 1] = cycles[i] * (1 + log_uniform(rng, 0.005, 0.05))
        traits[i].append("close")
        traits[i + 1].append("close")
    natural = 2 * np.pi * cycles / dt
    return natural * (-damping + 1j * np.sqrt(1 - damping**2)), traits


def _structure(rng, poles, traits, *, inputs, n_outputs, dt):
    """Shapes, participation and feedthrough; modes answer these inputs with like size, but for the weak ones."""
    n_modes, n_inputs = poles.size, inputs.shape[1]
    shapes = rng.standard_normal((n_outputs, n_modes)).astype(complex)
    if rng.random() < 0.4:
        for i in np.flatnonzero(rng.random(n_modes) < 0.6):
            shapes[:, i] *= np.exp(1j * rng.uniform(-1, 1, n_outputs))
            traits[i].append("complex")
    for i in 1 + np.flatnonzero(rng.random(n_modes - 1) < 0.12):  # the first mode is seen everywhere
        if n_outputs > 1:
            shapes[np.arange(n_outputs) != rng.integers(n_outputs), i] = 0.0
            traits[i].append("local")
    sizes = log_uniform(rng, 0.3, 1.0, n_modes)
    for i in 1 + np.flatnonzero(rng.random(n_modes - 1) < 0.2):
        sizes[i] = log_uniform(rng, 0.01, 0.15)
        traits[i].append("weak")
    derivative, words = int(rng.integers(3)), tuple(map(tuple, traits))
    forces = rng.standard_normal((n_inputs, n_modes))
    participation = forces * participation_of(poles, derivative, dt)
    rest = np.zeros((n_outputs, n_inputs))
    unsized = Structure(poles=poles, shapes=shapes, participation=participation, D=rest, dt=dt, traits=words)
    factors = sizes / np.sqrt((mode_responses(unsized, inputs) ** 2).mean(axis=(1, 2)))
    if derivative == 2:
        D = shapes.real @ (forces * factors).T
    else:  # a cross-talk of the sensors, or none
        D = rng.choice([0.0, 0.3]) * sizes.max() * rng.uniform(-1, 1, rest.shape)
    return Structure(poles=poles, shapes=shapes, participation=participation * factors, D=D, dt=dt, traits=words)


# --- data ------------------------------------------------------------------------------------------------------------


def random_excitation(rng, n_samples, n_inputs, *, kind: ExcitationKind, band: tuple[float, float]) -> np.ndarray:
    """(n_samples, n_inputs) of unit standard deviation; `band`: lowest and highest mode in cycles a sample."""
    import scipy.signal

    if kind == "white":
        values = rng.standard_normal((n_samples, n_inputs))
    elif kind == "coloured":
        memory = rng.uniform(0.5, 0.95)
        values = scipy.signal.lfilter([1.0, 0.3], [1.0, -memory], rng.standard_normal((n_samples, n_inputs)), axis=0)
    elif kind == "sweep":
        k = np.arange(n_samples)[:, np.newaxis]
        starts, ends = (
            band[0] * rng.uniform(0.2, 0.6, n_inputs),
            np.minimum(0.49, band[1] * rng.uniform(1.2, 2, n_inputs)),
        )
        ends, starts = (starts, ends) if rng.random() < 0.3 else (ends, starts)
        values = np.sin(2 * np.pi * (starts * k + (ends - starts) * k**2 / (2 * n_samples) + rng.random(n_inputs)))
    elif kind == "multisine":
        n_periods = rng.choice([1, 2, 4])
        period = n_samples // n_periods + 1
        lines = np.arange(1, int(period * min(0.5, rng.uniform(1.1, 3) * band[1])))
        spectrum = np.zeros((period // 2 + 1, n_inputs), dtype=complex)
        spectrum[lines] = np.exp(2j * np.pi * rng.random((lines.size, n_inputs)))
        values = np.tile(np.fft.irfft(spectrum, period, axis=0), (n_periods, 1))[:n_samples]
    else:
        values = np.zeros((n_samples, n_inputs))
        for j in range(n_inputs):
            length = int(rng.integers(1, 7))
            blow = np.sin(np.pi * (np.arange(length) + 1) / (length + 1))
            for start in rng.integers(1, n_samples - length, rng.integers(4, 20)):
                values[start : start + length, j] += rng.uniform(0.5, 1.5) * blow
    return values / values.std(axis=0)


def _noise(rng, structure, n_samples, kind):
    """(n_samples, n_outputs) of unit standard deviation on each channel."""
    import scipy.signal

    n_outputs = structure.shapes.shape[0]
    values = rng.standard_normal((n_samples, n_outputs))
    if kind == "coloured":
        values = scipy.signal.lfilter([1.0], [1.0, -rng.uniform(0.5, 0.95)], values, axis=0)
    elif kind == "process":
        # unmeasured forces, one a mode, over a floor of sensor noise
        forces, rms = rng.standard_normal((n_samples, structure.poles.size)), 0.0
        for pole, c, force in zip(structure.poles, structure.shapes.T, forces.T, strict=True):
            state = scipy.signal.lfilter([0.0, 1.0], [1.0, -np.exp(pole * structure.dt)], force)
            rms = rms + 2 * np.outer(state, c).real / state.std()
        values = 0.3 * values * rms.std() + rms
    return values / values.std(axis=0)


def _hum(rng, structure, n_samples, size):
    """(n_lines,) frequencies [Hz] and (n_lines, n_samples, n_outputs): one line or two, with harmonics or without."""
    distance = np.maximum(HUM_DISTANCE, 1.5 * structure.damping_ratios)
    cycles: list[float] = []
    if rng.random() < 0.4:
        for fundamental in rng.uniform(0.01, 0.45, rng.integers(1, 3)):
            cycles += [fundamental * n for n in range(1, rng.choice([2, 2, 4]))]
    modes = structure.frequencies * structure.dt
    cycles = [f for f in cycles if f < 0.48 and np.all(np.abs(f - modes) > distance * modes)]
    k = np.arange(n_samples)[:, np.newaxis]
    lines = np.zeros((len(cycles), n_samples, size.size))
    for i, f in enumerate(cycles):
        wander = rng.choice([0.0, 0.02]) * np.cumsum(
            rng.standard_normal((n_samples, 1)), axis=0
        )  # of a mains frequency
        phase = 2 * np.pi * (f * k + rng.random(size.size)) + wander
        lines[i] = log_uniform(rng, 0.01, 0.5) * rng.uniform(0.2, 1, size.size) * size * np.sin(phase)
    return np.array(cycles) / structure.dt, lines


def _free_size(structure, forced):
    """(n_modes,) state at which a mode's free motion is as large as its forced one."""
    return np.sqrt((forced**2).mean(axis=(1, 2)) / (2 * (np.abs(structure.shapes) ** 2).mean(axis=0)))


def log_uniform(rng, low, high, size=None):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))
