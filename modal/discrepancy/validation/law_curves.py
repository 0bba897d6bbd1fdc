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

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem
from modal.discrepancy.results import LawCurve
from modal.discrepancy.validation.law_channels import input_law_curve, sensor_law_curve
from modal.discrepancy.validation.law_curve import N_GRID, LawTask, law_curve, law_grid, law_loop
from modal.discrepancy.validation.law_forces import binned_force
from modal.discrepancy.validation.law_points import bins_of
from modal.discrepancy.validation.law_shape import force_law, loaded_law, reading_of
from modal.effects.effect import ForceEffect, InputEffect, SensorEffect
from modal.simulation.plant import Plant, Port
from modal.simulation.port_motion import motion_at
from okid.arrays import FloatArray

__all__ = ["law_curves"]


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
        force = about.forces[task.fitted.assembly.forces.index(placement)].value
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
