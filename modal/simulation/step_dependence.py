"""How each step depends on the states at both its ends, and what that makes of the recursion.

The forces see the states through few rows R (the coordinates of their ports) and enter through few columns U, so

    dX[k+1] = A dX[k] + U_y dy[k] + U (K0[k] R dX[k] + K1[k] R dX[k+1])

with U_y = L of an observer (the outputs' dependence on dX[k] is dy). What is implicit is solved by a system of the size
of the lines, a few a force (Woodbury): with B[k] = A + U_y H[k]

    dX[k+1] = (I + U Q[k] R) (...)        Q = (I - K1 R U)^-1 K1        M = B + U (Q R B + (I - K1 R U)^-1 K0 R)

Times come last in all arrays, so that every product runs over them at once.
"""

from dataclasses import dataclass

import numpy as np

from modal.simulation.forces import ActingForce
from okid.arrays import FloatArray

__all__ = ["StepDependence", "step_dependence"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StepDependence:
    """The linearised steps; nothing leads on from the last time of a record.

    Attributes:
        rows: R (n_coordinates, n), of all forces.
        columns: U (n, n_lines), of all forces.
        back: Q (n_lines, n_coordinates, n_times).
        transitions: M (n, n, n_times): `transitions[i, j]` is state i one time on by state j.
    """

    rows: FloatArray
    columns: FloatArray
    back: FloatArray
    transitions: FloatArray

    def advance(self, forcing: FloatArray) -> FloatArray:
        """(I - U K1 R)^-1 applied to forcings (n_columns, n_times, n) that stand at the times they lead from."""
        n_columns, n_times, n = forcing.shape
        if not self.rows.size or not forcing.size:
            return forcing
        seen = (self.rows @ forcing.reshape(-1, n).T).reshape(len(self.rows), n_columns, n_times)
        lines = np.einsum("rmt,mct->rct", self.back, seen)
        return forcing + (lines.reshape(-1, n_columns * n_times).T @ self.columns.T).reshape(forcing.shape)


def step_dependence(
    A: FloatArray,
    acting: tuple[ActingForce, ...],
    n_times: int,
    *,
    lasts: FloatArray,
    correction: FloatArray | None = None,
) -> StepDependence:
    """The linearised steps.

    Args:
        A: (n, n) of the plant, zero for the effects' own states.
        acting: The forces along the trajectory.
        n_times: Number of times.
        lasts: (n_times,) 0 at the last time of each record, 1 elsewhere.
        correction: (n, n, n_times) what an observer adds to A; None for a free run.

    Returns:
        The dependences.

    Raises:
        numpy.linalg.LinAlgError: Where a step has no unique end.
    """
    n = len(A)
    if not acting:
        return StepDependence(
            rows=np.zeros((0, n)),
            columns=np.zeros((n, 0)),
            back=np.zeros((0, 0, n_times)),
            transitions=lasts * (A[:, :, None] if correction is None else A[:, :, None] + correction),
        )
    rows, columns = np.concatenate([one.rows for one in acting]), np.hstack([one.columns for one in acting])
    sizes = [(one.rows.shape[0], one.columns.shape[1]) for one in acting]
    K1 = np.zeros((columns.shape[1], len(rows), n_times))
    before = np.zeros((columns.shape[1], n, n_times))
    row = line = 0
    for one, (n_rows, n_lines) in zip(acting, sizes, strict=True):
        K1[line : line + n_lines, row : row + n_rows] = (lasts * one.by_after).transpose(1, 0, 2)
        flat = (one.rows.T @ one.by_before.reshape(n_rows, -1)).reshape(n, n_lines, n_times)
        before[line : line + n_lines] = flat.transpose(1, 0, 2)
        row, line = row + n_rows, line + n_lines
    implicit = np.einsum("rmt,mq->rqt", -K1, rows @ columns)
    implicit[np.arange(line), np.arange(line)] += 1.0
    inverse = _inverse(implicit)
    back = _product(inverse, K1)
    lines = _product(inverse, before)
    whole = np.broadcast_to(A[:, :, None], (n, n, n_times)) if correction is None else A[:, :, None] + correction
    if correction is None:
        lines += np.einsum("rmt,mj->rjt", back, rows @ A)
    else:
        lines += _product(back, np.tensordot(rows, whole, axes=(1, 0)))
    transitions = (columns @ lines.reshape(line, -1)).reshape(n, n, n_times) + whole
    return StepDependence(rows=rows, columns=columns, back=back, transitions=lasts * transitions)


def _product(left: FloatArray, right: FloatArray) -> FloatArray:
    """Matrix products (a, b, n_times) by (b, c, n_times), time by time."""
    found = left[:, :1] * right[0]
    for i in range(1, len(right)):
        found += left[:, i : i + 1] * right[i]
    return np.asarray(found)


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
