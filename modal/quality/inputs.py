"""The channels against each other: what the inputs allow, copies, and outputs that answer late or too early.

The inputs must be enough, differ from one another, and move where the outputs do. Two channels that are one signal were
recorded twice, wired in parallel, or made from one another. An output that answers late, or before the input, belongs
to another recorder or to columns shifted against each other: the pulse response of a long observer says when an input
begins to act (`modal.preparation.delay`), and every output is first made late, so that one that runs ahead shows too.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.modes.mode import Choice
from modal.modes.response_synthesis import MeasuredFrf
from modal.modes.skew import LIKE, SKEWED
from modal.preparation.channel import FITTED_ROWS, MOST_ROWS, MOSTLY, SERIOUS, Finding, Level, named, spoken
from modal.preparation.delay import LEAST_DELAY, choose_input_delay, pulse_steps
from modal.preparation.kind import find_kind
from modal.preparation.steps import prepare
from modal.wording.text import percent, shorten
from okid.arrays import ROUNDED, TINY, FloatArray
from okid.errors import IdentificationError
from okid.excitation import DYNAMIC_RANGE, check_excitation
from okid.frequency_response import FEWEST_AVERAGES, AveragedSpectra
from okid.record import Record
from okid.rows import complete_rows

ALIKE = 0.95
"""Call two inputs alike in a line from this coherence: the share of one in the response depends on noise."""


HEAD_START = 16
"""Make the outputs so many samples late, so that one that runs ahead of an input shows."""

TIMED_TOGETHER = 8
"""Time so many outputs together: the observer of more would be shorter than the head start."""

AHEAD = 2
"""Say that an output runs ahead by so many samples: an input behind a filter or held by a converter explains one."""

EARLY = 0.25
"""Say that an output runs ahead where its answer before the input moves so much of what it moves at its steepest: a
blow has no power at high frequencies, and what an observer makes of that swells slowly towards it."""


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
    # ten sines: what a few samples and a handful of modes need
    order = int(min(20, max(1, longest // (4 * records[0].n_inputs))))
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
        elif message.startswith("the inputs hold too few"):
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
    if n < 2 or spectra.n_averages < FEWEST_AVERAGES:
        return []
    power = spectra.power[1:, :n]
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.abs(spectra.inputs[1:]) ** 2 / (power[:, :, np.newaxis] * power[:, np.newaxis])
    pairs = []
    for i in range(n):
        for j in range(i + 1, n):
            alike = np.nan_to_num(coherence[:, i, j]) > ALIKE
            share = min(float(power[alike, k].sum() / max(power[:, k].sum(), TINY)) for k in (i, j))
            whole = 1.0 - share < ROUNDED and bool((np.nan_to_num(coherence[:, i, j], nan=1.0) > 1.0 - ROUNDED).all())
            if share > MOSTLY and not whole:
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
    still = (power[:, :n] < DYNAMIC_RANGE * largest).all(axis=1)
    total = np.maximum(power[:, n:].sum(axis=0), np.finfo(float).tiny)
    # the little that an input does there may drive a resonance all the same: then the two are coherent
    foreign = still[:, np.newaxis] & ~(frf.multiple_coherence[1:] > MOSTLY)
    shares = np.where(foreign, power[:, n:], 0.0).sum(axis=0) / total
    which = np.flatnonzero(shares > SERIOUS)
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


def copy_findings(records: Sequence[Record]) -> list[Finding]:
    """Pairs with an output of which one is a multiple of the other; copies among inputs the excitation check names."""
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
            if abs(correlation) < 1.0 - ROUNDED:
                continue
            taken.add(j)
            found.append(_finding(roles[i], names[i], names[j], float(np.sign(correlation) * size[j] / size[i])))
    return found


def _finding(role: str, first: str, second: str, factor: float) -> Finding:
    equal = spoken(abs(factor)) == "1"
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
    """Complete rows from the start of each record, at most 65 536."""
    taken = []
    for record in records:
        rows = slice(0, max(8, MOST_ROWS // len(records)))
        block = np.concatenate([record.inputs[rows], record.outputs[rows]], axis=1)
        taken.append(block[complete_rows(block)])
    return np.concatenate(taken)


def timing_findings(records: Sequence[Record], moving: Sequence[int]) -> list[Finding]:
    """Outputs that begin to answer before the input, or all of them late.

    A channel that is shifted is so against every other: where there are several inputs and outputs, an output is ahead
    of two inputs, or two outputs of one. Other pairs are what chance makes of blows without power at high frequencies.

    Args:
        records: of one system.
        moving: indices of the outputs that are neither dead nor beyond use.
    """
    first = records[0]
    parts = [part for record in records if (part := _part(record)) is not None]
    if first.n_inputs == 0 or not parts:
        return []
    found: list[Finding] = []
    early: dict[int, FloatArray] = {}
    together: list[FloatArray] = []
    for start in range(0, len(moving), TIMED_TOGETHER):
        group = list(moving[start : start + TIMED_TOGETHER])
        lags = _lags(parts, group)
        if lags is None:
            continue
        together.append(lags)
        if lags.min() <= -AHEAD:
            each = [lags] if len(group) == 1 else [_lags(parts, [i]) for i in group]
            early |= {i: lag for i, lag in zip(group, each, strict=True) if lag is not None and lag.min() <= -AHEAD}
    found += [_ahead(first, i, lag) for i, lag in _told_twice(early, first.n_inputs, len(moving)).items()]
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


def choices_beforehand(records: Sequence[Record]) -> tuple[Choice, ...]:
    """What preparation would choose for the first rows of these records; nothing where it refuses them.

    Missing samples cost most of it, so fewer rows are enough there.
    """
    whole = all(record.complete_rows().all() for record in records)
    rows = max(1, (MOST_ROWS if whole else FITTED_ROWS) // len(records))
    parts = [record.samples(0, min(record.n_samples, rows)) for record in records]
    try:
        return prepare(parts, kind=find_kind(parts).kind).choices
    except IdentificationError:
        return ()


def skew_findings(record: Record, choices: Sequence[Choice]) -> list[Finding]:
    """Outputs that were found late against the others (`modal.modes.skew`).

    Args:
        record: one of those looked at, for its names.
        choices: what was chosen for them.
    """
    return [
        Finding(
            level="doubtful",
            what="late",
            where="outputs against one another",
            sentence=f"the motion shows in {choice.value} against the other outputs, {LIKE}: check the clocks and "
            "filters of these channels; the identification takes it off.",
            channels=tuple(name for name in record.output_names if f"{shorten(name)!r} " in choice.value),
        )
        for choice in choices
        if choice.what == SKEWED
    ]


def _told_twice(early: dict[int, FloatArray], n_inputs: int, n_outputs: int) -> dict[int, FloatArray]:
    """Lags of the pairs that share their input or their output with another pair ahead, zero elsewhere, by output."""
    if not early or n_inputs == 1 or n_outputs == 1:
        return early
    lags = np.stack(list(early.values()))
    ahead = lags <= -AHEAD
    twice = ahead & ((ahead.sum(axis=0) > 1) | (ahead.sum(axis=1) > 1)[:, np.newaxis])
    return {i: np.where(of, lag, 0.0) for i, lag, of in zip(early, lags, twice, strict=True) if of.any()}


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
    part = record.samples(0, min(record.n_samples, FITTED_ROWS))
    # a shorter record times nothing
    if part.n_samples < 400 or np.isnan(part.inputs).any() or np.isnan(part.outputs).all(axis=0).any():
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
    if (seen & (samples <= HEAD_START - AHEAD)).any():
        steps = pulse_steps(late)
        slow = (steps[: HEAD_START - AHEAD + 1].max(axis=0) < EARLY * steps.max(axis=0)).all(axis=0)
        samples = np.where(slow, np.maximum(samples, HEAD_START), samples) * seen
    return np.where(seen, samples - HEAD_START, 0).astype(np.float64) if seen.any() else None


def _later(values: FloatArray) -> FloatArray:
    return np.concatenate([np.zeros((HEAD_START, values.shape[1])), values[:-HEAD_START]])
