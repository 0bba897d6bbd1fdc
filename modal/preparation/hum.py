"""Lines that stand in struck records: mains in the cables, a machine beside the structure.

A structure that starts at rest has no states to hum with, so its model would fill with undamped modes that each blow
sets off. But a line stands before the first blow and after the last, and keeps its size and its phase in all parts of a
record, where a mode's motion is new with each blow and fades. It is looked for in the outputs, and, by turns with a
first model of the rest, in what is left of them:

    run    what the model leaves that runs from rest
    rung   what is left where between blows each mode may ring with a size of its own, whatever set it off

The second needs no more of the model than its poles, and tells a line as well as if nothing rang.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from modal.estimation.cross_validation import scaled_record
from modal.estimation.free_run import filled, run_from_rest
from modal.preparation.kind import acting_rows, widened
from modal.preparation.lines import MAIN_LOBE, MachineLines, blackman_harris, line_bins, lines_taken_off, share_taken
from modal.preparation.quick_model import observer_order, quick_model
from modal.preparation.rest import after_rest
from okid.arrays import ROUNDED, TINY, ComplexArray, FloatArray
from okid.record import Record
from okid.rows import runs_of
from okid.scaling import channel_scaling

Rows = tuple[int, int]
"""First row of a stretch in which nothing acts, and the row after its last."""

STANDS_OUT = 30.0
"""Ask where the power is so many times the median nearby,"""
MOST_PEAKS = 40
"""and of no more than so many peaks at a time."""
N_PARTS = 8
"""Ask whether a line keeps its size and phase in so many parts of a record,"""
BESIDE_LINE = 6
"""each against the noise of so many frequencies on either side of the line's main lobe there:"""
CERTAIN = 100.0
"""its parts together have so many times the power of noise,"""
BY_CHANCE = 1e-3
"""and they differ no more than noise makes them in all but so few records,"""
APART, MOST_APART = 0.03, 0.3
"""or more than half of them by no more than this share of it (the second only beside a model that is to be made
without the line),"""
FEWEST_VALUES = 5
"""and no stretch with so many values lacks it, or has more or less of it by three deviations."""
FADED = 0.2
"""Let a mode on a line explain no stretch at whose end more than this is left of it: it may be the line."""
MOST_DECAYS = 5e6
"""Fit no more values of decays than this in a stretch; longer ones tell of lines without."""
MOST_ROUNDS = 8
"""Take lines off and fit a first model to the rest so often at most,"""
SETTLED = 3e-5
"""or until no line changes by more than this share of an output's size."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Line:
    """A sinusoid of a record: the real part of size * exp(2 pi i cycles k) in row k.

    Attributes:
        cycles: a row.
        apart: cycles a row within which another line is the same one.
        size: (n_outputs,) complex.
        error: mean square of the error of its size, over all outputs.
    """

    cycles: float
    apart: float
    size: ComplexArray
    error: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Left:
    """What is left of a record's outputs, and where nothing acts.

    Attributes:
        values: (n_samples, n_outputs).
        free: stretches in which nothing acts.
    """

    values: FloatArray
    free: Sequence[Rows]

    def without(self, lines: Sequence[_Line]) -> "_Left":
        return replace(self, values=self.values - _sinusoids(len(self.values), lines))


def lines_beside_blows(records: Sequence[Record]) -> MachineLines:
    """Find the sinusoids that stand in struck records whatever the blows do, and take them off.

    Example:
        >>> blow = np.where(np.arange(4000) == 500, 1.0, 0.0)
        >>> ring = np.convolve(blow, 0.99 ** np.arange(1000) * np.cos(0.3 * np.arange(1000)))[:4000]
        >>> hum = 0.05 * np.sin(2 * np.pi * 7.3 * 0.01 * np.arange(4000))
        >>> noise = 0.001 * np.random.default_rng(0).standard_normal(4000)
        >>> found = lines_beside_blows([Record(blow, ring + hum + noise, 0.01)])
        >>> found.frequencies.round(2), bool(abs(found.records[0].outputs[:, 0] - ring - noise).max() < 0.001)
        (array([7.3]), True)
    """
    whole = filled([_centred(record) for record in records])
    scaling = channel_scaling(whole)
    scaled = [scaled_record(record, scaling) for record in whole]
    found = _found(scaled)
    if not any(found):
        return MachineLines(records=tuple(records), frequencies=np.empty(0))
    freed, shares = [], []
    for came, centred, lines in zip(records, whole, found, strict=True):
        hum = scaling.output_scale * _sinusoids(came.n_samples, lines)
        freed.append(replace(came, outputs=came.outputs - hum))
        shares.append(share_taken(centred, centred.outputs - hum))
    return lines_taken_off(
        records,
        freed,
        [line.cycles / one.dt for one, own in zip(records, found, strict=True) for line in own],
        max(shares),
        f"each keeps its size and its phase in {N_PARTS} parts of a record, whatever the blows do",
    )


def _centred(record: Record) -> Record:
    """About the median of each output; one that is not there at all is zero."""
    there = np.isfinite(record.outputs).any(axis=0)
    outputs = np.where(there, record.outputs, 0.0)
    return replace(record, outputs=outputs - np.nanmedian(outputs, axis=0))


def _found(records: Sequence[Record]) -> list[list[_Line]]:
    """The lines of each scaled record."""
    free = [runs_of(np.asarray(~widened(acting).any(axis=1))) for acting in acting_rows(records)]
    outputs = [_Left(values=record.outputs, free=own) for record, own in zip(records, free, strict=True)]
    at_once = _in_any([()] * len(records), outputs, APART)
    found = likely = at_once
    ahead = observer_order(records)  # else it would not see a blow in the first rows
    for _ in range(MOST_ROUNDS):
        taken = [_sinusoids(one.n_samples, lines) for one, lines in zip(records, likely, strict=True)]
        freed = [replace(record, outputs=record.outputs - hum) for record, hum in zip(records, taken, strict=True)]
        model = quick_model([after_rest(record, ahead) for record in freed])
        if model is None:
            break
        run = [
            replace(own, values=own.values - run_from_rest(model.form, record.inputs))
            for own, record in zip(outputs, records, strict=True)
        ]
        rung = [_rung(own, model.form.poles, lines) for own, lines in zip(outputs, likely, strict=True)]
        found = _in_any(at_once, rung, APART)
        likely = _in_any(_in_any(at_once, rung, MOST_APART), run, MOST_APART)
        again = [_sinusoids(one.n_samples, lines) for one, lines in zip(records, likely, strict=True)]
        if all(np.abs(new - old).max() < SETTLED for new, old in zip(again, taken, strict=True)):
            break
    return found


def _in_any(known: Sequence[Sequence[_Line]], left: Sequence[_Left], apart: float) -> list[list[_Line]]:
    """The lines of each record, known ones and those in what is left; one of any record is looked for in all."""
    found = [_better_known([*old, *_standing(own, apart)]) for old, own in zip(known, left, strict=True)]
    for i, own in enumerate(left):
        others = {line.cycles: line.apart for j, lines in enumerate(found) for line in lines if j != i}
        for cycles, near in others.items():
            if all(abs(cycles - line.cycles) > near for line in found[i]):
                line = _line_near(own.without(found[i]), cycles, near, apart=MOST_APART, told_by=0)
                found[i] = found[i] if line is None else [*found[i], line]
    return found


def _better_known(lines: Sequence[_Line]) -> list[_Line]:
    """Of two that are one, that whose size is known better."""
    kept = list[_Line]()
    for line in sorted(lines, key=lambda one: one.error):
        if all(abs(line.cycles - other.cycles) > max(line.apart, other.apart) for other in kept):
            kept.append(line)
    return kept


def _sinusoids(n_samples: int, lines: Sequence[_Line]) -> FloatArray:
    """(n_samples, n_outputs) their sum; (n_samples, 1) zeros without lines."""
    k = np.arange(n_samples)[:, np.newaxis]
    waves = [(line.size * np.exp(2j * np.pi * line.cycles * k)).real for line in lines]
    return np.sum(waves, axis=0) if waves else np.zeros((n_samples, 1))


def _rung(left: _Left, poles: ComplexArray, lines: Sequence[_Line]) -> _Left:
    """What is left but for what a structure with these poles may do between blows, and only there.

    Each stretch in which nothing acts is fitted by decays of sizes of its own, z^k and k z^k, since z is not quite
    right, beside the lines, which are the same in all stretches and stay. Rows of blows hold the lines alone, those
    before the first blow all that is there: nothing rings.
    """
    outputs, cycles = left.values, np.array([line.cycles for line in lines])
    waves = np.exp(2j * np.pi * np.outer(np.arange(len(outputs)), cycles))
    standing = np.hstack([waves.real, waves.imag])
    both = np.hstack([standing, outputs])
    told = np.zeros(len(outputs), dtype=np.bool_)
    for first, last in left.free:
        near = np.abs(np.angle(poles)[:, np.newaxis] / (2.0 * np.pi) - cycles) * (last - first) < MAIN_LOBE
        own = poles[(np.abs(poles) ** (last - first) < FADED) | ~near.any(axis=1)]
        if not first or not 8 * own.size < last - first < MOST_DECAYS / max(1, 4 * own.size):
            continue
        decays = own ** np.arange(last - first)[:, np.newaxis]
        decays = np.hstack([decays, decays * np.arange(last - first)[:, np.newaxis]])
        columns = np.hstack([decays.real, decays.imag])
        sizes = np.linalg.norm(columns, axis=0)
        basis, values, _ = np.linalg.svd(columns[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
        basis = basis[:, values > ROUNDED * values.max(initial=0.0)]
        both[first:last] -= basis @ (basis.T @ both[first:last])
        told[first:last] = True
    n = standing.shape[1]
    sizes = np.linalg.lstsq(both[told, :n], both[told, n:], rcond=None)[0]
    values = standing @ sizes
    values[told] = (both[:, n:] + (standing - both[:, :n]) @ sizes)[told]
    if left.free and not left.free[0][0]:
        before = slice(*left.free[0])
        values[before] = outputs[before]
    return replace(left, values=values)


def _standing(left: _Left, apart: float) -> list[_Line]:
    """The sinusoids that keep their size and phase, the strongest peaks first."""
    found = list[_Line]()
    for begins, ends in (_quietest(left.values), (0, len(left.values))):
        bins, power = line_bins(left.without(found).values[begins:ends], times=STANDS_OUT)
        peaks = [
            first + int(power[first:last].max(axis=1).argmax()) for first, last in runs_of(np.asarray(bins.any(axis=1)))
        ]
        for peak in sorted(peaks, key=lambda k: -float(power[k].max()))[:MOST_PEAKS]:
            line = _line_near(left.without(found), peak / (ends - begins), 2.0 / (ends - begins), apart=apart)
            if line is not None:
                found.append(line)
    return found


def _quietest(values: FloatArray) -> Rows:
    """The stretch in which a line would stand out most: a long one, of little power."""
    n_parts = 2 * N_PARTS
    n_rows = max(1, len(values) // n_parts)
    powers = np.square(values[: n_parts * n_rows]).reshape(-1, n_rows, values.shape[1]).sum(axis=1)
    pairs = [(i, j) for i in range(len(powers)) for j in range(i + 3, len(powers) + 1)] or [(0, len(powers))]
    means = [np.maximum(powers[i:j].mean(axis=0), TINY) for i, j in pairs]
    best = max(range(len(pairs)), key=lambda p: float(((pairs[p][1] - pairs[p][0]) / means[p]).max()))
    return pairs[best][0] * n_rows, pairs[best][1] * n_rows


def _line_near(left: _Left, peak: float, near: float, *, apart: float, told_by: int = 2) -> _Line | None:
    """The sinusoid as near to a peak [cycles a row] if it keeps its size and phase, which so many stretches tell."""
    n_rows = len(left.values) // N_PARTS
    if min(peak, 0.5 - peak) * n_rows < 2 * MAIN_LOBE:
        return None
    cycles = _frequency(left.values, peak, n_rows)
    sizes, noise = _parts(left.values, cycles, n_rows)
    size, weights = _robust_mean(sizes, noise)
    strongest = int((np.square(np.abs(size)) * weights.sum(axis=0)).argmax())
    power = float(np.square(np.abs(size[strongest])))
    if abs(cycles - peak) > near or power * weights[:, strongest].sum() < CERTAIN:
        return None
    if not _keeps(sizes[:, strongest] / size[strongest], noise[:, strongest] / power, apart):
        return None
    error = float((1.0 / weights.sum(axis=0)).sum())
    line = _Line(cycles=cycles, apart=MAIN_LOBE / len(left.values), size=size, error=error)
    return line if _told_by(left, line, apart) >= told_by else None


def _frequency(values: FloatArray, cycles: float, n_rows: int) -> float:
    """The frequency [cycles a row] near this one at which all parts have one phase best."""
    middles = n_rows * (np.arange(N_PARTS) + 0.5)
    steps = np.linspace(-0.45, 0.45, 129) / n_rows  # a whole turn from part to part would look the same
    sizes, noise = _parts(values, cycles, n_rows)
    turned = np.exp(-2j * np.pi * np.outer(steps, middles)) @ (sizes / noise)
    cycles += float(steps[(np.square(np.abs(turned)) / (1.0 / noise).sum(axis=0)).sum(axis=1).argmax()])
    for _ in range(3):
        sizes, noise = _parts(values, cycles, n_rows)
        size, weights = _robust_mean(sizes, noise)
        shares = weights * np.square(np.abs(size))
        whole = np.maximum(shares.sum(axis=0), TINY)  # of an output that does not move there is none
        late = middles[:, np.newaxis] - (shares * middles[:, np.newaxis]).sum(axis=0) / whole
        turns = np.angle(sizes * size.conj()) / (2.0 * np.pi)
        cycles += float((shares * late * turns).sum() / max((shares * late * late).sum(), TINY))
    return cycles


def _keeps(own: ComplexArray, variance: FloatArray, apart: float) -> bool:
    """Whether (N_PARTS,) sizes relative to their mean are all one, or most of them, given their variance."""
    squares = np.square(np.abs(own - 1.0))
    alike = 2.0 * float((squares / variance).sum()) < scipy.special.chdtri(2 * (N_PARTS - 1), BY_CHANCE)
    return alike or int((squares <= apart**2).sum()) > N_PARTS / 2


def _told_by(left: _Left, line: _Line, apart: float) -> int:
    """Stretches that tell of a line, before the first blow and late after each; -1 where one lacks it.

    A mode that hardly decays is as steady as a line until the next blow, and not there before the first.
    """
    standing, told = _sinusoids(len(left.values), [line]), 0
    for first, last in left.free:
        late = slice((first + last) // 2, last) if first else slice(first, last)
        if standing[late].size < FEWEST_VALUES:
            continue
        rest = left.values[late] - standing[late]
        scale = np.sqrt(np.square(rest).mean(axis=0) + TINY)
        power = max(float(np.square(standing[late] / scale).sum()), TINY)
        more, error = float((standing[late] * rest / scale**2).sum()) / power, 1.0 / np.sqrt(power)
        likelier = 0.5 + 2.0 * error**2  # so much less, and nothing is exp(2) times as likely as the line
        if not -max(apart, min(3.0 * error, likelier)) <= more <= max(apart, 3.0 * error):
            return -1
        told += error < MOST_APART
    return told


def _parts(values: FloatArray, cycles: float, n_rows: int) -> tuple[ComplexArray, FloatArray]:
    """(N_PARTS, n_outputs) sizes of a sinusoid in each part, and the variance of noise of its neighbours there."""
    window = blackman_harris(n_rows)
    beside = np.arange(MAIN_LOBE + 1, MAIN_LOBE + 1 + BESIDE_LINE)
    offsets = np.concatenate([[0], beside, -beside]) / n_rows
    offsets = offsets[(cycles + offsets > 0.0) & (cycles + offsets < 0.5)]
    waves = np.exp(-2j * np.pi * np.outer(cycles + offsets, np.arange(n_rows))) * (2.0 * window / window.sum())
    spectra = waves @ values[: N_PARTS * n_rows].reshape(N_PARTS, n_rows, -1)
    begins = np.exp(-2j * np.pi * cycles * n_rows * np.arange(N_PARTS))[:, np.newaxis]
    noise = np.square(np.abs(spectra[:, 1:])).mean(axis=1)
    return begins * spectra[:, 0], np.maximum(noise, TINY)


def _robust_mean(sizes: ComplexArray, noise: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """(n_outputs,) mean over the parts, weighed by their noise and by how far each is from the mean; the weights."""
    mean = np.median(sizes.real, axis=0) + 1j * np.median(sizes.imag, axis=0)
    weights = 1.0 / noise
    for _ in range(5):
        weights = 1.0 / (noise + np.square(np.abs(sizes - mean)))
        mean = (weights * sizes).sum(axis=0) / weights.sum(axis=0)
    return mean, weights
