"""Lines that stand in records with inputs: mains in the cables, a machine beside the structure.

A model has no states to hum with but undamped modes, which each force sets off anew. But a line keeps its size and its
phase in all parts of a record, whatever acts, where what forces make is new in each part. It is looked for by turns
with a first model of the rest, in what is left of the outputs:

    run    what the model leaves that runs from rest
    rung   what is left where modes may ring with a size of their own, whatever set them off

Between blows nothing acts: there each mode may ring, and a line is told as well as if nothing did; it stands before the
first blow and after the last, too, where a mode is new with each blow and fades. The second needs no more of the model
than its poles. Where forces act throughout only a mode that rings on through the whole record looks like a line.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from modal.estimation.cross_validation import scaled_record
from modal.estimation.free_run import filled, run_from_rest
from modal.preparation.drift import FreedTrials
from modal.preparation.kind import acting_rows, widened
from modal.preparation.lines import MAIN_LOBE, MachineLines, blackman_harris, line_bins, lines_taken_off, share_taken
from modal.preparation.quick_model import QuickModel, observer_order, quick_model
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
"""or until no line changes by more than this share of an output's size,"""
FEWEST_ROUNDS = 3
"""or, after so many, until none is left that holds."""
TONES = 0.05
"""Let be what forces drive that have more than this share of their power in lines: its own lines follow from these."""


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
    whole = [_centred(record) for record in records]
    scaling = channel_scaling(whole)
    found = _beside_blows([scaled_record(record, scaling) for record in whole])
    return _taken_off(whole, scaling.output_scale, found, records, "blows")


def lines_beside_forces(records: Sequence[Record], trials: FreedTrials) -> MachineLines:
    """Find the sinusoids that stand in driven records whatever the forces do, and take them off.

    Args:
        records: about their means.
        trials: of them.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force, noise = rng.standard_normal((2, 4000))
        >>> answer = np.convolve(force, 0.9 ** np.arange(100) * np.cos(0.3 * np.arange(100)))[:4000]
        >>> hum = 0.05 * np.sin(2 * np.pi * 7.3 * 0.01 * np.arange(4000))
        >>> record = Record(force, answer + hum + 0.01 * noise, 0.01)
        >>> lines_beside_forces([record], FreedTrials.of([record])).frequencies.round(2)
        array([7.3])
    """
    whole = [replace(own, outputs=own.outputs * trials.size) for own in trials.records]
    return _taken_off(whole, trials.size, _beside_forces(trials), records, "forces")


def _taken_off(
    whole: Sequence[Record], scale: FloatArray, found: Sequence[Sequence[_Line]], records: Sequence[Record], what: str
) -> MachineLines:
    """Records less the lines that were found in the same about their middle, in units of these scales."""
    if not any(found):
        return MachineLines(records=tuple(records), frequencies=np.empty(0))
    freed, shares = [], []
    for came, centred, lines in zip(records, whole, found, strict=True):
        hum = scale * _sinusoids(came.n_samples, lines)
        freed.append(replace(came, outputs=came.outputs - hum))
        shares.append(share_taken(centred, centred.outputs - hum))
    return lines_taken_off(
        records,
        freed,
        [line.cycles / one.dt for one, own in zip(records, found, strict=True) for line in own],
        max(shares),
        f"each keeps its size and its phase in {N_PARTS} parts of a record, whatever the {what} do",
    )


def _centred(record: Record) -> Record:
    """About the median of each output, without gaps."""
    (whole,) = filled([record])
    return replace(whole, outputs=whole.outputs - np.median(whole.outputs, axis=0))


def _beside_blows(records: Sequence[Record]) -> list[list[_Line]]:
    """The lines of each scaled record that was struck."""
    free = [runs_of(np.asarray(~widened(acting).any(axis=1))) for acting in acting_rows(records)]
    outputs = [_Left(values=record.outputs, free=own) for record, own in zip(records, free, strict=True)]
    at_once = _in_any([()] * len(records), outputs, APART)
    found = likely = at_once
    ahead = observer_order(records)  # else it would not see a blow in the first rows
    for _ in range(MOST_ROUNDS):
        model = quick_model([after_rest(record, ahead) for record in _less(records, likely)])
        if model is None:
            break
        run = _after_runs(outputs, model, records)
        rung = [_rung(own, model.form.poles, lines) for own, lines in zip(outputs, likely, strict=True)]
        found = _in_any(at_once, rung, APART)
        before, likely = likely, _in_any(_in_any(at_once, rung, MOST_APART), run, MOST_APART)
        if _settled(records, before, likely):
            break
    return found


def _beside_forces(trials: FreedTrials) -> list[list[_Line]]:
    """The lines of each record that forces drive."""
    records = trials.records
    found: list[list[_Line]] = [[] for _ in records]
    if max(_share_in_lines(record.inputs) for record in records) > TONES:
        return found
    outputs = [_Left(values=record.outputs, free=()) for record in records]
    likely = found
    for n_rounds in range(1, MOST_ROUNDS + 1):
        model = quick_model(_less(records, likely)) if any(likely) else trials.model(0, 0)
        if model is None:
            break
        run = [_bridged(left, lines) for left, lines in zip(_after_runs(outputs, model, records), likely, strict=True)]
        before, likely = likely, _in_any([()] * len(records), run, MOST_APART)
        found = [
            _borne_out(_rung_on(left, model.form.poles, lines), record.inputs, lines)
            for record, left, lines in zip(records, run, likely, strict=True)
        ]
        if _settled(records, before, likely) or (n_rounds >= FEWEST_ROUNDS and not any(found)):
            break
    return found


def _share_in_lines(values: FloatArray) -> float:
    bins, power = line_bins(values)
    return float((bins * power).sum(axis=0).max())


def _less(records: Sequence[Record], lines: Sequence[Sequence[_Line]]) -> list[Record]:
    return [
        replace(record, outputs=record.outputs - _sinusoids(record.n_samples, own))
        for record, own in zip(records, lines, strict=True)
    ]


def _after_runs(outputs: Sequence[_Left], model: QuickModel, records: Sequence[Record]) -> list[_Left]:
    """What the model leaves of the outputs, which runs from rest."""
    return [
        replace(own, values=own.values - run_from_rest(model.form, record.inputs))
        for own, record in zip(outputs, records, strict=True)
    ]


def _bridged(left: _Left, lines: Sequence[_Line]) -> _Left:
    """With what the lines do where a sample is missing: what is known of them so far, the more with each turn."""
    there = np.isfinite(left.values)
    return left if there.all() else replace(left, values=np.where(there, left.values, _sinusoids(len(there), lines)))


def _settled(records: Sequence[Record], before: Sequence[Sequence[_Line]], now: Sequence[Sequence[_Line]]) -> bool:
    return all(
        np.abs(_sinusoids(record.n_samples, new) - _sinusoids(record.n_samples, old)).max() < SETTLED
        for record, new, old in zip(records, now, before, strict=True)
    )


def _borne_out(rung: _Left, inputs: FloatArray, lines: Sequence[_Line]) -> list[_Line]:
    """Those that hold once the others are off, and that no input may have: what one has, a model may have missed."""
    held = list[_Line]()
    for line in lines:
        others = [other for other in lines if other is not line]
        own = _line_near(rung.without(others), line.cycles, line.apart, apart=MOST_APART)
        if own is not None and not _stands_in(inputs, line.cycles):
            held.append(own)
    return held


def _stands_in(inputs: FloatArray, cycles: float) -> bool:
    """Whether an input stands out at a frequency with the same size and phase in most parts."""
    sizes, noise = _parts(inputs, cycles, len(inputs) // N_PARTS)
    size, weights = _robust_mean(sizes, noise)
    return bool((np.square(np.abs(size)) * weights.sum(axis=0)).max() > STANDS_OUT)


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


def _rung_on(left: _Left, poles: ComplexArray, lines: Sequence[_Line]) -> _Left:
    """What is left but for what modes on the lines may do, ringing on through the record, as in `_rung`."""
    n_rows = len(left.values)
    near = np.abs(np.angle(poles)[:, np.newaxis] / (2.0 * np.pi) - [line.cycles for line in lines]) * n_rows < MAIN_LOBE
    own = poles[near.any(axis=1)]
    time = np.arange(n_rows)[:, np.newaxis]
    decays = np.hstack([own**time, own**time * (time / n_rows)])
    basis = np.linalg.qr(np.hstack([decays.real, decays.imag]))[0]
    return replace(left, values=left.values - basis @ (basis.T @ left.values))


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
    """The sinusoid as near to a peak [cycles a row] if it keeps its size and phase, as so many free stretches tell."""
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
    return line if not left.free or _told_by(left, line, apart) >= told_by else None


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
    offsets, waves = _neighbours(n_rows)
    rows = np.arange(N_PARTS * n_rows)
    slowed = values[: rows.size] * np.exp(-2j * np.pi * cycles * rows)[:, np.newaxis]
    within = waves[(cycles + offsets > 0.0) & (cycles + offsets < 0.5)]
    spectra = within @ slowed.reshape(N_PARTS, n_rows, -1)
    noise = np.square(np.abs(spectra[:, 1:])).mean(axis=1)
    return spectra[:, 0], np.maximum(noise, TINY)


@functools.lru_cache(maxsize=2)
def _neighbours(n_rows: int) -> tuple[FloatArray, ComplexArray]:
    """(n_frequencies,) distances from a line [cycles a row], it first; (n_frequencies, n_rows) what measures each."""
    window = blackman_harris(n_rows)
    beside = np.arange(MAIN_LOBE + 1, MAIN_LOBE + 1 + BESIDE_LINE)
    offsets = np.concatenate([[0], beside, -beside]) / n_rows
    waves = np.exp(-2j * np.pi * np.outer(offsets, np.arange(n_rows))) * (2.0 * window / window.sum())
    return offsets, waves


def _robust_mean(sizes: ComplexArray, noise: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """(n_outputs,) mean over the parts, weighed by their noise and by how far each is from the mean; the weights."""
    mean = np.median(sizes.real, axis=0) + 1j * np.median(sizes.imag, axis=0)
    weights = 1.0 / noise
    for _ in range(5):
        weights = 1.0 / (noise + np.square(np.abs(sizes - mean)))
        mean = (weights * sizes).sum(axis=0) / weights.sum(axis=0)
    return mean, weights
