"""How many states: the largest gap of the singular values, with the evidence that a reader needs to judge it.

The share of the sum of the singular values that an order keeps depends on the size of the matrix (noise adds singular
values, not size), the share of their squares hardly so, the gap not at all. All three are kept, the gap decides; on
measured data it stands beside a stabilisation diagram and the free run of the models, which `modal` adds.
"""

from dataclasses import dataclass

import numpy as np

from okid.arrays import FloatArray

__all__ = ["GapChoice", "choose_order"]

CLEAR_GAP = 3.0
"""Ratio of neighbouring singular values above which a gap cannot lie inside a conjugate pair."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapChoice:
    """An order and what speaks for it.

    Attributes:
        order: number of states.
        ratio: of the last singular value kept to the first one left out; inf where none is left above rounding.
        sum_share: share of the sum of the computed singular values that is kept.
        energy_share: share of the sum of the squares of all singular values that is kept.
        rank: numerical rank, as far as it was computed.
        reason: one sentence.
    """

    order: int
    ratio: float
    sum_share: float
    energy_share: float
    rank: int
    reason: str


def choose_order(
    singular_values: FloatArray,
    *,
    rank: int | None = None,
    energy: float | None = None,
    A: FloatArray | None = None,
    max_order: int | None = None,
) -> GapChoice:
    """The order before the largest ratio s[i] / s[i + 1]; noise-free data: the numerical rank.

    Where the gap is weak (a ratio below 3) and would cut a conjugate pair in two, so that the model of one order more
    has a real pole less, the pair is kept whole.

    Args:
        singular_values: falling.
        rank: numerical rank; by default singular values above rounding error of the largest.
        energy: sum of the squares of all singular values; by default of those given.
        A: (at least order + 1, same) balanced system matrix for the test of whole pairs, left out without it.
        max_order: highest order that may be chosen.

    Example:
        >>> choice = choose_order(np.array([8.0, 7.0, 0.2, 0.19, 0.18]))
        >>> choice.order, round(choice.ratio, 9), round(choice.energy_share, 4)
        (2, 35.0, 0.999)
    """
    values = np.asarray(singular_values, dtype=np.float64)
    if rank is None:
        floor = values[0] * values.size * np.finfo(float).eps if values.size else 0.0
        rank = int((values > floor).sum())
    if rank == 0:
        return _choice(values, 0, 0, energy, "all Markov parameters beyond the feedthrough are zero")
    highest = rank if max_order is None else min(rank, max_order)
    ratios = np.array([_ratio(values, i) for i in range(1, highest + 1)])
    if rank < values.size or highest < rank:
        order = int(np.argmax(ratios)) + 1
    else:
        # Noise fills the matrix, and the smallest few values of a square one are far apart by chance.
        order = int(np.argmax(ratios[: max(1, 3 * highest // 4)])) + 1
    why = "largest gap of the singular values"
    if order == rank < values.size:
        why = "numerical rank: what follows is rounding error"
    elif A is not None and _splits_a_pair(A, order) and ratios[order - 1] < CLEAR_GAP and order < highest:
        order += 1
        why = "largest gap of the singular values, one order more so that a conjugate pair is kept whole"
    return _choice(values, order, rank, energy, why)


def _choice(values: FloatArray, order: int, rank: int, energy: float | None, why: str) -> GapChoice:
    squares = float(np.square(values).sum()) if energy is None else energy
    total = float(values.sum())
    sum_share = float(values[:order].sum()) / total if total > 0 else 1.0
    energy_share = min(1.0, float(np.square(values[:order]).sum()) / squares) if squares > 0 else 1.0
    ratio = _ratio(values, order) if order else np.inf
    reason = (
        f"order {order}: {why} (s{order}/s{order + 1} = {ratio:.3g}; {100 * sum_share:.1f} % of their sum, "
        f"{100 * energy_share:.2f} % of their energy)."
    )
    return GapChoice(order=order, ratio=ratio, sum_share=sum_share, energy_share=energy_share, rank=rank, reason=reason)


def _ratio(values: FloatArray, order: int) -> float:
    """Of the last value kept to the first left out; a value that is zero counts as infinitely smaller."""
    if order >= values.size or values[order] <= 0.0:
        return float(np.inf)
    return float(values[order - 1] / values[order])


def _splits_a_pair(A: FloatArray, order: int) -> bool:
    if order + 1 > A.shape[0]:
        return False
    here, next_higher = (int((np.linalg.eigvals(A[:n, :n]).imag == 0).sum()) for n in (order, order + 1))
    return next_higher < here
