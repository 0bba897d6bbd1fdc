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

The laws of effects at inputs and sensors, each over what the data say of it without any law.

One law as a curve: over its grid, with its deviation, the data's points and the loop along a record.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem
from modal.discrepancy.results import LawCurve
from modal.discrepancy.validation.law_forces import binned_force, force_law, loaded_law, reading_of
from modal.discrepancy.validation.law_points import Bins, bins_of, drive_before, input_sources, told_by_sources
from modal.effects.effect import ForceEffect, InputEffect, SensorEffect
from modal.simulation.assembly import EffectPlacement, drive_inputs
from modal.simulation.drive import Drive
from modal.simulation.forces import motion_at
from modal.simulation.plant import Plant, Port
from modal.simulation.sensitivity import Source
from modal.simulation.tolerances import ROUNDING
from okid.arrays import FloatArray

__all__ = [
    "N_GRID",
    "LawAt",
    "LawGrid",
    "LawTask",
    "input_law_curve",
    "law_curve",
    "law_curves",
    "law_grid",
    "law_loop",
    "sensor_law_curve",
]

N_GRID = 201
LONGEST_LOOP = 400
LawAt = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""The law at values of its motion (n,), and its derivative (n, p) by the parameters that all records share."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LawTask:
    """What the laws are drawn of.

    Attributes:
        fitted: The model, in free run.
        problem: The records it was fitted to.
        plant: The plant.
    """

    fitted: Estimate
    problem: Problem
    plant: Plant

    @property
    def drive(self) -> Drive:
        """The drive after all effects at the inputs."""
        return self.fitted.trajectory.drive

    def item(self, placement: int) -> EffectPlacement:
        """An effect at its place."""
        return self.fitted.assembly.placements[placement]

    def values(self, placement: int) -> list[FloatArray]:
        """Its parameters."""
        return self.fitted.unknowns.values(self.fitted.assembly, placement)


def _nothing() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LawGrid:
    """A law over its grid and in its bins, each with its derivative by the parameters that all records share.

    Attributes:
        grid: (n,) values of what the law is drawn against.
        value: (n,) the law there.
        slope: (n, p) its derivative.
        bins: Bins of the data's points; None where the law has none.
        bin_value: The law at the bins' knots.
        bin_slope: Its derivative there.
    """

    grid: FloatArray
    value: FloatArray
    slope: FloatArray
    bins: Bins | None
    bin_value: FloatArray = field(default_factory=_nothing)
    bin_slope: FloatArray = field(default_factory=_nothing)


def law_grid(law_at: LawAt, grid: FloatArray, bins: Bins | None) -> LawGrid:
    """A law over a grid and in its bins.

    Args:
        law_at: The law and its derivative.
        grid: (n,) values of what it is drawn against.
        bins: Bins of the data's points; None where there are none.

    Returns:
        The law there.
    """
    value, slope = law_at(grid)
    if bins is None:
        return LawGrid(grid=grid, value=value, slope=slope, bins=None)
    bin_value, bin_slope = law_at(bins.knots)
    return LawGrid(grid=grid, value=value, slope=slope, bins=bins, bin_value=bin_value, bin_slope=bin_slope)


def law_curve(
    task: LawTask,
    placement: int,
    law: LawGrid,
    points: tuple[FloatArray, FloatArray] | None,
    spread: FloatArray,
    *,
    against: Literal["displacement", "velocity", "time", "input", "output"],
    units: tuple[str, str],
    loop: tuple[FloatArray, FloatArray] | None = None,
) -> LawCurve:
    """The curve of a law with its standard deviation, the data's points and its loop.

    Args:
        task: What the laws are drawn of.
        placement: Index of the effect.
        law: The law over its grid.
        points: Additions to the law in its bins, and their deviations; None without points.
        spread: Covariance of the effect's parameters that all records share.
        against: What it is drawn against.
        units: Units of what it is drawn against and of the law.
        loop: Motion and force along the loudest record; None where it has no loop.

    Returns:
        The curve.
    """
    item = task.item(placement)
    knots, force, deviation = _nothing(), _nothing(), _nothing()
    loop_motion, loop_force = (_nothing(), _nothing()) if loop is None else loop
    if law.bins is not None and points is not None:
        knots, force, deviation = law.bins.knots, law.bin_value + points[0], points[1]
    return LawCurve(
        effect=item.effect.key,
        where=item.where,
        against=against,
        motion=law.grid,
        force=law.value,
        deviation=np.sqrt(np.maximum(np.einsum("np,pq,nq->n", law.slope, spread, law.slope), 0.0)),
        points_motion=knots,
        points_force=force,
        points_deviation=deviation,
        loop_motion=loop_motion,
        loop_force=loop_force,
        motion_unit=units[0],
        force_unit=units[1],
    )


def law_loop(motion: FloatArray, force: FloatArray, drive: Drive) -> tuple[FloatArray, FloatArray]:
    """Motion and force along the loudest record, about the largest motion.

    Args:
        motion: (n_times,) the motion.
        force: (n_times,) the force.
        drive: The drive of all records.

    Returns:
        Both over the stretch to show.
    """
    record = int(np.argmax([drive.level[drive.firsts[r]] for r in range(drive.n_records)]))
    rows = drive.rows[drive.rows_of(record)]
    length = min(LONGEST_LOOP, len(rows))
    middle = int(np.argmax(np.abs(motion[rows])))
    first = min(max(middle - length // 2, 0), len(rows) - length)
    shown = rows[first : first + length]
    return motion[shown], force[shown]


def input_law_curve(task: LawTask, placement: int, effect: InputEffect, spread: FloatArray) -> LawCurve:
    """The law of an effect at an input.

    Args:
        task: What the laws are drawn of.
        placement: Index of the effect.
        effect: The effect.
        spread: Covariance of its parameters that all records share.

    Returns:
        Its curve.
    """
    item, dt = task.item(placement), task.drive.dt
    units = (task.plant.input_units[item.channel],) * 2
    before = drive_before(task.fitted, task.problem, placement)
    signal = before.sample[:, item.channel]
    values = [float(np.mean(value)) for value in task.values(placement)]
    grid = np.linspace(float(signal.min()), float(signal.max()), N_GRID)
    common = list(item.common)
    if not _of_the_moment(effect, values, grid, dt):
        after = drive_inputs(task.fitted.assembly, task.fitted.unknowns, before, first=placement)
        loop = law_loop(signal, after.sample[:, item.channel], task.drive)
        law = LawGrid(grid=grid, value=grid, slope=np.zeros((N_GRID, len(common))), bins=None)
        return law_curve(task, placement, law, None, spread, against="input", units=units, loop=loop)

    def law_at(motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = effect.by_parameter(values, motion, motion, motion, dt)[2]
        return effect.at_samples(values, motion, motion, motion, dt), np.asarray(slope.T[:, common])

    bins = bins_of(signal)
    sources = [] if bins is None else input_sources(task.fitted, placement, before, bins)
    law = law_grid(law_at, grid, bins)
    points = _points(task, placement, law, sources, spread)
    return law_curve(task, placement, law, points, spread, against="input", units=units)


def _of_the_moment(effect: InputEffect, values: list[float], grid: FloatArray, dt: float) -> bool:
    """Whether each value after the effect depends on the value before it alone."""
    forward = effect.apply(values, grid, grid, dt)[0]
    backward = effect.apply(values, grid[::-1], grid[::-1], dt)[0][::-1]
    return bool(np.allclose(forward, backward, rtol=ROUNDING, atol=1e-12 * float(np.abs(grid).max())))


def sensor_law_curve(task: LawTask, placement: int, effect: SensorEffect, spread: FloatArray) -> LawCurve:
    """The law of an effect at a sensor.

    Args:
        task: What the laws are drawn of.
        placement: Index of the effect.
        effect: The effect.
        spread: Covariance of its parameters that all records share.

    Returns:
        Its curve.
    """
    item, drive = task.item(placement), task.drive
    unit = task.plant.output_units[item.channel]
    values = [float(np.mean(value)) for value in task.values(placement)]
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
    law = law_grid(law_at, grid, bins)
    points = _points(task, placement, law, sources, spread)
    return law_curve(task, placement, law, points, spread, against=against, units=units)


def _points(
    task: LawTask, placement: int, law: LawGrid, sources: list[Source], spread: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Additions to a law at an input or a sensor, and their deviations; None where it has no bins."""
    if not sources:
        return None
    told = told_by_sources(task.fitted, task.problem, placement, sources)
    left = task.fitted.squares - told.fall
    return told.added, told.deviation(law.bin_slope, spread, task.fitted, left)


def law_curves(fitted: Estimate, problem: Problem, plant: Plant, spread: FloatArray) -> tuple[LawCurve, ...]:
    """Every law of a fitted model, its standard deviation, the data's points free of its form, and its loop.

    Args:
        fitted: The model, in free run.
        problem: The records it was fitted to.
        plant: The plant.
        spread: (n, n) covariance of all unknowns, common ones first (`covariance.covariance`).

    Returns:
        One curve an effect, in their order.
    """
    assembly = fitted.assembly
    if not assembly.placements:
        return ()
    task = LawTask(fitted=fitted, problem=problem, plant=plant)
    found = []
    for i, item in enumerate(assembly.placements):
        first = assembly.common_of(i).start
        own = slice(first, first + len(item.common))
        if isinstance(item.effect, ForceEffect) and item.port is not None:
            found.append(_force_curve(task, i, item.effect, item.port, spread[own, own]))
        elif isinstance(item.effect, InputEffect):
            found.append(input_law_curve(task, i, item.effect, spread[own, own]))
        elif isinstance(item.effect, SensorEffect):
            found.append(sensor_law_curve(task, i, item.effect, spread[own, own]))
    return tuple(found)


def _force_curve(task: LawTask, placement: int, effect: ForceEffect, port: Port, spread: FloatArray) -> LawCurve:
    item, drive, about = task.item(placement), task.drive, task.fitted.trajectory.linearisation
    n = task.plant.n_states
    values = task.values(placement)
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

    law = law_grid(law_at, grid, bins)
    points = None
    if bins is not None:
        found = binned_force(task.fitted, task.problem, placement, bins=bins, reading=reading, ahead=ahead)
        points = None if found is None else (found[0], found[1].deviation(law.bin_slope, spread, task.fitted, found[2]))
    along = {"displacement": port.length_unit, "velocity": f"{port.length_unit}/s", "time": "s"}[reading.against]
    loop = None
    if effect.n_memory:
        force = about.acting[task.fitted.assembly.forces.index(placement)].force.value
        loop = law_loop(motion.displacement, force, drive)
    return law_curve(
        task,
        placement,
        law,
        points,
        spread,
        against=reading.against,
        units=(along, port.force_unit),
        loop=loop,
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
