"""Coulomb friction: a force of constant size against the motion."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import Force, ForceEffect, Motion, ParameterKind, StepForce, StepValue, Values
from modal.effects.jump import jump, jump_line
from modal.effects.memoryless import memoryless
from okid.arrays import FloatArray

__all__ = ["CoulombFriction"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CoulombFriction(ForceEffect):
    """Coulomb (dry) friction f = Fc sign(v).

    Smoothed to Fc v / sqrt(v^2 + width^2) with width = smoothing x velocity scale (see `jump`).

    In the data: an odd law in the velocity; damping falls with the level (a force that stays Fc while all others
    grow: equivalent damping 4 Fc / (pi velocity amplitude)), free decays end on a straight line rather than an
    exponential, flat tops where the motion sticks; the loop of force over displacement is a rectangle of area
    4 Fc amplitude.

    Confused with: quadratic drag (its relative gap rises with the level, that of friction falls: one weak level alone
    can hardly tell), viscous damping at one level, a constant force where the velocity never reverses, and an
    elastoplastic link (which gives way elastically before it slips).

    Parameters: Fc [force], not negative.

    References:
        Feeny, Liang, A decrement method for the simultaneous estimation of Coulomb and viscous friction, J. Sound Vib.
        195(1), 1996, doi 10.1006/jsvi.1996.0411; Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models,
        analysis tools and compensation methods for the control of machines with friction, Automatica 30(7), 1994,
        doi 10.1016/0005-1098(94)90209-7.
    """

    key = "coulomb_friction"
    law = "f = Fc sign(v)"
    parameters = (ParameterKind(name="Fc", meaning="friction force", dimension=(1, 0, 0), lower=0.0),)
    neutral = (0.0,)
    family = "damping"
    signature = "odd lines; damping falls with the level"
    reference = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    needs = frozenset({"velocity"})

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        sign, slope = jump(motion.velocity, motion.smoothing * motion.velocity_scale)
        return memoryless(motion, values[0] * sign, (sign,), by_velocity=values[0] * slope)

    def step_force(self, values: Values, before: Motion, after: Motion) -> StepForce | None:
        """The line over each step with the force's own mean and moment: a reversal counts from when it happens."""
        width = before.smoothing * before.velocity_scale
        if not np.all(np.asarray(width) > 0.0):
            return None
        size, mobility = values[0], before.mobility
        line = jump_line(before.velocity, after.velocity, width, change=size * mobility)

        def part(line: FloatArray) -> StepValue:
            return StepValue(
                value=size * line[0],
                by_before=size * line[1],
                by_after=size * line[2],
                by_parameter=(line[0] + size * mobility * line[3])[:, None],
            )

        return StepForce(start=part(line.start), end=part(line.end), lift=part(line.lift))
