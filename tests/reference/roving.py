"""Set-ups of a chain whose modes are known in closed form: roving sensors, a roving hammer, unknown forces.

Every mode runs by its own recursion, exact for a force that is held over each sample; nothing of the product is used
but `okid.Record` to hold the numbers. Each set-up has its own delay, level and amplifier.
"""

import numpy as np
import scipy

import okid

DT = 0.01
MASSES = np.array([2.0, 1.0, 1.5, 1.0])
STIFFNESSES = np.array([8000.0, 6000.0, 5000.0, 7000.0]) / 4.0
DAMPING = 0.012


def _modes():
    matrix = np.diag(STIFFNESSES + np.append(STIFFNESSES[1:], 0.0))
    matrix -= np.diag(STIFFNESSES[1:], 1) + np.diag(STIFFNESSES[1:], -1)
    squares, shapes = scipy.linalg.eigh(matrix, np.diag(MASSES))
    return np.sqrt(squares), shapes


ANGULAR, SHAPES = _modes()
"""(n_modes,) [rad/s] and (n_points, n_modes) for unit modal mass."""
FREQUENCIES = ANGULAR / (2 * np.pi)


def motion(force, point, sensors):
    """Displacements to a force at one point, held over each sample."""
    outputs = np.zeros((force.size, len(sensors)))
    for size, shape in zip(ANGULAR, SHAPES.T, strict=True):
        pole = size * complex(-DAMPING, np.sqrt(1.0 - DAMPING**2))
        discrete = np.exp(pole * DT)
        drive = (discrete - 1.0) / pole / pole.imag
        state = scipy.signal.lfilter([0, drive], [1, -discrete], force.astype(complex))
        outputs += np.outer(state.imag * shape[point], shape[list(sensors)])
    return outputs


def later(outputs, delay):
    return np.vstack([np.zeros((delay, outputs.shape[1])), outputs[: len(outputs) - delay]])


def _record(force, outputs, names, sensors, name):
    return okid.Record(
        force,
        outputs,
        DT,
        input_names=names,
        input_units=["N"] * len(names),
        output_names=[f"y{k}" for k in sensors],
        output_units=["m"] * len(sensors),
        name=name,
    )


def hammer_blows(delays, *, sensors, n=600, noise=1e-3):
    """A record for each point that is struck, each started by a trigger of its own."""
    records = []
    for point, delay in enumerate(delays):
        rng = np.random.default_rng(point)
        force = np.zeros(n)
        force[20:23] = 50.0, 100.0, 50.0
        clean = later(motion(force, point, sensors), delay)
        outputs = clean + noise * np.abs(clean).max() * rng.standard_normal(clean.shape)
        records.append(_record(force, outputs, [f"hammer {point}"], sensors, f"point {point}"))
    return records


def unknown_forces(seed, sensors, *, level=1.0, n=3000, noise=0.01):
    """White forces at all points, which nobody measured; velocities, so that no mode outweighs the others."""
    rng = np.random.default_rng(seed)
    forces = level * rng.standard_normal((len(MASSES), n + 1))
    clean = np.diff(sum(motion(force, point, sensors) for point, force in enumerate(forces)), axis=0) / DT
    outputs = clean + noise * clean.std(axis=0) * rng.standard_normal(clean.shape)
    return _record([], outputs, [], sensors, f"ambient {seed}")
