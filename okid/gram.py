"""The Gram matrix of the observer regression, without building the regressors.

The matrix of the regressors [z(k) z(k-1) ... z(k-p)], z = [u; y], is block Hankel. Of its Gram matrix only the first
block row is summed over the data, `G[0, j] = sum_k z(k) z(k-j)'`, by `okid.gram`; along the block diagonals

    G[i+1, j+1] = G[i, j] + sum over runs [a, b) of counted rows of  z(a-1-i) z(a-1-j)' - z(b-1-i) z(b-1-j)'

holds exactly. (The Toeplitz shortcut that drops these edge terms gives matrices that are not even positive definite.)
Grams of disjoint rows add, so a training set is the whole less what is held out.

Lag correlations of many channels at once, by overlapped FFT blocks.

    R(j) = sum_{k counted} z(k) z(k-j)',   j = 0 ... order

costs about 8 N c^2 operations for c channels instead of 2 N c^2 (order + 1). Blocks add up, so memory is bounded and a
mapped file is read once. So do chunks, by the processes of any executor (`chunked_gram`): each counts once, in the
order of the rows, whoever is done first.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from okid.arrays import BoolArray, FloatArray
from okid.errors import ExecutorError, IdentificationError, InvalidDataError
from okid.record import Record
from okid.rows import Samples, complete_rows, runs_of, scaled_block, usable_rows
from okid.scaling import CACHE_VALUES, ChannelScaling


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
        wanted = max(CACHE_VALUES, n_frequencies * n_channels**2) // (n_channels * self.advance)
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
    store = np.empty(max(sum(sizes), 3 << 20))  # 24 MiB: glibc keeps no more from call to call
    edges = np.cumsum([0, *sizes]).tolist()
    return [
        store[edge : edge + int(np.prod(shape))].reshape(shape) for edge, shape in zip(edges[:-1], shapes, strict=True)
    ]


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
    return _summed(records, order, scaling, rows)


def _summed(
    records: Sequence[Samples], order: int, scaling: ChannelScaling, rows: Sequence[BoolArray] | None
) -> LagGram:
    n_inputs, n_outputs = records[0].inputs.shape[1], records[0].outputs.shape[1]
    n_channels = n_inputs + n_outputs
    longest = max(record.outputs.shape[0] for record in records)
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


SENT_VALUES = 1 << 22
"""Hand so many values to a process at once: 32 MiB, a tenth of a second of work."""


def chunked_gram(records: Sequence[Record], order: int, *, scaling: ChannelScaling, executor: Executor) -> LagGram:
    """As `lag_gram`, summed chunk by chunk by whoever an executor has; a chunk of a mapped file is sent by its place.

    Args:
        records: of one system.
        order: largest lag.
        scaling: mean and size of every channel, decided once for all chunks.
        executor: any `concurrent.futures.Executor`; its processes must see the same files.

    Raises:
        ExecutorError: the executor broke; no chunk is left out in silence.

    Example:
        >>> from concurrent.futures import ThreadPoolExecutor
        >>> from okid.scaling import channel_scaling
        >>> record = Record(np.sin(np.arange(50.0)), np.cos(np.arange(50.0)), 0.1)
        >>> with ThreadPoolExecutor(1) as one:
        ...     chunked_gram([record], 3, scaling=channel_scaling([record]), executor=one).n_rows
        47
    """
    chunks = _chunks(records, order)
    n_chunks = n_done = 0
    waiting: deque[Future[LagGram]] = deque()
    total: LagGram | None = None
    try:
        while True:
            # half a gigabyte of values on the way
            while len(waiting) < 16 and (chunk := next(chunks, None)) is not None:
                waiting.append(executor.submit(_gram_of_chunk, chunk, order, scaling))
                n_chunks += 1
            if not waiting:
                break
            own = waiting.popleft().result()
            total = own if total is None else total + own
            n_done += 1
    except IdentificationError:
        raise
    except Exception as error:  # a broken pool, submitting after shutdown, a lost scheduler
        why = f"{type(error).__name__}: {' '.join(str(error).split()) or 'no reason given'}"
        raise ExecutorError(
            f"the executor broke ({why}) after {n_done} chunks of the records were summed; nothing is kept, so call "
            "again with a new executor, or with modal.batch.Workers, which starts a dead process again."
        ) from error
    finally:
        for future in waiting:
            future.cancel()
    if total is None:  # no record is longer than the order
        return _summed(records, order, scaling, None)
    return total


@dataclass(frozen=True, slots=True, eq=False)
class _Mapped:
    """Where an array stands in a file that another process can map, too."""

    path: str
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]

    def array(self) -> FloatArray:
        whole = np.memmap(self.path, np.uint8, "r")
        found: FloatArray = np.ndarray(self.shape, np.float64, whole, self.offset, self.strides)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Chunk:
    inputs: FloatArray
    outputs: FloatArray


def _chunks(records: Sequence[Record], order: int) -> Iterator[tuple[Any, Any]]:
    """Inputs and outputs of each chunk, `order` rows of the past before its own."""
    for record in records:
        step = max(order, SENT_VALUES // (record.n_inputs + record.n_outputs))
        for start in range(order, record.n_samples, step):
            rows = slice(start - order, min(start + step, record.n_samples))
            yield _sent(record.inputs, rows), _sent(record.outputs, rows)


def _sent(array: FloatArray, rows: slice) -> "_Mapped | FloatArray":
    """The place of some rows in their file, or the rows themselves where its path leads to other values by now."""
    part = array[rows]
    base: object = array
    while isinstance(base, np.ndarray) and not (isinstance(base, np.memmap) and not isinstance(base.base, np.memmap)):
        base = base.base  # to the map itself: a view of it knows no place of its own
    path = base.filename if isinstance(base, np.memmap) else None
    if not (isinstance(base, np.memmap) and isinstance(path, str | Path) and Path(path).is_file()):
        return part  # a file without a name has none, or the number of a handle
    beyond = part.__array_interface__["data"][0] - base.__array_interface__["data"][0]
    place = _Mapped(str(path), base.offset + beyond, part.shape, part.strides)
    try:
        same = np.array_equal(place.array()[[0, -1]], part[[0, -1]], equal_nan=True)
    except (OSError, ValueError):  # a shorter file, or none that can be read
        same = False
    return place if same else part


def _gram_of_chunk(parts: tuple[Any, Any], order: int, scaling: ChannelScaling) -> LagGram:
    inputs, outputs = (part.array() if isinstance(part, _Mapped) else part for part in parts)
    return _summed([_Chunk(inputs, outputs)], order, scaling, None)


def turn_gram(records: Sequence[Record], order: int, *, scaling: ChannelScaling, n_turns: int, turn: int) -> LagGram:
    """Gram matrix of the rows k with k mod `n_turns` = `turn`: as much work as a few Grams, not one for each row.

    A record whose samples hold `n_turns` samples of ours, z(k), z(k-1), ..., and whose rows are these k, has the same
    regressors in the same order, and its rows are one run. Up to `n_turns` - 1 rows at a record's start are left out.

    Example:
        >>> from okid.scaling import channel_scaling
        >>> record = Record(np.sin(np.arange(50.0)), np.cos(np.arange(50.0)), 0.1)
        >>> turn_gram([record], 3, scaling=channel_scaling([record]), n_turns=2, turn=1).n_rows
        24
    """
    first = n_turns - 1 + (turn + 1) % n_turns
    folded = []
    for record in records:
        if record.n_samples <= first:
            continue
        samples = np.hstack([record.inputs, record.outputs])
        together = np.hstack([samples[first - j : record.n_samples - j : n_turns] for j in range(n_turns)])
        lacking = together.shape[1] - len(together)  # a record has no fewer samples than channels: no row of it counts
        if lacking > 0:
            together = np.vstack([together, np.full((lacking, together.shape[1]), np.nan)])
        folded.append(Record(np.empty((len(together), 0)), together, record.dt * n_turns))
    nothing = np.empty(0)
    mean = np.concatenate([scaling.input_mean, scaling.output_mean])
    size = np.concatenate([scaling.input_scale, scaling.output_scale])
    repeated = ChannelScaling(
        input_mean=nothing, input_scale=nothing, output_mean=np.tile(mean, n_turns), output_scale=np.tile(size, n_turns)
    )
    gram = lag_gram(folded, -(-(order + 1) // n_turns) - 1, scaling=repeated)
    kept = 1 + (order + 1) * mean.size
    return replace(
        gram,
        matrix=_closed(gram.matrix[:kept, :kept]),
        order=order,
        n_inputs=records[0].n_inputs,
        n_outputs=records[0].n_outputs,
    )


_EDGE_VALUES = 1 << 20
"""Edge samples that are kept before they are folded into the matrix."""


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
    correlation: LagCorrelation, edges: _Edges, record: Samples, scaling: ChannelScaling, mask: BoolArray | None
) -> None:
    order, step, n_samples = edges.order, correlation.n_chunk_rows, record.outputs.shape[0]
    for start in range(order, n_samples, step):
        stop = min(start + step, n_samples)
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
