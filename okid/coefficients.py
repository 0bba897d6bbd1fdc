"""Coefficients of the observer equation in scaled channels, and their way into the units of the record."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from okid.arrays import FloatArray

__all__ = ["Method", "ObserverCoefficients", "coefficients_from_solution"]

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
