"""Does a pole without an input stand as a peak? Its half-power bandwidth holds more power than what lies beside it.

Without inputs a pole may be the colour of what drives the system, or the edge of a filter. What tells a mode is its
resonance: power that stands above what lies on either side.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from modal.estimation.free_run import filled
from modal.modes.mode import ModalModel
from modal.verdict.probability import LEAST_HEIGHT, RESOLVED
from okid.arrays import BoolArray, ComplexArray, FloatArray
from okid.record import Record

BESIDE = (1.5, 4.0)
"""Compare a peak with what lies so many half-widths off: there a resonance alone has a sixth of its power."""
WIDER = (1.0, 2.0, 4.0)
"""Let sides reach so many times as far, one after the other, until a peak stands out."""
ALIKE = 1.5
"""Count so many neighbouring frequencies as one independent value: the noise bandwidth of the window (Hann)."""
LOADING = 1e-3
"""Null no neighbour below this share of the power beside a peak: chance would be nulled as well."""


def standing_out(model: ModalModel, records: Sequence[Record]) -> FloatArray:
    """How many times the power beside a mode its half-power bandwidth holds, a standard deviation of chance more.

    The outputs are weighted by the mode's shape c and the power S on both sides, w = S^-1 c*, as an array of sensors
    that hears one direction and is deaf to its neighbours (Capon). What is heard at a frequency f is counted in what
    would be heard there without the mode: as much as at the mode, of which each neighbour j that stands taller makes
    its resonance's share,

        b(f) = b(f_i) + sum_j P_j (L_j(f) - L_j(f_i)),   L_j(f) = s_j^2 / ((f - f_j)^2 + s_j^2),

    with half its half-power bandwidth s_j, and P_j from what is heard within it. The lesser of the two sides is given.

    Neighbours that are not known yet, and a damping ratio that is too small, put a side on the peak, so where a mode
    does not stand out it is asked again with wider sides, and beside each taller one that is found. The edge of a
    filter has its pass band on one side.

    Args:
        model: modes of the model.
        records: that it was identified from, without inputs.

    Returns:
        (n_modes,) nan where a mode does not turn, or its sides lie outside the band.

    References:
        Capon, Proceedings of the IEEE 57(8), 1969, 1408-1418, doi 10.1109/PROC.1969.7278.

    Example:
        >>> from modal.modes.mode import Mode
        >>> rng, y = np.random.default_rng(0), np.zeros(20_000)
        >>> for k in range(2, y.size):
        ...     y[k] = 1.6 * y[k - 1] - 0.95 * y[k - 2] + rng.standard_normal()
        >>> poles = [np.log(0.95**0.5 * np.exp(0.609j)) / 0.01, np.log(0.97 * np.exp(1.5j)) / 0.01]
        >>> modes = tuple(Mode(pole=s, kind="oscillatory", frequency=abs(s) / 2 / np.pi, damping_ratio=-s.real / abs(s),
        ...                    shape=np.ones(1), participation=np.empty(0)) for s in poles)
        >>> model = ModalModel(modes=modes, dt=0.01, indicator_caution=0.1)
        >>> standing_out(model, [Record([], y, 0.01)]).round(1).tolist()
        [5.2, 0.9]
    """
    longest = max(record.duration for record in records)
    spectra: list[tuple[FloatArray, ComplexArray]] = []
    for record in filled(records):
        motion = np.hanning(record.n_samples + 2)[1:-1, np.newaxis] * (record.outputs - record.outputs.mean(axis=0))
        lines = np.asarray(np.fft.rfftfreq(record.n_samples, record.dt), dtype=np.float64)
        spectra.append((lines[1:], np.fft.rfft(motion, axis=0)[1:] / record.duration**0.5))
    spectrum = (np.concatenate([lines for lines, _ in spectra]), np.concatenate([values for _, values in spectra]))
    waiting: dict[int, _Peak] = {}
    for i, mode in enumerate(model.modes):
        if mode.kind == "oscillatory":
            # a damping ratio that seems too small puts the sides on the peak
            damping = mode.damping_ratio + np.nan_to_num(np.minimum(mode.damping_ratio, mode.damping_ratio_std))
            waiting[i] = _Peak(mode.frequency, max(damping * mode.frequency, RESOLVED / longest), mode.shape)
    found = np.full(len(model), np.nan)
    standing: list[_Peak] = []
    asked = set(waiting)
    while waiting:
        for i in asked:
            found[i] = _tallest(waiting[i], standing, *spectrum)
        highest = max(waiting, key=lambda i: np.nan_to_num(found[i]))
        if not found[highest] >= LEAST_HEIGHT:
            break
        standing.append(waiting.pop(highest))
        asked = {i for i, peak in waiting.items() if peak.reaches(standing[-1], WIDER[-1])}
    return found


class _Peak(NamedTuple):
    """Where a mode would stand [Hz], half its half-power bandwidth [Hz], and its shape (n_outputs,)."""

    frequency: float
    half: float
    shape: ComplexArray

    def resonance(self, lines: FloatArray) -> FloatArray:
        """Power at these lines [Hz] in units of that at the peak."""
        values: FloatArray = self.half**2 / ((lines - self.frequency) ** 2 + self.half**2)
        return values

    def reaches(self, other: "_Peak", times: float) -> bool:
        """Whether sides that reach so many times as far touch the other's band."""
        return abs(other.frequency - self.frequency) <= times * BESIDE[1] * self.half + other.half

    def band(self, lines: FloatArray, low: float = -1.0, high: float = 1.0) -> BoolArray:
        """Which lines lie between so many half-widths off."""
        off = (lines - self.frequency) / self.half
        return np.asarray((low <= off) & (off <= high))


def _tallest(peak: _Peak, standing: Sequence[_Peak], lines: FloatArray, values: ComplexArray) -> float:
    """The first height that is enough as sides grow, the greatest where none is."""
    heights: list[float] = []
    for times in WIDER:
        heights.append(_height(peak, standing, lines, values, times=times))
        if not heights[-1] < LEAST_HEIGHT:
            break
    return float(np.fmax.reduce(heights))


def _height(peak: _Peak, standing: Sequence[_Peak], lines: FloatArray, values: ComplexArray, *, times: float) -> float:
    """Above sides that reach so many times as far; nan where wider ones leave the band."""
    own = peak.band(lines)
    bands = (peak.band(lines, -times * BESIDE[1], -BESIDE[0]), peak.band(lines, BESIDE[0], times * BESIDE[1]))
    sides = [side for side in bands if side.any()]
    if not own.any() or not sides or (times > 1.0 and len(sides) < len(bands)):
        return np.nan
    beside = np.mean([values[side].T @ values[side].conj() / np.count_nonzero(side) for side in sides], axis=0)
    size = np.sqrt(np.maximum(np.diag(beside).real, np.finfo(float).tiny))
    alike = beside / np.outer(size, size) + LOADING * np.eye(size.size)
    weights = np.linalg.solve(alike, peak.shape / size) / size
    heard = np.square(np.abs(values @ weights.conj()))
    background = np.zeros(lines.size)
    for other in standing:
        near = other.band(lines)
        if near.any() and peak.reaches(other, times):
            resonance = other.resonance(lines)
            background += heard[near].mean() / resonance[near].mean() * resonance
    background += max(float(heard[own].mean() - background[own].mean()), np.finfo(float).tiny)
    levels = [float(np.mean(heard[band] / background[band])) for band in (own, *sides)]
    n_values = np.count_nonzero(own) / ALIKE
    return float(levels[0] / max(*levels[1:], np.finfo(float).tiny) * np.exp(np.sqrt(2.0 / n_values)))
