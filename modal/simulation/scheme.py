"""One step of the plant, the recursion of all steps, and a count of what its solves cost.

The flow over a step is exact for whatever drives it in a straight line over the step:

    x[k+1] = Ad x[k] + B0 u_start + B1 u_end + E0 w[k] + E1 w[k+1]

Ad = exp(A dt), and with P1 = int_0^dt exp(A s) ds and P2 = 1/dt int_0^dt exp(A (dt - s)) s ds: B0 = (P1 - P2) B,
B1 = P2 B, likewise E.

A linear recursion dx[k+1] = M[k] dx[k] + b[k+1] over a whole trajectory is a unit lower triangular system of bandwidth
2n - 1, which LAPACK's `dtbtrs` solves for all right-hand sides at once: of few states, no loop over time in Python.

What a search may cost is counted in rows of states solved along the records: unlike time, the same on every machine.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
import scipy

from modal.simulation import DIFFERENCE_STEP
from modal.simulation.plant import Plant, PlantMatrices, plant_matrices
from okid.arrays import TINY, FloatArray


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
    found, *moved = [plant_matrices(plant, point) for point in points]
    slopes = [
        _slope(above, below, 2.0 * step) for above, below, step in zip(moved[::2], moved[1::2], steps, strict=True)
    ]
    flow, flow_slopes = _flow(found.A, np.array([one.A for one in slopes]).reshape(len(slopes), *found.A.shape), dt)
    return _scheme(found, *flow), tuple(
        _scheme_slope(found, flow, one, by) for one, by in zip(slopes, zip(*flow_slopes, strict=True), strict=True)
    )


Flow = tuple[FloatArray, FloatArray, FloatArray]
"""Ad, P1 and P2 (..., n, n)."""


def _flow(A: FloatArray, directions: FloatArray, dt: float) -> tuple[Flow, Flow]:
    """The flow over a step, and its exact derivatives along directions (n_directions, n, n) of A.

    With Q(h) = int_0^h exp(A (h - s)) s ds = h^2 sum_k (A h)^k / (k + 2)!, P1 = h + A Q, Ad = 1 + A P1, of a small h,
    and over twice the time Q + Ad Q + h P1, P1 + Ad P1, Ad Ad: so often until h = dt (Higham 2008, Functions of
    Matrices, section 10.7.4, https://doi.org/10.1137/1.9780898717778), in coordinates that powers of two balance.
    """
    if not A.size:
        none = np.zeros_like(directions)
        return (A, A, A), (none, none, none)
    balanced, (size, _) = scipy.linalg.matrix_balance(A, permute=False, separate=True)
    scale = size / size[:, np.newaxis]  # of row i and column j: size[j] / size[i]
    moved = directions * scale
    most = 2.0 * dt * float(np.linalg.norm(balanced, 1))
    doublings = max(0, int(np.ceil(np.log2(max(most, TINY)))))
    h = dt / 2.0**doublings
    term, by = 0.5 * np.eye(len(A)), np.zeros_like(moved)
    Q, Q_by = term.copy(), by.copy()
    for k in range(1, 14):  # up to half a unit of A h: the next is below 1e-16 of the first
        by = (by @ balanced + term @ moved) * (h / (k + 2))
        term = term @ balanced * (h / (k + 2))
        Q, Q_by = Q + term, Q_by + by
    Q, Q_by = h**2 * Q, h**2 * Q_by
    P1, P1_by = h * np.eye(len(A)) + balanced @ Q, moved @ Q + balanced @ Q_by
    Ad, Ad_by = np.eye(len(A)) + balanced @ P1, moved @ P1 + balanced @ P1_by
    for _ in range(doublings):
        Q_by = Q_by + Ad_by @ Q + Ad @ Q_by + h * P1_by
        Q = Q + Ad @ Q + h * P1
        P1_by, P1 = P1_by + Ad_by @ P1 + Ad @ P1_by, P1 + Ad @ P1
        Ad_by, Ad = Ad_by @ Ad + Ad @ Ad_by, Ad @ Ad
        h *= 2.0
    return (Ad / scale, P1 / scale, Q / dt / scale), (Ad_by / scale, P1_by / scale, Q_by / dt / scale)


def _scheme(matrices: PlantMatrices, Ad: FloatArray, P1: FloatArray, P2: FloatArray) -> Scheme:
    B, E, P0 = matrices.B, matrices.E, P1 - P2
    return Scheme(Ad=Ad, B0=P0 @ B, B1=P2 @ B, E0=P0 @ E, E1=P2 @ E, C=matrices.C, D=matrices.D, G=matrices.G)


def _scheme_slope(matrices: PlantMatrices, flow: Flow, slope: PlantMatrices, by: Flow) -> Scheme:
    """By a parameter, of which `slope` and `by` are the derivatives of the matrices and of the flow."""
    held, moved = _scheme(slope, *flow), _scheme(matrices, *by)
    both = {name: getattr(held, name) + getattr(moved, name) for name in ("B0", "B1", "E0", "E1")}
    return replace(held, Ad=by[0], **both)


def _slope(above: PlantMatrices, below: PlantMatrices, width: float) -> PlantMatrices:
    names = [one.name for one in fields(PlantMatrices)]
    return PlantMatrices(**{name: (getattr(above, name) - getattr(below, name)) / width for name in names})


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


BY_PRODUCTS = 8
"""Go from time to time by matrix products from so many states on: a band has twice as many diagonals, and every column
reads it anew (20 states, 40 columns: 8 times longer, 60 states: 15 times; 6 states: as long)."""
TIMES_AT_ONCE = 64
"""Turn so many times at once, so that what a product reads and writes lies together, in cache."""
BAND_VALUES = 250_000
"""Keep a band of so many values where all steps are alike, and use it again for each stretch of a record."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Recursion:
    """dx[k+1] = M[k] dx[k] + b[k+1] along records laid end to end, which do not touch.

    Attributes:
        transitions: M (n, n, n_times); `transitions[:, :, k]` leads from time k to k + 1. One that is the same at all
            times may be broadcast over them, and takes no room.
        firsts: Index of the first time of each record, and n_times at the end.
        band: (2 n, n_times_of_a_piece n) in LAPACK's lower band storage, of a piece of a record where all steps are
            alike, else of all; None where products are quicker.
    """

    transitions: FloatArray
    firsts: tuple[int, ...]
    band: FloatArray | None

    @classmethod
    def of(cls, transitions: FloatArray, firsts: tuple[int, ...]) -> "Recursion":
        """Of (n, n, n_times) transitions; those from the last times of records are not used."""
        n, _, n_times = transitions.shape
        if not 0 < n < BY_PRODUCTS:
            return cls(transitions=transitions, firsts=firsts, band=None)
        if _steady(transitions):
            longest = min(n_times, max(2, BAND_VALUES // (2 * n * n)))
            return cls(transitions=transitions, firsts=firsts, band=_band(transitions[:, :, :longest], [longest - 1]))
        return cls(transitions=transitions, firsts=firsts, band=_band(transitions, [one - 1 for one in firsts[1:]]))

    @property
    def steady(self) -> bool:
        """Whether all steps are alike."""
        return _steady(self.transitions)

    def solve(self, forcing: FloatArray) -> FloatArray:
        """Give dx (n_columns, n_times, n) in the place of what drives it.

        Args:
            forcing: b (n_columns, n_times, n); `forcing[:, k]` at the first time of a record is its initial state.
        """
        n_columns, n_times, n = forcing.shape
        add_work(n_times, n if n_columns else 1)
        if not forcing.size:
            return forcing
        with np.errstate(over="ignore", invalid="ignore"):  # a motion that grows beyond numbers is the caller's to see
            return self._solved(forcing)

    def _solved(self, forcing: FloatArray) -> FloatArray:
        n = forcing.shape[2]
        if self.band is None:
            for begin, end in pairwise(self.firsts):
                self._by_products(forcing, begin, end)
            return forcing
        if not self.steady:
            _solve_band(self.band, forcing)
            return forcing
        step, longest = self.transitions[:, :, 0].T, self.band.shape[1] // n
        for begin, end in pairwise(self.firsts):
            for first in range(begin, end, longest):
                if first > begin:
                    forcing[:, first] += forcing[:, first - 1] @ step
                _solve_band(self.band, forcing[:, first : min(first + longest, end)])
        return forcing

    def _by_products(self, forcing: FloatArray, begin: int, end: int) -> None:
        by_time = self.transitions.transpose(2, 1, 0)  # each as a product from the right takes it
        state = forcing[:, begin]
        led = np.empty(state.shape)
        for first in range(begin + 1, end, TIMES_AT_ONCE):
            times = slice(first, min(first + TIMES_AT_ONCE, end))
            together = np.ascontiguousarray(forcing[:, times].transpose(1, 0, 2))
            steps = by_time[first - 1 : times.stop - 1]
            for k, step in enumerate(steps if self.steady else steps.copy()):
                together[k] += np.matmul(state, step, out=led)
                state = together[k]
            forcing[:, times] = together.transpose(1, 0, 2)


def _steady(transitions: FloatArray) -> bool:
    return transitions.strides[2] == 0


def _band(transitions: FloatArray, lasts: Sequence[int]) -> FloatArray:
    """The band storage of the recursion, cut after the last times, unit diagonal included."""
    n, _, n_times = transitions.shape
    band = np.zeros((n_times, n, 2 * n))
    for row in range(n):
        for column in range(n):
            band[:, column, n + row - column] = -transitions[row, column]
    band[:, :, 0] = 1.0
    band[lasts, :, 1:] = 0.0
    return band.reshape(n_times * n, 2 * n).T


def _solve_band(band: FloatArray, forcing: FloatArray) -> None:
    """Put the solution (n_columns, n_times, n) in the place of the forcing."""
    n_columns, n_times, n = forcing.shape
    # Columns first in C order are LAPACK's right-hand sides in Fortran order: no copy.
    right = np.ascontiguousarray(forcing).reshape(n_columns, n_times * n).T
    solution, _ = scipy.linalg.lapack.dtbtrs(band[:, : n_times * n], right, uplo="L", diag="U", overwrite_b=True)
    forcing[:] = np.asarray(solution).T.reshape(forcing.shape)
