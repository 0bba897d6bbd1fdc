"""One step of the plant, the recursion of all steps as one banded solve, and a count of what the solves cost.

The flow over a step is exact for whatever drives it in a straight line over the step:

    x[k+1] = Ad x[k] + B0 u_start + B1 u_end + E0 w[k] + E1 w[k+1]

Ad = exp(A dt), and with P1 = int_0^dt exp(A s) ds and P2 = 1/dt int_0^dt exp(A (dt - s)) s ds: B0 = (P1 - P2) B,
B1 = P2 B, likewise E. All three come from one exponential (Van Loan 1978, https://doi.org/10.1109/TAC.1978.1101743).

A linear recursion dx[k+1] = M[k] dx[k] + b[k+1] over a whole trajectory is a unit lower triangular system of bandwidth
2n - 1, which LAPACK's `dtbtrs` solves for all right-hand sides at once: no loop over time in Python.

What a search may cost is counted in rows of states solved along the records: unlike time, the same on every machine.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields

import numpy as np
import scipy

from modal.simulation.plant import Plant, PlantMatrices, plant_matrices
from modal.simulation.tolerances import DIFFERENCE_STEP
from okid.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scheme:
    """Matrices of one step, or (from `scheme_and_slopes`) their derivatives by a linear parameter.

    Attributes:
        Ad: (n, n).
        B0: (n, n_inputs) for the input at the start of the step.
        B1: (n, n_inputs) for the input at its end.
        E0: (n, n_forces) for the force at the start.
        E1: (n, n_forces) for the force at the end.
        C: (n_outputs, n).
        D: (n_outputs, n_inputs).
        G: (n_outputs, n_forces).
    """

    Ad: FloatArray
    B0: FloatArray
    B1: FloatArray
    E0: FloatArray
    E1: FloatArray
    C: FloatArray
    D: FloatArray
    G: FloatArray


def scheme_and_slopes(plant: Plant, linear: FloatArray, dt: float) -> tuple[Scheme, tuple[Scheme, ...]]:
    """The scheme at `linear`, and its derivative by each linear parameter."""
    steps = [DIFFERENCE_STEP * max(parameter.deviation, abs(parameter.nominal)) for parameter in plant.parameters]
    points = [linear]
    for j, step in enumerate(steps):
        for sign in (1.0, -1.0):
            point = linear.copy()
            point[j] += sign * step
            points.append(point)
    matrices = [plant_matrices(plant, point) for point in points]
    flows = _flows(np.stack([item.A for item in matrices]), dt)
    schemes = [_scheme(item, *flow) for item, flow in zip(matrices, zip(*flows, strict=True), strict=True)]
    slopes = tuple(_slope(schemes[2 * j + 1], schemes[2 * j + 2], 2.0 * step) for j, step in enumerate(steps))
    return schemes[0], slopes


def _flows(A: FloatArray, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    n_points, n, _ = A.shape
    block = np.zeros((n_points, 3 * n, 3 * n))
    block[:, :n, :n] = A * dt
    block[:, :n, n : 2 * n] = np.eye(n) * dt
    block[:, n : 2 * n, 2 * n :] = np.eye(n)
    whole = scipy.linalg.expm(block) if n else block
    return whole[:, :n, :n], whole[:, :n, n : 2 * n], whole[:, :n, 2 * n :]


def _scheme(matrices: PlantMatrices, Ad: FloatArray, P1: FloatArray, P2: FloatArray) -> Scheme:
    B, E, P0 = matrices.B, matrices.E, P1 - P2
    return Scheme(Ad=Ad, B0=P0 @ B, B1=P2 @ B, E0=P0 @ E, E1=P2 @ E, C=matrices.C, D=matrices.D, G=matrices.G)


def _slope(above: Scheme, below: Scheme, width: float) -> Scheme:
    return Scheme(**{one.name: (getattr(above, one.name) - getattr(below, one.name)) / width for one in fields(Scheme)})


OVERHEAD = 3000
"""Count a solve as so many rows of one state beside its own: a march in windows of a few steps is not cheap."""

SHORT = 33_000
"""Count records as longer by so many rows of states: short ones are hardly cheaper, because calls cost most."""

SHARE_OF_A_STAGE = 0.7
"""Let a model's fits in observer form cost this share of what is left for it; of the rest, its free runs."""

_done: ContextVar[float] = ContextVar("work done", default=0.0)
_deadline: ContextVar[float] = ContextVar("CPU time at which all budgets end", default=np.inf)


@contextmanager
def cpu_seconds(most: float | None) -> Iterator[None]:
    """Let every budget within end after so many CPU seconds of this process; None for no such end."""
    token = _deadline.set(np.inf if most is None else time.process_time() + most)
    try:
        yield
    finally:
        _deadline.reset(token)


def add_work(n_times: int, n_states: int) -> None:
    """Count one solve of a linear recursion."""
    _done.set(_done.get() + n_times * n_states + OVERHEAD)


def simulation_work(n_times: int, n_states: int) -> float:
    """What a simulation along records counts, by and large."""
    return float(n_times * n_states + SHORT)


def work_done() -> float:
    """What this thread has solved so far, in rows of states."""
    return _done.get()


class Budget:
    """An amount of work from now on, and whether anything was left undone for want of it.

    It remembers, so that who decides at last knows what a search deep below had to leave: one object for all searches
    of a model along the same records.

    Args:
        work: In rows of states, as `work_done`; unlimited unless given.
        whole: What is marked as well where this one is not enough.

    Example:
        >>> budget = Budget(1000.0)
        >>> budget.allows(), budget.spent
        (True, False)
        >>> add_work(n_times=4000, n_states=2)
        >>> budget.allows(), budget.spent
        (False, True)
    """

    def __init__(self, work: float = np.inf, *, whole: "Budget | None" = None) -> None:
        self._end = work_done() + work
        self._whole = whole
        self._untried, self._spent = np.inf, False

    @property
    def spent(self) -> bool:
        """Whether anything was left undone."""
        return self._spent

    @property
    def untried(self) -> float:
        """Effects of the smallest models that were left untried and might matter; infinite where there are none."""
        return self._untried

    @property
    def left(self) -> float:
        """Work left; none once the CPU time is spent."""
        end = _deadline.get()
        if end < np.inf and time.process_time() >= end:
            return 0.0
        return max(self._end - work_done(), 0.0)

    def allows(self) -> bool:
        """Whether there is work left; who asks and gets False leaves something undone."""
        if self.left > 0.0:
            return True
        self.refuse()
        return False

    def part(self, share: float) -> "Budget":
        """A share of what is left now, on its own."""
        return Budget(share * self.left)

    def stage(self) -> "Budget":
        """The share of a stage of what is left now; where it is not enough, the whole is marked as well."""
        return Budget(SHARE_OF_A_STAGE * self.left, whole=self)

    def refuse(self, size: float = 0.0) -> None:
        """Mark that something is left undone."""
        self._spent = True
        self._untried = min(self._untried, size)
        if self._whole is not None:
            self._whole.refuse(size)


def band_of(transitions: FloatArray) -> FloatArray:
    """The band storage of the recursion.

    Args:
        transitions: M (n, n, n_times); `transitions[:, :, k]` leads from time k to k + 1, the last one is not used.
            Zeros at the last time of a record cut the recursion there.

    Returns:
        (2 n, n_times n) in LAPACK's lower band storage, unit diagonal included.
    """
    n, _, n_times = transitions.shape
    if n == 0:  # nothing is led on
        return np.zeros((0, 0))
    band = np.zeros((n_times, n, 2 * n))
    for row in range(n):
        for column in range(n):
            band[:, column, n + row - column] = -transitions[row, column]
    band[:, :, 0] = 1.0
    band[-1, :, 1:] = 0.0
    return band.reshape(n_times * n, 2 * n).T


def solve_band(band: FloatArray, forcing: FloatArray) -> FloatArray:
    """Solve the recursion for several forcings.

    Args:
        band: From `band_of`.
        forcing: b (n_columns, n_times, n); `forcing[:, 0]` are the initial states.

    Returns:
        dx (n_columns, n_times, n).
    """
    n_columns, n_times, n = forcing.shape
    if n == 0 or n_columns == 0:
        add_work(n_times, 1)
        return forcing
    add_work(n_times, n)
    # Columns first in C order are LAPACK's right-hand sides in Fortran order: no copy.
    right = np.ascontiguousarray(forcing).reshape(n_columns, n_times * n).T
    solution, _ = scipy.linalg.lapack.dtbtrs(band, right, uplo="L", diag="U")
    return np.asarray(solution).T.reshape(n_columns, n_times, n)
