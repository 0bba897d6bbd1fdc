"""Samples without a number: how many, in how many gaps, and what they leave to fit to."""

from collections.abc import Sequence

import numpy as np

from modal.quality.channel import MOST_SPANS, Channel, named, spoken, when, where_found
from modal.quality.findings import Finding
from modal.wording.numbers import percent
from okid.record import Record
from okid.rows import runs_of, usable_rows

__all__ = ["gap_findings", "missing_findings"]

MANY = 0.05
OBSERVER_ORDER = 50
"""Past samples that an observer uses, about: a row counts when it and they are complete."""
FEW_ROWS = 0.5
TOO_FEW_ROWS = 0.1


def missing_findings(channel: Channel, n_records: int) -> list[Finding]:
    """Missing samples of one channel."""
    if channel.n_missing == 0:
        return []
    gaps = [(number, *run) for number, part in enumerate(channel.parts) for run in runs_of(np.isnan(part))]
    longest = max(stop - start for _, start, stop in gaps)
    spans = tuple(channel.span(*gap) for gap in gaps[:MOST_SPANS])
    share = channel.n_missing / channel.n_samples
    several = f"{len(gaps)} gaps of at most" if len(gaps) > 1 else "one gap of"
    return [
        Finding(
            level="bad" if share > 0.5 else "doubtful" if share > MANY else "note",
            what="missing samples",
            where=where_found(channel.name, spans, n_records),
            sentence=f"{channel.role} {named(channel.name)} lacks {percent(share)} of its samples, in {several} "
            f"{spoken(longest * channel.dt)} s: the rows they touch are left out"
            + ("; leave the channel out if the others matter more." if share > MANY else "."),
            channels=(channel.name,),
            spans=spans,
            share=share,
        )
    ]


def gap_findings(records: Sequence[Record]) -> list[Finding]:
    """Gaps of all channels together that leave few rows with a complete past."""
    n_usable = n_rows = 0
    for record in records:
        complete = record.complete_rows()
        order = min(OBSERVER_ORDER, record.n_samples // 4)
        n_usable += int(usable_rows(complete, order).sum())
        n_rows += record.n_samples - order
    share = n_usable / max(1, n_rows)
    if share >= FEW_ROWS:
        return []
    return [
        Finding(
            level="bad" if share < TOO_FEW_ROWS else "doubtful",
            what="missing samples",
            where=when((), len(records)),
            sentence=f"gaps leave {percent(share)} of the rows with {OBSERVER_ORDER} whole samples before them, which "
            "is what a fit can use: leave out the channels with the most gaps, or fill gaps of a few samples.",
            share=1.0 - share,
        )
    ]
