"""What rings down, and the noise in which a description of it is likely.

Wind, traffic and machines still drive a mode while it rings down. What a description leaves is then no white noise, but
motion of the same mode, and an oscillator with a few numbers more follows it at once: in white noise of each output's
own size, every second mode that wind drives beside a blow is likelier as a spring that is not linear. So each
description has noise of its own: the motion of its modes under random forces, in white noise, and what one step ahead
the past does not tell of the two is weighed. With A(q) the poles of its modes and C(q) those of the best predictor,

    A(q) r = C(q) e,   r = seen - columns sizes

in each of the directions in which the outputs move: outputs that see one motion see one force as well, and would tell
the same once more. What else colours the noise, filters before all, is that of the last half of the record.

References:
    Ljung, System Identification, 2nd ed., 1999, sections 3.2 and 4.2 (prediction errors); Anderson and Moore, Optimal
    Filtering, 1979, section 9.4 (spectral factorisation).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray

ALIKE = 0.9
"""Take the lowest of lines that are as strong as this: samples that are missing in turns make images above a line."""
SHARES = (-18.0, 10.0)
"""Let ln of what shakes a mode over white noise be between these, from far below to far above it,"""
STEEPEST = 0.98
"""and the slope of its spectrum besides between minus and plus this;"""
TRIED = tuple((float(share), slope) for share in range(-16, 10, 4) for slope in (-0.8, 0.0, 0.8))
"""begin with the likeliest of these,"""
N_SHAKEN = 2
"""and count so many numbers of every direction."""
DIRECTIONS = 4
"""Ask so many directions of the outputs what shakes them, and price them: two modes of any phases move in no more."""
COLOUR = 8
"""Let what else is left be as coloured as so many rows before tell."""
FEWEST_TOLD = 4 * COLOUR
"""Tell no colour of fewer values."""
LEAST_APART = 1e-12
"""Take distances of poles below this for rounding."""
PAST = 6
"""Ask for so many rows before one that tells of noise: as many as three modes have poles."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Decay:
    """What rings down, and what every description of it may have besides.

    Attributes:
        times: (n,) in samples, rising.
        seen: (n, n_outputs), nan where not measured.
        beside: (n, n_columns) what has any size in every output.
        there: (n, n_outputs) what was measured.
        told: (n, n_outputs) what was measured after enough that was.
        turns: angular frequency [rad/sample] of the strongest line.
        outputs: those that were measured in the same rows together.
        strong: (n_outputs,) the first `DIRECTIONS` of each of these.
        colour: (n_outputs, order + 1) the filter that makes white what else is left.
    """

    times: FloatArray
    seen: FloatArray
    beside: FloatArray
    there: BoolArray
    told: BoolArray
    turns: float
    outputs: tuple["_Alike", ...]
    strong: BoolArray
    colour: FloatArray

    @classmethod
    def of(cls, times: FloatArray, seen: FloatArray, beside: FloatArray) -> "Decay":
        """From the first three."""
        there: BoolArray = np.asarray(np.isfinite(seen))
        groups, told, strong = [], there.copy(), np.zeros(seen.shape[1], dtype=np.bool_)
        columns = np.column_stack([np.ones(len(times)), beside])
        for rows in np.unique(there.T, axis=0):
            if not rows.any():
                continue
            own = np.asarray((rows == there.T).all(axis=1))
            strong[np.flatnonzero(own)[:DIRECTIONS]] = True
            left, sizes, _ = np.linalg.svd(columns[rows], full_matrices=False)
            basis = left[:, sizes > np.finfo(float).eps * len(columns) * sizes.max(initial=0.0)]
            values = seen[rows][:, own]
            at, step, known = _places(times[rows])
            told[np.ix_(rows, own)] = known[:, np.newaxis]
            values = values - basis @ (basis.T @ values)
            groups.append(_Alike(rows=rows, own=own, basis=basis, values=values, at=at, step=step))
        return cls(
            times=times,
            seen=seen,
            beside=beside,
            there=there,
            told=told,
            turns=strongest_line(times, seen),
            outputs=tuple(groups),
            strong=strong,
            colour=np.ones((seen.shape[1], 1)),
        )

    def first(self, n: int) -> "Decay":
        """The first rows."""
        return Decay.of(self.times[:n], self.seen[:n], self.beside[:n])

    def last(self, n: int) -> "Decay":
        """The last rows."""
        return Decay.of(self.times[-n:], self.seen[-n:], self.beside[-n:])

    def left(self, columns: FloatArray) -> FloatArray:
        """(n, n_outputs) what the best offset and sizes of these columns leave of each output, 0 where not measured."""
        left: FloatArray = self.left_of_each(columns[np.newaxis])[0]
        return left

    def left_of_each(self, columns: FloatArray) -> FloatArray:
        """(n_trials, n, n_outputs) the same of several (n_trials, n, n_columns)."""
        if len(self.outputs) == 1 and self.there.all():
            (group,) = self.outputs
            return np.array([_projected(group.values, part) for part in group.besides(columns)])
        rest = np.zeros((len(columns), *self.seen.shape))
        for group in self.outputs:
            place = np.ix_(group.rows, group.own)
            for own, part in zip(rest, group.besides(columns), strict=True):
                own[place] = _projected(group.values, part)
        return rest

    def innovations(self, columns: FloatArray, modes: FloatArray, noise: FloatArray) -> FloatArray:
        """(n, n_outputs) what one step ahead the past does not tell of what they leave, 0 where that is not known.

        Args:
            columns: (n, n_columns).
            modes: (n_modes, 2) angular frequencies [rad/sample] and damping ratios of what is shaken.
            noise: (n_outputs, 2) ln of the share, nan for white noise, and slope, as for `predictor`.
        """
        rest = np.zeros(self.seen.shape)
        for group in self.outputs:
            part = group.besides(columns)
            outputs, plain = np.flatnonzero(group.own), []
            for i, output in enumerate(outputs.tolist()):
                if np.isnan(noise[output, 0]) and not self.colour[output, 1:].any():
                    plain.append(i)
                    continue
                both = self._white(group, output, modes, noise[output], np.column_stack([group.values[:, i], part]))
                rest[group.rows, output] = _projected(both[:, :1], both[:, 1:])[:, 0]
            rest[np.ix_(group.rows, outputs[plain])] = _projected(group.values[:, plain], part)
        return rest * self.told

    def noise_of(self, modes: FloatArray, left: FloatArray) -> FloatArray:
        """(n_outputs, 2) the likeliest noise of what a description leaves, nan where white noise is as likely."""
        noise = np.full((self.seen.shape[1], 2), np.nan)
        for group in self.outputs:
            for output in np.flatnonzero(group.own & self.strong).tolist() if group.step else ():
                rest, known = left[group.rows, output, np.newaxis], self.told[group.rows, output]
                trials = ((np.nan, 0.0), *TRIED)
                white = np.hstack([self._white(group, output, modes, np.array(trial), rest) for trial in trials])
                power = np.nan_to_num(np.maximum(np.square(white[known]).sum(axis=0), TINY), nan=np.inf)
                best, count = int(np.argmin(power)), int(known.sum())
                if count * np.log(power[0] / power[best]) > N_SHAKEN * np.log(count):
                    noise[output] = trials[best]
        return noise

    def _white(
        self, group: "_Alike", output: int, modes: FloatArray, noise: FloatArray, values: FloatArray
    ) -> FloatArray:
        sections = np.ones((0, 3)), np.ones((0, 3))
        if np.isfinite(noise[0]):
            sections = predictor(tuple(map(tuple, (modes * [group.step, 1.0]).tolist())), *noise.tolist())
        return group.filtered(*sections, self.colour[output], values)

    def colours(self, left: FloatArray) -> FloatArray:
        """(n_outputs, COLOUR + 1) filters that make white what is left (n, n_outputs) one step ahead."""
        colour = np.zeros((left.shape[1], COLOUR + 1))
        colour[:, 0] = 1.0
        for group in self.outputs:
            even = np.zeros(int(group.at[-1]) + 1)
            for output in np.flatnonzero(group.own & self.strong) if group.step else ():
                even[group.at] = left[group.rows, output]
                colour[output] = colour_of(even, int(self.told[:, output].sum()))
        return colour

    def coloured(self, last: "Decay", left: FloatArray) -> "Decay":
        """With the colour of what is left (n_last, n_outputs) one step ahead of last rows that have the same steps."""
        colour = last.colours(left)
        colour[self.steps != last.steps] = np.eye(COLOUR + 1)[0]
        return replace(self, colour=colour)

    @property
    def steps(self) -> FloatArray:
        """(n_outputs,) samples from row to row, 0 where these do not stand side by side."""
        steps = np.zeros(self.seen.shape[1])
        for group in self.outputs:
            steps[group.own] = group.step
        return steps

    def size(self, left: FloatArray) -> FloatArray:
        """(n_outputs,) root mean square of what is told."""
        power = np.square(left * self.told).sum(axis=0) / np.maximum(1, self.told.sum(axis=0))
        return np.sqrt(np.maximum(power, np.finfo(float).tiny))

    def misfit(self, left: FloatArray, *, whole: bool = False) -> float:
        """-2 ln L of white noise of each direction's own size, but for a constant; of the strong ones, or of all."""
        counted = self.told.sum(axis=0) * (self.strong | whole)
        return float((2.0 * counted * np.log(self.size(left))).sum())


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Alike:
    """Outputs that were measured in the same rows.

    Attributes:
        rows: (n,) which.
        own: (n_outputs,) which outputs.
        basis: (n_rows, n_columns) of an offset and of what is beside.
        values: (n_rows, n_own) what this leaves.
        at: (n_rows,) places on an even grid,
        step: of so many samples; 0 where too few rows stand side by side.
    """

    rows: BoolArray
    own: BoolArray
    basis: FloatArray
    values: FloatArray
    at: NDArray[np.intp]
    step: float

    def besides(self, columns: FloatArray) -> FloatArray:
        """(..., n_rows, n_columns) what an offset and what is beside leave of columns (..., n, n_columns)."""
        part = columns[..., self.rows, :]
        return part - self.basis @ (self.basis.T @ part)

    def filtered(self, above: FloatArray, below: FloatArray, colour: FloatArray, values: FloatArray) -> FloatArray:
        """(n_rows, n_columns) through A(q) / C(q), sections (n, 3) of each, and a colour; at rest before, gaps as 0."""
        moved = np.zeros((int(self.at[-1]) + 1, values.shape[1]))
        moved[self.at] = values
        for one, other in zip(above, below, strict=True):
            band = np.tile(other[:, np.newaxis], (1, len(moved)))
            moved, _ = scipy.linalg.lapack.dtbtrs(band, _lagged(one, moved), uplo="L", diag="U", overwrite_b=True)
        return _lagged(colour, moved)[self.at]


def _lagged(weights: FloatArray, values: FloatArray) -> FloatArray:
    """(n, n_columns) sums of weighted rows before, the row itself first."""
    summed = weights[0] * values
    for lag in range(1, min(len(weights), len(values))):
        if weights[lag]:
            summed[lag:] += weights[lag] * values[:-lag]
    return summed


def _projected(values: FloatArray, columns: FloatArray) -> FloatArray:
    """(n, n_values) what the best sizes of columns (n, n_columns) leave."""
    # of narrow columns numpy's decomposition is the same but for what it does besides, which takes three times as long
    reflectors, scalars, _, _ = scipy.linalg.lapack.dgeqrf(columns)
    rotated, _, _ = scipy.linalg.lapack.dorgqr(reflectors[:, : len(scalars)], scalars, overwrite_a=True)
    rest: FloatArray = values - rotated @ (rotated.T @ values)
    return rest


def _places(times: FloatArray) -> tuple[NDArray[np.intp], float, BoolArray]:
    """Places on an even grid, its step [samples], and which rows have enough before them, or are the first.

    The step is 0, and all rows count, where fewer than half have.
    """
    rows = np.arange(len(times))
    step = int(np.gcd.reduce(np.diff(times).astype(np.intp))) if len(times) > PAST else 0
    at = ((times - times[0]) / max(step, 1)).astype(np.intp)
    begun = np.maximum.accumulate(np.where(np.diff(at, prepend=-1) > 1, rows, 0))
    known: BoolArray = np.asarray((begun == 0) | (rows - begun >= PAST))
    enough = step > 0 and 2 * known.sum() >= len(known)
    return (at, float(step), known) if enough else (rows, 0.0, np.ones(len(known), dtype=np.bool_))


def directions(seen: FloatArray, beside: FloatArray) -> FloatArray:
    """(n_outputs, n_directions) orthogonal columns, in which outputs move but for an offset and what is beside.

    Of outputs that were measured in the same rows, the strongest first; none in which nothing but rounding moves, as
    where an output is the copy of another.

    Args:
        seen: (n, n_outputs), nan where not measured.
        beside: (n, n_columns).
    """
    there = np.isfinite(seen)
    along, moves = np.zeros((seen.shape[1], seen.shape[1])), np.zeros(seen.shape[1], dtype=np.bool_)
    columns = np.column_stack([np.ones(len(seen)), beside])
    for rows in np.unique(there.T, axis=0):
        own = np.flatnonzero((rows == there.T).all(axis=1))
        values = seen[np.ix_(rows, own)]
        values = values - columns[rows] @ np.linalg.lstsq(columns[rows], values, rcond=None)[0]
        _, sizes, turned = np.linalg.svd(values, full_matrices=len(values) < len(own))
        along[np.ix_(own, own)] = turned.T
        moves[own[: len(sizes)]] = sizes > np.sqrt(np.finfo(float).eps) * sizes.max(initial=0.0)
    return along[:, moves]


@lru_cache(maxsize=64)  # parameters that leave the poles alone are moved one by one
def predictor(modes: tuple[tuple[float, ...], ...], share: float, slope: float) -> tuple[FloatArray, FloatArray]:
    """A(q) and C(q) as sections of the second order, of the motion of modes that random forces shake, in white noise.

    A(q) has the poles of the modes and C(q) those of the best predictor; with as much of every mode,

        C(q) C(1/q) ~ A(q) A(1/q) + w (1 + a (q + 1/q) / 2) (A_1(q) A_1(1/q) + A_2(q) A_2(1/q) + ...)

    A_i being A without the poles of mode i, w the share of what shakes over that of white noise, and a what depends on
    the quantity that is measured: 1 where it falls off most with the frequency, -1 where least. With u = 1 - cos of the
    angle and a pole r exp(i p) that is 4 r^2 ((u - u_0)^2 + d^2) of each mode, u_0 = (1 + r^2)/r sin^2(p/2) -
    (1 - r)^2/(2 r) and d = (1 - r^2)/(2 r) sin p: a polynomial of u, counted from the modes and in their distances, as
    the poles of close, light or slow modes lose their digits in powers of q.

    Args:
        modes: n_modes pairs of angular frequency [rad/row] and damping ratio.
        share: ln w.
        slope: a.

    Returns:
        (n_modes, 3) monic each.

    Example:
        >>> rings, best = predictor(((0.5, 0.01),), np.log(1e-3), 0.5)
        >>> print(np.round(np.abs(np.roots(rings[0])), 3), np.round(np.abs(np.roots(best[0])), 3))
        [0.995 0.995] [0.961 0.961]
    """
    angular, ratio = np.array(modes).T
    radius, turned = np.exp(-ratio * angular), np.sqrt(1.0 - ratio**2) * angular
    level = (1.0 + radius**2) / radius * np.sin(0.5 * turned) ** 2 - np.expm1(-ratio * angular) ** 2 / (2.0 * radius)
    depth = -np.expm1(-2.0 * ratio * angular) / (2.0 * radius) * np.sin(turned)
    middle, scale = level.mean(), max(float(np.ptp(level)), float(np.abs(depth).max()), LEAST_APART)
    own = [np.array([1.0, -2.0 * u, u**2 + d**2]) for u, d in zip((level - middle) / scale, depth / scale, strict=True)]
    force = np.exp(share) * np.array([-slope * scale, 1.0 + slope * (1.0 - middle)])
    whole = _product(own)
    for i, one in enumerate(radius):
        shaken = np.convolve(force / (4.0 * one**2 * scale**2), _product(own[:i] + own[i + 1 :]))
        whole[len(whole) - len(shaken) :] += shaken
    rings = np.column_stack([np.ones(len(radius)), -2.0 * radius * np.cos(turned), radius**2])
    return rings, np.array([_section(*pair) for pair in _pairs(middle + scale * np.roots(whole))])


def _pairs(roots: ComplexArray) -> list[tuple[complex, complex]]:
    """Conjugate ones together, and real ones in their order."""
    above, real = roots[roots.imag > 0.0], np.sort(roots[roots.imag == 0.0].real)
    return [(one, one.conjugate()) for one in above] + list(zip(real[::2], real[1::2], strict=True))


def _section(one: complex, other: complex) -> FloatArray:
    """(3,) the monic polynomial in q whose roots lie within the unit circle, of two of u = 1 - (q + 1/q) / 2."""
    if (
        one.imag == 0.0 and 0.0 < one.real < 2.0 and 0.0 < other.real < 2.0
    ):  # on the circle by rounding: one double root
        one = complex(0.5 * (one.real + other.real), max(0.5 * abs(one.real - other.real), LEAST_APART))
        other = one.conjugate()
    inside = []
    for u in (complex(one), complex(other)):
        half = np.sqrt(2.0 * u * (0.5 * u - 1.0))
        inside.append(min(1.0 - u + half, 1.0 - u - half, key=abs))
    return np.array([1.0, -(inside[0] + inside[1]).real, (inside[0] * inside[1]).real])


def _product(factors: Sequence[FloatArray]) -> FloatArray:
    """The polynomial of these."""
    whole = np.ones(1)
    for factor in factors:
        whole = np.convolve(whole, factor)
    return whole


def colour_of(values: FloatArray, count: int) -> FloatArray:
    """(COLOUR + 1,) the monic filter that makes values (n,) white, of the likeliest order by Schwarz's criterion.

    Levinson's recursion, of the `count` values that are told, 0 where none is.
    """
    if count < FEWEST_TOLD:
        return np.eye(COLOUR + 1)[0]
    best = monic = np.ones(1)
    covariances = np.array([values[lag:] @ values[: len(values) - lag] for lag in range(min(COLOUR + 1, len(values)))])
    power = start = max(float(covariances[0]), TINY)
    least = 0.0
    for order in range(1, len(covariances)):
        step = -float(monic @ covariances[order:0:-1]) / power
        padded = np.append(monic, 0.0)
        monic, power = padded + step * padded[::-1], power * max(1.0 - step**2, TINY)
        criterion = count * np.log(power / start) + order * np.log(count)
        if criterion < least:
            best, least = monic, criterion
    return np.append(best, np.zeros(COLOUR + 1 - len(best)))


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
