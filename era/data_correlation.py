"""ERA/DC, the eigensystem realisation algorithm with data correlations: ERA on correlations of the pulse responses.

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
from typing import Literal

import numpy as np

from era.balanced import gap_choice, scaled_channels
from era.hankel import BlockHankelOperator, block_hankel, hankel_triplets
from era.realisation import HankelFactors, Realisation
from okid.arrays import FloatArray, require, whole_number
from okid.errors import InsufficientDataError
from okid.markov import MarkovParameters


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
