"""One decomposition of the scaled block Hankel matrix, and from it the balanced model of the highest order.

    H(0) = U S V',   A = S^(-1/2) U' H(1) V S^(-1/2),   B = S^(1/2) V' E_in,   C = E_out' U S^(1/2)

- H(1) is H(0) without its first block row, and one new block row at the end. So U' H(1) V needs no product with H(1):
  H(0) V = U S gives all of it but the last block row.
- U S^(1/2) is the observability matrix, so the gain comes from its own Markov parameters by K = S^(-1/2) U' [g1; g2;
  ...].
- Channels are scaled to comparable size first (h[i, j] input_scale[j] / output_scale[i]), because the decomposition
  weighs them by size; the scales are undone on B, C and K.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from era.hankel import BlockHankelOperator, block_hankel, block_sizes, hankel_energy
from era.order import CLEAR_GAP
from era.randomised import leading_triplets
from okid.arguments import require
from okid.arrays import FloatArray
from okid.errors import InsufficientDataError, InvalidDataError
from okid.markov import MarkovParameters

__all__ = ["HankelDecomposition", "Method", "RealiseOn", "decompose"]

Method = Literal["auto", "full", "randomised"]
RealiseOn = Literal["system", "system_and_gain"]

FULL_UP_TO = 1.5e6
"""Rows x columns x smaller side of a block Hankel matrix that is always decomposed in full (1-2 ms)."""
FIRST_RANK = 32
"""Triplets that are looked for first when nobody said how many are needed."""
LARGEST_RANK = 256
"""Triplets that are looked for at most when nobody said how many are needed."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HankelDecomposition:
    """Singular value decomposition of the scaled block Hankel matrix, with the model of the highest order it allows.

    Attributes:
        left: (n_block_rows * n_outputs, max_order) leading left singular vectors U.
        singular_values: all that were computed, falling; at least max_order.
        right: (max_order, n_block_columns * n_channels) leading right singular vectors V'; n_channels counts the
            inputs, the outputs where the gain stands in for missing inputs, or both for "system_and_gain".
        A: (max_order, max_order) of the scaled channels.
        B: (max_order, n_inputs) in the units of the record.
        C: (n_outputs, max_order) in the units of the record.
        D: (n_outputs, n_inputs) in the units of the record.
        K: (max_order, n_outputs) in the units of the record, None when no gain is known.
        dt: time step [s].
        rank: numerical rank as far as it was computed: singular values above rounding error; never below max_order.
        energy: sum of the squares of all singular values, also of those not computed.
        subspace_error: (max_order,) sine of the angle between each left singular vector and the subspace one power step
            earlier; zeros for the full decomposition. Vectors below about 0.1 agree with the full decomposition; larger
            ones belong to the noise floor, where neighbouring singular values are too close for their vectors to
            settle.
        method: how it was computed.
        n_block_rows: number of block rows.
        n_block_columns: number of block columns.
        input_scale: (n_inputs,) by which inputs were scaled.
        output_scale: (n_outputs,) by which outputs were scaled.
        observer_order: of the observer behind the Markov parameters, None when they were measured.
    """

    left: FloatArray
    singular_values: FloatArray
    right: FloatArray
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    K: FloatArray | None
    dt: float
    rank: int
    energy: float
    subspace_error: FloatArray
    method: Literal["full", "randomised"]
    n_block_rows: int
    n_block_columns: int
    input_scale: FloatArray
    output_scale: FloatArray
    observer_order: int | None

    def __post_init__(self) -> None:
        for array in (self.left, self.singular_values, self.right, self.A, self.B, self.C, self.K, self.subspace_error):
            if array is not None:
                array.flags.writeable = False

    @property
    def max_order(self) -> int:
        """Highest order that `era.balanced.realise_from` can give."""
        order: int = self.A.shape[0]
        return order


def decompose(
    markov: MarkovParameters,
    *,
    n_block_rows: int | None = None,
    n_block_columns: int | None = None,
    max_order: int | None = None,
    method: Method = "auto",
    realise_on: RealiseOn = "system",
    rng: np.random.Generator | None = None,
) -> HankelDecomposition:
    """Decompose the block Hankel matrix once, for the models of all orders.

    Args:
        markov: Markov parameters; without inputs, those of the gain are realised (output only).
        n_block_rows: by default from `era.hankel.block_sizes`.
        n_block_columns: likewise; rows and columns together use every lag.
        max_order: highest order wanted; by default as many as the matrix (in full) or the search for the noise floor
            (randomised) gives.
        method: "full" is LAPACK's decomposition; "randomised" finds the leading part by products with H, exact to
            rounding when H has low rank, and otherwise to `subspace_error`; "auto" takes "full" for small matrices.
        realise_on: "system", or "system_and_gain" for the joint Hankel matrix of [h g]. The joint form has spurious
            modes on noise-free data, where the gain is not that of the system's own order.
        rng: for the randomised method; a fixed seed unless given, so equal data give equal models.

    Raises:
        InsufficientDataError: too few lags for the block sizes or for max_order.
        InvalidDataError: the joint form, or no inputs, without Markov parameters of a gain; a method or realise_on that
            is none of those above.

    Example:
        >>> markov = MarkovParameters(system=0.9 ** np.arange(20.0).reshape(20, 1, 1), dt=0.1)
        >>> found = decompose(markov)
        >>> found.rank, round(float(found.A[0, 0]), 12)
        (1, 0.9)
    """
    require(markov, MarkovParameters, where="a realisation", made_by="okid.recover_markov")
    for name, choice, known in (("method", method, get_args(Method)), ("realise_on", realise_on, get_args(RealiseOn))):
        if choice not in known:
            raise InvalidDataError(f"{name} must be one of {', '.join(known)}, but is {choice!r}.")
    scaled = _scaled_markov(markov, realise_on)
    _, n_outputs, n_channels = scaled.shape
    a, b = block_sizes(markov.n_lags, n_outputs, n_channels, n_block_rows=n_block_rows, n_block_columns=n_block_columns)
    _check_order(max_order, (a, n_outputs), (b, n_channels))
    if method == "auto":
        method = _cheaper_method(a * n_outputs, b * n_channels, max_order)
    if method == "full":
        left, values, right, error = _full(scaled, a, b, max_order)
    else:
        generator = np.random.default_rng(0) if rng is None else rng
        left, values, right, error = _randomised(scaled, a, b, max_order, generator)
    A, B, C = _balanced_model(scaled, left, values[: left.shape[1]], right)
    gain_of = slice(n_channels - n_outputs, None) if _gain_is_realised(markov, realise_on) else None
    K = B[:, gain_of] if gain_of is not None else _gain(markov, left, values[: left.shape[1]], a)
    return HankelDecomposition(
        left=left,
        singular_values=values,
        right=right,
        A=A,
        B=B[:, : markov.n_inputs] / markov.input_scale,
        C=markov.output_scale[:, np.newaxis] * C,
        D=markov.system[0],
        K=None if K is None else K / markov.output_scale,
        dt=markov.dt,
        rank=_rank(values, a * n_outputs, b * n_channels),
        energy=hankel_energy(scaled, a, b),
        subspace_error=error,
        method=method,
        n_block_rows=a,
        n_block_columns=b,
        input_scale=markov.input_scale,
        output_scale=markov.output_scale,
        observer_order=markov.observer_order,
    )


def _gain_is_realised(markov: MarkovParameters, realise_on: RealiseOn) -> bool:
    return realise_on == "system_and_gain" or markov.n_inputs == 0


def _scaled_markov(markov: MarkovParameters, realise_on: RealiseOn) -> FloatArray:
    """What the block Hankel matrix is made of: (n_lags + 1, n_outputs, n_channels), channels of comparable size."""
    out = markov.output_scale[:, np.newaxis]
    system = markov.system * (markov.input_scale / out)
    if not _gain_is_realised(markov, realise_on):
        return system
    if markov.gain is None:
        raise InvalidDataError(
            "Markov parameters without inputs, or a joint realisation with the gain, need the Markov parameters of "
            "a gain, but there are none; recover them from an observer, or give system Markov parameters."
        )
    return np.concatenate([system, markov.gain * (markov.output_scale / out)], axis=2)


def _check_order(max_order: int | None, rows: tuple[int, int], columns: tuple[int, int]) -> None:
    """Blocks and channels of both sides must make a matrix of at least `max_order` rows and columns."""
    (a, n_outputs), (b, n_channels) = rows, columns
    smaller = min(a * n_outputs, b * n_channels)
    if max_order is not None and not 0 <= max_order <= smaller:
        raise InsufficientDataError(
            f"model order {max_order} needs a block Hankel matrix of at least that many rows and columns, but {a} "
            f"block rows of {n_outputs} and {b} block columns of {n_channels} channels make {a * n_outputs} x "
            f"{b * n_channels}; use an order from 0 to {smaller} or recover more lags."
        )


def _cheaper_method(n_rows: int, n_columns: int, max_order: int | None) -> Literal["full", "randomised"]:
    smaller = min(n_rows, n_columns)
    wanted = FIRST_RANK if max_order is None else max_order
    small = float(n_rows) * n_columns * smaller <= FULL_UP_TO
    return "full" if small or 4 * wanted >= smaller else "randomised"


def _full(
    scaled: FloatArray, a: int, b: int, max_order: int | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    left, values, right = np.linalg.svd(block_hankel(scaled, a, b), full_matrices=False)
    kept = _rank(values, left.shape[0], right.shape[1])
    if max_order is not None:
        kept = min(kept, max_order)
    return left[:, :kept], values, right[:kept], np.zeros(kept)


def _randomised(
    scaled: FloatArray, a: int, b: int, max_order: int | None, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    operator = BlockHankelOperator.of(scaled, a, b)
    smaller = min(operator.shape)
    wanted = min(FIRST_RANK if max_order is None else max_order, smaller)
    found = leading_triplets(operator, wanted, rng=rng)
    while max_order is None and not (found.complete or _shows_a_gap(found.singular_values)):
        if 2 * wanted > min(LARGEST_RANK, smaller // 4):
            break
        wanted *= 2
        found = leading_triplets(operator, wanted, rng=rng)
    kept = _rank(found.singular_values, *operator.shape)
    return found.left[:, :kept], found.singular_values, found.right[:kept], found.subspace_error[:kept]


def _shows_a_gap(values: FloatArray) -> bool:
    """Whether the largest ratio of neighbours is clear and stands well before the end of what was computed."""
    ratios = values[:-1] / np.maximum(values[1:], np.finfo(float).tiny)
    largest = int(np.argmax(ratios))
    return bool(ratios[largest] >= CLEAR_GAP and largest < 3 * values.size // 4)


def _rank(values: FloatArray, n_rows: int, n_columns: int) -> int:
    if values.size == 0 or values[0] == 0.0:
        return 0
    return int((values > values[0] * max(n_rows, n_columns) * np.finfo(float).eps).sum())


def _balanced_model(
    scaled: FloatArray, left: FloatArray, values: FloatArray, right: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B and C of the scaled channels, from U' H(1) V = (U without its last block)' (U S without its first) + new."""
    _, n_outputs, n_channels = scaled.shape
    a, b = left.shape[0] // n_outputs, right.shape[1] // n_channels
    root = np.sqrt(values)
    newest = scaled[a + 1 : a + 1 + b].transpose(1, 0, 2).reshape(n_outputs, b * n_channels)
    kept = (left[: (a - 1) * n_outputs].T @ left[n_outputs:]) * values
    A = (kept + left[(a - 1) * n_outputs :].T @ (newest @ right.T)) / (root[:, np.newaxis] * root)
    return A, root[:, np.newaxis] * right[:, :n_channels], left[:n_outputs] * root


def _gain(markov: MarkovParameters, left: FloatArray, values: FloatArray, n_block_rows: int) -> FloatArray | None:
    """K of the scaled channels by least squares on [g1; g2; ...] = O K."""
    if markov.gain is None:
        return None
    scaled = markov.gain * (markov.output_scale / markov.output_scale[:, np.newaxis])
    stacked = scaled[1 : 1 + n_block_rows].reshape(-1, markov.n_outputs)
    return (left.T @ stacked) / np.sqrt(values)[:, np.newaxis]
