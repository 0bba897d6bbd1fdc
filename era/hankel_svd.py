"""Leading singular triplets of a block Hankel matrix: in full when it is small, randomised when it is large."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from era.hankel import BlockHankelOperator, block_hankel
from era.order import CLEAR_GAP
from era.randomised import leading_triplets
from okid.arrays import FloatArray

__all__ = ["HankelTriplets", "Method", "hankel_triplets"]

Method = Literal["auto", "full", "randomised"]

FULL_UP_TO = 1.5e6
"""Rows x columns x smaller side of a block Hankel matrix that is always decomposed in full (1-2 ms)."""
FIRST_RANK = 32
"""Triplets that are looked for first when nobody said how many are needed."""
LARGEST_RANK = 256
"""Triplets that are looked for at most when nobody said how many are needed."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HankelTriplets:
    """H = U S V', its leading part.

    Attributes:
        left: (n_rows, n_kept) U.
        singular_values: all that were computed, falling; at least n_kept.
        right: (n_kept, n_columns) V'.
        subspace_error: (n_kept,) see `era.randomised.LeadingTriplets`; zeros for the full decomposition.
        rank: numerical rank as far as it was computed: singular values above rounding error.
        method: how they were computed.
    """

    left: FloatArray
    singular_values: FloatArray
    right: FloatArray
    subspace_error: FloatArray
    rank: int
    method: Literal["full", "randomised"]


def hankel_triplets(
    lags: FloatArray,
    n_block_rows: int,
    n_block_columns: int,
    *,
    max_order: int | None,
    method: Method,
    rng: np.random.Generator | None = None,
) -> HankelTriplets:
    """Decompose the block Hankel matrix of `lags`, whose block (i, j) is lags[1 + i + j].

    Args:
        lags: (n_lags + 1, n_rows, n_columns), lag 0 first; lag 0 is not used.
        n_block_rows: number of block rows.
        n_block_columns: number of block columns.
        max_order: triplets wanted; None: as many as the matrix (in full) or the search for the noise floor gives.
        method: see `era.decomposition.decompose`.
        rng: for the randomised method; a fixed seed unless given.

    Example:
        >>> found = hankel_triplets(0.5 ** np.arange(9.0).reshape(9, 1, 1), 4, 4, max_order=None, method="auto")
        >>> found.rank, found.method
        (1, 'full')
    """
    n_rows, n_columns = n_block_rows * lags.shape[1], n_block_columns * lags.shape[2]
    if method == "auto":
        method = _cheaper_method(n_rows, n_columns, max_order)
    if method == "full":
        left, values, right = np.linalg.svd(block_hankel(lags, n_block_rows, n_block_columns), full_matrices=False)
        error = np.zeros(values.size)
    else:
        operator = BlockHankelOperator.of(lags, n_block_rows, n_block_columns)
        generator = np.random.default_rng(0) if rng is None else rng
        left, values, right, error = _randomised(operator, max_order, generator)
    rank = _rank(values, n_rows, n_columns)
    kept = rank if max_order is None else min(rank, max_order)
    return HankelTriplets(
        left=left[:, :kept],
        singular_values=values,
        right=right[:kept],
        subspace_error=error[:kept],
        rank=rank,
        method=method,
    )


def _cheaper_method(n_rows: int, n_columns: int, max_order: int | None) -> Literal["full", "randomised"]:
    smaller = min(n_rows, n_columns)
    wanted = FIRST_RANK if max_order is None else max_order
    small = float(n_rows) * n_columns * smaller <= FULL_UP_TO
    return "full" if small or 4 * wanted >= smaller else "randomised"


def _randomised(
    operator: BlockHankelOperator, max_order: int | None, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    smaller = min(operator.shape)
    wanted = min(FIRST_RANK if max_order is None else max_order, smaller)
    found = leading_triplets(operator, wanted, rng=rng)
    while max_order is None and not (found.complete or _shows_a_gap(found.singular_values)):
        if 2 * wanted > min(LARGEST_RANK, smaller // 4):
            break
        wanted *= 2
        found = leading_triplets(operator, wanted, rng=rng)
    return found.left, found.singular_values, found.right, found.subspace_error


def _shows_a_gap(values: FloatArray) -> bool:
    """Whether the largest ratio of neighbours is clear and stands well before the end of what was computed."""
    ratios = values[:-1] / np.maximum(values[1:], np.finfo(float).tiny)
    largest = int(np.argmax(ratios))
    return bool(ratios[largest] >= CLEAR_GAP and largest < 3 * values.size // 4)


def _rank(values: FloatArray, n_rows: int, n_columns: int) -> int:
    if values.size == 0 or values[0] == 0.0:
        return 0
    return int((values > values[0] * max(n_rows, n_columns) * np.finfo(float).eps).sum())
