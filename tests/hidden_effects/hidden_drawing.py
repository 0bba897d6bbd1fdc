"""What is drawn at random for a case: plant, inputs, levels and initial states; place and size of each effect.

Inputs leave the upper part of the band empty, so that the noise can be seen there. Forces of effects are 10 to 40 % of
the elastic or driving force at the middle level; contact, yielding and saturation are placed between the motion at the
lowest and at the highest level. `strength` scales an effect down (0.2: effects at 20 % of the strength).

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass, replace

import numpy as np
from hidden_integrator import march
from hidden_kinds import Kind
from hidden_truth import (
    INPUT_EFFECTS,
    SENSOR_EFFECTS,
    Experiment,
    TrueChain,
    TrueRotor,
    Truth,
    chain_plant,
    clean_outputs,
)
from hidden_types import HiddenEffect


def multisine(rng, n_samples, *, lowest, highest, n_periods=1):
    """(n_samples,) random phases on every line between two frequencies (in cycles a sample); variance 1."""
    period = n_samples // n_periods
    line = np.arange(period // 2 + 1) / period
    spectrum = np.where((line >= lowest) & (line <= highest), np.exp(2j * np.pi * rng.random(line.size)), 0.0)
    spectrum[0] = 0.0
    wave = np.tile(np.fft.irfft(spectrum, period), -(-n_samples // period))[:n_samples]
    return wave / wave.std()


def filtered_noise(rng, n_samples, *, lowest, highest):
    """(n_samples,) normal noise between two frequencies (in cycles a sample), the middle of a longer stretch."""
    spectrum = np.fft.rfft(rng.standard_normal(2 * n_samples))
    line = np.arange(n_samples + 1) / (2 * n_samples)
    spectrum[(line < lowest) | (line > highest)] = 0.0
    wave = np.fft.irfft(spectrum, 2 * n_samples)[n_samples // 2 : n_samples // 2 + n_samples]
    return wave / wave.std()


def staircase(rng, n_samples, *, shortest, longest, rounding):
    """(n_samples,) random steps that last between two numbers of samples, their corners rounded; variance 1."""
    values = np.empty(0)
    while values.size < n_samples:
        values = np.concatenate([values, np.full(rng.integers(shortest, longest), rng.standard_normal())])
    window = np.hanning(rounding + 2)[1:-1]
    wave = np.convolve(values, window / window.sum(), mode="same")[:n_samples]
    return (wave - wave.mean()) / wave.std()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Surroundings:
    """Where the effect will act: standard deviations at the middle level, of the linear model.

    `top`: ratio of the highest to the middle level.
    """

    displacement: float
    velocity: float
    input: float
    output: float
    force: float
    stiffness: float
    mass: float
    frequencies: np.ndarray
    dt: float
    duration: float
    top: float
    strength: float

    @property
    def elastic(self):
        return self.stiffness * self.displacement

    @property
    def driving(self):
        """The lesser of driving and elastic force: what friction may take away."""
        return min(self.force, self.elastic) if self.stiffness > 0 else self.force


def draw_parameters(effect, rng, at):
    """Parameter values by name."""
    return _DRAWS[effect](rng, at)


def _sign(rng, negative=0.5):
    return -1.0 if rng.random() < negative else 1.0


def _share(rng, at):
    return at.strength * rng.uniform(0.1, 0.4)


def _cubic(rng, at):
    return {"k3": _share(rng, at) * at.stiffness / (3.9 * at.displacement**2) * (0.5 if at.top > 2 else 1.0)}


def _quadratic(rng, at):
    escape = at.stiffness / (3.2 * at.top * at.displacement)
    return {"k2": _sign(rng) * at.strength * rng.uniform(0.25, 0.6) * escape}


def _bilinear(rng, at):
    sign = _sign(rng, 0.3)
    return {"kb": sign * at.strength * rng.uniform(0.15, 0.5 if sign > 0 else 0.35) * at.stiffness}


def _gap(rng, at):
    weaker = at.strength
    if rng.random() < 0.3:
        share = weaker * rng.uniform(0.3, 0.6)
        return {"k_in": -share * at.stiffness, "k_out": 0.0, "gap": rng.uniform(0.8, 1.6) * at.displacement}
    return {"k_in": 0.0, "k_out": weaker * rng.uniform(0.5, 2.5) * at.stiffness,
            "gap": rng.uniform(1.3, 2.0) * at.displacement}  # fmt: skip


def _coulomb(rng, at):
    return {"Fc": _share(rng, at) * at.driving}


def _drag(rng, at):
    return {"c2": _share(rng, at) * at.driving / (1.73 * at.velocity**2)}


def _bouc_wen(rng, at):
    limit = rng.uniform(0.4, 1.2) * at.displacement
    return {"a": _share(rng, at) * at.elastic / limit, "yield_displacement": limit, "n": rng.uniform(1.0, 3.0)}


def _sine(rng, at):
    highest = 3.2 * at.top * at.displacement
    return {"length_scale": highest / (rng.uniform(0.6, 1.1) * np.sqrt(at.strength))}


def _slack(rng, at):
    limit = rng.uniform(0.2, 0.6) * at.displacement
    return {"k": _share(rng, at) * at.elastic / limit, "yield_displacement": limit,
            "slack": rng.uniform(0.2, 0.6) * at.displacement}  # fmt: skip


def _constant(rng, at):
    return {"offset": _sign(rng) * 1.5 * _share(rng, at) * at.driving}


def _time_varying(rng, at):
    sign = _sign(rng)
    return {"rate": sign * at.strength * rng.uniform(0.12, 0.35) * at.stiffness / at.duration}


def _missing_mode(rng, at):
    return {"mass_ratio": at.strength * rng.uniform(0.02, 0.1), "damping": rng.uniform(0.01, 0.05),
            "frequency": rng.uniform(0.8, 1.3) * rng.choice(at.frequencies) / (2 * np.pi)}  # fmt: skip


def _delay(rng, at):
    return {"tau": at.strength * rng.uniform(0.6, 3.5) * at.dt}


def _saturation(rng, at):
    lowest, highest = (1.3, 2.0) if at.strength == 1 else (1.6, 2.0)
    if at.strength < 1:  # only the peaks of the highest level
        lowest, highest = lowest * at.top, highest * at.top
    return {"limit": rng.uniform(lowest, highest) * at.input}


def _gain(rng, at):
    return {"gain": 1.0 + _sign(rng) * at.strength * rng.uniform(0.1, 0.35)}


def _bias(rng, at):
    return {"offset": _sign(rng) * _share(rng, at) * at.output,
            "slope": _sign(rng) * at.strength * rng.uniform(0.2, 0.6) * at.output / at.duration}  # fmt: skip


def _periodic(rng, at):
    frequency = at.frequencies[0] / (2 * np.pi) * rng.uniform(0.4, 1.8)
    return {"amplitude": _share(rng, at) * at.driving, "frequency": frequency}


_DRAWS = {
    "cubic_stiffness": _cubic,
    "quadratic_stiffness": _quadratic,
    "bilinear_stiffness": _bilinear,
    "gap_spring": _gap,
    "coulomb_friction": _coulomb,
    "quadratic_drag": _drag,
    "bouc_wen_hysteresis": _bouc_wen,
    "sine_softening": _sine,
    "slack_in_hysteresis": _slack,
    "constant_force": _constant,
    "time_varying_stiffness": _time_varying,
    "missing_mode": _missing_mode,
    "input_delay": _delay,
    "input_saturation": _saturation,
    "input_gain": _gain,
    "sensor_bias": _bias,
    "sensor_gain": _gain,
    "periodic_disturbance": _periodic,
}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scene:
    """The plant in its experiment, without the effect: `linear` (n_records, n_samples, n_outputs)."""

    plant: TrueChain | TrueRotor
    sort: str
    experiment: Experiment
    linear: np.ndarray
    levels: list[float]
    recipe: Kind


def draw_effect(name, scene, rng):
    """Place and size; sizes follow the linear motion at the middle level."""
    if isinstance(scene.plant, TrueRotor):
        return _rotor_effect(name, scene, rng)
    plant, experiment = scene.plant, scene.experiment
    place = _place(name, plant, scene.sort, rng)
    if place is None:
        return None
    middle = scene.recipe.levels[1]
    size = middle / np.array(scene.levels)  # of the middle level over that of each record
    number = int(place.split("_")[1])
    at_motion = place if place.startswith(("element", "dof")) else "element_0"
    _, (d, v) = clean_outputs(
        Truth(
            plant=plant, effects=(HiddenEffect(effect="constant_force", place=at_motion, parameters={"offset": 0.0}),)
        ),
        experiment,
        n_steps=1,
    )
    joined = plant.stiffnesses[int(at_motion.split("_")[1])]
    channel = number if name in SENSOR_EFFECTS else 0
    at = Surroundings(
        displacement=float(np.mean(d[..., 0].std(axis=1) * size)),
        velocity=float(np.mean(v[..., 0].std(axis=1) * size)),
        input=float(np.mean(experiment.inputs[..., 0].std(axis=1) * size)),
        output=float(np.mean(scene.linear[..., channel].std(axis=1) * size)),
        force=float(np.mean(experiment.inputs[..., 0].std(axis=1) * size)),
        stiffness=float(joined),
        mass=float(plant.masses[min(number, plant.n_dofs - 1)]),
        frequencies=plant.natural_frequencies,
        dt=experiment.dt,
        duration=experiment.dt * experiment.inputs.shape[1],
        top=scene.recipe.levels[2] / middle,
        strength=scene.recipe.strength,
    )
    return HiddenEffect(effect=name, place=place, parameters=draw_parameters(name, rng, at))


def _place(name, plant, sort, rng):
    """Any place that can be told apart from the others by what is measured; None: this plant has none."""
    n = plant.n_dofs
    if name in INPUT_EFFECTS:
        return "input_0"
    if name in SENSOR_EFFECTS:
        return f"output_{rng.integers(len(plant.sensor_dofs))}"
    seen = plant.sensor_dofs if sort == "state_space" else range(n)
    dofs = [f"dof_{i}" for i in seen]
    elements = [f"element_{e}" for e in range(n) if e in seen and (e == 0 or e - 1 in seen)]
    if name == "missing_mode":
        places = dofs
    elif name == "periodic_disturbance":
        places = dofs + elements
    elif name == "constant_force":  # in the last element it moves one output only: a bias, by structure
        places = [p for p in dofs + elements if n == 1 or p != f"element_{n - 1}"]
    else:
        places = elements
    if not places:
        return None
    place = str(rng.choice(places))
    return "element_0" if place == "dof_0" and name != "missing_mode" else place


def _rotor_effect(name, scene, rng):
    rotor, experiment = scene.plant, scene.experiment
    middle = scene.recipe.levels[1]
    size = middle / np.array(scene.levels)
    speed = float(np.mean(np.sqrt(np.mean(scene.linear[..., 0] ** 2, axis=1)) * size))
    volt = float(np.mean(np.sqrt(np.mean(experiment.inputs[..., 0] ** 2, axis=1)) * size))
    place = "input_0" if name in INPUT_EFFECTS else "element_0"
    if name == "quadratic_drag":
        parameters = {"c2": rng.uniform(0.15, 0.6) * rotor.kt * volt / speed**2}
    elif name == "coulomb_friction":
        parameters = {"Fc": rng.uniform(0.3, 0.7) * rotor.kt * volt}
    elif name == "input_delay":
        parameters = {"tau": rng.uniform(0.6, 4.5) * experiment.dt}
    elif name == "input_saturation":
        parameters = {"limit": rng.uniform(1.2, 1.8) * volt}
    elif name == "overflow":
        parameters = {"limit": float(np.quantile(scene.linear, rng.uniform(0.75, 0.9)))}
    else:
        exponent = rng.uniform(0.4, 0.7)
        parameters = {"exponent": exponent, "coefficient": rotor.b * speed ** (1 - exponent)}
    return HiddenEffect(effect=name, place=place, parameters=parameters)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plan:
    """What is to be drawn."""

    recipe: Kind
    sort: str
    n_dofs: int
    sensor_kind: str
    n_sensors: int
    effects: tuple[str, ...]


def draw_experiment(plan, rng):
    """Plant, experiment, and the levels of its records, the last of them to be held out."""
    return (_rotor if plan.sort in ("motor", "tank") else _chain)(plan, rng)


def _chain(plan, rng):
    """A chain, its inputs at the levels to fit and, last, at the level held out."""
    scale, first = 10 ** rng.uniform(-0.5, 1.0), 2 * np.pi * 10 ** rng.uniform(0.0, 1.3)
    masses, springs = scale * rng.uniform(0.7, 1.5, plan.n_dofs), rng.uniform(0.7, 1.5, plan.n_dofs)
    shape = TrueChain(
        masses=masses, stiffnesses=springs, dampings=springs, force_dofs=(int(rng.integers(plan.n_dofs)),),
        sensor_dofs=tuple(sorted(int(i) for i in rng.permutation(plan.n_dofs)[: plan.n_sensors])),
        sensor_kind=plan.sensor_kind,
    )  # fmt: skip
    springs = springs * (first / shape.natural_frequencies[0]) ** 2
    ratio = rng.uniform(0.008, 0.03)
    dampings = springs * 2 * ratio / first * rng.uniform(0.7, 1.3, plan.n_dofs) * (0.5 if plan.n_dofs > 1 else 1.0)
    plant = replace(shape, stiffnesses=springs, dampings=dampings)
    omega = plant.natural_frequencies
    dt = min(2 * np.pi / omega[0] / rng.uniform(30, 60), 2 * np.pi / omega[-1] / 12)
    n_samples = int(rng.choice([1536, 2048, 2048, 3072]))
    hold = (
        "linear"
        if rng.random() < 0.25 and not {"input_delay", "input_saturation"} & set(plan.effects)
        else "zero_order"
    )
    levels = _levels(plan.recipe, rng)
    low, high = (
        rng.uniform(0.15, 0.4) * omega[0],
        rng.uniform(1.2, 1.6) * omega[-1] * (1.5 if plan.n_dofs == 1 else 1.0),
    )
    wave = _wave(rng, n_samples, low * dt / (2 * np.pi), min(high * dt / (2 * np.pi), 0.2))
    newton = 10 ** rng.uniform(-1, 2)
    inputs = newton * np.array([[wave()] for _ in levels]).swapaxes(1, 2) * np.array(levels)[:, np.newaxis, np.newaxis]
    starts = _starts(plant, inputs, dt, hold, rng)
    phases = rng.uniform(0, 2 * np.pi, len(levels))
    return plant, Experiment(inputs=inputs, starts=starts, phases=phases, dt=dt, hold=hold), levels


def _rotor(plan, rng):
    """A motor, or a tank that is never empty."""
    tau, J = 10 ** rng.uniform(-1.3, 0.0), 10 ** rng.uniform(-5, -3)
    if plan.sort == "tank":
        tau, J = tau * 300, 10 ** rng.uniform(-3, -1)
    rotor = TrueRotor(J=J, b=J / tau, kt=J / tau * 10 ** rng.uniform(0, 2))
    dt, n_samples = tau / rng.uniform(20, 40), int(rng.choice([1536, 2048]))
    levels = _levels(plan.recipe, rng)
    steps = rng.random() < 0.5 or plan.sort == "tank"

    def wave():
        if steps:
            return staircase(rng, n_samples, shortest=20, longest=150, rounding=8)
        return filtered_noise(rng, n_samples, lowest=0.0, highest=0.04)

    u = np.array([[wave()] for _ in levels]).swapaxes(1, 2)
    if plan.sort == "tank":
        u = 1.0 + 0.28 * u / np.abs(u).max(axis=1, keepdims=True) * 3
    elif "coulomb_friction" not in plan.effects and rng.random() < 0.5:
        u = u + 1.5
    inputs = u * np.array(levels)[:, np.newaxis, np.newaxis]
    starts = np.zeros((len(levels), 1))
    if plan.sort == "tank":
        starts = rng.uniform(0.5, 1.0, starts.shape) * rotor.kt / rotor.b * np.array(levels)[:, np.newaxis]
    elif rng.random() < 0.5:
        starts = rotor.kt / rotor.b * 0.5 * rng.standard_normal(starts.shape) * np.array(levels)[:, np.newaxis]
    experiment = Experiment(inputs=inputs, starts=starts, phases=np.zeros(len(levels)), dt=dt, hold="zero_order")
    return rotor, experiment, levels


def _levels(recipe, rng):
    """Levels to fit and, last, the one held out: between the lowest and the highest, near none of the others."""
    low, middle, high = (level * rng.uniform(0.95, 1.05) for level in recipe.levels)
    fit = [low, middle, high] if rng.choice(recipe.n_fit) == 3 else [low, high]
    return [*fit, rng.uniform(middle * 1.15, high * 0.85)]


def _wave(rng, n_samples, lowest, highest):
    sort = rng.integers(3)
    if sort == 2:
        return lambda: filtered_noise(rng, n_samples, lowest=lowest, highest=highest)
    return lambda: multisine(rng, n_samples, lowest=lowest, highest=highest, n_periods=1 + sort)


def _starts(plant, inputs, dt, hold, rng):
    """At rest, or anywhere on the way of the linear plant: some state of it at another time."""
    rest = np.zeros((len(inputs), 2 * plant.n_dofs))
    if rng.random() < 0.5:
        return rest
    linear, _ = chain_plant(plant, [])
    run = march(linear, [], inputs, dt=dt, hold=hold, initial_states=rest, n_steps=1)
    return run.states[np.arange(len(inputs)), rng.integers(inputs.shape[1] // 3, inputs.shape[1], len(inputs))]
