"""Initial state and level of each output, by least squares on the training samples of a free run.

With x = a + j b per pole the free response is Re(w c lambda^k x), so every sum over rows and outputs follows from the
sums of lambda_i^k lambda_j^k and conj(lambda_i)^k lambda_j^k over the rows, and these have a closed form.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy

from okid.arrays import ComplexArray, FloatArray

__all__ = ["TrainingPattern", "fit_initial_state"]

TrainingPattern = tuple[npt.NDArray[np.int64], Sequence[tuple[int, int]]]
"""Outputs, and the runs (first, one past last) of the rows on which these outputs train."""
STATE_REGULARISATION = 1e-9
"""Of each free response's energy over the whole record: keeps a response that no training row shows from growing."""


def fit_initial_state(
    poles: ComplexArray,
    shapes: ComplexArray,
    products: ComplexArray,
    totals: FloatArray,
    *,
    patterns: Sequence[TrainingPattern],
    n_samples: int,
) -> tuple[ComplexArray, FloatArray]:
    """Least squares of what the inputs do not explain on the free responses and a constant.

    Args:
        poles: (n_poles,) one of each conjugate pair.
        shapes: (n_outputs, n_poles) w c, with the weights.
        products: (n_poles,) sum over training samples of what is to be explained times w c lambda^k.
        totals: (n_outputs,) sum over training samples of what is to be explained.
        patterns: every output in one of them.
        n_samples: of the record.

    Returns:
        (n_poles,) initial state and (n_outputs,) level.
    """
    n_poles, n_outputs = poles.size, totals.size
    plain, conjugate = np.zeros((2, n_poles, n_poles), dtype=np.complex128)
    to_level = np.empty((n_poles, n_outputs), dtype=np.complex128)
    n_rows = np.empty(n_outputs)
    same, crossed = np.outer(poles, poles), np.outer(poles.conj(), poles)
    for outputs, runs in patterns:
        edges = np.array(runs, dtype=np.int64).reshape(-1, 2)
        own, n_trained = shapes[outputs], float((edges[:, 1] - edges[:, 0]).sum())
        first, last = poles[:, np.newaxis] ** edges[:, 0], poles[:, np.newaxis] ** edges[:, 1]
        plain += _series(first @ first.T - last @ last.T, same, n_trained) * (own.T @ own)
        conjugate += _series(first.conj() @ first.T - last.conj() @ last.T, crossed, n_trained) * (own.conj().T @ own)
        to_level[:, outputs] = _series((first - last).sum(axis=1), poles, n_trained)[:, np.newaxis] * own.T
        n_rows[outputs] = max(1.0, n_trained)

    size = 2 * n_poles + n_outputs
    matrix = np.zeros((size, size))
    a, b, c = slice(0, n_poles), slice(n_poles, 2 * n_poles), slice(2 * n_poles, size)
    matrix[a, a] = 0.5 * (conjugate.real + plain.real)
    matrix[b, b] = 0.5 * (conjugate.real - plain.real)
    matrix[a, b] = -0.5 * (conjugate.imag + plain.imag)
    matrix[b, a] = matrix[a, b].T
    matrix[a, c], matrix[b, c] = to_level.real, -to_level.imag
    matrix[c, a], matrix[c, b] = to_level.real.T, -to_level.imag.T
    matrix[c, c] = np.diag(n_rows)
    vector = np.concatenate([products.real, -products.imag, totals])

    energy = 0.5 * _energies(poles, n_samples) * np.square(np.abs(shapes)).sum(axis=0)
    scale = np.concatenate([energy, energy, n_rows])
    scale = np.sqrt(np.where(scale > 0.0, scale, 1.0))
    scaled = matrix / np.outer(scale, scale)
    scaled[np.diag_indices(size)] += STATE_REGULARISATION
    solution = _solved(scaled, vector / scale) / scale
    return solution[a] + 1j * solution[b], solution[c]


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    _, solution, info = scipy.linalg.lapack.dposv(matrix, right)
    if info:  # rounding of the sums beyond the regularisation: poles at the edge of stability
        solution = scipy.linalg.lstsq(matrix, right, cond=1e-13, check_finite=False)[0]
    result: FloatArray = solution
    return result


def _series(ends: ComplexArray, ratio: ComplexArray, n_rows: float) -> ComplexArray:
    """Sum of ratio^k over the runs' rows, from the sum of ratio^first - ratio^last over the runs."""
    # a ratio of 1 (an integrator): every term of the series is 1
    one = np.abs(1.0 - ratio) < 1e-12
    return np.where(one, n_rows, ends / np.where(one, 1.0, 1.0 - ratio))


def _energies(poles: ComplexArray, n_samples: int) -> FloatArray:
    """(n_poles,) sum of |pole|^(2 k) over the samples."""
    ratio = np.square(np.abs(poles))
    one = 1.0 - ratio < 1e-12
    result: FloatArray = np.where(one, float(n_samples), (1.0 - ratio**n_samples) / np.where(one, 1.0, 1.0 - ratio))
    return result
