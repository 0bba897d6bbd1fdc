"""A force law by itself over what it is drawn against, and beside it a force free of any form, in bins.

Where the law found has the right form one linear step is enough. Where it has not, the motion that it makes is wrong as
well, and so is a response linearised about that motion; so the step is taken, the model simulated anew with law and
bins, and the next step starts there.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, score_equations, simulate_at
from modal.discrepancy.validation.law_points import N_BINS, Bins, Told, derivatives, told_by, unknowns_but
from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Values
from modal.simulation.assembly import EffectPlacement, Unknowns
from modal.simulation.tolerances import DIFFERENCE_STEP, ROUNDING
from okid.arrays import FloatArray

__all__ = ["BinnedForce", "Reading", "binned_force", "force_law", "loaded_law", "reading_of", "still_motion"]

LOADING_STEPS = 60
"""Load a law with memory from rest to either side in so many steps."""


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
    if effect.n_memory == 0 and not np.allclose(then, effect.force(values, at).value, rtol=ROUNDING, atol=0.0):
        at_rest = effect.force(values, replace(later, displacement=np.zeros(n))).value
        scaled = not np.allclose(then, at_rest, rtol=ROUNDING, atol=0.0)
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
    paths = np.linspace(0.0, 1.0, LOADING_STEPS + 1)[:, None] * reach
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


STEPS = 4
"""Fit the bins in at most so many steps."""
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
    for _ in range(STEPS - 1):
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
