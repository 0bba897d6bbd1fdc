"""Laws of the velocity: dry friction, friction that holds with more than it slides with, and drag."""

from dataclasses import dataclass

import numpy as np

from modal.effects.effect import (
    Force,
    ForceEffect,
    Limit,
    Motion,
    ParameterKind,
    Situation,
    StepForce,
    StepValue,
    Values,
)
from modal.effects.jump import jump, jump_line
from modal.effects.memoryless import cut_to_finite, least_length, levels, memoryless
from okid.arrays import FloatArray

__all__ = ["CoulombFriction", "QuadraticDrag", "StribeckFriction"]


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


SHARES = (0.1, 0.3, 0.6)
"""Start from the speeds below which the mass moves for these shares of the time: below the least friction is breakaway
only, above the greatest it never falls to the end."""
_POINTS, _WEIGHTS = (part.copy() for part in np.polynomial.legendre.leggauss(4))
_POINTS, _WEIGHTS = 0.5 * (_POINTS + 1.0), 0.5 * _WEIGHTS


@dataclass(frozen=True, slots=True, kw_only=True)
class StribeckFriction(ForceEffect):
    """Dry friction with a breakaway force above the sliding one.

    In the data: as dry friction, but a mass that stops needs more to break loose than to go on; at low levels stick and
    slip, a damping that is negative where friction falls.

    Law: `f = (Fc + excess exp(-(v / stribeck_velocity)^2)) sign(v)`. Parameters: Fc [force] while sliding, excess
    [force] of the breakaway force over it, stribeck_velocity [velocity] at which it is down to 37 %; none negative.

    Confused with: Coulomb friction, its limit without an excess; where the velocity never comes near rest the excess
    does not show.

    References:
        Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation methods for the
        control of machines with friction, Automatica 30(7), 1994, doi 10.1016/0005-1098(94)90209-7 (equation 4).
    """

    key = "stribeck_friction"
    law = "f = (Fc + excess exp(-(v / stribeck_velocity)^2)) sign(v)"
    parameters = (
        ParameterKind(name="Fc", meaning="friction force while sliding", dimension=(1, 0, 0), lower=0.0),
        ParameterKind(name="excess", meaning="breakaway force less that", dimension=(1, 0, 0), lower=0.0),
        ParameterKind(
            name="stribeck_velocity",
            meaning="speed at which the excess is down to 37 %",
            dimension=(0, 1, -1),
            lower=0.0,
            role="shape",
        ),
    )
    neutral = (0.0, 0.0, 1.0)
    family = "friction"
    signature = "odd lines; damping falls with the level, stick and slip at low ones"
    reference = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    needs = frozenset({"velocity"})
    limits = (Limit(law="coulomb_friction", values=lambda v: (v[0] + 0.5 * v[1],), near=lambda v, size: True),)  # noqa: ARG005 - whatever its size

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Speeds below which the mass moves for a part of the time."""
        return tuple((1.0, 1.0, speed) for speed in levels(situation.motion.velocity, SHARES))

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        sign, slope = jump(motion.velocity, motion.smoothing * motion.velocity_scale)
        fallen, by_speed, by_width = _fallen(motion.velocity, values[2], motion.velocity_scale)
        return memoryless(
            motion,
            (values[0] + values[1]) * sign - values[1] * fallen,
            (sign, sign - fallen, -values[1] * by_width),
            by_velocity=(values[0] + values[1]) * slope - values[1] * by_speed,
        )

    def step_force(self, values: Values, before: Motion, after: Motion) -> StepForce | None:
        """The line of dry friction of the breakaway size, less that of what the force falls by along the step."""
        width = before.smoothing * before.velocity_scale
        if not np.all(np.asarray(width) > 0.0):
            return None
        size, mobility, excess = values[0] + values[1], before.mobility, values[1]
        line = jump_line(before.velocity, after.velocity, width, change=size * mobility)
        ahead = _POINTS[:, None]
        speeds = (1.0 - ahead) * before.velocity + ahead * after.velocity
        fallen, by_speed, by_width = _fallen(speeds, values[2], before.velocity_scale)

        def part(line: FloatArray, weights_of: FloatArray) -> StepValue:
            weights = weights_of[:, None]
            by_size = line[0] + size * mobility * line[3]
            drop = np.sum(weights * fallen, axis=0)
            by_drop = -excess * np.sum(weights * by_width, axis=0)
            return StepValue(
                value=size * line[0] - excess * drop,
                by_before=size * line[1] - excess * np.sum(weights * (1.0 - ahead) * by_speed, axis=0),
                by_after=size * line[2] - excess * np.sum(weights * ahead * by_speed, axis=0),
                by_parameter=np.stack([by_size, by_size - drop, by_drop], axis=1),
            )

        tilt = 6.0 * (_POINTS - 0.5)
        return StepForce(
            start=part(line.start, _WEIGHTS * (1.0 - tilt)),
            end=part(line.end, _WEIGHTS * (1.0 + tilt)),
            lift=part(line.lift, 0.0 * tilt),
        )


def _fallen(velocity: FloatArray, speed: float | FloatArray, scale: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What friction falls by, sign(v) (1 - exp(-(v / speed)^2)), and its slopes by velocity and speed."""
    width = np.maximum(speed, least_length(scale))
    x = cut_to_finite(velocity) / width
    left = np.exp(-np.square(x))
    by_x = 2.0 * np.abs(x) * left
    return np.sign(x) * -np.expm1(-np.square(x)), by_x / width, -x * by_x / width


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadraticDrag(ForceEffect):
    """Quadratic drag f = c2 v |v|.

    In the data: an odd law in the velocity; damping rises with the level (equivalent damping 8 c2 velocity amplitude
    / (3 pi)), the relative gap grows in proportion to the level, free decays start steep and end slow; a propeller
    speeds up less than its linear model at high input.

    Confused with: Coulomb friction at one weak level (its damping falls with the level), and with viscous damping:
    about a mean speed v0 the law is linear, 2 c2 |v0| (v - v0), and only motion on both sides of it, or several
    speeds, tells.

    Parameters: c2 [force time^2/length^2], not negative.

    References:
        Morison, O'Brien, Johnson, Schaaf, The force exerted by surface waves on piles, J. Petroleum Technology 2(5),
        1950, doi 10.2118/950149-G; Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 3.3, doi
        10.1002/9783527617586.
    """

    key = "quadratic_drag"
    law = "f = c2 v |v|"
    parameters = (ParameterKind(name="c2", meaning="drag coefficient", dimension=(1, -2, 2), lower=0.0),)
    neutral = (0.0,)
    family = "damping"
    signature = "odd lines; damping rises with the level"
    reference = "Morison et al. 1950, doi 10.2118/950149-G"
    needs = frozenset({"velocity"})

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        v = cut_to_finite(motion.velocity)
        speed = np.abs(v)
        square = v * speed
        return memoryless(motion, values[0] * square, (square,), by_velocity=2.0 * values[0] * speed)
