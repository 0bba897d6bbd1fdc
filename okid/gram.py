"""The Gram matrix of the observer regression, without building the regressors.

The matrix of the regressors [z(k) z(k-1) ... z(k-p)], z = [u; y], is block Hankel. Of its Gram matrix only the first
block row is summed over the data, `G[0, j] = sum_k z(k) z(k-j)'`, by `okid.correlation`; along the block diagonals

    G[i+1, j+1] = G[i, j] + sum over runs [a, b) of counted rows of  z(a-1-i) z(a-1-j)' - z(b-1-i) z(b-1-j)'

holds exactly. (The Toeplitz shortcut that drops these edge terms gives matrices that are not even positive definite.)
Grams of disjoint rows add, so a training set is the whole less what is held out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from okid.arrays import BoolArray, FloatArray
from okid.correlation import LagCorrelation
from okid.errors import InvalidDataError
from okid.record import Record
from okid.rows import complete_rows, runs_of, scaled_block, usable_rows
from okid.scaling import ChannelScaling

__all__ = ["LagGram", "lag_gram"]

_EDGE_VALUES = 1 << 20
"""Edge samples that are kept before they are folded into the matrix."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LagGram:
    """Sum over rows of phi(k) phi(k)', phi(k) = [1; u(k); y(k); u(k-1); y(k-1); ...; y(k-order)] of scaled channels.

    Attributes:
        matrix: (1 + (order + 1) n_channels, same) symmetric.
        n_rows: number of rows summed.
        order: largest lag.
        n_inputs: number of inputs.
        n_outputs: number of outputs.
    """

    matrix: FloatArray
    n_rows: int
    order: int
    n_inputs: int
    n_outputs: int

    def __add__(self, other: "LagGram") -> "LagGram":
        """The Gram of the rows of both."""
        _check_alike(self, other)
        return replace(self, matrix=_closed(self.matrix + other.matrix), n_rows=self.n_rows + other.n_rows)

    def __sub__(self, other: "LagGram") -> "LagGram":
        """The Gram of the rows of `self` that are not in `other`."""
        _check_alike(self, other)
        return replace(self, matrix=_closed(self.matrix - other.matrix), n_rows=self.n_rows - other.n_rows)

    def truncated(self, order: int) -> "LagGram":
        """The Gram of the same rows with fewer lags: the leading part.

        Raises:
            InvalidDataError: an order above the own one.
        """
        if not 0 <= order <= self.order:
            raise InvalidDataError(f"a Gram matrix of order {self.order} holds orders 0 to {self.order}, not {order}.")
        size = 1 + (order + 1) * (self.n_inputs + self.n_outputs)
        return replace(self, matrix=self.matrix[:size, :size], order=order)


def lag_gram(
    records: Sequence[Record], order: int, *, scaling: ChannelScaling, rows: Sequence[BoolArray] | None = None
) -> LagGram:
    """Gram matrix of all regressors up to lag `order`.

    Args:
        records: of one system; read in chunks.
        order: largest lag.
        scaling: mean and size of every channel.
        rows: one mask a record of the rows that may count, None for all; a row also needs `order` samples before it in
            its record and no missing channel from there to itself.

    Raises:
        InvalidDataError: masks that do not fit the records.

    References:
        The displacement structure is that of the covariance method of linear prediction: Morf, Dickinson, Kailath,
        Vieira, IEEE Transactions on Acoustics, Speech, and Signal Processing 25(5), 1977, doi
        10.1109/TASSP.1977.1162991.

    Example:
        >>> from okid.scaling import channel_scaling
        >>> record = Record(np.sin(np.arange(50.0)), np.cos(np.arange(50.0)), 0.1)
        >>> gram = lag_gram([record], 3, scaling=channel_scaling([record]))
        >>> gram.matrix.shape, gram.n_rows
        ((9, 9), 47)
    """
    _check_masks(records, rows)
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    n_channels = n_inputs + n_outputs
    longest = max(record.n_samples for record in records)
    correlation = LagCorrelation(max(1, longest - order), n_channels, order)
    edges = _Edges(order, n_channels)
    for number, record in enumerate(records):
        _add_record(correlation, edges, record, scaling, None if rows is None else rows[number])
    lags = correlation.lags()
    # Its work space goes before the matrix comes: with many channels each is the larger part of the memory in use.
    del correlation
    return LagGram(
        matrix=_closed(edges.matrix(lags)), n_rows=edges.n_rows, order=order, n_inputs=n_inputs, n_outputs=n_outputs
    )


class _Edges:
    """What chunks add to besides lag correlations: counts, column sums, and the samples at the edges of runs."""

    def __init__(self, order: int, n_channels: int) -> None:
        self.order, self.n_channels = order, n_channels
        self.n_rows = 0
        self.total = np.zeros(n_channels)
        self.folded: FloatArray | None = None
        self.heads: list[FloatArray] = []
        self.tails: list[FloatArray] = []

    def add_run(self, block: FloatArray, start: int, stop: int) -> None:
        """Note the `order` samples before rows `start` and `stop`; a block's rows begin at its row `order`."""
        self.heads.append(block[start : start + self.order][::-1].reshape(1, -1).copy())
        self.tails.append(block[stop : stop + self.order][::-1].reshape(1, -1).copy())
        if len(self.heads) * self.order * self.n_channels > _EDGE_VALUES:
            self.fold()

    def fold(self) -> None:
        """Turn the edges noted so far into their part of the matrix."""
        part = _assembled(*self._stacked(), np.zeros((self.n_channels, (self.order + 1) * self.n_channels)))
        self.folded = part if self.folded is None else self.folded + part
        self.heads, self.tails = [], []

    def matrix(self, lags: FloatArray) -> FloatArray:
        """The Gram matrix of everything added, from its lag correlations."""
        lags[0] = 0.5 * (lags[0] + lags[0].T)
        gram = _assembled(*self._stacked(), lags.transpose(1, 0, 2).reshape(self.n_channels, -1))
        gram[0, 0] = self.n_rows
        gram[0, 1:] += np.tile(self.total, self.order + 1)
        if self.folded is not None:
            gram += self.folded
        gram[1:, 0] = gram[0, 1:]
        return gram

    def _stacked(self) -> tuple[FloatArray, FloatArray]:
        if not self.heads:
            return np.empty((0, self.order * self.n_channels)), np.empty((0, self.order * self.n_channels))
        return np.concatenate(self.heads), np.concatenate(self.tails)


def _add_record(
    correlation: LagCorrelation, edges: _Edges, record: Record, scaling: ChannelScaling, mask: BoolArray | None
) -> None:
    order, step = edges.order, correlation.n_chunk_rows
    for start in range(order, record.n_samples, step):
        stop = min(start + step, record.n_samples)
        n_rows = stop - start
        counted = None if mask is None else mask[start:stop]
        if counted is not None and not counted.any():
            continue
        block = correlation.chunk(n_rows)
        if not scaled_block(record, start - order, stop, scaling, out=block):
            usable = usable_rows(complete_rows(block), order)[order:]
            counted = usable if counted is None else usable & counted
            block[np.isnan(block)] = 0.0
        if counted is None or counted.all():
            edges.add_run(block, 0, n_rows)
            edges.n_rows += n_rows
            edges.total += np.ones(n_rows) @ block[order:]
            correlation.add(n_rows, None)
        elif counted.any():
            for run in runs_of(counted):
                edges.add_run(block, *run)
            edges.n_rows += int(counted.sum())
            edges.total += counted.astype(np.float64) @ block[order:]
            correlation.add(n_rows, counted)


def _assembled(heads: FloatArray, tails: FloatArray, first: FloatArray) -> FloatArray:
    """The matrix that continues the first block row along block diagonals by the head and tail terms of all runs.

    Its row and column of the constant hold the head and tail sums only.
    """
    c = first.shape[0]
    size = 1 + first.shape[1]
    gram = np.empty((size, size))
    gram[0, : 1 + c] = 0.0
    np.cumsum((heads.sum(axis=0) - tails.sum(axis=0)).reshape(-1, c), axis=0, out=gram[0, 1 + c :].reshape(-1, c))
    left, right = np.concatenate([heads, tails]).T.copy(), np.concatenate([heads, -tails])
    running = first.copy()
    gram[1 : 1 + c, 1:] = running
    gram[1 + c :, 1 : 1 + c] = running[:, c:].T
    for low in range(0, size - 1 - c, c):
        running = running[:, :-c] + left[low : low + c] @ right[:, low:]
        start = 1 + c + low
        gram[start : start + c, start:] = running
        gram[start + c :, start : start + c] = running[:, c:].T
    gram[1:, 0] = gram[0, 1:]
    return gram


def _closed(matrix: FloatArray) -> FloatArray:
    matrix.flags.writeable = False
    return matrix


def _check_masks(records: Sequence[Record], rows: Sequence[BoolArray] | None) -> None:
    if rows is None:
        return
    lengths, have = [record.n_samples for record in records], [mask.shape for mask in rows]
    if have != [(length,) for length in lengths]:
        raise InvalidDataError(f"row masks must be one a record of lengths {lengths}, but have shapes {have}.")


def _check_alike(one: LagGram, other: LagGram) -> None:
    shapes = [(gram.order, gram.n_inputs, gram.n_outputs) for gram in (one, other)]
    if shapes[0] != shapes[1]:
        raise InvalidDataError(
            f"Gram matrices must agree in order, inputs and outputs, but have {shapes[0]} and {shapes[1]}; truncate "
            "the larger one."
        )
