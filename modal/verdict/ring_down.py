"""Does what rings down ring as a mode does? One frequency, one damping, whatever the level.

Dry friction lets a motion die away along a line and then stop, drag takes most at the start, and a spring that is not
linear, or a bearing that creeps before it slides, has another frequency at each level. From one reversal to the next
such an oscillator is nearly linear: with the size A of what it begins the half cycle with,

    x'' + 2 d x' + w^2 (x - c) = 0,   w = w0 (1 + k1 A + k2 A^2),   d = (z + p A) w,   c = f sign(x)
    x(n+1) - c = -(x(n) - c) exp(-d pi / w_d),   at rest once |x(n)| <= f

with f = F/k of dry friction F on a spring k, exact where k1, k2 and p are zero. A bent spring makes harmonics, in first
approximation as x^2 and x^3 do, which each output shows in its own size.

No pole makes a line, but enough poles side by side follow any curve: a decay under friction is fitted down to its noise
by a linear model of some twenty states, which are no modes and yet are found again in every part of it. So this
oscillator competes by Schwarz's criterion with linear models of as few numbers and as many: with the one mode that it
is without f, k1, k2 and p, with that mode and harmonics, as a string or a crooked sensor makes them, and with two
modes, free in every output. Two modes make any beat, and no line.

Where no such oscillator is near either, as for a pendulum that swings far, the poles side by side are still not found
again one by one. Whoever is found among them is no mode for that: modes that are certain are most of what rings down.

References:
    Den Hartog, Mechanical Vibrations, 4th ed., 1956, section 8.6; Feldman, Hilbert transform in vibration analysis,
    Mech. Syst. Signal Process. 25, 2011, https://doi.org/10.1016/j.ymssp.2010.07.018; Schwarz, Annals of Statistics 6,
    1978, 461-464, https://doi.org/10.1214/aos/1176344136.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from modal.modes.mode import Choice, ModalModel
from modal.verdict.probability import FEWEST_TURNS
from modal.wording.text import hertz, percent
from okid.arrays import BoolArray, FloatArray
from okid.record import Record

RINGS = "ring-down"
"""Name of the choice."""
FEWEST = 40
"""Ask nothing of fewer rows."""
MOST_ROWS = 4000
"""Take every so manieth row of longer records: a few dozen cycles and where they stop show as well in fewer,"""
A_CYCLE = 8
"""but no fewer rows a cycle,"""
MOST_CYCLES = 100
"""and no more cycles, the first ones."""
EVIDENCE = 10.0
"""Believe in the oscillator where the criterion falls by so much: odds of 150 to 1."""
LEAST_LEFT = 1e-9
"""Weigh outputs by what the linear model leaves of each, but by no less than this share of it."""
CLOSELY = 2.0
"""Ask that the oscillator leaves at most so many times what the linear model leaves, root mean square: where several
modes ring, neither it nor two modes explain much."""
FIRST = 3.0
"""Begin the fit with no more cycles than twice this,"""
FRICTIONS = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08)
"""with these shares of friction, the spring's force at the start being 1,"""
DAMPINGS = (0.0, 0.003, 0.01, 0.03)
"""these damping ratios besides,"""
PHASES = 12
"""and so many phases of a turn."""
HEAVIEST = 0.3
"""Take more damping than this for no ringing."""
MOST_DAMPED = 0.9
"""Keep an oscillator that is tried below what no longer turns."""
MOST_BENT = 0.3
"""Let frequency and damping change by no more than this with the level."""
LATER = 0.1
"""Say what damping and frequency are at this share of the level at the start, or, where friction stops it before, at"""
MOVING = 2.0
"""so many times the level at which it stops."""
MANIFEST = 1.1
"""Tell how many times as closely it explains a decay above this."""
CARRIED = 0.5
"""Ask that modes of the system carry this share of what rings, before one of them is certain."""
APART = ((0.0, 1.0), (1.0, 0.0), (0.5, 0.5), (1.0, 1.0), (2.0, 2.0), (0.0, 4.0), (4.0, 0.0))
"""Begin two modes so many widths below and above the one,"""
HEAVIER = (0.25, 1.0, 4.0)
"""damped so many times as much as it,"""
PAIRS = 4
"""and go on from so many of the nearest to the record."""
MODE = np.array([True, True, True, False, False, False, False])
"""Parameters of one linear mode: angular frequency, damping ratio, phase; and not friction, p, k1, k2."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RingDown:
    """An oscillator that explains decays better than two linear modes.

    Attributes:
        level: later level of which the others tell, over that at the start.
        frequency: at the start and at that level [Hz].
        damping_ratio: of one mode that would lose as much in a cycle, at the same levels.
        friction: force of dry friction over that of the spring at the start.
        drag: p, damping ratio for the level at the start.
        gain: rms that two modes leave over that which the oscillator leaves.
    """

    level: float
    frequency: tuple[float, float]
    damping_ratio: tuple[float, float]
    friction: float
    drag: float
    gain: float

    @property
    def sentence(self) -> str:
        """What was found, and what to do."""
        likely = {
            f"as under dry friction of {percent(self.friction)} of the spring's force at the start": _lost(
                self.friction, self.level
            ),
            "as under drag": self.drag,
            "as with a spring that is not linear": abs(self.frequency[0] / self.frequency[1] - 1.0),
        }
        like = max(likely, key=lambda words: likely[words])
        damping, later = (percent(ratio) for ratio in self.damping_ratio)
        first, last = (hertz(frequency) for frequency in self.frequency)
        return (
            f"What rings at {first} Hz does not die away as a mode does, but {like}: damping {damping} at the start, "
            f"{later} at {percent(self.level)} of that level, where it rings at {last} Hz. Such an oscillator explains "
            f"the decay {self._closer} two modes do, so no mode is certain; `modal-report gap` tells friction, drag "
            "and springs apart."
        )

    @property
    def choice(self) -> Choice:
        """That modes were asked whether they describe it, and do not."""
        reason = f"an oscillator whose damping and frequency depend on its level explains it {self._closer} two modes"
        return no_modes(reason)

    @property
    def _closer(self) -> str:
        return f"{self.gain:.2g} times as closely as" if self.gain > MANIFEST else "more closely than"

    @property
    def doubt(self) -> str:
        """The reason of each mode."""
        return f"what rings at {hertz(self.frequency[0])} Hz has another damping or frequency at each level"


def _lost(friction: float, level: float) -> float:
    """Damping ratio of what loses as much in a cycle, 4 F A = 2 pi zeta k A^2, as dry friction of F/k at level A."""
    return 2.0 * friction / (np.pi * level)


def ring_down_of(records: Sequence[Record], left: Sequence[FloatArray]) -> RingDown | None:
    """The oscillator whose damping or frequency depends on its level, if it explains decays better than modes.

    Args:
        records: that ring down once their inputs are zero.
        left: (n_samples, n_outputs) a record, what the linear model with all its states leaves.

    Example:
        >>> x, _, _ = motion(np.array([2 * np.pi, 0.002, 0.3, 0.03, 0.0, 0.0, 0.0]), 0.02 * np.arange(400))
        >>> noise = 1e-3 * np.random.default_rng(1).standard_normal((400, 1))
        >>> found = ring_down_of([Record([], x[:, np.newaxis] + noise, 0.02)], [noise])
        >>> round(found.frequency[0], 2), round(found.friction, 3)
        (1.0, 0.03)
    """
    misfits, price, found = np.zeros(4), np.zeros(4), []
    n_outputs = records[0].n_outputs
    for record, errors in zip(records, left, strict=True):
        rows = _free_rows(record)
        rows = rows[np.isfinite(errors[rows]).all(axis=1)]
        if len(rows) < FEWEST or not np.ptp(record.outputs[rows], axis=0).all():
            continue  # too short, or silent
        seen = record.outputs[rows] - record.outputs[rows].mean(axis=0)
        size = np.maximum(np.sqrt(np.mean(errors[rows] ** 2, axis=0)), LEAST_LEFT * seen.std(axis=0))
        seen, linear = seen / size, errors[rows] / size
        times = (rows - rows[0]).astype(np.float64)
        own = _fitted(times, seen, np.ones_like(MODE), harmonics=True, linear=linear)
        if own is None:
            return None
        one, crooked = (_fitted(times, seen, MODE, harmonics=harmonics) for harmonics in (False, True))
        assert one is not None  # nothing was asked of it
        assert crooked is not None
        misfits += (own[0], one[0], crooked[0], _two_modes(times, seen, one[1]))
        numbers = [len(MODE), MODE.sum(), MODE.sum(), 4]
        price += np.log(len(rows)) * (np.array(numbers) + n_outputs * np.array([4, 2, 4, 5]))
        found.append((float(np.square(seen).mean()), len(rows), own[1], record.dt))
    total = misfits + price
    if not found or not total[0] + EVIDENCE < total[1:].min() or not misfits[0] < misfits[3]:
        return None
    _, _, (angular, damping, _, friction, drag, bend, more), dt = max(found, key=lambda one: one[0])
    n_values = n_outputs * sum(n_rows for _, n_rows, _, _ in found)
    level = min(1.0, max(LATER, MOVING * friction))
    frequencies = [angular * (1.0 + bend * at + more * at**2) / (2 * np.pi * dt) for at in (1.0, level)]
    ratios = [damping + drag * at + _lost(friction, at) for at in (1.0, level)]
    return RingDown(
        level=float(level),
        frequency=(float(frequencies[0]), float(frequencies[1])),
        damping_ratio=(float(ratios[0]), float(ratios[1])),
        friction=float(friction),
        drag=float(drag),
        gain=float(np.exp((misfits[3] - misfits[0]) / (2 * n_values))),
    )


def no_modes(reason: str) -> Choice:
    """The choice that says of a decay that modes do not describe it."""
    return Choice(what=RINGS, value="not as modes do", reason=reason)


def doubt_of_the_rest(modes: ModalModel, records: Sequence[Record], *, output_scale: FloatArray) -> str:
    """Why no mode of decays is certain where other poles carry most of them; empty where there is no reason.

    Args:
        modes: of decays, each release a pulse at an input.
        records: the decays.
        output_scale: (n_outputs,) what the outputs are divided by.
    """
    share = carried(modes, n_steps=max(record.n_samples for record in records), output_scale=output_scale)
    if share >= CARRIED or not any(mode.verdict == "system" for mode in modes.modes):
        return ""
    return f"poles that were not found again carry {percent(min(1.0 - share, 1.0))} of what rings down"


def carried(modes: ModalModel, *, n_steps: int, output_scale: FloatArray) -> float:
    """Share of the energy of all that oscillates that the modes of the system carry together, pulse by pulse.

    What is doubted for something else, as hum is, and what hardly turns, as drift, counts on neither side. Poles that
    follow a curve which is no sum of modes cancel one another: alone each tells nothing, so what is told is what all
    the others leave of the sum, below zero where they are more than it. 1 where nothing oscillates.
    """
    turning = [
        mode
        for mode in modes.modes
        if mode.kind == "oscillatory" and not mode.doubts and mode.frequency * n_steps * modes.dt >= FEWEST_TURNS
    ]
    if not turning:
        return 1.0
    others = np.array([mode.verdict != "system" for mode in turning])
    poles = np.array([complex(min(mode.pole.real, 0.0), mode.pole.imag) for mode in turning])
    sizes = np.array([np.outer(mode.shape / output_scale, mode.participation).ravel() for mode in turning])
    steps = np.arange(0, n_steps, max(1, n_steps // MOST_ROWS))
    rings = np.exp(poles * modes.dt * steps[:, np.newaxis])
    whole, rest = (rings @ sizes).real, (rings[:, others] @ sizes[others]).real
    return 1.0 - float(np.square(rest).sum() / max(np.square(whole).sum(), np.finfo(float).tiny))


def _free_rows(record: Record) -> NDArray[np.intp]:
    """Rows in which nothing drives and something moves."""
    free: BoolArray = np.asarray(np.isfinite(record.outputs).all(axis=1))
    free[: np.flatnonzero((record.inputs != 0.0).any(axis=1)).max(initial=-1) + 1] = False
    moves = (np.diff(record.outputs, axis=0) != 0.0).any(axis=1)  # a sensor that stands still tells nothing more
    free[np.flatnonzero(moves).max(initial=0) + 2 :] = False
    rows = np.flatnonzero(free)
    if len(rows) < FEWEST or not np.ptp(record.outputs[rows], axis=0).any():
        return rows[:0]
    turns = _turns(rows.astype(np.float64), record.outputs[rows] - record.outputs[rows].mean(axis=0))
    rows = rows[: max(FEWEST, int(MOST_CYCLES * 2 * np.pi / turns))]
    return rows[:: max(1, min(len(rows) // MOST_ROWS, int(2 * np.pi / (A_CYCLE * turns))))]


def motion(parameters: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, velocity and acceleration (n,) of the oscillator, from a start of unit size.

    Args:
        parameters: angular frequency, damping ratio, phase of the start, f, p, k1, k2.
        times: (n,) rising, in the unit of the frequency's inverse.
    """
    base, ratio, phase, friction, drag, bend, more = parameters.tolist()

    def half_cycle(size: float) -> tuple[float, float, float]:
        angular = base * (1.0 + bend * size + more * size**2)
        damping = min(ratio + drag * size, MOST_DAMPED)
        return angular, damping * angular, angular * math.sqrt(1.0 - damping**2)

    t, x, v = float(times[0]), math.cos(phase), -base * (1.0 + bend + more) * math.sin(phase)
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


def _turns(times: FloatArray, values: FloatArray) -> float:
    """Angular frequency [rad/sample] of the strongest line, rows that are missing on the way from one to the next.

    Args:
        times: (n,) in samples, rising.
        values: (n, n_outputs).
    """
    spacing = float(np.median(np.diff(times)))
    even = np.arange(times[0], times[-1] + 0.5 * spacing, spacing)
    values = values if len(even) == len(times) else np.column_stack([np.interp(even, times, one) for one in values.T])
    size = 4 * len(values)
    window = np.hanning(2 * len(values))[len(values) :, np.newaxis]  # a decay is strongest at its start
    power = (np.abs(np.fft.rfft(window * values, size, axis=0)) ** 2).sum(axis=1)
    power[:4] = 0.0  # the level
    return float(2 * np.pi * np.argmax(power) / (size * spacing))


def _left(basis: FloatArray, seen: FloatArray) -> FloatArray:
    """(n, n_outputs) what the best offset and sizes of these columns leave of each output."""
    rotated, _ = np.linalg.qr(np.column_stack([np.ones(len(basis)), basis]))
    return np.asarray(seen - rotated @ (rotated.T @ seen))


def _longer(times: FloatArray, turns: float) -> list[int]:
    """Numbers of rows, rising: over all of a record a frequency that is off by half a cycle leads nowhere."""
    numbers = [len(times)]
    while numbers[-1] > FEWEST and times[numbers[-1] - 1] > FIRST * 2 * np.pi / turns:
        numbers.append(max(FEWEST, numbers[-1] // 2))
    return numbers[::-1]


def _grown(
    columns: Callable[[FloatArray, FloatArray], FloatArray],
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    data: tuple[FloatArray, FloatArray],
    linear: FloatArray | None = None,
    *,
    whole: bool = False,
) -> tuple[float, FloatArray] | None:
    """Misfit and parameters, the first cycles fitted first and more of the record then, or the whole at once.

    None as soon as more is left than `CLOSELY` times what a linear model leaves in the same rows.
    """
    times, seen = data
    turns = _turns(times, seen)
    scale = np.where(np.isfinite(bounds[1]), 0.02 * bounds[1], 0.1)
    for n in [len(times)] if whole else _longer(times, turns):
        fit = scipy.optimize.least_squares(
            lambda values, n=n: _left(columns(values, times[:n]), seen[:n]).ravel(),
            np.clip(start, bounds[0] + 1e-9, bounds[1] - 1e-9),
            bounds=bounds,
            x_scale=scale,
            max_nfev=50,
        )
        start = fit.x
        if linear is not None and 2.0 * fit.cost > CLOSELY**2 * float(np.square(linear[:n]).sum()):
            return None
    return _misfit(_left(columns(start, times), seen)), start


def _fitted(
    times: FloatArray,
    seen: FloatArray,
    free: BoolArray,
    *,
    harmonics: bool,
    linear: FloatArray | None = None,
) -> tuple[float, FloatArray] | None:
    """Misfit and parameters of the oscillator, with harmonics or without; some are free and the others zero.

    None where it leaves far more than `linear`, which a linear model leaves.
    """
    turns = _turns(times, seen)
    first = slice(_longer(times, turns)[0])
    bent = (MOST_BENT,) * 3
    low = np.array([0.5 * turns, 0.0, -np.inf, 0.0, 0.0, *(-value for value in bent[1:])])[free]
    high = np.array([1.5 * turns, HEAVIEST, np.inf, 0.5, *bent])[free]

    def whole(values: FloatArray) -> FloatArray:
        full = np.zeros(len(free))
        full[free] = values
        return full

    starts = [
        np.array([turns, damping, phase, friction, 0.0, 0.0, 0.0])[free]
        for friction in (FRICTIONS if free[3] else (0.0,))
        for damping in DAMPINGS
        for phase in 2 * np.pi * np.arange(PHASES) / PHASES
    ]
    best = None
    for reading in range(3 if harmonics else 1):  # displacement, velocity or acceleration, which are one for a mode

        def columns(values: FloatArray, rows: FloatArray, at: int = reading) -> FloatArray:
            x, v, a = motion(whole(values), rows)
            if not harmonics:
                return (x, v, a)[at][:, np.newaxis]
            square = (x**2, 2 * x * v, 2 * v**2 + 2 * x * a)[at]
            cube = (x**3, 3 * x**2 * v, 6 * x * v**2 + 3 * x**2 * a)[at]
            return np.column_stack([(x, v, a)[at], square, cube])

        tried = [float((_left(columns(one, times[first]), seen[first]) ** 2).sum()) for one in starts]
        found = _grown(columns, starts[int(np.argmin(tried))], (low, high), (times, seen), linear)
        if found is not None and (best is None or found[0] < best[0]):
            best = (found[0], whole(found[1]))
    return best


def _two_modes(times: FloatArray, seen: FloatArray, mode: FloatArray) -> float:
    """Misfit of two linear modes, each with any size and phase in every output; `mode` is the one alone."""
    turns = _turns(times, seen)
    span = float(times[-1])

    def columns(values: FloatArray, rows: FloatArray) -> FloatArray:
        parts = []
        for angular, ratio in values.reshape(2, 2):
            wave = np.exp((-ratio + 1j * np.sqrt(1.0 - ratio**2)) * angular * rows)
            parts += [wave.real, wave.imag]
        return np.column_stack(parts)

    bounds = (np.zeros(4), np.array([np.pi, HEAVIEST, np.pi, HEAVIEST]))
    one = mode[:2]
    beside = _turns(times, _left(columns(np.array([*one, *one]), times)[:, :2], seen))
    decay = max(one[1], 1.0 / (turns * span))
    seconds = [(beside, decay), (turns * (1.0 + 0.5 * decay), 3.0 * decay), (turns + np.pi / span, decay)]
    fits = [_grown(columns, np.array([*one, *other]), bounds, (times, seen)) for other in seconds]
    width = max(decay * turns, np.pi / span)
    pairs = [
        np.array([one[0] - below * width, light * decay, one[0] + above * width, heavy * decay])
        for below, above in APART
        for light in HEAVIER
        for heavy in HEAVIER
    ] + [np.array([*one, beside, heavy * decay]) for heavy in HEAVIER]
    pairs = [np.clip(pair, bounds[0] + 1e-9, bounds[1] - 1e-9) for pair in pairs]
    tried = [float((_left(columns(pair, times), seen) ** 2).sum()) for pair in pairs]
    # what is close together shows in the whole record only: its first cycles are those of one mode
    fits += [_grown(columns, pairs[i], bounds, (times, seen), whole=True) for i in np.argsort(tried)[:PAIRS]]
    return min(fit[0] for fit in fits if fit is not None)


def _misfit(left: FloatArray) -> float:
    """-2 ln L of white noise of each output's own size, but for a constant."""
    power = np.maximum(np.mean(left**2, axis=0), np.finfo(float).tiny)
    return float(len(left) * np.log(power).sum())
