"""Folds for choosing by held-out error: masks of rows, in interleaved blocks.

Contiguous thirds would train on the tail of an earthquake and test on its shock. Blocks spread over the record give
every fold some of everything, and since Gram matrices of disjoint rows add, a training set is the whole less one fold.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from okid.arrays import BoolArray
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record

__all__ = ["interleaved_folds", "whole_record_folds"]


def whole_record_folds(
    records: Sequence[Record], *, n_folds: int = 3, lead: float = 0.1
) -> tuple[tuple[BoolArray, ...], ...]:
    """Masks of the held-out rows where the records can stand for each other: each fold holds out whole records.

    The first share `lead` of every record trains, so that its initial state is known when it is held out.

    Args:
        records: of one system, at least `n_folds` of them.
        n_folds: records go to the folds in turn.
        lead: share of each record.

    Example:
        >>> record = Record([], np.arange(40.0), 0.1)
        >>> folds = whole_record_folds([record, record, record])
        >>> [[int(rows.sum()) for rows in fold] for fold in folds]
        [[36, 0, 0], [0, 36, 0], [0, 0, 36]]
    """
    folds = []
    for i in range(n_folds):
        fold = []
        for r, record in enumerate(records):
            rows = np.zeros(record.n_samples, dtype=np.bool_)
            if r % n_folds == i:
                rows[max(1, round(lead * record.n_samples)) :] = True
            fold.append(rows)
        folds.append(tuple(fold))
    return tuple(folds)


def interleaved_folds(
    records: Sequence[Record], *, n_folds: int = 3, n_blocks: int = 10, min_block: int = 10
) -> tuple[tuple[BoolArray, ...], ...]:
    """Masks of the held-out rows: [fold][record] -> (n_samples,) bool.

    Each record is cut into blocks of equal length. Its first block, which holds the free response to the initial state,
    always trains; the others go to the folds in turn, and the turn goes on from record to record, so that the folds
    stay equally large however many blocks a record has. A record too short for `n_blocks` blocks of `min_block` samples
    gets fewer blocks; one too short for two is a single block, which goes to a fold as a whole (the first such record
    trains).

    Args:
        records: of one system.
        n_folds: at least 2.
        n_blocks: blocks a record, above `n_folds`.
        min_block: fewest samples of a block.

    Raises:
        InvalidDataError: fewer than two folds, or no more blocks than folds.
        InsufficientDataError: the records are too short to give every fold a block.

    Example:
        >>> record = Record([], np.arange(40.0), 0.1)
        >>> for fold in interleaved_folds([record], n_folds=3, n_blocks=4):
        ...     print(np.flatnonzero(fold[0])[[0, -1]])
        [10 19]
        [20 29]
        [30 39]
    """
    if n_folds < 2 or n_blocks <= n_folds or min_block < 1:
        raise InvalidDataError(
            f"folds need n_folds >= 2, n_blocks > n_folds and min_block >= 1, but are {n_folds}, {n_blocks}, "
            f"{min_block}."
        )
    masks = [[np.zeros(record.n_samples, dtype=np.bool_) for record in records] for _ in range(n_folds)]
    turn, first_single = 0, True
    for number, record in enumerate(records):
        own_blocks = min(n_blocks, record.n_samples // min_block)
        if own_blocks < 2:
            blocks = [] if first_single else [(0, record.n_samples)]
            first_single = False
        else:
            edges = np.linspace(0, record.n_samples, own_blocks + 1).round().astype(int).tolist()
            blocks = list(itertools.pairwise(edges[1:]))
        for start, stop in blocks:
            masks[turn % n_folds][number][start:stop] = True
            turn += 1
    if turn < n_folds:
        total = sum(record.n_samples for record in records)
        raise InsufficientDataError(
            f"{n_folds} folds need at least {(n_folds + 1) * min_block} samples in one record; there are {total} in "
            f"{len(records)} record{'s' * (len(records) != 1)}. Use a longer record, a smaller delay or less "
            "decimation; okid.fit_observer takes an order and a ridge without folds."
        )
    for fold in masks:
        for mask in fold:
            mask.flags.writeable = False
    return tuple(tuple(fold) for fold in masks)
