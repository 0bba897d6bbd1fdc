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

from modal.discrepancy.acting_force import ActingForce, acting_forces
from modal.discrepancy.assembly import Assembly, Unknowns
from modal.discrepancy.drive import Drive
from modal.discrepancy.driven import per_time
from modal.discrepancy.effects.effect import Force, Memory
from modal.discrepancy.force_line import ForceLine
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
    acting = acting_forces(assembly, unknowns, drive, scheme, states, smoothing=smoothing)
    before = np.zeros((n_times, n_all, n_all))
    before[:, :n, :n] = scheme.Ad
    following = np.zeros((n_times, n_all))
    following[:, :n] = states[:, :n] @ scheme.Ad.T + drive.start @ scheme.B0.T + drive.end @ scheme.B1.T
    U, V = _end_of_step(acting, n, n_all, n_times)
    free = states[drive.rows, :n] @ scheme.C.T + drive.sample[drive.rows] @ scheme.D.T
    H = np.zeros((len(drive.rows), assembly.plant.n_outputs, n_all))
    H[:, :, :n] = scheme.C
    for one in acting:
        before[:, :n] += one.E0[:, None] * one.line.start_before[:, None, :]
        before[:, :n] += one.E1[:, None] * one.line.end_before[:, None, :]
        following[:, :n] += one.line.flow(one.E0, one.E1)
        one.add_memory(before, following)
        free += one.force.value[drive.rows, None] * one.G
        H += one.G[:, None] * one.rows(drive.rows, n_all)[:, None, :]
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
        forces=tuple(one.force for one in acting),
        lines=tuple(one.line for one in acting),
        memories=tuple(one.memory for one in acting),
        G=np.stack([one.G for one in acting], axis=1) if acting else np.zeros((assembly.plant.n_outputs, 0)),
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


def _end_of_step(acting: tuple[ActingForce, ...], n: int, n_all: int, n_times: int) -> tuple[FloatArray, FloatArray]:
    """U and V: what each step takes from the state at its own end, two rows a force and one a state of an effect."""
    n_rows = 2 * len(acting)
    U = np.zeros((n_all, n_rows + n_all - n))
    U[n:, n_rows:] = np.eye(n_all - n)
    V = np.zeros((n_times, n_rows + n_all - n, n_all))
    for position, one in enumerate(acting):
        U[:n, 2 * position], U[:n, 2 * position + 1] = one.E0, one.E1
        V[:, 2 * position], V[:, 2 * position + 1] = one.line.start_after, one.line.end_after
        one.add_memory_end(V[:, n_rows:, :n], n)
    return U, V


def _inverse(matrices: FloatArray) -> FloatArray:
    if matrices.shape[1] == 0:
        return matrices
    if matrices.shape[1] == 1:
        return np.asarray(1.0 / matrices)
    if matrices.shape[1] == 2:  # one force: the closed form costs a tenth of LAPACK's loop over small matrices
        (a, b), (c, d) = matrices.transpose(1, 2, 0)
        found = np.stack([np.stack([d, -b]), np.stack([-c, a])]) / (a * d - b * c)
        if not np.isfinite(found).all():
            raise np.linalg.LinAlgError("a step has no unique end")
        return np.ascontiguousarray(found.transpose(2, 0, 1))
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
