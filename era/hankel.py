"""The block Hankel matrix of Markov parameters, its leading singular triplets, and how many states they show.

    H(shift) block (i, j) = h[1 + shift + i + j],   i < n_block_rows,   j < n_block_columns

It starts at h[1]: the feedthrough h[0] = D is no power of A and would add false states. A product with H is a
correlation along the lags, so for large matrices it is done by fast Fourier transforms of the (n_lags, n_outputs,
n_inputs) array: H itself, n_block_rows * n_block_columns times larger than what defines it, is never built.

A random sketch H' W finds the row space; where it misses part of it (noisy data: H has full rank) power steps H' H
turn it towards the leading vectors. Where the last column of the sketch adds nothing to the others the row space is
complete, so noise-free data (H of low rank) are decomposed to rounding with no power step at all.

The share of the sum of the singular values that an order keeps depends on the size of the matrix (noise adds singular
values, not size), the share of their squares hardly so, the gap not at all. All three are kept, the gap decides; on
measured data it stands beside a stabilisation diagram and the free run of the models, which `modal` adds.

References:
    Halko, Martinsson, Tropp, SIAM Review 53(2), 2011, 217-288, doi 10.1137/090771806.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy

from okid.arrays import FloatArray, whole_number
from okid.errors import InsufficientDataError, NumericalError


def block_hankel(markov: FloatArray, n_block_rows: int, n_block_columns: int) -> FloatArray:
    """H(0) as an array.

    Args:
        markov: (n_lags + 1, n_outputs, n_inputs), lag 0 first; lag 0 is not used.
        n_block_rows: number of block rows.
        n_block_columns: number of block columns.

    Returns:
        (n_block_rows * n_outputs, n_block_columns * n_inputs).

    Raises:
        InsufficientDataError: fewer lags than n_block_rows + n_block_columns - 1.

    Example:
        >>> block_hankel(np.arange(6.0).reshape(6, 1, 1), 2, 3)
        array([[1., 2., 3.], [2., 3., 4.]])
    """
    n_needed = n_block_rows + n_block_columns - 1
    _check_lags(markov.shape[0] - 1, n_block_rows, n_block_columns, n_needed)
    _, n_outputs, n_inputs = markov.shape
    if n_inputs == 0:
        return np.empty((n_block_rows * n_outputs, 0))
    lags = markov[1 : 1 + n_needed].transpose(1, 0, 2).reshape(n_outputs, -1)
    windows = np.lib.stride_tricks.sliding_window_view(lags, n_block_columns * n_inputs, axis=1)[:, ::n_inputs]
    return windows.transpose(1, 0, 2).reshape(n_block_rows * n_outputs, n_block_columns * n_inputs)


def hankel_energy(markov: FloatArray, n_block_rows: int, n_block_columns: int) -> float:
    """Sum of the squares of all elements of H(0), that is of all its singular values, without building it.

    Example:
        >>> hankel_energy(np.ones((4, 1, 1)), 2, 2)
        4.0
    """
    n_needed = n_block_rows + n_block_columns - 1
    lag = np.arange(1, n_needed + 1)
    times_in_matrix = np.minimum(np.minimum(lag, n_needed + 1 - lag), min(n_block_rows, n_block_columns))
    return float(times_in_matrix @ np.square(markov[1 : n_needed + 1]).sum(axis=(1, 2)))


def block_sizes(
    n_lags: int, n_outputs: int, n_inputs: int, *, n_block_rows: int | None = None, n_block_columns: int | None = None
) -> tuple[int, int]:
    """Block rows and columns that use every lag, H(0) and H(1) together: rows + columns = n_lags.

    The shares follow the channels (n_outputs * rows = n_inputs * columns makes H square) but stay between a third and
    two
    thirds: that is where the variance of the poles is flat and smallest, and a short side costs dearly.

    Args:
        n_lags: lags beyond the feedthrough.
        n_outputs: outputs of the Markov parameters.
        n_inputs: inputs of the Markov parameters, at least 1.
        n_block_rows: taken as it is when given.
        n_block_columns: taken as it is when given.

    Raises:
        InsufficientDataError: fewer than two lags, or fewer than the two sizes need.
        InvalidDataError: a size below 1.

    References:
        Hua, Sarkar, IEEE Trans. Acoust. Speech Signal Process. 38(5), 1990, 814-824, doi 10.1109/29.56027.

    Example:
        >>> block_sizes(300, 16, 2), block_sizes(300, 2, 2)
        ((100, 200), (150, 150))
    """
    if n_lags < 2:
        raise InsufficientDataError(
            f"a realisation needs Markov parameters of at least 2 lags beyond lag 0, but there is {n_lags}; recover "
            "more."
        )
    if n_block_rows is not None:
        n_block_rows = whole_number(n_block_rows, name="n_block_rows", least=1)
    if n_block_columns is not None:
        n_block_columns = whole_number(n_block_columns, name="n_block_columns", least=1)
    if n_block_rows is None and n_block_columns is None:
        share = min(max(n_inputs / (n_outputs + n_inputs), 1 / 3), 2 / 3)
        n_block_rows = min(max(round(share * n_lags), 1), n_lags - 1)
    if n_block_rows is None:
        n_block_rows = max(1, n_lags - (n_block_columns or 0))
    if n_block_columns is None:
        n_block_columns = max(1, n_lags - n_block_rows)
    _check_lags(n_lags, n_block_rows, n_block_columns, n_block_rows + n_block_columns)
    return n_block_rows, n_block_columns


@dataclass(frozen=True, slots=True, eq=False)
class BlockHankelOperator:
    """Products with H(0) and its transpose, by FFT when that is cheaper than the matrix itself.

    Args:
        lags: (n_block_rows + n_block_columns - 1, n_outputs, n_inputs), from lag 1 on, float64 or float32.
        n_block_rows: number of block rows.
        n_block_columns: number of block columns.
        matrix: H(0) where it is small enough to be built.
        spectrum: (n_frequencies, n_outputs, n_inputs) transform of the lags where it is not.
        n_transform: length of the transforms.

    Example:
        >>> h = np.arange(6.0).reshape(6, 1, 1)
        >>> operator = BlockHankelOperator.of(h, 2, 3, products="fft")
        >>> operator.times(np.ones((3, 1))).round(12).ravel()
        array([6., 9.])
    """

    n_block_rows: int
    n_block_columns: int
    n_outputs: int
    n_inputs: int
    matrix: FloatArray | None
    spectrum: np.ndarray | None
    n_transform: int

    @classmethod
    def of(
        cls,
        markov: FloatArray,
        n_block_rows: int,
        n_block_columns: int,
        *,
        products: Literal["auto", "dense", "fft"] = "auto",
    ) -> "BlockHankelOperator":
        """Operator of the (n_lags + 1, n_outputs, n_inputs) Markov parameters; lag 0 is not used."""
        n_needed = n_block_rows + n_block_columns - 1
        _check_lags(markov.shape[0] - 1, n_block_rows, n_block_columns, n_needed)
        _, n_outputs, n_inputs = markov.shape
        sizes = (n_block_rows, n_block_columns, n_outputs, n_inputs)
        if products == "dense" or (products == "auto" and _dense_is_cheaper(*sizes)):
            return cls(*sizes, block_hankel(markov, n_block_rows, n_block_columns), None, 0)
        n_transform = _smooth_length(n_needed)
        spectrum = np.fft.rfft(markov[1 : n_needed + 1], n_transform, axis=0)
        return cls(*sizes, None, spectrum, n_transform)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of H(0)."""
        return self.n_block_rows * self.n_outputs, self.n_block_columns * self.n_inputs

    def times(self, columns: FloatArray) -> FloatArray:
        """H(0) @ columns; (n_block_columns * n_inputs, n) to (n_block_rows * n_outputs, n)."""
        if self.spectrum is None:
            return self.matrix @ columns  # type: ignore[operator]  # one of the two is always there
        return self._correlate(self.spectrum, columns, self.n_block_columns, self.n_inputs, self.n_block_rows)

    def transpose_times(self, columns: FloatArray) -> FloatArray:
        """H(0)' @ columns; (n_block_rows * n_outputs, n) to (n_block_columns * n_inputs, n)."""
        if self.spectrum is None:
            return self.matrix.T @ columns  # type: ignore[union-attr]  # one of the two is always there
        turned = self.spectrum.transpose(0, 2, 1)
        return self._correlate(turned, columns, self.n_block_rows, self.n_outputs, self.n_block_columns)

    def _correlate(self, spectrum: np.ndarray, columns: FloatArray, n_from: int, width: int, n_to: int) -> FloatArray:
        blocks = np.fft.rfft(columns.reshape(n_from, -1), self.n_transform, axis=0)
        blocks = blocks.reshape(blocks.shape[0], width, -1)
        product = np.matmul(spectrum, np.conj(blocks, out=blocks))
        result: FloatArray = np.fft.irfft(product.reshape(product.shape[0], -1), self.n_transform, axis=0)[:n_to]
        return result.reshape(n_to * spectrum.shape[1], columns.shape[1])


def _check_lags(n_lags: int, n_block_rows: int, n_block_columns: int, n_needed: int) -> None:
    if n_lags < n_needed:
        raise InsufficientDataError(
            f"{n_block_rows} block rows and {n_block_columns} block columns need Markov parameters up to lag "
            f"{n_needed}, but there are {n_lags} lags; use fewer block rows or columns, or recover more lags."
        )


def _dense_is_cheaper(n_block_rows: int, n_block_columns: int, n_outputs: int, n_inputs: int) -> bool:
    """Compare measured costs a column: 30 GFlop/s dense; 0.35 ns a butterfly, 2 ns a complex product by FFT."""
    n_values = n_block_rows * n_outputs * n_block_columns * n_inputs
    length = n_block_rows + n_block_columns
    transforms = 0.35 * (n_outputs + n_inputs) * length * np.log2(length)
    products = 2.0 * n_outputs * n_inputs * length / 2
    return n_values <= 1 << 22 and 2 * n_values / 30 <= 1.5 * (transforms + products)  # 32 MiB


@lru_cache(maxsize=64)
def _smooth_length(least: int) -> int:
    """Smallest product of powers of 2, 3 and 5 that is not below `least`: the lengths that the FFT likes."""
    best = 1 << (least - 1).bit_length()
    five = 1
    while five < best:
        three = five
        while three < best:
            two = three << max(0, (-(-least // three) - 1).bit_length())
            best = min(best, two)
            three *= 3
        five *= 5
    return best


CLEAR_GAP = 3.0
"""Ratio of neighbouring singular values above which a gap cannot lie inside a conjugate pair."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GapChoice:
    """An order and what speaks for it.

    Attributes:
        order: number of states.
        ratio: of the last singular value kept to the first one left out; inf where none is left above rounding.
        sum_share: share of the sum of the computed singular values that is kept.
        energy_share: share of the sum of the squares of all singular values that is kept.
        rank: numerical rank, as far as it was computed.
        reason: one sentence.
    """

    order: int
    ratio: float
    sum_share: float
    energy_share: float
    rank: int
    reason: str


def choose_order(
    singular_values: FloatArray,
    *,
    rank: int | None = None,
    energy: float | None = None,
    A: FloatArray | None = None,
    max_order: int | None = None,
) -> GapChoice:
    """The order before the largest ratio s[i] / s[i + 1]; noise-free data: the numerical rank.

    Where the gap is weak (a ratio below 3) and would cut a conjugate pair in two, so that the model of one order more
    has a real pole less, the pair is kept whole.

    Args:
        singular_values: falling.
        rank: numerical rank; by default singular values above rounding error of the largest.
        energy: sum of the squares of all singular values; by default of those given.
        A: (at least order + 1, same) balanced system matrix for the test of whole pairs, left out without it.
        max_order: highest order that may be chosen.

    Example:
        >>> choice = choose_order(np.array([8.0, 7.0, 0.2, 0.19, 0.18]))
        >>> choice.order, round(choice.ratio, 9), round(choice.energy_share, 4)
        (2, 35.0, 0.999)
    """
    values = np.asarray(singular_values, dtype=np.float64)
    if rank is None:
        floor = values[0] * values.size * np.finfo(float).eps if values.size else 0.0
        rank = int((values > floor).sum())
    if rank == 0:
        return _choice(values, 0, 0, energy, "all Markov parameters beyond the feedthrough are zero")
    highest = rank if max_order is None else min(rank, max_order)
    ratios = np.array([_ratio(values, i) for i in range(1, highest + 1)])
    if rank < values.size or highest < rank:
        order = int(np.argmax(ratios)) + 1
    else:
        # Noise fills the matrix, and the smallest few values of a square one are far apart by chance.
        order = int(np.argmax(ratios[: max(1, 3 * highest // 4)])) + 1
    why = "largest gap of the singular values"
    if order == rank < values.size:
        why = "numerical rank: what follows is rounding error"
    elif A is not None and _splits_a_pair(A, order) and ratios[order - 1] < CLEAR_GAP and order < highest:
        order += 1
        why = "largest gap of the singular values, one order more so that a conjugate pair is kept whole"
    return _choice(values, order, rank, energy, why)


def _choice(values: FloatArray, order: int, rank: int, energy: float | None, why: str) -> GapChoice:
    squares = float(np.square(values).sum()) if energy is None else energy
    total = float(values.sum())
    sum_share = float(values[:order].sum()) / total if total > 0 else 1.0
    energy_share = min(1.0, float(np.square(values[:order]).sum()) / squares) if squares > 0 else 1.0
    ratio = _ratio(values, order) if order else np.inf
    reason = (
        f"order {order}: {why} (s{order}/s{order + 1} = {ratio:.3g}; {100 * sum_share:.1f} % of their sum, "
        f"{100 * energy_share:.2f} % of their energy)."
    )
    return GapChoice(order=order, ratio=ratio, sum_share=sum_share, energy_share=energy_share, rank=rank, reason=reason)


def _ratio(values: FloatArray, order: int) -> float:
    """Of the last value kept to the first left out; a value that is zero counts as infinitely smaller."""
    if order >= values.size or values[order] <= 0.0:
        return float(np.inf)
    return float(values[order - 1] / values[order])


def _splits_a_pair(A: FloatArray, order: int) -> bool:
    if order + 1 > A.shape[0]:
        return False
    here, next_higher = (int((np.linalg.eigvals(A[:n, :n]).imag == 0).sum()) for n in (order, order + 1))
    return next_higher < here


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


def leading_triplets(operator: BlockHankelOperator, n_wanted: int, *, rng: np.random.Generator) -> LeadingTriplets:
    """The `n_wanted` leading singular triplets of H, from a random sketch of six columns more.

    Example:
        >>> h = 0.9 ** np.arange(40.0).reshape(40, 1, 1)
        >>> found = leading_triplets(BlockHankelOperator.of(h, 20, 20), 3, rng=np.random.default_rng(0))
        >>> found.complete, round(float(found.singular_values[0]), 6)
        (True, 4.666827)
    """
    n_rows, n_columns = operator.shape
    n_basis = min(n_wanted + 6, n_rows, n_columns)
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
        rows, left, values, turn, error = _power_steps(operator, rows, n_wanted)
    kept = slice(0, min(n_wanted, n_basis))
    return LeadingTriplets(
        left=np.ascontiguousarray(left[:, kept]),
        singular_values=values[kept],
        right=turn[kept] @ rows.T,
        subspace_error=error[kept],
        complete=complete,
    )


def _power_steps(
    operator: BlockHankelOperator, rows: FloatArray, n_wanted: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Row basis, the decomposition of H times it, and the sines by which the left vectors turned in the last step."""
    before, step = _orthonormal(operator.times(rows)), 1
    while True:
        rows = _orthonormal(operator.transpose_times(before))
        left, values, turn = _tall_svd(operator.times(rows))
        outside = left - before @ (before.T @ left)
        sines = np.minimum(1.0, np.sqrt(np.square(outside).sum(axis=0)))
        if step == 2 or sines[:n_wanted].max(initial=0.0) <= SETTLED:
            return rows, left, values, turn, sines
        before, step = left, 2


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


Method = Literal["auto", "full", "randomised"]

FULL_UP_TO = 1.5e6
"""Rows x columns x smaller side of a block Hankel matrix that is always decomposed in full (1-2 ms)."""
FIRST_RANK = 32
"""Triplets that are looked for first when nobody said how many are needed."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HankelTriplets:
    """H = U S V', its leading part.

    Attributes:
        left: (n_rows, n_kept) U.
        singular_values: all that were computed, falling; at least n_kept.
        right: (n_kept, n_columns) V'.
        subspace_error: (n_kept,) see `LeadingTriplets`; zeros for the full decomposition.
        rank: numerical rank as far as it was computed: singular values above rounding error.
        method: how they were computed.
    """

    left: FloatArray
    singular_values: FloatArray
    right: FloatArray
    subspace_error: FloatArray
    rank: int
    method: Literal["full", "randomised"]


def hankel_triplets(
    lags: FloatArray,
    n_block_rows: int,
    n_block_columns: int,
    *,
    max_order: int | None,
    method: Method,
    rng: np.random.Generator | None = None,
) -> HankelTriplets:
    """Decompose the block Hankel matrix of `lags`, whose block (i, j) is lags[1 + i + j].

    Args:
        lags: (n_lags + 1, n_rows, n_columns), lag 0 first; lag 0 is not used.
        n_block_rows: number of block rows.
        n_block_columns: number of block columns.
        max_order: triplets wanted; None: as many as the matrix (in full) or the search for the noise floor gives.
        method: see `era.balanced.decompose`.
        rng: for the randomised method; a fixed seed unless given.

    Example:
        >>> found = hankel_triplets(0.5 ** np.arange(9.0).reshape(9, 1, 1), 4, 4, max_order=None, method="auto")
        >>> found.rank, found.method
        (1, 'full')
    """
    n_rows, n_columns = n_block_rows * lags.shape[1], n_block_columns * lags.shape[2]
    if method == "auto":
        method = _cheaper_method(n_rows, n_columns, max_order)
    if method == "full":
        left, values, right = np.linalg.svd(block_hankel(lags, n_block_rows, n_block_columns), full_matrices=False)
        error = np.zeros(values.size)
    else:
        operator = BlockHankelOperator.of(lags, n_block_rows, n_block_columns)
        generator = np.random.default_rng(0) if rng is None else rng
        left, values, right, error = _randomised(operator, max_order, generator)
    rank = _rank(values, n_rows, n_columns)
    kept = rank if max_order is None else min(rank, max_order)
    return HankelTriplets(
        left=left[:, :kept],
        singular_values=values,
        right=right[:kept],
        subspace_error=error[:kept],
        rank=rank,
        method=method,
    )


def _cheaper_method(n_rows: int, n_columns: int, max_order: int | None) -> Literal["full", "randomised"]:
    smaller = min(n_rows, n_columns)
    wanted = FIRST_RANK if max_order is None else max_order
    small = float(n_rows) * n_columns * smaller <= FULL_UP_TO
    return "full" if small or 4 * wanted >= smaller else "randomised"


def _randomised(
    operator: BlockHankelOperator, max_order: int | None, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    smaller = min(operator.shape)
    wanted = min(FIRST_RANK if max_order is None else max_order, smaller)
    found = leading_triplets(operator, wanted, rng=rng)
    while max_order is None and not (found.complete or _shows_a_gap(found.singular_values)):
        if 2 * wanted > min(256, smaller // 4):  # triplets at most when nobody said how many
            break
        wanted *= 2
        found = leading_triplets(operator, wanted, rng=rng)
    return found.left, found.singular_values, found.right, found.subspace_error


def _shows_a_gap(values: FloatArray) -> bool:
    """Whether the largest ratio of neighbours is clear and stands well before the end of what was computed."""
    ratios = values[:-1] / np.maximum(values[1:], np.finfo(float).tiny)
    largest = int(np.argmax(ratios))
    return bool(ratios[largest] >= CLEAR_GAP and largest < 3 * values.size // 4)


def _rank(values: FloatArray, n_rows: int, n_columns: int) -> int:
    if values.size == 0 or values[0] == 0.0:
        return 0
    return int((values > values[0] * max(n_rows, n_columns) * np.finfo(float).eps).sum())
