"""The observer fit: an ARX model of the data by least squares, the first half of OKID.

    y(k) = D u(k) + sum_{i=1..p} [alpha_i u(k-i) + beta_i y(k-i)] + offset + e(k)

with alpha_i = C Abar^(i-1) (B - K D), beta_i = C Abar^(i-1) K, Abar = A - K C (Juang, Phan, Horta, Longman, Journal of
Guidance, Control, and Dynamics 16(2), 1993, doi 10.2514/3.21006). The first p samples of every record are dropped, so
any initial state is right.
"""

from dataclasses import dataclass
from typing import Literal

from okid.arrays import FloatArray

__all__ = ["ObserverFit"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObserverFit:
    """Coefficients of the observer equation, in the units of the record.

    Attributes:
        feedthrough: (n_outputs, n_inputs) D.
        input_coefficients: (order, n_outputs, n_inputs) alpha_1 ... alpha_order.
        output_coefficients: (order, n_outputs, n_outputs) beta_1 ... beta_order.
        offset: (n_outputs,) constant of each output's equation.
        dt: time step [s].
        ridge: what was added to the unit diagonal of the Gram matrix of the scaled channels, for lag 0; it grows with
            the lag as ridge (1 + lag).
        input_scale: (n_inputs,) standard deviation of each input, by which channels were made comparable.
        output_scale: (n_outputs,) likewise.
        residual_covariance: (n_outputs, n_outputs) of the one-step residual e, degrees of freedom taken off.
        n_rows: number of complete rows that were fitted.
        n_parameters: unknowns per output.
        condition: estimated 2-norm condition number of the scaled regressor matrix, ridge excluded.
        method: "cholesky", "eigh" (rank-deficient: directions without information left out) or "qr" (short or
            ill-conditioned).
        rank: number of directions kept.
    """

    feedthrough: FloatArray
    input_coefficients: FloatArray
    output_coefficients: FloatArray
    offset: FloatArray
    dt: float
    ridge: float
    input_scale: FloatArray
    output_scale: FloatArray
    residual_covariance: FloatArray
    n_rows: int
    n_parameters: int
    condition: float
    method: Literal["cholesky", "eigh", "qr"]
    rank: int

    @property
    def order(self) -> int:
        """Number of past samples that the observer uses."""
        return self.output_coefficients.shape[0]

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return self.feedthrough.shape[1]

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return self.feedthrough.shape[0]
