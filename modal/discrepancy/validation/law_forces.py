"""A force free of any form beside a law: the bins' values as parameters of an effect of their own, fitted for real.

Where the law found has the right form one linear step is enough. Where it has not, the motion that it makes is wrong as
well, and so is a response linearised about that motion; so the step is taken, the model simulated anew with law and
bins, and the next step starts there.
"""

from dataclasses import dataclass, replace

import numpy as np

from modal.discrepancy.fitting.estimation import Estimate, Problem, score_equations, simulate_at
from modal.discrepancy.validation.law_points import N_BINS, Bins, Told, derivatives, told_by, unknowns_but
from modal.discrepancy.validation.law_shape import Reading
from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, Values
from modal.simulation.assembly import EffectPlacement, Unknowns
from okid.arrays import FloatArray

__all__ = ["BinnedForce", "binned_force"]

STEPS = 4
WORTH = 0.02
"""A step is worth a simulation where it takes away more than this share of the squares that are left."""


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
