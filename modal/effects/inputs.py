"""What a drive does to its command: gain, a limit, a lag, a delay.

An amplifier, valve or motor at its end cannot exceed a limit; a coil's inductance or a filter in the output stage lets
the drive follow late. Input goes straight from a to b over a step, with jumps allowed between steps, and so goes what
replaces it: the one straight line with its mean and its first moment over the step, so that the state at the end of the
step is right but for (dt x pole)^2 of what is not straight in it.

The lagging drive z obeys tau z' = u - z: with r = dt / tau and the time s in steps,

    z(s) = a + (b - a) (s - 1/r) + c exp(-r s),     c = z(0) - a + (b - a) / r

For a delay tau = (m + f) dt the drive within step k is the last share f of step k - m - 1 followed by the first share
1 - f of step k - m. For a zero-order hold with the values a, then b:

    mean = f a + (1 - f) b        end - start = 6 f (1 - f) (b - a)

The line is continuous in tau, also across whole steps, where its slope by tau jumps.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from modal.effects.effect import InputEffect, ParameterKind, Situation, Values
from okid.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class InputGain(InputEffect):
    """The drive times a factor; 1 is no effect, and the derivative by the gain is the drive itself.

    Signature: the output is the simulated one times a factor, the same at every frequency, level and output that this
    input drives.

    Law: `u' = gain u`. Parameters: gain [-], the factor itself.

    Confused with: with one degree of freedom the gain of the sensor and the scale of the mass, damping and stiffness
    together (they are one number); a saturation seen at one level only. Several outputs separate it from the gain of a
    sensor, several inputs from the scale of the mass, several levels from a saturation.

    References:
        K. Worden, G. R. Tomlinson, Nonlinearity in Structural Dynamics, 2001 (homogeneity: a gain keeps it, so that no
        level tells it from a linear model), doi 10.1201/9781420033823

    Example:
        >>> InputGain().apply([0.5], np.array([2.0]), np.array([4.0]), 0.01)
        (array([1.]), array([2.]))
    """

    key = "input_gain"
    law = "u' = gain u"
    parameters = (ParameterKind(name="gain", meaning="factor on the drive, 1 for none", dimension=(0, 0, 0)),)
    neutral = (1.0,)
    family = "input gain"
    signature = "flat ratio at every frequency and level"
    reference = "Worden, Tomlinson, Nonlinearity in Structural Dynamics, 2001"
    like_a_mass = True

    def apply(self, values: Values, start: FloatArray, end: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002 - a gain needs no time
        """Start and end of each step times the gain."""
        gain = float(values[0])
        return gain * start, gain * end

    def by_parameter(
        self,
        values: Values,  # noqa: ARG002 - linear
        sample: FloatArray,
        start: FloatArray,
        end: FloatArray,
        dt: float,  # noqa: ARG002 - a gain needs no time
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The drive itself."""
        return start[np.newaxis], end[np.newaxis], sample[np.newaxis]


SHARES = (0.9, 0.7, 0.5, 0.3)
"""Start from these shares of the largest drive of all records: of a random drive (largest about 3.5 standard
deviations) they clip from one sample in 600 to one in three."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InputSaturation(InputEffect):
    """The drive clipped at plus and minus a limit.

    Signature: nothing at low level; above a level the output stays behind the simulation, most where the drive is
    highest; odd harmonics of the drive.

    Law: `u' = min(max(u, -limit), limit)`, taken at both ends of each step. Parameters: limit [input], not
    negative.

    Confused with: an input gain below 1, where every record is far above the limit or only one level was measured;
    Coulomb friction or drag at the driven place. One level below the limit separates it from a gain, and the loss in
    saturation follows the drive alone, not the motion.

    References:
        K. J. Åström, R. M. Murray, Feedback Systems, 2nd ed., 2021 (saturation of actuators and its describing
        function).

    Example:
        >>> u = np.array([-3.0, 0.5, 2.0])
        >>> InputSaturation().apply([1.0], u, u, 0.01)[0]
        array([-1. ,  0.5,  1. ])
    """

    key = "input_saturation"
    law = "u' = min(max(u, -limit), limit)"
    parameters = (
        ParameterKind(
            name="limit", meaning="largest drive of either sign", dimension=(1, 0, 0), lower=0.0, role="shape"
        ),
    )
    neutral = (np.inf,)
    family = "input gain"
    signature = "nothing at low level, output stays behind at high level"
    reference = "Åström, Murray, Feedback Systems, 2nd ed., 2021"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Shares of the largest drive; none for a drive that is zero."""
        peak = float(np.max(np.abs(situation.motion.displacement), initial=0.0))
        return tuple((share * peak,) for share in SHARES) if peak > 0.0 else ()

    def apply(self, values: Values, start: FloatArray, end: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002 - clipping needs no time
        """Start and end of each step, clipped."""
        limit = abs(float(values[0]))
        return np.clip(start, -limit, limit), np.clip(end, -limit, limit)

    def by_parameter(
        self,
        values: Values,
        sample: FloatArray,
        start: FloatArray,
        end: FloatArray,
        dt: float,  # noqa: ARG002 - clipping needs no time
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The sign of the drive where it is clipped, 0 elsewhere."""
        limit = abs(float(values[0]))

        def sign(drive: FloatArray) -> FloatArray:
            return np.where(np.abs(drive) > limit, np.sign(drive), 0.0)[np.newaxis]

        return sign(start), sign(end), sign(sample)


LAGS = (0.3, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Start from these lags, in steps: each doubles the phase of the one before."""


def lag_starts(situation: Situation) -> tuple[tuple[float, ...], ...]:
    """Lags that double, up to a hundredth of the longest record."""
    return tuple((count * situation.dt,) for count in LAGS if count * situation.dt <= 0.01 * situation.longest)


FADED = math.log(1e3)
"""Count what a drive was before its record as gone after so many lags: a thousandth of it is left."""
STEEPEST = 1e-6
"""Take a lag below this share of a step for none: the response to a step is over within it."""


def lagged(first: float, share: float, forcing: FloatArray) -> FloatArray:
    """The z of z[k+1] = share z[k] + forcing[k], (n + 1,), from z[0] = first.

    Example:
        >>> lagged(1.0, 0.5, np.array([0.0, 1.0]))
        array([1.  , 0.5 , 1.25])
    """
    band = np.ones((2, len(forcing) + 1))
    band[1] = -share
    found, _ = scipy.linalg.lapack.dtbtrs(band, np.concatenate([[first], forcing]), uplo="L", diag="U")
    return np.asarray(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class ActuatorLag(InputEffect):
    """The drive behind a first-order lag.

    Signature: the phase of every output lags and its magnitude falls as frequency rises, alike at every level and in
    every output that this input drives.

    Law: `tau u'' + u' = u`: the drive u' is the command u through 1 / (tau s + 1). Parameters: tau [s], not negative.
    What the drive was before a record is not known: what a record shows within seven lags of its start is not judged,
    unless it starts without any drive.

    Confused with: a delay, whose phase goes on in proportion to frequency and which leaves the magnitude; with one
    input and one output a lag of the sensor, which in a linear structure is the same.

    References:
        K. J. Åström, R. M. Murray, Feedback Systems, 2nd ed., 2021 (first-order lag), https://fbswiki.org

    Example:
        >>> u = np.array([0.0, 1.0, 1.0, 1.0])
        >>> ActuatorLag().at_samples([1.0], u, u, u, 1.0).round(3)
        array([0.   , 0.   , 0.632, 0.865])
    """

    key = "actuator_lag"
    law = "tau du'/dt + u' = u"
    parameters = (ParameterKind(name="tau", meaning="lag of the drive", dimension=(0, 0, 1), lower=0.0, role="shape"),)
    neutral = (0.0,)
    family = "lag"
    signature = "phase lags and magnitude falls with frequency, same at every level"
    reference = "Åström, Murray, Feedback Systems, 2nd ed., 2021"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """As of every lag."""
        return lag_starts(situation)

    def apply(self, values: Values, start: FloatArray, end: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """Start and end of the line with the lagging drive's mean and first moment over each step."""
        z = self.at_samples(values, start, start, end, dt)
        if not _lags(values, dt):
            return start, end
        r = dt / float(values[0])
        rest = z - start + (end - start) / r
        gone = -math.expm1(-r)
        area, lever = gone / r, (gone - r * math.exp(-r)) / r**2 - 0.5 * gone / r
        mean = start + (end - start) * (0.5 - 1.0 / r) + area * rest
        moment = (end - start) / 12.0 + lever * rest
        return mean - 6.0 * moment, mean + 6.0 * moment

    def at_samples(
        self, values: Values, sample: FloatArray, start: FloatArray, end: FloatArray, dt: float
    ) -> FloatArray:
        """The lagging drive at each time, from the first value of the command on."""
        if not _lags(values, dt) or start.size == 0:
            return sample
        r = dt / float(values[0])
        left = math.exp(-r)
        by_end = 1.0 + math.expm1(-r) / r
        return lagged(float(start[0]), left, ((1.0 - left - by_end) * start + by_end * end)[:-1])

    def unheard(self, values: Values, dt: float) -> tuple[int, int]:
        """As many times at the start as the drive before it takes to fade."""
        return math.ceil(FADED * float(values[0]) / dt), 0


def _lags(values: Values, dt: float) -> bool:
    return float(values[0]) > STEEPEST * dt


DELAYS = (-0.5, 0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 7.5, 10.5, 15.5, 22.5, 31.5)
"""Start from these delays, in steps: each lies between whole steps, where a held drive has no bend in tau; a broadband
drive that is held has lost its correlation after one step, so the first are dense. The negative one is for skew: a
wrong hold, or outputs that were written down a step after their inputs."""
WHOLE = 1e-6
"""Take a delay within this share of a step of a whole number of steps for that number: division by dt rounds."""


def _split(tau: float, dt: float, longest: int) -> tuple[int, float]:
    """Whole steps, rounded down, and the share of a step that is left."""
    steps = min(max(tau / dt, -float(longest)), float(longest))
    whole = round(steps)
    if abs(steps - whole) < WHOLE:
        return whole, 0.0
    return math.floor(steps), steps - math.floor(steps)


def _steps_before(edge: FloatArray, lag: int, *, first: float, last: float) -> FloatArray:
    """The values `lag` steps earlier: `first` before the start, `last` after the end."""
    shift = min(abs(lag), edge.size)
    if lag >= 0:
        return np.concatenate([np.full(shift, first), edge[: edge.size - shift]])
    return np.concatenate([edge[shift:], np.full(shift, last)])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Step:
    """The drive over the step that lies some steps before each step."""

    start: FloatArray
    rise: FloatArray

    @staticmethod
    def of(start: FloatArray, end: FloatArray, lag: int) -> "_Step":
        first, last = float(start[0]), float(end[-1])
        begin = _steps_before(start, lag, first=first, last=last)
        return _Step(start=begin, rise=_steps_before(end, lag, first=first, last=last) - begin)

    def at(self, share: float) -> FloatArray:
        """Its values at a share of the step."""
        return self.start + share * self.rise


def _mean(now: _Step, before: _Step, f: float) -> FloatArray:
    """Mean of the last share f of one step and the first share 1 - f of the next."""
    return f * before.at(1.0 - 0.5 * f) + (1.0 - f) * now.at(0.5 * (1.0 - f))


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayedInput(InputEffect):
    """The drive delayed by tau, whole samples or fractions; a negative tau is a drive that acts before it is recorded.

    Signature: the phase of the output lags by an angle in proportion to frequency, the same at every level; the
    magnitude is right. The relative gap grows with frequency.

    Law: `u'(t) = u(t - tau)`, with the first value held before the record starts and the last one after its end; what
    a record shows before its own drive arrives is not judged, unless it starts without any.
    Parameters: tau [s]; a negative one is no physics but skew of the record.

    Confused with: a wrongly declared hold (half a sample, of either sign); outputs written down a step after their
    inputs (-1 sample); a lag of the actuator (a pole: its phase bends, and the magnitude falls); stiffness and damping
    that are wrong, where the drive covers one resonance only. A drive that covers frequencies away from any resonance
    separates them.

    References:
        K. J. Åström, B. Wittenmark, Computer-Controlled Systems, 3rd ed., 1997 (sampling of a system with a delay that
        is no whole number of samples: the two pieces of each step).

    Example:
        >>> u = np.array([0.0, 1.0, 1.0, 1.0])  # a zero-order hold: start and end of each step agree
        >>> start, end = DelayedInput().apply([0.25], u, u, 1.0)
        >>> (start + end) / 2
        array([0.  , 0.75, 1.  , 1.  ])
    """

    key = "input_delay"
    law = "u'(t) = u(t - tau)"
    parameters = (ParameterKind(name="tau", meaning="delay of the drive", dimension=(0, 0, 1), role="shape"),)
    neutral = (0.0,)
    family = "delay"
    signature = "phase lag in proportion to frequency, same at every level"
    reference = "Åström, Wittenmark, Computer-Controlled Systems, 3rd ed., 1997"

    def starts(self, situation: Situation) -> tuple[tuple[float, ...], ...]:
        """Delays between whole steps, dense at first, up to a tenth of the longest record."""
        delays = [count * situation.dt for count in DELAYS]
        return tuple((delay,) for delay in delays if delay <= max(0.1 * situation.longest, delays[0]))

    def apply(self, values: Values, start: FloatArray, end: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """Start and end of each step of the delayed drive, with its mean and first moment over each step."""
        if start.size == 0:
            return start, end
        lag, f = _split(float(values[0]), dt, start.size + 1)
        if f == 0.0:
            first, last = float(start[0]), float(end[-1])
            return _steps_before(start, lag, first=first, last=last), _steps_before(end, lag, first=first, last=last)
        now, before = _Step.of(start, end, lag), _Step.of(start, end, lag + 1)
        entry = before.at(1.0 - f)
        # integrals of (s - 1/2) and s (s - 1/2) over the share [0, f] of the step; over all of it 0 and 1/12
        lever, curve = 0.5 * f * (f - 1.0), f**3 / 3.0 - 0.25 * f**2
        moment = lever * (entry - now.at(-f)) + curve * before.rise + (1.0 / 12.0 - curve) * now.rise
        mean = _mean(now, before, f)
        return mean - 6.0 * moment, mean + 6.0 * moment

    def at_samples(
        self, values: Values, sample: FloatArray, start: FloatArray, end: FloatArray, dt: float
    ) -> FloatArray:
        """The delayed drive at each time itself (not the line's start, which is off where the hold jumps in a step)."""
        if start.size == 0:
            return sample
        lag, f = _split(float(values[0]), dt, start.size + 1)
        if f == 0.0:
            return _steps_before(sample, lag, first=float(sample[0]), last=float(sample[-1]))
        return _Step.of(start, end, lag + 1).at(1.0 - f)

    def unheard(self, values: Values, dt: float) -> tuple[int, int]:
        """As many times at the start as the delay is long, or at the end where it is negative."""
        steps = float(values[0]) / dt
        count = math.ceil(abs(steps) - WHOLE)
        return (count, 0) if steps > 0.0 else (0, count)

    def by_parameter(
        self,
        values: Values,
        sample: FloatArray,  # noqa: ARG002 - the steps tell how it changes
        start: FloatArray,
        end: FloatArray,
        dt: float,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives by tau; of whole steps those of the side nearer to none, of none those of a slightly longer one.

        With u(x) the drive before the change and x in steps, the mean over [-f, 1 - f] changes by u(-f) - u(1 - f), the
        moment by mean - (u(-f) + u(1 - f)) / 2.
        """
        if start.size == 0:
            empty = np.empty((1, 0))
            return empty, empty, empty
        lag, f = _split(float(values[0]), dt, start.size + 1)
        if f == 0.0 and lag > 0:
            lag, f = lag - 1, 1.0
        now, before = _Step.of(start, end, lag), _Step.of(start, end, lag + 1)
        entry, leave = before.at(1.0 - f), now.at(1.0 - f)
        by_mean = entry - leave
        by_moment = _mean(now, before, f) - 0.5 * (entry + leave)
        slopes = (by_mean - 6.0 * by_moment, by_mean + 6.0 * by_moment, -before.rise)
        by_start, by_end, by_sample = (slope[np.newaxis] / dt for slope in slopes)
        return by_start, by_end, by_sample
