"""The normal equations of the observer regression, cut out of a Gram matrix, and their triangular factor.

    (V V' + penalty) Theta = V Y',   penalty = n_rows ridge diag(0; 1 ...; (1 + lag) ...)

with v(k) = [1; u(k); u(k-1); y(k-1); ...; u(k-p); y(k-p)] in scaled channels. The regression solves them, the
covariance of its solution needs the same matrix again.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import FloatArray
from okid.gram import LagGram

__all__ = ["NormalEquations", "cholesky", "normal_equations", "triangular_solve"]

_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NormalEquations:
    """What a ridge regression is solved from.

    Attributes:
        matrix: (n_unknowns, n_unknowns) V V' + penalty, in Fortran order so that it can be factored in place.
        right: (n_unknowns, n_outputs) V Y'.
        outputs: (n_outputs, n_outputs) Y Y'.
        penalty: (n_unknowns,) what the ridge adds to the diagonal.
        gram: that they were cut from.
        ridge: relative to the unit diagonal, at lag 0.
    """

    matrix: FloatArray
    right: FloatArray
    outputs: FloatArray
    penalty: FloatArray
    gram: LagGram
    ridge: float


def normal_equations(gram: LagGram, ridge: float) -> NormalEquations:
    """Take y(k), which is explained, out of phi(k), which explains.

    Args:
        gram: Gram matrix of the rows.
        ridge: relative to the unit diagonal, at lag 0.

    Example:
        >>> equations = normal_equations(LagGram(matrix=np.eye(5), n_rows=10, order=1, n_inputs=1, n_outputs=1), 0.1)
        >>> equations.penalty
        array([0., 1., 2., 2.])
    """
    low, n_channels = 1 + gram.n_inputs, gram.n_inputs + gram.n_outputs
    high = 1 + n_channels
    whole = gram.matrix
    size = whole.shape[0] - gram.n_outputs
    matrix = np.empty((size, size), order="F")
    # The transpose is C-ordered, as the Gram is: each slice is copied along memory.
    view = matrix.T
    view[:low, :low], view[:low, low:] = whole[:low, :low], whole[:low, high : size + gram.n_outputs]
    view[low:, :low], view[low:, low:] = whole[high:, :low], whole[high:, high : size + gram.n_outputs]
    right = np.concatenate([whole[:low, low:high], whole[high:, low:high]])
    penalty = np.zeros(size)
    if ridge > 0.0:
        penalty[1:low] = 1.0
        penalty[low:] = np.repeat(np.arange(2.0, gram.order + 2.0), n_channels)
        penalty *= ridge * gram.n_rows
        view.flat[:: size + 1] += penalty
    return NormalEquations(
        matrix=matrix, right=right, outputs=whole[low:high, low:high], penalty=penalty, gram=gram, ridge=ridge
    )


def cholesky(matrix: FloatArray) -> FloatArray | None:
    """Lower factor, in place; None where the matrix is not positive definite to working precision."""
    factor, info = scipy.linalg.lapack.dpotrf(matrix, lower=1, clean=0, overwrite_a=1)
    if info != 0:
        return None
    pivots = factor.diagonal()
    trusted = pivots.min() ** 2 > _EPS * matrix.shape[0] * pivots.max() ** 2
    return factor if trusted else None


def triangular_solve(factor: FloatArray, right: FloatArray, *, transposed: bool) -> FloatArray:
    """Solve L X = right, or L' X = right where `transposed`; only the lower triangle of `factor` is read."""
    solution, _ = scipy.linalg.lapack.dtrtrs(factor, right, lower=1, trans=int(transposed))
    return solution
