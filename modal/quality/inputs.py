"""What the inputs allow: enough of them, different from one another, moving where the outputs do.

Two channels that are one signal: recorded twice, wired in parallel, or made from one another.

An output that answers late, or before the input: channels of two recorders, or columns shifted against each other.

The pulse response of a long observer says when an input begins to act (`modal.preparation.delay`). Every output is
first made late by sixteen samples, so that one that runs ahead shows as well.

Hammer tests: double hits, where the force spectrum ends, and whether the response has died out at the end.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from modal.modes.response_synthesis import AveragedSpectra, MeasuredFrf
from modal.preparation.delay import LEAST_DELAY, choose_input_delay
from modal.quality.findings import MOST_SPANS, Channel, Finding, Level, Span, named, spoken, where_found
from modal.wording.numbers import percent
from okid.arrays import TINY, FloatArray
from okid.errors import IdentificationError
from okid.excitation import check_excitation
from okid.record import Record
from okid.rows import complete_rows, runs_of

__all__ = [
    "copy_findings",
    "excitation_findings",
    "hit_findings",
    "hits_of",
    "is_hammer",
    "ring_findings",
    "timing_findings",
    "together_findings",
]

NEEDED_ORDER = 20
"""Persistent excitation of ten sines: what an observer of few samples and a handful of modes need at least."""
MOST_ROWS = 200_000
ALIKE = 0.95
"""Coherence between inputs from which the share of one in the response depends on noise."""
ALIKE_SHARE = 0.5
"""Of an input's power that lies in such lines."""
ENOUGH_AVERAGES = 10
UNDRIVEN = 1e-6
"""Power of an input relative to its largest line, below which it does not drive (60 dB)."""
UNDRIVEN_SHARE = 0.05
COHERENT = 0.5


def excitation_findings(records: Sequence[Record]) -> list[Finding]:
    """What `check_excitation` says, each with its level; constant inputs are named elsewhere."""
    if records[0].n_inputs == 0:
        return [
            Finding(
                level="note",
                what="no input",
                where="all records",
                sentence="no input was measured: frequencies, damping ratios and shapes can be identified, modal "
                "masses and frequency responses cannot, and a line may be that of a machine.",
            )
        ]
    rows = max(1, MOST_ROWS // len(records))
    part = [record.samples(0, min(record.n_samples, max(rows, record.n_inputs))) for record in records]
    longest = max(record.n_samples for record in part)
    order = int(min(NEEDED_ORDER, max(1, longest // (4 * records[0].n_inputs))))
    try:
        check = check_excitation(part, order=order)
    except IdentificationError:
        return []
    found: list[Finding] = []
    if sum("never moves" in message for message in check.messages) == records[0].n_inputs:
        return []  # all that could be said follows from it
    alike = any("told apart; leave one out" in message for message in check.messages)
    for message in check.messages:
        level: Level
        if "never moves" in message:
            continue
        if "the same signal" in message or "linearly dependent" in message:
            level, what = "bad", "inputs alike"
        elif alike and message.startswith("the inputs"):  # follows from it
            continue
        elif message.startswith("the inputs are persistently"):
            level, what = "doubtful", "poor excitation"
        elif message.startswith("the inputs of"):
            level, what = "note", "poor excitation"
        else:
            level, what = "note", "band of the input"
        found.append(Finding(level=level, what=what, where="inputs", sentence=message))
    return found


def together_findings(record: Record, spectra: AveragedSpectra, frf: MeasuredFrf | None) -> list[Finding]:
    """Inputs that move together, so that their effects cannot be told apart; and motion where no input drives.

    Args:
        record: any of the records, for names.
        spectra: averaged over the records.
        frf: with coherences, from the same; None where there are too few segments.
    """
    if record.n_inputs == 0:
        return []
    undriven = [] if frf is None else _undriven(record, spectra, frf)
    return [*_alike(record, spectra), *undriven]


def _alike(record: Record, spectra: AveragedSpectra) -> list[Finding]:
    n = record.n_inputs
    if n < 2 or spectra.n_averages < ENOUGH_AVERAGES:
        return []
    power = spectra.power[1:, :n]
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.abs(spectra.inputs[1:]) ** 2 / (power[:, :, np.newaxis] * power[:, np.newaxis])
    pairs = []
    for i in range(n):
        for j in range(i + 1, n):
            alike = np.nan_to_num(coherence[:, i, j]) > ALIKE
            share = min(float(power[alike, k].sum() / max(power[:, k].sum(), TINY)) for k in (i, j))
            whole = 1.0 - share < 1e-9 and bool((np.nan_to_num(coherence[:, i, j], nan=1.0) > 1.0 - 1e-9).all())
            if share > ALIKE_SHARE and not whole:
                pairs.append((share, i, j))
    if not pairs:
        return []
    share, i, j = max(pairs)
    more = f", and {len(pairs) - 1} more pair{'s' * (len(pairs) > 2)} of inputs do" if len(pairs) > 1 else ""
    return [
        Finding(
            level="doubtful",
            what="inputs alike",
            where=named((record.input_names[i], record.input_names[j])),
            sentence=f"inputs {named((record.input_names[i], record.input_names[j]))} move together (coherence above "
            f"{ALIKE} in {percent(share)} of their power{more}): what each of them does can hardly be told apart, the "
            "sum can; drive them with signals of their own, one after the other, or leave one out.",
            channels=(record.input_names[i], record.input_names[j]),
            share=share,
        )
    ]


def _undriven(record: Record, spectra: AveragedSpectra, frf: MeasuredFrf) -> list[Finding]:
    """Outputs that move where no input does: something else drives them, or a nonlinearity."""
    n = record.n_inputs
    power = spectra.power[1:]
    largest = power[:, :n].max(axis=0)
    still = (power[:, :n] < UNDRIVEN * largest).all(axis=1)
    total = np.maximum(power[:, n:].sum(axis=0), np.finfo(float).tiny)
    # the little that an input does there may drive a resonance all the same: then the two are coherent
    foreign = still[:, np.newaxis] & ~(frf.multiple_coherence[1:] > COHERENT)
    shares = np.where(foreign, power[:, n:], 0.0).sum(axis=0) / total
    which = np.flatnonzero(shares > UNDRIVEN_SHARE)
    if which.size == 0:
        return []
    names = tuple(record.output_names[i] for i in which)
    worst = int(shares.argmax())
    strongest = float(spectra.frequencies[1 + int(np.where(foreign[:, worst], power[:, n + worst], 0.0).argmax())])
    return [
        Finding(
            level="doubtful",
            what="undriven motion",
            where=named(names),
            sentence=f"{percent(float(shares[worst]))} of the power of output {named(record.output_names[worst])} "
            f"lies where no input moves (strongest at {spoken(strongest)} Hz): noise, a force that was not measured, "
            "or a nonlinearity that makes new frequencies; look at the set-up, and use an input that covers that "
            "band.",
            channels=names,
            share=float(shares[worst]),
        )
    ]


EXACT = 1e-9
"""One minus the modulus of the correlation: residual of 4e-5 of the motion, as left by rounding to five digits."""
MOST_ROWS_COMPARED = 100_000
_SAME_FACTOR = 1e-4


def copy_findings(records: Sequence[Record]) -> list[Finding]:
    """Pairs with an output of which one is a multiple of the other; copies among inputs the excitation check names.

    Args:
        records: of one system.
    """
    values = _some_rows(records)
    if len(values) < 8:
        return []
    n_inputs = records[0].n_inputs
    names = (*records[0].input_names, *records[0].output_names)
    roles = ("input",) * n_inputs + ("output",) * records[0].n_outputs
    values = values - values.mean(axis=0)
    size = np.sqrt(np.mean(values**2, axis=0))
    gram = values.T @ values / len(values)
    moving = size > 0.0
    found: list[Finding] = []
    taken: set[int] = set()
    for j in range(n_inputs, len(names)):
        for i in range(j):
            if not (moving[i] and moving[j]) or j in taken:
                continue
            correlation = gram[i, j] / (size[i] * size[j])
            if abs(correlation) < 1.0 - EXACT:
                continue
            taken.add(j)
            found.append(_finding(roles[i], names[i], names[j], float(np.sign(correlation) * size[j] / size[i])))
    return found


def _finding(role: str, first: str, second: str, factor: float) -> Finding:
    equal = abs(abs(factor) - 1.0) < _SAME_FACTOR
    sign = "the negative of" if factor < 0 and equal else "" if equal else f"{spoken(factor)} times"
    what = f"is {sign} {role} {named(first)}".replace("  ", " ") if sign else f"is the same as {role} {named(first)}"
    return Finding(
        level="bad" if equal else "doubtful",
        what="copied channel",
        where=named((first, second)),
        sentence=f"output {named(second)} {what}, sample by sample: one signal was recorded twice, so it says nothing "
        "new and sets a false shape; look at the wiring and leave one of them out.",
        channels=(first, second),
    )


def _some_rows(records: Sequence[Record]) -> FloatArray:
    """Complete rows from the start of each record, at most 100 000."""
    taken = []
    for record in records:
        rows = slice(0, max(8, MOST_ROWS_COMPARED // len(records)))
        block = np.concatenate([record.inputs[rows], record.outputs[rows]], axis=1)
        taken.append(block[complete_rows(block)])
    return np.concatenate(taken)


HEAD_START = 16
MOST_ROWS_TIMED = 8000
GROUP = 8
"""Outputs looked at together: the observer of more would be shorter than the head start."""
FEWEST_ROWS = 400
AHEAD = 2
"""Samples by which an output must run ahead: an input measured behind a filter or held by a converter explains one."""


def timing_findings(records: Sequence[Record], moving: Sequence[int]) -> list[Finding]:
    """Outputs that begin to answer before the input, or all of them late.

    Args:
        records: of one system.
        moving: indices of the outputs that are neither dead nor beyond use.
    """
    first = records[0]
    parts = [part for record in records if (part := _part(record)) is not None]
    if first.n_inputs == 0 or not parts:
        return []
    found: list[Finding] = []
    together: list[FloatArray] = []
    for start in range(0, len(moving), GROUP):
        group = list(moving[start : start + GROUP])
        lags = _lags(parts, group)
        if lags is None:
            continue
        together.append(lags)
        if lags.min() <= -AHEAD:
            each = [lags] if len(group) == 1 else [_lags(parts, [i]) for i in group]
            found += [
                _ahead(first, i, lag)
                for i, lag in zip(group, each, strict=True)
                if lag is not None and lag.min() <= -AHEAD
            ]
    late = min((int(lags.min()) for lags in together), default=0)
    if late >= LEAST_DELAY:
        found.append(
            Finding(
                level="note",
                what="delay",
                where="all outputs",
                sentence=f"the outputs begin to answer {late} samples ({spoken(late * first.dt)} s) after the "
                "inputs: a "
                "transport delay, or recorders that were started one after the other; the identification takes it off.",
            )
        )
    return found


def _ahead(record: Record, output: int, lags: FloatArray) -> Finding:
    name, which = record.output_names[output], record.input_names[int(lags.argmin())]
    early = -int(lags.min())
    return Finding(
        level="bad",
        what="runs ahead",
        where=named(name),
        sentence=f"output {named(name)} begins to answer {early} samples ({spoken(early * record.dt)} s) before input "
        f"{named(which)}: no system does; the channels are shifted against each other or swapped, or that input is an "
        "answer itself; shift or swap them.",
        channels=(name, which),
    )


def _part(record: Record) -> Record | None:
    """The first rows of a record, means removed; None where it is short or an input is missing."""
    part = record.samples(0, min(record.n_samples, MOST_ROWS_TIMED))
    if part.n_samples < FEWEST_ROWS or np.isnan(part.inputs).any() or np.isnan(part.outputs).all(axis=0).any():
        return None
    return part.detrended(0)


def _lags(parts: Sequence[Record], outputs: Sequence[int]) -> FloatArray | None:
    """Samples after which each input begins to act on any of the outputs, negative for before; None where not known."""
    late = [
        replace(chosen, outputs=_later(chosen.outputs))
        for part in parts
        for chosen in (part.select(outputs=list(outputs)),)
    ]
    late = [part.samples(HEAD_START) for part in late]
    try:
        samples = np.array(choose_input_delay(late).samples)
    except (IdentificationError, np.linalg.LinAlgError):
        return None
    # zero means that nothing is known: the leading lags are not empty, or the input does nothing
    seen = samples > 0
    return np.where(seen, samples - HEAD_START, 0).astype(np.float64) if seen.any() else None


def _later(values: FloatArray) -> FloatArray:
    return np.concatenate([np.zeros((HEAD_START, values.shape[1])), values[:-HEAD_START]])


QUIET = 0.05
"""Of the largest force: a hammer is quieter than this ..."""
QUIET_SHARE = 0.95
"""... for this share of the time, and the channel carries no noise of that size."""
ONE_SIDED = 0.3
"""Of the largest force: a hammer pushes and does not pull; what swings to both sides is a burst or an earthquake."""
HIT = 0.1
"""Of the largest force: what counts as a hit."""
DOUBLE = 20.0
"""Widths of a hit within which the next one is a double hit."""
FALLEN = 0.01
"""Of the largest density of the force: 20 dB down, the modes above are hardly driven."""
RINGING = 0.1
"""Of the largest level of the response that is left at the end."""
N_BLOCKS = 50


def is_hammer(channel: Channel) -> bool:
    """Whether an input is at rest but for short pulses, each of them many samples apart."""
    if channel.role == "output" or channel.std == 0.0:
        return False
    rest = _rest(channel)
    up, down = channel.largest - rest, rest - channel.smallest
    largest = max(up, down)
    if min(up, down) > ONE_SIDED * largest:
        return False
    quiet = sum(int((np.abs(part - rest) < QUIET * largest).sum()) for part in channel.parts)
    if quiet < QUIET_SHARE * (channel.n_samples - channel.n_missing):
        return False
    hits = hits_of(channel)
    return 0 < sum(len(some) for some in hits) <= max(1, channel.n_samples // 100)


def hits_of(channel: Channel) -> tuple[list[tuple[int, int]], ...]:
    """(start, stop) of each hit, a record; parts of one pulse that are closer than their width are one hit."""
    rest = _rest(channel)
    largest = max(channel.largest - rest, rest - channel.smallest)
    found = []
    for part in channel.parts:
        hits: list[tuple[int, int]] = []
        for start, stop in runs_of(np.abs(part - rest) > HIT * largest):
            if hits and start - hits[-1][1] < max(2, hits[-1][1] - hits[-1][0]):
                hits[-1] = (hits[-1][0], stop)
            else:
                hits.append((start, stop))
        found.append(hits)
    return tuple(found)


def hit_findings(channel: Channel, frequencies: FloatArray, density: FloatArray, n_records: int) -> list[Finding]:
    """Double hits, and the end of the force spectrum.

    Args:
        channel: a hammer.
        frequencies: (n_frequencies,) [Hz]; empty where no spectrum could be made.
        density: (n_frequencies,) of this channel.
        n_records: number of records.
    """
    found: list[Finding] = []
    doubles: list[Span] = []
    gap = 0.0
    for number, hits in enumerate(hits_of(channel)):
        for (start, stop), (again, end) in pairwise(hits):
            if again - start < DOUBLE * max(2, stop - start, end - again):
                doubles.append(channel.span(number, start, end))
                gap = gap or (again - start) * channel.dt
    if doubles:
        found.append(
            Finding(
                level="note",
                what="double hit",
                where=where_found(channel.name, doubles, n_records),
                sentence=f"hammer {named(channel.name)} struck twice {len(doubles)} time{'s' * (len(doubles) > 1)}, "
                f"first at {doubles[0][1]:.6g} s with {spoken(gap)} s between: the force spectrum then has dips every "
                f"{spoken(1 / gap)} Hz, which spoil quotients of spectra; the identification uses the force as it was "
                "and stands it.",
                channels=(channel.name,),
                spans=tuple(doubles[:MOST_SPANS]),
            )
        )
    if frequencies.size > 8:
        fallen = np.flatnonzero(density[1:] < FALLEN * density[1:].max())
        if fallen.size and frequencies[1 + fallen[0]] < 0.9 * frequencies[-1]:
            found.append(
                Finding(
                    level="note",
                    what="force spectrum",
                    where=named(channel.name),
                    sentence=f"the force spectrum of hammer {named(channel.name)} falls below a hundredth (-20 dB) of "
                    f"its largest density at {spoken(float(frequencies[1 + fallen[0]]))} Hz: modes above are hardly "
                    "driven; a harder tip reaches further.",
                    channels=(channel.name,),
                )
            )
    return found


def ring_findings(
    channel: Channel, hammers: Sequence[tuple[list[tuple[int, int]], ...]], n_records: int
) -> list[Finding]:
    """An output that still rings when the record ends.

    Args:
        channel: an output.
        hammers: hits of each hammer.
        n_records: number of records.
    """
    if channel.role == "input" or channel.std == 0.0 or not hammers:
        return []
    worst = 0.0
    for number, part in enumerate(channel.parts):
        last = max((hits[number][-1][1] for hits in hammers if hits[number]), default=None)
        if last is None or part.size - last < 2 * N_BLOCKS:
            continue
        size = (part.size - last) // N_BLOCKS
        blocks = part[part.size - N_BLOCKS * size :].reshape(N_BLOCKS, size) - channel.mean
        there = ~np.isnan(blocks)
        levels = np.sqrt(np.where(there, blocks**2, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1))
        worst = max(worst, float(levels[-2:].mean() / max(levels.max(), np.finfo(float).tiny)))
    if worst <= RINGING:
        return []
    return [
        Finding(
            level="note",
            what="still ringing",
            where=where_found(channel.name, (), n_records),
            sentence=f"output {named(channel.name)} still rings at {percent(worst)} of its largest level when the "
            "record ends: spectra of it leak, and an exponential window would add damping that has to be taken off "
            "again; the identification works in time and needs no window, but a longer record makes damping sharper.",
            channels=(channel.name,),
            share=worst,
        )
    ]


def _rest(channel: Channel) -> float:
    """Where the hammer rests: the median of the longest record."""
    return float(np.nanmedian(max(channel.parts, key=len)[: 1 << 20]))
