"""The laws of a fitted model, each over what the data say of it without any law.

A law is drawn against what it reads: time where it depends on time, else displacement, else velocity. Where it reads
displacement and velocity, it is drawn against the displacement at rest (velocity 0); a law that changes with time and
reads the displacement as well, over time at a displacement of one standard deviation; a law at one frequency over one
period, all periods of all records laid over each other. Laws with memory are drawn as they load from rest (a hung mass:
with the mass held), and as the loop along the loudest record about its largest motion; they have no points, because no
single force belongs to a displacement. An input is drawn after the effect over before it, a sensor's reading over the
true output (a drift over time); a delay is no function of the input: it has a loop and no points.

Where the direction of a force is not known, its law is that of the component in the port's first column, and the points
are such components of forces in the direction that was found.

A law of unknown form is one statement about a whole curve, so its band holds the whole curve at once. With l(x) the
law's derivative by its parameters there and Q their covariance, T(x) = Q^1/2 l(x) / |Q^1/2 l(x)| runs along a path of
length k on the unit sphere, and a band of c deviations is left somewhere with the probability of the tube about it,

    P = k / pi exp(-c^2 / 2) + 2 (1 - Phi(c))

What is left of it is overlooked up to a share of the force (`SLIGHT`), and between its points no spline is the law:
that share, of the force's root mean square along the records, belongs to the band.

References:
    Sun, Loader, Simultaneous confidence bands for linear regression and smoothing, Ann. Statist. 22, 1994,
    https://doi.org/10.1214/aos/1176325631
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import Estimate, Problem
from modal.discrepancy.results import LawCurve
from modal.discrepancy.validation.law_points import (
    Bins,
    Told,
    binned_force,
    bins_of,
    drive_before,
    force_law,
    input_sources,
    loaded_law,
    reading_of,
    told_by_sources,
)
from modal.effects.effect import ForceEffect, InputEffect, SensorEffect, is_form_free
from modal.effects.smooth_law import SmoothLaw
from modal.simulation import SLIGHT
from modal.simulation.assembly import EffectPlacement, drive_inputs
from modal.simulation.drive import Drive
from modal.simulation.forces import motion_at
from modal.simulation.plant import Plant, Port
from modal.simulation.trajectory import Source
from modal.wording.text import NINETY_FIVE
from okid.arrays import ROUNDED, FloatArray

N_GRID = 201
"""Draw a law at so many points."""
LawAt = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""The law at values of its motion (n,), and its derivative (n, p) by the parameters that all records share."""
Points = Callable[[FloatArray], tuple[FloatArray, FloatArray] | None]
"""From the law's derivative (m, p) in the bins, what the data add to it there and the deviation; None where unknown."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _LawTask:
    """A fitted model and one of its effects, whose law is drawn.

    Attributes:
        fitted: The model, in free run.
        problem: The records it was fitted to.
        plant: The plant.
        placement: Index of the effect.
        spread: (p, p) covariance of its parameters that all records share.
        beside: Standard deviation of the linear coefficient of the same motion, for a law of unknown form: what is law
            and what is linear part is known no better.
    """

    fitted: Estimate
    problem: Problem
    plant: Plant
    placement: int
    spread: FloatArray
    beside: float = 0.0

    @property
    def drive(self) -> Drive:
        """The drive after all effects at the inputs."""
        return self.fitted.trajectory.drive

    @property
    def item(self) -> EffectPlacement:
        """The effect at its place."""
        return self.fitted.assembly.placements[self.placement]

    @property
    def values(self) -> list[FloatArray]:
        """Its parameters."""
        return self.fitted.unknowns.values(self.fitted.assembly, self.placement)

    def deviation(self, told: Told, slope: FloatArray, squares: float) -> FloatArray:
        """(m,) deviation of points, with the law's derivative (m, p) there and the squares that are left with them."""
        return told.deviation(slope, self.spread, self.fitted, squares)

    def by_sources(self, sources: Sequence[Source]) -> Points:
        """Points of a law at an input or a sensor, whose bins act as these sources."""

        def points(slope: FloatArray) -> tuple[FloatArray, FloatArray]:
            told = told_by_sources(self.fitted, self.problem, self.placement, list(sources))
            return told.added, self.deviation(told, slope, self.fitted.squares - told.fall)

        return points

    def curve(
        self,
        law_at: LawAt,
        grid: FloatArray,
        *,
        bins: Bins | None,
        points: Points,
        against: Literal["displacement", "velocity", "time", "input", "output"],
        units: tuple[str, str],
        loop: tuple[FloatArray, FloatArray] | None = None,
        visited: FloatArray | None = None,
    ) -> LawCurve:
        """The law over a grid with its standard deviation, the data's points in bins, and its loop.

        Args:
            law_at: The law.
            grid: (n,) values of what it is drawn against.
            bins: Of the data's points; None where there are none.
            points: What the data add to the law in the bins.
            against: What it is drawn against.
            units: Of what it is drawn against, and of the law.
            loop: Motion and force along the loudest record; None where it has no loop.
            visited: Motion along the records, of a law of unknown form.
        """
        nothing = np.zeros(0)
        value, slope = law_at(grid)
        knots, force, deviation = nothing, nothing, nothing
        if bins is not None:
            bin_value, bin_slope = law_at(bins.knots)
            found = points(bin_slope)
            if found is not None:
                knots, force, deviation = bins.knots, bin_value + found[0], found[1]
        loop_motion, loop_force = (nothing, nothing) if loop is None else loop
        wider, overlooked = 1.0, 0.0
        if is_form_free(self.item.effect) and visited is not None:
            wider = whole_reach(slope, self.spread) / NINETY_FIVE
            overlooked = SLIGHT * float(np.sqrt(np.mean(np.interp(visited, grid, value) ** 2))) / NINETY_FIVE
        variance = np.maximum(np.einsum("np,pq,nq->n", slope, self.spread, slope), 0.0) + (self.beside * grid) ** 2
        return LawCurve(
            effect=self.item.effect.key,
            where=self.item.where,
            against=against,
            motion=grid,
            force=value,
            deviation=np.sqrt(wider**2 * variance + overlooked**2),
            points_motion=knots,
            points_force=force,
            points_deviation=deviation,
            loop_motion=loop_motion,
            loop_force=loop_force,
            motion_unit=units[0],
            force_unit=units[1],
        )


def whole_reach(slope: FloatArray, spread: FloatArray) -> float:
    """How many deviations on either side hold a whole curve with a probability of 95 %.

    Args:
        slope: (n, p) derivative of the curve by its parameters at points along it.
        spread: (p, p) their covariance.

    Example:
        >>> line = np.linspace(-1.0, 1.0, 201)[:, np.newaxis]
        >>> round(whole_reach(line, np.eye(1)), 2)  # a straight line through rest is one number
        1.96
    """
    sizes, axes = np.linalg.eigh(spread)
    path = slope @ axes * np.sqrt(np.maximum(sizes, 0.0))
    length = np.sqrt(np.sum(path**2, axis=1))
    path = path[length > ROUNDED * length.max(initial=0.0)]
    path /= np.sqrt(np.sum(path**2, axis=1))[:, np.newaxis]
    turned = np.arccos(np.clip(np.abs(np.sum(path[1:] * path[:-1], axis=1)), 0.0, 1.0)).sum()
    reach = np.linspace(NINETY_FIVE, 12.0, 10_001)
    outside = turned / np.pi * np.exp(-0.5 * reach**2) + 2.0 * scipy.special.ndtr(-reach)
    return float(np.interp(-2.0 * scipy.special.ndtr(-NINETY_FIVE), -outside, reach))


def _loop(motion: FloatArray, force: FloatArray, drive: Drive) -> tuple[FloatArray, FloatArray]:
    """Motion and force (n_times,) along the stretch of the loudest record to show: about its largest motion."""
    record = int(np.argmax([drive.level[drive.firsts[r]] for r in range(drive.n_records)]))
    rows = drive.rows[drive.rows_of(record)]
    length = min(400, len(rows))
    middle = int(np.argmax(np.abs(motion[rows])))
    first = min(max(middle - length // 2, 0), len(rows) - length)
    shown = rows[first : first + length]
    return motion[shown], force[shown]


def _input_curve(task: _LawTask, effect: InputEffect) -> LawCurve:
    """The law of an effect at an input."""
    fitted, item, dt = task.fitted, task.item, task.drive.dt
    units = (task.plant.input_units[item.channel],) * 2
    before = drive_before(fitted, task.problem, task.placement)
    signal = before.sample[:, item.channel]
    values = [float(np.mean(value)) for value in task.values]
    grid = np.linspace(float(signal.min()), float(signal.max()), N_GRID)
    common = list(item.common)
    of_the_moment = _of_the_moment(effect, values, grid, dt)

    def law_at(motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not of_the_moment:
            return motion, np.zeros((len(motion), len(common)))
        slope = effect.by_parameter(values, motion, motion, motion, dt)[2]
        return effect.at_samples(values, motion, motion, motion, dt), np.asarray(slope.T[:, common])

    bins = bins_of(signal) if of_the_moment else None
    points = task.by_sources([] if bins is None else input_sources(fitted, task.placement, before, bins))
    loop = None
    if not of_the_moment:
        after = drive_inputs(fitted.assembly, fitted.unknowns, before, first=task.placement)
        loop = _loop(signal, after.sample[:, item.channel], task.drive)
    return task.curve(law_at, grid, bins=bins, points=points, against="input", units=units, loop=loop)


def _of_the_moment(effect: InputEffect, values: list[float], grid: FloatArray, dt: float) -> bool:
    """Whether each value after the effect depends on the value before it alone."""
    forward = effect.apply(values, grid, grid, dt)[0]
    backward = effect.apply(values, grid[::-1], grid[::-1], dt)[0][::-1]
    return bool(np.allclose(forward, backward, rtol=ROUNDED, atol=1e-12 * float(np.abs(grid).max())))


def _sensor_curve(task: _LawTask, effect: SensorEffect) -> LawCurve:
    """The law of an effect at a sensor."""
    item, drive = task.item, task.drive
    unit = task.plant.output_units[item.channel]
    if effect.n_memory:
        about, assembly = task.fitted.trajectory.linearisation, task.fitted.assembly
        force = about.acting[assembly.forces.index(task.placement)].force.value
        shown = about.states[:, assembly.memory_of(task.placement)][:, 0]
        return task.curve(
            lambda motion: (motion, np.zeros((len(motion), len(item.common)))),
            np.linspace(float(shown.min()), float(shown.max()), N_GRID),
            bins=None,
            points=task.by_sources([]),
            against="output",
            units=(unit, unit),
            loop=_loop(shown - force, shown, drive),
        )
    values = [float(np.mean(value)) for value in task.values]
    gain = float(np.mean(effect.gain(values)))
    time = drive.time[drive.rows]
    one = np.ones(1)
    reads = not np.array_equal(effect.by_parameter(values, one, one), effect.by_parameter(values, 2.0 * one, one))
    drifts = gain == 1.0 and not reads
    signal = time if drifts else task.fitted.trajectory.linearisation.free[:, item.channel]
    common = list(item.common)

    def law_at(motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        none = np.zeros_like(motion)
        output, at = (none, motion) if drifts else (motion, none)
        return gain * output + effect.offset(values, at), effect.by_parameter(values, output, at)[:, common]

    bins = bins_of(signal)
    sources = []
    for hat in () if bins is None else bins.hats(signal)[0].T:
        sensed = np.zeros_like(task.fitted.trajectory.outputs)
        sensed[:, item.channel] = hat
        sources.append(Source(sensed=sensed))
    grid = np.linspace(float(signal.min()), float(signal.max()), N_GRID)
    against: Literal["time", "output"] = "time" if drifts else "output"
    units = ("s" if drifts else unit, unit)
    return task.curve(law_at, grid, bins=bins, points=task.by_sources(sources), against=against, units=units)


def law_curves(fitted: Estimate, problem: Problem, plant: Plant, spread: FloatArray) -> tuple[LawCurve, ...]:
    """Every law of a fitted model, its standard deviation, the data's points free of its form, and its loop.

    Args:
        fitted: The model, in free run.
        problem: The records it was fitted to.
        plant: The plant.
        spread: (n, n) covariance of all unknowns, common ones first (`covariance.covariance`).
    """
    found = []
    for i, item in enumerate(fitted.assembly.placements):
        first = fitted.assembly.common_of(i).start
        own = slice(first, first + len(item.common))
        beside = 0.0
        if isinstance(item.effect, SmoothLaw):
            name = item.effect.linear_name(item.where)
            linear = [spread[j, j] for j, one in enumerate(plant.parameters) if one.name == name]
            beside = float(np.sqrt(max(sum(linear), 0.0)))
        task = _LawTask(
            fitted=fitted, problem=problem, plant=plant, placement=i, spread=spread[own, own], beside=beside
        )
        if isinstance(item.effect, ForceEffect) and item.port is not None:
            found.append(_force_curve(task, item.effect, item.port))
        elif isinstance(item.effect, InputEffect):
            found.append(_input_curve(task, item.effect))
        elif isinstance(item.effect, SensorEffect):
            found.append(_sensor_curve(task, item.effect))
    return tuple(found)


def _force_curve(task: _LawTask, effect: ForceEffect, port: Port) -> LawCurve:
    item, drive, about = task.item, task.drive, task.fitted.trajectory.linearisation
    n = task.plant.n_states
    values = task.values
    means = [float(np.mean(value)) for value in values]
    reading = reading_of(item, effect, means)
    motion = motion_at(item, about.states[:, :n], drive, np.zeros((drive.n_times, effect.n_memory)), 0.0)
    run = {"displacement": motion.displacement, "velocity": motion.velocity, "time": motion.time}[reading.against]
    ahead = np.zeros(drive.n_records)
    if reading.period:
        means, ahead = _folded(effect, values, means, ahead)
    bins = None if effect.n_memory else bins_of(run, period=reading.period)
    low, high = (0.0, reading.period) if reading.period else (float(run.min()), float(run.max()))
    grid = np.linspace(low, high, N_GRID)
    common = list(item.common)

    def law_at(motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        if effect.n_memory and "velocity" not in effect.needs:
            value, slope = loaded_law(item, effect, means, motion, drive.dt)
        else:
            value, slope = force_law(item, effect, means, reading, motion)
        kept = slope[:, common].copy()
        if reading.period:
            # an error of the frequency moves the periods against each other and leaves the law over one period
            kept[:, [k for k, j in enumerate(common) if effect.parameters[j].role == "shape"]] = 0.0
        return value, kept

    def points(slope: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        if bins is None:
            return None
        found = binned_force(task.fitted, task.problem, task.placement, bins=bins, reading=reading, ahead=ahead)
        return None if found is None else (found[0], task.deviation(found[1], slope, found[2]))

    along = {"displacement": port.length_unit, "velocity": f"{port.length_unit}/s", "time": "s"}[reading.against]
    loop = None
    if effect.n_memory:
        force = about.acting[task.fitted.assembly.forces.index(task.placement)].force.value
        loop = _loop(motion.displacement, force, drive)
    units = along, port.force_unit
    return task.curve(
        law_at, grid, bins=bins, points=points, against=reading.against, units=units, loop=loop, visited=run
    )


def _folded(
    effect: ForceEffect, values: list[FloatArray], means: list[float], none: FloatArray
) -> tuple[list[float], FloatArray]:
    """A law at one frequency at phase 0, and the time by which it runs ahead in each record."""
    names = [kind.name for kind in effect.parameters]
    rate = next(j for j, kind in enumerate(effect.parameters) if kind.dimension == (0, 0, -1))
    if "phase" not in names:
        return means, none
    phase = names.index("phase")
    ahead = none + values[phase] / (2.0 * np.pi * means[rate])
    return [0.0 if j == phase else value for j, value in enumerate(means)], ahead
