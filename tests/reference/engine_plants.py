"""Hand-written plants, records and values that exercise every part of the simulation engine at once.

Only the containers come from the product; every matrix is written down here.
"""

from dataclasses import replace

import numpy as np

from modal.effects.catalogue import CATALOGUE
from modal.simulation.assembly import Unknowns, assemble, initial_unknowns, place_effect
from modal.simulation.plant import LinearParameter, Plant, Port
from okid.record import Record

EVERYTHING = frozenset({"motion", "force", "mass", "flow"})
MASSES, STIFFNESSES, DAMPINGS = (1.0, 0.7), (90.0, 140.0), (0.8, 0.5)

VALUES = {
    "cubic_stiffness": (60.0,),
    "quadratic_stiffness": (20.0,),
    "bilinear_stiffness": (25.0,),
    "gap_spring": (5.0, 40.0, 0.15),
    "coulomb_friction": (0.7,),
    "quadratic_drag": (0.6,),
    "bouc_wen_hysteresis": (25.0, 0.2, 2.0),
    "sine_softening": (0.6,),
    "slack_in_hysteresis": (30.0, 0.1, 0.05),
    "constant_force": (0.5,),
    "time_varying_stiffness": (8.0,),
    "missing_mode": (0.15, 1.7, 0.04),
    "input_delay": (0.0273,),
    "input_saturation": (1.1,),
    "input_gain": (1.2,),
    "sensor_bias": (0.1, 0.02),
    "sensor_gain": (1.15,),
    "periodic_disturbance": (0.6, 1.3, 0.4),
    "power_law_flow": (3.0, 0.6, 4.0),
    "overflow": (20.0, 0.12),
}
"""For motions of about 0.2 m: every law shows, none rules."""

FORCES = tuple(key for key in VALUES if not key.startswith(("input", "sensor")))
WHERE = {"input": "push", "sensor": "speed"}


def two_masses():
    """Two masses in line: x = (d0, d1, v0, v1), inputs at both, outputs d1, v0 and the acceleration of mass 0.

    Linear parameters: the ground spring's stiffness and damping, which also stand in the accelerometer's row.
    Ports: the ground spring, the spring between the masses, and a place with an unknown direction.
    """
    m0, m1 = MASSES
    constant = np.zeros((7, 4 + 2 + 3))
    constant[0, 2] = constant[1, 3] = 1.0
    k1, c1 = STIFFNESSES[1], DAMPINGS[1]
    constant[2] = np.array([-k1, k1, -c1, c1, 1.0, 0.3, -1.0, 1.0, 0.0]) / m0
    constant[3] = np.array([k1, -k1, c1, -c1, 0.0, 1.0, 0.0, -1.0, -1.0]) / m1
    constant[4, 1] = constant[5, 2] = 1.0
    constant[6] = constant[2]
    by_stiffness, by_damping = np.zeros_like(constant), np.zeros_like(constant)
    by_stiffness[[2, 6], 0] = by_damping[[2, 6], 2] = -1.0 / m0
    rows = np.eye(6)
    return Plant(
        system=np.stack([constant, by_stiffness, by_damping]),
        n_states=4,
        n_inputs=2,
        parameters=(
            LinearParameter(name="stiffness", unit="N/m", nominal=90.0, deviation=9.0, lower=60.0, upper=120.0),
            LinearParameter(name="damping", unit="N s/m", nominal=0.8, deviation=0.4, lower=0.0, upper=4.0),
        ),
        ports=(
            Port(
                name="ground",
                displacement=rows[0],
                velocity=rows[2],
                columns=(0,),
                stiffness=90.0,
                mass=m0,
                accepts=EVERYTHING,
            ),
            Port(
                name="between",
                displacement=rows[1] - rows[0],
                velocity=rows[3] - rows[2],
                columns=(1,),
                stiffness=k1,
                mass=m1,
                accepts=EVERYTHING,
            ),
            Port(name="anywhere", displacement=rows[1], velocity=rows[3], columns=(2, 0), mass=m1, accepts=EVERYTHING),
        ),
        input_names=("push", "other"),
        output_names=("place", "speed", "acceleration"),
        input_units=("N", "N"),
        output_units=("m", "m/s", "m/s^2"),
    )


def imposed_motion():
    """Imposed motion in, force out: no states. Inputs: displacement, its velocity, and a force; one output."""
    constant = np.array([[0.0, 0.5, 0.2, 1.0]])
    rows = np.eye(3)
    return Plant(
        system=np.stack([constant, np.array([[1.0, 0.0, 0.0, 0.0]])]),
        n_states=0,
        n_inputs=3,
        parameters=(
            LinearParameter(name="stiffness", unit="N/m", nominal=3.0, deviation=3.0, lower=-30.0, upper=30.0),
        ),
        ports=(Port(name="clamp", displacement=rows[0], velocity=rows[1], columns=(0,), accepts=EVERYTHING),),
        input_names=("push", "rate", "other"),
        output_names=("speed",),
        input_units=("m", "m/s", "N"),
        output_units=("N",),
    )


def smooth_inputs(n_samples, n_inputs, dt, seed, level=1.0):
    """Sums of five sines below 2.5 Hz, (n_samples, n_inputs), of standard deviation `level`."""
    rng = np.random.default_rng(seed)
    t = np.arange(n_samples)[:, None, None] * dt
    frequencies = rng.uniform(0.3, 2.5, (1, n_inputs, 5))
    phases = rng.uniform(0, 2 * np.pi, (1, n_inputs, 5))
    return level * np.sin(2 * np.pi * frequencies * t + phases).sum(axis=2) * np.sqrt(2 / 5)


def some_records(plant, lengths=(70, 53), *, dt=0.02, hold="linear", levels=(2.0, 3.5), missing=0.0, seed=5):
    """Records of different lengths and levels with random outputs, a share of them missing."""
    rng = np.random.default_rng(seed)
    found = []
    for i, (length, level) in enumerate(zip(lengths, levels, strict=True)):
        inputs = smooth_inputs(length, plant.n_inputs, dt, seed + 10 * i, level)
        if plant.n_states == 0:
            t = np.arange(length) * dt
            inputs[:, 0] = 0.1 * level * np.sin(2 * np.pi * 1.1 * t) + 0.03 * np.cos(2 * np.pi * 2.9 * t)
            inputs[:, 1] = 0.1 * level * 2 * np.pi * 1.1 * np.cos(
                2 * np.pi * 1.1 * t
            ) - 0.03 * 2 * np.pi * 2.9 * np.sin(2 * np.pi * 2.9 * t)
        outputs = 0.2 * rng.standard_normal((length, plant.n_outputs))
        outputs[rng.random(outputs.shape) < missing] = np.nan
        found.append(Record(inputs, outputs, dt, input_hold=hold, name=f"run {i}"))
    return found


def place_of(plant, key, port=None):
    """Where an effect of that key goes."""
    kind = key.split("_")[0]
    return WHERE.get(kind, port or plant.ports[0].name)


def with_effects(plant, keys, n_records, *, seed=0, port=None, scales=(0.2, 1.5)):
    """The plant with effects at places (key or (key, place)), and unknowns with everything away from zero."""
    rng = np.random.default_rng(seed)
    pairs = [(key, place_of(plant, key, port)) if isinstance(key, str) else key for key in keys]
    items = [
        place_effect(plant, CATALOGUE[key], where, displacement_scale=scales[0], velocity_scale=scales[1])
        for key, where in pairs
    ]
    assembly = assemble(plant, items)
    unknowns = initial_unknowns(assembly, n_records)
    common, local = unknowns.common.copy(), unknowns.local.copy()
    local[:, : plant.n_states] = (
        rng.standard_normal((n_records, plant.n_states)) * ([0.05, 0.05, 0.3, 0.3][: plant.n_states])
    )
    for i, (key, _) in enumerate(pairs):
        item = items[i]
        span = assembly.common_of(i)
        common[span] = [*(VALUES[key][j] for j in item.common), *(0.4 + 0.1 * np.arange(item.n_directions))]
        own = assembly.own_of(i)
        local[:, own.start : own.start + item.n_memory] = 0.02 * rng.standard_normal((n_records, item.n_memory))
        for position, j in enumerate(item.local):
            local[:, assembly.local_of(i).start + position] = VALUES[key][j] + 0.7 * np.arange(n_records)
    return assembly, Unknowns(common=common, local=local)


def moved(unknowns, *, common=None, local=None, by=0.0):
    """The unknowns with one of them changed: `common` its index, or `local` (record, index)."""
    first, second = unknowns.common.copy(), unknowns.local.copy()
    if common is not None:
        first[common] += by
    if local is not None:
        second[local] += by
    return replace(unknowns, common=first, local=second)
