"""A second world for the diagnosis: what no entry of the catalogue describes, with an integrator of its own.

`outside_case(kind, seed)` gives arrays only: the masses, stiffnesses and dampings that the user believes in
(stiffnesses off by up to 5 %, dampings by up to 30 %), records with white noise of 1 %, and the truth. The classical
Runge-Kutta rule runs all records side by side; inputs are broadband and held between samples.

`effects`: names that count as right where the truth has one in the catalogue (one-way friction, offsets, lags), empty
where it has none; any one of them, or all where `needs_all`. `place`: where it is, empty where no element holds it.
`law`: the hidden force of the motion named by `motion`, None where it is no such force.
Nothing here imports okid, era or modal.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

N_STEPS = 8
SHARP_STEPS = 24
LEVELS = (1.0, 6.0, 2.5)
"""Of the records; the last one is held out."""
SHARE = (0.1, 0.4)
"""A hidden force is this share of the elastic or damping force at the loud level, root mean square."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OutsideRecord:
    """inputs (n_samples, n_inputs), outputs (n_samples, n_outputs), true motion at the place (n_samples,) each."""

    inputs: np.ndarray
    outputs: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray
    dt: float
    name: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OutsideCase:
    """What the user has, and the truth. `stiffness`, `damping`: true ones of element 0."""

    kind: str
    seed: int
    masses: np.ndarray
    true_masses: np.ndarray
    stiffnesses: np.ndarray
    dampings: np.ndarray
    sensor_kind: str
    rotary: bool
    fit: tuple[OutsideRecord, ...]
    held_out: tuple[OutsideRecord, ...]
    effects: tuple[str, ...]
    needs_all: bool
    place: str
    law: Callable[[np.ndarray], np.ndarray] | None
    motion: str
    stiffness: float
    damping: float


def _excess(function, x):
    """A law less its own tangent at rest."""
    step = 1e-5
    return function(x) - function(0.0) - x * (function(step) - function(-step)) / (2 * step)


STIFFNESS = {
    "sinh": lambda x: _excess(lambda s: np.sinh(2.0 * s), x),
    "quintic": lambda x: x**5,
    "hertz": lambda x: np.maximum(x, 0.0) ** 1.5,
    "tanh_spring": lambda x: _excess(np.tanh, 1.5 * x),
    "exponential_spring": lambda x: _excess(lambda s: np.exp(1.2 * s), x),
    "power_spring": lambda x: np.abs(x) ** 1.5 * np.sign(x),
}
"""Of the displacement over its largest at the loud level."""
DAMPING = {
    "power_damping": lambda x: np.abs(x) ** 1.5 * np.sign(x),
    "cubic_damping": lambda x: x**3,
    "quintic_damping": lambda x: x**5,
    "sinh_damping": lambda x: _excess(lambda s: np.sinh(2.0 * s), x),
}
"""Of the velocity over its largest at the loud level."""
SHARP = {
    "stribeck": lambda x: np.tanh(x / 0.004) * (0.5 + 0.5 * np.exp(-((x / 0.1) ** 2))),
    "one_sided_friction": lambda x: 0.5 + 0.5 * np.tanh(x / 0.004),
    "even_drag": lambda x: x**2,
}
OTHER = (
    "van_der_pol", "parametric_stiffness", "maxwell", "lugre", "two_hidden_masses", "actuator_lag", "sensor_lag",
    "cross_talk", "record_offsets", "wrong_mass", "second_input", "base_motion", "one_way_friction", "quantised",
    "faint_quintic", "pendulum", "clipped", "late_sensor", "coloured_noise", "wrong_chain_mass",
)  # fmt: skip
KINDS = (*STIFFNESS, *DAMPING, *SHARP, *OTHER)
"""New ones stand at the end: the seed counts from the place."""
RIGHT = {
    "stribeck": ("stribeck_friction",),
    "one_sided_friction": ("coulomb_friction", "constant_force"),
    "actuator_lag": ("actuator_lag",),
    "sensor_lag": ("sensor_lag", "actuator_lag"),
    "record_offsets": ("record_offset",),
    "wrong_mass": (),
    "one_way_friction": ("coulomb_friction", "constant_force"),
    "pendulum": ("sine_softening",),
}
ALONE = ("input_gain", "sensor_gain")
"""Another mass of one degree of freedom, stiffness and damping free, is a gain."""
NEEDS_ALL = ("one_sided_friction",)
"""Half of it pushes back either way, and half stays."""
NOT_OF_AN_ELEMENT = (
    "actuator_lag", "sensor_lag", "cross_talk", "record_offsets", "wrong_mass", "wrong_chain_mass", "second_input",
    "base_motion", "quantised", "clipped", "late_sensor", "coloured_noise",
)  # fmt: skip


def _noise(rng, n_samples, highest):
    """Broadband: normal noise through a low pass of second order, so that no part of the band is left empty."""
    white = rng.standard_normal(n_samples + 400)
    pole, wave = np.exp(-2 * np.pi * highest), white
    for _ in range(2):
        out = np.empty_like(wave)
        last = 0.0
        for k, value in enumerate(wave):
            last = pole * last + (1 - pole) * value
            out[k] = last
        wave = out
    wave = wave[400:]
    return wave / wave.std()


def _run(slope, inputs, start, dt, n_steps=N_STEPS):
    """(n_records, n_samples, n_states) by the classical Runge-Kutta rule; inputs (n_records, n_samples, n_inputs)."""
    h = dt / n_steps
    x = np.array(start, dtype=float)
    found = np.empty((*inputs.shape[:2], x.shape[1]))
    for k in range(inputs.shape[1]):
        found[:, k] = x
        u = inputs[:, k]
        for i in range(n_steps):
            t = k * dt + i * h
            a = slope(x, u, t)
            b = slope(x + 0.5 * h * a, u, t + 0.5 * h)
            c = slope(x + 0.5 * h * b, u, t + 0.5 * h)
            x = x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c, u, t + h))
    return found


def _chain(values):
    n = len(values)
    matrix = np.zeros((n, n))
    for e, value in enumerate(values):
        matrix[e, e] += value
        if e:
            matrix[e - 1, e - 1] += value
            matrix[e - 1, e] -= value
            matrix[e, e - 1] -= value
    return matrix


@functools.cache
def outside_case(kind, seed):  # noqa: PLR0912 - one branch a kind
    """The case of a kind and a seed."""
    rng = np.random.default_rng([KINDS.index(kind), seed, 77])
    if kind == "one_way_friction":
        return _motor(rng, kind, seed)
    n = 2 if kind in ("wrong_mass", "cross_talk", "second_input", "base_motion", "late_sensor") else 1
    if kind == "wrong_chain_mass":
        n = (1, 3, 4)[rng.integers(3)]
    frequency = rng.uniform(2.0, 8.0)
    masses = rng.uniform(1.0, 4.0, n)
    stiffnesses = masses * (2 * np.pi * frequency) ** 2 * rng.uniform(1.0, 1.6, n)
    dampings = 2 * rng.uniform(0.01, 0.04, n) * np.sqrt(stiffnesses * masses)
    dt, n_samples = 1.0 / (25 * frequency), int(rng.integers(600, 1000))
    C, K = _chain(dampings), _chain(stiffnesses)
    size = 0.3 * stiffnesses[0] * 0.01
    waves = np.array([_noise(rng, n_samples, 0.1) for _ in LEVELS])
    drive = size * np.array(LEVELS)[:, None, None] * waves[:, :, None]
    extra = size * np.array([_noise(rng, n_samples, 0.1) for _ in LEVELS])
    true_masses = masses.copy()
    if kind in ("wrong_mass", "wrong_chain_mass"):
        true_masses[rng.integers(n)] *= 1 + rng.choice([-1, 1]) * rng.uniform(0.05, 0.2)
    inverse = 1.0 / true_masses

    def world(law, n_more=0, more=None, push=None):
        def slope(x, u, t):
            d, v, z = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
            force = -d @ K - v @ C
            force[:, 0] += u[:, 0] - law(d[:, 0], v[:, 0], z, t)
            if push is not None:
                force += push(u)
            return np.hstack([v, force * inverse, *([more(d, v, z, u)] if n_more else [])])

        return slope

    def none(d, v, z, t):
        return 0.0

    rest = np.zeros((len(LEVELS), 2 * n))
    linear = _run(world(none), drive, rest, dt, 3)
    loud = int(np.argmax(LEVELS))
    if kind == "pendulum":  # wide enough for a sine, and hardly wide enough to tell it from a cubic law
        reach = rng.uniform(0.5, 0.7) / np.abs(linear[loud, :, 0]).max()
        drive, linear = reach * drive, reach * linear
    d_size, v_size = (3.0 * linear[loud, :, j].std() for j in (0, n))
    share = rng.uniform(*SHARE)
    law, motion, n_more, more, push = none, "", 0, None, None
    hidden = None
    inputs = drive
    form = kind.removeprefix("faint_")
    if form in STIFFNESS or form in DAMPING or form in SHARP:
        shape = {**STIFFNESS, **DAMPING, **SHARP}[form]
        motion = "displacement" if form in STIFFNESS else "velocity"
        scale, j = (d_size, 0) if form in STIFFNESS else (v_size, n)
        reference = stiffnesses[0] * linear[loud, :, 0] if form in STIFFNESS else 3 * dampings[0] * linear[loud, :, n]
        height = share * reference.std() / shape(linear[loud, :, j] / scale).std()
        if kind == "tanh_spring":
            height = 0.5 * height
        hidden = lambda x: height * shape(x / scale)  # noqa: E731
        law = lambda d, v, z, t: hidden(d if motion == "displacement" else v)  # noqa: E731
    elif kind == "pendulum":
        law = lambda d, v, z, t: stiffnesses[0] * (np.sin(d) - d)  # noqa: E731
    elif kind == "van_der_pol":
        law = lambda d, v, z, t: 3 * dampings[0] * (d / d_size * 3) ** 2 * v  # noqa: E731
    elif kind == "parametric_stiffness":
        law = lambda d, v, z, t: share * stiffnesses[0] * np.cos(2 * np.pi * 0.13 * frequency * t) * d  # noqa: E731
    elif kind == "maxwell":
        n_more, rate = 1, 2 * np.pi * frequency * rng.uniform(0.3, 3.0)
        law = lambda d, v, z, t: share * stiffnesses[0] * z[:, 0]  # noqa: E731
        more = lambda d, v, z, u: v[:, :1] - rate * z  # noqa: E731
    elif kind == "lugre":
        n_more, stiff = 1, 1.0 / (0.05 * d_size)
        limit = share * stiffnesses[0] * linear[loud, :, 0].std()
        curve = lambda v: 0.7 + 0.3 * np.exp(-((v / (0.1 * v_size)) ** 2))  # noqa: E731
        law = lambda d, v, z, t: limit * z[:, 0]  # noqa: E731
        more = lambda d, v, z, u: stiff * (v[:, :1] - np.abs(v[:, :1]) * z / curve(v[:, :1]))  # noqa: E731
    elif kind == "two_hidden_masses":
        n_more = 4
        part = rng.uniform(0.02, 0.1, 2) * masses[0]
        own = part * (2 * np.pi * frequency * np.array([0.7, 1.5])) ** 2
        rub = 0.1 * np.sqrt(own * part)
        law = lambda d, v, z, t: sum(own[i] * (d - z[:, i]) + rub[i] * (v - z[:, 2 + i]) for i in (0, 1))  # noqa: E731

        def more(d, v, z, u):
            pull = [(own[i] * (d[:, 0] - z[:, i]) + rub[i] * (v[:, 0] - z[:, 2 + i])) / part[i] for i in (0, 1)]
            return np.hstack([z[:, 2:], np.array(pull).T])

    elif kind == "actuator_lag":
        n_more, rate = 1, 2 * np.pi * frequency * rng.uniform(2.0, 8.0)
        law = lambda d, v, z, t: 0.0  # noqa: E731
        push = lambda u: 0.0  # noqa: E731
    elif kind in ("second_input", "base_motion"):
        inputs = np.concatenate([drive, extra[:, :, None]], axis=2)
        at = n - 1 if kind == "second_input" else 0
        push = lambda u: np.eye(n)[at] * u[:, 1:2] * (2.0 if kind == "second_input" else 1.0)  # noqa: E731

    if kind == "actuator_lag":

        def slope(x, u, t):
            d, v, z = x[:, :1], x[:, 1:2], x[:, 2:]
            return np.hstack([v, (z - d @ K - v @ C) * inverse, rate * (u - z)])

    else:
        slope = world(law, n_more, more, push)
    begin = np.zeros((len(LEVELS), 2 * n + n_more))
    with np.errstate(over="ignore", invalid="ignore"):
        states = _run(slope, inputs, begin, dt, SHARP_STEPS if kind in (*SHARP, "lugre") else N_STEPS)
    if not np.isfinite(states).all():
        raise ValueError(f"{kind} {seed} escapes")
    outputs = states[:, :, :n].copy()
    if kind == "sensor_lag":
        pole = np.exp(-2 * np.pi * frequency * rng.uniform(2.0, 8.0) * dt / N_STEPS)
        lagged = _lagged(_run_fine(slope, inputs, begin, dt)[:, :, :n], pole)
        outputs = lagged[:, ::N_STEPS]
    elif kind == "cross_talk":
        outputs[:, :, 1] += rng.uniform(0.05, 0.2) * outputs[:, :, 0]
    elif kind == "record_offsets":
        outputs += rng.uniform(-1, 1, (len(LEVELS), 1, n)) * outputs.std(axis=1, keepdims=True)
    elif kind == "quantised":
        step = 0.15 * outputs[loud].std()
        outputs = step * np.round(outputs / step)
    elif kind == "late_sensor":
        late = int(rng.integers(3, 3 * N_STEPS))
        fine = _run_fine(slope, inputs, begin, dt)[:, :, 1]
        outputs[:, :, 1] = np.pad(fine, ((0, 0), (late, 0)))[:, : fine.shape[1] : N_STEPS]
    noise = rng.standard_normal(outputs.shape)
    if kind == "coloured_noise":
        noise = np.array([_noise(rng, n_samples, 0.05) for _ in LEVELS])[:, :, None]
    part = {"faint_quintic": 0.05, "coloured_noise": 0.03}.get(kind, 0.01)
    noisy = outputs + part * outputs.std(axis=1, keepdims=True) * noise
    if kind == "clipped":
        noisy = np.clip(noisy, -0.6 * np.abs(noisy).max(), 0.6 * np.abs(noisy).max())
    records = tuple(
        OutsideRecord(
            inputs=drive[r], outputs=noisy[r], displacement=states[r, :, 0], velocity=states[r, :, n], dt=dt,
            name=f"level {LEVELS[r]:g}",
        )
        for r in range(len(LEVELS))
    )  # fmt: skip
    return OutsideCase(
        kind=kind, seed=seed, masses=masses, true_masses=true_masses,
        stiffnesses=stiffnesses * rng.uniform(0.95, 1.05, n), dampings=dampings * rng.uniform(0.7, 1.3, n),
        sensor_kind="displacement", rotary=False, fit=records[:-1], held_out=records[-1:],
        effects=ALONE if kind == "wrong_chain_mass" and n == 1 else RIGHT.get(kind, ()), needs_all=kind in NEEDS_ALL,
        place="" if kind in NOT_OF_AN_ELEMENT else "element_0",
        law=None if kind in ("stribeck", "one_sided_friction") else hidden,
        motion=motion, stiffness=stiffnesses[0], damping=dampings[0],
    )  # fmt: skip


def _run_fine(slope, inputs, begin, dt):
    """The same motion at every step of the integrator."""
    fine = np.repeat(inputs, N_STEPS, axis=1)
    h = dt / N_STEPS
    x = np.array(begin, dtype=float)
    found = np.empty((*fine.shape[:2], x.shape[1]))
    for k in range(fine.shape[1]):
        found[:, k] = x
        u, t = fine[:, k], k * h
        a = slope(x, u, t)
        b = slope(x + 0.5 * h * a, u, t + 0.5 * h)
        c = slope(x + 0.5 * h * b, u, t + 0.5 * h)
        x = x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c, u, t + h))
    return found


def _lagged(signal, pole):
    found = np.empty_like(signal)
    last = np.zeros_like(signal[:, 0])
    for k in range(signal.shape[1]):
        found[:, k] = last
        last = pole * last + (1 - pole) * signal[:, k]
    return found


def _motor(rng, kind, seed):
    """J w' = u - b w - Fc sign(w), always driven one way; the speed is measured."""
    J, b = rng.uniform(0.5, 2.0), rng.uniform(0.2, 1.0)
    Fc = rng.uniform(0.1, 0.5)
    dt, n_samples = 0.02 * J / b, int(rng.integers(500, 900))
    level = np.array([1.0, 3.0, 1.7])
    ripple = np.array([_noise(rng, n_samples, 0.01) for _ in level])
    drive = (Fc + level[:, None] * np.maximum(1.0 + 0.3 * ripple, 0.1))[:, :, None]
    start = (drive[:, :1, 0] - Fc) / b

    def slope(x, u, t):
        return (u - b * x - Fc * np.tanh(x / 1e-3)) / J

    speed = _run(slope, drive, start, dt, SHARP_STEPS)
    noisy = speed + 0.01 * speed.std(axis=1, keepdims=True) * rng.standard_normal(speed.shape)
    records = tuple(
        OutsideRecord(inputs=drive[r], outputs=noisy[r], displacement=np.zeros(n_samples), velocity=speed[r, :, 0],
                      dt=dt, name=f"level {level[r]:g}")
        for r in range(len(level))
    )  # fmt: skip
    return OutsideCase(
        kind=kind, seed=seed, masses=np.array([J]), true_masses=np.array([J]), stiffnesses=np.array([0.0]),
        dampings=np.array([b * rng.uniform(0.7, 1.3)]),
        sensor_kind="velocity", rotary=True, fit=records[:-1], held_out=records[-1:], effects=RIGHT[kind],
        needs_all=False, place="element_0", law=None,
        motion="velocity", stiffness=0.0, damping=b,
    )  # fmt: skip
