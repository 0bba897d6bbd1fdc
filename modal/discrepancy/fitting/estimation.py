"""Fit everything unknown in a model to records: Levenberg-Marquardt on exact sensitivities, within hard bounds.

The cost is sum((y - yhat)^2 / floor) over the measured values, each record and output in units of its own noise floor,
so that a quiet record counts as much as a loud one, plus the weak priors of the linear parameters. Each iteration is
one solve of the recursion for all sensitivities; a trial starts Newton's method from the trajectory that they predict.

The level above a brim is flow / rate. In the rate it is all but flat once the brim is hard: a step of Gauss and Newton
asks for many times the rate, and the levels that it predicts lie far below the brim. In 1 / rate both are straight
lines. A step `dr` in the rate r is one of -dr / r^2 in 1 / r, which leads to r / (1 - dr / r): never negative, infinite
at dr = r, so a step goes up to a share of that. A brim that no step of the simulation can tell from a wall is one.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from modal.effects.effect import WALL
from modal.estimation.output_error import FIRST_DAMPING
from modal.simulation.assembly import Assembly, Unknowns
from modal.simulation.drive import Drive, IndexArray
from modal.simulation.forces import step_compliance
from modal.simulation.scheme import Budget, Scheme, scheme_and_slopes
from modal.simulation.trajectory import SHARP, Sensitivity, Trajectory, resting_states, sensitivity, simulate_states
from okid.arrays import TINY, BoolArray, FloatArray
from okid.display import Displayed


def bounded_step(
    gram: FloatArray,
    score: FloatArray,
    damping: float,
    *,
    at: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    reach: FloatArray,
) -> FloatArray:
    """The damped step, unknowns at a bound that it would cross held there.

    What would go further than it may reach in one step goes that far, and the others follow from that.

    Args:
        gram: (n, n) J' J.
        score: (n,) J' r.
        damping: Marquardt's, as a share of the diagonal.
        at: (n,) the unknowns.
        lower: (n,) hard bounds.
        upper: (n,) likewise.
        reach: (n,) longest step upwards, not negative; infinite for most unknowns.

    Returns:
        (n,) the step.

    Example:
        >>> far = np.full(2, np.inf)
        >>> gram, score = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([4.0, 2.0])
        >>> bounded_step(gram, score, 0.0, at=np.zeros(2), lower=-far, upper=far, reach=np.array([1.0, np.inf]))
        array([1. , 0.5])
    """
    scale = np.sqrt(np.maximum(np.diag(gram), TINY))
    scaled = gram / np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] = 1.0 + damping
    free = scale > 1e-140
    step, pinned = np.zeros(len(score)), np.zeros(len(score))
    for _ in range(len(score)):
        index = np.flatnonzero(free)
        step[:] = pinned
        wanted = score[index] / scale[index] - scaled[index] @ (pinned * scale)
        step[index] = _solve(scaled[np.ix_(index, index)], wanted) / scale[index]
        beyond = free & (step > reach)
        if beyond.any():
            free &= ~beyond
            pinned[beyond] = reach[beyond]
            continue
        crossing = free & ((at + step < lower) | (at + step > upper))
        if not crossing.any():
            return step
        held = np.clip(at, lower, upper) - at
        stuck = crossing & (((at <= lower) & (step < 0.0)) | ((at >= upper) & (step > 0.0)))
        if not stuck.any():
            bound = np.clip(at + step, lower, upper) - at
            return np.where(crossing, bound, step)
        free &= ~stuck
        pinned[stuck] = held[stuck]
    return step


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    try:
        return np.asarray(scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix), right))
    except scipy.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-12)[0])


REACH = 0.9
"""Lengthen no step beyond this share of the size: it makes a limit ten times as hard."""


def walls(assembly: Assembly, unknowns: Unknowns, dt: float) -> FloatArray:
    """(n_common,) the sizes at which hard limits are walls for steps of `dt`; infinite for all other unknowns."""
    found = np.full(assembly.n_common, np.inf)
    for i in assembly.forces:
        effect, port = assembly.placements[i].force_and_port
        if not effect.is_brim:
            continue
        compliance = step_compliance(assembly.plant, port, unknowns.directions(assembly, i), dt)
        begin = assembly.common_of(i).start
        for position, j in enumerate(assembly.placements[i].common):
            if effect.parameters[j].role == "amplitude" and compliance > 0.0:
                found[begin + position] = WALL / compliance
    return found


def reach_of(common: FloatArray, walls: FloatArray) -> FloatArray:
    """(n_common,) the longest step upwards: of a hard limit a share of its size, none at the wall; else infinite.

    A limit of no size yet goes as far as it likes.
    """
    found = np.full(len(common), np.inf)
    hard = np.isfinite(walls) & (common > 0.0)
    found[hard] = np.where(common[hard] < walls[hard], REACH * common[hard], 0.0)
    return found


def moved_by_reciprocals(common: FloatArray, step: FloatArray, walls: FloatArray) -> FloatArray:
    """The common unknowns after a step, sizes of hard limits moved in their reciprocal.

    Args:
        common: (n_common,) before.
        step: (n_common,) the step; within the reach of each (`reach_of`).
        walls: (n_common,) the sizes at which hard limits are walls; infinite for what is none.

    Returns:
        (n_common,) after.

    Example:
        >>> moved_by_reciprocals(np.array([2.0, 2.0, 2.0]), np.ones(3), np.array([np.inf, 1e4, 3.0]))
        array([3., 4., 3.])
    """
    after = common + step
    hard = np.isfinite(walls) & (common > 0.0)
    share = np.minimum(step[hard] / common[hard], REACH)
    after[hard] = np.minimum(common[hard] / (1.0 - share), walls[hard])
    return after


STANDSTILL = 1e-4
"""End a fit after an iteration that lowers the cost by less than this share of it."""
FAR_ABOVE = 10.0
"""Trust neither a likelihood of white noise nor a step along a wrong motion above this mean square in units of the
floor."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Problem:
    """Records to fit.

    Attributes:
        drive: The records.
        floor: (n_records, n_outputs) noise variance.
        free_common: Whether the common unknowns are fitted; False on held-out records, where only each record's own
            initial state and phases are.
    """

    drive: Drive
    floor: FloatArray
    free_common: bool = True

    @property
    def upsampling(self) -> int:
        """Steps of the simulation per sample."""
        return int(self.drive.rows[1]) if len(self.drive.rows) > 1 else 1

    @property
    def weights(self) -> FloatArray:
        """(n_rows, n_outputs) 1 / deviation, zero where a value is missing."""
        spread = np.repeat(self.floor, np.diff(self.drive.row_firsts), axis=0)
        return np.where(self.drive.present, 1.0 / np.sqrt(spread), 0.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Estimate(Displayed):
    """A fitted model.

    Attributes:
        assembly: The plant and its effects.
        unknowns: The estimate.
        trajectory: Its simulation.
        scheme: Matrices of one step.
        slopes: Their derivatives.
        cost: Sum of the weighted squares, priors included.
        squares: Sum of the weighted squares of the residual alone.
        mean_square: (n_records, n_outputs) mean square of the residual in units of the floor.
        at_bounds: (n_common,) whether an unknown sits on a hard bound.
        iterations: Number of iterations.
        gain: Observer gain, None for a free run.
        smoothing: Smoothing of sharp laws.
    """

    assembly: Assembly
    unknowns: Unknowns
    trajectory: Trajectory
    scheme: Scheme
    slopes: tuple[Scheme, ...]
    cost: float
    squares: float
    mean_square: FloatArray
    at_bounds: BoolArray
    iterations: int
    gain: FloatArray | None
    smoothing: float

    @property
    def level(self) -> float:
        """Mean square of the residual in units of the floor, over all records and outputs alike."""
        return float(np.nanmean(self.mean_square))


def weights_along(problem: Problem, trajectory: Trajectory) -> FloatArray:
    """(n_rows, n_outputs) 1 / deviation, zero where a value is missing or the drive behind it is not known."""
    return np.where(trajectory.drive.present, problem.weights, 0.0)


def weighted_residual(problem: Problem, trajectory: Trajectory) -> FloatArray:
    """(n_rows, n_outputs) residual in units of the noise's deviation, zero where nothing is known."""
    return np.asarray((problem.drive.outputs - trajectory.outputs) * weights_along(problem, trajectory))


def simulate_at(
    assembly: Assembly,
    unknowns: Unknowns,
    problem: Problem,
    *,
    states: FloatArray | None = None,
    gain: FloatArray | None = None,
    smoothing: float = SHARP,
    start: Literal["far", "near"] = "far",
) -> Estimate | None:
    """The model at given values, as an estimate that was not fitted; None where it cannot be simulated."""
    scheme, slopes = scheme_and_slopes(assembly.plant, unknowns.common[: assembly.n_linear], problem.drive.dt)
    begun = resting_states(assembly, problem.drive) if states is None else states
    trajectory = simulate_states(
        assembly, unknowns, problem.drive, scheme, begun, smoothing=smoothing, gain=gain, start=start
    )
    if trajectory is None:
        return None
    residual = weighted_residual(problem, trajectory)
    with np.errstate(over="ignore", invalid="ignore"):
        squares = float(np.sum(residual**2))
    if not np.isfinite(squares):  # a motion that escapes without leaving the range of numbers
        return None
    return Estimate(
        assembly=assembly,
        unknowns=unknowns,
        trajectory=trajectory,
        scheme=scheme,
        slopes=slopes,
        cost=squares + _prior_cost(assembly, unknowns),
        squares=squares,
        mean_square=_mean_square(problem, trajectory, residual),
        at_bounds=_at_bounds(assembly, unknowns, problem.drive.dt),
        iterations=0,
        gain=gain,
        smoothing=smoothing,
    )


def estimate(
    start: Estimate, problem: Problem, *, iterations: int, standstill: float = STANDSTILL, budget: Budget | None = None
) -> Estimate:
    """Fit from a simulated start.

    The best model found; the start where nothing is better.
    """
    current, damping = start, FIRST_DAMPING
    for iteration in range(iterations):
        least = standstill * max(current.cost, 1.0)
        better, damping = _better(current, problem, damping, least=least, budget=budget)
        if better is None:
            return current
        fall = current.cost - better.cost
        current = replace(better, iterations=start.iterations + iteration + 1)
        if fall <= least or _over(budget):
            return current
    return current


def _better(
    current: Estimate, problem: Problem, damping: float, *, least: float, budget: Budget | None
) -> tuple[Estimate | None, float]:
    """A better estimate, None where none is found, and the damping to go on with."""
    slopes = sensitivity_of(current, problem)
    gram, score = score_equations(current, problem, slopes)
    if not (np.isfinite(gram).all() and np.isfinite(score).all()):
        return None, damping  # along a motion that hardly stays within numbers no step is known
    for trial in range(5):  # each ten times more damped than the one before
        step = _step(current, gram, score, damping, free_common=problem.free_common)
        better = _trial(current, problem, slopes, step)
        if better is not None:
            return better, max(damping / 10.0, 1e-9)
        damping *= 10.0
        promised = 2.0 * score @ step - step @ gram @ step  # negative where a bound cut the step short
        there = current.level <= FAR_ABOVE and trial == 0 and 0.0 <= promised <= least
        if there or _over(budget):
            break
    return None, damping


def _over(budget: Budget | None) -> bool:
    return (_ENDLESS if budget is None else budget).left <= 0.0


_ENDLESS = Budget()
"""Let only the CPU time end a fit that has no budget of its own."""


def sensitivity_of(current: Estimate, problem: Problem) -> Sensitivity:
    """Derivatives by everything that is fitted to the records."""
    slopes = current.slopes if problem.free_common else ()
    return sensitivity(
        current.assembly,
        current.unknowns,
        problem.drive,
        current.trajectory,
        current.scheme,
        slopes=slopes,
        gain=current.gain,
        common=problem.free_common,
    )


def score_equations(current: Estimate, problem: Problem, slopes: Sensitivity) -> tuple[FloatArray, FloatArray]:
    """Gram matrix and score of all unknowns: the common ones first, then record by record, priors included."""
    drive, weights = problem.drive, weights_along(problem, current.trajectory)
    n_common, n_local = len(slopes.common), len(slopes.local)
    size = n_common + drive.n_records * n_local
    gram, score = np.zeros((size, size)), np.zeros(size)
    residual = weighted_residual(problem, current.trajectory)
    for record in range(drive.n_records):
        rows = drive.rows_of(record)
        columns = np.concatenate([slopes.common[:, rows], slopes.local[:, rows]])
        weighted = (columns * weights[rows]).reshape(len(columns), weights[rows].size)
        with np.errstate(over="ignore", invalid="ignore"):
            part = weighted @ weighted.T
            seen = weighted @ residual[rows].ravel()
        at = np.concatenate([np.arange(n_common), n_common + record * n_local + np.arange(n_local)]).astype(int)
        gram[np.ix_(at, at)] += part
        score[at] += seen
    if n_common:
        centre, deviation = current.assembly.prior()
        gram[np.arange(n_common), np.arange(n_common)] += deviation**-2
        score[:n_common] += (centre - current.unknowns.common) * deviation**-2
    precision = current.assembly.local_deviation() ** -2
    own = n_common + np.arange(drive.n_records * n_local)
    gram[own, own] += np.tile(precision, drive.n_records)
    score[own] -= (current.unknowns.local * precision).ravel()
    return gram, score


def _step(current: Estimate, gram: FloatArray, score: FloatArray, damping: float, *, free_common: bool) -> FloatArray:
    """The damped step within the bounds, and within the reach of hard limits."""
    at = np.zeros(len(score))
    reach = np.full(len(score), np.inf)
    own = current.unknowns.local
    at[len(at) - own.size :] = own.ravel()
    upper = np.full(len(score), np.inf)
    upper[len(at) - own.size :] = current.assembly.largest_own(own, current.trajectory.drive).ravel()
    lower = -upper
    if free_common:
        n = current.assembly.n_common
        at[:n] = current.unknowns.common
        lower[:n], upper[:n] = current.assembly.bounds()
        reach[:n] = reach_of(at[:n], walls(current.assembly, current.unknowns, current.trajectory.drive.dt))
    return bounded_step(gram, score, damping, at=at, lower=lower, upper=upper, reach=reach)


def _trial(current: Estimate, problem: Problem, slopes: Sensitivity, step: FloatArray) -> Estimate | None:
    n_common, n_local = len(slopes.common), len(slopes.local)
    n_records = problem.drive.n_records
    own = step[n_common:].reshape(n_records, n_local)
    common = current.unknowns.common
    if n_common:
        common = moved_by_reciprocals(
            common, step[:n_common], walls(current.assembly, current.unknowns, problem.drive.dt)
        )
    unknowns = Unknowns(common=common, local=current.unknowns.local + own)
    states = current.trajectory.states + np.tensordot(step[:n_common], slopes.common_states, axes=(0, 0))
    for record in range(n_records):
        times = problem.drive.times_of(record)
        states[times] += np.tensordot(own[record], slopes.local_states[:, times], axes=(0, 0))
    found = simulate_at(
        current.assembly, unknowns, problem, states=states, gain=current.gain, smoothing=current.smoothing, start="near"
    )
    return found if found is not None and found.cost < current.cost else None


def covariance(current: Estimate, problem: Problem) -> FloatArray:
    """Covariance of all unknowns at the estimate, scaled by the residual where that is above the floor.

    What is held, or sits on a hard bound, has none: the others' is that given the bound.
    """
    gram, _ = score_equations(current, problem, sensitivity_of(current, problem))
    held = held_unknowns(current)
    gram[held, :] = 0.0
    gram[:, held] = 0.0
    scale = np.sqrt(np.maximum(np.diag(gram), TINY))
    inverse = scipy.linalg.pinvh(gram / np.outer(scale, scale)) / np.outer(scale, scale)
    inverse[held, :] = 0.0
    inverse[:, held] = 0.0
    return np.asarray(inverse * max(1.0, current.level))


def held_unknowns(current: Estimate) -> IndexArray:
    """Which common unknowns are held, or sit on a hard bound."""
    lower, upper = current.assembly.bounds()
    return np.flatnonzero((lower == upper) | current.at_bounds)


def _prior_cost(assembly: Assembly, unknowns: Unknowns) -> float:
    centre, deviation = assembly.prior()
    own = unknowns.local / assembly.local_deviation()
    return float(np.sum(((unknowns.common - centre) / deviation) ** 2) + np.sum(own**2))


def _mean_square(problem: Problem, trajectory: Trajectory, residual: FloatArray) -> FloatArray:
    drive = trajectory.drive
    found = np.full(problem.floor.shape, np.nan)
    for record in range(drive.n_records):
        rows = drive.rows_of(record)
        count = drive.present[rows].sum(axis=0)
        total = np.sum(residual[rows] ** 2, axis=0)
        found[record] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return found


def _at_bounds(assembly: Assembly, unknowns: Unknowns, dt: float) -> BoolArray:
    lower, upper = assembly.bounds()
    upper = np.minimum(upper, walls(assembly, unknowns, dt))
    return np.asarray((unknowns.common <= lower) | (unknowns.common >= upper))
