"""The model about a trajectory: the defect of every step and how each step depends on the states at both its ends.

The states X = [x; z] are those of the plant and of the effects. A step is

    x[k+1] = Ad x[k] + B0 u0[k] + B1 u1[k] + E0 w[k] + E1 w[k+1] + L (y[k] - yhat[k])
    z[k+1] = Z(z[k], motion[k], motion[k+1])

with L = 0 for a free run and a Kalman gain for the observer form. The outputs of a free run may hear of a force over
the step to come as well (`modal.simulation.forces.Heard`), those of an observer, which acts on them at once, the
law alone.

The forces see the states through few rows R (the coordinates of their ports) and enter through few columns U, so

    dX[k+1] = A dX[k] + U_y dy[k] + U (K0[k] R dX[k] + K1[k] R dX[k+1])

with U_y = L of an observer (the outputs' dependence on dX[k] is dy). What is implicit is solved by a system of the size
of the lines, a few a force (Woodbury): with B[k] = A + U_y H[k]

    dX[k+1] = (I + U Q[k] R) (...)        Q = (I - K1 R U)^-1 K1        M = B + U (Q R B + (I - K1 R U)^-1 K0 R)

Times come last in all arrays, so that every product runs over them at once.
"""

from dataclasses import dataclass

import numpy as np

from modal.simulation.assembly import Assembly, Unknowns, per_row
from modal.simulation.drive import Drive, IndexArray
from modal.simulation.forces import ActingForce, Heard, acting_forces
from modal.simulation.scheme import Recursion, Scheme, add_work
from okid.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OutputDependence:
    """The outputs by small changes of the states.

        dy = factors (C dx + sum G (by_now R dx + by_next R dx one time on))

    Attributes:
        C: (n_outputs, n_states).
        acting: The forces.
        heard: Each as the outputs hear it.
        factors: (n_rows, n_outputs) of the sensors.
        rows: (n_rows,) times at which outputs are measured.
    """

    C: FloatArray
    acting: tuple[ActingForce, ...]
    heard: tuple[Heard, ...]
    factors: FloatArray
    rows: IndexArray

    def outputs(self, states: FloatArray) -> FloatArray:
        """Outputs (n_columns, n_rows, n_outputs) by changes (n_columns, n_times, n) of the states."""
        at_rows = states if len(self.rows) == states.shape[1] else states[:, self.rows]
        found = at_rows[:, :, : self.C.shape[1]] @ self.C.T
        for one, heard in zip(self.acting, self.heard, strict=True):
            if not one.G.any():
                continue
            force = np.einsum("ckm,mk->ck", at_rows @ one.rows.T, heard.by_now[:, self.rows])
            if heard.by_next is not None:
                following = np.minimum(self.rows + 1, states.shape[1] - 1)
                force += np.einsum("ckm,mk->ck", states[:, following] @ one.rows.T, heard.by_next[:, self.rows])
            found += force[:, :, None] * one.G
        found *= self.factors
        return found

    def at_once(self, n_all: int) -> FloatArray:
        """(n, n_outputs, n_rows) dependence on the states at the row itself."""
        found = np.zeros((n_all, *self.factors.T.shape))
        found[: self.C.shape[1]] = self.C.T[:, :, None]
        for one, heard in zip(self.acting, self.heard, strict=True):
            by_state = np.tensordot(one.rows.T, heard.by_now[:, self.rows], axes=(1, 0))
            found += by_state[:, None, :] * one.G[:, None]
        return np.asarray(found * self.factors.T)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StepDependence:
    """The linearised steps; those from the last time of a record lead nowhere and mean nothing.

    Attributes:
        rows: R (n_coordinates, n), of all forces.
        columns: U (n, n_lines), of all forces.
        back: Q (n_lines, n_coordinates, n_times).
        transitions: M (n, n, n_times): `transitions[i, j]` is state i one time on by state j; broadcast over the times
            where all steps are alike.
        firsts: Index of the first time of each record, and n_times at the end.
    """

    rows: FloatArray
    columns: FloatArray
    back: FloatArray
    transitions: FloatArray
    firsts: tuple[int, ...]

    def recursion(self) -> Recursion:
        """What leads from time to time."""
        return Recursion.of(self.transitions, self.firsts)

    def advance(self, forcing: FloatArray) -> FloatArray:
        """(I - U K1 R)^-1 applied to forcings (n_columns, <= n_times, n) that stand at the times they lead from."""
        n_columns, n_times, n = forcing.shape
        if not self.rows.size or not forcing.size:
            return forcing
        seen = (self.rows @ forcing.reshape(-1, n).T).reshape(len(self.rows), n_columns, n_times)
        lines = np.einsum("rmt,mct->rct", self.back[:, :, :n_times], seen)
        return forcing + (lines.reshape(-1, n_columns * n_times).T @ self.columns.T).reshape(forcing.shape)


def _step_dependence(
    A: FloatArray,
    acting: tuple[ActingForce, ...],
    firsts: tuple[int, ...],
    *,
    correction: FloatArray | None = None,
) -> StepDependence:
    """The linearised steps.

    Args:
        A: (n, n) of the plant, zero for the effects' own states.
        acting: The forces along the trajectory.
        firsts: Index of the first time of each record, and n_times at the end.
        correction: (n, n, n_times) what an observer adds to A, (n, n, 1) where that is always the same; None for a free
            run.

    Raises:
        numpy.linalg.LinAlgError: Where a step has no unique end.
    """
    n, n_times = len(A), firsts[-1]
    if not acting:
        return StepDependence(
            rows=np.zeros((0, n)),
            columns=np.zeros((n, 0)),
            back=np.zeros((0, 0, n_times)),
            transitions=np.broadcast_to(
                A[:, :, None] if correction is None else A[:, :, None] + correction, (n, n, n_times)
            ),
            firsts=firsts,
        )
    rows, columns = np.concatenate([one.rows for one in acting]), np.hstack([one.columns for one in acting])
    sizes = [(one.rows.shape[0], one.columns.shape[1]) for one in acting]
    leads = np.ones(n_times)
    leads[np.array(firsts[1:]) - 1] = 0.0
    K1 = np.zeros((columns.shape[1], len(rows), n_times))
    before = np.zeros((columns.shape[1], n, n_times))
    row = line = 0
    for one, (n_rows, n_lines) in zip(acting, sizes, strict=True):
        K1[line : line + n_lines, row : row + n_rows] = (leads * one.by_after).transpose(1, 0, 2)
        flat = (one.rows.T @ one.by_before.reshape(n_rows, -1)).reshape(n, n_lines, n_times)
        before[line : line + n_lines] = flat.transpose(1, 0, 2)
        row, line = row + n_rows, line + n_lines
    implicit = -(rows @ columns).T @ K1
    implicit[np.arange(line), np.arange(line)] += 1.0
    inverse = _inverse(implicit)
    back = _product(inverse, K1)
    lines = _product(inverse, before)
    whole = np.broadcast_to(A[:, :, None], (n, n, n_times)) if correction is None else A[:, :, None] + correction
    if correction is None:
        lines += (rows @ A).T @ back
    else:
        lines += _product(back, np.tensordot(rows, whole, axes=(1, 0)))
    transitions = (columns @ lines.reshape(line, -1)).reshape(n, n, n_times) + whole
    return StepDependence(rows=rows, columns=columns, back=back, transitions=transitions, firsts=firsts)


def _product(left: FloatArray, right: FloatArray) -> FloatArray:
    """Matrix products (a, b, n_times) by (b, c, n_times), time by time."""
    return np.asarray(np.einsum("abt,bct->act", left, right))


def _inverse(matrices: FloatArray) -> FloatArray:
    """Inverses (a, a, n_times), time by time, by halves (Schur complement); with pivoting where these fail."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = _halved(matrices)
    failed = np.flatnonzero(~np.isfinite(found).all(axis=(0, 1)))
    if failed.size:  # raises where a step has no unique end
        found[:, :, failed] = np.linalg.inv(matrices[:, :, failed].transpose(2, 0, 1)).transpose(1, 2, 0)
        if not np.isfinite(found).all():
            raise np.linalg.LinAlgError("a step has no unique end")
    return found


def _halved(matrices: FloatArray) -> FloatArray:
    size = len(matrices)
    if size == 1:
        return np.asarray(1.0 / matrices)
    if size == 2:
        (a, b), (c, d) = matrices
        return np.stack([np.stack([d, -b]), np.stack([-c, a])]) / (a * d - b * c)
    half = 2
    B, C = matrices[:half, half:], matrices[half:, :half]
    upper = _halved(matrices[:half, :half])
    across = _product(upper, B)
    lower = _halved(matrices[half:, half:] - _product(C, across))
    down = _product(lower, _product(C, upper))
    found = np.empty_like(matrices)
    found[half:, half:], found[half:, :half], found[:half, half:] = lower, -down, -_product(across, lower)
    found[:half, :half] = upper + _product(across, down)
    return found


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Linearisation:
    """The model about a trajectory.

    Attributes:
        states: X (n_times, n).
        acting: Each force along the trajectory.
        heard: Each force as the outputs hear it.
        steps: How each step depends on the states at both its ends.
        sensors: How the outputs depend on the states.
        free: (n_rows, n_outputs) outputs before the sensors' effects.
        outputs: (n_rows, n_outputs) outputs of the model.
        defect: (n_times, n) what each step misses; row k + 1 belongs to the step k -> k + 1, the first row of a record
            to its initial state.
        smoothing: Width of sharp laws, as a share of the motion's scale.
    """

    states: FloatArray
    acting: tuple[ActingForce, ...]
    heard: tuple[Heard, ...]
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
        initial: (n_records, n) all states at the start of each record; by default those among the unknowns.

    Raises:
        numpy.linalg.LinAlgError: Where a step has no unique end.
    """
    n, n_all, n_times = assembly.plant.n_states, states.shape[1], drive.n_times
    for i in assembly.forces:
        add_work(n_times, 2 + assembly.placements[i].n_memory)
    acting = acting_forces(assembly, unknowns, drive, scheme, states, smoothing=smoothing)
    lasts = np.array(drive.firsts[1:]) - 1
    heard = tuple(one.heard(lasts if gain is None else None) for one in acting)
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
        if not acting and len(drive.rows) == n_times and drive.present.all() and (factors == factors[0]).all():
            correction = np.zeros((n_all, n_all, 1))  # the same at all times
            correction[:n, :n, 0] = -(gain * factors[0]) @ scheme.C
        else:
            correction = np.zeros((n_all, n_all, n_times))
            correction[:n, :, drive.rows] = -np.tensordot(gain, sensors.at_once(n_all) * drive.present.T, axes=(1, 1))
    A = np.zeros((n_all, n_all))
    A[:n, :n] = scheme.Ad
    defect, begins = np.empty_like(states), list(drive.firsts[:-1])
    defect[1:] = following[:-1] - states[1:]
    defect[begins] = (unknowns.local[:, list(assembly.initial)] if initial is None else initial) - states[begins]
    return Linearisation(
        states=states,
        acting=acting,
        heard=heard,
        steps=_step_dependence(A, acting, drive.firsts, correction=correction),
        sensors=sensors,
        free=free,
        outputs=outputs,
        defect=defect,
        smoothing=smoothing,
    )


def _sensed(assembly: Assembly, unknowns: Unknowns, drive: Drive, free: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Outputs after the effects at the sensors, and the factor of each on the true output."""
    outputs = free.copy()
    factors = np.ones_like(free)
    for i in assembly.sensors:
        item = assembly.placements[i]
        values = [per_row(value, drive) for value in unknowns.values(assembly, i)]
        factor, offset = item.sensor_effect.gain(values), item.sensor_effect.offset(values, drive.time[drive.rows])
        outputs[:, item.channel] = factor * outputs[:, item.channel] + offset
        factors[:, item.channel] *= factor
    return outputs, factors
