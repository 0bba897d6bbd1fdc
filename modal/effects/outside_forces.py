"""Forces of what the model has nothing of: a weight or preload, a sine that nobody measured, a mass on a spring.

No motion changes the first two. The third is a tuned absorber, a loose panel, a part on a soft mount: between samples
the displacement d of the place is taken as the cubic through displacement and velocity at both ends,
for which the step of (z, z') is exact: the exponential of one 6 x 6 matrix (the absorber driven by a chain of four
integrators that holds the cubic), once for a set of parameters; its derivatives by frequency and damping are Fréchet
derivatives of that exponential.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy

from modal.effects.effect import (
    N_PEAKS,
    Force,
    ForceEffect,
    Memory,
    Motion,
    ParameterKind,
    Situation,
    Values,
    memoryless,
)
from modal.simulation import UNDAMPED_DEVIATION
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


RATIOS = (1.0, 0.9, 1.11)
"""Start from these frequencies, by each peak: an absorber splits the resonance of its host, so its own frequency lies
between two peaks, and each peak is off by about the root of the mass ratio."""


def _flow(frequency: float, damping: float, dt: float) -> tuple[FloatArray, FloatArray]:
    """The generator (6, 6) of one step in the time s / dt, and its derivatives (2, 6, 6) by frequency and damping.

    The states are (z, z' dt) and the cubic (d, d' dt, d'' dt^2, d''' dt^3).
    """
    w = 2.0 * np.pi * frequency * dt
    generator = np.zeros((6, 6))
    generator[0, 1] = generator[2, 3] = generator[3, 4] = generator[4, 5] = 1.0
    generator[1, :4] = -(w**2), -2.0 * damping * w, w**2, 2.0 * damping * w
    by_shape = np.zeros((2, 6, 6))
    by_shape[0, 1, :4] = np.array([-2.0 * w, -2.0 * damping, 2.0 * w, 2.0 * damping]) * (2.0 * np.pi * dt)
    by_shape[1, 1, :4] = 0.0, -2.0 * w, 0.0, 2.0 * w
    return generator, by_shape


@lru_cache(maxsize=64)
def _step(frequency: float, damping: float, dt: float) -> tuple[FloatArray, FloatArray]:
    """One step (2, 6) of (z, z') from (z, z', d, d', d after, d' after), and its derivatives (2, 2, 6)."""
    generator, by_shape = _flow(frequency, damping, dt)
    cubic = np.array(  # (d, d' dt, d'' dt^2, d''' dt^3) at the start from (d, d' dt) at both ends
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-6.0, -4.0, 6.0, -2.0], [12.0, 6.0, -12.0, 6.0]]
    )
    entry = scipy.linalg.block_diag(np.eye(2), cubic) * np.array([1.0, dt, 1.0, dt, 1.0, dt])
    leave = np.array([[1.0], [1.0 / dt]])
    rows = [
        scipy.linalg.expm(generator),
        *(scipy.linalg.expm_frechet(generator, e, compute_expm=False) for e in by_shape),
    ]
    steps = np.stack([leave * (row[:2] @ entry) for row in rows])
    return steps[0], steps[1:]


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingMode(ForceEffect):
    """A mass on a spring and a damper, hung on the place where the port moves.

    Signature: a resonance splits in two, or a narrow band about one frequency is wrong; the relative gap there is the
    same at every level (the effect is linear).

    Law: with m = mass_ratio x (mass at the place), w = 2 pi frequency, k = m w^2, c = 2 m damping w, and z the absolute
    displacement of the hung mass:

        f = k (d - z) + c (d' - z')        z'' = w^2 (d - z) + 2 damping w (d' - z')

    Parameters: mass_ratio [-], frequency [Hz] and damping [-] of the hung mass with its place held; none negative.

    Confused with: a periodic disturbance, where one level only was measured (2 ln L margin 8; three levels 191): a mode
    scales with the drive. A wrong stiffness of a mode that is in the model moves one resonance, a missing mode adds
    one. At a node of the structure it does not show at all.

    References:
        J. Ormondroyd, J. P. Den Hartog, The theory of the dynamic vibration absorber, Transactions of the ASME 50,
        1928, 9-22.
    """

    key = "missing_mode"
    law = "f = k (d - z) + c (d' - z'), m z'' = f"
    parameters = (
        ParameterKind(name="mass_ratio", meaning="hung mass by the mass at the place", dimension=(0, 0, 0), lower=0.0),
        ParameterKind(
            name="frequency",
            meaning="frequency of the hung mass with its place held, in Hz",
            dimension=(0, 0, -1),
            lower=0.0,
            role="shape",
        ),
        ParameterKind(
            name="damping",
            meaning="damping ratio with its place held",
            dimension=(0, 0, 0),
            lower=0.0,
            upper=1.0,
            role="shape",
        ),
    )
    neutral = (0.0, 1.0, UNDAMPED_DEVIATION)
    family = "narrow band"
    signature = "narrow band, same relative size at every level"
    reference = "Ormondroyd, Den Hartog, Transactions of the ASME 50, 1928, 9-22"
    like_a_mass = True
    needs = frozenset({"displacement", "velocity"})
    acts_at = "mass"
    n_memory = 2

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Highest peaks of the residual and a tenth to either side; without any, the mean frequency of the motion."""
        motion = situation.motion
        peaks = tuple(peak for peak in situation.residual_frequencies[:N_PEAKS] if peak > 0.0)
        if not peaks and motion.displacement_scale > 0.0 and motion.velocity_scale > 0.0:
            peaks = (motion.velocity_scale / (2.0 * np.pi * motion.displacement_scale),)  # Rice: rate of up-crossings
        return tuple((1.0, ratio * peak, UNDAMPED_DEVIATION) for peak in peaks for ratio in RATIOS)

    def undriven(self, values: Values) -> tuple[ForceEffect, tuple[float, ...], float]:
        """The vibration that a light mass with a wide swing leaves."""
        return FreeVibration(), (float(values[1]), float(values[2])), float(values[0])

    def force(self, values: Values, motion: Motion) -> Force:
        """The force of spring and damper on the place, and its derivatives."""
        ratio, frequency, damping = values
        mass = motion.mass
        w = 2.0 * np.pi * frequency
        stretch = motion.displacement - motion.memory[:, 0]
        rate = motion.velocity - motion.memory[:, 1]
        stiffness = np.zeros(stretch.size) + ratio * mass * w**2
        damper = np.zeros(stretch.size) + 2.0 * ratio * mass * damping * w
        by_mass = mass * (w**2 * stretch + 2.0 * damping * w * rate)
        by_frequency = 4.0 * np.pi * ratio * mass * (w * stretch + damping * rate)
        by_damping = 2.0 * ratio * mass * w * rate
        return Force(
            value=ratio * by_mass,
            by_displacement=stiffness,
            by_velocity=damper,
            by_memory=-np.stack([stiffness, damper], axis=1),
            by_parameter=np.stack([by_mass, by_frequency, by_damping], axis=1),
        )

    def advance(self, values: Values, before: Motion, after: Motion, dt: float) -> Memory:
        """(z, z') one sample on, exact for a displacement that is a cubic between the samples."""
        step, by_shape = _step(float(values[1]), float(values[2]), dt)
        drive = np.stack([before.displacement, before.velocity, after.displacement, after.velocity], axis=1)
        state = np.concatenate([before.memory, drive], axis=1)
        n_samples = state.shape[0]
        by_parameter = np.zeros((n_samples, 2, 3))
        by_parameter[:, :, 1:] = np.einsum("pij,nj->nip", by_shape, state)
        return Memory(
            value=state @ step.T,
            by_memory=np.tile(step[:, :2], (n_samples, 1, 1)),
            by_displacement_before=np.tile(step[:, 2], (n_samples, 1)),
            by_velocity_before=np.tile(step[:, 3], (n_samples, 1)),
            by_displacement_after=np.tile(step[:, 4], (n_samples, 1)),
            by_velocity_after=np.tile(step[:, 5], (n_samples, 1)),
            by_parameter=by_parameter,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeVibration(ForceEffect):
    """A vibration that no motion drives: every record begins with as much of it as it likes. No entry of the catalogue.

    Law: with m the mass at the place and w = 2 pi frequency, f = m z'' and z'' + 2 damping w z' + w^2 z = 0. A missing
    mode comes to it as its mass goes to none and its swing to infinity. Undamped it is a sine whose size and phase are
    each record's own.
    """

    key = "free_vibration"
    law = "f = m z'', z'' + 2 damping w z' + w^2 z = 0"
    parameters = MissingMode.parameters[1:]
    neutral = MissingMode.neutral[1:]
    family = "narrow band"
    signature = "one line, of a size and a phase of its own in each record"
    reference = MissingMode.reference
    needs = MissingMode.needs
    acts_at = "mass"
    n_memory = 2

    def force(self, values: Values, motion: Motion) -> Force:
        """The force of a missing mode of the mass at the place, itself held, and its derivatives."""
        found = MissingMode().force((1.0, *values), _held(motion))
        return replace(
            found,
            by_displacement=np.zeros_like(found.value),
            by_velocity=np.zeros_like(found.value),
            by_parameter=found.by_parameter[:, 1:],
        )

    def advance(self, values: Values, before: Motion, after: Motion, dt: float) -> Memory:
        """(z, z') one sample on."""
        found = MissingMode().advance((1.0, *values), _held(before), _held(after), dt)
        none = np.zeros_like(found.value)
        return replace(
            found,
            by_displacement_before=none,
            by_velocity_before=none,
            by_displacement_after=none,
            by_velocity_after=none,
            by_parameter=found.by_parameter[:, :, 1:],
        )


def _held(motion: Motion) -> Motion:
    """The same with the place at rest."""
    none = np.zeros_like(motion.displacement)
    return replace(motion, displacement=none, velocity=none)
