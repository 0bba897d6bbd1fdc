"""A damped Gauss-Newton step that stays within bounds."""

import numpy as np
import scipy

from okid.arrays import TINY, FloatArray

__all__ = ["bounded_step"]


def bounded_step(
    gram: FloatArray,
    score: FloatArray,
    damping: float,
    *,
    at: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    reach: FloatArray,
) -> FloatArray:
    """The damped step, unknowns at a bound that it would cross held there.

    What would go further than it may reach in one step goes that far, and the others follow from that.

    Args:
        gram: (n, n) J' J.
        score: (n,) J' r.
        damping: Marquardt's, as a share of the diagonal.
        at: (n,) the unknowns.
        lower: (n,) hard bounds.
        upper: (n,) likewise.
        reach: (n,) longest step upwards, not negative; infinite for most unknowns.

    Returns:
        (n,) the step.

    Example:
        >>> far = np.full(2, np.inf)
        >>> gram, score = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([4.0, 2.0])
        >>> bounded_step(gram, score, 0.0, at=np.zeros(2), lower=-far, upper=far, reach=np.array([1.0, np.inf]))
        array([1. , 0.5])
    """
    scale = np.sqrt(np.maximum(np.diag(gram), TINY))
    scaled = gram / np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] = 1.0 + damping
    free = scale > 1e-140
    step, pinned = np.zeros(len(score)), np.zeros(len(score))
    for _ in range(len(score)):
        index = np.flatnonzero(free)
        step[:] = pinned
        wanted = score[index] / scale[index] - scaled[index] @ (pinned * scale)
        step[index] = _solve(scaled[np.ix_(index, index)], wanted) / scale[index]
        beyond = free & (step > reach)
        if beyond.any():
            free &= ~beyond
            pinned[beyond] = reach[beyond]
            continue
        crossing = free & ((at + step < lower) | (at + step > upper))
        if not crossing.any():
            return step
        held = np.clip(at, lower, upper) - at
        stuck = crossing & (((at <= lower) & (step < 0.0)) | ((at >= upper) & (step > 0.0)))
        if not stuck.any():
            bound = np.clip(at + step, lower, upper) - at
            return np.where(crossing, bound, step)
        free &= ~stuck
        pinned[stuck] = held[stuck]
    return step


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    try:
        return np.asarray(scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix), right))
    except scipy.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-12)[0])
