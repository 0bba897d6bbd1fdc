"""Where the climb to the likeliest gain begins, how long it goes on, and when its end is of no use."""

from collections.abc import Sequence

import numpy as np

from era.innovation_form import ScoredGain, Starts, first_fit, inverse_of_information, step
from era.innovation_run import finite_gramian
from era.left_over import NoisePart
from era.riccati import riccati_gain
from okid.arrays import FloatArray

__all__ = ["climbed", "first_gain", "usable_gain"]

MOST_STEPS = 40
SMALLEST_RISE = 1e-2
"""Of the log likelihood, below which another step moves K by much less than its standard deviation."""
FIRST_SIZE = 1.0
"""Energy of the free decays that one sample's process noise starts, relative to an output's noise."""
LARGEST_POLE = 0.999
"""Of a model whose free decays are given an energy."""
LARGEST_LOSS = 2.0
"""Growth of the innovations from starts of the free run, over those from the best starts, that a gain may have."""


def first_gain(A: FloatArray, C: FloatArray, length: int) -> FloatArray:
    """Gain for process noise that moves every state equally visibly.

    From a zero gain alone the climb can get stuck where records are so short that free decays pass for noise.
    """
    # of the same model with its largest pole well within the unit circle, for the energy of a growing decay is none
    shrunk = A * min(1.0, LARGEST_POLE / max(float(np.abs(np.linalg.eigvals(A)).max()), LARGEST_POLE))
    equal = inverse_of_information(finite_gramian(shrunk, C.T @ C, length))
    nothing = np.zeros((A.shape[0], C.shape[0]))
    return riccati_gain(A, C, FIRST_SIZE * equal, np.eye(C.shape[0]), nothing)


def usable_gain(
    A: FloatArray, C: FloatArray, likeliest: ScoredGain, parts: Sequence[NoisePart], n_rows: int
) -> ScoredGain:
    """The likeliest gain, unless its predictions hang on starts that nobody can know beforehand.

    Noise without power at some frequency has its likeliest gain near the edge of stability. From the starts of the free
    run, which is all that a user has, such a gain predicts badly for long; then the one that is best from these starts
    is taken.
    """
    allowed = 2.0 * np.log(LARGEST_LOSS) * C.shape[0]
    kept = first_fit(A, C, likeliest.gain, parts, starts="kept")
    if kept is not None and kept.log_determinant - likeliest.log_determinant <= allowed:
        return likeliest
    other = first_fit(A, C, first_gain(A, C, n_rows), parts, starts="kept")
    if other is None:
        return likeliest
    other = climbed(A, C, other, n_rows, starts="kept")
    if kept is not None and kept.log_determinant - other.log_determinant <= allowed:
        return likeliest
    return other


def climbed(A: FloatArray, C: FloatArray, start: ScoredGain, n_rows: int, *, starts: Starts = "free") -> ScoredGain:
    """The fit after as many steps as are worth it."""
    best = start
    for _ in range(MOST_STEPS):
        moved = step(A, C, best, starts=starts)
        if moved is None:
            break
        rise = 0.5 * n_rows * (best.log_determinant - moved.log_determinant)
        best = moved
        if rise < SMALLEST_RISE:
            break
    return best
