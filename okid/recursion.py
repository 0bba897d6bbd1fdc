"""The output recursion of an observer, y(k) = x(k) + sum_{i=1..p} beta_i y(k-i), solved in blocks of steps.

One step at a time costs an interpreter round a step. A block of b steps is one product with the constant Toeplitz strip
that carries the past and one triangular solve with the constant unit lower triangle that links the steps of the block.
"""

import numpy as np
import scipy

from okid.arrays import FloatArray

__all__ = ["solve_recursion"]

_BLOCK_UNKNOWNS = 64
"""Rows of one block: few enough that the triangle stays in cache, enough that the interpreter does not count."""


def solve_recursion(
    output_coefficients: FloatArray, forcing: FloatArray, history: FloatArray | None = None
) -> FloatArray:
    """Run the recursion forward for several columns at once.

    Args:
        output_coefficients: (order, n_outputs, n_outputs) beta_1 ... beta_order.
        forcing: (n_steps, n_outputs, n_columns) x(0), x(1), ...
        history: (order, n_outputs, n_columns) y(-order) ... y(-1); None for zeros.

    Returns:
        (n_steps, n_outputs, n_columns).

    Example:
        >>> solve_recursion(np.array([[[0.5]]]), np.array([[[1.0]], [[0.0]], [[0.0]]])).ravel()
        array([1.  , 0.5 , 0.25])
    """
    order, n_outputs = output_coefficients.shape[:2]
    n_steps, _, n_columns = forcing.shape
    values = np.empty((order + n_steps, n_outputs, n_columns))
    values[:order] = 0.0 if history is None else history
    steps = max(1, min(n_steps, _BLOCK_UNKNOWNS // n_outputs))
    strip, triangle = _strip_and_triangle(output_coefficients, steps)
    flat = values.reshape((order + n_steps) * n_outputs, n_columns)
    flat_forcing = forcing.reshape(n_steps * n_outputs, n_columns)
    past = order * n_outputs
    for start in range(0, n_steps * n_outputs, steps * n_outputs):
        size = min(steps * n_outputs, n_steps * n_outputs - start)
        right = flat_forcing[start : start + size] + strip[:size] @ flat[start : start + past]
        if steps > 1:
            # X' T' = R' with C-ordered operands is what BLAS sees as T X = R: no copy is made.
            right = scipy.linalg.blas.dtrsm(
                1.0, triangle[:size, :size].T, right.T, side=1, lower=0, diag=1, overwrite_b=1
            ).T
        flat[start + past : start + past + size] = right
    return values[order:]


def _strip_and_triangle(output_coefficients: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """Coefficients of a block of steps on the `order` steps before it, and on the steps in it (unit lower triangle)."""
    order, q = output_coefficients.shape[:2]
    padded = np.zeros((order + 2 * steps, q, q))
    padded[steps : steps + order] = output_coefficients[::-1]
    block, row, column = padded.strides
    # Row r, block t of the strip is beta_(order + r - t), which stands at padded[steps + t - r].
    strip = np.lib.stride_tricks.as_strided(padded[steps:], (steps, q, order, q), (-block, row, block, column))
    # Row r, block t of the triangle is -beta_(r - t), which stands at padded[steps + order + t - r].
    inner = np.lib.stride_tricks.as_strided(padded[steps + order :], (steps, q, steps, q), (-block, row, block, column))
    triangle = -np.ascontiguousarray(inner).reshape(steps * q, steps * q)
    return np.ascontiguousarray(strip).reshape(steps * q, order * q), triangle
