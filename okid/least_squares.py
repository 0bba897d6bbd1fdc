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
from typing import Literal

import numpy as np
import scipy

from okid.arrays import TINY, BoolArray, ComplexArray, FloatArray, real_number
from okid.errors import InvalidDataError
from okid.gram import LagGram
from okid.record import Record
from okid.rows import regressor_chunks
from okid.scaling import ChannelScaling

Method = Literal["cholesky", "eigh", "qr"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObserverCoefficients:
    """An observer of scaled channels: (value - mean) / scale of every input and output.

    Attributes:
        feedthrough: (n_outputs, n_inputs) D.
        input_coefficients: (order, n_outputs, n_inputs) alpha_1 ... alpha_order.
        output_coefficients: (order, n_outputs, n_outputs) beta_1 ... beta_order.
        offset: (n_outputs,) constant of each output's equation.
        residual_covariance: (n_outputs, n_outputs) of the one-step residual, degrees of freedom taken off.
        n_rows: rows that were fitted.
        order: number of past samples.
        ridge: added to the unit diagonal as ridge (1 + lag).
        method: how it was solved.
        condition: estimated condition number of the regressor matrix, ridge included.
        rank: number of directions kept.
    """

    feedthrough: FloatArray
    input_coefficients: FloatArray
    output_coefficients: FloatArray
    offset: FloatArray
    residual_covariance: FloatArray
    n_rows: int
    order: int
    ridge: float
    method: Method
    condition: float
    rank: int

    @property
    def n_parameters(self) -> int:
        """Unknowns per output."""
        n_outputs, n_inputs = self.feedthrough.shape
        return 1 + n_inputs + self.order * (n_inputs + n_outputs)


def coefficients_from_solution(
    solution: FloatArray,
    squares: FloatArray,
    *,
    n_inputs: int,
    n_rows: int,
    ridge: float,
    method: Method,
    condition: float,
    rank: int,
) -> ObserverCoefficients:
    """Cut a least-squares solution into the parts of the observer equation.

    Args:
        solution: (1 + n_inputs + order n_channels, n_outputs), rows [1, u(k), u(k-1), y(k-1), ..., y(k-order)].
        squares: (n_outputs, n_outputs) sum of products of the residuals.
        n_inputs: number of inputs.
        n_rows: rows fitted.
        ridge: as used.
        method: as used.
        condition: as estimated.
        rank: directions kept.
    """
    n_outputs = solution.shape[1]
    n_channels = n_inputs + n_outputs
    past = solution[1 + n_inputs :].reshape(-1, n_channels, n_outputs).transpose(0, 2, 1)
    return ObserverCoefficients(
        feedthrough=np.ascontiguousarray(solution[1 : 1 + n_inputs].T),
        input_coefficients=np.ascontiguousarray(past[:, :, :n_inputs]),
        output_coefficients=np.ascontiguousarray(past[:, :, n_inputs:]),
        offset=solution[0].copy(),
        residual_covariance=squares / max(n_rows - rank, 1),
        n_rows=n_rows,
        order=past.shape[0],
        ridge=ridge,
        method=method,
        condition=condition,
        rank=rank,
    )


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


def factor_rows(
    records: Sequence[Record],
    order: int,
    scaling: ChannelScaling,
    rows: Sequence[BoolArray] | None,
    penalty: FloatArray,
) -> FloatArray:
    """Upper triangle R of the orthogonal factorisation of [V Y], chunk after chunk, so memory is bounded.

    Args:
        records: of one system.
        order: observer order.
        scaling: mean and size of every channel.
        rows: masks, None for all.
        penalty: (n_unknowns,) ridge, entered as rows sqrt(penalty) below V.

    Returns:
        (n_unknowns + n_outputs, same).

    References:
        Demmel, Grigori, Hoemmen, Langou, SIAM Journal on Scientific Computing 34(1), 2012, section 3 (sequential
        reduction of tall matrices), doi 10.1137/080731992.
    """
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    size = penalty.size + n_outputs
    # The ridge rows come first: every later factorisation then starts from at least `size` rows.
    triangle = np.zeros((size, size))
    triangle.flat[: penalty.size * (size + 1) : size + 1] = np.sqrt(penalty)
    for chunk in regressor_chunks(records, order, scaling, rows):
        stacked = np.empty((size + chunk.shape[0], size), order="F")
        stacked[:size] = triangle
        new = stacked[size:]
        new[:, : 1 + n_inputs] = chunk[:, : 1 + n_inputs]
        new[:, 1 + n_inputs : penalty.size] = chunk[:, 1 + n_inputs + n_outputs :]
        new[:, penalty.size :] = chunk[:, 1 + n_inputs : 1 + n_inputs + n_outputs]
        factored, _, _, _ = scipy.linalg.lapack.dgeqrf(stacked, lwork=64 * size, overwrite_a=1)
        triangle = np.triu(factored[:size])
    return triangle


def solve_factor(triangle: FloatArray, n_outputs: int, noise: float) -> tuple[FloatArray, FloatArray, float, int]:
    """Solution, residual products (ridge rows included), condition number and rank from the triangle of [V Y].

    Args:
        triangle: from `factor_rows`.
        n_outputs: number of columns of Y.
        noise: singular values of V that the rounding of the samples alone would give; smaller ones carry nothing.
    """
    size = triangle.shape[0] - n_outputs
    left, right = triangle[:size, :size], triangle[:size, size:]
    squares = triangle[size:, size:].T @ triangle[size:, size:]
    u, values, vt = np.linalg.svd(left)
    kept = values > 32.0 * max(noise, _EPS * np.sqrt(size) * values[0])
    projected = u.T @ right
    solution = vt[kept].T @ (projected[kept] / values[kept, np.newaxis])
    squares += projected[~kept].T @ projected[~kept]
    condition = float(values[0] / values[kept][-1]) if kept.any() else np.inf
    return solution, squares, condition, int(kept.sum())


def residual_products(
    records: Sequence[Record],
    order: int,
    scaling: ChannelScaling,
    rows: Sequence[BoolArray] | None,
    solution: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """V'E (n_unknowns, n_outputs) and E'E of the residuals E = Y - V solution, summed over chunks."""
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    low, high = 1 + n_inputs, 1 + n_inputs + n_outputs
    with_regressors, squares = np.zeros_like(solution), np.zeros((n_outputs, n_outputs))
    for chunk in regressor_chunks(records, order, scaling, rows):
        residual = chunk[:, low:high] - chunk[:, :low] @ solution[:low] - chunk[:, high:] @ solution[low:]
        with_regressors[:low] += chunk[:, :low].T @ residual
        with_regressors[low:] += chunk[:, high:].T @ residual
        squares += residual.T @ residual
    return with_regressors, squares


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
    factor = cholesky(system.matrix)
    if factor is not None:
        reciprocal, _ = scipy.linalg.lapack.dpocon(factor, norm, uplo="L")
        condition = float(np.sqrt(1.0 / max(reciprocal, _EPS**2)))
        solution = triangular_solve(factor, triangular_solve(factor, system.right, transposed=False), transposed=True)
        squares = _residual_squares(system, solution)
        if _rounding_is_negligible(system, squares, condition) or (source is None and condition < 0.01 * _EPS**-0.5):
            return _observer(system, solution, squares, method="cholesky", condition=condition, rank=solution.shape[0])
    size = system.right.shape[0] + gram.n_outputs
    if source is not None and 2.0 * gram.n_rows * size**2 <= _QR_OPERATIONS:
        return _solve_rows(system, source)
    system = normal_equations(gram, ridge)  # afresh: the factorisation overwrote its matrix
    return _solve_eigh(system)[1] if source is None else _solve_refined(system, source)


def _residual_squares(system: NormalEquations, solution: FloatArray) -> FloatArray:
    """Residual products Y'Y - Theta'(V'Y + penalty Theta), from (V'V + penalty) Theta = V'Y."""
    size = solution.shape[0]
    squares = system.outputs - solution.T @ (system.right[:size] + system.penalty[:size, np.newaxis] * solution)
    return 0.5 * (squares + squares.T)


def _rounding_is_negligible(system: NormalEquations, squares: FloatArray, condition: float) -> bool:
    """Whether cond^2 eps stays far below a coefficient's standard deviation, residual * cond / sqrt(n_rows)."""
    energy = system.outputs.diagonal()
    relative = float(np.sqrt(np.maximum(squares.diagonal(), 0.0) / np.maximum(energy, TINY)).min())
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


def total_least_squares(
    inputs: ComplexArray, cross: ComplexArray, power: FloatArray, response: ComplexArray
) -> ComplexArray:
    """Hv: of each output with all inputs, channels at unit power, the direction of least power is what does not fit.

    Args:
        inputs: (n_lines, n_inputs, n_inputs) spectra of the inputs.
        cross: (n_lines, n_outputs, n_inputs) of outputs with inputs.
        power: (n_lines, n_inputs + n_outputs) of all channels.
        response: (n_lines, n_outputs, n_inputs) of another estimator; lines where it is not finite stay unknown.
    """
    n_inputs = inputs.shape[1]
    known = np.flatnonzero(np.isfinite(response).all(axis=(1, 2)))
    found = np.full_like(response, np.nan)
    size = np.sqrt(power[known])
    for output in range(response.shape[1]):
        scale = np.concatenate([size[:, :n_inputs], size[:, [n_inputs + output]]], axis=1)
        matrix = np.empty((known.size, n_inputs + 1, n_inputs + 1), dtype=np.complex128)
        matrix[:, :n_inputs, :n_inputs] = inputs[known]
        matrix[:, n_inputs, :n_inputs] = cross[known, output]
        matrix[:, :n_inputs, n_inputs] = cross[known, output].conj()
        matrix[:, n_inputs, n_inputs] = power[known, n_inputs + output]
        with np.errstate(divide="ignore", invalid="ignore"):
            matrix /= scale[:, :, np.newaxis] * scale[:, np.newaxis]
            matrix = np.nan_to_num(matrix)
            # v^H [u; y] ~ 0 for the eigenvector of least power, so y = -conj(v_u) u / conj(v_y)
            least = np.linalg.eigh(matrix)[1][:, :, 0] / scale
            found[known, output] = -(least[:, :n_inputs] / least[:, [n_inputs]]).conj()
    return found
