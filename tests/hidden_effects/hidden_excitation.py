"""Inputs that leave the upper part of the band empty, so that the noise can be seen there.

Nothing here imports okid, era or modal.
"""

import numpy as np

__all__ = ["filtered_noise", "multisine", "staircase"]


def multisine(rng, n_samples, *, lowest, highest, n_periods=1):
    """(n_samples,) random phases on every line between two frequencies (in cycles a sample); variance 1."""
    period = n_samples // n_periods
    line = np.arange(period // 2 + 1) / period
    spectrum = np.where((line >= lowest) & (line <= highest), np.exp(2j * np.pi * rng.random(line.size)), 0.0)
    spectrum[0] = 0.0
    wave = np.tile(np.fft.irfft(spectrum, period), -(-n_samples // period))[:n_samples]
    return wave / wave.std()


def filtered_noise(rng, n_samples, *, lowest, highest):
    """(n_samples,) normal noise between two frequencies (in cycles a sample), the middle of a longer stretch."""
    spectrum = np.fft.rfft(rng.standard_normal(2 * n_samples))
    line = np.arange(n_samples + 1) / (2 * n_samples)
    spectrum[(line < lowest) | (line > highest)] = 0.0
    wave = np.fft.irfft(spectrum, 2 * n_samples)[n_samples // 2 : n_samples // 2 + n_samples]
    return wave / wave.std()


def staircase(rng, n_samples, *, shortest, longest, rounding):
    """(n_samples,) random steps that last between two numbers of samples, their corners rounded; variance 1."""
    values = np.empty(0)
    while values.size < n_samples:
        values = np.concatenate([values, np.full(rng.integers(shortest, longest), rng.standard_normal())])
    window = np.hanning(rounding + 2)[1:-1]
    wave = np.convolve(values, window / window.sum(), mode="same")[:n_samples]
    return (wave - wave.mean()) / wave.std()
