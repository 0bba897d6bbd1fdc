"""A force law by itself over what it is drawn against, and beside it a force free of any form, in bins.

Where the law found has the right form one linear step is enough. Where it has not, the motion that it makes is wrong as
well, and so is a response linearised about that motion; so the step is taken, the model simulated anew with law and
bins, and the next step starts there.

For what the data say of a law in bins of its motion, free of its form, the law is held as found and a smooth function
of the motion, given by its values in the bins, is added to it. These values are fitted with everything else unknown in
the model left free; the parameters of the law itself are not, so that the bins take up the whole departure of the data
from it. With F0 the Gram matrix of the responses to the bins, F what the other unknowns leave of it and s the score,

    F v = lambda F0 v, v' F0 v = 1        addition = sum over lambda >= 0.01 of v v' s / lambda

A direction with a small lambda cannot be told from the rest of the model: a force in proportion to the motion from a
wrong stiffness or damping, under accelerometers a constant force. There the points follow the law as found; in all
others they are free. So the points are what acts beyond the calibrated linear model. With P = sum of v v' F0 the
projection on what can be told, L the law's derivative by its parameters and Q their covariance, the points' covariance
about the true law is

    P S P' - P L Q L' P' + L Q L'        S = sum of v v' / lambda

that of the departure, less what the law's own fit explains of it, and that of the law.

References:
    Larsen, McCleary, The use of partial residual plots in regression analysis, Technometrics 14(3), 1972,
    https://doi.org/10.1080/00401706.1972.10488966 (points of a component with the others fitted); Worden, Tomlinson,
    Nonlinearity in Structural Dynamics, 2001, chapter 7 (restoring force surfaces).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy

from modal.discrepancy.fitting.estimation import (
    Estimate,
    Problem,
    score_equations,
    simulate_at,
    weighted_residual,
    weights_along,
)
from modal.discrepancy.selection.lack_of_fit import INDISTINCT
from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Values
from modal.simulation import DIFFERENCE_STEP
from modal.simulation.assembly import EffectPlacement, Unknowns, drive_inputs
from modal.simulation.drive import Drive
from modal.simulation.trajectory import Sensitivity, Source, respond, sensitivity
from okid.arrays import ROUNDED, TINY, FloatArray

IndexArray = npt.NDArray[np.intp]

N_BINS = 12
"""Cut a motion into so many bins."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Bins:
    """Bins of a motion.

    Attributes:
        knots: (m,) centres, rising.
        period: Length after which the motion repeats; 0 for none.
    """

    knots: FloatArray
    period: float = 0.0

    def hats(self, motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Smooth hats (n, m) and their slopes: the natural cubic spline that is 1 at one knot and 0 at all others.

        Beyond the outer knots they go on straight. Straight hats would lie on the wrong side of a curved force: over
        a parabola their values in the outer bins come out several per cent too small.
        """
        heights = np.eye(len(self.knots))
        if self.period:
            knots = np.append(self.knots, self.knots[0] + self.period)
            at = np.mod(motion - knots[0], self.period) + knots[0]
            return _spline(knots, np.concatenate([heights, heights[:1]]), at, periodic=True)
        at = np.clip(motion, self.knots[0], self.knots[-1])
        values, rise = _spline(self.knots, heights, at, periodic=False)
        return values + rise * (motion - at)[:, None], rise


def _spline(knots: FloatArray, heights: FloatArray, at: FloatArray, *, periodic: bool) -> tuple[FloatArray, FloatArray]:
    """Values (n, m) and slopes of the cubic splines through heights (n_knots, m), without curvature at the ends.

    A periodic spline goes on smoothly from its last knot to its first. The curvatures M at the knots follow from equal
    slopes on both sides of each, h(i-1) M(i-1) + 2 (h(i-1) + h(i)) M(i) + h(i) M(i+1) = 6 (r(i) - r(i-1)) with widths h
    and rises r of the intervals (de Boor, A Practical Guide to Splines, 2001, chapter 4).
    """
    widths = np.diff(knots)
    rises = np.diff(heights, axis=0) / widths[:, None]
    n = len(widths)
    system, right = np.zeros((n, n)), 6.0 * (rises - np.roll(rises, 1, axis=0))
    for i in range(n):  # knot i, between the intervals i - 1 and i
        system[i, i] += 2.0 * (widths[i - 1] + widths[i])
        system[i, i - 1] += widths[i - 1]
        system[i, (i + 1) % n] += widths[i]
    curvatures = np.zeros_like(heights)
    if periodic:
        curvatures[:-1] = np.linalg.solve(system, right)
        curvatures[-1] = curvatures[0]
    else:
        curvatures[1:-1] = np.linalg.solve(system[1:, 1:], right[1:])
    bends = np.diff(curvatures, axis=0) / widths[:, None]
    starts = rises - widths[:, None] * (curvatures[:-1] / 3.0 + curvatures[1:] / 6.0)
    at_left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, n - 1)
    x = (at - knots[at_left])[:, None]
    start, curvature, bend = starts[at_left], curvatures[at_left], bends[at_left]
    values = heights[at_left] + x * (start + x * (curvature / 2.0 + x * bend / 6.0))
    return values, start + x * (curvature + x * bend / 2.0)


def bins_of(motion: FloatArray, *, n_bins: int = N_BINS, period: float = 0.0) -> Bins | None:
    """Bins between the extremes of a motion, half by its quantiles and half even; None where nothing moves.

    Quantiles alone would leave two bins for the outer two thirds of a Gaussian motion's reach.

    Example:
        >>> bins_of(np.linspace(-1.0, 1.0, 201), n_bins=5).knots
        array([-1. , -0.5,  0. ,  0.5,  1. ])
    """
    if period > 0.0:
        return Bins(knots=np.arange(n_bins) * period / n_bins, period=period)
    low, high = float(motion.min(initial=np.inf)), float(motion.max(initial=-np.inf))
    if not high > low or (high - low) <= ROUNDED * max(abs(low), abs(high)):
        return None
    shares = np.linspace(0.0, 1.0, n_bins)
    return Bins(knots=0.5 * (np.quantile(motion, shares) + low + shares * (high - low)))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Told:
    """What normal equations say of the bins of a law.

    Attributes:
        added: (m,) step of the bins' values.
        others: (k,) step of the other unknowns that goes with it.
        scatter: (m, m) covariance of `added` for unit noise.
        project: (m, m) P, on what can be told from the rest of the model.
        fall: What the step takes away of the sum of squares.
    """

    added: FloatArray
    others: FloatArray
    scatter: FloatArray
    project: FloatArray
    fall: float

    def deviation(self, by_parameter: FloatArray, spread: FloatArray, fitted: Estimate, squares: float) -> FloatArray:
        """(m,) standard deviation of law and addition together about the true law.

        Args:
            by_parameter: (m, p) derivative of the law in each bin by the parameters that all records share.
            spread: (p, p) their covariance.
            fitted: The model with its law as found.
            squares: Sum of squares that is left with the bins: the noise is taken from it, not from what a law of the
                wrong form leaves.
        """
        level = max(1.0, fitted.level * squares / max(fitted.squares, TINY))
        law = by_parameter @ spread @ by_parameter.T * (level / max(1.0, fitted.level))
        departure = np.diag(level * self.scatter - self.project @ law @ self.project.T)
        return np.asarray(np.sqrt(np.maximum(departure, 0.0) + np.maximum(np.diag(law), 0.0)))


def told_by(gram: FloatArray, score: FloatArray, bins: IndexArray, others: IndexArray) -> Told:
    """Solve normal equations for the bins with the other unknowns free.

    Args:
        gram: (n, n) Gram matrix.
        score: (n,).
        bins: (m,) where the bins stand.
        others: (k,) where the other unknowns stand; what stands in neither keeps its value.
    """
    scale = np.sqrt(np.maximum(np.diag(gram), TINY))
    scaled, seen = gram / np.outer(scale, scale), score / scale
    inverse = scipy.linalg.pinvh(scaled[np.ix_(others, others)])
    cross = scaled[np.ix_(bins, others)]
    left = scaled[np.ix_(bins, bins)] - cross @ inverse @ cross.T
    metric = scaled[np.ix_(bins, bins)] + ROUNDED * np.eye(len(bins))
    share, directions = scipy.linalg.eigh(left, metric)
    told = share >= INDISTINCT
    share, directions = share[told], directions[:, told]
    along = directions.T @ (seen[bins] - cross @ inverse @ seen[others])
    added = directions @ (along / share)
    size = scale[bins]
    return Told(
        added=added / size,
        others=inverse @ (seen[others] - cross.T @ added) / scale[others],
        scatter=(directions / share) @ directions.T / np.outer(size, size),
        project=(directions @ directions.T @ metric) * size / size[:, None],
        fall=float(np.sum(along**2 / share)),
    )


def derivatives(fitted: Estimate, problem: Problem) -> Sensitivity:
    """Derivatives by everything unknown at the estimate."""
    return sensitivity(
        fitted.assembly,
        fitted.unknowns,
        problem.drive,
        fitted.trajectory,
        fitted.scheme,
        slopes=fitted.slopes,
        gain=fitted.gain,
    )


def unknowns_but(fitted: Estimate, placements: list[int]) -> IndexArray:
    """Indices of all unknowns but the parameters, directions and values of each record of some placements."""
    assembly, (n_records, n_local) = fitted.assembly, fitted.unknowns.local.shape
    held: list[int] = []
    for placement in placements:
        common, local = assembly.common_of(placement), assembly.local_of(placement)
        held += range(common.start, common.stop)
        for record in range(n_records):
            first = assembly.n_common + record * n_local
            held += range(first + local.start, first + local.stop)
    return np.setdiff1d(np.arange(assembly.n_common + n_records * n_local), held)


def told_by_sources(fitted: Estimate, problem: Problem, placement: int, sources: list[Source]) -> Told:
    """What the data say of bins whose hats act as these sources: exact where they act linearly (inputs, sensors)."""
    slopes = derivatives(fitted, problem)
    gram, score = score_equations(fitted, problem, slopes)
    _, outputs = respond(fitted.assembly, fitted.unknowns, fitted.trajectory, sources, len(sources), gain=fitted.gain)
    weights = weights_along(problem, fitted.trajectory)
    columns = outputs * weights
    flat = columns.reshape(len(columns), -1)
    parts = [flat @ (slopes.common * weights).reshape(len(slopes.common), -1).T]
    for record in range(problem.drive.n_records):
        rows = problem.drive.rows_of(record)
        local = (slopes.local[:, rows] * weights[rows]).reshape(len(slopes.local), -1)
        parts.append(columns[:, rows].reshape(len(columns), -1) @ local.T)
    cross = np.concatenate(parts, axis=1)
    whole = np.block([[gram, cross.T], [cross, flat @ flat.T]])
    seen = np.concatenate([score, flat @ weighted_residual(problem, fitted.trajectory).ravel()])
    return told_by(whole, seen, len(score) + np.arange(len(sources)), unknowns_but(fitted, [placement]))


def drive_before(fitted: Estimate, problem: Problem, placement: int) -> Drive:
    """The drive as it reaches an effect at an input: after the effects before it."""
    earlier = replace(fitted.assembly, placements=fitted.assembly.placements[:placement])
    return drive_inputs(earlier, fitted.unknowns, problem.drive)


def input_sources(fitted: Estimate, placement: int, before: Drive, bins: Bins) -> list[Source]:
    """What a unit of each bin's hat, added to the input behind the effect, does by itself."""
    channel = fitted.assembly.placements[placement].channel
    hats = [bins.hats(signal[:, channel])[0] for signal in (before.start, before.end, before.sample)]
    found = []
    for bin_ in range(len(bins.knots)):
        slopes = np.zeros((3, *before.start.shape))
        for k in range(3):
            slopes[k, :, channel] = hats[k][:, bin_]
        found.append(_source(fitted, *_carried(fitted, placement, before, slopes)))
    return found


def _carried(
    fitted: Estimate, placement: int, before: Drive, slopes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Changes behind the effect, carried through the effects after it on the same input by central differences."""
    assembly = fitted.assembly
    channel = assembly.placements[placement].channel
    if not any(i > placement and assembly.placements[i].channel == channel for i in assembly.inputs):
        return slopes[0], slopes[1], slopes[2]
    first = replace(assembly, placements=assembly.placements[: placement + 1])
    behind = drive_inputs(first, fitted.unknowns, before, first=placement)
    size = DIFFERENCE_STEP * max(float(np.abs(behind.sample).max()), TINY)
    after = []
    for step in (size, -size):
        moved = replace(
            behind,
            start=behind.start + step * slopes[0],
            end=behind.end + step * slopes[1],
            sample=behind.sample + step * slopes[2],
        )
        last = drive_inputs(assembly, fitted.unknowns, moved, first=placement + 1)
        after.append((last.start, last.end, last.sample))
    start, end, sample = ((above - below) / (2.0 * size) for above, below in zip(*after, strict=True))
    return start, end, sample


def _source(fitted: Estimate, start: FloatArray, end: FloatArray, sample: FloatArray) -> Source:
    """What a change of the drive does: to the plant, and to the forces at ports that the inputs move."""
    assembly, scheme, about = fitted.assembly, fitted.scheme, fitted.trajectory.linearisation
    rows, n = fitted.trajectory.drive.rows, assembly.plant.n_states
    flow = np.zeros_like(about.states)
    flow[:, :n] = start @ scheme.B0.T + end @ scheme.B1.T
    outputs = sample[rows] @ scheme.D.T
    for position, i in enumerate(assembly.forces):
        port, force = assembly.placements[i].port, about.acting[position].force
        if port is None or assembly.placements[i].channel >= 0:
            continue
        moved = np.zeros(len(flow))
        if port.displacement is not None:
            moved += force.by_displacement * (sample @ port.displacement[n:])
        if port.velocity is not None:
            moved += force.by_velocity * (sample @ port.velocity[n:])
        columns, direction = list(port.columns), fitted.unknowns.directions(assembly, i)
        flow[:, :n] += moved[:, None] * (scheme.E0[:, columns] @ direction)
        flow[:-1, :n] += moved[1:, None] * (scheme.E1[:, columns] @ direction)
        outputs = outputs + moved[rows, None] * about.acting[position].G
    return Source(flow=flow, outputs=outputs)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Reading:
    """What a force law is drawn against.

    Attributes:
        against: What it is.
        period: Period of a law at one frequency [s], 0 for none.
        at_displacement: Displacement at which a law of time is drawn; 1 where it does not read it.
        scaled: Whether it reads the displacement as well as the time.
    """

    against: Literal["displacement", "velocity", "time"]
    period: float = 0.0
    at_displacement: float = 1.0
    scaled: bool = False


def still_motion(item: EffectPlacement, n: int) -> Motion:
    """(n,) samples of no motion at a force's place, where laws are not smoothed."""
    port = item.port
    stiffness = None if port is None else port.stiffness
    mass = None if port is None else port.mass
    zeros = np.zeros(n)
    return Motion(
        displacement=zeros,
        velocity=zeros,
        time=zeros,
        memory=np.zeros((n, item.n_memory)),
        displacement_scale=item.displacement_scale,
        velocity_scale=item.velocity_scale,
        stiffness=1.0 if stiffness is None else stiffness,
        mass=1.0 if mass is None else mass,
        smoothing=0.0,
    )


def reading_of(item: EffectPlacement, effect: ForceEffect, values: Values) -> Reading:
    """What a force law is drawn against: time where it depends on it, else displacement, else velocity."""
    n = 7
    d, v = item.displacement_scale, item.velocity_scale
    at = replace(still_motion(item, n), displacement=np.full(n, d), velocity=np.full(n, v))
    later = replace(at, time=np.linspace(0.0, 1.0, n) ** 2 * 7.3)
    then = effect.force(values, later).value
    if effect.n_memory == 0 and not np.allclose(then, effect.force(values, at).value, rtol=ROUNDED, atol=0.0):
        at_rest = effect.force(values, replace(later, displacement=np.zeros(n))).value
        scaled = not np.allclose(then, at_rest, rtol=ROUNDED, atol=0.0)
        rates = [j for j, kind in enumerate(effect.parameters) if kind.dimension == (0, 0, -1)]
        rate = float(np.mean(values[rates[0]])) if rates else 0.0
        return Reading(
            against="time",
            period=1.0 / rate if rate > 0.0 else 0.0,
            at_displacement=d if scaled else 1.0,
            scaled=scaled,
        )
    has_displacement = item.port is not None and item.port.displacement is not None
    if "displacement" in effect.needs or (has_displacement and not effect.needs):
        return Reading(against="displacement")
    return Reading(against="velocity")


def force_law(
    item: EffectPlacement, effect: ForceEffect, values: Values, reading: Reading, grid: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The law (n,) over a grid of what it is drawn against, and its derivative (n, n_parameters)."""
    still = still_motion(item, len(grid))
    if reading.against == "time":
        moved = replace(still, time=grid, displacement=np.full(len(grid), reading.at_displacement))
    elif reading.against == "velocity":
        moved = replace(still, velocity=grid)
    else:
        moved = replace(still, displacement=grid)
    force = effect.force(values, moved)
    return force.value, force.by_parameter


def loaded_law(
    item: EffectPlacement, effect: ForceEffect, values: Values, grid: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """A law with memory as it loads from rest to either side, and its derivative, by central differences."""
    given = np.array([float(np.mean(value)) for value in values])
    steps = DIFFERENCE_STEP * np.maximum(np.abs(given), 1e-12)
    moves = np.repeat(np.diag(steps), 2, axis=0) * np.tile([1.0, -1.0], len(given))[:, None]
    trials = given + np.concatenate([np.zeros((1, len(given))), moves])
    reach = np.array([float(grid.min()), float(grid.max())])
    paths = np.linspace(0.0, 1.0, 61)[:, None] * reach
    displacement = np.tile(paths, (1, len(trials)))
    parameters = list(np.repeat(trials, 2, axis=0).T)
    at = still_motion(item, displacement.shape[1])
    forces = np.zeros_like(displacement)
    for k, following in enumerate(displacement):
        after = replace(at, displacement=following)
        if k:
            memory = effect.advance(parameters, at, after, dt).value
            after = replace(after, memory=memory)
        forces[k] = effect.force(parameters, after).value
        at = after
    found = np.concatenate([forces[:0:-1, 0::2], forces[:, 1::2]]).T
    along = np.concatenate([paths[:0:-1, 0], paths[:, 1]])
    order = np.argsort(along, kind="stable")
    law = np.stack([np.interp(grid, along[order], one[order]) for one in found])
    return law[0], ((law[1::2] - law[2::2]) / (2.0 * steps[:, None])).T


WORTH = 0.02
"""Simulate a step that takes away more than this share of the squares that are left."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BinnedForce(ForceEffect):
    """A force that is piecewise linear in what a law is drawn against.

    Its last parameter, of each record, is the time by which a law at one frequency runs ahead.

    Attributes:
        bins: The bins.
        reading: What the law is drawn against.
    """

    bins: Bins
    reading: Reading

    key = "binned_force"
    law = "f = sum of values x hats"
    parameters = (
        *(ParameterKind(name=f"bin_{j}", meaning="force in the bin", dimension=(1, 0, 0)) for j in range(N_BINS)),
        ParameterKind(name="ahead", meaning="time it runs ahead", dimension=(0, 0, 1), role="shape", local=True),
    )
    neutral = (0.0,) * (N_BINS + 1)
    family = "binned"
    signature = "any"
    reference = "Worden, Tomlinson, Nonlinearity in Structural Dynamics, 2001, chapter 7"
    needs = frozenset()
    acts_at = "force"

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        against, reading = self.reading.against, self.reading
        read = {"displacement": motion.displacement, "velocity": motion.velocity, "time": motion.time + values[-1]}
        hats, rises = self.bins.hats(read[against])
        heights = np.array([float(np.mean(value)) for value in values[:-1]])
        value, rise, none = hats @ heights, rises @ heights, np.zeros(len(hats))
        by_displacement, by_velocity = none, none
        if reading.scaled:
            by_displacement = value / reading.at_displacement
            size = motion.displacement / reading.at_displacement
            value, hats = value * size, hats * size[:, None]
        elif against == "displacement":
            by_displacement = rise
        elif against == "velocity":
            by_velocity = rise
        return Force(
            value=value,
            by_displacement=by_displacement,
            by_velocity=by_velocity,
            by_memory=np.zeros((len(hats), 0)),
            by_parameter=np.column_stack([hats, none]),
        )


def binned_force(
    fitted: Estimate, problem: Problem, placement: int, *, bins: Bins, reading: Reading, ahead: FloatArray
) -> tuple[FloatArray, Told, float] | None:
    """Fit the bins beside a law whose own parameters are held.

    Args:
        fitted: The model.
        problem: The records.
        placement: The law.
        bins: Bins of what it is drawn against.
        reading: What that is.
        ahead: (n_records,) time by which a law at one frequency runs ahead in each record; zeros for others.

    Returns:
        What the data add to the law in each bin (m,), the last normal equations' word, and the sum of squares that is
        left; None where the model cannot be simulated.
    """
    current = _beside(fitted, problem, placement, bins=bins, reading=reading, ahead=ahead)
    if current is None:
        return None
    added_to = len(current.assembly.placements) - 1
    first = current.assembly.common_of(added_to).start
    where = first + np.arange(len(bins.knots))
    others = unknowns_but(current, [placement, added_to])
    for _ in range(3):
        slopes = derivatives(current, problem)
        told = told_by(*score_equations(current, problem, slopes), where, others)
        if told.fall <= WORTH * current.squares:
            break
        step = np.zeros(current.assembly.n_common + current.unknowns.local.size)
        step[where], step[others] = told.added, told.others
        n_common = current.assembly.n_common
        moved = step[n_common:].reshape(current.unknowns.local.shape)
        states = current.trajectory.states + np.tensordot(step[:n_common], slopes.common_states, axes=(0, 0))
        for record in range(problem.drive.n_records):
            times = problem.drive.times_of(record)
            states[times] += np.tensordot(moved[record], slopes.local_states[:, times], axes=(0, 0))
        unknowns = Unknowns(common=current.unknowns.common + step[:n_common], local=current.unknowns.local + moved)
        better = simulate_at(
            current.assembly,
            unknowns,
            problem,
            states=states,
            gain=fitted.gain,
            smoothing=fitted.smoothing,
            start="near",
        )
        if better is None or not better.cost < current.cost:
            break
        current = better
    else:
        told = told_by(*score_equations(current, problem, derivatives(current, problem)), where, others)
    return current.unknowns.common[where] + told.added, told, current.squares - told.fall


def _beside(
    fitted: Estimate, problem: Problem, placement: int, *, bins: Bins, reading: Reading, ahead: FloatArray
) -> Estimate | None:
    """The model with empty bins beside a law, in its direction."""
    item = fitted.assembly.placements[placement]
    beside = EffectPlacement(
        effect=BinnedForce(bins=bins, reading=reading),
        where=item.where,
        port=item.port,
        displacement_scale=item.displacement_scale,
        velocity_scale=item.velocity_scale,
    )
    directions = fitted.unknowns.directions(fitted.assembly, placement)[1:]
    unknowns = Unknowns(
        common=np.concatenate([fitted.unknowns.common, np.zeros(len(bins.knots)), directions]),
        local=np.column_stack([fitted.unknowns.local, ahead]),
    )
    return simulate_at(
        replace(fitted.assembly, placements=(*fitted.assembly.placements, beside)),
        unknowns,
        problem,
        states=fitted.trajectory.states,
        gain=fitted.gain,
        smoothing=fitted.smoothing,
        start="near",
    )
