"""The model about a trajectory: the defect of every step and how each step depends on the states at both its ends.

The states X = [x; z] are those of the plant and of the effects. A step is

    x[k+1] = Ad x[k] + B0 u0[k] + B1 u1[k] + E0 w[k] + E1 w[k+1] + L (y[k] - yhat[k])
    z[k+1] = Z(z[k], motion[k], motion[k+1])

with L = 0 for a free run and a Kalman gain for the observer form. The outputs of a free run may hear of a force over
the step to come as well (`modal.simulation.forces.Heard`), those of an observer, which acts on them at once, the
law alone.
"""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Force, Memory
from modal.simulation.assembly import Assembly, Unknowns
from modal.simulation.drive import Drive
from modal.simulation.driven import per_time
from modal.simulation.force_line import ForceLine
from modal.simulation.forces import Heard, acting_forces
from modal.simulation.output_dependence import OutputDependence
from modal.simulation.scheme import Scheme
from modal.simulation.step_dependence import StepDependence, step_dependence
from okid.arrays import FloatArray

__all__ = ["Linearisation", "linearise"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Linearisation:
    """The model about a trajectory.

    Attributes:
        states: X (n_times, n).
        forces: Each force at its place, along the trajectory.
        lines: The line that stands for each force over the steps.
        heard: Each force as the outputs hear it.
        memories: Each force's own states one sample on; None where it has none.
        G: (n_outputs, n_forces) what each force does to the outputs directly.
        steps: How each step depends on the states at both its ends.
        sensors: How the outputs depend on the states.
        free: (n_rows, n_outputs) outputs before the sensors' effects.
        outputs: (n_rows, n_outputs) outputs of the model.
        defect: (n_times, n) what each step misses; row k + 1 belongs to the step k -> k + 1, the first row of a record
            to its initial state.
        smoothing: Width of sharp laws, as a share of the motion's scale.
    """

    states: FloatArray
    forces: tuple[Force, ...]
    lines: tuple[ForceLine, ...]
    heard: tuple[Heard, ...]
    memories: tuple[Memory | None, ...]
    G: FloatArray
    steps: StepDependence
    sensors: OutputDependence
    free: FloatArray
    outputs: FloatArray
    defect: FloatArray
    smoothing: float


def linearise(
    assembly: Assembly,
    unknowns: Unknowns,
    drive: Drive,
    scheme: Scheme,
    states: FloatArray,
    *,
    smoothing: float,
    gain: FloatArray | None = None,
    initial: FloatArray | None = None,
) -> Linearisation:
    """The model about a trajectory.

    Args:
        assembly: The plant and its effects.
        unknowns: Values of all unknowns.
        drive: Inputs after the effects at the inputs (`drive_inputs`).
        scheme: Matrices of one step.
        states: The trajectory (n_times, n_states + n_memory).
        smoothing: Width of sharp laws, as a share of the motion's scale.
        gain: Observer gain L (n_states, n_outputs), or None for a free run.
        initial: (n_records, n) all states at the start of each record; by default the plant's are unknowns and the
            effects' own are zero.

    Returns:
        Defects and dependences.
    """
    n, n_all, n_times = assembly.plant.n_states, states.shape[1], drive.n_times
    acting = acting_forces(assembly, unknowns, drive, scheme, states, smoothing=smoothing)
    lasts = np.array(drive.firsts[1:]) - 1
    heard = tuple(one.heard(lasts) if gain is None else one.law_alone() for one in acting)
    following = np.zeros((n_times, n_all))
    following[:, :n] = states[:, :n] @ scheme.Ad.T + drive.start @ scheme.B0.T + drive.end @ scheme.B1.T
    free = states[drive.rows, :n] @ scheme.C.T + drive.sample[drive.rows] @ scheme.D.T
    for one, at_sensors in zip(acting, heard, strict=True):
        following[:, :n] += one.line.flow(one.E0, one.E1)
        if one.memory is not None:
            following[:, one.span] = one.memory.value
        free += at_sensors.value[drive.rows, None] * one.G
    outputs, factors = _sensed(assembly, unknowns, drive, free)
    sensors = OutputDependence(C=scheme.C, acting=acting, heard=heard, factors=factors, rows=drive.rows)
    correction = None
    if gain is not None:
        following[drive.rows, :n] += np.where(drive.present, drive.outputs - outputs, 0.0) @ gain.T
        correction = np.zeros((n_all, n_all, n_times))
        correction[:n, :, drive.rows] = -np.tensordot(gain, sensors.at_once(n_all) * drive.present.T, axes=(1, 1))
    A, leading = np.zeros((n_all, n_all)), np.ones(n_times)
    A[:n, :n], leading[lasts] = scheme.Ad, 0.0
    return Linearisation(
        states=states,
        forces=tuple(one.force for one in acting),
        lines=tuple(one.line for one in acting),
        heard=heard,
        memories=tuple(one.memory for one in acting),
        G=np.stack([one.G for one in acting], axis=1) if acting else np.zeros((assembly.plant.n_outputs, 0)),
        steps=step_dependence(A, acting, n_times, lasts=leading, correction=correction),
        sensors=sensors,
        free=free,
        outputs=outputs,
        defect=_defect(
            drive, states, following, unknowns.local[:, list(assembly.initial)] if initial is None else initial
        ),
        smoothing=smoothing,
    )


def _defect(drive: Drive, states: FloatArray, following: FloatArray, initial: FloatArray) -> FloatArray:
    defect = np.empty_like(states)
    defect[1:] = following[:-1] - states[1:]
    begins = list(drive.firsts[:-1])
    defect[begins] = initial - states[begins]
    return defect


def _sensed(assembly: Assembly, unknowns: Unknowns, drive: Drive, free: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Outputs after the effects at the sensors, and the factor of each on the true output."""
    outputs = free.copy()
    factors = np.ones_like(free)
    for i in assembly.sensors:
        item = assembly.placements[i]
        values = [per_time(value, drive) for value in unknowns.values(assembly, i)]
        values = [value if np.ndim(value) == 0 else value[drive.rows] for value in values]
        factor, offset = item.sensor_effect.gain(values), item.sensor_effect.offset(values, drive.time[drive.rows])
        outputs[:, item.channel] = factor * outputs[:, item.channel] + offset
        factors[:, item.channel] *= factor
    return outputs, factors
