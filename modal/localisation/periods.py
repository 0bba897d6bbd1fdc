"""The period of an excitation that repeats, found from the inputs."""

import numpy as np

from okid.arrays import FloatArray
from okid.record import Record

__all__ = ["input_period", "periods_of"]

LARGEST_DIFFERENCE = 1e-3
"""Mean square of u(k + T) - u(k) over twice the variance of u from which on T is no period: 3 % noise on the input."""
UNLIKE = 0.1
"""The same measure: a shift must first pull the input apart from itself this far, else it only shows a slow signal."""
SHORTEST = 4
"""Samples of a period."""


def input_period(record: Record) -> int | None:
    """Number of samples after which all inputs repeat, at least twice in the record; None where there is none.

    Args:
        record: with inputs, none of them missing; others have no period.

    Example:
        >>> sine = np.sin(2 * np.pi * np.arange(100) / 20)
        >>> input_period(Record(sine, sine, 0.1)), input_period(Record(np.arange(100.0), sine, 0.1))
        (20, None)
    """
    inputs = record.inputs[:, np.ptp(record.inputs, axis=0) > 0.0]
    n_samples = record.n_samples
    if not inputs.shape[1] or np.isnan(record.inputs).any() or n_samples < 2 * SHORTEST:
        return None
    difference = _differences((inputs - inputs.mean(axis=0)) / inputs.std(axis=0))
    apart = np.flatnonzero(difference > UNLIKE)
    if not apart.size:
        return None
    again = np.flatnonzero(difference < LARGEST_DIFFERENCE)
    again = again[again > max(apart[0], SHORTEST - 1)]
    if not again.size:
        return None
    # an input that moves slowly is nearly itself one sample on as well: the best of the first few shifts
    run = again[: 1 + int(np.argmax(np.append(np.diff(again) > 1, values=True)))]
    return int(run[np.argmin(difference[run])])


def periods_of(values: FloatArray, period: int) -> FloatArray:
    """(n_periods, period, n_columns) the last whole periods of a signal, in order.

    Example:
        >>> periods_of(np.arange(7.0)[:, np.newaxis], 3)[:, :, 0].tolist()
        [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    """
    n_periods = len(values) // period
    return values[len(values) - n_periods * period :].reshape(n_periods, period, values.shape[1])


def _differences(inputs: FloatArray) -> FloatArray:
    """(n_samples // 2 + 1,) mean square of u(k + T) - u(k) over twice the variance, the worst input of each shift T."""
    n_samples = len(inputs)
    spectrum = np.fft.rfft(inputs, 2 * n_samples, axis=0)
    shifts = np.arange(n_samples // 2 + 1)
    products = np.fft.irfft(np.square(np.abs(spectrum)), axis=0)[shifts]
    power = np.concatenate([np.zeros((1, inputs.shape[1])), np.cumsum(np.square(inputs), axis=0)])
    ends = power[n_samples - shifts] + power[n_samples] - power[shifts]
    # both ends share what they miss: a period in which the input rests must not divide by zero
    difference: FloatArray = (ends - 2.0 * products) / (2.0 * (n_samples - shifts)[:, np.newaxis])
    return difference.max(axis=1)
