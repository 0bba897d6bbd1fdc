"""The oscillator whose frequency and damping depend on its level, and modes, fitted to what rings down.

With the size A of what a half cycle begins with, and the centre c = f sign(x) that dry friction moves,

    x'' + 2 d x' + w^2 (x - c) = 0,   w = w0 (1 + k1 A + k2 A^2 + k3 A^3 + k4 A^4),   d = (z + p A + q A^2) w
    x(n+1) - c = -(x(n) - c) exp(-d pi / w_d),   at rest once |x(n)| <= f

which is exact where only f is not zero. Sizes are linear in every output and leave by projection, with an offset and
with what stands beside; the rest is found over the first cycles, then over more and more of the record, in white noise,
and from there in the noise of `modal.verdict.decay`, whose poles move with it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from modal.verdict.decay import SHARES, STEEPEST, Decay, strongest_line
from okid.arrays import BoolArray, ComplexArray, FloatArray

FEWEST = 40
"""Ask nothing of fewer rows."""
CLOSELY = 2.0
"""Ask that the oscillator leaves at most so many times what the linear model leaves, root mean square: where several
modes ring close together, neither it nor two modes explain much."""
FIRST = 3.0
"""Begin the fit with no more cycles than twice this,"""
FRICTIONS = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""with these shares of friction, the spring's force at the start being 1,"""
DAMPINGS = (0.0, 0.003, 0.01, 0.03)
"""these damping ratios besides,"""
PHASES = 12
"""and so many phases of a turn."""
HEAVIEST = 0.3
"""Take more damping than this for no ringing."""
MOST_DAMPED, LEAST_TURNING = 0.9, 0.2
"""Keep an oscillator that is tried below what no longer turns, and above this share of its frequency at rest."""
MOST_BENT = 0.6
"""Let frequency and damping change by no more than this with each power of the level."""
APART = ((0.0, 1.0), (1.0, 0.0), (0.5, 0.5), (1.0, 1.0), (2.0, 2.0), (0.0, 4.0), (4.0, 0.0))
"""Begin two modes so many widths below and above the one,"""
HEAVIER = (0.25, 1.0, 4.0)
"""damped so many times as much as it,"""
PAIRS = 4
"""and go on from so many of the nearest to the record."""
AGAIN = 2
"""Fit a description so often in the noise that it leaves,"""
ROUNDING = np.sqrt(np.finfo(float).eps)
"""Nudge parameters by this of themselves, or of one, for differences in white noise,"""
NUDGE = 1e-7
"""and in other noise by so many of the steps in which parameters are counted."""
MODE = np.array([True] * 3 + [False] * 7)
"""Parameters of one linear mode: angular frequency, damping ratio, phase;"""
STEPS = tuple(np.array([True] * n + [False] * (10 - n)) for n in (4, 7, 10))
"""and of an oscillator: f, then p, k1 and k2 as well, which few cycles do not tell apart, then q, k3 and k4,"""
LAWS = tuple(MODE | (np.arange(10) == law) for law in (3, 4, 6))
"""or f, p or k2 alone."""


def at_level(parameters: FloatArray, size: float) -> tuple[float, float]:
    """Angular frequency and damping ratio besides friction, at a level of that at the start."""
    base, ratio, _, _, drag, bend, more, drags, third, fourth = parameters.tolist()
    bent = size * (bend + size * (more + size * (third + size * fourth)))
    return base * max(1.0 + bent, LEAST_TURNING), min(max(ratio + size * (drag + size * drags), 0.0), MOST_DAMPED)


def motion(parameters: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, velocity and acceleration (n,) of the oscillator, from a start of unit size.

    Args:
        parameters: angular frequency, damping ratio, phase of the start, f, p, k1, k2, and of laws that bend more also
            q, k3, k4.
        times: (n,) rising, in the unit of the frequency's inverse.
    """
    place, velocity, acceleration = motions(parameters[np.newaxis], times)
    return place[0], velocity[0], acceleration[0]


def motions(parameters: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, velocity and acceleration (n_trials, n) of as many oscillators (n_trials, n_parameters)."""
    arcs, rows = [], []
    for one in parameters:
        own = _arcs(one, float(times[0]), float(times[-1]))
        ends = np.searchsorted(times, [arc[0] for arc in own[1:]] + [np.inf])
        arcs += own
        rows += [ends[:1], ends[1:] - ends[:-1]]
    table = np.repeat(np.array(arcs).T, np.concatenate(rows), axis=1).reshape(7, len(parameters), len(times))
    begun, around, place, speed, angulars, decays, turns = table
    since = times - begun
    angle = turns * since
    cosine, sine, shrunk = np.cos(angle), np.sin(angle) / turns, np.exp(-decays * since)
    away = shrunk * (place * cosine + (speed + decays * place) * sine)
    velocity = shrunk * (speed * cosine - (decays * speed + angulars**2 * place) * sine)
    return around + away, velocity, -(angulars**2) * away - 2.0 * decays * velocity


def _arcs(parameters: FloatArray, first: float, last: float) -> list[tuple[float, ...]]:
    """From turn to turn: when it begins, the centre, the distance from it, the speed, w, decay [1/sample] and w_d."""
    slowest, ratio, phase, friction, drag, bend, more, drags, third, fourth = parameters.tolist()

    def half_cycle(size: float) -> tuple[float, float, float]:
        bent = 1.0 + size * (bend + size * (more + size * (third + size * fourth)))
        angular = slowest * (bent if bent > LEAST_TURNING else LEAST_TURNING)  # noqa: FURB136 - half the time of max
        damping = ratio + size * (drag + size * drags)
        damping = (damping if damping < MOST_DAMPED else MOST_DAMPED) if damping > 0.0 else 0.0  # noqa: FURB136
        return angular, damping * angular, angular * math.sqrt(1.0 - damping * damping)

    base = half_cycle(1.0)[0]
    t, x, v = first, math.cos(phase), -base * math.sin(phase)
    arcs: list[tuple[float, ...]] = []
    if v:  # until the speed is zero
        angular, decay, turning = half_cycle(1.0)
        centre = math.copysign(friction, -v)
        off = x - centre
        arcs.append((t, centre, off, v, angular, decay, turning))
        against = (decay * v + angular**2 * off) / turning
        turned = math.atan2(abs(v), math.copysign(against, against * v))
        pulled = off * math.cos(turned) + (v + decay * off) / turning * math.sin(turned)
        x, t = centre + math.exp(-decay * turned / turning) * pulled, t + turned / turning
    while t <= last:
        size = abs(x)
        if size <= friction:  # the spring no longer moves it
            arcs.append((t, x, 0.0, 0.0, base, 0.0, base))
            break
        angular, decay, turning = half_cycle(size)
        centre = math.copysign(friction, x)
        off = x - centre
        arcs.append((t, centre, off, 0.0, angular, decay, turning))
        half = math.pi / turning
        x, t = centre - off * math.exp(-decay * half), t + half
    return arcs


def level_after(parameters: FloatArray, times: FloatArray) -> float:
    """Level over the last turn of what was at 1 at the start."""
    x, _, _ = motion(parameters, times)
    return float(np.abs(x[times >= times[-1] - 2 * np.pi / parameters[0]]).max())


def _longer(decay: Decay) -> list[Decay]:
    """More and more of its rows: over all of a record a frequency that is off by half a cycle leads nowhere."""
    numbers = [len(decay.times)]
    while numbers[-1] > FEWEST and decay.times[numbers[-1] - 1] > FIRST * 2 * np.pi / decay.turns:
        numbers.append(max(FEWEST, numbers[-1] // 2))
    return [decay.first(n) for n in numbers[::-1]]


Columns = Callable[[FloatArray, FloatArray], FloatArray]
"""Of parameters (n_trials, n_parameters) and times (n,): (n_trials, n, n_columns)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Contender:
    """How one description fits.

    Attributes:
        misfit: -2 ln L in noise of its own, of the strong directions,
        white: and in white noise, of all.
        parameters: of the description.
        noise: (n_outputs, 2), as for `Decay.innovations`.
        n_free: how many parameters are free.
    """

    misfit: float
    white: float
    parameters: FloatArray
    noise: FloatArray
    n_free: int

    @property
    def n_noise(self) -> int:
        """How many numbers of its noise are."""
        return int(np.isfinite(self.noise).sum())

    def criterion(self, decay: Decay) -> float:
        """Schwarz's, but for the sizes."""
        return self.misfit + (self.n_free + self.n_noise) * float(np.log(decay.told.sum()))


def _tried(values: FloatArray, free: BoolArray, moved: FloatArray, nudges: FloatArray) -> FloatArray:
    """(1 + n_free, n_parameters) parameters where those that are free moved, then with each nudged besides."""
    trials = np.tile(values, (1 + len(moved), 1))
    trials[:, free] = moved + np.vstack([np.zeros(len(moved)), np.diag(nudges)])
    return trials


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Law:
    """A description of a decay: its columns, the bounds of its parameters, and the modes that are shaken."""

    columns: Columns
    bounds: tuple[FloatArray, FloatArray]
    modes: Callable[[FloatArray], FloatArray]

    def left(self, decay: Decay, values: FloatArray) -> FloatArray:
        """As `Decay.left`."""
        left: FloatArray = self.left_of_each(decay, values[np.newaxis])[0]
        return left

    def left_of_each(self, decay: Decay, trials: FloatArray) -> FloatArray:
        """As `Decay.left_of_each`, of parameters (n_trials, n_parameters)."""
        return decay.left_of_each(self.columns(trials, decay.times))

    def fitted(self, decay: Decay, start: FloatArray, free: BoolArray) -> tuple[float, FloatArray]:
        """Squared error and parameters after a fit of those that are free, in white noise."""
        values = start.copy()

        def left(moved: FloatArray) -> FloatArray:
            values[free] = moved
            return self.left(decay, values).ravel()

        def slopes(moved: FloatArray) -> FloatArray:
            nudges = ROUNDING * np.where(moved < 0.0, -1.0, 1.0) * np.maximum(1.0, np.abs(moved))
            nudges = np.where((moved + nudges < low) | (moved + nudges > high), -nudges, nudges)
            nudges = (moved + nudges) - moved
            base, *each = self.left_of_each(decay, _tried(values, free, moved, nudges))
            return np.array([(one - base).ravel() / nudge for one, nudge in zip(each, nudges, strict=True)]).T

        low, high = self._within(free)
        fit = scipy.optimize.least_squares(
            left,
            np.clip(start[free], low + 1e-9, high - 1e-9),
            jac=slopes,
            bounds=(low, high),
            x_scale=self._steps(free),
            max_nfev=50,
        )
        values[free] = fit.x
        return 2.0 * float(fit.cost), values

    def _within(self, free: BoolArray) -> tuple[FloatArray, FloatArray]:
        return self.bounds[0][free], self.bounds[1][free]

    def _steps(self, free: BoolArray) -> FloatArray:
        high = self.bounds[1][free]
        return np.where(np.isfinite(high), 0.02 * high, 0.1)

    def noise(self, decay: Decay, values: FloatArray) -> FloatArray:
        """As `Decay.noise_of`."""
        return decay.noise_of(self.modes(values), self.left(decay, values))

    def innovations(self, decay: Decay, values: FloatArray, noise: FloatArray) -> FloatArray:
        """As `Decay.innovations`."""
        return decay.innovations(self.columns(values[np.newaxis], decay.times)[0], self.modes(values), noise)

    def criterion(self, decay: Decay, values: FloatArray, free: BoolArray) -> float:
        """Schwarz's in white noise, but for the sizes."""
        return decay.misfit(self.left(decay, values)) + float(free.sum() * np.log(decay.told.sum()))

    def told(self, decay: Decay, start: FloatArray, free: BoolArray, noise: FloatArray | None = None) -> Contender:
        """The likeliest in noise of its own, from parameters and, where known, noise (n_outputs, 2) to start from."""
        left = self.left(decay, start)
        noise = self.noise(decay, start) if noise is None else noise.copy()
        shaken, values, white = np.isfinite(noise[:, 0]), start.copy(), decay.misfit(left, whole=True)
        n_free, n_shaken = int(free.sum()), int(shaken.sum())
        n = n_free + 2 * n_shaken
        low, high = self._within(free)
        low = np.concatenate([low, np.tile([SHARES[0], -STEEPEST], n_shaken)])
        high = np.concatenate([high, np.tile([SHARES[1], STEEPEST], n_shaken)])
        steps = np.concatenate([self._steps(free), np.tile([1.0, 0.3], n_shaken)])
        size: FloatArray = np.ones(len(noise))

        def innovations(moved: FloatArray, columns: FloatArray | None = None) -> FloatArray:
            values[free], noise[shaken] = moved[:n_free], moved[n_free:].reshape(-1, 2)
            if columns is None:
                return self.innovations(decay, values, noise) / size
            return decay.innovations(columns, self.modes(values), noise) / size

        def slopes(moved: FloatArray) -> FloatArray:
            nudges = np.where(moved + NUDGE * steps > high, -NUDGE, NUDGE) * steps
            columns, *each = self.columns(_tried(values, free, moved[:n_free], nudges[:n_free]), decay.times)
            base, found = innovations(moved, columns), np.zeros((*decay.seen.shape, n))
            for i, one in enumerate(each):
                found[..., i] = (innovations(moved + nudges * (np.arange(n) == i), one) - base) / nudges[i]
            for first in (n_free, n_free + 1) if n_shaken else ():  # noise of one output is nothing to the others
                own = np.arange(first, n, 2)
                moves = innovations(moved + nudges * np.isin(np.arange(n), own), columns) - base
                found[:, np.flatnonzero(shaken), own] = moves[:, shaken] / nudges[own]
            return found.reshape(-1, n)

        moved = np.clip(np.concatenate([start[free], noise[shaken].ravel()]), low + 1e-9, high - 1e-9)
        for _ in range(AGAIN if n_shaken or decay.colour[:, 1:].any() else 0):
            size = size * decay.size(innovations(moved))
            fit = scipy.optimize.least_squares(
                lambda moved: innovations(moved).ravel(),
                moved,
                jac=slopes,
                bounds=(low, high),
                x_scale=steps,
                max_nfev=30,
            )
            moved = fit.x
            left = innovations(moved) * size
        return Contender(
            misfit=decay.misfit(left),
            white=white,
            parameters=values,
            noise=noise,
            n_free=n_free,
        )


def oscillator_of(decay: Decay, linear: FloatArray, one: Contender) -> Contender | None:
    """The oscillator; None where it leaves far more than `linear` (n, n_outputs), which a linear model leaves."""
    parts = _longer(decay)
    fits = [fit for reading in range(3) if (fit := _fitted(parts, reading, STEPS, linear))]
    if not fits:
        return None
    best = [(law, *min(tried, key=lambda one: law.criterion(decay, *one))) for law, tried in fits]
    law, values, free, noise = min(
        ((law, values, free, law.noise(decay, values)) for law, values, free in best),
        key=lambda one: (
            decay.misfit(one[0].innovations(decay, one[1], one[3])) + one[2].sum() * np.log(decay.told.sum())
        ),
    )
    found = [law.told(decay, values, free, noise)]
    found += [_law(decay, 0).told(decay, one.parameters, alone, one.noise) for alone in LAWS]
    return min(found, key=lambda fit: fit.criterion(decay))


def mode_of(decay: Decay) -> tuple[Decay, Contender]:
    """The one mode that the oscillator is where nothing depends on its level; and the colour of the noise besides."""
    fitted = _fitted(_longer(decay), 0, (MODE,), None)
    assert fitted is not None  # nothing was asked of it
    law, ((values, free),) = fitted
    last, ringing = decay.last(len(decay.times) // 2), _linear(1)
    fit = ringing.told(last, law.modes(values).ravel(), np.ones(2, dtype=np.bool_))
    decay = decay.coloured(last, ringing.innovations(last, fit.parameters, fit.noise))
    return decay, law.told(decay, values, free)


def _fitted(
    parts: list[Decay], reading: int, steps: tuple[BoolArray, ...], linear: FloatArray | None
) -> tuple[_Law, list[tuple[FloatArray, BoolArray]]] | None:
    """Of displacement, velocity or acceleration, which are one for a mode; with more numbers where few are too few.

    None as soon as more is left than `CLOSELY` times what a linear model leaves in the same rows.

    Args:
        parts: more and more of the rows, at last all.
        reading: of the three, counted from 0.
        steps: which parameters are free, one after the other.
        linear: (n, n_outputs) what a linear model leaves, or None.

    Returns:
        The law, its parameters and which are free.
    """
    decay = parts[-1]
    law = _law(decay, reading)
    starts = np.array(
        [
            [decay.turns, damping, phase, friction, *np.zeros(6)]
            for friction in (FRICTIONS if linear is not None else (0.0,))
            for damping in DAMPINGS
            for phase in 2 * np.pi * np.arange(PHASES) / PHASES
        ]
    )
    lefts = [law.left_of_each(parts[0], some) for some in starts.reshape(-1, PHASES, starts.shape[1])]
    values = starts[int(np.argmin([np.square(left).sum() for some in lefts for left in some]))]
    found = []
    for part in parts:
        most = np.inf if linear is None else CLOSELY**2 * float(np.square(linear[: len(part.times)][part.there]).sum())
        for number, free in enumerate(steps):
            cost, values = law.fitted(part, values, free)
            if cost <= most and part is not parts[-1]:
                steps = steps[number:]
                break
            if cost <= most:
                found.append((values, free))
        if cost > most:
            return None
    return law, found


def _law(decay: Decay, reading: int) -> _Law:
    """The oscillator, of which displacement, velocity or acceleration is seen."""
    bent = [MOST_BENT] * 5
    return _Law(
        columns=lambda trials, times: motions(trials, times)[reading][..., np.newaxis],
        bounds=(
            np.array([0.5 * decay.turns, 0.0, -np.inf, 0.0, 0.0, *(-value for value in bent)]),
            np.array([1.5 * decay.turns, HEAVIEST, np.inf, 0.5, MOST_BENT, *bent]),
        ),
        modes=lambda values: np.array([at_level(values, 0.0)]),
    )


def _linear(n_modes: int) -> _Law:
    """Modes, each an angular frequency [rad/sample] and a damping ratio, free in every output."""
    return _Law(
        columns=lambda trials, times: waves(trials.reshape(len(trials), -1, 2), times),
        bounds=(np.zeros(2 * n_modes), np.tile([np.pi, HEAVIEST], n_modes)),
        modes=lambda values: values.reshape(-1, 2),
    )


def modes_of(decay: Decay, start: FloatArray) -> Contender:
    """Linear modes from angular frequencies [rad/sample] and damping ratios (n_modes, 2)."""
    free = np.ones(start.size, dtype=np.bool_)
    law = _linear(len(start))
    return law.told(decay, law.fitted(decay, start.ravel(), free)[1], free)


def two_modes_of(decay: Decay, one: FloatArray) -> Contender:
    """The best two modes, `one` being the parameters of the one alone."""
    turns, span, one = decay.turns, float(decay.times[-1]), one[:2]
    beside = strongest_line(decay.times, np.where(decay.there, decay.left(waves(one[np.newaxis], decay.times)), np.nan))
    light = max(one[1], 1.0 / (turns * span))
    seconds = [(beside, light), (turns * (1.0 + 0.5 * light), 3.0 * light), (turns + np.pi / span, light)]
    law, free, fits, parts = _linear(2), np.ones(4, dtype=np.bool_), [], _longer(decay)
    for second in seconds:
        values = np.array([one, second]).ravel()
        for part in parts:
            _, values = law.fitted(part, values, free)
        fits.append(values)
    width = max(light * turns, np.pi / span)
    pairs = [
        np.array([[one[0] - below * width, lighter * light], [one[0] + above * width, heavier * light]])
        for below, above in APART
        for lighter in HEAVIER
        for heavier in HEAVIER
    ] + [np.array([one, [beside, heavier * light]]) for heavier in HEAVIER]
    pairs = [np.clip(pair, 1e-9, [np.pi - 1e-9, HEAVIEST - 1e-9]) for pair in pairs]
    tried = [float(np.square(decay.left(waves(pair, decay.times))).sum()) for pair in pairs]
    # what is close together shows in the whole record only: its first cycles are those of one mode
    fits += [law.fitted(decay, pairs[i].ravel(), free)[1] for i in np.argsort(tried)[:PAIRS]]
    return law.told(decay, min(fits, key=lambda values: decay.misfit(law.left(decay, values))), free)


def waves(modes: FloatArray, times: FloatArray) -> FloatArray:
    """(..., n, 2 n_modes) cosines and sines that die away, of angular frequencies and damping (..., n_modes, 2)."""
    angular, ratio = modes[..., 0], modes[..., 1]
    poles = (-ratio + 1j * np.sqrt(1.0 - ratio**2)) * angular
    rings = np.exp(poles[..., np.newaxis, :] * times[:, np.newaxis])
    return np.concatenate([rings.real, rings.imag], axis=-1)


def exponentials(poles: ComplexArray, times: FloatArray) -> FloatArray:
    """(n, n_columns) what poles [1/sample] make, each with any size: one column of a real one, two of a pair."""
    grown = np.exp((np.minimum(poles.real, 0.0) + 1j * poles.imag) * times[:, np.newaxis])
    return np.hstack([grown.real, grown.imag[:, poles.imag != 0]])
