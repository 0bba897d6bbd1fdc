"""The noise of the outputs of one record from its spectrum: gaps bridged, quiet band found, bursts set aside.

A missing sample gets the value that the samples beside it foretell: the regression of a sample of this output on its
neighbours before and after and on the inputs at the same times, learnt from the rows where all of them are there. That
brings hardly any noise to high frequencies: there the level of the noise falls by the share of bridged samples.

Noise of another colour than white is made white by a short autoregression (`whitening_filter`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from modal.discrepancy.noise.quiet_band import (
    UNKNOWN,
    QuietBand,
    SteadyLevel,
    quiet_band,
    residual_spectrum,
    steady_level,
)
from modal.simulation.scheme import Scheme
from okid.arrays import ROUNDED, TINY, BoolArray, FloatArray
from okid.record import Record
from okid.residuals import WHITENESS_LAGS
from okid.rows import runs_of

_LONGEST_GAP = 6
"""Bridge no gap of more samples than this."""
_REACHES = (6, 4, 3, 2)
"""Foretell from so many neighbours on either side: fewer where missing samples leave too few whole rows to learn
from."""
_FEWEST_WHOLE_ROWS = 4
"""Learn from no fewer whole rows for each neighbour and input."""


def bridgeable_runs(there: BoolArray) -> list[tuple[int, int]]:
    """(start, stop) of stretches that begin and end with a sample and hold no gap longer than 6 samples.

    Args:
        there: (n_samples,) False where a sample is missing.

    Example:
        >>> there = np.ones(20, dtype=bool)
        >>> there[[0, 5, 6]] = False
        >>> there[10:18] = False
        >>> bridgeable_runs(there)
        [(1, 10), (18, 20)]
    """
    runs: list[tuple[int, int]] = []
    for start, stop in runs_of(there):
        if runs and start - runs[-1][1] <= _LONGEST_GAP:
            runs[-1] = (runs[-1][0], stop)
        else:
            runs.append((start, stop))
    return runs


def bridged(values: FloatArray, inputs: FloatArray) -> FloatArray:
    """The values with what is missing foretold from the samples and inputs beside it.

    Args:
        values: (n_samples,) of one output, NaN where missing.
        inputs: (n_samples, n_inputs) without gaps.

    Example:
        >>> wave = np.sin(0.2 * np.arange(400.0))
        >>> holed = wave.copy()
        >>> holed[50::37] = np.nan
        >>> bool(np.abs(bridged(holed, np.empty((400, 0))) - wave).max() < 1e-3)
        True
    """
    missing = np.flatnonzero(np.isnan(values))
    if missing.size == 0:
        return values
    there = ~np.isnan(values)
    straight = np.interp(np.arange(values.size), np.flatnonzero(there), values[there])
    centre, scale = float(straight.mean()), float(straight.std()) or 1.0
    spread = inputs.std(axis=0)
    channels = np.empty((values.size, 1 + inputs.shape[1]))
    channels[:, 0] = (values - centre) / scale
    channels[:, 1:] = (inputs - inputs.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    for reach in _REACHES:
        rows = _neighbourhoods(channels, reach)
        whole = rows[~np.isnan(rows).any(axis=1)]
        if len(whole) >= _FEWEST_WHOLE_ROWS * rows.shape[1]:
            filled = np.array(straight)
            filled[missing] = centre + scale * _foretold(rows[missing], whole, reach)
            return filled
    return straight


def _neighbourhoods(channels: FloatArray, reach: int) -> FloatArray:
    """(n_samples, n_channels (2 reach + 1)) every channel from `reach` samples before to `reach` after, NaN outside."""
    padded = np.full((len(channels) + 2 * reach, channels.shape[1]), np.nan)
    padded[reach : len(padded) - reach] = channels
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    return windows.reshape(len(channels), -1)


def _foretold(rows: FloatArray, whole: FloatArray, centre: int) -> FloatArray:
    """The centre of each row from what is known of it, by the second moments of whole rows."""
    gram = whole.T @ whole
    gram[np.diag_indices_from(gram)] += ROUNDED * np.trace(gram) / len(gram)
    known = ~np.isnan(rows)
    result = np.zeros(len(rows))
    for pattern in np.unique(known, axis=0):
        same = (known == pattern).all(axis=1)
        beside = np.flatnonzero(pattern)
        if beside.size:
            weight = np.linalg.solve(gram[np.ix_(beside, beside)], gram[beside, centre])
            result[same] = rows[np.ix_(same, beside)] @ weight
    return result


FEWEST_ROWS = 64
"""Take no spectrum, and no scatter, of fewer samples than this."""
_MOST_BRIDGED = 0.3
"""Take whole rows only where more than this share of the samples would be bridged."""
_BURSTS_ERROR = 0.5
"""Give a level among bursts at least this relative error: how much of them lies below the limit is not known."""
_ROUNDED = 0.1
"""Look for no bursts where quantisation is more than this share of the level: it makes its own."""
_REGULAR = 0.05
"""Call an output quantised where all steps lie this near to multiples of the smallest."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SpectralFloor:
    """Noise of the outputs of one record.

    Attributes:
        variance: (n_outputs,) [unit^2].
        standard_error: (n_outputs,) relative.
        driven_share: (n_outputs,) share of the level in the band that the inputs explain.
        notes: one an output: band and certainty in words.
    """

    variance: FloatArray
    standard_error: FloatArray
    driven_share: FloatArray
    notes: tuple[str, ...]

    def words(self, record: Record, which: BoolArray | None = None) -> str:
        """What was found, output by output.

        Args:
            record: that it belongs to.
            which: (n_outputs,) True for outputs to be named; None names all.
        """
        chosen = range(record.n_outputs) if which is None else np.flatnonzero(which).tolist()
        return "; ".join(f"{record.output_names[i]!r} {self.notes[i]}" for i in chosen)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Level:
    """Of one output."""

    variance: float
    standard_error: float
    driven_share: float
    note: str


def spectral_floor(record: Record, outputs: FloatArray | None = None) -> SpectralFloor:
    """Noise of each output from the quiet part of its spectrum, at least that of its quantisation.

    Args:
        record: its inputs drive the outputs.
        outputs: (n_samples, n_outputs) in the place of the record's, such as a model's residual; quantisation is still
            that of the record's.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> decay = np.exp(-0.002 * np.arange(2000)) * np.sin(0.2 * np.arange(2000))
        >>> floor = spectral_floor(Record([], decay + 0.1 * rng.standard_normal(2000), 0.01))
        >>> print(f"{floor.variance[0]:.3f}")
        0.010
    """
    values = record.outputs if outputs is None else outputs
    moving = np.ptp(np.where(np.isnan(record.inputs), 0.0, record.inputs), axis=0) > 0.0
    inputs = record.inputs[:, moving]
    whole: BoolArray = ~np.asarray(np.isnan(inputs).any(axis=1))
    least = smallest_variance(record)
    if whole.all() and not np.isnan(values).any():
        levels = _levels(inputs, values, record.dt, 0.0, least)
    else:
        levels = [_with_gaps(inputs, values[:, i], whole, record.dt, least[i : i + 1]) for i in range(record.n_outputs)]
    notes = [
        f"is no noisier than its quantisation (variance {floor:.3g})" if level.variance <= floor else level.note
        for level, floor in zip(levels, least, strict=True)
    ]
    return SpectralFloor(
        variance=np.maximum([level.variance for level in levels], least),
        standard_error=np.array([level.standard_error for level in levels]),
        driven_share=np.array([level.driven_share for level in levels]),
        notes=tuple(notes),
    )


def smallest_variance(record: Record) -> FloatArray:
    """(n_outputs,) variance of rounding each output to the step of its values, or to double precision.

    Example:
        >>> record = Record([], 0.5 * np.round(4 * np.sin(np.arange(100.0))), 0.1)
        >>> print(f"{smallest_variance(record)[0]:.4f}")  # 0.5^2 / 12
        0.0208
    """
    return np.array([_rounding(record.outputs[:, i]) for i in range(record.n_outputs)])


def _rounding(values: FloatArray) -> float:
    levels = np.unique(values[~np.isnan(values)])
    double = float((np.finfo(np.float64).eps * np.abs(levels).max()) ** 2)
    if levels.size < 2:
        return double
    gaps = np.diff(levels)
    steps = gaps / gaps.min()
    regular = np.abs(steps - np.round(steps)).max() < _REGULAR
    return max(double, float(gaps.min()) ** 2 / 12.0) if regular else double


def _with_gaps(inputs: FloatArray, values: FloatArray, whole: BoolArray, dt: float, least: FloatArray) -> _Level:
    """The longest stretch that can be bridged; where most of it is missing, the longest that is whole."""
    there = ~np.isnan(values)
    stride = _stride(there)
    if stride > 1 and whole.all():
        # the response to what the inputs did since the last sample: every one of those rows is an input of its own
        kept = np.flatnonzero(there)[1:]
        since = np.concatenate([inputs[kept - lag] for lag in range(stride)], axis=1)
        return _levels(since, values[kept, np.newaxis], stride * dt, 0.0, least)[0]
    runs = [
        (start + first, start + last)
        for start, stop in runs_of(whole)
        for first, last in bridgeable_runs(there[start:stop])
    ]
    start, stop = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
    missing = 1.0 - float(there[start:stop].mean()) if stop > start else 1.0
    if missing > _MOST_BRIDGED:
        start, stop = max(runs_of(there & whole), key=lambda run: run[1] - run[0], default=(0, 0))
        missing = 0.0
    if stop - start < FEWEST_ROWS:
        return _guess(values)
    filled = bridged(values[start:stop], inputs[start:stop])
    return _levels(inputs[start:stop], filled[:, np.newaxis], dt, missing, least)[0]


def _stride(there: BoolArray) -> int:
    """Rows from one sample to the next where that is always the same, else 1: a slower channel among faster ones."""
    steps = np.diff(np.flatnonzero(there))
    return int(steps[0]) if steps.size and (steps == steps[0]).all() else 1


def _levels(inputs: FloatArray, outputs: FloatArray, dt: float, missing: float, least: FloatArray) -> list[_Level]:
    spectrum = residual_spectrum(inputs, outputs) if len(outputs) >= FEWEST_ROWS else None
    if spectrum is None:
        return [_guess(column) for column in outputs.T]
    levels = []
    for i in range(outputs.shape[1]):
        band = quiet_band(spectrum, i)
        # rounding comes in bursts too, where the signal crosses from step to step
        steady = steady_level(spectrum, i) if least[i] < _ROUNDED * band.variance else None
        levels.append(_level(band, steady, dt, missing))
    return levels


def _level(band: QuietBand, steady: SteadyLevel | None, dt: float, missing: float) -> _Level:
    variance, error = band.variance * band.rise, max(band.standard_error, band.rise - 1.0)
    how = ", rising above it" if band.rise > 1.0 else ""
    if steady is not None and steady.bursts:
        lower = min(variance, steady.variance)
        error = max(error, _BURSTS_ERROR, variance / lower - 1.0 if lower > 0.0 else UNKNOWN)
        variance, how = lower, ", in the pauses of bursts (impacts, rubbing) that reach into it"
    # bridged samples hold no noise at high frequencies
    variance, error = variance / (1.0 - missing), min(UNKNOWN, float(np.hypot(error, 0.5 * missing)))
    bridges = f", {100 * missing:.2g} % of the samples bridged" if missing else ""
    doubt = "; the band is too narrow to tell noise from distortion" if error > _BURSTS_ERROR and not how else ""
    return _Level(
        variance=variance,
        standard_error=error,
        driven_share=band.driven_share,
        note=f"by its level from {band.low / dt:.4g} to {band.high / dt:.4g} Hz{how}"
        f"{bridges}, known to {50 * error:.2g} %{doubt}",  # root mean square: half of the error of a variance
    )


def _guess(values: FloatArray) -> _Level:
    """From differences of what is there, gaps or not, over those of white noise; too much rather than too little."""
    there = values[~np.isnan(values)]
    order = min(4, there.size - 1)
    # the sum of squares of the coefficients of a difference of order n is the binomial coefficient (2n, n)
    differences = np.diff(there, order)
    return _Level(
        variance=float(np.mean(differences**2) / scipy.special.binom(2 * order, order)) if order else 0.0,
        standard_error=UNKNOWN,
        driven_share=0.0,
        note="by differences of its samples, since too few follow each other: a guess, rather an upper limit",
    )


MOST_ORDER = 4
"""Filter the residual by an autoregression of at most this order: more would take up the lack of fit itself."""


def filter_by(taps: FloatArray, values: FloatArray) -> FloatArray:
    """Sum over j of taps[j] times the values j samples ago, along the last axis."""
    filtered: FloatArray = taps[0] * values
    for lag, tap in enumerate(taps[1:], start=1):
        filtered[..., lag:] += tap * values[..., :-lag]
    return filtered


def whitening_filter(residual: FloatArray, present: BoolArray) -> tuple[FloatArray, BoolArray]:
    """The autoregression of least BIC that makes a residual white, over its deviation; and the rows that it reaches."""
    n = len(residual)
    lagged = np.zeros((MOST_ORDER + 1, n))
    reach = np.zeros((MOST_ORDER + 1, n), dtype=bool)
    for lag in range(min(MOST_ORDER + 1, n)):
        lagged[lag, lag:], reach[lag, lag:] = residual[: n - lag], present[: n - lag]
    whole = reach.all(axis=0)
    best, taps, order = np.inf, np.array([1.0]), 0
    if 2 * whole.sum() >= present.sum() > 0 and whole.sum() > WHITENESS_LAGS:
        for p in range(MOST_ORDER + 1):
            weights = np.linalg.lstsq(lagged[1 : p + 1, whole].T, lagged[0, whole], rcond=None)[0]
            error = lagged[0, whole] - weights @ lagged[1 : p + 1, whole]
            score = whole.sum() * np.log(max(float(np.mean(error**2)), TINY)) + p * np.log(whole.sum())
            if score < best:
                best, taps, order = score, np.concatenate([[1.0], -weights]), p
    valid: BoolArray = np.all(reach[: order + 1], axis=0)
    white = filter_by(taps, residual)[valid]
    deviation = float(np.sqrt(np.mean(white**2))) if white.size else 1.0
    return taps / max(deviation, TINY), valid


def replies(scheme: Scheme, n: int, step: int) -> FloatArray:
    """(n_lines, n_outputs, n_forces + n_inputs) squared gains of n samples, `step` steps of the scheme each."""
    z = _waves(n)[:, :, np.newaxis] ** (1.0 / step)
    pushes = np.hstack([scheme.E0, scheme.B0]) + z * np.hstack([scheme.E1, scheme.B1])
    moved = np.linalg.solve(z * np.eye(len(scheme.Ad)) - scheme.Ad, pushes)
    return np.asarray(np.abs(scheme.C @ moved + np.hstack([scheme.G, scheme.D])) ** 2)


def most_heard(scheme: Scheme, n: int, step: int) -> FloatArray:
    """(n_lines, n_outputs, n_forces) likewise of forces, held over each step or straight, whichever does more.

    At the highest line a straight one turns its sign within each step: an inertia's speed hears none of it. A held one
    does, of which a displacement hears nothing.
    """
    z = _waves(n)[:, :, np.newaxis] ** (1.0 / step)
    flow = z * np.eye(len(scheme.Ad)) - scheme.Ad
    held = scheme.C @ np.linalg.solve(flow, (scheme.E0 + scheme.E1)[np.newaxis]) + scheme.G
    straight = replies(scheme, n, step)[:, :, : scheme.E0.shape[1]]
    return np.asarray(np.maximum(np.abs(held) ** 2, straight))


def colours_of(taps: Sequence[FloatArray], n: int) -> FloatArray:
    """(n_lines, n_outputs) spectra of autoregressions, whose mean is the variance."""
    waves = _waves(n)
    return np.array([1.0 / np.abs(waves ** -np.arange(len(tap)) @ tap) ** 2 for tap in taps]).T


def _waves(n: int) -> npt.NDArray[np.complex128]:
    """(n_lines, 1) of n samples, but for zero and the last one."""
    return np.asarray(np.exp(2j * np.pi / n * np.arange(1, (n + 1) // 2))[:, np.newaxis])


RINGS = 0.5
"""Call a pole ringing below this share of critical damping: noise of a smooth spectrum has none."""


def lead_of_forces(left: FloatArray, taps: Sequence[FloatArray], scheme: Scheme, step: int) -> FloatArray:
    """(n_places,) by how much BIC prefers a white force there beside white noise to each output's autoregression.

    By Whittle's likelihood of what is left (n_samples, n_outputs), a scheme's steps `step` a sample.
    """
    n = len(left)
    powers = np.abs(np.fft.fft(left, axis=0)[1 : (n + 1) // 2]) ** 2 / n
    heard = replies(scheme, n, step)
    lead = np.zeros(heard.shape[2])
    outputs = zip(powers.T, taps, heard.transpose(1, 0, 2), colours_of(taps, n).T, strict=True)
    for power, tap, reply, smooth in outputs:
        shares = reply / np.maximum(reply.mean(axis=0), TINY)
        spectra = 1.0 + np.logspace(-2.0, 4.0, 25)[:, np.newaxis, np.newaxis] * shares
        spectra *= np.mean(power[:, np.newaxis] / spectra, axis=1, keepdims=True)
        forced = 2.0 * np.sum(np.log(spectra) + power[:, np.newaxis] / spectra, axis=1).min(axis=0)
        own = 2.0 * np.sum(np.log(smooth) + power / smooth)
        lead += own - forced + (len(tap) - 2) * np.log(n)
    return lead


def rings(poles: npt.NDArray[Any]) -> BoolArray:
    """Which discrete poles swing up and down lightly damped."""
    rates = np.log(np.where(poles == 0.0, TINY, poles).astype(complex))
    swinging = (np.abs(rates.imag) > ROUNDED) & (np.abs(rates.imag) < 0.5 * np.pi)
    return np.asarray(swinging & (-rates.real < RINGS * np.abs(rates)))


def log_f_tail(ratio: float, above: float, below: float) -> float:
    """Ln P(F > ratio), by the leading term of the incomplete beta function where that is no number any more."""
    a, b, x = 0.5 * below, 0.5 * above, below / (below + above * ratio)
    tail = float(scipy.special.betainc(a, b, x))
    if tail > TINY:
        return float(np.log(tail))
    return float(a * np.log(x) + b * np.log1p(-x) - np.log(a) - scipy.special.betaln(a, b))


def log_chi_square_tail(value: float, freedom: float) -> float:
    """Ln P(chi-square > value), by its leading term where that is no number any more."""
    tail = float(scipy.special.gammaincc(0.5 * freedom, 0.5 * value))
    if tail > TINY:
        return float(np.log(tail))
    s = 0.5 * freedom
    return float((s - 1.0) * np.log(0.5 * value) - 0.5 * value - scipy.special.gammaln(s))
