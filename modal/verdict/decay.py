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

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from okid.arrays import TINY, BoolArray, FloatArray

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
        rest = np.zeros(self.seen.shape)
        for group in self.outputs:
            rest[np.ix_(group.rows, group.own)] = _projected(group.values, group.besides(columns))
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
                power = np.maximum(np.square(white[known]).sum(axis=0), TINY)
                best, count = int(np.argmin(power)), int(known.sum())
                if count * np.log(power[0] / power[best]) > N_SHAKEN * np.log(count):
                    noise[output] = trials[best]
        return noise

    def _white(
        self, group: "_Alike", output: int, modes: FloatArray, noise: FloatArray, values: FloatArray
    ) -> FloatArray:
        above, below = np.ones(1), np.ones(1)
        if np.isfinite(noise[0]):
            above, below = predictor(tuple(map(tuple, (modes * [group.step, 1.0]).tolist())), *noise.tolist())
        return group.filtered(np.convolve(above, self.colour[output]), below, values)

    def coloured(self, left: FloatArray) -> "Decay":
        """With the colour of what is left (n_last, n_outputs) one step ahead in its last rows."""
        colour = np.zeros((left.shape[1], COLOUR + 1))
        colour[:, 0] = 1.0
        for output in np.flatnonzero(self.strong):
            colour[output] = colour_of(left[:, output], int(self.told[-len(left) :, output].sum()))
        return replace(self, colour=colour)

    def size(self, left: FloatArray) -> FloatArray:
        """(n_outputs,) root mean square of what is told."""
        power = np.square(left * self.told).sum(axis=0) / np.maximum(1, self.told.sum(axis=0))
        return np.sqrt(np.maximum(power, np.finfo(float).tiny))

    def misfit(self, left: FloatArray) -> float:
        """-2 ln L of white noise of each output's own size, but for a constant."""
        return float((2.0 * self.told.sum(axis=0) * np.log(self.size(left))).sum())


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
        """(n_rows, n_columns) what an offset and what is beside leave of columns."""
        part = columns[self.rows]
        return part - self.basis @ (self.basis.T @ part)

    def filtered(self, above: FloatArray, below: FloatArray, values: FloatArray) -> FloatArray:
        """(n_rows, n_columns) through the monic polynomials A(q) / C(q), at rest before, 0 where not measured."""
        n = int(self.at[-1]) + 1
        even = np.zeros((n, values.shape[1]))
        even[self.at] = values
        moved = even.copy()
        for lag in range(1, min(len(above), n)):
            moved[lag:] += above[lag] * even[: n - lag]
        if len(below) > 1:
            band = np.tile(below[:, np.newaxis], (1, n))
            moved = scipy.linalg.solve_banded((len(below) - 1, 0), band, moved, overwrite_b=True, check_finite=False)
        return moved[self.at]


def _projected(values: FloatArray, columns: FloatArray) -> FloatArray:
    """(n, n_values) what the best sizes of columns (n, n_columns) leave."""
    rotated, _ = np.linalg.qr(columns)
    rest: FloatArray = values - rotated @ (rotated.T @ values)
    return rest


def _places(times: FloatArray) -> tuple[NDArray[np.intp], float, BoolArray]:
    """Places on an even grid, its step [samples], and which rows have enough before them, or are the first.

    The step is 0, and all rows count, where fewer than half have.
    """
    steps = np.diff(times)
    step = float(steps.min(initial=np.inf))
    at = np.concatenate([[0.0], np.cumsum(np.rint(steps / step))]).astype(np.intp)
    rows = np.arange(len(at))
    begun = np.maximum.accumulate(np.where(np.diff(at, prepend=-1) > 1, rows, 0))
    known: BoolArray = np.asarray((begun == 0) | (rows - begun >= PAST))
    return (at, step, known) if 2 * known.sum() >= len(known) else (rows, 0.0, np.ones(len(known), dtype=np.bool_))


def directions(seen: FloatArray, beside: FloatArray) -> FloatArray:
    """(n_outputs, n_outputs) orthogonal columns, in which outputs move but for an offset and what is beside.

    Of outputs that were measured in the same rows, the strongest first.

    Args:
        seen: (n, n_outputs), nan where not measured.
        beside: (n, n_columns).
    """
    there = np.isfinite(seen)
    along = np.zeros((seen.shape[1], seen.shape[1]))
    columns = np.column_stack([np.ones(len(seen)), beside])
    for rows in np.unique(there.T, axis=0):
        own = np.flatnonzero((rows == there.T).all(axis=1))
        values = seen[np.ix_(rows, own)]
        sizes = np.linalg.lstsq(columns[rows], values, rcond=None)[0]
        along[np.ix_(own, own)] = np.linalg.svd(values - columns[rows] @ sizes)[2].T if len(own) > 1 else 1.0
    return along


@lru_cache(maxsize=64)  # parameters that leave the poles alone are moved one by one
def predictor(modes: tuple[tuple[float, ...], ...], share: float, slope: float) -> tuple[FloatArray, FloatArray]:
    """A(q) and C(q), (2 n_modes + 1,), of the motion of modes that random forces shake, in white noise.

    A(q) has the poles of the modes and C(q) those of the best predictor; with as much of every mode,

        C(q) C(1/q) ~ A(q) A(1/q) + w (1 + a (q + 1/q) / 2) (A_1(q) A_1(1/q) + A_2(q) A_2(1/q) + ...)

    A_i being A without the poles of mode i, w the share of what shakes over that of white noise, and a what depends on
    the quantity that is measured: 1 where it falls off most with the frequency, -1 where least. The right side is a
    series of Chebyshev's polynomials of the cosine of the frequency.

    Args:
        modes: n_modes pairs of angular frequency [rad/row] and damping ratio.
        share: ln w.
        slope: a.

    Example:
        >>> rings, best = predictor(((0.5, 0.01),), np.log(1e-3), 0.5)
        >>> print(np.round(np.abs(np.roots(rings)), 3), np.round(np.abs(np.roots(best)), 3))
        [0.995 0.995] [0.976 0.976]
    """
    angular, ratio = np.array(modes).T
    poles = np.exp((-ratio + 1j * np.sqrt(1.0 - ratio**2)) * angular)
    pairs = np.column_stack([np.ones(len(poles)), -2.0 * poles.real, np.abs(poles) ** 2])
    rings = _product(pairs)
    half = np.correlate(rings, rings, "full")[len(rings) - 1 :]
    for i in range(len(pairs)):
        other = _product(np.delete(pairs, i, axis=0))
        shaken = np.convolve(np.correlate(other, other, "full"), [0.5 * slope, 1.0, 0.5 * slope])
        half[: len(rings) - 1] += np.exp(share) * shaken[len(shaken) // 2 :]
    half[1:] *= 2.0
    at = np.polynomial.chebyshev.chebroots(half).astype(np.complex128)
    root = np.sqrt(at - 1.0) * np.sqrt(at + 1.0)
    inside = np.where(np.abs(at + root) < np.abs(at - root), at + root, at - root)
    return rings, np.asarray(np.poly(inside).real, dtype=np.float64)


def _product(factors: FloatArray) -> FloatArray:
    """The polynomial of (n, m) factors."""
    whole = np.ones(1)
    for factor in factors:
        whole = np.convolve(whole, factor)
    return whole


def colour_of(values: FloatArray, count: int) -> FloatArray:
    """(COLOUR + 1,) the monic filter that makes values (n,) white, of the likeliest order by Schwarz's criterion.

    Levinson's recursion, of the `count` values that are told.
    """
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
