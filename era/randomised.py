"""Leading singular triplets of a large block Hankel matrix, without the matrix.

A random sketch H' W finds the row space; where it misses part of it (noisy data: H has full rank) power steps H' H
turn it towards the leading vectors. Where the last column of the sketch adds nothing to the others the row space is
complete, so noise-free data (H of low rank) are decomposed to rounding with no power step at all.

References:
    Halko, Martinsson, Tropp, SIAM Review 53(2), 2011, 217-288, doi 10.1137/090771806.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from era.hankel import BlockHankelOperator
from okid.arrays import FloatArray
from okid.errors import NumericalError

__all__ = ["LeadingTriplets", "leading_triplets"]

COMPLETE = 1e-12
"""What the last column of the sketch adds to the others, relative to the largest, when it adds but rounding error."""
SETTLED = 0.03
"""Sine of the angle by which the wanted vectors still turned, below which another power step is not worth its price."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LeadingTriplets:
    """H ~ left @ diag(singular_values) @ right.

    Attributes:
        left: (n_rows, n_kept), orthonormal columns; H right' = left diag(singular_values) holds to rounding.
        singular_values: (n_kept,), falling.
        right: (n_kept, n_columns), orthonormal rows.
        subspace_error: (n_kept,) sine of the angle between each left vector and the subspace one power step earlier:
            what the last step still changed, more than what is left to change.
        complete: whether the triplets hold the whole matrix to rounding.
    """

    left: FloatArray
    singular_values: FloatArray
    right: FloatArray
    subspace_error: FloatArray
    complete: bool


def leading_triplets(
    operator: BlockHankelOperator,
    n_wanted: int,
    *,
    rng: np.random.Generator,
    oversampling: int = 6,
    n_power_steps: int = 2,
) -> LeadingTriplets:
    """The `n_wanted` leading singular triplets of H.

    Args:
        operator: H.
        n_wanted: number of triplets.
        rng: source of the sketch.
        oversampling: columns of the sketch beyond `n_wanted`.
        n_power_steps: products with H' H at most, when the sketch does not hold the whole row space; at least one is
            done, more while the wanted vectors still turn.

    Example:
        >>> h = 0.9 ** np.arange(40.0).reshape(40, 1, 1)
        >>> found = leading_triplets(BlockHankelOperator.of(h, 20, 20), 3, rng=np.random.default_rng(0))
        >>> found.complete, round(float(found.singular_values[0]), 6)
        (True, 4.666827)
    """
    n_rows, n_columns = operator.shape
    n_basis = min(n_wanted + oversampling, n_rows, n_columns)
    heads = rng.integers(0, 2, size=(n_rows, n_basis), dtype=np.int8)
    reflectors, scalars = _reflectors(operator.transpose_times(2.0 * heads.astype(np.float64) - 1.0))
    sizes = np.abs(np.diagonal(reflectors))
    largest = float(sizes.max(initial=0.0))
    missed = float(sizes[-1]) / largest if largest > 0.0 and n_basis < min(n_rows, n_columns) else 0.0
    rows = _generate(reflectors, scalars)
    complete = missed <= COMPLETE
    if complete:
        left, values, turn = _tall_svd(operator.times(rows))
        error = np.minimum(1.0, missed * values[0] / np.maximum(values, np.finfo(float).tiny))
    else:
        rows, left, values, turn, error = _power_steps(operator, rows, n_wanted, n_power_steps)
    kept = slice(0, min(n_wanted, n_basis))
    return LeadingTriplets(
        left=np.ascontiguousarray(left[:, kept]),
        singular_values=values[kept],
        right=turn[kept] @ rows.T,
        subspace_error=error[kept],
        complete=complete,
    )


def _power_steps(
    operator: BlockHankelOperator, rows: FloatArray, n_wanted: int, n_steps: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Row basis, the decomposition of H times it, and the sines by which the left vectors turned in the last step."""
    before = _orthonormal(operator.times(rows))
    step = 1
    while True:
        rows = _orthonormal(operator.transpose_times(before))
        left, values, turn = _tall_svd(operator.times(rows))
        outside = left - before @ (before.T @ left)
        sines = np.minimum(1.0, np.sqrt(np.square(outside).sum(axis=0)))
        if step >= n_steps or sines[:n_wanted].max(initial=0.0) <= SETTLED:
            return rows, left, values, turn, sines
        before = left
        step += 1


def _tall_svd(columns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Singular value decomposition of a tall matrix by way of its triangular factor."""
    reflectors, scalars = _reflectors(columns)
    left, values, right = np.linalg.svd(np.triu(reflectors[: columns.shape[1]]))
    return _generate(reflectors, scalars) @ left, values, right


def _orthonormal(columns: FloatArray) -> FloatArray:
    """Q by Householder reflections: LAPACK called as it is, up to three times faster than numpy.linalg.qr when tall."""
    return _generate(*_reflectors(columns))


def _reflectors(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    reflectors, scalars, _, info = scipy.linalg.lapack.dgeqrf(columns)
    if info:
        raise NumericalError(f"LAPACK's dgeqrf failed with info {info}; check the Markov parameters.")
    return reflectors, scalars


def _generate(reflectors: FloatArray, scalars: FloatArray) -> FloatArray:
    basis, _, info = scipy.linalg.lapack.dorgqr(reflectors, scalars, overwrite_a=1)
    if info:
        raise NumericalError(f"LAPACK's dorgqr failed with info {info}; check the Markov parameters.")
    result: FloatArray = basis
    return result
