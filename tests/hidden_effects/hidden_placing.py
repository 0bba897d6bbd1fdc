"""Where a hidden effect sits, and how strong it is.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass

import numpy as np
from hidden_kinds import Kind
from hidden_plants import TrueChain, TrueRotor
from hidden_sizes import Surroundings, draw_parameters
from hidden_truth import INPUT_EFFECTS, SENSOR_EFFECTS, Experiment, Truth, clean_outputs
from hidden_types import HiddenEffect

__all__ = ["Scene", "draw_effect"]


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
