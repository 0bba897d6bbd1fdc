"""What the inputs do to the outputs, without a model order: the pulse response of one long observer.

It costs hundredths of a second where a model costs seconds, outlasts no segment, and is good enough to tell what the
inputs explain from what they do not. It is never an answer.
"""

from collections.abc import Sequence

import numpy as np

from okid.arrays import FloatArray
from okid.errors import IdentificationError
from okid.gram import lag_gram
from okid.least_squares import solve
from okid.record import Record
from okid.recovery import recover_system
from okid.rows import runs_of
from okid.scaling import channel_scaling

__all__ = ["best_pulse", "fitted_pulse_response", "predicted_outputs", "whole_rows"]

MOST_ROWS = 6000
OBSERVERS = ((512, 1e-6), (128, 1e-6), (128, 1e-3), (32, 1e-6))
"""Coefficients of an output's equation, and ridge: a single transient wants another one than an hour of noise."""
ROWS_PER_UNKNOWN = 6
LARGEST_PULSE = 1e6
"""In standard deviations of the output for one of the input: beyond, the observer describes nothing that could be."""


def whole_rows(records: Sequence[Record]) -> Record | None:
    """The longest run of complete rows of the longest record, at most 6000, means removed; None where it is short."""
    longest = max(records, key=lambda record: record.n_samples)
    start, stop = max(runs_of(longest.complete_rows()), key=lambda run: run[1] - run[0], default=(0, 0))
    if stop - start < 20 * (longest.n_inputs + longest.n_outputs):
        return None
    return longest.samples(start, min(stop, start + MOST_ROWS)).detrended(0)


def fitted_pulse_response(record: Record, *, n_unknowns: int, ridge: float) -> tuple[FloatArray, int] | None:
    """(n_samples, n_outputs, n_inputs) of outputs to a unit pulse, and how many numbers of an output were fitted.

    Args:
        record: means removed, nothing missing.
        n_unknowns: coefficients of an output's equation, at most.
        ridge: of the fit, for channels of unit size.

    Returns:
        None where the response diverges or a channel is constant.

    Example:
        >>> force = np.random.default_rng(0).standard_normal(900)
        >>> record = Record(force, np.convolve(force, [0.0, 1.0, 0.5])[:900], 0.01)
        >>> pulse, n_fitted = fitted_pulse_response(record, n_unknowns=64, ridge=1e-6)
        >>> pulse[:4].ravel().round(3) + 0.0
        array([0. , 1. , 0.5, 0. ])
    """
    n_channels = record.n_inputs + record.n_outputs
    order = max(1, min(n_unknowns, record.n_samples // ROWS_PER_UNKNOWN) // n_channels)
    scaling = channel_scaling([record])
    if scaling.constant_inputs or scaling.constant_outputs:
        return None
    try:
        fit = solve(lag_gram([record], order, scaling=scaling), ridge)
    except (IdentificationError, np.linalg.LinAlgError):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        pulse = recover_system(fit.feedthrough, fit.input_coefficients, fit.output_coefficients, record.n_samples - 1)
    if not np.abs(pulse).max() < LARGEST_PULSE:  # nan is not below either
        return None
    size = scaling.output_scale[:, np.newaxis] / scaling.input_scale
    return np.asarray(pulse * size, dtype=np.float64), record.n_inputs + order * n_channels


def best_pulse(record: Record) -> tuple[FloatArray, FloatArray] | None:
    """Of a few observers the pulse response that explains most, and the share of each output's power that it explains.

    What is left counts more by as much as the fitted numbers took of it.

    Args:
        record: means removed, nothing missing.

    Returns:
        (n_samples, n_outputs, n_inputs) and (n_outputs,); None where every response diverges or a channel is constant.
    """
    power = np.maximum(record.outputs.var(axis=0), np.finfo(float).tiny)
    best: tuple[FloatArray, FloatArray] | None = None
    for n_unknowns, ridge in OBSERVERS:
        found = fitted_pulse_response(record, n_unknowns=n_unknowns, ridge=ridge)
        if found is None:
            continue
        pulse, n_fitted = found
        left = record.outputs - predicted_outputs(pulse, record.inputs)
        shares = 1.0 - left.var(axis=0) / (1.0 - n_fitted / record.n_samples) / power
        if best is None or shares.sum() > best[1].sum():
            best = pulse, shares
    return best


def predicted_outputs(pulse: FloatArray, inputs: FloatArray) -> FloatArray:
    """(n_samples, n_outputs) answer to the inputs from rest.

    Args:
        pulse: (n_lags, n_outputs, n_inputs).
        inputs: (n_samples, n_inputs).
    """
    n_samples = len(inputs)
    size = 1 << (len(pulse) + n_samples).bit_length()
    spectrum = np.einsum("fqm,fm->fq", np.fft.rfft(pulse, size, axis=0), np.fft.rfft(inputs, size, axis=0))
    return np.asarray(np.fft.irfft(spectrum, size, axis=0)[:n_samples], dtype=np.float64)
