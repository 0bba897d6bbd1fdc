"""The drive reaches the plant later, or sooner, than the record says.

The drive is linear within each step, with jumps allowed between steps. For tau = (m + f) dt the delayed drive within
step k is the last share f of step k - m - 1 followed by the first share 1 - f of step k - m. It is replaced by the one
straight line with the same mean and the same first moment over the step, so that the state at the end of the step is
right but for (dt x pole)^2 of the drive's change within it. For a zero-order hold with the values a, then b:

    mean = f a + (1 - f) b        end - start = 6 f (1 - f) (b - a)

The line is continuous in tau, also across whole steps, where its slope by tau jumps.
"""

import math
from dataclasses import dataclass

import numpy as np

from modal.effects.effect import InputEffect, ParameterKind, Situation, Values
from okid.arrays import FloatArray

__all__ = ["DelayedInput"]

COUNTS = (-0.5, 0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 7.5, 10.5, 15.5, 22.5, 31.5)
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
        delays = [count * situation.dt for count in COUNTS]
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
