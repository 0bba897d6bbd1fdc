"""What the inputs allow: enough of them, different from one another, moving where the outputs do."""

from collections.abc import Sequence

import numpy as np

from modal.modes.response_synthesis import AveragedSpectra, MeasuredFrf
from modal.quality.channel import named, spoken
from modal.quality.findings import Finding, Level
from modal.wording.numbers import percent
from okid.arrays import TINY
from okid.errors import IdentificationError
from okid.excitation import check_excitation
from okid.record import Record

__all__ = ["excitation_findings", "together_findings"]

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
