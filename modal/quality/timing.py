"""An output that answers late, or before the input: channels of two recorders, or columns shifted against each other.

The pulse response of a long observer says when an input begins to act (`modal.preparation.delay`). Every output is first made
late by sixteen samples, so that one that runs ahead shows as well.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modal.preparation.delay import LEAST_DELAY, choose_input_delay
from modal.quality.channel import named, spoken
from modal.quality.findings import Finding
from okid.arrays import FloatArray
from okid.errors import IdentificationError
from okid.record import Record

__all__ = ["timing_findings"]

HEAD_START = 16
MOST_ROWS = 8000
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
    part = record.samples(0, min(record.n_samples, MOST_ROWS))
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
