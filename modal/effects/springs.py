"""Laws of the displacement: springs with a cubic, square, cornered, gapped or pendulum law, or that change in time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.effects.effect import (
    Force,
    ForceEffect,
    Motion,
    ParameterKind,
    Situation,
    Values,
    cut_to_finite,
    least_length,
    levels,
    memoryless,
    positive_part,
)
from okid.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CubicStiffness(ForceEffect):
    """Cubic stiffness f = k3 d^3.

    In the data: an odd law, so a sine at f answers at 3 f and odd lines fill up while even ones stay empty; the
    resonance rises with the level where k3 > 0 (k + 3/4 k3 amplitude^2 to a first approximation) and falls where
    k3 < 0; the relative gap grows with the square of the level.

    Confused with: stops met now and then (one level beyond contact and one below tell them apart: below contact stops
    leave nothing) and sine softening (the same law to third order, k3 = -k / (6 length_scale^2): only motion beyond
    about one length scale tells).

    Parameters: k3 [force/length^3], of either sign.

    References:
        Duffing, Erzwungene Schwingungen bei veränderlicher Eigenfrequenz, Vieweg 1918; Kerschen et al., Past, present
        and future of nonlinear system identification in structural dynamics, Mech. Syst. Signal Process. 20(3), 2006,
        doi 10.1016/j.ymssp.2005.04.008.
    """

    key = "cubic_stiffness"
    law = "f = k3 d^3"
    parameters = (ParameterKind(name="k3", meaning="cubic stiffness", dimension=(1, -3, 0)),)
    neutral = (0.0,)
    family = "odd stiffness"
    signature = "odd lines, third harmonic; the resonance moves with the level"
    reference = "Kerschen et al. 2006, doi 10.1016/j.ymssp.2005.04.008"
    first_term = True

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        d = cut_to_finite(motion.displacement)
        square = d * d
        cube = square * d
        return memoryless(motion, values[0] * cube, (cube,), by_displacement=3.0 * values[0] * square)


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadraticStiffness(ForceEffect):
    """Quadratic stiffness f = k2 d^2.

    In the data: an even law, so a sine at f answers at 2 f and at zero frequency, even lines fill up, and the mean
    shifts against the sign of k2 with the square of the level; the relative gap grows in proportion to the level.

    Confused with: bilinear stiffness (also even, but its relative gap is the same at every level: two levels tell
    them apart; accelerometers miss the static shift, so never on the screen alone), and with a spring preloaded off
    the centre of a cubic law, of which it is one part.

    Parameters: k2 [force/length^2], of either sign (which way is stiffer).

    References:
        Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 2.3, doi 10.1002/9783527617586; the Silverbox needs it
        beside its cubic spring: Wigren, Schoukens, Three free data sets for development and benchmarking in nonlinear
        system identification, ECC 2013, doi 10.23919/ECC.2013.6669201.
    """

    key = "quadratic_stiffness"
    law = "f = k2 d^2"
    parameters = (ParameterKind(name="k2", meaning="quadratic stiffness", dimension=(1, -2, 0)),)
    neutral = (0.0,)
    family = "even stiffness"
    signature = "even lines, second harmonic, static shift that grows with the square of the level"
    reference = "Nayfeh, Mook 1979, doi 10.1002/9783527617586"
    first_term = True

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        d = cut_to_finite(motion.displacement)
        square = d * d
        return memoryless(motion, values[0] * square, (square,), by_displacement=2.0 * values[0] * d)


@dataclass(frozen=True, slots=True, kw_only=True)
class BilinearStiffness(ForceEffect):
    """Bilinear stiffness f = kb max(d, 0).

    Its corner is smoothed to a parabola of half-width smoothing x displacement scale. A breathing crack, a prestress
    that is lost, a one-sided support: the spring has one stiffness closed and another open.

    In the data: even lines and a static shift, and the same relative gap at every level: the law is homogeneous in the
    amplitude, so twice the force gives exactly twice the response; the resonance lies between those of the two
    springs, 2 f1 f2 / (f1 + f2), at every level.

    Confused with: quadratic stiffness (its relative gap grows with the level: two levels tell them apart;
    accelerometers miss the static shift, so never on the screen alone), and with kb / 2 of wrong linear stiffness, of
    which only the even part frees it.

    Parameters: kb [force/length], of either sign (which way is stiffer).

    References:
        Chu, Shen, Analysis of forced bilinear oscillators and the application to cracked beam dynamics, AIAA J. 30(10),
        1992, doi 10.2514/3.11271.
    """

    key = "bilinear_stiffness"
    law = "f = kb max(d, 0)"
    parameters = (ParameterKind(name="kb", meaning="stiffness on the positive side", dimension=(1, -1, 0)),)
    neutral = (0.0,)
    family = "even stiffness"
    has_corners = True
    signature = "even lines, static shift; the same relative gap at every level"
    reference = "Chu, Shen 1992, doi 10.2514/3.11271"

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        positive, slope = positive_part(motion.displacement, motion.smoothing * motion.displacement_scale)
        return memoryless(motion, values[0] * positive, (positive,), by_displacement=values[0] * slope)


SHARES = (0.2, 0.5, 0.8, 0.95)
"""Start from gaps that these shares of the motion stay within."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GapSpring(ForceEffect):
    """Spring with a symmetric gap: f = k_in d + (k_out - k_in) r(d), r(d) = max(d - gap, 0) - max(-d - gap, 0).

    r is the part of the displacement beyond the gap, with its sign: (|d| - gap) sign(d) outside, 0 inside. Each corner
    is smoothed to a parabola of half-width smoothing x displacement scale, which leaves the law odd at every gap.

    In the data: an odd law. Stops (k_out above k_in): nothing below contact, a resonance that rises from one level on,
    peaks of force cut sharp. Freeplay (k_in far below k_out): a soft, ill-defined resonance at low level that
    stiffens as the level rises; free runs may be chaotic.

    Confused with: cubic stiffness (one level beyond contact and one below tell them apart). A gap that is never reached
    leaves a linear spring, a wrong stiffness; k_in is also a change of the linear stiffness at the place, so where
    that is free too only k_out - k_in and the gap are determined.

    Parameters: k_in [force/length] within the gap, beside the linear stiffness at the place and so negative for
    freeplay in a model that was too stiff there; k_out [force/length] beyond it, not negative; gap [length], not
    negative.

    References:
        Shaw, Holmes, A periodically forced piecewise linear oscillator, J. Sound Vib. 90(1), 1983, doi
        10.1016/0022-460X(83)90407-8.
    """

    key = "gap_spring"
    law = "f = k_in d within the gap, k_in d + (k_out - k_in)(|d| - gap) sign(d) beyond it"
    parameters = (
        ParameterKind(name="k_in", meaning="stiffness within the gap, beside the linear one", dimension=(1, -1, 0)),
        ParameterKind(
            name="k_out", meaning="stiffness beyond the gap, beside the linear one", dimension=(1, -1, 0), lower=0.0
        ),
        ParameterKind(
            name="gap", meaning="displacement at contact, either way", dimension=(0, 1, 0), lower=0.0, role="shape"
        ),
    )
    neutral = (0.0, 0.0, 1.0)
    family = "odd stiffness"
    has_corners = True
    beside_stiffness = ("k_in", "k_out")
    signature = "odd lines; stops: nothing below one level; freeplay: soft at low level, stiff at high"
    reference = "Shaw, Holmes 1983, doi 10.1016/0022-460X(83)90407-8"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """One start for each gap that a share of the motion stays within."""
        return tuple((1.0, 1.0, gap) for gap in levels(situation.motion.displacement, SHARES))

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        k_in, k_out, gap = values
        d = motion.displacement
        width = motion.smoothing * motion.displacement_scale
        above, slope_above = positive_part(d - gap, width)
        below, slope_below = positive_part(-d - gap, width)
        beyond = above - below
        return memoryless(
            motion,
            k_in * (d - beyond) + k_out * beyond,
            (d - beyond, beyond, (k_out - k_in) * (slope_below - slope_above)),
            by_displacement=k_in + (k_out - k_in) * (slope_above + slope_below),
        )


LENGTHS = (1.0, 3.0)
"""Start from these length scales, in units of the largest displacement."""
STRAIGHT = 1e-2
"""Take sine less angle from its series below this d / length_scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SineSoftening(ForceEffect):
    """Sine softening f = k L (sin(d / L) - d / L), with which the spring k d of the model becomes k L sin(d / L).

    k is the linear stiffness at the place, L the length scale: 1 rad for a pendulum whose displacement is its angle,
    the length of the pendulum for the arc, the width of a magnet's pole for a magnetic spring.

    In the data: an odd law; the resonance falls with the level (a pendulum's by angle^2 / 16) and nothing is lost: the
    damping stays; the relative gap grows with the square of the level.

    Confused with: cubic stiffness with k3 = -k / (6 L^2), to third order in d / L; only motion beyond about one length
    scale tells. L is known beforehand more often than not (1 rad): a found L at the known value is evidence.

    Parameters: length_scale [length], not negative; infinite for no effect.

    References:
        Nelson, Olsson, The pendulum: rich physics from a simple system, Am. J. Phys. 54(2), 1986, doi 10.1119/1.14703.
    """

    key = "sine_softening"
    law = "f = k length_scale (sin(d/length_scale) - d/length_scale), k the linear stiffness"
    parameters = (
        ParameterKind(
            name="length_scale", meaning="displacement of one radian", dimension=(0, 1, 0), lower=0.0, role="shape"
        ),
    )
    neutral = (np.inf,)
    family = "odd stiffness"
    needs = frozenset({"displacement", "stiffness"})
    per_stiffness = True
    signature = "odd lines; the resonance falls with the square of the level, the damping stays"
    reference = "Nelson, Olsson 1986, doi 10.1119/1.14703"

    def known_values(self, length_unit: str) -> tuple[float | None, ...]:
        """One radian, where the displacement is an angle."""
        return ({"rad": 1.0, "deg": 180.0 / np.pi}.get(length_unit),)

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """One start for each length scale, about as long as the motion and longer."""
        largest = float(np.max(np.abs(situation.motion.displacement), initial=0.0)) or 1.0
        return tuple((share * largest,) for share in LENGTHS)

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        d, k = cut_to_finite(motion.displacement), motion.stiffness
        length = np.maximum(values[0], least_length(motion.displacement_scale))
        angle = d / length
        missing = _sine_less_angle(angle)
        # length x missing, written so that an infinite length gives 0 and not infinity x 0
        share = np.divide(missing, angle, out=np.zeros_like(angle), where=angle != 0.0)
        return memoryless(
            motion,
            k * d * share,
            (k * (missing + angle * 2.0 * np.sin(0.5 * angle) ** 2),),
            by_displacement=-2.0 * k * np.sin(0.5 * angle) ** 2,
        )

    def screen_columns(self, values: Values, motion: Motion) -> FloatArray:
        """The force at the length scale in `values`: its shape is nearly the same at every greater one."""
        return self.force(values, motion).value[:, None]

    def from_screen(self, values: Values, weights: Sequence[float] | FloatArray) -> tuple[float, ...]:
        """The length scale whose cubic term is `weights[0]` times that at `values`; at most ten times as long."""
        return (float(values[0]) / float(np.sqrt(min(max(float(weights[0]), 0.01), 100.0))),)


def _sine_less_angle(angle: FloatArray) -> FloatArray:
    small = np.clip(angle, -STRAIGHT, STRAIGHT)
    square = small * small
    series = -small * square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    return np.where(np.abs(angle) < STRAIGHT, series, np.sin(angle) - angle)


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeVaryingStiffness(ForceEffect):
    """Time-varying stiffness f = rate t d, t since the start of each record.

    Warming, wear, a tank that empties: the linear stiffness is that at the start of each record.

    In the data: the gap grows while the record runs and is the same, in proportion, at every level; the resonance
    moves with the time and not with the level; no harmonics of a steady sine.

    Confused with: a wrong linear stiffness (that is its mean over the record: only the change within it tells), and,
    where each record is louder at its end, with any law that grows with the level.

    Parameters: rate [force/(length time)], of either sign.

    References:
        Poulimenos, Fassois, Parametric time-domain methods for non-stationary random vibration modelling and analysis,
        Mech. Syst. Signal Process. 20(4), 2006, doi 10.1016/j.ymssp.2005.10.003.
    """

    key = "time_varying_stiffness"
    law = "f = rate t d"
    parameters = (
        ParameterKind(name="rate", meaning="change of stiffness over time, from the start", dimension=(1, -1, -1)),
    )
    neutral = (0.0,)
    family = "drifting stiffness"
    signature = "the gap grows in time, in proportion the same at every level"
    reference = "Poulimenos, Fassois 2006, doi 10.1016/j.ymssp.2005.10.003"

    def force(self, values: Values, motion: Motion) -> Force:
        """The force and its derivatives."""
        swept = motion.time * motion.displacement
        return memoryless(motion, values[0] * swept, (swept,), by_displacement=values[0] * motion.time)
