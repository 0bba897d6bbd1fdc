"""Mean and size of every channel, so that a fit does not depend on the units of the data.

Least squares at full rank does not care, but a ridge, a truncated factorisation and the order choice of a realisation
do: with units spread over 1e6 a ridge in raw units gave 100 % error where scaled channels gave 19 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from okid.arrays import FloatArray
from okid.display import Displayed
from okid.errors import InvalidDataError
from okid.record import Record

ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Standard deviation relative to the mean up to which a channel does not move: its last digit does."""
CACHE_VALUES = 1 << 17
"""Values in one step: the chunk stays in cache while it is read three times."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ChannelScaling(Displayed):
    """What is taken off each channel, and by what it is divided.

    Attributes:
        input_mean: (n_inputs,) in the input's unit.
        input_scale: (n_inputs,) standard deviation, 1 where the channel is constant.
        output_mean: (n_outputs,) in the output's unit.
        output_scale: (n_outputs,) standard deviation, 1 where the channel is constant.
        constant_inputs: indices of the inputs that never move by more than their last digit.
        constant_outputs: likewise.
    """

    input_mean: FloatArray
    input_scale: FloatArray
    output_mean: FloatArray
    output_scale: FloatArray
    constant_inputs: tuple[int, ...] = ()
    constant_outputs: tuple[int, ...] = ()

    @property
    def reciprocal(self) -> FloatArray:
        """(n_inputs + n_outputs,) factor that gives every channel unit size."""
        factor: FloatArray = 1.0 / np.concatenate([self.input_scale, self.output_scale])
        return factor

    @property
    def offset_ratio(self) -> float:
        """Largest mean over size: by this factor the rounding of the samples exceeds that of their fluctuation."""
        return float(
            max(
                np.abs(self.input_mean / self.input_scale).max(initial=0.0),
                np.abs(self.output_mean / self.output_scale).max(initial=0.0),
            )
        )


def channel_scaling(records: Sequence[Record]) -> ChannelScaling:
    """Mean and standard deviation of every channel over all records, missing samples left out.

    Summed in chunks (a mapped file stays on disk) about a first sample, mean and sum of squares of each chunk apart and
    then merged, so that a mean of 1e6 standard deviations or a drift costs no accuracy.

    Raises:
        InvalidDataError: values too large for their standard deviation to be a number.

    References:
        Chan, Golub, LeVeque, "Algorithms for computing the sample variance", The American Statistician 37(3), 1983,
        equation 2.1, doi 10.1080/00031305.1983.10483115.

    Example:
        >>> channel_scaling([Record([1.0, 3.0, 1.0, 3.0], [5.0, 5.0, np.nan, 5.0], 0.1)]).input_scale
        array([1.])
    """
    with np.errstate(over="ignore", invalid="ignore"):  # said below, with the channel's name
        input_mean, input_scale, constant_inputs = _mean_and_scale([record.inputs for record in records])
        output_mean, output_scale, constant_outputs = _mean_and_scale([record.outputs for record in records])
    names = (*records[0].input_names, *records[0].output_names)
    for name, scale in zip(names, (*input_scale, *output_scale), strict=False):
        if not np.isfinite(scale):
            raise InvalidDataError(
                f"the squares of all values must add up to a number below 1e308, but those of channel {name!r} do not; "
                "give it in a larger unit, or remove the samples that are no measurements."
            )
    return ChannelScaling(
        input_mean=input_mean,
        input_scale=input_scale,
        output_mean=output_mean,
        output_scale=output_scale,
        constant_inputs=constant_inputs,
        constant_outputs=constant_outputs,
    )


def _mean_and_scale(arrays: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, tuple[int, ...]]:
    n_channels = arrays[0].shape[1]
    if n_channels == 0:
        return np.empty(0), np.empty(0), ()
    origin = _first_values(arrays)
    count, mean, squares = np.zeros(n_channels), np.zeros(n_channels), np.zeros(n_channels)
    step = max(1, CACHE_VALUES // n_channels)
    for array in arrays:
        for start in range(0, array.shape[0], step):
            added, chunk_mean, chunk_squares = _moments(array[start : start + step] - origin)
            total = count + added
            share = added / np.maximum(total, 1.0)
            shift = chunk_mean - mean
            mean += shift * share
            squares += chunk_squares + shift * shift * count * share
            count = total
    scale = np.sqrt(squares / np.maximum(count, 1.0))
    mean += origin
    constant = scale <= ROUNDING * np.abs(mean)
    scale[constant] = 1.0
    mean.flags.writeable = scale.flags.writeable = False
    return mean, scale, tuple(np.flatnonzero(constant).tolist())


def _first_values(arrays: Sequence[FloatArray]) -> FloatArray:
    """The first number of every channel: about it a constant channel is exactly zero."""
    origin = np.array(arrays[0][0])
    for channel in np.flatnonzero(np.isnan(origin)):
        for array in arrays:
            there = np.flatnonzero(~np.isnan(array[:, channel]))
            if there.size:
                origin[channel] = array[there[0], channel]
                break
    return origin


def _moments(chunk: FloatArray) -> tuple[FloatArray | float, FloatArray, FloatArray]:
    """Count, mean and sum of squares about the mean of each column; `chunk` is overwritten."""
    count: FloatArray | float = float(chunk.shape[0])
    mean = (np.ones(chunk.shape[0]) @ chunk) / count
    if np.isnan(mean).any():
        missing = np.isnan(chunk)
        chunk[missing] = 0.0
        count = (~missing).sum(axis=0).astype(np.float64)
        mean = chunk.sum(axis=0) / np.maximum(count, 1.0)
        chunk -= mean
        chunk[missing] = 0.0
        return count, mean, np.einsum("ij,ij->j", chunk, chunk)
    about_origin = np.einsum("ij,ij->j", chunk, chunk)
    squares = about_origin - count * mean * mean
    if (squares < 1e-3 * about_origin).any():
        # The mean is far from the origin: the difference has lost digits, so take it off first.
        chunk -= mean
        squares = np.einsum("ij,ij->j", chunk, chunk)
    return count, mean, squares
