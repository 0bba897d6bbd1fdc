"""Least squares from the rows themselves: slower than by the Gram matrix, with the condition number, not its square."""

from collections.abc import Sequence

import numpy as np
import scipy

from okid.arrays import BoolArray, FloatArray
from okid.record import Record
from okid.rows import regressor_chunks
from okid.scaling import ChannelScaling

__all__ = ["factor_rows", "residual_products", "solve_factor"]

_EPS = float(np.finfo(np.float64).eps)


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
