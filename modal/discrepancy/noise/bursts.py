"""Noise is the same at all times; impacts and reversals of friction fill the quiet band in bursts.

The residual of the upper half of the spectrum, back in time, has an envelope: of steady Gaussian noise its square is
exponentially distributed. Bursts stand out of that. The level of what lies between them is the mean below a limit, the
limit being a multiple of the level itself: m = 1 - t / (exp(t) - 1) is the mean of an exponential variable below t.
"""

from dataclasses import dataclass

import numpy as np

from modal.discrepancy.noise.quiet_band import ResidualSpectrum
from modal.simulation.tolerances import SURE
from okid.arrays import FloatArray

__all__ = ["SteadyLevel", "steady_level"]

_LIMIT = 3.0
"""Of the level: 5 % of steady noise lies above."""
_FROM, _FULL = 0.25, 0.35
"""Cycles a sample where the taper begins and where it is 1: sharp edges would smear bursts over time."""
_SPREAD = 0.82
"""Standard deviation of clipped over plain level of steady noise, times the root of the independent envelope values."""


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

    Args:
        spectrum: residual spectrum of all outputs.
        output: which of them.

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
