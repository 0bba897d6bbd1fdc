"""Faults that a look at single channels finds, and what the identification does about them before anything else.

A dead output is left out, spikes are left out sample by sample, and so is what is clipped where measured inputs tell
what lay beyond the limit; what cannot be mended (few levels, a frozen sensor) is said with its size. `modal.quality`
says the same, and more, before a fit.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal.modes.mode import Choice
from modal.preparation.amplitude import (
    clipped_samples,
    clipping_findings,
    constant_findings,
    resolution_findings,
    resolution_of,
    stuck_findings,
)
from modal.preparation.channel import (
    LEVELS,
    Channel,
    Finding,
    channels_of,
    named,
    sharp_samples,
    spike_findings,
    spikes_of,
    spoken,
    without_spikes,
)
from modal.preparation.kind import KindFound, acts, rings_down
from modal.wording.text import counted, percent
from okid.arrays import BoolArray
from okid.errors import InsufficientDataError
from okid.frequency_response import FrequencyResponse
from okid.gram import lag_gram
from okid.record import Record
from okid.rows import as_records
from okid.scaling import channel_scaling

FINEST = 1e-4
"""Take no output for finer than this share of its size, 13 bits of what moves: sensors and converters are not."""
ROWS_A_NUMBER = 10
"""or fewer where there are not so many rows for each of them."""
MOST_TOLD = 4
"""Tell the same fault of so many channels, and count the others."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Mended:
    """Records without dead outputs, spikes missing."""

    records: tuple[Record, ...]
    warnings: tuple[str, ...]


def mended(records: Sequence[Record], *, driven: bool = False) -> Mended:
    """Leave out what is no measurement, and say so.

    Args:
        records: of one system.
        driven: by inputs that were measured throughout: a free run bridges what is clipped. A blow or a decay has all
            that it says at its peaks, and without inputs peaks are predicted by others that are clipped.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> tip = np.convolve(rng.standard_normal(4000), [1.0, 1.6, 1.5, 0.8])[:4000]
        >>> found = mended([Record([], np.column_stack([tip, np.ones(4000)]), 0.01, output_names=["tip", "root"])])
        >>> found.records[0].output_names, found.warnings
        (('tip',), ("Output 'root' never moves (always 1): it is dead, unplugged or not recorded; left out.",))
    """
    kept, dead = living(records)
    told: dict[str, list[str]] = {"dead": dead}
    masks = [np.zeros(record.outputs.shape, dtype=np.bool_) for record in kept]
    for channel, resolution, sharp in _looked(kept):
        spiked, gone = _spikes(channel, resolution, sharp, kept)
        if spiked:
            told.setdefault("spikes", []).append(spiked)
        left_out = driven and channel.role == "output"
        limited = without_spikes(channel, [(i, int(k)) for i, own in enumerate(gone) for k in np.flatnonzero(own)])
        clipped = clipping_findings(limited, left_out=left_out)
        if clipped and left_out:
            gone = [one | more for one, more in zip(gone, clipped_samples(limited), strict=True)]
        if channel.role == "output":
            for mask, own in zip(masks, gone, strict=True):
                mask[:, channel.index] = own
        more = [*clipped, *resolution_findings(channel, resolution)]
        more += [] if clipped else stuck_findings(channel, kept, resolution)
        for f in more:
            if f.level != "note":
                told.setdefault(f.what, []).append(f"{f.sentence[0].upper()}{f.sentence[1:]}")
    if any(mask.any() for mask in masks):
        kept = tuple(
            replace(record, outputs=np.where(mask, np.nan, record.outputs)) if mask.any() else record
            for record, mask in zip(kept, masks, strict=True)
        )
    return Mended(records=kept, warnings=tuple(_told(told)))


def no_finer_than_sensors(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[Choice, ...]]:
    """Ambient outputs with the noise of a good sensor, where their past foretells a combination of them more finely.

    What fewer forces drive than there are sensors, or forces behind a steep filter, has combinations without any
    innovation once there is no noise: no model with noise is likely then, and one that fits rounding is sure of it all.

    Example:
        >>> tip = np.convolve(np.random.default_rng(0).standard_normal(4000), [1.0, 1.6, 1.5, 0.8])
        >>> noisy, choices = no_finer_than_sensors([Record([], np.column_stack([tip, 2.0 * tip]), 0.01)])
        >>> choices[0].what, bool(np.ptp(noisy[0].outputs[:, 1] - 2.0 * noisy[0].outputs[:, 0]) > 0.0)
        ('noise floor', True)
    """
    scaling, q = channel_scaling(records), records[0].n_outputs
    n_rows = sum(int(record.complete_rows().sum()) for record in records)
    try:
        gram = lag_gram(records, max(1, min(32, n_rows // (ROWS_A_NUMBER * q))), scaling=scaling)
    except InsufficientDataError:
        return tuple(records), ()
    if gram.n_rows <= 2 * q * gram.order:  # so much is missing that the past of hardly a row is whole
        return tuple(records), ()
    level = gram.matrix[1:, 0] / gram.n_rows
    covariance = gram.matrix[1:, 1:] / gram.n_rows - np.outer(level, level)
    foretold = np.linalg.lstsq(covariance[q:, q:], covariance[q:, :q], rcond=FINEST**3)[0].T @ covariance[q:, :q]
    least = float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance[:q, :q] - foretold)[0])))
    if least >= FINEST:
        return tuple(records), ()
    rng = np.random.default_rng(0)
    noisy = tuple(
        replace(
            record,
            outputs=record.outputs + FINEST * scaling.output_scale * rng.standard_normal(record.outputs.shape),
        )
        for record in records
    )
    reason = (
        f"their past foretells a combination of the outputs to {least:.0e} of their size, which no sensor measures: "
        "without noise of that size nothing tells what is certain from rounding"
    )
    return noisy, (Choice(what="noise floor", value=f"{FINEST:g} of each output", reason=reason),)


def free_of_clipping(
    records: Sequence[Record], kind: KindFound, clean: Sequence[Record]
) -> tuple[tuple[Record, ...], KindFound]:
    """What is struck or rings down without its clipped peaks, which make harmonics that are found again in every half.

    So is what seemed ambient, an event and what it makes ring whose input was not measured, where all records ring down
    once no output is clipped.

    Records that were not clipped are enough where every input moves in them; else each record is the decay that is left
    once no output is clipped and no input acts. Nothing changes where nothing is clipped, or where nothing is left.
    A spike hides neither limits nor rest: `clean` are the records as they are mended.
    """
    names, ends = _last_clipped(clean)
    if not any(ends):
        return tuple(records), kind
    whole = tuple(record for record, end in zip(records, ends, strict=True) if not end)
    head = f"{counted(len(names)).capitalize()} output{'s are' if len(names) > 1 else ' is'} clipped ({names[0]}"
    head += " and others): " if len(names) > 1 else "): "
    if kind.kind == "transient" and whole and np.any([one.inputs.any(axis=0) for one in whole], axis=0).all():
        text = f"{head}of {len(records)} records {len(records) - len(whole)} in which this happens are left out."
        return whole, replace(kind, warnings=(*kind.warnings, text))
    lasts = [last for _, last in acts(records)] if kind.kind == "transient" else kind.starts or [0] * len(records)
    starts = [max(end, last) for end, last in zip(ends, lasts, strict=True)]
    left = [
        (one, first)
        for one, seen, first in zip(records, clean, starts, strict=True)
        if rings_down(seen.outputs[first:])
    ]
    if not left or (kind.kind == "ambient" and len(left) < len(records)):
        return tuple(records), kind
    text = (
        f"{head}only the free motion after the last clipped sample is used, as a decay, so nothing is known of modal "
        "masses; measure again with a larger range."
    )
    decay = Choice(what="record kind", value="decay", reason=f"{kind.choice.reason}; outputs are clipped before")
    found = KindFound(
        kind="decay", choice=decay, warnings=(*kind.warnings, text), starts=tuple(first for _, first in left)
    )
    return tuple(one.select(inputs=[]) for one, _ in left), found


def _last_clipped(records: Sequence[Record]) -> tuple[list[str], list[int]]:
    """Names of the outputs that are clipped, and the row of each record after the last sample in which one is."""
    names, ends = [], [0] * len(records)
    for channel in channels_of(records, channel_scaling(records)):
        if channel.role == "input":
            continue
        rows = [np.flatnonzero(mask) for mask in clipped_samples(channel)]
        if any(row.size for row in rows):
            names.append(named(channel.name))
            ends = [max(end, *(row[-1:] + 1).tolist(), end) for end, row in zip(ends, rows, strict=True)]
    return names, ends


def _told(faults: Mapping[str, Sequence[str]]) -> Iterator[str]:
    for what, sentences in faults.items():
        yield from sentences[:MOST_TOLD]
        if len(sentences) > MOST_TOLD:
            yield f"The same ({what}) is true of {counted(len(sentences) - MOST_TOLD)} more channels."


def _spikes(
    channel: Channel, resolution: float, sharp: Sequence[BoolArray], records: Sequence[Record]
) -> tuple[str, list[BoolArray]]:
    """A sentence on the spikes of a channel, and where they are; nothing where they are not worth one."""
    found, largest = spikes_of(channel, resolution, sharp)
    spiked = spike_findings(channel, resolution, sharp) if found else []
    masks = [np.zeros(record.n_samples, dtype=np.bool_) for record in records]
    if all(finding.level == "note" for finding in spiked):
        return "", masks
    for number, k in found:
        masks[number][k] = True
    fate = "left out" if channel.role == "output" else "an input must be whole, so they stay"
    sentence = (
        f"{channel.role.capitalize()} {named(channel.name)} has {len(found)} spike{'s' * (len(found) > 1)} "
        f"({percent(len(found) / channel.n_samples)} of the samples, up to {spoken(largest / channel.std)} "
        f"standard deviations off the curve through the neighbours): {fate}."
    )
    return sentence, masks


def spoiled_channels(records: Record | Sequence[Record]) -> tuple[Finding, ...]:
    """What `modal.check_quality` finds of dead, clipped and spiked channels, without the price of spectra."""
    findings: list[Finding] = []
    for channel, resolution, sharp in _looked(as_records(records)):
        limited = without_spikes(channel, spikes_of(channel, resolution, sharp)[0])
        findings += [*constant_findings(channel), *clipping_findings(limited)]
        findings += spike_findings(channel, resolution, sharp)
    return tuple(sorted(findings, key=lambda finding: LEVELS.index(finding.level)))


def _looked(records: Sequence[Record]) -> Iterator[tuple[Channel, float, tuple[BoolArray, ...]]]:
    """Each channel with its resolution and where the inputs before it move sharply."""
    sharp = tuple(np.zeros(record.n_samples, dtype=np.bool_) for record in records)
    for channel in channels_of(records, channel_scaling(records)):
        resolution = resolution_of(channel)
        yield channel, resolution, sharp
        if channel.role == "input":
            own = sharp_samples(channel)
            sharp = tuple(mask | more for mask, more in zip(sharp, own, strict=True))


def living(records: Sequence[Record]) -> tuple[tuple[Record, ...], list[str]]:
    """The records without outputs that stand at one value in all of them, or hold none, as long as one output moves.

    Example:
        >>> living([Record([], [[1.0, np.nan], [2.0, np.nan]], 0.01, output_names=["tip", "root"])])[1]
        ["Output 'root' holds no number: it was not recorded; left out."]
    """
    first = records[0]
    low = np.fmin.reduce([np.fmin.reduce(record.outputs, axis=0) for record in records], axis=0)
    high = np.fmax.reduce([np.fmax.reduce(record.outputs, axis=0) for record in records], axis=0)
    moves = low < high
    if moves.all() or not moves.any():
        return tuple(records), []
    words = [
        f"Output {named(first.output_names[i])} holds no number: it was not recorded; left out."
        if np.isnan(low[i])
        else f"Output {named(first.output_names[i])} never moves (always {low[i]:.6g}): it is dead, unplugged or not "
        "recorded; left out."
        for i in np.flatnonzero(~moves)
    ]
    return tuple(record.select(outputs=np.flatnonzero(moves).tolist()) for record in records), words


def living_response(table: FrequencyResponse) -> tuple[FrequencyResponse, list[str]]:
    """The table without outputs and inputs whose responses are 0 at every line, as long as one is not; and why.

    Example:
        >>> table, words = living_response(FrequencyResponse([[1.0, 0.0], [1j, 0.0], [-1.0, 0.0]], [0.0, 1.0, 2.0]))
        >>> table.output_names, words
        (('output_0',), ["Responses of output 'output_1' are 0 at every line: dead or not recorded; left out."])
    """
    moves = np.nan_to_num(table.response) != 0
    outputs, inputs = moves.any(axis=(0, 2)), moves.any(axis=(0, 1))
    if not moves.any() or (outputs.all() and inputs.all()):
        return table, []
    words = [
        f"Responses {to} {role} {named(names[i])} are 0 at every line: dead or not recorded; left out."
        for to, role, names, alive in (
            ("of", "output", table.output_names, outputs),
            ("to", "input", table.input_names, inputs),
        )
        for i in np.flatnonzero(~alive)
    ]
    kept, driven = np.flatnonzero(outputs), np.flatnonzero(inputs)
    coherence = table.coherence
    if coherence is not None:
        coherence = coherence[:, kept] if coherence.ndim == 2 else coherence[:, kept][:, :, driven]
    return replace(
        table,
        response=table.response[:, kept][:, :, driven],
        coherence=coherence,
        output_names=tuple(table.output_names[i] for i in kept),
        output_units=tuple(table.output_units[i] for i in kept),
        input_names=tuple(table.input_names[i] for i in driven),
        input_units=tuple(table.input_units[i] for i in driven),
    ), words


BACKWARDS = 3.0
"""Take a table for conjugated where its pulse responses hold this many times more in the second half of their lags than
in the first. Noise has as much in both: lines without a force, which outweigh a table, made 1.6 times at most of 6."""


def forward_response(table: FrequencyResponse) -> tuple[FrequencyResponse, list[str]]:
    """The table, or its conjugate where outputs would move before the inputs do; and a sentence.

    A table of motion as exp(-2 pi j f t) is the conjugate of ours, and its pulse responses run backwards. Poles that
    decay fit none of it: damping was 0, and the structure said to be not linear.

    Example:
        >>> lines = np.linspace(0.0, 50.0, 101)
        >>> table = FrequencyResponse(1 / (20.0**2 - lines**2 - 1j * 2.0 * lines), lines)
        >>> forward, words = forward_response(table)
        >>> forward.response[40, 0, 0].imag < 0.0 < table.response[40, 0, 0].imag, len(words)
        (np.True_, 1)
    """
    f = table.frequencies
    grid = np.linspace(0.0, f[-1], f.size)
    halves = np.zeros(2)
    for responses in table.response.reshape(f.size, -1).T:
        known = np.isfinite(responses)
        pulse = np.fft.irfft(np.interp(grid, f[known], responses[known], left=0.0))
        power = np.square(pulse[1:]) / max(float(np.square(pulse).sum()), np.finfo(float).tiny)
        halves += [power[: power.size // 2].sum(), power[power.size - power.size // 2 :].sum()]
    if not halves[1] > BACKWARDS * halves[0]:
        return table, []
    sentence = (
        f"{100 * halves[1] / halves.sum():.0f} % of the pulse responses lie before the pulse: the responses are those "
        "of motion as exp(-2 pi j f t), and their conjugates are used; export them with exp(+2 pi j f t)."
    )
    return replace(table, response=table.response.conj()), [sentence]
