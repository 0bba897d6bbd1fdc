"""The eigensystem realisation algorithm: a balanced state-space model from Markov parameters.

    H(0) = U S V',   A = S^(-1/2) U' H(1) V S^(-1/2),   B = S^(1/2) V' E_in,   C = E_out' U S^(1/2),   D = h[0]

with E_in and E_out the first block column of the identity. The model of a lower order is a corner of the model of a
higher order, so one decomposition serves all orders.

References:
    Juang, Pappa, Journal of Guidance, Control, and Dynamics 8(5), 1985, 620-627, doi 10.2514/3.20031.

- H(1) is H(0) without its first block row, and one new block row at the end. So U' H(1) V needs no product with H(1):
  H(0) V = U S gives all of it but the last block row.
- U S^(1/2) is the observability matrix, so the gain comes from its own Markov parameters by K = S^(-1/2) U' [g1; g2;
  ...].
- Channels are scaled to comparable size first (h[i, j] input_scale[j] / output_scale[i]), because the decomposition
  weighs them by size; the scales are undone on B, C and K.

ERA/DC, the eigensystem realisation algorithm with data correlations: ERA on correlations of the pulse responses.

    R(k) = H(k) H(0)',   H(k) block (i, j) = h[1 + k + i + j],   i < a = n_block_rows, j < b = n_block_columns
    U(k) block (i, j) = R(l + k + (i + j) a),   l = first_lag
    U(0) = P S Q',   A = S^(-1/2) P' U(1) Q S^(-1/2),   C = E_out' P S^(1/2),   [B ...] = S^(-1/2) P' H_tall

- With O and X the observability and controllability matrices of h[k] = C A^(k-1) B, R(k) = O A^k X H(0)': correlations
  are Markov parameters themselves, and U is the block Hankel matrix of the sequence R(l), R(l + a), R(l + 2a), ...
- White noise on h of variance v adds b v I to block (i, j) of R(k) where j = i + k, in the mean, and so nothing from
  k = a on: first_lag >= a, the default, keeps that bias out of every block. It is not the scatter that goes.
- The states are those of U(0) = [O; O A^a; ...] (A^l X H(0)' ...): its first factor is the observability matrix of the
  pulse responses over all block rows of U, the second one is not their controllability matrix. B is therefore the least
  squares solution of P S^(1/2) X = H_tall, the tall block Hankel matrix of h[1], h[2], ... with as many rows: from h[l]
  on it would be A^l B. (The paper takes the first a block rows only, which needs a n_outputs >= order; with every row
  the columns of P are orthonormal, and the model of a lower order is a corner of the one of a higher order.)
- U holds squares: modes a factor 1e-3 weaker than the strongest stand at 1e-6 in its singular values.

References:
    Juang, Cooper, Wright, An eigensystem realization algorithm using data correlations (ERA/DC) for modal parameter
    identification, Control Theory and Advanced Technology 4(1), 1988, 5-14.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from era.hankel import (
    BlockHankelOperator,
    GapChoice,
    Method,
    block_hankel,
    block_sizes,
    choose_order,
    hankel_energy,
    hankel_triplets,
)
from era.realisation import HankelFactors, Realisation
from okid.arrays import FloatArray, require, whole_number
from okid.display import Displayed
from okid.errors import InsufficientDataError, InvalidDataError
from okid.markov import MarkovParameters

RealiseOn = Literal["system", "system_and_gain"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class HankelDecomposition(Displayed):
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
    scaled = scaled_channels(markov, realise_on)
    _, n_outputs, n_channels = scaled.shape
    a, b = block_sizes(markov.n_lags, n_outputs, n_channels, n_block_rows=n_block_rows, n_block_columns=n_block_columns)
    _check_order(max_order, (a, n_outputs), (b, n_channels))
    found = hankel_triplets(scaled, a, b, max_order=max_order, method=method, rng=rng)
    values = found.singular_values[: found.left.shape[1]]
    A, B, C = _balanced_model(scaled, found.left, values, found.right)
    gain_of = slice(n_channels - n_outputs, None) if _gain_is_realised(markov, realise_on) else None
    K = B[:, gain_of] if gain_of is not None else _gain(markov, found.left, values, a)
    return HankelDecomposition(
        left=found.left,
        singular_values=found.singular_values,
        right=found.right,
        A=A,
        B=B[:, : markov.n_inputs] / markov.input_scale,
        C=markov.output_scale[:, np.newaxis] * C,
        D=markov.system[0],
        K=None if K is None else K / markov.output_scale,
        dt=markov.dt,
        rank=found.rank,
        energy=hankel_energy(scaled, a, b),
        subspace_error=found.subspace_error,
        method=found.method,
        n_block_rows=a,
        n_block_columns=b,
        input_scale=markov.input_scale,
        output_scale=markov.output_scale,
        observer_order=markov.observer_order,
    )


def _gain_is_realised(markov: MarkovParameters, realise_on: RealiseOn) -> bool:
    return realise_on == "system_and_gain" or markov.n_inputs == 0


def scaled_channels(markov: MarkovParameters, realise_on: RealiseOn) -> FloatArray:
    """What the block Hankel matrix is made of: (n_lags + 1, n_outputs, n_channels), channels of comparable size.

    Raises:
        InvalidDataError: the gain is needed and there is none.
    """
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


GAP_BEFORE_THE_END = 10.0
"""Ratio of neighbours from which a gap is preferred to the end of what an observer can give. On ten random systems of
three modes it was above 12 at 10 % noise with spare order, and gaps inside the system were below 9 at 1 % noise."""


def realise_from(decomposition: HankelDecomposition, order: int) -> Realisation:
    """The balanced model of one order: a corner of the model of the highest order, so nothing is decomposed again.

    Args:
        decomposition: from `decompose`.
        order: number of states, at most the decomposition's rank and max_order.

    Raises:
        InsufficientDataError: an order above the numerical rank or above what was decomposed.
        InvalidDataError: a negative order.

    Example:
        >>> markov = MarkovParameters(system=0.9 ** np.arange(20.0).reshape(20, 1, 1), dt=0.1)
        >>> realise_from(decompose(markov), 1).order
        1
    """
    found = decomposition
    order = whole_number(order, name="a model order", least=0)
    if order > found.rank:
        largest = found.singular_values[0] if found.singular_values.size else 0.0
        raise InsufficientDataError(
            f"model order {order} was asked for, but the {found.left.shape[0]} x {found.right.shape[1]} block Hankel "
            f"matrix has numerical rank {found.rank} (largest singular value {largest:.3g}, all beyond the rank are "
            f"rounding error); use an order of at most {found.rank}."
        )
    if order > found.max_order:
        raise InsufficientDataError(
            f"model order {order} was asked for, but only {found.max_order} orders were decomposed; decompose with "
            f"max_order={order}."
        )
    root = np.sqrt(found.singular_values[:order])
    observability, controllability = found.left[:, :order] * root, root[:, np.newaxis] * found.right[:order]
    for part in (observability, controllability):
        part.flags.writeable = False
    return Realisation(
        A=found.A[:order, :order],
        B=found.B[:order],
        C=found.C[:, :order],
        D=found.D,
        dt=found.dt,
        K=None if found.K is None else found.K[:order],
        singular_values=found.singular_values,
        factors=HankelFactors(
            observability=observability,
            controllability=controllability,
            n_block_rows=found.n_block_rows,
            n_block_columns=found.n_block_columns,
            input_scale=found.input_scale,
            output_scale=found.output_scale,
            observer_order=found.observer_order,
        ),
    )


def order_choice(decomposition: HankelDecomposition) -> GapChoice:
    """The order at the largest gap of the singular values, conjugate pairs kept whole, with its evidence.

    Markov parameters of an observer of order p are a sum of p n_outputs exponentials whatever the data were: their
    singular values end there, at the largest gap of all. It says nothing of the system, so a tenfold gap before it
    counts instead; where there is none (an observer of the least order, or much noise) the end stands.
    """
    found = decomposition
    return gap_choice(
        found.singular_values,
        rank=found.rank,
        energy=found.energy,
        A=found.A,
        end=0 if found.observer_order is None else found.observer_order * found.C.shape[0],
    )


def gap_choice(singular_values: FloatArray, *, rank: int, energy: float | None, A: FloatArray, end: int) -> GapChoice:
    """The rule of `order_choice` for any singular values.

    Args:
        singular_values: falling.
        rank: numerical rank.
        energy: sum of the squares of all singular values; None: of those given.
        A: balanced system matrix of the highest order.
        end: number of exponentials in Markov parameters that an observer gave; 0 for measured ones.
    """
    if 1 < end <= rank and end < singular_values.size:
        before = choose_order(singular_values, rank=rank, energy=energy, A=A, max_order=end - 1)
        if before.ratio >= GAP_BEFORE_THE_END:
            return before
    return choose_order(singular_values, rank=rank, energy=energy, A=A)


def realise(
    markov: MarkovParameters,
    *,
    order: int | Literal["auto"] = "auto",
    n_block_rows: int | None = None,
    n_block_columns: int | None = None,
    method: Method = "auto",
    realise_on: RealiseOn = "system",
    rng: np.random.Generator | None = None,
) -> Realisation:
    """Balanced state-space model of the Markov parameters.

    Args:
        markov: Markov parameters of the system, of the gain, or both.
        order: number of states; "auto" cuts at the largest gap of the singular values (`era.hankel`).
        n_block_rows: see `decompose`.
        n_block_columns: see `decompose`.
        method: see `decompose`.
        realise_on: see `decompose`.
        rng: see `decompose`.

    Raises:
        InsufficientDataError: too few lags for the order or the block sizes, or an order above the numerical rank.
        InvalidDataError: see `decompose`; or an order that is neither a number nor "auto".

    References:
        Juang, Pappa, Journal of Guidance, Control, and Dynamics 8(5), 1985, 620-627, doi 10.2514/3.20031.

    Example:
        >>> lag = np.arange(1.0, 40.0)
        >>> pulse = 0.9**lag * np.cos(0.5 * lag)
        >>> model = realise(MarkovParameters(system=np.r_[0.0, pulse].reshape(-1, 1, 1), dt=0.1))
        >>> model.order, np.abs(np.linalg.eigvals(model.A)).round(9)
        (2, array([0.9, 0.9]))
    """
    wanted = None
    if not (isinstance(order, str) and order == "auto"):
        wanted = whole_number(order, name="order", least=0, otherwise='or "auto"')
    found = decompose(
        markov,
        n_block_rows=n_block_rows,
        n_block_columns=n_block_columns,
        max_order=wanted,
        method=method,
        realise_on=realise_on,
        rng=rng,
    )
    return realise_from(found, order_choice(found).order if wanted is None else wanted)


def realise_data_correlation(
    markov: MarkovParameters,
    *,
    order: int | Literal["auto"] = "auto",
    n_block_rows: int = 1,
    n_block_columns: int | None = None,
    first_lag: int | None = None,
) -> Realisation:
    """State-space model from correlations of the Markov parameters (ERA/DC), an alternative to `era.realise`.

    It averages over `n_block_columns` lags before it decomposes, so a long pulse response needs but a small singular
    value decomposition. It is no better than ERA on the same lags in the noise measured (see modal/docs/order.md), and
    weak modes are lost earlier.

    Args:
        markov: Markov parameters; without inputs, those of the gain are realised (output only).
        order: number of states; "auto" cuts at the largest gap of the singular values (`era.hankel`).
        n_block_rows: a, block rows of a correlation; 1 takes the plain correlation functions of the outputs.
        n_block_columns: b, lags that a correlation is summed over; half of the lags by default.
        first_lag: l, first correlation lag that is used; n_block_rows by default, from which on white noise on the
            Markov parameters adds no bias.

    Returns:
        The model, with `factors` for the indicators. Its `singular_values` are those of U(0): squares, so to speak, of
        those that `era.realise` gives.

    Raises:
        InsufficientDataError: too few lags for the sizes, or an order above the numerical rank of U(0).
        InvalidDataError: an argument outside its range; no Markov parameters of a gain where there are no inputs.

    References:
        Juang, Cooper, Wright, Control Theory and Advanced Technology 4(1), 1988, 5-14.

    Example:
        >>> lag = np.arange(1.0, 40.0)
        >>> pulse = 0.9**lag * np.cos(0.5 * lag)
        >>> model = realise_data_correlation(MarkovParameters(system=np.r_[0.0, pulse].reshape(-1, 1, 1), dt=0.1))
        >>> model.order, np.abs(np.linalg.eigvals(model.A)).round(9)
        (2, array([0.9, 0.9]))
    """
    require(markov, MarkovParameters, where="a realisation", made_by="okid.recover_markov")
    wanted = None
    if not (isinstance(order, str) and order == "auto"):
        wanted = whole_number(order, name="order", least=0, otherwise='or "auto"')
    sizes = _sizes(markov.n_lags, n_block_rows, n_block_columns, first_lag)
    scaled = scaled_channels(markov, "system")
    correlations = _correlations(scaled, sizes)
    smaller = min(sizes.rows, sizes.columns) * sizes.a * markov.n_outputs
    at_most = None if wanted is None else min(wanted, smaller)
    found = hankel_triplets(correlations[0], sizes.rows, sizes.columns, max_order=at_most, method="auto")
    if wanted is not None and wanted > found.left.shape[1]:
        raise InsufficientDataError(
            f"model order {wanted} was asked for, but the matrix of correlations (smaller side {smaller}) has "
            f"numerical rank {found.rank}: it holds squares, so weak states vanish in its rounding; use an order of "
            f"at most {found.left.shape[1]}, or era.realise."
        )
    root = np.sqrt(found.singular_values[: found.left.shape[1]])
    later = BlockHankelOperator.of(correlations[1], sizes.rows, sizes.columns)
    A = (found.left.T @ later.times(found.right.T)) / (root[:, np.newaxis] * root)
    if wanted is None:
        end = 0 if markov.observer_order is None else markov.observer_order * markov.n_outputs
        values = np.sqrt(found.singular_values)  # of the size of ERA's, for which the rule was made
        wanted = gap_choice(values, rank=found.rank, energy=None, A=A, end=end).order
    # its controllability matrix would need h[l] and later: B belongs to the tall Hankel matrix that starts at h[1]
    left = found.left[:, :wanted]
    tall = BlockHankelOperator.of(scaled, sizes.n_tall, sizes.b)
    controllability = tall.transpose_times(left / root[:wanted]).T
    return _model(
        markov,
        sizes,
        singular_values=found.singular_values,
        A=A[:wanted, :wanted],
        observability=left * root[:wanted],
        controllability=controllability,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Sizes:
    """a and b, first lag l, and the block rows and columns of U."""

    a: int
    b: int
    first_lag: int
    rows: int
    columns: int

    @property
    def n_tall(self) -> int:
        """Block rows of the pulse responses that the rows of U span."""
        return self.a * self.rows


def _sizes(n_lags: int, a: int, b: int | None, first_lag: int | None) -> _Sizes:
    """U(1) reaches to h[l + (rows + columns - 1) a + b]: every lag is used but for a remainder below a."""
    a = whole_number(a, name="n_block_rows", least=1)
    first = a if first_lag is None else whole_number(first_lag, name="first_lag", least=0)
    columns = max(1, (n_lags - a - first + 1) // 2) if b is None else whole_number(b, name="n_block_columns", least=1)
    needed = first + a + columns
    if n_lags < needed:
        raise InsufficientDataError(
            f"ERA/DC with {a} block rows, {columns} block columns and first lag {first} needs Markov parameters up to "
            f"lag {needed}, but there are {n_lags} lags; use smaller sizes or recover more lags."
        )
    n_steps = (n_lags - needed) // a
    return _Sizes(a=a, b=columns, first_lag=first, rows=n_steps // 2 + 1, columns=n_steps - n_steps // 2 + 1)


def _correlations(scaled: FloatArray, sizes: _Sizes) -> tuple[FloatArray, FloatArray]:
    """R(l), R(l + a), ... and the same one lag later, each (n + 1, a n_outputs, a n_outputs) with an unused lag 0."""
    a, n_outputs = sizes.a, scaled.shape[1]
    n_correlations = sizes.rows + sizes.columns - 1
    reach = sizes.first_lag + 1 + (n_correlations - 1) * a
    tall = BlockHankelOperator.of(scaled, reach + a, sizes.b)
    products = tall.times(block_hankel(scaled, a, sizes.b).T)
    result = np.zeros((2, n_correlations + 1, a * n_outputs, a * n_outputs))
    for shift in (0, 1):
        start = (sizes.first_lag + shift) * n_outputs
        rows = products[start : start + n_correlations * a * n_outputs]
        result[shift, 1:] = rows.reshape(n_correlations, a * n_outputs, a * n_outputs)
    return result[0], result[1]


def _model(
    markov: MarkovParameters,
    sizes: _Sizes,
    *,
    singular_values: FloatArray,
    A: FloatArray,
    observability: FloatArray,
    controllability: FloatArray,
) -> Realisation:
    n_outputs, scale_out = markov.n_outputs, markov.output_scale
    K = None
    if markov.n_inputs == 0:
        K = controllability[:, :n_outputs] / scale_out
    elif markov.gain is not None:
        gain = (markov.gain[1 : 1 + sizes.n_tall] * (scale_out / scale_out[:, np.newaxis])).reshape(-1, n_outputs)
        size = singular_values[: A.shape[0], np.newaxis]  # the columns of the observability matrix have these squares
        K = observability.T @ gain / size / scale_out
    return Realisation(
        A=A,
        B=controllability[:, : markov.n_inputs] / markov.input_scale,
        C=scale_out[:, np.newaxis] * observability[:n_outputs],
        D=markov.system[0],
        dt=markov.dt,
        K=K,
        singular_values=singular_values,
        factors=HankelFactors(
            observability=observability,
            controllability=controllability,
            n_block_rows=sizes.n_tall,
            n_block_columns=sizes.b,
            input_scale=markov.input_scale,
            output_scale=scale_out,
            observer_order=markov.observer_order,
        ),
    )
