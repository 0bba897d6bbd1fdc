"""The truth behind a case and its records: a true plant, the effects hidden in it, and what they make of the inputs.

Plants are chains of masses, motors and tanks, with places where an effect can act and sensors of any kind.

Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass, replace

import numpy as np
from hidden_integrator import HiddenPlant, march
from hidden_laws import law_from
from hidden_types import HiddenEffect, NominalChain


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Absorber:
    """A mass on a spring and a damper, hung on one degree of freedom: a mode that the model misses."""

    dof: int
    mass: float
    frequency: float
    damping_ratio: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrueChain(NominalChain):
    """The chain itself, with what the user's model has off put right."""

    @property
    def n_dofs(self):
        return len(self.masses)

    @property
    def natural_frequencies(self):
        """(n_dofs,) [rad/s], rising."""
        mass, _, stiffness = chain_matrices(self)
        return np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrueRotor:
    """J v' = kt u - b v, v measured: the speed of a motor or the level of a tank (which may overflow)."""

    J: float
    b: float
    kt: float
    limit: float | None = None


def chain_matrices(chain, absorber=None):
    """Mass, damping and stiffness matrix; the absorber's degree of freedom is the last."""
    n = len(chain.masses)
    size = n + (absorber is not None)
    mass, damping, stiffness = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    mass[np.arange(n), np.arange(n)] = chain.masses
    for e in range(n):
        row = place_row(f"element_{e}", size)
        stiffness += chain.stiffnesses[e] * np.outer(row, row)
        damping += chain.dampings[e] * np.outer(row, row)
    if absorber is not None:
        row = np.zeros(size)
        row[n], row[absorber.dof] = 1.0, -1.0
        omega = 2 * np.pi * absorber.frequency
        mass[n, n] = absorber.mass
        stiffness += absorber.mass * omega**2 * np.outer(row, row)
        damping += 2 * absorber.damping_ratio * absorber.mass * omega * np.outer(row, row)
    return mass, damping, stiffness


def place_row(place, n_dofs):
    """(n_dofs,) relative displacement at "element_e", displacement at "dof_i"; by its transpose the force enters."""
    sort, number = place.split("_")
    row, index = np.zeros(n_dofs), int(number)
    row[index] = 1.0
    if sort == "element" and index > 0:
        row[index - 1] = -1.0
    return row


def chain_plant(chain, places, absorber=None):
    """State (x, x'): the plant, and the output rows C, D, G of y = C x + D u + G w."""
    mass, damping, stiffness = chain_matrices(chain, absorber)
    size = len(mass)
    rows = np.array([place_row(place, size) for place in places]).reshape(len(places), size)
    lower = np.hstack([-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)])
    A = np.vstack([np.hstack([np.zeros((size, size)), np.eye(size)]), lower])
    force = np.linalg.solve(mass, np.eye(size)[:, list(chain.force_dofs)])
    push = -np.linalg.solve(mass, rows.T)
    plant = HiddenPlant(
        A=A,
        B=np.vstack([np.zeros_like(force), force]),
        E=np.vstack([np.zeros_like(push), push]),
        displacement=np.hstack([rows, np.zeros_like(rows)]),
        velocity=np.hstack([np.zeros_like(rows), rows]),
    )
    sensors = list(chain.sensor_dofs)
    if chain.sensor_kind == "acceleration":
        return plant, (lower[sensors], force[sensors], push[sensors])
    C = np.eye(2 * size)[[dof + size * (chain.sensor_kind == "velocity") for dof in sensors]]
    return plant, (C, np.zeros((len(sensors), force.shape[1])), np.zeros((len(sensors), len(places))))


def rotor_plant(rotor, n_places):
    """State v; every place is the rotor itself."""
    plant = HiddenPlant(
        A=np.array([[-rotor.b / rotor.J]]),
        B=np.array([[rotor.kt / rotor.J]]),
        E=np.full((1, n_places), -1.0 / rotor.J),
        displacement=np.zeros((n_places, 1)),
        velocity=np.ones((n_places, 1)),
        limit=None if rotor.limit is None else (0, rotor.limit),
    )
    return plant, (np.eye(1), np.zeros((1, 1)), np.zeros((1, n_places)))


def outputs_of(run, rows, inputs):
    """(n_records, n_samples, n_outputs); `inputs` as they reach the plant."""
    C, D, G = rows
    return run.states @ C.T + inputs @ D.T + run.forces @ G.T


STEPS_A_RADIAN, FEWEST_STEPS = 8.0, 2
"""Steps a sample per radian that the fastest motion turns in a sample: errors of 1e-5 of the motion, measured against
48 steps; reversals of friction are located whatever the step."""
AT_CORNERS = ("bilinear_stiffness", "gap_spring", "bouc_wen_hysteresis", "slack_in_hysteresis")
STEPS_AT_CORNERS, FEWEST_AT_CORNERS = 18.0, 6
"""So many where the law has a corner within its stroke: of 5e-4 and less."""

INPUT_EFFECTS = ("input_delay", "input_saturation", "input_gain")
SENSOR_EFFECTS = ("sensor_bias", "sensor_gain")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Experiment:
    """What is done to the plant: `inputs` (n_records, n_samples, n_inputs), `starts` (n_records, n_states) of the
    plant without absorber, `phases` (n_records,) of a disturbance that nobody steers."""

    inputs: np.ndarray
    starts: np.ndarray
    phases: np.ndarray
    dt: float
    hold: str

    def only(self, rows):
        return replace(self, inputs=self.inputs[rows], starts=self.starts[rows], phases=self.phases[rows])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Truth:
    """A chain or a rotor with effects."""

    plant: TrueChain | TrueRotor
    effects: tuple[HiddenEffect, ...]

    def without(self, effect):
        return replace(self, effects=tuple(e for e in self.effects if e is not effect))


def clean_outputs(truth, experiment, *, n_steps=None):
    """(n_records, n_samples, n_outputs) without noise; displacement and velocity at the place of each force law."""
    forces = [e for e in truth.effects if e.effect not in (*INPUT_EFFECTS, *SENSOR_EFFECTS, "missing_mode", "overflow")]
    laws = [_law(e, truth.plant, experiment.phases) for e in forces]
    plant, rows = _plant(truth, [e.place for e in forces])
    inputs, delay = _as_driven(truth.effects, experiment.inputs)
    extra = len(plant.A) - experiment.starts.shape[1]
    starts = experiment.starts if not extra else _with_absorber(experiment.starts)
    if n_steps is None:
        n_steps = _steps_needed(truth, plant, experiment.dt)
    run = march(
        plant, laws, inputs, dt=experiment.dt, hold=experiment.hold, initial_states=starts, n_steps=n_steps, delay=delay
    )
    outputs = outputs_of(run, rows, _late(inputs, delay, experiment.dt))
    motion = run.states @ plant.displacement.T, run.states @ plant.velocity.T
    return _as_sensed(truth.effects, outputs, experiment.dt), motion


def _law(effect, plant, phases):
    values = dict(effect.parameters)
    if effect.effect == "periodic_disturbance":
        values["phases"] = phases[:, np.newaxis, np.newaxis]
    if effect.effect == "sine_softening":
        values["k"] = float(plant.stiffnesses[int(effect.place.split("_")[1])])
    if effect.effect == "power_law_flow":
        values["linear"] = plant.b
    return law_from(effect.effect, **values)


def _plant(truth, places):
    if isinstance(truth.plant, TrueRotor):
        brim = next((e.parameters["limit"] for e in truth.effects if e.effect == "overflow"), None)
        return rotor_plant(replace(truth.plant, limit=brim), len(places))
    hung = next((e for e in truth.effects if e.effect == "missing_mode"), None)
    absorber = None
    if hung is not None:
        dof, values = int(hung.place.split("_")[1]), hung.parameters
        absorber = Absorber(
            dof=dof,
            mass=values["mass_ratio"] * truth.plant.masses[dof],
            frequency=values["frequency"],
            damping_ratio=values["damping"],
        )
    return chain_plant(truth.plant, places, absorber)


def _with_absorber(starts):
    """The absorber at rest in the middle: displacements, then velocities, one more of each."""
    n_dofs = starts.shape[1] // 2
    zero = np.zeros((len(starts), 1))
    return np.hstack([starts[:, :n_dofs], zero, starts[:, n_dofs:], zero])


def _as_driven(effects, inputs):
    """Inputs as they reach the plant, but for their delay [s]."""
    delay = 0.0
    inputs = np.array(inputs)
    for e in effects:
        if e.effect in INPUT_EFFECTS:
            channel = int(e.place.split("_")[1])
            if e.effect == "input_gain":
                inputs[..., channel] *= e.parameters["gain"]
            elif e.effect == "input_saturation":
                limit = e.parameters["limit"]
                inputs[..., channel] = np.clip(inputs[..., channel], -limit, limit)
            else:
                delay = e.parameters["tau"]
    return inputs, delay


def _late(inputs, delay, dt):
    """The input that acts at each sample, held since the last switch that has arrived."""
    n = int(np.ceil(delay / dt - 1e-9))
    return np.concatenate([np.zeros_like(inputs[:, :n]), inputs[:, : inputs.shape[1] - n]], axis=1)


def _as_sensed(effects, outputs, dt):
    outputs = np.array(outputs)
    time = dt * np.arange(outputs.shape[1])
    for e in effects:
        if e.effect in SENSOR_EFFECTS:
            channel = int(e.place.split("_")[1])
            if e.effect == "sensor_gain":
                outputs[..., channel] *= e.parameters["gain"]
            else:
                outputs[..., channel] += e.parameters["offset"] + e.parameters["slope"] * time
    return outputs


def _steps_needed(truth, plant, dt):
    """Steps a sample; contact adds its stiffness, no law at all needs no more than the exact linear part."""
    if not any(e.effect not in (*INPUT_EFFECTS, *SENSOR_EFFECTS, "missing_mode") for e in truth.effects):
        return 1
    fastest = np.abs(np.linalg.eigvals(plant.A)).max()
    if isinstance(truth.plant, TrueChain):
        added = max((e.parameters.get("k_out", 0.0) for e in truth.effects), default=0.0)
        fastest = np.sqrt(fastest**2 + 2 * added / truth.plant.masses.min())
    corners = any(e.effect in AT_CORNERS for e in truth.effects)
    each, fewest = (STEPS_AT_CORNERS, FEWEST_AT_CORNERS) if corners else (STEPS_A_RADIAN, FEWEST_STEPS)
    return int(np.clip(np.ceil(each * fastest * dt), fewest, 40))
