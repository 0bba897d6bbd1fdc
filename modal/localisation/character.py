"""What kind of signal the gap is: where in frequency it lies, whether it is one line, whether it follows the model.

A force that belongs to the structure moves with it, so part of the gap is coherent with the simulated output; a
disturbance from outside is not, whatever its size.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal.localisation.bands import line_power
from modal.localisation.gap import Gap
from okid.arrays import ComplexArray, FloatArray

N_SEGMENTS = 8
"""Average spectra over so many segments of a record, half overlapping."""
INDEPENDENT = 0.6
"""Count half-overlapping Hann segments as this share of independent ones (Welch)."""
MOST_CELLS = 512
"""Look for the narrowest interval among at most so many cells."""
LINE_REACH = 2
"""Sum a line over so many cells on either side: a record of any length spreads it over these."""
MOSTLY = 0.7
"""Call a gap one line that holds at least this share of it above the noise."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Interval:
    """The narrowest range of frequencies that holds a share of the gap.

    Attributes:
        low: [Hz].
        high: [Hz].
        share: of the gap above the noise, its constant part included in the whole.
        simulated_share: of the simulated output's variance in the same range.
    """

    low: float
    high: float
    share: float
    simulated_share: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SingleLine:
    """One frequency that holds most of the gap, though little of the simulated output.

    Attributes:
        frequency: [Hz].
        share: of the gap above the noise.
        simulated_share: of the simulated output's variance at that frequency.
        amplitudes: (n_records,) of the line [output units].
    """

    frequency: float
    share: float
    simulated_share: float
    amplitudes: FloatArray


def excess_spectrum(gap: Gap, outputs: Sequence[int]) -> tuple[float, FloatArray]:
    """Constant part and (n_cells,) spectrum of the gap above the noise, relative to the outputs' variances.

    Sums over the outputs, means over the records. Single cells may be negative.
    """
    chosen = list(outputs)
    size = np.where(gap.variance > 0.0, gap.variance, np.inf)[:, chosen]
    lengths = np.array([[record.n_samples] for record in gap.measured])
    constant = (gap.constant - gap.floor / lengths)[:, chosen] / size
    spectrum = (gap.cells.gap - gap.cells.floor)[..., chosen] / size[:, np.newaxis]
    return float(constant.sum(axis=1).mean()), spectrum.sum(axis=2).mean(axis=0)


def narrowest_interval(gap: Gap, outputs: Sequence[int], *, share: float = 0.8) -> Interval | None:
    """The narrowest range of frequencies that holds a share of the gap above the noise; None where there is no gap."""
    constant, cells = excess_spectrum(gap, outputs)
    total = cells.sum()
    if not total > 0.0:
        return None
    top = 1 + int(np.argmax(np.cumsum(cells) >= 0.999 * total))
    step = -(-top // MOST_CELLS)
    edges = np.minimum(np.arange(0, top + step, step), cells.size)
    sums = np.concatenate([[0.0], np.cumsum(cells)])[edges]
    inside = sums[np.newaxis, :] - sums[:, np.newaxis]
    width = (edges[np.newaxis, :] - edges[:, np.newaxis]).astype(float)
    fits = (inside >= share * total) & (width > 0)
    # of equally narrow ranges the fullest
    best = np.where(fits, width - 0.5 * inside / max(float(inside.max()), float(total)), np.inf)
    first, last = (edges[i] for i in np.unravel_index(int(np.argmin(best)), best.shape))
    size = np.where(gap.variance > 0.0, gap.variance, np.inf)[:, np.newaxis, :]
    simulated = (gap.cells.simulated / size)[..., list(outputs)].sum(axis=2).mean(axis=0)
    return Interval(
        low=float(gap.cells.edges[first]),
        high=float(gap.cells.edges[last]),
        share=float(cells[first:last].sum() / (total + max(0.0, constant))),
        simulated_share=_share(simulated, int(first), int(last)),
    )


def single_line(gap: Gap, output: int) -> SingleLine | None:
    """The line that holds most of the gap of an output at every record, though not of the simulated output."""
    # absolute sums: a disturbance has the same size in every record
    cells = (gap.cells.gap - gap.cells.floor)[..., output]
    whole = cells.sum(axis=0)
    total = whole.sum() + float(np.maximum(gap.constant[:, output], 0.0).sum())
    peak = int(np.argmax(whole))
    near = slice(max(0, peak - LINE_REACH), peak + LINE_REACH + 1)
    share = float(whole[near].sum() / total) if total > 0.0 else 0.0
    simulated = _share(gap.cells.simulated[..., output].mean(axis=0), near.start, near.stop)
    if share < MOSTLY or simulated > 0.5 * share:
        return None
    return SingleLine(
        frequency=_centre(gap, output, gap.cells.edges[near.start], gap.cells.edges[min(near.stop, whole.size)]),
        share=share,
        simulated_share=simulated,
        amplitudes=np.sqrt(2.0 * np.maximum(cells[:, near].sum(axis=1), 0.0)),
    )


def _centre(gap: Gap, output: int, low: float, high: float) -> float:
    """Mean frequency of the gap's lines between two frequencies, in the longest record [Hz]."""
    longest = max(range(len(gap.measured)), key=lambda i: gap.measured[i].n_samples)
    power = line_power(gap.residuals[longest][:, [output]])[1][:, 0]
    place = np.arange(1, power.size + 1) / gap.measured[longest].duration
    near = (place >= low) & (place <= high)
    return float(power[near] @ place[near] / power[near].sum())


def coherent_share(gap: Gap) -> FloatArray:
    """(n_outputs,) share of the gap that is coherent with the simulated output, mean over records; nan where unknown.

    The coherence of the two, weighted by the spectrum of the gap, less the bias of an average over few segments.

    References:
        Bendat, Piersol, Random Data, 4th edition, Wiley 2010, chapter 9, doi 10.1002/9781118032428.
    """
    shares = np.array(
        [_coherent_share(residual, run.outputs) for residual, run in zip(gap.residuals, gap.simulated, strict=True)]
    )
    known = np.isfinite(shares)
    total = np.where(known, shares, 0.0).sum(axis=0)
    result: FloatArray = np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
    return result


def _coherent_share(residual: FloatArray, simulated: FloatArray) -> FloatArray:
    length = len(residual) // N_SEGMENTS
    if length < 2 * N_SEGMENTS:
        return np.full(residual.shape[1], np.nan)
    first, second = _segments(residual, length), _segments(simulated, length)
    own, other = (np.square(np.abs(spectra)).mean(axis=0) for spectra in (first, second))
    cross = np.square(np.abs((first * second.conj()).mean(axis=0)))
    coherent = np.divide(cross, other, out=np.zeros_like(cross), where=other > 0.0).sum(axis=0)
    whole = own.sum(axis=0)
    share = np.divide(coherent, whole, out=np.full_like(coherent, np.nan), where=whole > 0.0)
    bias = 1.0 / (INDEPENDENT * len(first))
    result: FloatArray = (share - bias) / (1.0 - bias)
    return result


def _segments(values: FloatArray, length: int) -> ComplexArray:
    """(n_segments, n_lines, n_outputs) spectra of half-overlapping Hann segments, means and missing samples at zero."""
    with np.errstate(invalid="ignore"):
        mean = np.nanmean(values, axis=0)
    whole = np.nan_to_num(values - mean)
    window = np.hanning(length + 1)[:-1, np.newaxis]
    starts = range(0, len(values) - length + 1, max(1, length // 2))
    spectra: ComplexArray = np.array(
        [np.fft.rfft(window * whole[start : start + length], axis=0)[1:] for start in starts]
    )
    return spectra


def _share(power: FloatArray, first: int, last: int) -> float:
    total = float(power.sum())
    return float(power[first:last].sum()) / total if total > 0.0 else 0.0
