"""Records outside the world of driven, rich, linear, healthy data, each with its truth; imports no okid, era or modal.

    from hard_records import FAMILIES
    record = FAMILIES["tones"](7)

A record is a structure of known modes (`structures.Structure`, answered exactly by `structures.mode_responses`) with
one thing that a laboratory or a site does to it: a shaker that plays tones, noise as large as the motion, a machine at
constant speed, a multiplexed logger, spikes, a converter of few bits, dry friction, a load that drives onto a bridge.
All follows from the seed; arrays are time-major.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.signal
from structures import Structure, mode_responses, participation_of


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HardRecord:
    """Inputs (n_samples, n_inputs), outputs (n_samples, n_outputs), and what is true of them.

    `frequencies` [Hz] and `damping_ratios` of the modes that stand in the record, `lines` [Hz] of the sinusoids in it.
    """

    inputs: np.ndarray
    outputs: np.ndarray
    dt: float
    frequencies: np.ndarray
    damping_ratios: np.ndarray
    lines: np.ndarray


def tones(seed: int, *, n_samples: int = 6000) -> HardRecord:
    """A shaker plays two to six tones; the load cell adds 0.1 to 1 % of its own, the accelerometers 0.3 to 3 %."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=int(rng.integers(2, 5)), n_inputs=1, n_outputs=int(rng.integers(1, 4)))
    lines = np.sort(rng.uniform(0.02, 0.4, int(rng.integers(2, 7)))) / made.dt
    time = made.dt * np.arange(n_samples)[:, np.newaxis]
    waves = rng.uniform(0.3, 1.0, lines.size) * np.sin(2 * np.pi * (lines * time + rng.random(lines.size)))
    force = waves.sum(axis=1, keepdims=True)
    return _record(rng, made, force, sensor=_log(rng, 0.003, 0.03), cell=_log(rng, 0.001, 0.01), lines=lines)


def stepped_sine(seed: int, *, n_samples: int = 6000) -> HardRecord:
    """Four to eight frequencies one after the other, each for its share of the record."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=int(rng.integers(2, 5)), n_inputs=1, n_outputs=int(rng.integers(1, 4)))
    lines = np.sort(rng.uniform(0.02, 0.4, int(rng.integers(4, 9)))) / made.dt
    step = np.arange(n_samples) * lines.size // n_samples
    force = np.sin(2 * np.pi * made.dt * np.cumsum(lines[step]))[:, np.newaxis]
    return _record(rng, made, force, sensor=_log(rng, 0.003, 0.03), cell=_log(rng, 0.001, 0.01), lines=lines)


def distorted_tones(seed: int, *, n_samples: int = 6000) -> HardRecord:
    """Three tones, of which the amplifier makes squares and cubes and the structure's joints make more of them."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=int(rng.integers(2, 5)), n_inputs=1, n_outputs=int(rng.integers(1, 4)))
    tones = np.sort(rng.choice(np.arange(5, 26), 3, replace=False)) * rng.uniform(0.008, 0.01) / made.dt
    time = made.dt * np.arange(n_samples)[:, np.newaxis]
    waves = (rng.uniform(0.3, 1.0, 3) * np.sin(2 * np.pi * (tones * time + rng.random(3)))).sum(axis=1, keepdims=True)
    force = waves + _log(rng, 1e-4, 1e-2) * waves**2 + _log(rng, 1e-4, 1e-2) * waves**3
    record = _record(rng, made, force, sensor=_log(rng, 0.001, 0.01), cell=_log(rng, 0.001, 0.01), lines=tones)
    size = record.outputs.std(axis=0)
    bent = record.outputs + _log(rng, 1e-3, 3e-2) * size * ((record.outputs / size) ** 2 + (record.outputs / size) ** 3)
    return replace(record, outputs=bent)


def tones_in_noise(seed: int, *, n_samples: int = 6000) -> HardRecord:
    """Three tones in a broad band of a tenth to a third of their size, which drives the modes."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=int(rng.integers(2, 5)), n_inputs=1, n_outputs=int(rng.integers(1, 4)))
    lines = np.sort(rng.uniform(0.02, 0.4, 3)) / made.dt
    time = made.dt * np.arange(n_samples)[:, np.newaxis]
    waves = (rng.uniform(0.3, 1.0, 3) * np.sin(2 * np.pi * (lines * time + rng.random(3)))).sum(axis=1, keepdims=True)
    force = waves + _log(rng, 0.1, 0.3) * waves.std() * rng.standard_normal(waves.shape)
    return _record(rng, made, force, sensor=_log(rng, 0.003, 0.03), cell=1e-3, lines=lines)


def low_fit(seed: int, *, n_samples: int = 6000) -> HardRecord:
    """White forces, sensor noise 0.7 (even seeds) or 1.5 times the motion."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=2, n_inputs=1, n_outputs=3, damping=(0.005, 0.015))
    return _record(rng, made, rng.standard_normal((n_samples, 1)), sensor=1.5 if seed % 2 else 0.7)


def light_damping(seed: int, *, n_samples: int = 6000) -> HardRecord:
    """Driven by white forces, damping ratios of about 1e-4: hardly any decay within the record."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=3, n_inputs=1, n_outputs=3, damping=(0.8e-4, 1.5e-4))
    return _record(rng, made, rng.standard_normal((n_samples, 1)), sensor=_log(rng, 0.01, 0.1))


def driven(seed: int, *, n_samples: int = 4000) -> HardRecord:
    """Nothing wrong: one or two white forces, 1 to 5 % noise."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=3, n_inputs=int(rng.integers(1, 3)), n_outputs=4)
    force = rng.standard_normal((n_samples, made.participation.shape[0]))
    return _record(rng, made, force, sensor=_log(rng, 0.01, 0.05))


def ambient(seed: int, *, n_samples: int = 20_000) -> HardRecord:
    """Wind on all modes, no input measured."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=5, n_inputs=5, n_outputs=4, damping=(0.004, 0.015))
    return _unmeasured(_record(rng, made, rng.standard_normal((n_samples, 5)), sensor=0.03))


def noiseless(seed: int, *, n_samples: int = 5000) -> HardRecord:
    """One or two hidden forces behind a steep low-pass move four to eight sensors that have no noise at all."""
    rng = np.random.default_rng([seed, 2])
    n_inputs, order = int(rng.integers(1, 3)), int(rng.integers(6, 13))
    made = _structure(
        rng, n_modes=int(rng.integers(2, 6)), n_inputs=n_inputs, n_outputs=int(rng.integers(4, 9)), highest=0.25
    )
    filtered = scipy.signal.butter(order, rng.uniform(0.3, 0.8), output="sos")
    force = scipy.signal.sosfilt(filtered, rng.standard_normal((n_samples + 3000, n_inputs)), axis=0)
    whole = _unmeasured(_record(rng, made, force, sensor=0.0))
    return replace(whole, inputs=whole.inputs[3000:], outputs=whole.outputs[3000:])


def machine_lines(seed: int) -> HardRecord:
    """Ambient motion with a machine: a line with two multiples, or two lines, 0.3 to 2 times the motion."""
    rng = np.random.default_rng([seed, 1])
    clean = ambient(seed)
    modes = clean.frequencies * clean.dt
    while True:
        first = rng.uniform(0.03, 0.13 if seed % 2 else 0.4)
        lines = first * np.arange(1, 4) if seed % 2 else np.array([first, rng.uniform(0.03, 0.4)])
        apart = np.abs(np.subtract.outer(lines, modes)) > 0.04 * modes
        if apart.all() and (lines.size == 3 or abs(lines[1] - lines[0]) > 0.03):
            break
    time = np.arange(len(clean.outputs))[:, np.newaxis]
    outputs = clean.outputs.copy()
    size = clean.outputs.std(axis=0)
    for line in lines:
        place = rng.uniform(0.4, 1.0, size.size) * rng.choice([-1.0, 1.0], size.size)
        outputs += np.sqrt(2) * _log(rng, 0.3, 2.0) * size * place * np.sin(2 * np.pi * (line * time + rng.random()))
    return replace(clean, outputs=outputs, lines=lines / clean.dt)


def coloured_noise(seed: int, *, n_samples: int = 12_000) -> HardRecord:
    """Noise of a smooth colour on one to four channels: no mode at all."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((n_samples, int(rng.integers(1, 5))))
    poles = rng.uniform(-0.5, 0.95, int(rng.integers(0, 4)))
    zeros = rng.uniform(-0.8, 0.8, int(rng.integers(0, 3)))
    outputs = scipy.signal.lfilter(np.poly(zeros), np.poly(poles), values, axis=0)
    nothing = np.empty(0)
    return HardRecord(
        inputs=np.empty((n_samples, 0)), outputs=outputs, dt=0.01, frequencies=nothing, damping_ratios=nothing,
        lines=nothing,
    )  # fmt: skip


def spikes(seed: int) -> HardRecord:
    """0.3 % of the samples of each output are 20 standard deviations off."""
    rng, clean = np.random.default_rng([seed, 2]), driven(seed)
    hit = rng.random(clean.outputs.shape) < 0.003
    jump = 20.0 * clean.outputs.std(axis=0) * rng.choice([-1.0, 1.0], clean.outputs.shape)
    return replace(clean, outputs=clean.outputs + hit * jump)


def clipped(seed: int) -> HardRecord:
    """The first output stands at its limit of 1.5 standard deviations."""
    clean = driven(seed)
    limit = 1.5 * clean.outputs[:, 0].std()
    outputs = clean.outputs.copy()
    outputs[:, 0] = np.clip(outputs[:, 0], -limit, limit)
    return replace(clean, outputs=outputs)


def coarse(seed: int) -> HardRecord:
    """All outputs rounded to half a standard deviation."""
    clean = driven(seed)
    step = 0.5 * clean.outputs.std(axis=0)
    return replace(clean, outputs=step * np.round(clean.outputs / step))


def dead_channel(seed: int) -> HardRecord:
    """The second of four outputs is not connected."""
    clean = driven(seed)
    outputs = clean.outputs.copy()
    outputs[:, 1] = 0.25
    return replace(clean, outputs=outputs)


def skewed(seed: int, *, oversampled: int = 20) -> HardRecord:
    """A multiplexed logger: output j is taken j / n_outputs of a step late, by interpolation of a finer record."""
    rng = np.random.default_rng(seed)
    made = _structure(rng, n_modes=3, n_inputs=1, n_outputs=4, highest=0.25)
    fine = replace(
        made,
        dt=made.dt / oversampled,
        participation=made.participation
        * participation_of(made.poles, 0, made.dt / oversampled)
        / participation_of(made.poles, 0, made.dt),
    )
    force = rng.standard_normal((4000, 1))
    held = np.repeat(force, oversampled, axis=0)
    motion = mode_responses(fine, held).sum(axis=0)
    late = np.arange(4) * oversampled // 4
    rows = np.arange(3999)[:, np.newaxis] * oversampled + late
    outputs = motion[rows, np.arange(4)]
    noise = _log(rng, 0.01, 0.05) * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    return HardRecord(
        inputs=force[:3999], outputs=outputs + noise, dt=made.dt, frequencies=made.frequencies,
        damping_ratios=made.damping_ratios, lines=np.empty(0),
    )  # fmt: skip


def dry_friction(seed: int, *, n_samples: int = 6000, share: float = 0.15) -> HardRecord:
    """One DOF with Coulomb friction of a share of the force's standard deviation; the drive's level varies slowly."""
    rng = np.random.default_rng(seed)
    level = 1.0 + 0.6 * np.sin(2 * np.pi * 1.5 * np.arange(n_samples) / n_samples)
    force = level * rng.standard_normal(n_samples)
    return _one_degree(rng, force, stiffness=np.ones(n_samples), friction=share)


def drifting_stiffness(seed: int, *, n_samples: int = 6000, change: float = 0.06) -> HardRecord:
    """One DOF whose stiffness changes steadily by this share over the record."""
    rng = np.random.default_rng(seed)
    stiffness = 1.0 + change * (np.arange(n_samples) / n_samples - 0.5)
    return _one_degree(rng, rng.standard_normal(n_samples), stiffness=stiffness, friction=0.0)


def hidden_earthquake(seed: int) -> HardRecord:
    """A strong burst of a few seconds drives the structure, and is not in the file."""
    rng = np.random.default_rng(seed)
    n_samples = 10_000
    made = _structure(rng, n_modes=3, n_inputs=1, n_outputs=3, damping=(0.005, 0.02))
    time = np.arange(n_samples) / n_samples
    envelope = np.exp(-(((time - 0.25) / 0.08) ** 2)) + 0.02
    ground = scipy.signal.lfilter([1.0], [1.0, -1.2, 0.6], rng.standard_normal(n_samples)) * envelope
    return _unmeasured(_record(rng, made, ground[:, np.newaxis], sensor=0.01))


FAMILIES = {
    one.__name__: one
    for one in (
        tones, distorted_tones, tones_in_noise, stepped_sine, low_fit, light_damping, driven, ambient,
        noiseless, machine_lines, coloured_noise, spikes, clipped, coarse, dead_channel, skewed, dry_friction,
        drifting_stiffness, hidden_earthquake,
    )
}  # fmt: skip


def _log(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _structure(rng, *, n_modes, n_inputs, n_outputs, damping=(0.004, 0.02), highest=0.38):
    """Modes at least a tenth of their frequency apart, of displacement, that white forces move alike."""
    dt = 0.01
    while True:
        cycles = np.sort(rng.uniform(0.02, highest, n_modes))
        if np.all(np.diff(cycles) > 0.1 * cycles[:-1]):
            break
    ratios = np.exp(rng.uniform(*np.log(damping), n_modes))
    poles = 2 * np.pi * cycles / dt * (-ratios + 1j * np.sqrt(1 - ratios**2))
    shapes = (rng.uniform(0.4, 1.0, (n_outputs, n_modes)) * rng.choice([-1.0, 1.0], (n_outputs, n_modes))).astype(
        complex
    )
    gains = rng.uniform(0.5, 1.0, (n_inputs, n_modes)) * rng.choice([-1.0, 1.0], (n_inputs, n_modes))
    part = gains * participation_of(poles, 0, dt)
    part = part * np.sqrt(-poles.real) / np.abs(part).max(axis=0)
    return Structure(
        poles=poles, shapes=shapes, participation=part, D=np.zeros((n_outputs, n_inputs)), dt=dt,
        traits=((),) * n_modes,
    )  # fmt: skip


def _record(rng, made, force, *, sensor, cell=0.0, lines=()):
    """The structure's answer with noise of so large a share on the sensors and on the load cell."""
    motion = mode_responses(made, force).sum(axis=0)
    return HardRecord(
        inputs=force + cell * force.std(axis=0) * rng.standard_normal(force.shape),
        outputs=motion + sensor * motion.std(axis=0) * rng.standard_normal(motion.shape),
        dt=made.dt,
        frequencies=made.frequencies,
        damping_ratios=made.damping_ratios,
        lines=np.asarray(lines, dtype=float),
    )


def _unmeasured(record):
    return replace(record, inputs=record.inputs[:, :0])


def _one_degree(rng, force, *, stiffness, friction, steps=20):
    """m x'' + c x' + k(t) x + F sign(x') = f, held between samples; semi-implicit Euler on a fine grid.

    The friction stops the body within a step rather than turning it round.
    """
    dt, frequency, ratio = 0.01, 8.0, 0.01
    natural = 2 * np.pi * frequency
    h = dt / steps
    dry = friction * force.std()
    position = velocity = 0.0
    outputs = np.empty((force.size, 1))
    for k, f in enumerate(force):
        outputs[k] = position
        for _ in range(steps):
            push = f - natural**2 * stiffness[k] * position - 2 * ratio * natural * velocity
            moved = velocity + h * push
            velocity = np.sign(moved) * max(0.0, abs(moved) - h * dry)
            position += h * velocity
    outputs += 0.01 * outputs.std() * rng.standard_normal(outputs.shape)
    return HardRecord(
        inputs=force[:, np.newaxis], outputs=outputs, dt=dt, frequencies=np.array([frequency]),
        damping_ratios=np.array([ratio]), lines=np.empty(0),
    )  # fmt: skip
