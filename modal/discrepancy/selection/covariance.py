"""How sure an estimate is: the covariance of its unknowns, and which of them are held."""

import numpy as np
import scipy

from modal.discrepancy.fitting.estimation import Estimate, Problem, score_equations, sensitivity_of
from modal.simulation.drive import IndexArray
from okid.arrays import TINY, FloatArray

__all__ = ["covariance", "held_unknowns"]


def covariance(current: Estimate, problem: Problem) -> FloatArray:
    """Covariance of all unknowns at the estimate, scaled by the residual where that is above the floor.

    What is held, or sits on a hard bound, has none: the others' is that given the bound.
    """
    gram, _ = score_equations(current, problem, sensitivity_of(current, problem))
    held = held_unknowns(current)
    gram[held, :] = 0.0
    gram[:, held] = 0.0
    scale = np.sqrt(np.maximum(np.diag(gram), TINY))
    inverse = scipy.linalg.pinvh(gram / np.outer(scale, scale)) / np.outer(scale, scale)
    inverse[held, :] = 0.0
    inverse[:, held] = 0.0
    return np.asarray(inverse * max(1.0, current.level))


def held_unknowns(current: Estimate) -> IndexArray:
    """Which common unknowns are held, or sit on a hard bound."""
    lower, upper = current.assembly.bounds()
    return np.flatnonzero((lower == upper) | current.at_bounds)
