"""The block Hankel matrix of Markov parameters, as an array and as an operator.

    H(shift) block (i, j) = h[1 + shift + i + j],   i < n_block_rows,   j < n_block_columns

It starts at h[1]: the feedthrough h[0] = D is no power of A and would add false states. A product with H is a
correlation along the lags, so for large matrices it is done by fast Fourier transforms of the (n_lags, n_outputs,
n_inputs) array: H itself, n_block_rows * n_block_columns times larger than what defines it, is never built.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from okid.arrays import FloatArray, whole_number
from okid.errors import InsufficientDataError

__all__ = ["BlockHankelOperator", "block_hankel", "block_sizes", "hankel_energy"]

LARGEST_DENSE = 1 << 22
"""Values of a block Hankel matrix that is still built (32 MiB)."""


def block_hankel(markov: FloatArray, n_block_rows: int, n_block_columns: int, shift: int = 0) -> FloatArray:
    """H(shift) as an array.

    Args:
        markov: (n_lags + 1, n_outputs, n_inputs), lag 0 first; lag 0 is not used.
        n_block_rows: number of block rows.
        n_block_columns: number of block columns.
        shift: lags to start later than h[1].

    Returns:
        (n_block_rows * n_outputs, n_block_columns * n_inputs).

    Raises:
        InsufficientDataError: fewer lags than n_block_rows + n_block_columns + shift - 1.

    Example:
        >>> block_hankel(np.arange(6.0).reshape(6, 1, 1), 2, 3)
        array([[1., 2., 3.], [2., 3., 4.]])
    """
    n_needed = n_block_rows + n_block_columns + shift - 1
    _check_lags(markov.shape[0] - 1, n_block_rows, n_block_columns, n_needed)
    _, n_outputs, n_inputs = markov.shape
    if n_inputs == 0:
        return np.empty((n_block_rows * n_outputs, 0))
    lags = markov[1 + shift : 1 + n_needed].transpose(1, 0, 2).reshape(n_outputs, -1)
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
    return n_values <= LARGEST_DENSE and 2 * n_values / 30 <= 1.5 * (transforms + products)


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
