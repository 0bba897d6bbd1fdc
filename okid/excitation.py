"""Before the fit: do the inputs move enough, and in enough different ways, for the answer to be in the data?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from okid.arrays import TINY, BoolArray, FloatArray, whole_number
from okid.display import Displayed
from okid.gram import lag_gram
from okid.record import Record
from okid.rows import as_records, runs_of
from okid.scaling import ChannelScaling, channel_scaling

_SMALLEST_EIGENVALUE = 1e-13
"""Of the Gram matrix, relative to the largest: what double precision can tell from zero."""
POOR_CONDITION = 1e4
"""Say so where the inputs' regressors have a larger condition number: 80 dB from strongest to weakest direction."""
_POOR_SHARE = 0.9
"""Below this share of the band the message names the band that is missing."""
_BRIDGED = 0.01
"""Of the whole band: a message takes bands that are closer than this for one."""
DYNAMIC_RANGE = 1e-6
"""Count a frequency as excited within this factor, 60 dB, of the largest spectral density, and a line as driven."""
_HALVED = 256
"""Look through a window of half the length, too, where the whole has so many samples: a Hann window is down by 60 dB
seven lines away, which would be most of the band of a few dozen."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Excitation(Displayed):
    """What the inputs allow to be identified.

    Attributes:
        needed_order: order of persistent excitation that was asked for.
        persistency_order: largest order up to `needed_order` for which the input Hankel matrix has full numerical rank.
        condition: condition number of the scaled input Hankel matrix of `needed_order` block rows.
        excited_share: (n_inputs,) share of the band 0 to half the sampling frequency in which the input has power
            (within 60 dB of its largest spectral density).
        excited_bands: one tuple of (low, high) [Hz] pairs an input: where it moves.
        messages: findings in words; empty when the inputs carry all that was asked.
    """

    needed_order: int
    persistency_order: int
    condition: float
    excited_share: FloatArray
    excited_bands: tuple[tuple[tuple[float, float], ...], ...]
    messages: tuple[str, ...]


def check_excitation(records: Record | Sequence[Record], *, order: int) -> Excitation:
    """Judge the inputs: how many past samples can be told apart, and where in frequency each input moves.

    A system of n states and an observer of p past samples need inputs that are persistently exciting of order p + 1 +
    n: the input Hankel matrix of that many block rows must have full rank. A sum of r sines has order 2 r. A good
    one-step fit is no proof of it: an input that moved in 60 % of the band gave a one-step residual of 3e-7 and a
    frequency 500 % wrong.

    Args:
        records: one record or several of one system; rows with a missing input are left out.
        order: of persistent excitation that is needed, in samples.

    Raises:
        InvalidDataError: an order below 1.

    References:
        Willems, Rapisarda, Markovsky, De Moor, "A note on persistency of excitation", Systems & Control Letters 54(4),
        2005, 325-329, doi 10.1016/j.sysconle.2004.09.003.

    Example:
        >>> k = np.arange(500)
        >>> sine = Record(np.sin(0.3 * k), np.sin(0.3 * k - 0.4), 0.01, input_names=["force"])
        >>> check = check_excitation(sine, order=6)
        >>> check.persistency_order
        2
        >>> print(check.messages[0])
        the inputs hold too few frequencies, or leave a part of the band out: they tell the effects of 2 successive ...
    """
    several = as_records(records)
    order = whole_number(order, name="an order of persistent excitation", least=1)
    if several[0].n_inputs == 0:
        return Excitation(
            needed_order=order,
            persistency_order=0,
            condition=np.inf,
            excited_share=np.empty(0),
            excited_bands=(),
            messages=("no input was measured: only poles, shapes and the observer gain can be identified.",),
        )
    scaling = channel_scaling(several)
    persistency, condition, same_time = _persistency(several, scaling, order)
    densities = [_density(several, channel, scaling) for channel in range(several[0].n_inputs)]
    nyquist = 0.5 / several[0].dt
    excited = [_excited(density) for density in densities]
    bands = tuple(_bands(mask, nyquist) for mask in excited)
    shares = np.array([float(mask.mean()) for mask in excited])
    shares.flags.writeable = False
    collinear = _collinear_messages(several[0].input_names, same_time, scaling)  # no order tells these apart
    messages = [
        *_constant_messages(several[0], scaling),
        *(collinear or _order_messages(order, persistency, condition)),
        *_band_messages(several[0].input_names, shares, bands, nyquist, scaling),
    ]
    return Excitation(
        needed_order=order,
        persistency_order=persistency,
        condition=condition,
        excited_share=shares,
        excited_bands=bands,
        messages=tuple(messages),
    )


def _persistency(records: Sequence[Record], scaling: ChannelScaling, order: int) -> tuple[int, float, FloatArray]:
    """Persistency order up to `order`, condition number at `order`, and covariance of the inputs at equal times."""
    n_inputs = records[0].n_inputs
    gram = lag_gram([_inputs_only(record) for record in records], order - 1, scaling=_inputs_scaling(scaling))
    mean = gram.matrix[0, 1:]
    matrix = gram.matrix[1:, 1:] - np.outer(mean, mean) / max(gram.n_rows, 1)
    same_time = matrix[:n_inputs, :n_inputs] / max(gram.n_rows, 1)

    def extremes(lags: int) -> tuple[float, float]:
        values = np.linalg.eigvalsh(matrix[: lags * n_inputs, : lags * n_inputs])
        return float(values[0]), float(values[-1])

    def full_rank(lags: int) -> bool:
        smallest, largest = extremes(lags)
        return gram.n_rows >= lags * n_inputs and smallest > _SMALLEST_EIGENVALUE * lags * largest

    smallest, largest = extremes(order)
    condition = float(np.sqrt(largest / smallest)) if smallest > 0.0 else np.inf
    if full_rank(order):
        return order, condition, same_time
    # The smallest eigenvalue of a leading part falls with its size (interlacing): bisection finds where it vanishes.
    low, high = 0, order
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if full_rank(middle) else (low, middle)
    return low, condition, same_time


def _inputs_only(record: Record) -> Record:
    """The inputs in the place of outputs: `lag_gram` then sees nothing else."""
    return Record(np.empty((record.n_samples, 0)), record.inputs, record.dt)


def _inputs_scaling(scaling: ChannelScaling) -> ChannelScaling:
    nothing = np.empty(0)
    return ChannelScaling(
        input_mean=nothing, input_scale=nothing, output_mean=scaling.input_mean, output_scale=scaling.input_scale
    )


def _density(records: Sequence[Record], channel: int, scaling: ChannelScaling) -> FloatArray:
    """Power spectral density (arbitrary unit) of one scaled input: Hann windows, half overlapped, averaged.

    A window hardly sees what is near its own ends, where a sweep begins or ends: at both ends of the record stand one
    more of the same length and, where that still tells one frequency from its neighbours, one half as long. An input
    that rests most of the time rests before and after its record, too: a blow at an end is seen whole.
    """
    longest = max(record.n_samples for record in records)
    length = int(np.clip(1 << max(3, (longest // 4).bit_length() - 1), 8, 1024))
    window = np.hanning(length + 2)[1:-1]
    density = np.zeros(length // 2 + 1)
    for record in records:
        # so many rows tell a spectrum
        values = (record.inputs[:2_000_000, channel] - scaling.input_mean[channel]) / scaling.input_scale[channel]
        known = values[~np.isnan(values)]
        rest = np.median(known) if known.size else np.nan
        if np.count_nonzero(values == rest) > values.size / 2:
            values = np.pad(values - rest, length // 2)
        for start, stop in runs_of(~np.isnan(values)):
            if stop - start < length:
                continue
            segments = np.lib.stride_tricks.sliding_window_view(values[start:stop], length)[:: length // 2]
            for first in range(0, segments.shape[0], 256):
                spectra = np.fft.rfft(segments[first : first + 256] * window, axis=1)
                density += (spectra.real**2 + spectra.imag**2).sum(axis=0)
            for short in (length, length // 2) if length >= _HALVED else (length,):
                ends = np.stack([values[start : start + short], values[stop - short : stop]])
                spectra = np.fft.rfft(ends * np.hanning(short + 2)[1:-1], length, axis=1)
                density += (spectra.real**2 + spectra.imag**2).sum(axis=0)
    return density


def _excited(density: FloatArray) -> BoolArray:
    excited: BoolArray = density > DYNAMIC_RANGE * density.max()
    return excited


def _bridged(bands: Sequence[tuple[float, float]], gap: float) -> list[tuple[float, float]]:
    """Bands that are closer than a gap taken for one: a single line of chance between them means nothing."""
    wide = [bands[0]]
    for low, high in bands[1:]:
        if low - wide[-1][1] < gap:
            wide[-1] = (wide[-1][0], high)
        else:
            wide.append((low, high))
    return wide


def _bands(excited: BoolArray, nyquist: float) -> tuple[tuple[float, float], ...]:
    step = nyquist / (excited.size - 1)
    edges = runs_of(excited)
    return tuple((max(0.0, (start - 0.5) * step), min(nyquist, (stop - 0.5) * step)) for start, stop in edges)


def _constant_messages(record: Record, scaling: ChannelScaling) -> list[str]:
    return [
        f"input {record.input_names[i]!r} never moves (always {scaling.input_mean[i]:.6g}): nothing can be identified "
        "from it; leave it out."
        for i in scaling.constant_inputs
    ]


def _order_messages(order: int, persistency: int, condition: float) -> list[str]:
    if persistency < order:
        return [
            (
                f"the inputs hold too few frequencies, or leave a part of the band out: they tell the effects of "
                f"{persistency} successive sample{'s' * (persistency != 1)} apart, and {order} are needed; drive with "
                "more frequencies or over the whole band, or use a lower observer order or a ridge."
            )
        ]
    if condition > POOR_CONDITION:
        return [
            (
                f"the inputs of {order} successive samples are nearly dependent (condition {condition:.1e}; below "
                f"{POOR_CONDITION:.0e} is safe): some of what the inputs do hardly shows; use a ridge, or decimate "
                "to the band that is excited."
            )
        ]
    return []


def _collinear_messages(names: Sequence[str], same_time: FloatArray, scaling: ChannelScaling) -> list[str]:
    """Name inputs that are multiples of each other, or that together carry fewer signals than channels."""
    moving = [i for i in range(len(names)) if i not in scaling.constant_inputs]
    messages, paired = [], set()
    size = np.sqrt(np.maximum(same_time.diagonal(), TINY))
    for i in moving:
        for j in moving:
            correlation = same_time[i, j] / (size[i] * size[j])
            if i < j and abs(correlation) > 1.0 - 1e-10:
                ratio = np.sign(correlation) * scaling.input_scale[j] / scaling.input_scale[i]
                messages.append(
                    f"inputs {names[i]!r} and {names[j]!r} are the same signal ({names[j]!r} = {ratio:.4g} times "
                    f"{names[i]!r}): their effects cannot be told apart; leave one out."
                )
                paired.add(j)
    rest = [i for i in moving if i not in paired]
    if len(rest) > 2:
        values, vectors = np.linalg.eigh(same_time[np.ix_(rest, rest)])
        if values[0] < 1e-10 * values[-1]:
            involved = ", ".join(
                repr(names[i]) for i, part in zip(rest, vectors[:, 0], strict=True) if abs(part) > 0.05
            )
            messages.append(
                f"inputs {involved} are linearly dependent: one is a combination of the others, so their effects "
                "cannot be told apart; leave one out."
            )
    return messages


def _band_messages(
    names: Sequence[str],
    shares: FloatArray,
    bands: Sequence[tuple[tuple[float, float], ...]],
    nyquist: float,
    scaling: ChannelScaling,
) -> list[str]:
    messages = []
    for i, name in enumerate(names):
        if i in scaling.constant_inputs or shares[i] >= _POOR_SHARE or not bands[i]:
            continue
        wide = _bridged(bands[i], _BRIDGED * nyquist)
        shown = ", ".join(f"{low:.4g} to {high:.4g} Hz" for low, high in wide[:4])
        left = len(wide) - 4
        more = f" and {left} narrower band{'s' * (left > 1)}" if left > 0 else ""
        messages.append(
            f"input {name!r} moves in {100 * shares[i]:.0f} % of the band up to {nyquist:.4g} Hz ({shown}{more}): "
            "elsewhere the response to it is not in the data."
        )
    return messages
