"""A discrete-time state-space model with the evidence it was cut from.

    x(k+1) = A x(k) + B u(k) + K e(k)
    y(k)   = C x(k) + D u(k) + e(k)
"""

from dataclasses import KW_ONLY, dataclass

from okid.arrays import FloatArray

__all__ = ["HankelFactors", "Realisation"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HankelFactors:
    """The balanced factors H(0) = observability @ controllability that the SVD of the block Hankel matrix gave.

    They are data, not model: rebuilt from (A, B, C) they would make every accuracy indicator 1. Channels are scaled
    (output i by 1/output_scale[i], input j by 1/input_scale[j]).

    Attributes:
        observability: (n_block_rows * n_outputs, n_kept) U S^(1/2).
        controllability: (n_kept, n_block_columns * n_inputs) S^(1/2) V'.
        n_block_rows: a, number of block rows.
        n_block_columns: b, number of block columns.
        input_scale: (n_inputs,) by which inputs were scaled.
        output_scale: (n_outputs,) by which outputs were scaled.
        observer_order: p of the observer that the Markov parameters came from, None when they were measured.
    """

    observability: FloatArray
    controllability: FloatArray
    n_block_rows: int
    n_block_columns: int
    input_scale: FloatArray
    output_scale: FloatArray
    observer_order: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Realisation:
    """State-space model in the units of the record; see the module for its equations.

    Attributes:
        A: (order, order).
        B: (order, n_inputs).
        C: (n_outputs, order).
        D: (n_outputs, n_inputs).
        dt: time step [s].
        K: (order, n_outputs) gain of the one-step predictor, None when none is known.
        singular_values: of the scaled block Hankel matrix, all that were computed; empty after `from_control`.
        factors: Hankel factors of this order, None when the model did not come from data.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    dt: float
    _: KW_ONLY
    K: FloatArray | None = None
    singular_values: FloatArray = ()  # type: ignore[assignment]  # an array once constructed
    factors: HankelFactors | None = None

    @property
    def order(self) -> int:
        """Number of states."""
        return self.A.shape[0]
