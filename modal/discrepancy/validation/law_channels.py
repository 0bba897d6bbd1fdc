"""The laws of effects at inputs and sensors, each over what the data say of it without any law."""

from typing import Literal

import numpy as np

from modal.discrepancy.results import LawCurve
from modal.discrepancy.validation.law_curve import N_GRID, LawGrid, LawTask, law_curve, law_grid, law_loop
from modal.discrepancy.validation.law_inputs import drive_before, input_sources
from modal.discrepancy.validation.law_points import bins_of, told_by_sources
from modal.effects.effect import InputEffect, SensorEffect
from modal.simulation.driven import drive_inputs
from modal.simulation.sensitivity import Source
from modal.simulation.tolerances import ROUNDING
from okid.arrays import FloatArray

__all__ = ["input_law_curve", "sensor_law_curve"]


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
