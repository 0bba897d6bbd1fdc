"""Linear recursions dx[k+1] = M[k] dx[k] + b[k+1] over a whole trajectory as one triangular banded solve.

The stacked unknowns obey a unit lower triangular system of bandwidth 2n - 1, which LAPACK's `dtbtrs` solves for all
right-hand sides at once: no loop over time in Python, whatever the coefficients do.
"""

import numpy as np
import scipy

from modal.simulation.budget import add_work
from okid.arrays import FloatArray

__all__ = ["band_of", "solve_band"]


def band_of(transitions: FloatArray) -> FloatArray:
    """The band storage of the recursion.

    Args:
        transitions: M (n, n, n_times); `transitions[:, :, k]` leads from time k to k + 1, the last one is not used.
            Zeros at the last time of a record cut the recursion there.

    Returns:
        (2 n, n_times n) in LAPACK's lower band storage, unit diagonal included.
    """
    n, _, n_times = transitions.shape
    if n == 0:  # nothing is led on
        return np.zeros((0, 0))
    band = np.zeros((n_times, n, 2 * n))
    for row in range(n):
        for column in range(n):
            band[:, column, n + row - column] = -transitions[row, column]
    band[:, :, 0] = 1.0
    band[-1, :, 1:] = 0.0
    return band.reshape(n_times * n, 2 * n).T


def solve_band(band: FloatArray, forcing: FloatArray) -> FloatArray:
    """Solve the recursion for several forcings.

    Args:
        band: From `band_of`.
        forcing: b (n_columns, n_times, n); `forcing[:, 0]` are the initial states.

    Returns:
        dx (n_columns, n_times, n).
    """
    n_columns, n_times, n = forcing.shape
    if n == 0 or n_columns == 0:
        add_work(n_times, 1)
        return forcing
    add_work(n_times, n)
    # Columns first in C order are LAPACK's right-hand sides in Fortran order: no copy.
    right = np.ascontiguousarray(forcing).reshape(n_columns, n_times * n).T
    solution, _ = scipy.linalg.lapack.dtbtrs(band, right, uplo="L", diag="U")
    return np.asarray(solution).T.reshape(n_columns, n_times, n)
