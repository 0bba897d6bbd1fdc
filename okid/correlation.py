"""Lag correlations of many channels at once, by overlapped FFT blocks.

    R(j) = sum_{k counted} z(k) z(k-j)',   j = 0 ... order

costs about 8 N c^2 operations for c channels instead of 2 N c^2 (order + 1). Blocks add up, so memory is bounded and a
mapped file is read once.
"""

import numpy as np

from okid.arrays import BoolArray, FloatArray

__all__ = ["LagCorrelation"]

_BLOCK_VALUES = 1 << 17
"""Values in one step: small enough that all that is made of them stays in cache."""

_KEPT_VALUES = 3 << 20
"""Values of the work space at least: 24 MiB, below the 32 MiB from which glibc never keeps memory."""


class LagCorrelation:
    """A running sum of lag correlations, and the work space that is used again for every chunk.

    Fresh arrays for every chunk cost up to eight times the arithmetic, for the pages that the system has to supply.
    """

    def __init__(self, n_rows: int, n_channels: int, order: int) -> None:
        """Make room for chunks of records of at most `n_rows` rows."""
        # A fifth to a third of each block is past; within 10 % of the best length for 4 to 68 channels.
        length = max(128, 1 << (4 * order + 3).bit_length())
        n_frequencies = length // 2 + 1
        self.order, self.advance = order, length - order
        # Each chunk reads and writes the sums once: a chunk has at least as many values as they have.
        wanted = max(_BLOCK_VALUES, n_frequencies * n_channels**2) // (n_channels * self.advance)
        self.n_blocks = max(1, min(wanted, -(-n_rows // self.advance)))
        self._length = length
        transformed = (self.n_blocks, n_frequencies, 2 * n_channels)
        summed = (n_frequencies, n_channels, 2 * n_channels)
        self._block, self._rows, *parts = _carve(
            (order + self.n_blocks * self.advance, n_channels),
            (self.n_blocks, length, n_channels),
            transformed,
            transformed,
            summed,
            summed,
        )
        self._counted, self._past, self._product, self._sum = (part.view(np.complex128) for part in parts)
        self._rows[:, :order] = 0.0
        self._sum[:] = 0.0

    @property
    def n_chunk_rows(self) -> int:
        """Most rows of one chunk."""
        return self.n_blocks * self.advance

    def chunk(self, n_rows: int) -> FloatArray:
        """The array, `order` rows of the past and then `n_rows` rows, to be filled before `add`."""
        return self._block[: self.order + n_rows]

    def add(self, n_rows: int, counted: BoolArray | None) -> None:
        """Add the correlations of the chunk's counted rows (None: all) with the rows before them."""
        n_blocks, n_channels = -(-n_rows // self.advance), self._block.shape[1]
        stop = self.order + n_blocks * self.advance
        self._block[self.order + n_rows : stop] = 0.0
        blocks = self._block[self.order : stop].reshape(n_blocks, self.advance, n_channels)
        row_stride, column_stride = self._block.strides
        windows = np.lib.stride_tricks.as_strided(
            self._block,
            (n_blocks, self._length, n_channels),
            (self.advance * row_stride, row_stride, column_stride),
            writeable=False,
        )
        # The counted rows stand where they stand in their window, after `order` zeros: no lag up to `order` wraps.
        rows = self._rows[:n_blocks]
        if counted is None:
            rows[:, self.order :] = blocks
        else:
            chosen = np.zeros((n_blocks, self.advance), dtype=np.bool_)
            chosen.ravel()[:n_rows] = counted
            some = np.flatnonzero(chosen.any(axis=1))
            rows, windows, n_blocks = rows[: some.size], windows[some], some.size
            np.multiply(blocks[some], chosen[some][:, :, np.newaxis], out=rows[:, self.order :])
        ours, past = self._counted[:n_blocks], self._past[:n_blocks]
        np.fft.rfft(rows, axis=1, out=ours)
        np.conjugate(ours, out=ours)
        np.fft.rfft(windows, axis=1, out=past)
        # Per frequency (n_channels, n_blocks) @ (n_blocks, n_channels): views that BLAS takes as they are.
        np.matmul(ours.transpose(1, 2, 0), past.transpose(1, 0, 2), out=self._product)
        self._sum += self._product

    def lags(self) -> FloatArray:
        """(order + 1, n_channels, n_channels) R(0) ... R(order) of all that was added."""
        # Position -j (from the end) of the inverse transform pairs row i with row i - j.
        correlation = np.fft.irfft(self._sum, n=self._length, axis=0)
        lags: FloatArray = correlation[-np.arange(self.order + 1)]
        return lags


def _carve(*shapes: tuple[int, ...]) -> list[FloatArray]:
    """Uninitialised arrays cut from one piece of memory, which the allocator then keeps for the next call.

    Asked for a large piece once, glibc serves later requests up to that size from memory that it holds; asked for
    several of a megabyte or two, it returns them to the system each time and pays for every page anew: two to six times
    the whole calculation. Pages that are never touched cost nothing.
    """
    sizes = [int(np.prod(shape)) + 7 & ~7 for shape in shapes]
    store = np.empty(max(sum(sizes), _KEPT_VALUES))
    edges = np.cumsum([0, *sizes]).tolist()
    return [
        store[edge : edge + int(np.prod(shape))].reshape(shape) for edge, shape in zip(edges[:-1], shapes, strict=True)
    ]
