"""Random plants, inputs, levels and initial states.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass, replace

import numpy as np
from hidden_excitation import filtered_noise, multisine, staircase
from hidden_integrator import march
from hidden_kinds import Kind
from hidden_plants import TrueChain, TrueRotor, chain_plant
from hidden_truth import Experiment

__all__ = ["Plan", "draw_experiment"]


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
