"""The matrix behind the variance of an observer's coefficients, factored once: W = V V' + penalty.

With the regressors V of the rows that were fitted, the ridge estimate moves by W^-1 times what moves its right side,
and the data and not the ridge decide trace(W^-1 V V') of its unknowns.

References:
    Hoerl, Kennard, "Ridge regression: biased estimation for nonorthogonal problems", Technometrics 12(1), 1970,
    equation 2.8, doi 10.1080/00401706.1970.10488634.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import FloatArray
from okid.gram import LagGram
from okid.normal_equations import cholesky, normal_equations, triangular_solve

__all__ = ["CoefficientCovariance", "coefficient_covariance"]

_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CoefficientCovariance:
    """Covariance of the coefficients of one equation for residuals of unit variance.

    Attributes:
        factor: (n_unknowns, n_unknowns) lower triangle L of W; None where W is singular to working precision.
        basis: (n_unknowns, n_kept) with W^+ = basis basis' where it is, None otherwise: directions without
            information were left out of the fit, and are left out here.
        penalty: (n_unknowns,) of the ridge.
    """

    factor: FloatArray | None
    basis: FloatArray | None
    penalty: FloatArray

    @property
    def effective_unknowns(self) -> float:
        """Trace of W^-1 V V', the unknowns that the data and not the ridge decide: their number without a ridge."""
        if self.factor is None:
            assert self.basis is not None
            return float(self.basis.shape[1] - np.square(np.sqrt(self.penalty)[:, np.newaxis] * self.basis).sum())
        n_unknowns = self.penalty.size
        if not (self.penalty > 0.0).any():
            return float(n_unknowns)
        shrunk = triangular_solve(self.factor, np.diag(np.sqrt(self.penalty)), transposed=False)
        return float(n_unknowns - np.square(shrunk).sum())

    def solve(self, right: FloatArray) -> FloatArray:
        """W^-1 right (W^+ where it is singular), (n_unknowns, n) to the same."""
        if self.factor is not None:
            half = triangular_solve(self.factor, right, transposed=False)
            return triangular_solve(self.factor, half, transposed=True)
        assert self.basis is not None
        solution: FloatArray = self.basis @ (self.basis.T @ right)
        return solution


def coefficient_covariance(gram: LagGram, ridge: float) -> CoefficientCovariance:
    """Covariance of the ridge estimate from these rows.

    Args:
        gram: Gram matrix of the rows that were fitted, of the observer's order.
        ridge: as in the fit.

    Example:
        >>> gram = LagGram(matrix=100.0 * np.eye(5), n_rows=100, order=1, n_inputs=1, n_outputs=1)
        >>> round(float(coefficient_covariance(gram, 0.0).solve(np.eye(4))[1, 1]), 12)  # variance of a mean of 100
        0.01
    """
    equations = normal_equations(gram, ridge)
    factor = cholesky(equations.matrix.copy(order="F"))
    if factor is not None:
        return CoefficientCovariance(factor=factor, basis=None, penalty=equations.penalty)
    values, vectors = scipy.linalg.eigh(equations.matrix, lower=True, check_finite=False, driver="evd")
    kept = values > 4.0 * values.size * _EPS * values[-1]
    return CoefficientCovariance(factor=None, basis=vectors[:, kept] / np.sqrt(values[kept]), penalty=equations.penalty)
