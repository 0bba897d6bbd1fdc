"""The oscillator whose frequency and damping depend on its level, and modes, fitted to what rings down.

With the size A of what a half cycle begins with, and the centre c = f sign(x) that dry friction moves,

    x'' + 2 d x' + w^2 (x - c) = 0,   w = w0 (1 + k1 A + k2 A^2 + k3 A^3 + k4 A^4),   d = (z + p A + q A^2) w
    x(n+1) - c = -(x(n) - c) exp(-d pi / w_d),   at rest once |x(n)| <= f

which is exact where only f is not zero. Sizes are linear in every output and leave by projection, with an offset and
with what stands beside; the rest is found over the first cycles, then over more and more of the record.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray

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
ALIKE = 0.9
"""Take the lowest of lines that are as strong as this: samples that are missing in turns make images above a line."""
LINES = 10
"""Look for errors that ring with a mode at so many lines to either side: twice what an oscillator's numbers reach."""
MODE = np.array([True] * 3 + [False] * 7)
"""Parameters of one linear mode: angular frequency, damping ratio, phase;"""
STEPS = tuple(np.array([True] * n + [False] * (10 - n)) for n in (4, 7, 10))
"""and of an oscillator: f, then p, k1 and k2 as well, which few cycles do not tell apart, then q, k3 and k4."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Decay:
    """What rings down, and what every description of it may have besides.

    Attributes:
        times: (n,) in samples, rising.
        seen: (n, n_outputs), nan where not measured.
        beside: (n, n_columns) what has any size in every output.
        there: (n, n_outputs) what was measured.
        turns: angular frequency [rad/sample] of the strongest line.
        outputs: that were measured in the same rows: these rows, those outputs, a basis of an offset and of what is
            beside, and what this leaves.
    """

    times: FloatArray
    seen: FloatArray
    beside: FloatArray
    there: BoolArray
    turns: float
    outputs: tuple[tuple[BoolArray, BoolArray, FloatArray, FloatArray], ...]

    @classmethod
    def of(cls, times: FloatArray, seen: FloatArray, beside: FloatArray) -> "Decay":
        """From the first three."""
        there: BoolArray = np.asarray(np.isfinite(seen))
        groups = []
        columns = np.column_stack([np.ones(len(times)), beside])
        for pattern in np.unique(there.T, axis=0):
            own = np.asarray((pattern == there.T).all(axis=1))
            left, sizes, _ = np.linalg.svd(columns[pattern], full_matrices=False)
            basis = left[:, sizes > np.finfo(float).eps * len(columns) * sizes.max(initial=0.0)]
            values = seen[pattern][:, own]
            groups.append((pattern, own, basis, values - basis @ (basis.T @ values)))
        turns = strongest_line(times, seen)
        return cls(times=times, seen=seen, beside=beside, there=there, turns=turns, outputs=tuple(groups))

    def first(self, n: int) -> "Decay":
        """The first rows."""
        return Decay.of(self.times[:n], self.seen[:n], self.beside[:n])

    def left(self, columns: FloatArray) -> FloatArray:
        """(n, n_outputs) what the best offset and sizes of these columns leave of each output, 0 where not measured."""
        rest = np.zeros(self.seen.shape)
        for rows, own, basis, values in self.outputs:
            part = columns[rows]
            part = part - basis @ (basis.T @ part)
            rotated, _ = np.linalg.qr(part)
            rest[np.ix_(rows, own)] = values - rotated @ (rotated.T @ values)
        return rest

    def alike(self, left: FloatArray) -> float:
        """How many values of what is left tell as much of the line as one of white noise, and no less than 1.

        What still drives a mode while it rings down makes errors that ring with it, in all outputs: the largest sum of
        these, at lines half a cycle in the record apart, over the largest that white noise of every output has there.
        """
        apart = np.arange(-LINES, LINES + 1) * np.pi / max(float(self.times[-1] - self.times[0]), 1.0)
        lines = np.exp(-1j * np.outer(self.turns + apart, self.times)) @ left
        lines /= np.sqrt(np.maximum(np.square(left).sum(axis=0), TINY))
        of_white = (np.sqrt(len(apart)) + np.sqrt(left.shape[1] - 1)) ** 2
        return max(1.0, float(np.linalg.norm(lines, 2) ** 2 / of_white))

    def misfit(self, left: FloatArray) -> float:
        """-2 ln L of white noise of each output's own size, but for a constant."""
        count = self.there.sum(axis=0)
        power = np.maximum(np.square(left).sum(axis=0) / np.maximum(1, count), np.finfo(float).tiny)
        return float((count * np.log(power)).sum())


def strongest_line(times: FloatArray, values: FloatArray) -> float:
    """Angular frequency [rad/sample], of any output.

    Args:
        times: (n,) whole numbers of samples, rising.
        values: (n, n_outputs), nan where not measured.
    """
    spacing = int(np.gcd.reduce(np.diff(times).astype(np.intp)))
    at = ((times - times[0]) / spacing).astype(np.intp)
    even = np.zeros((at[-1] + 1, values.shape[1]))
    there = np.isfinite(values)
    even[at] = np.where(there, values, 0.0) - there * (np.nansum(values, axis=0) / np.maximum(1, there.sum(axis=0)))
    size = 4 * len(even)
    window = np.hanning(2 * len(even))[len(even) :, np.newaxis]  # a decay is strongest at its start
    power = (np.abs(np.fft.rfft(window * even, size, axis=0)) ** 2).sum(axis=1)
    power[:4] = 0.0  # the level
    peaks = np.flatnonzero(power >= ALIKE * power.max())
    same = peaks[peaks <= peaks[0] + 8]  # a line of the window is as wide
    return float(2 * np.pi * same[np.argmax(power[same])] / (size * spacing))


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
    phase, friction = float(parameters[2]), float(parameters[3])

    def half_cycle(size: float) -> tuple[float, float, float]:
        angular, damping = at_level(parameters, size)
        return angular, damping * angular, angular * math.sqrt(1.0 - damping**2)

    base = half_cycle(1.0)[0]
    t, x, v = float(times[0]), math.cos(phase), -base * math.sin(phase)
    arcs = []
    if v:  # until the speed is zero
        angular, decay, turning = half_cycle(1.0)
        centre = math.copysign(friction, -v)
        off = x - centre
        arcs.append((t, centre, off, v, angular, decay, turning))
        against = (decay * v + angular**2 * off) / turning
        turned = math.atan2(abs(v), math.copysign(against, against * v))
        pulled = off * math.cos(turned) + (v + decay * off) / turning * math.sin(turned)
        x, t = centre + math.exp(-decay * turned / turning) * pulled, t + turned / turning
    last = float(times[-1])
    while t <= last:
        size = abs(x)
        if size <= friction:  # the spring no longer moves it
            arcs.append((t, x, 0.0, 0.0, base, 0.0, base))
            break
        angular, decay, turning = half_cycle(size)
        centre = math.copysign(friction, x)
        arcs.append((t, centre, x - centre, 0.0, angular, decay, turning))
        half = math.pi / turning
        x, t = centre - (x - centre) * math.exp(-decay * half), t + half
    table = np.array(arcs)
    begun, around, place, speed, angulars, decays, turns = table[
        np.searchsorted(table[:, 0], times, side="right") - 1
    ].T
    since = times - begun
    cosine, sine, shrunk = np.cos(turns * since), np.sin(turns * since) / turns, np.exp(-decays * since)
    away = shrunk * (place * cosine + (speed + decays * place) * sine)
    velocity = shrunk * (speed * cosine - (decays * speed + angulars**2 * place) * sine)
    return around + away, velocity, -(angulars**2) * away - 2.0 * decays * velocity


def level_after(parameters: FloatArray, times: FloatArray) -> float:
    """Level over the last turn of what was at 1 at the start."""
    x, _, _ = motion(parameters, times)
    return float(np.abs(x[times >= times[-1] - 2 * np.pi / parameters[0]]).max())


def _longer(decay: Decay) -> list[int]:
    """Numbers of rows, rising: over all of a record a frequency that is off by half a cycle leads nowhere."""
    numbers = [len(decay.times)]
    while numbers[-1] > FEWEST and decay.times[numbers[-1] - 1] > FIRST * 2 * np.pi / decay.turns:
        numbers.append(max(FEWEST, numbers[-1] // 2))
    return numbers[::-1]


Columns = Callable[[FloatArray, FloatArray], FloatArray]
"""Of parameters and times (n,): (n, n_columns)."""


def _least(
    decay: Decay, columns: Columns, start: FloatArray, bounds: tuple[FloatArray, FloatArray], free: BoolArray
) -> tuple[float, FloatArray]:
    """Squared error and parameters after a fit of those that are free."""
    values = start.copy()

    def left(moved: FloatArray) -> FloatArray:
        values[free] = moved
        return decay.left(columns(values, decay.times)).ravel()

    low, high = bounds[0][free], bounds[1][free]
    fit = scipy.optimize.least_squares(
        left,
        np.clip(start[free], low + 1e-9, high - 1e-9),
        bounds=(low, high),
        x_scale=np.where(np.isfinite(high), 0.02 * high, 0.1),
        max_nfev=50,
    )
    values[free] = fit.x
    return 2.0 * float(fit.cost), values


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Contender:
    """Misfit, parameters, how many of them are free, and how many values of what it leaves are worth one."""

    misfit: float
    parameters: FloatArray
    n_free: int
    alike: float

    def criterion(self, decay: Decay) -> float:
        """Schwarz's, but for the sizes."""
        return self.misfit + self.n_free * float(np.log(decay.there.sum()))


def _contender(decay: Decay, columns: Columns, values: FloatArray, n_free: int) -> Contender:
    left = decay.left(columns(values, decay.times))
    return Contender(misfit=decay.misfit(left), parameters=values, n_free=n_free, alike=decay.alike(left))


def oscillator_of(decay: Decay, linear: FloatArray) -> Contender | None:
    """The oscillator; None where it leaves far more than `linear` (n, n_outputs), which a linear model leaves."""
    fits = [_fitted(decay, reading, STEPS, linear) for reading in range(3)]
    return min((fit for fit in fits if fit is not None), key=lambda fit: fit.criterion(decay), default=None)


def mode_of(decay: Decay) -> Contender:
    """The one mode that the oscillator is where nothing depends on its level."""
    found = _fitted(decay, 0, (MODE,), None)
    assert found is not None  # nothing was asked of it
    return found


def _fitted(decay: Decay, reading: int, steps: tuple[BoolArray, ...], linear: FloatArray | None) -> Contender | None:
    """Of displacement, velocity or acceleration, which are one for a mode; with more numbers where few are too few.

    None as soon as more is left than `CLOSELY` times what a linear model leaves in the same rows.
    """
    bent = [MOST_BENT] * 5
    low = np.array([0.5 * decay.turns, 0.0, -np.inf, 0.0, 0.0, *(-value for value in bent)])
    high = np.array([1.5 * decay.turns, HEAVIEST, np.inf, 0.5, MOST_BENT, *bent])

    def columns(values: FloatArray, times: FloatArray) -> FloatArray:
        return motion(values, times)[reading][:, np.newaxis]

    parts = [decay.first(n) for n in _longer(decay)]
    starts = [
        np.array([decay.turns, damping, phase, friction, *np.zeros(6)])
        for friction in (FRICTIONS if linear is not None else (0.0,))
        for damping in DAMPINGS
        for phase in 2 * np.pi * np.arange(PHASES) / PHASES
    ]
    tried = [float(np.square(parts[0].left(columns(one, parts[0].times))).sum()) for one in starts]
    values = starts[int(np.argmin(tried))]
    found: list[Contender] = []
    for part in parts:
        most = np.inf if linear is None else CLOSELY**2 * float(np.square(linear[: len(part.times)][part.there]).sum())
        for number, free in enumerate(steps):
            cost, values = _least(part, columns, values, (low, high), free)
            if cost <= most and part is not parts[-1]:
                steps = steps[number:]
                break
            if cost <= most:
                found.append(_contender(decay, columns, values, int(free.sum())))
        if cost > most:
            return None
    return min(found, key=lambda fit: fit.criterion(decay))


def modes_of(decay: Decay, start: FloatArray, *, whole: bool) -> Contender:
    """Linear modes (n_modes, 2) from angular frequencies [rad/sample] and damping ratios, free in every output."""

    def columns(values: FloatArray, times: FloatArray) -> FloatArray:
        return waves(values.reshape(-1, 2), times)

    free = np.ones(start.size, dtype=np.bool_)
    bounds = (np.zeros(start.size), np.tile([np.pi, HEAVIEST], len(start)))
    values = start.ravel()
    for part in [decay] if whole else [decay.first(n) for n in _longer(decay)]:
        _, values = _least(part, columns, values, bounds, free)
    return _contender(decay, columns, values, values.size)


def waves(modes: FloatArray, times: FloatArray) -> FloatArray:
    """(n, 2 n_modes) cosines and sines that die away, of angular frequencies and damping ratios (n_modes, 2)."""
    angular, ratio = modes.T
    rings = np.exp((-ratio + 1j * np.sqrt(1.0 - ratio**2)) * angular * times[:, np.newaxis])
    return np.hstack([rings.real, rings.imag])


def two_modes_of(decay: Decay, one: FloatArray) -> Contender:
    """The best two modes, `one` being the parameters of the one alone."""
    turns, span, one = decay.turns, float(decay.times[-1]), one[:2]
    beside = strongest_line(decay.times, np.where(decay.there, decay.left(waves(one[np.newaxis], decay.times)), np.nan))
    light = max(one[1], 1.0 / (turns * span))
    seconds = [(beside, light), (turns * (1.0 + 0.5 * light), 3.0 * light), (turns + np.pi / span, light)]
    fits = [modes_of(decay, np.array([one, second]), whole=False) for second in seconds]
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
    fits += [modes_of(decay, pairs[i], whole=True) for i in np.argsort(tried)[:PAIRS]]
    return min(fits, key=lambda fit: fit.misfit)


def exponentials(poles: ComplexArray, times: FloatArray) -> FloatArray:
    """(n, n_columns) what poles [1/sample] make, each with any size: one column of a real one, two of a pair."""
    grown = np.exp((np.minimum(poles.real, 0.0) + 1j * poles.imag) * times[:, np.newaxis])
    return np.hstack([grown.real, grown.imag[:, poles.imag != 0]])
