"""The matrix behind the variance of an observer's coefficients, factored once: W = V V' + penalty.

With the regressors V of the rows that were fitted, the ridge estimate moves by W^-1 times what moves its right side,
and the data and not the ridge decide trace(W^-1 V V') of its unknowns.

References:
    Hoerl, Kennard, "Ridge regression: biased estimation for nonorthogonal problems", Technometrics 12(1), 1970,
    equation 2.8, doi 10.1080/00401706.1970.10488634.

Gram matrices of contiguous blocks of rows, and how far each block alone pulls the coefficients of the observer.

Sums over long blocks keep what single rows do not show: residuals that carry over from row to row, noise whose size
changes along the record, and what a ridge leaves unexplained. With W = V V' + penalty and Theta its solution,

    T_b = W^-1 (V_b Y_b' - V_b V_b' Theta - n_b / n penalty Theta),   sum of T_b = 0

and the sum of T_b[r, i] T_b[s, j] over blocks estimates cov(Theta[r, i], Theta[s, j]) whatever the residuals are, as
long as blocks are long against their memory and that of the regressors (covariance clustered by blocks).

References:
    Liang, Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73(1), 1986, 13-22, doi
    10.1093/biomet/73.1.13.
"""

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from okid.arrays import FloatArray
from okid.errors import InsufficientDataError
from okid.gram import LagGram, lag_gram
from okid.least_squares import cholesky, normal_equations, triangular_solve
from okid.record import Record
from okid.scaling import ChannelScaling

__all__ = [
    "FEWEST_BLOCKS",
    "CoefficientCovariance",
    "block_deviations",
    "block_grams",
    "coefficient_covariance",
    "pair_freedom",
]

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


FEWEST_BLOCKS = 20
"""Blocks from which on a standard deviation is known to 16 %."""


def block_grams(
    records: Sequence[Record], order: int, *, scaling: ChannelScaling, n_blocks: int
) -> tuple[LagGram, ...]:
    """Gram matrices of contiguous blocks of rows, about `n_blocks` in all; they add up to that of all rows.

    Args:
        records: of one system; each is cut into blocks of about the same length, at least one.
        order: observer order; the first rows of a block look back into the block before it.
        scaling: of the channels.
        n_blocks: over all records.

    Raises:
        InsufficientDataError: fewer than two blocks have a row without a gap.

    Example:
        >>> from okid.scaling import channel_scaling
        >>> record = Record(np.sin(np.arange(100.0)), np.cos(np.arange(100.0)), 0.1)
        >>> parts = block_grams([record], 4, scaling=channel_scaling([record]), n_blocks=20)
        >>> len(parts), sum(part.n_rows for part in parts)
        (20, 96)
    """
    total = sum(max(record.n_samples - order, 0) for record in records)
    parts = []
    for record in records:
        n_rows = record.n_samples - order
        if n_rows < 1:
            continue
        own = min(max(1, round(n_blocks * n_rows / total)), n_rows)
        edges = np.linspace(order, record.n_samples, own + 1).round().astype(int).tolist()
        for start, stop in itertools.pairwise(edges):
            part = lag_gram([record.samples(start - order, stop)], order, scaling=scaling)
            if part.n_rows:
                parts.append(part)
    if len(parts) < 2:
        raise InsufficientDataError(
            f"standard deviations need two blocks of rows that observer order {order} can be fitted to, but there are "
            f"{len(parts)}; use a lower order or a longer record."
        )
    return tuple(parts)


def block_deviations(parts: Sequence[LagGram], ridge: float) -> FloatArray:
    """T_b of neighbouring blocks in pairs, (T_b + T_(b+1)) / sqrt(2), scaled so that squares add up to the variance.

    A pair counts what its two blocks have in common, so it may be half as long as a block would have to be, at the
    price of a third of the degrees of freedom (see `pair_freedom`). What a fit to the same rows takes off is put back:
    the T_b sum to 0, and residuals are smaller than the noise (as in the correction HC1 of MacKinnon, White, Journal of
    Econometrics 29(3), 1985, doi 10.1016/0304-4076(85)90158-7).

    Args:
        parts: Gram matrices of the blocks in the order of the rows, of the observer's order.
        ridge: as in the fit.

    Returns:
        (n_blocks + 1, n_unknowns, n_outputs) for scaled channels; the first and the last block stand alone once.

    References:
        Newey, West, Econometrica 55(3), 1987, 703-708, doi 10.2307/1913610: weights 1 and 1/2 of blocks and neighbours.

    Example:
        >>> from okid.scaling import channel_scaling
        >>> rng = np.random.default_rng(0)
        >>> record = Record(rng.standard_normal(400), rng.standard_normal(400), 0.1)
        >>> parts = block_grams([record], 2, scaling=channel_scaling([record]), n_blocks=20)
        >>> bool(np.abs(block_deviations(parts, 1e-3).sum(axis=0)).max() < 1e-12)
        True
    """
    # one after the other: of many channels twenty Gram matrices side by side are gigabytes
    matrix = functools.reduce(np.add, (part.matrix for part in parts))
    whole = replace(parts[0], matrix=matrix, n_rows=sum(part.n_rows for part in parts))
    equations = normal_equations(whole, ridge)
    covariance = coefficient_covariance(whole, ridge)
    solution = covariance.solve(equations.right)
    pulls = []
    for part in parts:
        own = normal_equations(part, 0.0)
        penalty = equations.penalty[:, np.newaxis] * (part.n_rows / whole.n_rows)
        pulls.append(own.right - own.matrix @ solution - penalty * solution)
    n_unknowns, n_outputs = solution.shape
    moved = covariance.solve(np.concatenate(pulls, axis=1)).reshape(n_unknowns, len(parts), n_outputs)
    alone = np.zeros((len(parts) + 2, n_unknowns, n_outputs))
    alone[1:-1] = moved.transpose(1, 0, 2)
    spare = whole.n_rows / max(whole.n_rows - covariance.effective_unknowns, 1.0)
    scale = np.sqrt(0.5 * spare * len(parts) / max(len(parts) - 2, 1))
    deviations: FloatArray = scale * (alone[1:] + alone[:-1])
    return deviations


def pair_freedom(n_blocks: int) -> float:
    """Degrees of freedom of a variance from blocks in pairs: n_blocks over the sum of the squared weights, 1 + 2 / 4.

    Example:
        >>> pair_freedom(30)
        20.0
    """
    return max(n_blocks / 1.5, 1.0)
