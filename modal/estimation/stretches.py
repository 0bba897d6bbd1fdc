"""Which rows are held out, and which stretches of long records are run freely to score a candidate.

Every row counts in the fit. A free run through a million samples for each of a thousand candidates would take hours and
say no more than one through thirty thousand, so long records are scored on stretches spread evenly over them. Each
stretch holds ten blocks; its first block never counts in the score, so that the initial state, which is fitted there
too, is known before the first row that does.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from okid.arrays import BoolArray
from okid.folds import interleaved_folds, whole_record_folds
from okid.record import Record

__all__ = ["Stretch", "folds_of", "is_long", "stretches_of"]

LONGEST_SCORED = 30_000
"""Samples that are run freely for each candidate; shorter data are run whole."""
STRETCH = 10_000
"""Samples of one stretch."""
BLOCKS = 10
MANY_RECORDS = 4
"""Records from which on whole ones are held out,"""
ALIKE = 0.5
"""if the shortest is at least this share of the longest,"""
LEAST_TRAINED = 0.01
"""and if each input keeps this share of its power when the whole records of a fold are left out."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Stretch:
    """Some consecutive rows of one record.

    Attributes:
        record: index of the record.
        first: first row.
        last: one past the last row.
        n_lead: rows at the start that are never scored; 0 for a whole record, whose first block always trains.
    """

    record: int
    first: int
    last: int
    n_lead: int

    def held_out(self, fold: Sequence[BoolArray]) -> BoolArray:
        """(n_rows,) rows of the stretch that the fold scores."""
        rows = fold[self.record][self.first : self.last].copy()
        rows[: self.n_lead] = False
        return rows


def is_long(records: Sequence[Record]) -> bool:
    """Whether the records are scored on stretches."""
    return sum(record.n_samples for record in records) > LONGEST_SCORED


def folds_of(records: Sequence[Record]) -> tuple[tuple[BoolArray, ...], ...]:
    """[fold][record] held-out rows.

    Whole records where there are enough that can stand for each other (a block of a sweep cannot stand for another
    one, but neither can a record stand for the only one in which an input moves); else ten blocks a record, or ten
    blocks a stretch where the records are long.
    """
    lengths = [record.n_samples for record in records]
    longest = max(lengths)
    if len(records) >= MANY_RECORDS and min(lengths) >= ALIKE * longest and not is_long(records):
        folds = whole_record_folds(records)
        if _every_input_trains(records, folds):
            return folds
    if not is_long(records) or longest <= STRETCH:
        return interleaved_folds(records)
    n_stretches = -(-longest // STRETCH)
    return interleaved_folds(records, n_blocks=BLOCKS * n_stretches, min_block=STRETCH // BLOCKS)


def _every_input_trains(records: Sequence[Record], folds: Sequence[Sequence[BoolArray]]) -> bool:
    """Whether each input moves in the whole records that each fold leaves: not where one drives one record alone."""
    moved = [np.square(record.inputs - record.inputs.mean(axis=0)).sum(axis=0) for record in records]
    least = LEAST_TRAINED * np.sum(moved, axis=0)
    return all(
        bool((np.sum([m for m, rows in zip(moved, fold, strict=True) if not rows.any()], axis=0) > least).all())
        for fold in folds
    )


def stretches_of(records: Sequence[Record]) -> tuple[Stretch, ...]:
    """Whole records, or about `LONGEST_SCORED` samples of them in stretches spread evenly.

    Example:
        >>> record = Record([], np.zeros(95_000) + np.arange(95_000.0), 0.01)
        >>> [(stretch.first, stretch.last) for stretch in stretches_of([record])]
        [(0, 9500), (38000, 47500), (85500, 95000)]
    """
    if not is_long(records):
        return tuple(Stretch(record=i, first=0, last=record.n_samples, n_lead=0) for i, record in enumerate(records))
    pieces = []
    for i, record in enumerate(records):
        n_pieces = max(1, -(-record.n_samples // STRETCH))
        edges = np.linspace(0, record.n_samples, n_pieces + 1).round().astype(int).tolist()
        pieces += [
            Stretch(record=i, first=first, last=last, n_lead=0 if first == 0 else (last - first) // BLOCKS)
            for first, last in itertools.pairwise(edges)
        ]
    n_kept = max(1, LONGEST_SCORED * len(pieces) // sum(record.n_samples for record in records))
    kept = np.unique(np.linspace(0, len(pieces) - 1, min(n_kept, len(pieces))).round().astype(int))
    return tuple(pieces[i] for i in kept)
