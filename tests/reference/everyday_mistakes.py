"""Records of everyday mistakes: a wrong mass, a zero that moves, a lag, friction that falls with speed.

Linear parts are exact (`scipy.signal.cont2discrete`), friction is marched by hand in small steps; nothing of okid, era
or modal is imported. A case is plain numbers: what the user believes, and records that know better.
"""

from dataclasses import dataclass

import numpy as np
import scipy.signal

N_SAMPLES = 1200
LEVELS = (1.0, 3.0, 2.0)
"""Two records to fit, one held out."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Mistake:
    """A chain as the user has it, records (inputs, outputs) of it, the last one held out, and what is wrong.

    `effect`: its key in the catalogue, "" where none is missing; `where`: a place, or the mass that is wrong.
    """

    masses: np.ndarray
    stiffnesses: np.ndarray
    dampings: np.ndarray
    force_dof: int
    sensor_dofs: tuple[int, ...]
    sensor_kind: str
    dt: float
    records: tuple[tuple[np.ndarray, np.ndarray], ...]
    effect: str
    where: str
    size: float
    noise_variance: np.ndarray


def drives(rng, n_records, lowest=0.005, highest=0.12):
    """(n_records, N_SAMPLES) of normal noise between two frequencies in cycles a sample."""
    spectrum = np.fft.rfft(rng.standard_normal((n_records, 2 * N_SAMPLES)))
    line = np.arange(N_SAMPLES + 1) / (2 * N_SAMPLES)
    spectrum[:, (line < lowest) | (line > highest)] = 0.0
    wave = np.fft.irfft(spectrum, 2 * N_SAMPLES)[:, N_SAMPLES // 2 : N_SAMPLES // 2 + N_SAMPLES]
    return wave / wave.std(axis=1, keepdims=True) * np.array(LEVELS)[:n_records, np.newaxis]


def continuous(masses, stiffnesses, dampings, *, force_dof, sensor_dofs, kind):
    """A, B, C, D of a chain; element e joins mass e - 1 and e, element 0 the ground."""
    n = len(masses)
    join = np.eye(n) - np.eye(n, k=-1)
    inverse = np.diag(1.0 / np.asarray(masses))
    K, D = join.T @ np.diag(stiffnesses) @ join, join.T @ np.diag(dampings) @ join
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ D]])
    B = np.concatenate([np.zeros((n, 1)), inverse[:, [force_dof]]])
    first = 0 if kind == "displacement" else n
    rows = [first + dof for dof in sensor_dofs]
    if kind == "acceleration":
        return A, B, A[rows], B[rows]
    return A, B, np.eye(2 * n)[rows], np.zeros((len(rows), 1))


def held_run(system, inputs, dt):
    """(n_records, n_samples, n_outputs) from rest, the input held between samples."""
    A, B, C, D, _ = scipy.signal.cont2discrete(system, dt)
    return np.array([scipy.signal.dlsim((A, B, C, D, dt), u[:, np.newaxis])[1] for u in inputs])


def behind_a_lag(system, tau):
    """The system with its input through 1 / (tau s + 1)."""
    A, B, C, D = system
    return (
        np.block([[A, B], [np.zeros((1, len(A))), np.full((1, 1), -1.0 / tau)]]),
        np.concatenate([np.zeros_like(B), [[1.0 / tau]]]),
        np.hstack([C, D]),
        np.zeros_like(D),
    )


N_STEPS = 20


def rubbed(system, mass, inputs, dt, friction):
    """(n_records, n_samples, 1) displacement of one mass under friction(|v|), which holds it where it can.

    The classical Runge-Kutta rule while it slides. A step in which the mass comes to rest ends there (the moment by a
    line through both speeds), and the rest of the step goes on from rest: held, or the other way.
    """
    _, (stiffness, damping) = -mass * system[0]
    x, v = np.zeros(len(inputs)), np.zeros(len(inputs))
    found = np.empty((*inputs.shape, 1))
    for k in range(inputs.shape[1]):
        found[:, k, 0] = x
        for _ in range(N_STEPS):
            left = np.full(len(inputs), dt / N_STEPS)
            for _ in range(2):
                x, v, left = _slid(x, v, left, inputs[:, k], mass=mass, stiffness=stiffness, damping=damping,
                                   friction=friction)  # fmt: skip
    return found


def _slid(x, v, h, u, *, mass, stiffness, damping, friction):
    """Displacement, speed and what is left of the time h, up to the next stop."""
    pull = u - stiffness * x
    way = np.where(v != 0.0, np.sign(v), np.sign(pull))

    def rate(x, v):
        return (u - stiffness * x - damping * v - way * friction(np.abs(v))) / mass

    def run(h):
        a1 = rate(x, v)
        a2 = rate(x + 0.5 * h * v, v + 0.5 * h * a1)
        a3 = rate(x + 0.5 * h * v + 0.25 * h**2 * a1, v + 0.5 * h * a2)
        a4 = rate(x + h * v + 0.5 * h**2 * a2, v + h * a3)
        return x + h * v + h**2 / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    further, faster = run(h)
    held = (v == 0.0) & (np.abs(pull) <= friction(np.zeros_like(v)))
    turned = ~held & (faster * way < 0.0)
    until = h * np.where(turned, np.abs(v) / np.maximum(np.abs(v) + np.abs(faster), 1e-300), 1.0)
    stop, _ = run(until)
    after = np.where(held, x, np.where(turned, stop, further))
    return after, np.where(held | turned, 0.0, faster), np.where(turned, h - until, 0.0)


def structure(rng, n_dofs):
    """Masses, stiffnesses, dampings and the time step of a chain with about 2 % damping."""
    masses, shape = rng.uniform(0.7, 1.5, n_dofs), rng.uniform(0.7, 1.5, n_dofs)
    first = 2 * np.pi * rng.uniform(2.0, 8.0)
    stiffnesses = shape * first**2 * masses.mean() * n_dofs
    A = continuous(masses, stiffnesses, 0 * shape, force_dof=0, sensor_dofs=(0,), kind="displacement")[0]
    omega = np.sort(np.abs(np.linalg.eigvals(A)))
    return (
        masses,
        stiffnesses,
        stiffnesses * 0.04 / omega[0] * rng.uniform(0.5, 1.0, n_dofs),
        2 * np.pi / omega[-1] / 14,
    )


def _case(rng, *, n_dofs, sensors, kind="displacement", effect, where, size, change, noise=0.01):
    masses, stiffnesses, dampings, dt = structure(rng, n_dofs)
    force_dof = int(rng.integers(n_dofs))
    plant = {"masses": masses, "force_dof": force_dof, "sensor_dofs": sensors, "dt": dt}
    system = continuous(masses, stiffnesses, dampings, force_dof=force_dof, sensor_dofs=sensors, kind=kind)
    inputs = drives(rng, len(LEVELS))
    clean, believed = change(rng, system, plant, inputs)
    inputs = inputs[:, : clean.shape[1]]
    variance = (noise * clean.std(axis=1)) ** 2
    noisy = clean + np.sqrt(variance)[:, np.newaxis] * rng.standard_normal(clean.shape)
    return Mistake(
        masses=believed, stiffnesses=stiffnesses * rng.uniform(0.97, 1.03, n_dofs),
        dampings=dampings * rng.uniform(0.8, 1.2, n_dofs), force_dof=force_dof, sensor_dofs=sensors, sensor_kind=kind,
        dt=dt, records=tuple((u[:, np.newaxis], y) for u, y in zip(inputs, noisy, strict=True)), effect=effect,
        where=where, size=size, noise_variance=variance,
    )  # fmt: skip


def wrong_mass(seed, shares=(0.05, 0.2)):
    """One of two or three masses is 5 to 20 % off, or by other shares of what is believed."""
    rng = np.random.default_rng([1, seed])
    n = 2 + seed % 2
    dof, share = int(rng.integers(n)), float(rng.uniform(*shares) * rng.choice([-1, 1]))

    def change(rng, system, plant, inputs):
        believed = plant["masses"].copy()
        believed[dof] /= 1 + share
        return held_run(system, inputs, plant["dt"]), believed

    kind = ("displacement", "acceleration")[seed // 2 % 2]
    return _case(rng, n_dofs=n, sensors=tuple(range(n)), kind=kind, effect="", where=f"dof_{dof}", size=share,
                 change=change)  # fmt: skip


def record_offset(seed):
    """The zero of the displacement sensor moves from record to record, by a part of the motion."""
    rng = np.random.default_rng([2, seed])
    size = float(rng.uniform(0.2, 1.0))

    def change(rng, system, plant, inputs):
        clean = held_run(system, inputs, plant["dt"])
        return clean + size * clean.std() * rng.standard_normal((len(clean), 1, 1)), plant["masses"]

    n = 1 + seed % 2
    return _case(rng, n_dofs=n, sensors=(n - 1,), effect="record_offset", where="output_0", size=size, change=change)


def actuator_lag(seed):
    """The force follows its command late: 1 / (tau s + 1)."""
    rng = np.random.default_rng([3, seed])
    tau = float(rng.uniform(1.0, 4.0))

    def change(rng, system, plant, inputs):
        return held_run(behind_a_lag(system, tau * plant["dt"]), inputs, plant["dt"]), plant["masses"]

    n = 1 + seed % 2
    return _case(
        rng, n_dofs=n, sensors=tuple(range(n)), effect="actuator_lag", where="input_0", size=tau, change=change
    )


def sensor_lag(seed):
    """One of two sensors follows the motion late."""
    rng = np.random.default_rng([4, seed])
    tau = float(rng.uniform(1.0, 4.0))

    def change(rng, system, plant, inputs):
        A, B, C, D = system
        late = held_run(behind_a_lag(system, tau * plant["dt"]), inputs, plant["dt"])
        clean = held_run((A, B, C, D), inputs, plant["dt"])
        return np.concatenate([clean[..., :-1], late[..., -1:]], axis=-1), plant["masses"]

    n = 2
    return _case(rng, n_dofs=n, sensors=(0, 1), effect="sensor_lag", where="output_1", size=tau, change=change)


def stribeck_friction(seed, n_samples=N_SAMPLES):
    """Friction that falls from the breakaway force as the mass speeds up, over the first samples of each drive."""
    rng = np.random.default_rng([5, seed])
    high, low = float(rng.uniform(0.5, 0.8)), float(rng.uniform(0.2, 0.35))

    def change(rng, system, plant, inputs):
        linear = held_run(system, inputs, plant["dt"])
        speed = 0.3 * np.gradient(linear[1, :, 0], plant["dt"]).std()

        def friction(v):
            return low + (high - low) * np.exp(-((v / speed) ** 2))

        return rubbed(system, plant["masses"][0], inputs[:, :n_samples], plant["dt"], friction), plant["masses"]

    return _case(rng, n_dofs=1, sensors=(0,), effect="stribeck_friction", where="element_0", size=high, change=change)


MISTAKES = {one.__name__: one for one in (wrong_mass, record_offset, actuator_lag, sensor_lag, stribeck_friction)}


def mistake(kind, seed, **options):
    """The case of a kind and a seed."""
    return MISTAKES[kind](seed, **options)
