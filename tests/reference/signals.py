"""Inputs of every kind, and measurement noise, for the systems of `systems.py`; independent of okid, era and modal."""

from typing import Literal

import numpy as np
import scipy

InputKind = Literal["white", "coloured", "sweep", "multisine", "hits", "steps"]


def random_inputs(
    rng: np.random.Generator, n_samples: int, n_inputs: int, *, kind: InputKind = "white", scale: float = 1.0
) -> np.ndarray:
    """(n_samples, n_inputs) inputs of standard deviation about `scale`, a different one on each channel."""
    white = rng.standard_normal((n_samples, n_inputs))
    k = np.arange(n_samples)[:, np.newaxis]
    if kind == "white":
        values = white
    elif kind == "coloured":
        values = np.empty_like(white)
        level = np.zeros(n_inputs)
        for i, e in enumerate(white):
            level = 0.8 * level + e
            values[i] = level + 0.3 * e
    elif kind == "sweep":
        starts, ends = 0.005 * (1 + np.arange(n_inputs)), 0.45 - 0.01 * np.arange(n_inputs)
        values = np.sin(2 * np.pi * (starts * k + (ends - starts) * k**2 / (2 * n_samples)))
    elif kind == "multisine":
        lines = np.arange(1, n_samples // 2)
        values = np.empty_like(white)
        for j in range(n_inputs):
            spectrum = np.zeros(n_samples // 2 + 1, dtype=complex)
            spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
            values[:, j] = np.fft.irfft(spectrum, n_samples)
    elif kind == "hits":
        values = np.where(rng.random((n_samples, n_inputs)) < 10 / n_samples, rng.uniform(0.5, 1.5, white.shape), 0.0)
        values[rng.integers(1, 20, n_inputs), np.arange(n_inputs)] = 1.0
    else:
        values = np.repeat(rng.standard_normal((-(-n_samples // 7), n_inputs)), 7, axis=0)[:n_samples]
    return scale * values / values.std(axis=0)


def with_noise(rng: np.random.Generator, outputs: np.ndarray, share: float) -> np.ndarray:
    """Outputs plus white noise whose standard deviation is a share of each channel's own."""
    return outputs + share * outputs.std(axis=0) * rng.standard_normal(outputs.shape)


def answer(force, frequency=0.07, damping=0.03):
    """One mode driven by a force, one sample late, as any sampled structure without feedthrough."""
    radius = np.exp(-2 * np.pi * frequency * damping)
    poles = [1.0, -2 * radius * np.cos(2 * np.pi * frequency), radius**2]
    motion = scipy.signal.lfilter([0.0, 1.0], poles, force)
    return motion / motion.std()
