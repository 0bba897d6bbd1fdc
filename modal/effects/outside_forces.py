"""Forces that no motion changes: a weight or preload, and a sine that nobody measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.effects.effect import N_PEAKS, Force, ForceEffect, Motion, ParameterKind, Situation, Values, memoryless
from okid.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantForce(ForceEffect):
    """A constant force at a place.

    Signature: a gap at zero frequency, of the same absolute size at every level, at one place. An accelerometer does
    not see it but for the transient at the start.

    Law: `f = offset` (opposes positive motion where it is positive). Parameters: offset [force].

    Confused with: the bias of a sensor where one displacement is measured; Coulomb friction where the velocity never
    reverses; the static shift of quadratic stiffness, which grows with the square of the level. A second output, a run
    in the other direction and a second level separate them.

    References:
        K. Worden, G. R. Tomlinson, Nonlinearity in Structural Dynamics, 2001 (a static preload),
        doi 10.1201/9781420033823
    """

    key = "constant_force"
    law = "f = offset"
    parameters = (
        ParameterKind(name="offset", meaning="constant force, positive against positive motion", dimension=(1, 0, 0)),
    )
    neutral = (0.0,)
    family = "offset"
    signature = "zero frequency, same absolute size at every level, at one place"
    reference = "Worden, Tomlinson, Nonlinearity in Structural Dynamics, 2001"
    needs = frozenset()
    acts_at = "force"

    def force(self, values: Values, motion: Motion) -> Force:
        """The offset at every sample; no motion changes it."""
        one = np.ones_like(motion.displacement)
        return memoryless(motion, values[0] * one, (one,))


OFF_PEAK = 1.0 / 3.0
"""Try the highest peak also this share of a spectral line 1 / longest to either side: a peak is known to half a
line only, where a sine that is off by half a line loses 59 % of its power and one off by a sixth of a line 9 %."""

FEWEST_PERIODS = 3.0
"""Try no sine with fewer periods in the longest record: it bends like a drift, and nothing shows that it repeats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodicDisturbance(ForceEffect):
    """A sine force at a place, independent of the motion.

    Signature: one line in the spectrum of the gap, of the same absolute size at every level; its phase differs from
    record to record.

    Law: `f = amplitude sin(2 pi frequency t + phase)`, with a phase of its own in each record (t counts from its
    start).

    Parameters: amplitude [force] and frequency [Hz], not negative; phase [rad].

    Confused with: a missing mode, where one level only was measured (both leave a narrow band; a mode scales with the
    drive, a disturbance does not: 2 ln L margin 8 at one level, 191 at three); a constant force or the drift of a
    sensor, where the period is longer than the record. A record without any drive settles both.

    The screen takes a sine and a cosine for each frequency, so that the phase needs no search.

    References:
        D. C. Rife, R. R. Boorstyn, Single-tone parameter estimation from discrete-time observations, IEEE Transactions
        on Information Theory 20(5), 1974, 591-598, doi 10.1109/TIT.1974.1055282.

    Example:
        >>> values = PeriodicDisturbance().from_screen([1.0, 50.0, 0.0], [0.0, 2.0])  # all of it in the cosine
        >>> [round(value, 4) for value in values]
        [2.0, 50.0, 1.5708]
    """

    key = "periodic_disturbance"
    law = "f = amplitude sin(2 pi frequency t + phase)"
    parameters = (
        ParameterKind(name="amplitude", meaning="largest force", dimension=(1, 0, 0), lower=0.0),
        ParameterKind(name="frequency", meaning="frequency in Hz", dimension=(0, 0, -1), lower=0.0, role="shape"),
        ParameterKind(
            name="phase", meaning="angle at the start of each record", dimension=(0, 0, 0), role="shape", local=True
        ),
    )
    neutral = (0.0, 1.0, 0.0)
    family = "narrow band"
    signature = "one line, same absolute size at every level"
    reference = "Rife, Boorstyn, IEEE Transactions on Information Theory 20(5), 1974"
    needs = frozenset()
    acts_at = "force"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """The highest peaks of the residual that are no drift, and the two sides of the highest."""
        slowest = FEWEST_PERIODS / situation.longest if situation.longest > 0.0 else 0.0
        peaks = tuple(peak for peak in situation.residual_frequencies if peak >= slowest)[:N_PEAKS]
        step = OFF_PEAK / situation.longest if situation.longest > 0.0 else 0.0
        sides = (peaks[0] - step, peaks[0] + step) if peaks and step > 0.0 else ()
        return tuple((1.0, frequency, 0.0) for frequency in (*peaks, *sides) if frequency > 0.0)

    def force(self, values: Values, motion: Motion) -> Force:
        """The sine at each sample and its derivatives by amplitude, frequency and phase."""
        amplitude, frequency, phase = values
        angle = 2.0 * np.pi * frequency * motion.time + phase
        sine, quadrature = np.sin(angle), amplitude * np.cos(angle)
        by_frequency = 2.0 * np.pi * motion.time * quadrature
        return memoryless(motion, amplitude * sine, (sine, by_frequency, quadrature))

    def screen_columns(self, values: Values, motion: Motion) -> FloatArray:
        """Sine and cosine of the frequency in `values`, (n, 2): together every amplitude and phase."""
        angle = 2.0 * np.pi * values[1] * motion.time
        return np.stack([np.sin(angle), np.cos(angle)], axis=1)

    def from_screen(self, values: Values, weights: Sequence[float] | FloatArray) -> tuple[float, ...]:
        """Amplitude and phase from the weights of sine and cosine; the frequency stays."""
        sine, cosine = float(weights[0]), float(weights[1])
        return float(np.hypot(sine, cosine)), float(values[1]), float(np.arctan2(cosine, sine))
