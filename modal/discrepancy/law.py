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
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from modal.discrepancy.assembly import Placement
from modal.discrepancy.diagnosis import LawCurve
from modal.discrepancy.drive import Drive
from modal.discrepancy.driven import drive_inputs
from modal.discrepancy.effects.effect import ForceEffect, InputEffect, SensorEffect
from modal.discrepancy.estimation import Estimate, Problem
from modal.discrepancy.law_forces import binned_force
from modal.discrepancy.law_inputs import drive_before, input_sources
from modal.discrepancy.law_points import Bins, bins_of, told_by_sources
from modal.discrepancy.law_shape import force_law, loaded_law, reading_of
from modal.discrepancy.plant import Plant, Port
from modal.discrepancy.port_motion import motion_at
from modal.discrepancy.sensitivity import Source
from okid.arrays import FloatArray

__all__ = ["law_curves"]

N_GRID = 201
LONGEST_LOOP = 400
LawAt = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""The law at values of its motion (n,), and its derivative (n, p) by the parameters that all records share."""


def law_curves(fitted: Estimate, problem: Problem, plant: Plant, spread: FloatArray) -> tuple[LawCurve, ...]:
    """Every law of a fitted model, its standard deviation, the data's points free of its form, and its loop.

    Args:
        fitted: The model, in free run.
        problem: The records it was fitted to.
        plant: The plant.
        spread: (n, n) covariance of all unknowns, common ones first (`estimation.covariance`).

    Returns:
        One curve an effect, in their order.
    """
    assembly = fitted.assembly
    if not assembly.placements:
        return ()
    task = _Task(fitted=fitted, problem=problem, plant=plant)
    found = []
    for i, item in enumerate(assembly.placements):
        first = assembly.common_of(i).start
        own = slice(first, first + len(item.common))
        if isinstance(item.effect, ForceEffect) and item.port is not None:
            found.append(_force_curve(task, i, item.effect, item.port, spread[own, own]))
        elif isinstance(item.effect, InputEffect):
            found.append(_input_curve(task, i, item.effect, spread[own, own]))
        elif isinstance(item.effect, SensorEffect):
            found.append(_sensor_curve(task, i, item.effect, spread[own, own]))
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Task:
    fitted: Estimate
    problem: Problem
    plant: Plant

    @property
    def drive(self) -> Drive:
        """The drive after all effects at the inputs."""
        return self.fitted.trajectory.drive

    def item(self, placement: int) -> Placement:
        """An effect at its place."""
        return self.fitted.assembly.placements[placement]

    def values(self, placement: int) -> list[FloatArray]:
        """Its parameters."""
        return self.fitted.unknowns.values(self.fitted.assembly, placement)


def _nothing() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Law:
    """A law over its grid and in its bins, each with its derivative by the parameters that all records share."""

    grid: FloatArray
    value: FloatArray
    slope: FloatArray
    bins: Bins | None
    bin_value: FloatArray = field(default_factory=_nothing)
    bin_slope: FloatArray = field(default_factory=_nothing)


def _law(law_at: LawAt, grid: FloatArray, bins: Bins | None) -> _Law:
    value, slope = law_at(grid)
    if bins is None:
        return _Law(grid=grid, value=value, slope=slope, bins=None)
    bin_value, bin_slope = law_at(bins.knots)
    return _Law(grid=grid, value=value, slope=slope, bins=bins, bin_value=bin_value, bin_slope=bin_slope)


def _curve(
    task: _Task,
    placement: int,
    against: Literal["displacement", "velocity", "time", "input", "output"],
    law: _Law,
    points: tuple[FloatArray, FloatArray] | None,
    spread: FloatArray,
    *,
    units: tuple[str, str],
    loop: tuple[FloatArray, FloatArray] | None = None,
) -> LawCurve:
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


def _force_curve(task: _Task, placement: int, effect: ForceEffect, port: Port, spread: FloatArray) -> LawCurve:
    item, drive, about = task.item(placement), task.drive, task.fitted.trajectory.linearisation
    n = task.plant.n_states
    values = task.values(placement)
    means = [float(np.mean(value)) for value in values]
    reading = reading_of(item, effect, means)
    motion = motion_at(item, about.states[:, :n], drive, np.zeros((drive.n_times, effect.n_memory)), 0.0)
    run = {"displacement": motion.displacement, "velocity": motion.velocity, "time": motion.time}[reading.against]
    ahead = np.zeros(drive.n_records)
    if reading.period:
        means, ahead = _folded(effect, values, means)
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

    law = _law(law_at, grid, bins)
    points = None
    if bins is not None:
        found = binned_force(task.fitted, task.problem, placement, bins, reading, ahead + np.zeros(drive.n_records))
        points = None if found is None else (found[0], found[1].deviation(law.bin_slope, spread, task.fitted, found[2]))
    along = {"displacement": port.length_unit, "velocity": f"{port.length_unit}/s", "time": "s"}[reading.against]
    loop = None
    if effect.n_memory:
        force = about.forces[task.fitted.assembly.forces.index(placement)].value
        loop = _loop(motion.displacement, force, drive)
    return _curve(
        task,
        placement,
        reading.against,
        law,
        points,
        spread,
        units=(along, port.force_unit),
        loop=loop,
    )


def _folded(effect: ForceEffect, values: list[FloatArray], means: list[float]) -> tuple[list[float], FloatArray]:
    """A law at one frequency at phase 0, and the time by which it runs ahead in each record."""
    names = [kind.name for kind in effect.parameters]
    rate = next(j for j, kind in enumerate(effect.parameters) if kind.dimension == (0, 0, -1))
    if "phase" not in names:
        return means, np.zeros(1)
    phase = names.index("phase")
    ahead = np.atleast_1d(values[phase]) / (2.0 * np.pi * means[rate])
    return [0.0 if j == phase else value for j, value in enumerate(means)], ahead


def _loop(motion: FloatArray, force: FloatArray, drive: Drive) -> tuple[FloatArray, FloatArray]:
    """Motion and force along the loudest record, about the largest motion."""
    record = int(np.argmax([drive.level[drive.firsts[r]] for r in range(drive.n_records)]))
    rows = drive.rows[drive.rows_of(record)]
    length = min(LONGEST_LOOP, len(rows))
    middle = int(np.argmax(np.abs(motion[rows])))
    first = min(max(middle - length // 2, 0), len(rows) - length)
    shown = rows[first : first + length]
    return motion[shown], force[shown]


def _input_curve(task: _Task, placement: int, effect: InputEffect, spread: FloatArray) -> LawCurve:
    item, dt = task.item(placement), task.drive.dt
    units = (task.plant.input_units[item.channel],) * 2
    before = drive_before(task.fitted, task.problem, placement)
    signal = before.sample[:, item.channel]
    values = [float(np.mean(value)) for value in task.values(placement)]
    grid = np.linspace(float(signal.min()), float(signal.max()), N_GRID)
    common = list(item.common)
    if not _of_the_moment(effect, values, grid, dt):
        after = drive_inputs(task.fitted.assembly, task.fitted.unknowns, before, first=placement)
        loop = _loop(signal, after.sample[:, item.channel], task.drive)
        law = _Law(grid=grid, value=grid, slope=np.zeros((N_GRID, len(common))), bins=None)
        return _curve(task, placement, "input", law, None, spread, units=units, loop=loop)

    def law_at(motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = effect.by_parameter(values, motion, motion, motion, dt)[2]
        return effect.at_samples(values, motion, motion, motion, dt), np.asarray(slope.T[:, common])

    bins = bins_of(signal)
    sources = [] if bins is None else input_sources(task.fitted, placement, before, bins)
    law = _law(law_at, grid, bins)
    return _curve(task, placement, "input", law, _points(task, placement, law, sources, spread), spread, units=units)


def _of_the_moment(effect: InputEffect, values: list[float], grid: FloatArray, dt: float) -> bool:
    """Whether each value after the effect depends on the value before it alone."""
    forward = effect.apply(values, grid, grid, dt)[0]
    backward = effect.apply(values, grid[::-1], grid[::-1], dt)[0][::-1]
    return bool(np.allclose(forward, backward, rtol=1e-9, atol=1e-12 * float(np.abs(grid).max())))


def _sensor_curve(task: _Task, placement: int, effect: SensorEffect, spread: FloatArray) -> LawCurve:
    item, drive = task.item(placement), task.drive
    unit = task.plant.output_units[item.channel]
    values = [float(np.mean(value)) for value in task.values(placement)]
    gain = float(np.mean(effect.gain(values)))
    time = drive.time[drive.rows]
    drifts = gain == 1.0 and "gain" not in effect.key
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
    law = _law(law_at, grid, bins)
    return _curve(task, placement, against, law, _points(task, placement, law, sources, spread), spread, units=units)


def _points(
    task: _Task, placement: int, law: _Law, sources: list[Source], spread: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Additions to a law at an input or a sensor, and their deviations; None where it has no bins."""
    if not sources:
        return None
    told = told_by_sources(task.fitted, task.problem, placement, sources)
    left = task.fitted.squares - told.fall
    return told.added, told.deviation(law.bin_slope, spread, task.fitted, left)
