"""The level of white noise on an output, from the part of its spectrum that the response leaves quiet.

In a window of neighbouring frequencies the spectrum of an output is, with the spectra U of the inputs,

    Y(k) = sum over inputs of G_j(k) U_j(k) + T(k) + E(k)

where the response function G and the transient T (initial state, and the ends of a record that is no whole number of
periods) are smooth, hence low-order polynomials of k: linear least squares. What is left over, per degree of freedom,
is noise and distortion. Noise is flat; the distortion of a nonlinear response piles up around its resonances and their
harmonics. So the level is that of the quietest stretch of windows, as long a stretch as the data allow.

The quietest of many is too quiet by chance. Therefore the stretch is chosen on every second window and its level taken
from the others, and the other way round: what was chosen has no part in what is measured.

How sure the level is depends on where the stretch lies. The force of a rubbing or an impact jumps, and the spectrum of
samples with jumps falls off no faster than 1 / (4 sin^2(w / 2)), w in radians a sample. Over a long stretch that shape
and a flat one cannot be mistaken for each other; over the last tenth of the band they look the same. The standard error
is that of the flat part when such a tail is allowed for.

Noise is the same at all times; impacts and reversals of friction fill the quiet band in bursts. The residual of the
upper half of the spectrum, back in time, has an envelope: of steady Gaussian noise its square is exponentially
distributed. Bursts stand out of that. The level of what lies between them is the mean below a limit, the
limit being a multiple of the level itself: m = 1 - t / (exp(t) - 1) is the mean of an exponential variable below t.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from modal.localisation.lines import FALSE_ALARM
from modal.simulation import SURE
from okid.arrays import ROUNDED, BoolArray, ComplexArray, FloatArray

_DEGREE = 2
"""Fit polynomials of this degree in a window."""
_LINES_A_COLUMN = 5
"""Widen a window to so many frequencies for each of its unknowns: fewer waste data, more ask for smoother response
functions."""
_FEWEST_LINES = 16
"""Make no window narrower than so many lines."""
_MOST_BLOCKS = 120
"""Begin and end stretches at the edges of at most so many blocks; the stretches grow with their square."""
_CAUTION = 5.0
"""Add so many standard errors to a level before it is called the smallest: with fewer a short stretch wins by
chance."""
_SMALLEST_SHARE = 0.2
"""Take no stretch below this share of the spectrum: the gap between two resonances is quiet too, but no place to
measure."""
_LOWEST_TAIL = 0.1
"""Follow no tail below so many cycles a sample: resonances stand there."""
UNKNOWN = 3.0
"""Give a floor that is no better than a guess this relative error."""
_FEWEST_ABOVE = 8
"""Ask for so many windows above a stretch to see a spectrum rise."""
_UNDRIVEN = 1.2
"""Call what is above a band undriven up to this ratio of its level with the response to the inputs to that without."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResidualSpectrum:
    """What smooth response functions and a smooth transient leave of each output's spectrum.

    Attributes:
        n_samples: of the record.
        first: number of the first line of the first window; line k is at k / n_samples cycles a sample.
        edges: (n_windows + 1,) in cycles a sample, rising.
        left: (n_windows, n_lines, n_outputs) residual, white noise of variance s^2 having E |left|^2 = s^2 before what
            is fitted takes its share.
        level: (n_windows, n_outputs) variance of a white noise of this density [unit^2].
        level_undriven: the same with the transient alone taken out, the response to the inputs left in.
        freedom: complex degrees of freedom of each window's level.
        transient_freedom: unknowns of the transient in a window.
    """

    n_samples: int
    first: int
    edges: FloatArray
    left: ComplexArray
    level: FloatArray
    level_undriven: FloatArray
    freedom: int
    transient_freedom: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QuietBand:
    """The quietest stretch of one output's spectrum.

    Attributes:
        variance: of the white noise [unit^2].
        standard_error: relative, a tail of distortion in the stretch allowed for; at most 3.
        low: end of the band, in cycles a sample.
        high: likewise.
        freedom: complex degrees of freedom behind the variance.
        driven_share: share of the level in the middle window of the band that the inputs explain.
        rise: variance of a noise that has this level up to the band and what the spectrum shows above it, over
            `variance`: more than 1 where the spectrum rises to half the sampling frequency though no input drives it.
    """

    variance: float
    standard_error: float
    low: float
    high: float
    freedom: float
    driven_share: float
    rise: float


def residual_spectrum(inputs: FloatArray, outputs: FloatArray) -> ResidualSpectrum | None:
    """Levels of the residual in windows of neighbouring frequencies; None where there are too few samples for two.

    Args:
        inputs: (n_samples, n_inputs) without gaps; n_inputs may be 0.
        outputs: (n_samples, n_outputs) without gaps.

    References:
        Pintelon, Schoukens, Vandersteen, Barbe, "Estimation of nonparametric noise and FRF models for multivariable
        systems, part I: theory", Mechanical Systems and Signal Processing 24(3), 2010, 573-595, doi
        10.1016/j.ymssp.2009.08.009.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> u = rng.standard_normal((2000, 1))
        >>> spectrum = residual_spectrum(u, 5.0 * u + 0.1 * rng.standard_normal((2000, 1)))
        >>> print(f"{spectrum.level.mean():.3f}")
        0.010
    """
    n_samples, n_inputs = inputs.shape
    last = (n_samples - 1) // 2  # the line at half the sampling frequency is real, and left out
    degree, width = _window(last, n_inputs)
    n_windows = last // width
    if n_windows < 2:
        return None
    first = last - n_windows * width + 1
    given, answer = (
        (np.fft.rfft(part - part.mean(axis=0), axis=0)[first : last + 1] / np.sqrt(n_samples)).reshape(
            n_windows, width, part.shape[1]
        )
        for part in (inputs, outputs)
    )
    powers = np.linspace(-1.0, 1.0, width)[:, np.newaxis] ** np.arange(degree + 1)
    n_powers = degree + 1
    driven = (given[:, :, :, np.newaxis] * powers[:, np.newaxis, :]).reshape(n_windows, width, n_inputs * n_powers)
    size = np.linalg.norm(driven, axis=1, keepdims=True)
    columns = np.empty((n_windows, width, n_powers * (1 + n_inputs)), dtype=np.complex128)
    columns[:, :, :n_powers] = powers
    columns[:, :, n_powers:] = driven / np.where(size > 0.0, size, 1.0)
    # Q has orthonormal columns even where an input has nothing in a window: its freedom is spent, no bias is made
    basis = np.linalg.qr(columns)[0]
    along = basis.conj().transpose(0, 2, 1) @ answer
    left = answer - basis @ along
    by_inputs = (np.abs(along[:, n_powers:]) ** 2).sum(axis=1)
    freedom, energy = width - columns.shape[2], (np.abs(left) ** 2).sum(axis=1)
    return ResidualSpectrum(
        n_samples=n_samples,
        first=first,
        edges=(first - 0.5 + width * np.arange(n_windows + 1)) / n_samples,
        left=left,
        level=energy / freedom,
        level_undriven=(energy + by_inputs) / (width - n_powers),
        freedom=freedom,
        transient_freedom=n_powers,
    )


def quiet_band(spectrum: ResidualSpectrum, output: int) -> QuietBand:
    """The quietest stretch of windows: the one with the smallest upper limit of its level.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> y = np.sin(0.2 * np.arange(4000)) ** 3 + 0.1 * rng.standard_normal(4000)
        >>> band = quiet_band(residual_spectrum(np.empty((4000, 0)), y[:, np.newaxis]), 0)
        >>> print(f"{band.variance:.3f}, sure to {100 * band.standard_error:.0f} %")
        0.010, sure to 5 %
    """
    level = spectrum.level[:, output]
    n_windows = level.size
    n_blocks = int(np.clip(n_windows // 2, 1, _MOST_BLOCKS))
    block = (np.arange(n_windows) * n_blocks) // n_windows
    half = np.arange(n_windows) % 2 == 0
    everything, measured = np.zeros(n_windows, dtype=np.bool_), np.zeros(n_windows)
    for choosing in (half, ~half):
        first, last = _quietest(level, block, choosing, spectrum.freedom)
        inside = (block >= first) & (block <= last)
        kept = inside & _ordinary(level, inside, spectrum.freedom)
        everything |= kept
        measured += kept & ~choosing if (kept & ~choosing).any() else kept
    where = np.flatnonzero(everything)
    mean = float(level @ measured / measured.sum())
    undriven = float(np.median(spectrum.level_undriven[everything, output]))
    return QuietBand(
        variance=mean,
        standard_error=_standard_error(spectrum, measured),
        low=float(spectrum.edges[where[0]]),
        high=float(spectrum.edges[where[-1] + 1]),
        freedom=float(measured.sum()) * spectrum.freedom,
        driven_share=max(0.0, 1.0 - float(np.median(level[everything])) / undriven) if undriven > 0.0 else 0.0,
        rise=_rise(spectrum, output, mean, int(where[-1]) + 1),
    )


def _window(n_lines: int, n_inputs: int) -> tuple[int, int]:
    """Degree of the polynomials and lines of a window: a lower degree where the record is short."""
    degree = _DEGREE
    while True:
        width = max(_FEWEST_LINES, _LINES_A_COLUMN * (degree + 1) * (1 + n_inputs))
        if degree == 0 or n_lines >= 6 * width:
            return degree, width
        degree -= 1


def _quietest(level: FloatArray, block: np.ndarray, choosing: BoolArray, freedom: int) -> tuple[int, int]:
    """First and last block of the stretch whose level plus its caution is smallest, on the choosing windows."""
    n_blocks = int(block[-1]) + 1
    total = np.concatenate([[0.0], np.cumsum(np.bincount(block, level * choosing, minlength=n_blocks))])
    count = np.concatenate([[0.0], np.cumsum(np.bincount(block, choosing, minlength=n_blocks))])
    sums, counts = (part[np.newaxis, :] - part[:, np.newaxis] for part in (total, count))
    with np.errstate(invalid="ignore", divide="ignore"):
        bound = sums / counts * (1.0 + _CAUTION / np.sqrt(counts * freedom))
    bound[~(counts >= max(1.0, _SMALLEST_SHARE * count[-1]))] = np.inf
    first, stop = np.unravel_index(int(np.argmin(bound)), bound.shape)
    return int(first), int(stop) - 1


def _ordinary(level: FloatArray, inside: BoolArray, freedom: int) -> BoolArray:
    """False for windows that hold a line: far above the middle of their stretch."""
    middle = float(np.median(level[inside]))
    limit = scipy.special.gammainccinv(freedom, FALSE_ALARM) / scipy.special.gammainccinv(freedom, 0.5)
    ordinary: BoolArray = level <= limit * middle
    return ordinary


def _rise(spectrum: ResidualSpectrum, output: int, mean: float, after: int) -> float:
    """Variance with what lies above the band over that without; 1 where that need not be noise.

    Distortion falls with frequency; what rises to the end is the noise of a differentiated or a sampled-down signal.
    """
    above, undriven = spectrum.level[after:, output], spectrum.level_undriven[after:, output]
    if above.size < _FEWEST_ABOVE or mean <= 0.0:
        return 1.0
    quarter = above.size // 4
    rises = above[-quarter:].mean() >= above[:-quarter].mean() > mean
    if not rises or undriven.mean() > _UNDRIVEN * above.mean():
        return 1.0
    return float((mean * after + above.sum()) / (mean * spectrum.level.shape[0]))


def _standard_error(spectrum: ResidualSpectrum, weight: FloatArray) -> float:
    """Of the flat part of flat + tail, from windows of these weights; gamma distributed levels near flat."""
    middle = np.maximum(0.5 * (spectrum.edges[1:] + spectrum.edges[:-1]), _LOWEST_TAIL)
    tail = 1.0 / (4.0 * np.sin(np.pi * middle) ** 2)
    own, cross, square = weight.sum(), weight @ tail, weight @ tail**2
    known = own * square - cross**2
    if known <= ROUNDED * own * square:
        return UNKNOWN
    return float(min(UNKNOWN, np.sqrt(square / known / spectrum.freedom)))


_LIMIT = 3.0
"""Cut bursts off at this multiple of the level: 5 % of steady noise lies above."""
_FROM, _FULL = 0.25, 0.35
"""Begin the taper at the first, in cycles a sample, and end it at the second: sharp edges would smear bursts over
time."""
_SPREAD = 0.82
"""Expect this standard deviation of clipped over plain level of steady noise, times the root of the independent
envelope values."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SteadyLevel:
    """Level of the upper half of the spectrum with and without bursts.

    Attributes:
        variance: of the white noise between the bursts [unit^2].
        ratio: that over the level of all samples.
        bursts: whether the ratio is too small for steady noise.
        share: of the samples that lie below the limit.
    """

    variance: float
    ratio: float
    bursts: bool
    share: float


def steady_level(spectrum: ResidualSpectrum, output: int) -> SteadyLevel | None:
    """Level of the noise between bursts; None where the record is too short to tell.

    Example:
        >>> from modal.discrepancy.noise.quiet_band import residual_spectrum
        >>> rng = np.random.default_rng(0)
        >>> y = 0.1 * rng.standard_normal((4000, 1))
        >>> y[::40] += rng.standard_normal((100, 1))  # hits
        >>> level = steady_level(residual_spectrum(np.empty((4000, 0)), y), 0)
        >>> print(f"{y.var():.3f} {level.variance:.3f} {level.bursts}")
        0.035 0.013 True
    """
    n_windows, width, _ = spectrum.left.shape
    n_samples = spectrum.n_samples
    lines = spectrum.first + np.arange(n_windows * width)
    rise = np.clip((lines / n_samples - _FROM) / (_FULL - _FROM), 0.0, 1.0)
    taper = np.sin(0.5 * np.pi * rise)
    weight = float((taper**2).sum())
    half_spectrum = np.zeros(n_samples, dtype=np.complex128)
    half_spectrum[lines] = spectrum.left[:, :, output].ravel() * taper
    power = np.abs(np.fft.ifft(half_spectrum)) ** 2 * (n_samples**2 / weight)
    # what was fitted as a transient has gone from both ends of the record, and from nowhere else
    end = int(np.ceil(n_samples * spectrum.transient_freedom / width))
    independent = weight * (1.0 - 2.0 * end / n_samples)
    if independent < 20.0:
        return None
    power = power[end : n_samples - end] * (width - spectrum.transient_freedom) / spectrum.freedom
    plain = float(power.mean())
    level = _between_bursts(power)
    ratio = level / plain if plain > 0.0 else 1.0
    return SteadyLevel(
        variance=level,
        ratio=ratio,
        bursts=ratio < 1.0 - SURE * _SPREAD / np.sqrt(independent),
        share=float((power < _LIMIT * level).mean()),
    )


def _between_bursts(power: FloatArray) -> float:
    """Level at which the mean below the limit is that of an exponential variable cut there."""
    cut_mean = 1.0 - _LIMIT / np.expm1(_LIMIT)
    rising = np.sort(power)
    means = np.cumsum(rising) / np.arange(1, rising.size + 1)
    level = float(np.median(power)) / np.log(2.0)
    for _ in range(100):
        count = int(np.searchsorted(rising, _LIMIT * level))
        if count == 0:
            break
        new = float(means[count - 1]) / cut_mean
        done = abs(new - level) <= 1e-6 * level
        level = new
        if done:
            break
    return level
