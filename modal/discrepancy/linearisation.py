"""The model about a trajectory: the defect of every step and how each step depends on the states at both its ends.

The states X = [x; z] are those of the plant and of the effects. A step is

    x[k+1] = Ad x[k] + B0 u0[k] + B1 u1[k] + E0 w[k] + E1 w[k+1] + L (y[k] - yhat[k])
    z[k+1] = Z(z[k], motion[k], motion[k+1])

with L = 0 for a free run and a Kalman gain for the observer form. What is implicit in X[k+1] enters through few rows
(the force's dependence on the motion, the effects' states): X[k+1] = P0[k] X[k] + U V[k] X[k+1] + ..., so the inverse
of I - U V[k] costs a small system a step (Woodbury).
"""

from dataclasses import dataclass

import numpy as np

from modal.discrepancy.assembly import Assembly, Unknowns
from modal.discrepancy.drive import Drive
from modal.discrepancy.driven import per_time
from modal.discrepancy.effects.effect import Force, Memory
from modal.discrepancy.force_line import ForceLine, add_rows, force_line
from modal.discrepancy.port_motion import motion_at, one_on
from modal.discrepancy.scheme import Scheme
from okid.arrays import FloatArray

__all__ = ["Linearisation", "linearise"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Linearisation:
    """The model about a trajectory.

    Attributes:
        states: X (n_times, n).
        forces: Each force at its place, along the trajectory.
        lines: The line that stands for each force over the steps.
        memories: Each force's own states one sample on; None where it has none.
        G: (n_outputs, n_forces) what each force does to the outputs directly.
        before: P0 (n_times, n, n): dependence of each step on the state at its start.
        U: (n, r) and
        V: (n_times, r, n): dependence on the state at its end, U V[k].
        inverse: (n_times, r, r) of I - V U.
        free: (n_rows, n_outputs) outputs before the sensors' effects.
        outputs: (n_rows, n_outputs) outputs of the model.
        H: (n_rows, n_outputs, n) dependence of the outputs on the states.
        defect: (n_times, n) what each step misses; row k + 1 belongs to the step k -> k + 1, the first row of a record
            to its initial state.
        smoothing: Width of sharp laws, as a share of the motion's scale.
    """

    states: FloatArray
    forces: tuple[Force, ...]
    lines: tuple[ForceLine, ...]
    memories: tuple[Memory | None, ...]
    G: FloatArray
    before: FloatArray
    U: FloatArray
    V: FloatArray
    inverse: FloatArray
    free: FloatArray
    outputs: FloatArray
    H: FloatArray
    defect: FloatArray
    smoothing: float

    def advance(self, forcing: FloatArray) -> FloatArray:
        """(I - U V)^-1 applied to forcings (n_columns, n_times, n) that stand at the times they lead from."""
        if self.U.shape[1] == 0:
            return forcing
        rows = self.inverse @ (self.V @ forcing.transpose(1, 2, 0))
        return forcing + np.ascontiguousarray(rows.transpose(2, 0, 1)) @ self.U.T

    def transitions(self) -> FloatArray:
        """M (n_times, n, n): the state at the end of a step by the state at its start."""
        return self.before + self.U @ (self.inverse @ (self.V @ self.before))


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
    n_forces = len(assembly.forces)
    forces: list[Force] = []
    lines: list[ForceLine] = []
    memories: list[Memory | None] = []
    J = np.zeros((n_forces, len(drive.rows), n_all))
    before = np.zeros((n_times, n_all, n_all))
    before[:, :n, :n] = scheme.Ad
    n_rows = 2 * n_forces
    U = np.zeros((n_all, n_rows + n_all - n))
    U[n:, n_rows:] = np.eye(n_all - n)
    V = np.zeros((n_times, n_rows + n_all - n, n_all))
    following = np.zeros((n_times, n_all))
    following[:, :n] = states[:, :n] @ scheme.Ad.T + drive.start @ scheme.B0.T + drive.end @ scheme.B1.T
    G = np.zeros((assembly.plant.n_outputs, n_forces))
    widths = smoothing * drive.level
    first = n
    for position, i in enumerate(assembly.forces):
        item = assembly.placements[i]
        effect, port = item.force_and_port
        values = [per_time(value, drive) for value in unknowns.values(assembly, i)]
        span = slice(first, first + effect.n_memory)
        at = assembly.stiffness_parameter(i)
        stiffness = None if at is None else float(unknowns.common[at])
        motion = motion_at(item, states[:, :n], drive, states[:, span], widths, stiffness=stiffness)
        after = one_on(motion)
        force = effect.force(values, motion)
        line = force_line(effect, values, port, motion, after, force, drive.dt, n_states=n, n_all=n_all, memory=span)
        direction = unknowns.directions(assembly, i)
        E0, E1 = (matrix[:, list(port.columns)] @ direction for matrix in (scheme.E0, scheme.E1))
        G[:, position] = scheme.G[:, list(port.columns)] @ direction
        add_rows(J[position, :, :n], port, force.by_displacement[drive.rows], force.by_velocity[drive.rows])
        J[position, :, span] = force.by_memory[drive.rows]
        before[:, :n] += E0[:, None] * line.start_before[:, None, :] + E1[:, None] * line.end_before[:, None, :]
        U[:n, 2 * position], U[:n, 2 * position + 1] = E0, E1
        V[:, 2 * position], V[:, 2 * position + 1] = line.start_after, line.end_after
        following[:, :n] += line.flow(E0, E1)
        memory: Memory | None = None
        if effect.n_memory:
            memory = effect.advance(values, motion, after, drive.dt)
            following[:, span] = memory.value
            before[:, span, span] = memory.by_memory
            for own in range(effect.n_memory):
                at_start, at_end = before[:, first + own, :n], V[:, n_rows + first - n + own, :n]
                add_rows(at_start, port, memory.by_displacement_before[:, own], memory.by_velocity_before[:, own])
                add_rows(at_end, port, memory.by_displacement_after[:, own], memory.by_velocity_after[:, own])
        forces.append(force)
        lines.append(line)
        memories.append(memory)
        first += effect.n_memory

    w = np.stack([force.value for force in forces], axis=1) if forces else np.zeros((n_times, 0))
    free = states[drive.rows, :n] @ scheme.C.T + drive.sample[drive.rows] @ scheme.D.T + w[drive.rows] @ G.T
    H = np.zeros((len(drive.rows), assembly.plant.n_outputs, n_all))
    H[:, :, :n] = scheme.C
    for position in range(n_forces):
        H += G[:, position][:, None] * J[position][:, None, :]
    outputs, factors = _sensed(assembly, unknowns, drive, free)
    H *= factors[:, :, None]
    if gain is not None:
        innovation = np.where(drive.present, drive.outputs - outputs, 0.0)
        following[drive.rows, :n] += innovation @ gain.T
        before[drive.rows, :n] -= gain @ (drive.present[:, :, None] * H)
    defect = np.zeros_like(states)
    defect[1:] = following[:-1] - states[1:]
    lasts = np.array(drive.firsts[1:]) - 1
    before[lasts] = 0.0
    V[lasts] = 0.0
    for record, begin in enumerate(drive.firsts[:-1]):
        defect[begin] = -states[begin]
        if initial is None:
            defect[begin] += unknowns.local[record, list(assembly.initial)]
        else:
            defect[begin] += initial[record]
    return Linearisation(
        states=states,
        forces=tuple(forces),
        lines=tuple(lines),
        memories=tuple(memories),
        G=G,
        before=before,
        U=U,
        V=V,
        inverse=_inverse(np.eye(U.shape[1]) - V @ U),
        free=free,
        outputs=outputs,
        H=H,
        defect=defect,
        smoothing=smoothing,
    )


def _inverse(matrices: FloatArray) -> FloatArray:
    if matrices.shape[1] == 0:
        return matrices
    if matrices.shape[1] == 1:
        return np.asarray(1.0 / matrices)
    return np.asarray(np.linalg.inv(matrices), dtype=float)


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
