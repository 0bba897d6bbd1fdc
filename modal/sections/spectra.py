"""Power spectra of outputs, for pictures: Hann windows of half overlap over every uninterrupted stretch."""

from collections.abc import Sequence

import numpy as np

from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["power_spectra"]


def power_spectra(records: Sequence[Record], *, n_segment: int | None = None) -> tuple[FloatArray, FloatArray]:
    """One-sided power spectral density of each output, averaged over records (Welch, doi 10.1109/TAU.1967.1161901).

    Args:
        records: of one system, one time step; a missing sample counts as the mean of its channel.
        n_segment: samples in a window; an eighth of the longest record, 64 to 2048, unless given.

    Returns:
        (n_frequencies,) [Hz] and (n_frequencies, n_outputs) [unit^2/Hz].
    """
    dt = records[0].dt
    longest = max(record.n_samples for record in records)
    size = n_segment or int(np.clip(longest // 8, 64, 2048))
    size = min(size, *(record.n_samples for record in records))
    window = np.hanning(size + 2)[1:-1]
    power = np.zeros((size // 2 + 1, records[0].n_outputs))
    n_windows = 0
    for record in records:
        mean = np.nan_to_num(np.nanmean(record.outputs, axis=0))
        for start in range(0, record.n_samples - size + 1, max(1, size // 2)):
            segment = np.nan_to_num(record.outputs[start : start + size] - mean)
            power += np.abs(np.fft.rfft(segment * window[:, None], axis=0)) ** 2
            n_windows += 1
    power *= 2.0 * dt / (n_windows * np.sum(window**2))
    return np.asarray(np.fft.rfftfreq(size, dt), dtype=np.float64), power
