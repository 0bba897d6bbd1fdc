"""Least squares for the observer equation from its Gram matrix.

    Theta = argmin sum_k |y(k) - Theta' v(k)|^2 + n_rows ridge sum_lag (1 + lag) |Theta_lag|^2,
    v(k) = [1; u(k); u(k-1); y(k-1); ...; u(k-p); y(k-p)]

The ridge is relative to the unit diagonal of scaled channels and grows with the lag; the constant has none.

The normal equations square the condition number. `solve` therefore compares what rounding does to the coefficients with
what the noise does to them, and where rounding is not far below, goes to the rows themselves (orthogonal
factorisation), or for records too long for that to a truncated eigendecomposition followed by one refinement with
residuals from the rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from okid.arrays import BoolArray, FloatArray
from okid.coefficients import Method, ObserverCoefficients, coefficients_from_solution
from okid.errors import InvalidDataError
from okid.gram import LagGram
from okid.normal_equations import NormalEquations, cholesky, normal_equations, triangular_solve
from okid.record import Record
from okid.row_factor import factor_rows, residual_products, solve_factor
from okid.scalars import real_number
from okid.scaling import ChannelScaling

__all__ = ["RegressionRows", "solve"]

_EPS = float(np.finfo(np.float64).eps)
_QR_OPERATIONS = 4e11
"""Largest orthogonal factorisation done unasked: some ten seconds of one core."""
_NEGLIGIBLE = 1e-3
"""Rounding may cost this share of a coefficient's standard deviation before a more accurate method is taken."""
_CLEAN = 1e-6
"""Relative residual below which a Gram matrix (squares to 1e-16) says nothing certain about the residual."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RegressionRows:
    """Where the rows behind a Gram matrix can be read again.

    Attributes:
        records: of one system.
        scaling: as used for the Gram matrix.
        rows: masks as used for the Gram matrix, None for all rows.
    """

    records: Sequence[Record]
    scaling: ChannelScaling
    rows: Sequence[BoolArray] | None = None


def solve(gram: LagGram, ridge: float, *, source: RegressionRows | None = None) -> ObserverCoefficients:
    """The observer of the Gram's order, as accurately as the data deserve.

    Args:
        gram: Gram matrix of the rows.
        ridge: relative to the unit diagonal, at lag 0.
        source: where to read the rows again if the Gram matrix is too ill-conditioned; without it a truncated
            eigendecomposition is the last resort.

    Raises:
        InvalidDataError: a ridge that is not a number of at least 0.

    References:
        Higham, Accuracy and Stability of Numerical Algorithms, 2nd edition, SIAM 2002, section 20.4 (normal equations)
        and section 15.1 (condition estimate), doi 10.1137/1.9780898718027.
    """
    _check_ridge(ridge)
    system = normal_equations(gram, ridge)
    norm = scipy.linalg.lapack.dlange("1", system.matrix)
    factor = cholesky(system.matrix.copy(order="F") if source is None else system.matrix)
    if factor is not None:
        reciprocal, _ = scipy.linalg.lapack.dpocon(factor, norm, uplo="L")
        condition = float(np.sqrt(1.0 / max(reciprocal, _EPS**2)))
        solution = triangular_solve(factor, triangular_solve(factor, system.right, transposed=False), transposed=True)
        squares = _residual_squares(system, solution)
        if _rounding_is_negligible(system, squares, condition) or (source is None and condition < 0.01 * _EPS**-0.5):
            return _observer(system, solution, squares, method="cholesky", condition=condition, rank=solution.shape[0])
    if source is None:
        return _solve_eigh(system)[1]
    size = system.right.shape[0] + gram.n_outputs
    if 2.0 * gram.n_rows * size**2 <= _QR_OPERATIONS:
        return _solve_rows(system, source)
    return _solve_refined(normal_equations(gram, ridge), source)


def _residual_squares(system: NormalEquations, solution: FloatArray) -> FloatArray:
    """Residual products Y'Y - Theta'(V'Y + penalty Theta), from (V'V + penalty) Theta = V'Y."""
    size = solution.shape[0]
    squares = system.outputs - solution.T @ (system.right[:size] + system.penalty[:size, np.newaxis] * solution)
    return 0.5 * (squares + squares.T)


def _rounding_is_negligible(system: NormalEquations, squares: FloatArray, condition: float) -> bool:
    """Whether cond^2 eps stays far below a coefficient's standard deviation, residual * cond / sqrt(n_rows)."""
    energy = system.outputs.diagonal()
    relative = float(np.sqrt(np.maximum(squares.diagonal(), 0.0) / np.maximum(energy, 1e-300)).min())
    rounding = condition * _EPS * np.sqrt(system.gram.n_rows)
    return relative > _CLEAN and rounding <= _NEGLIGIBLE * relative


def _solve_eigh(system: NormalEquations) -> tuple[FloatArray, ObserverCoefficients]:
    """Truncated eigendecomposition: directions that rounding has made are left out."""
    values, vectors = scipy.linalg.eigh(system.matrix, lower=True, check_finite=False, driver="evd")
    kept = values > 4.0 * values.size * _EPS * values[-1]
    basis = vectors[:, kept] / np.sqrt(values[kept])
    solution = basis @ (basis.T @ system.right)
    # Without rows nothing is kept, and the observer is zero.
    condition = float(np.sqrt(values[-1] / values[kept][0])) if kept.any() else np.inf
    squares = _clipped(_residual_squares(system, solution))
    return basis, _observer(system, solution, squares, method="eigh", condition=condition, rank=int(kept.sum()))


def _solve_refined(system: NormalEquations, source: RegressionRows) -> ObserverCoefficients:
    """As `_solve_eigh`, then one step of iterative refinement with residuals taken from the rows."""
    basis, first = _solve_eigh(system)
    solution = basis @ (basis.T @ system.right)
    order, n_inputs = system.gram.order, system.gram.n_inputs
    products, _ = residual_products(source.records, order, source.scaling, source.rows, solution)
    solution += basis @ (basis.T @ (products - system.penalty[:, np.newaxis] * solution))
    _, squares = residual_products(source.records, order, source.scaling, source.rows, solution)
    return coefficients_from_solution(
        solution,
        squares,
        n_inputs=n_inputs,
        n_rows=first.n_rows,
        ridge=system.ridge,
        method="eigh",
        condition=first.condition,
        rank=first.rank,
    )


def _solve_rows(system: NormalEquations, source: RegressionRows) -> ObserverCoefficients:
    """Orthogonal factorisation of the rows [V Y], its triangle only."""
    triangle = factor_rows(source.records, system.gram.order, source.scaling, source.rows, system.penalty)
    noise = _EPS * (1.0 + source.scaling.offset_ratio) * np.sqrt(system.gram.n_rows)
    solution, squares, condition, rank = solve_factor(triangle, system.gram.n_outputs, noise)
    squares -= solution.T @ (system.penalty[:, np.newaxis] * solution)
    return _observer(system, solution, _clipped(squares), method="qr", condition=condition, rank=rank)


def _clipped(squares: FloatArray) -> FloatArray:
    """The nearest matrix without negative eigenvalues, which rounding gives noise-free data."""
    values, vectors = np.linalg.eigh(squares)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def _observer(
    system: NormalEquations, solution: FloatArray, squares: FloatArray, *, method: Method, condition: float, rank: int
) -> ObserverCoefficients:
    return coefficients_from_solution(
        solution,
        squares,
        n_inputs=system.gram.n_inputs,
        n_rows=system.gram.n_rows,
        ridge=system.ridge,
        method=method,
        condition=condition,
        rank=rank,
    )


def _check_ridge(ridge: float) -> None:
    number = real_number(ridge)
    if not (np.isfinite(number) and number >= 0.0):
        raise InvalidDataError(f"a ridge must be a number of at least 0, but is {ridge!r}; 0.01 is a strong one.")
