"""Two ways to say what noise does to the coefficients of an observer, and what it then does to functionals of them.

White: residuals that do not carry over, so that cov(Theta) = P (x) Sigma_e. Blocks: whatever the residuals are, the
deviations that contiguous blocks of rows would have made are what Theta scatters by (`okid.block_grams`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from okid.arrays import ComplexArray, FloatArray
from okid.block_grams import FEWEST_BLOCKS, block_deviations, block_grams, pair_freedom
from okid.coefficient_covariance import CoefficientCovariance, coefficient_covariance
from okid.errors import InvalidDataError
from okid.gram import LagGram, lag_gram
from okid.observer import ObserverFit
from okid.record import Record
from okid.recursion import solve_recursion
from okid.scaling import channel_scaling

__all__ = ["BlockNoise", "WhiteNoise", "block_noise", "white_noise"]

_NEGLIGIBLE = 1e-14
"""Share of the largest eigenvalue below which a direction of a pulse's regressors is rounding."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WhiteNoise:
    """Residuals without memory.

    Attributes:
        covariance: of the coefficients for residuals of unit variance.
        root: (n_outputs, n_outputs) S with S S' the covariance of the residuals of scaled outputs.
        degrees_of_freedom: of the residuals.
    """

    covariance: CoefficientCovariance
    root: FloatArray
    degrees_of_freedom: float

    def products(self, regressors: ComplexArray, weights: ComplexArray) -> tuple[FloatArray, ComplexArray]:
        """E |f|^2 and E f^2 of the numbers f = sum over s of weights[:, s]' dTheta' regressors[:, s].

        Args:
            regressors: (n_unknowns, n_steps).
            weights: (n_numbers, n_steps, n_outputs).
        """
        n_numbers, n_steps, n_outputs = weights.shape
        weighed = (weights @ self.root).transpose(1, 0, 2).reshape(n_steps, -1)
        # the triangular solve is done on whichever has fewer columns
        if weighed.shape[1] < n_steps:
            plain, pulled = self._spread(regressors @ weighed)
            first = (np.abs(plain) ** 2).sum(axis=0) - (np.abs(pulled) ** 2).sum(axis=0)
            second = (plain**2).sum(axis=0) - (pulled**2).sum(axis=0)
        else:
            plain, pulled = self._spread(regressors)
            hermitian = plain.conj().T @ plain - pulled.conj().T @ pulled
            first = (weighed.conj() * (hermitian @ weighed)).sum(axis=0).real
            second = (weighed * ((plain.T @ plain - pulled.T @ pulled) @ weighed)).sum(axis=0)
        return first.reshape(n_numbers, n_outputs).sum(axis=1), second.reshape(n_numbers, n_outputs).sum(axis=1)

    def response_variance(self, regressors: FloatArray, output_coefficients: FloatArray) -> FloatArray:
        """(n_steps, n_outputs) variance of dh(k) = dTheta' v(k) + sum over i of beta_i dh(k-i).

        That is a convolution of dTheta' v with the gain Markov parameters. With F F' = v' P v (steps by steps; a pulse
        response has few directions, so F is thin), the variance is the square of the convolution of F with g S.

        Args:
            regressors: (n_unknowns, n_steps) v(k).
            output_coefficients: (order, n_outputs, n_outputs) beta.
        """
        plain, pulled = self.covariance.spread(regressors)
        values, vectors = np.linalg.eigh(plain.T @ plain - pulled.T @ pulled)
        kept = values > _NEGLIGIBLE * max(values[-1], np.finfo(np.float64).tiny)
        factor = vectors[:, kept] * np.sqrt(values[kept])
        forcing = np.zeros((regressors.shape[1], *self.root.shape))
        forcing[0] = self.root
        response = solve_recursion(output_coefficients, forcing)
        variance = np.zeros(response.shape[:2])
        for i, j in np.ndindex(*response.shape[1:]):
            moved = _lower_toeplitz(response[:, i, j]) @ factor
            variance[:, i] += np.einsum("kr,kr->k", moved, moved)
        return variance

    def _spread(self, functionals: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        n_columns = functionals.shape[1]
        plain, pulled = self.covariance.spread(np.concatenate([functionals.real, functionals.imag], axis=1))
        return (
            plain[:, :n_columns] + 1j * plain[:, n_columns:],
            pulled[:, :n_columns] + 1j * pulled[:, n_columns:],
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BlockNoise:
    """Residuals of any kind.

    Attributes:
        deviations: (n_deviations, n_unknowns, n_outputs) of the coefficients, whose squares add up to their variance.
        degrees_of_freedom: of that variance.
    """

    deviations: FloatArray
    degrees_of_freedom: float

    def products(self, regressors: ComplexArray, weights: ComplexArray) -> tuple[FloatArray, ComplexArray]:
        """As `WhiteNoise.products`."""
        n_blocks, n_unknowns, n_outputs = self.deviations.shape
        turned = self.deviations.transpose(0, 2, 1).reshape(-1, n_unknowns)
        moved = (turned @ regressors.real + 1j * (turned @ regressors.imag)).reshape(n_blocks, n_outputs, -1)
        numbers = moved.reshape(n_blocks, -1) @ weights.transpose(2, 1, 0).reshape(-1, weights.shape[0])
        return (np.abs(numbers) ** 2).sum(axis=0), (numbers**2).sum(axis=0)

    def response_variance(self, regressors: FloatArray, output_coefficients: FloatArray) -> FloatArray:
        """As `WhiteNoise.response_variance`, by running the recursion on every deviation."""
        n_blocks, n_unknowns, n_outputs = self.deviations.shape
        turned = self.deviations.transpose(2, 0, 1).reshape(-1, n_unknowns) @ regressors
        forcing = turned.reshape(n_outputs, n_blocks, -1).transpose(2, 0, 1)
        moved = solve_recursion(output_coefficients, np.ascontiguousarray(forcing))
        variance: FloatArray = np.square(moved).sum(axis=2)
        return variance


def white_noise(records: Sequence[Record], observer: ObserverFit) -> WhiteNoise:
    """Noise of the residual covariance of this fit.

    Raises:
        InvalidDataError: records that the observer was not fitted to.
    """
    gram = lag_gram(records, observer.order, scaling=channel_scaling(records))
    _check_rows([gram], observer)
    residual = observer.residual_covariance / np.outer(observer.output_scale, observer.output_scale)
    values, vectors = np.linalg.eigh(residual)
    return WhiteNoise(
        covariance=coefficient_covariance(gram, observer.ridge),
        root=vectors * np.sqrt(np.maximum(values, 0.0)),
        degrees_of_freedom=float(max(observer.n_rows - observer.rank, 1)),
    )


def block_noise(records: Sequence[Record], observer: ObserverFit) -> BlockNoise:
    """Noise as the blocks of the records show it.

    Raises:
        InvalidDataError: records that the observer was not fitted to.
        InsufficientDataError: fewer than two blocks have a row to fit.
    """
    parts = block_grams(records, observer.order, scaling=channel_scaling(records), n_blocks=FEWEST_BLOCKS)
    _check_rows(parts, observer)
    return BlockNoise(deviations=block_deviations(parts, observer.ridge), degrees_of_freedom=pair_freedom(len(parts)))


def _check_rows(parts: Sequence[LagGram], observer: ObserverFit) -> None:
    have = (parts[0].n_inputs, parts[0].n_outputs, sum(part.n_rows for part in parts))
    want = (observer.n_inputs, observer.n_outputs, observer.n_rows)
    if have != want:
        raise InvalidDataError(
            f"the records must be those of the observer fit, with (inputs, outputs, rows) {want}, but have {have}."
        )


def _lower_toeplitz(values: FloatArray) -> FloatArray:
    """T with T[k, s] = values[k - s] for k >= s, else 0."""
    n_steps = values.size
    padded = np.concatenate([np.zeros(n_steps - 1), values])
    return np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(padded, n_steps)[:, ::-1])
