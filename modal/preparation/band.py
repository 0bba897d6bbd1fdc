"""Which frequencies the records speak about: the band in which the outputs follow the inputs.

Above it a record holds noise alone; keeping it would spend most of the observer on noise. Oversampled records are
decimated to that band, inputs and outputs through the same filter.

Where inputs move throughout, coherence tells it. After a blow nearly every segment holds nothing that acts, and
averages over them hide what the blow does: there the band is what rows after a blow show above those at rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from modal.modes.mode import ModalModel
from modal.preparation.kind import acting_in, find_kind
from okid.arrays import ROUNDED, TINY, ComplexArray, FloatArray
from okid.record import Record

COHERENT = 0.3
"""Multiple coherence from which on an output counts as following the inputs."""
COHERENT_POWER = 0.9999
"""Share of each output's coherent power that the band must hold: a mode left out moves less than 1 % of any output."""
COLLINEAR = 1e-9
"""Add so much of its power to each input before they are told apart: two that are one have no inverse."""
FEWEST_AVERAGES = 16
"""Believe no coherence over segments of twice the length that are fewer: three lines that agree are chance."""
WORTH = 0.95
"""Count half-overlapping Hann segments as this share of their number in averages, about."""
LENGTHS = (64, 256, 1024)
"""Look at so many rows after each blow: an answer stands out most over as many rows as it takes."""
NEIGHBOURS = 8
"""Take for rest what so many lines on either side have in the median: a line that stands out of them is an answer."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Band:
    """The coherent band and what follows from it.

    Attributes:
        upper_frequency: highest frequency at which some output follows the inputs [Hz].
        factor: by which the records can be decimated.
        frequencies: (n_frequencies,) [Hz].
        coherence: (n_frequencies, n_outputs) multiple coherence, its bias taken off; outputs' normalised spectra where
            there is no input.
        reason: one sentence.
    """

    upper_frequency: float
    factor: int
    frequencies: FloatArray
    coherence: FloatArray
    reason: str


def coherent_band(records: Sequence[Record]) -> Band:
    """The band in which at least one output follows the inputs.

    Example:
        >>> force = np.random.default_rng(0).standard_normal(2000)
        >>> band = coherent_band([Record(force, 2.0 * force, 0.01)])
        >>> band.factor, band.reason
        (1, 'the outputs follow the inputs up to 50 Hz of 50 Hz: nothing to gain from decimation')
    """
    dt = records[0].dt
    nyquist = 0.5 / dt
    n_segment = _segment_length(records)
    frequencies = np.asarray(np.fft.rfftfreq(n_segment, dt), dtype=np.float64)
    n_inputs = records[0].n_inputs
    untouched = np.ones((frequencies.size, records[0].n_outputs))
    if n_inputs and find_kind(records).kind == "transient":
        upper = _struck_up_to(records)
        factor = _factor(records, upper)
        reason = f"what follows a blow stands above the rest up to {upper:.4g} Hz of {nyquist:.4g} Hz: " + (
            "nothing to gain from decimation" if factor == 1 else f"decimated by {factor}"
        )
        return Band(upper_frequency=upper, factor=factor, frequencies=frequencies, coherence=untouched, reason=reason)
    spectra, n_averages = _spectra(records, n_segment)
    if n_inputs == 0 or n_averages < 2 * n_inputs + 2:
        return Band(
            upper_frequency=nyquist,
            factor=1,
            frequencies=frequencies,
            coherence=untouched,
            reason="the whole band is kept: there is no input to compare the outputs with"
            if n_inputs == 0
            else "the whole band is kept: the record is too short between its gaps to judge coherence "
            f"({n_averages} averages of {n_segment} samples)",
        )
    coherence = _multiple_coherence(spectra, n_inputs, n_averages)
    upper = _upper_frequency(frequencies, spectra, coherence) or nyquist
    factor = _factor(records, upper)
    # of a mode that rings on for longer than a segment the answer is in later ones, and a longer one shows it
    longer = _upper_over(records, 2 * n_segment)
    if longer > nyquist / factor:
        upper, factor = longer, _factor(records, longer)
    if factor == 1:
        reason = (
            f"the outputs follow the inputs up to {upper:.4g} Hz of {nyquist:.4g} Hz: nothing to gain from decimation"
        )
    else:
        reason = (
            f"{100 * COHERENT_POWER:g} % of what each output owes to the inputs lies below {upper:.4g} Hz, the "
            f"record goes to {nyquist:.4g} Hz: decimated by {factor}"
        )
    return Band(upper_frequency=upper, factor=factor, frequencies=frequencies, coherence=coherence, reason=reason)


def _factor(records: Sequence[Record], upper: float) -> int:
    """That leaves a fifth of the new band above the upper frequency, and enough samples."""
    total = sum(record.n_samples for record in records)
    factor = max(1, min(int(0.5 / records[0].dt / (1.25 * upper)), total // 500))  # no fewer samples
    while factor > 1 and any(record.n_samples < 60 * factor for record in records):
        factor -= 1
    return factor


def _struck_up_to(records: Sequence[Record]) -> float:
    """Highest frequency at which rows after a blow have more power than rest has by chance, the last one if none has.

    Rest is what half of the segments in which nothing acts stay below (line by line, then in the median over lines
    nearby, which is ln 2 times the mean of exponentially distributed powers); the power after n blows over it is then
    gamma-distributed. The least chance of all lines, outputs and lengths counts, times their number (Bonferroni).
    """
    acting = acting_in(records)
    struck = [(np.nan_to_num(one.outputs), rows) for one, rows in zip(records, acting, strict=True) if rows.any()]
    lengths = [n for n in LENGTHS if 4 * n <= min(rows.size for _, rows in struck)]
    highest = 0.0
    for n in lengths:
        ratios, n_blows = np.zeros((n // 2 + 1, records[0].n_outputs)), 0
        for outputs, rows in struck:
            quiet = [k for k in range(0, rows.size - n + 1, n // 2) if not rows[k : k + n].any()]
            blows = [k for k in np.flatnonzero(rows[: 1 - n]) if not rows[max(0, k - n) : k].any()]
            if not quiet or not blows:
                continue
            rest = np.median([_power(outputs[k : k + n]) for k in quiet], axis=0)
            rest = scipy.ndimage.median_filter(rest, size=(2 * NEIGHBOURS + 1, 1), mode="nearest") / np.log(2)
            ratios += np.sum([_power(outputs[k : k + n]) for k in blows], axis=0) / np.maximum(rest, TINY)
            n_blows += len(blows)
        chance = scipy.special.gammaincc(max(1, n_blows), ratios).min(axis=1) * ratios.size * len(lengths)
        above = np.flatnonzero(chance < FOLLOWS)
        highest = max(highest, above[-1] / (n * records[0].dt) if above.size else 0.0)
    return float(highest or 0.5 / records[0].dt)


def _power(rows: FloatArray) -> FloatArray:
    """(n_lines, n_columns) of a Hann-windowed segment, its mean removed."""
    window = np.hanning(len(rows) + 2)[1:-1, np.newaxis]
    return np.asarray(np.abs(np.fft.rfft((rows - rows.mean(axis=0)) * window, axis=0)) ** 2)


def missed_share(records: Sequence[Record], left: Sequence[FloatArray]) -> float:
    """Share of what the inputs explain of the outputs that a model of them leaves, nan where it cannot be told.

    What still follows the inputs (multiple coherence) over that and what the model explains; each output counts alike.

    Args:
        records: with inputs.
        left: (n_samples, n_outputs) a record: what the model's free run leaves, NaN where an output is missing.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> force, noise = rng.standard_normal((2, 4000, 1))
        >>> record = Record(force, force + 3.0 * noise, 0.01)
        >>> round(missed_share([record], [3.0 * noise]), 1), round(missed_share([record], [record.outputs]), 1)
        (0.0, 1.0)
    """
    remains = [replace(record, outputs=errors) for record, errors in zip(records, left, strict=True)]
    spectra, n_averages = _spectra(remains, _segment_length(records))
    n_inputs = records[0].n_inputs
    if n_inputs == 0 or n_averages < 2 * n_inputs + 2:
        return float("nan")
    power = np.einsum("foo->fo", spectra[:, n_inputs:, n_inputs:]).real
    follows = (power * _multiple_coherence(spectra, n_inputs, n_averages, clip=False)).sum(axis=0) / power.sum(axis=0)
    whole = np.sum([np.nansum(np.square(record.outputs), axis=0) for record in records], axis=0)
    errors = np.sum([np.nansum(np.square(part), axis=0) for part in left], axis=0)
    missed = np.maximum(0.0, follows) * errors / whole
    explained = np.maximum(0.0, 1.0 - errors / whole)
    return float(missed.sum() / max(missed.sum() + explained.sum(), np.finfo(float).tiny))


FOLLOWS = 0.01
"""Doubt a pole at whose frequency outputs that know nothing of the inputs follow them as well so often."""


def chance_of_following(
    records: Sequence[Record], frequencies: Sequence[float], half_widths: Sequence[float]
) -> FloatArray:
    """How often outputs that know nothing of the inputs follow them as well within each of some bands.

    The multiple coherence of an output, m inputs over n averages, is chance with the mean m / n; its sum over half as
    many independent lines as the window leaves in the band is about gamma-distributed. The least of all outputs counts,
    times their number (Bonferroni). A segment that is short against the memory of a pole, 1 / (4 pi half width), sees
    about T / (T + memory) of its answer; where that would be chance too nothing can be told.

    Args:
        records: of one system.
        frequencies: (n_bands,) middle of each band [Hz].
        half_widths: (n_bands,) [Hz]; two lines on either side at least.

    Returns:
        (n_bands,) probabilities, 0 where they cannot be told.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> noise, force = rng.standard_normal((2, 8000))
        >>> force = np.fft.irfft(np.where(np.arange(4001) < 2000, np.fft.rfft(force), 0.0), 8000)  # up to 25 Hz of 50
        >>> told = chance_of_following([Record(force, force + 0.1 * noise, 0.01)], [10.0, 40.0], [1.0, 1.0])
        >>> bool(told[0] < 1e-6), bool(told[1] > 0.01)
        (True, True)
    """
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    n_segment = _segment_length(records)
    spectra, n_averages = _spectra(records, n_segment)
    if n_inputs == 0 or n_averages < 2 * n_inputs + 2:
        return np.zeros(len(frequencies))
    lines = np.fft.rfftfreq(n_segment, records[0].dt)
    worth = WORTH * n_averages  # as in `_multiple_coherence`, whose correction is taken back
    bias = n_inputs / worth
    coherence = _multiple_coherence(spectra, n_inputs, n_averages, clip=False) * (1.0 - bias) + bias
    chances = np.zeros(len(frequencies))
    for i, (middle, half) in enumerate(zip(frequencies, half_widths, strict=True)):
        near = np.abs(lines - middle) <= max(half, 2.0 * lines[1])
        if near.any():
            shape = 0.5 * n_inputs * max(2, int(near.sum()))
            seen = 1.0 / (1.0 + lines[1] / (4.0 * np.pi * max(half, np.finfo(float).tiny)))
            ratios = np.append(coherence[near].mean(axis=0), bias + (1.0 - bias) * seen) / bias
            *found, of_a_pole = n_outputs * scipy.special.gammaincc(shape, shape * ratios)
            chances[i] = min(1.0, *found) if of_a_pole < FOLLOWS else 0.0
    return chances


def chance_at_modes(model: ModalModel, records: Sequence[Record]) -> FloatArray:
    """(n_modes,) of `chance_of_following` within half the half-power bandwidth of each mode."""
    half_widths = [0.5 * mode.damping_ratio * mode.frequency for mode in model.modes]
    return chance_of_following(records, [mode.frequency for mode in model.modes], half_widths)


def share_that_follows(
    records: Sequence[Record], frequencies: Sequence[float], half_widths: Sequence[float]
) -> FloatArray:
    """How much of the outputs' power within each of some bands the inputs explain, by multiple coherence.

    Outputs count alike. As `chance_of_following`, which asks whether any of it does.

    Returns:
        (n_bands,) shares, about 0 where nothing follows, 1 where that cannot be told: without inputs, or with too few
        averages.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> noise, force = rng.standard_normal((2, 8000, 1))
        >>> share_that_follows([Record(force, force + 2.0 * noise, 0.01)], [10.0], [1.0]).round(1)
        array([0.2])
    """
    n_inputs, n_segment = records[0].n_inputs, _segment_length(records)
    spectra, n_averages = _spectra(records, n_segment)
    if n_inputs == 0 or n_averages < 2 * n_inputs + 2:
        return np.ones(len(frequencies))
    lines = np.fft.rfftfreq(n_segment, records[0].dt)
    power = np.einsum("foo->fo", spectra[:, n_inputs:, n_inputs:]).real
    power = power / np.maximum(power.mean(axis=0), np.finfo(float).tiny)
    followed = power * _multiple_coherence(spectra, n_inputs, n_averages, clip=False)
    shares = np.ones(len(frequencies))
    for i, (middle, half) in enumerate(zip(frequencies, half_widths, strict=True)):
        near = np.abs(lines - middle) <= max(half, 2.0 * lines[1])
        if near.any() and power[near].any():
            shares[i] = followed[near].sum() / power[near].sum()
    return shares


def _upper_over(records: Sequence[Record], n_segment: int) -> float:
    """Highest frequency at which segments of another length follow the inputs; 0 where none does or they are few."""
    spectra, n_averages = _spectra(records, n_segment)
    n_inputs = records[0].n_inputs
    if n_averages < max(FEWEST_AVERAGES, 2 * n_inputs + 2):
        return 0.0
    frequencies = np.asarray(np.fft.rfftfreq(n_segment, records[0].dt), dtype=np.float64)
    return _upper_frequency(frequencies, spectra, _multiple_coherence(spectra, n_inputs, n_averages)) or 0.0


def _upper_frequency(frequencies: FloatArray, spectra: ComplexArray, coherence: FloatArray) -> float | None:
    """Below it lies `COHERENT_POWER` of every output's coherent power; None when no output follows any input."""
    best = coherence.max(axis=1)
    # three neighbouring lines must agree, so that one lucky line far above the band does not decide
    agreed = np.minimum.reduce([best[:-2], best[1:-1], best[2:]]) > COHERENT
    if not agreed.any():
        return None
    last = int(np.flatnonzero(agreed)[-1]) + 2
    n_outputs = coherence.shape[1]
    power = np.einsum("foo->fo", spectra[:, -n_outputs:, -n_outputs:]).real
    share = np.cumsum(coherence * power, axis=0)
    share /= np.maximum(share[-1], np.finfo(np.float64).tiny)
    enough = int((share < COHERENT_POWER).sum(axis=0).max())
    return float(frequencies[min(last, enough, frequencies.size - 1)])


def _segment_length(records: Sequence[Record]) -> int:
    """About forty half-overlapping segments, at most 1024 samples each."""
    total = sum(record.n_samples for record in records)
    wanted = min(1024, int(2 ** np.floor(np.log2(max(32, total / 20)))))
    lengths = np.sort([record.n_samples for record in records])[::-1]
    # records shorter than a segment give none: at most a quarter of the samples may be lost so
    enough = int(lengths[np.searchsorted(np.cumsum(lengths), 0.75 * total)])
    return int(min(wanted, max(16, enough)))


def _spectra(records: Sequence[Record], n_segment: int) -> tuple[ComplexArray, int]:
    """(n_frequencies, n_channels, n_channels) cross-spectra of the segments without a gap, and their number."""
    window = np.hanning(n_segment + 2)[1:-1]
    n_channels = records[0].n_inputs + records[0].n_outputs
    total = np.zeros((n_segment // 2 + 1, n_channels, n_channels), dtype=np.complex128)
    n_averages = 0
    for record in records:
        complete = record.complete_rows()
        for start in range(0, record.n_samples - n_segment + 1, n_segment // 2):
            rows = slice(start, start + n_segment)
            if not complete[rows].all():
                continue
            segment = np.vstack([record.inputs[rows].T, record.outputs[rows].T])
            segment = (segment - segment.mean(axis=1, keepdims=True)) * window
            lines = np.fft.rfft(segment).T
            total += lines[:, :, np.newaxis] * lines[:, np.newaxis, :].conj()
            n_averages += 1
    return total / max(1, n_averages), n_averages


def _multiple_coherence(spectra: ComplexArray, n_inputs: int, n_averages: int, *, clip: bool = True) -> FloatArray:
    """Share of each output's power that the inputs explain, less what noise alone would seem to explain.

    Not clipped it may be negative, and a sum over frequencies is zero on the mean where nothing is explained.
    """
    into, out = slice(0, n_inputs), slice(n_inputs, None)
    input_spectra = spectra[:, into, into]
    tiny = np.finfo(np.float64).tiny
    own = np.einsum("fii->fi", input_spectra).real  # each input's: they have units of their own
    regular = input_spectra + (COLLINEAR * own + tiny)[:, :, np.newaxis] * np.eye(n_inputs)
    gain = np.linalg.solve(regular, spectra[:, into, out])
    explained = np.einsum("fio,fio->fo", spectra[:, into, out].conj(), gain).real
    power = np.maximum(np.einsum("foo->fo", spectra[:, out, out]).real, tiny)
    bias = min(1.0, n_inputs / max(1.0, WORTH * n_averages))
    coherence: FloatArray = (explained / power - bias) / max(ROUNDED, 1.0 - bias)
    return np.clip(coherence, 0.0, 1.0) if clip else coherence
