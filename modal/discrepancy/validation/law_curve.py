"""One law as a curve: over its grid, with its deviation, the data's points and the loop along a record."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem
from modal.discrepancy.results import LawCurve
from modal.discrepancy.validation.law_points import Bins
from modal.simulation.assembly import EffectPlacement
from modal.simulation.drive import Drive
from modal.simulation.plant import Plant
from okid.arrays import FloatArray

__all__ = ["N_GRID", "LawAt", "LawGrid", "LawTask", "law_curve", "law_grid", "law_loop"]

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
