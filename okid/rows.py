"""Which rows of which records take part in a regression, and what they look like.

A row k counts when its mask says so, when k >= order, and when no channel is missing at k, k-1, ..., k-order. So the
first `order` samples of every record are dropped, which makes the fit right for any initial state, and a missing sample
takes only the rows that it touches.

Folds for choosing by held-out error: masks of rows, in interleaved blocks.

Contiguous thirds would train on the tail of an earthquake and test on its shock. Blocks spread over the record give
every fold some of everything, and since Gram matrices of disjoint rows add, a training set is the whole less one fold.
"""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from okid.arrays import CHUNK_VALUES, ROUNDED, BoolArray, FloatArray, is_mapped, row_chunks, whole_number
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record
from okid.scaling import ChannelScaling

N_FOLDS = 3
"""How many folds a choice by held-out error is made over."""


def as_records(records: Record | Sequence[Record]) -> tuple[Record, ...]:
    """One record or several of one system, checked to have the same channels, units and time step.

    Raises:
        InvalidDataError: no record, something else than records, or records that do not belong together.

    Example:
        >>> len(as_records(Record([0.0, 1.0], [0.0, 0.5], 0.1)))
        1
    """
    several = tuple(records) if isinstance(records, Iterable) else (records,)
    if not several or not all(isinstance(record, Record) for record in several):
        kinds = ", ".join(sorted({type(record).__name__ for record in several})) or "nothing"
        raise InvalidDataError(f"one okid.Record or a sequence of them is needed, but {kinds} was given.")
    first = several[0]
    for number, record in enumerate(several[1:], start=1):
        for kind in ("input_names", "output_names", "input_units", "output_units"):
            have, want = getattr(record, kind), getattr(first, kind)
            if have != want:
                raise InvalidDataError(
                    f"records of one system must have the same {kind.replace('_', ' ')}, but record {number} has "
                    f"{list(have)} where record 0 has {list(want)}; select the common channels in the same order."
                )
        if abs(record.dt - first.dt) > ROUNDED * first.dt:
            raise InvalidDataError(
                f"records of one system must have the same time step, but record {number} has {record.dt:.9g} s where "
                f"record 0 has {first.dt:.9g} s; resample or decimate one of them."
            )
    return several


def bytes_in_memory(records: Sequence[Record]) -> int:
    """Of their samples; those in mapped files take none."""
    return sum(own.nbytes for one in records for own in (one.inputs, one.outputs) if not is_mapped(own))


def same_samples(one: Record, other: Record) -> bool:
    """Whether two records hold the same numbers throughout, whatever they are called.

    Two measurements never do, for no noise comes twice.
    """
    if one.outputs.shape != other.outputs.shape or one.inputs.shape != other.inputs.shape:
        return False
    pairs = ((one.outputs, other.outputs), (one.inputs, other.inputs))
    return all(
        np.array_equal(a[rows], b[rows], equal_nan=True) for a, b in pairs for rows in row_chunks(len(a), a.shape[1])
    )


def refuse_copies(records: Sequence[Record]) -> None:
    """Raise where two of the records are one: counted twice, it would seem surer than it is, and prove itself.

    Raises:
        InvalidDataError: a record that is a copy of another.

    Example:
        >>> refuse_copies([Record([], [0.0, 1.0], 0.1, name="a"), Record([], [0.0, 1.0], 0.1, name="b")])
        Traceback (most recent call last):
        okid.errors.InvalidDataError: records 'a' and 'b' hold the same samples; a record counts once; leave one out.
    """
    alike: dict[bytes, list[int]] = {}
    for number, record in enumerate(records):
        others = alike.setdefault(_some_samples(record), [])
        for other in others:
            if same_samples(records[other], record):
                raise InvalidDataError(
                    f"records {_called(records[other], other)} and {_called(record, number)} hold the same samples; a "
                    "record counts once; leave one out."
                )
        others.append(number)


def _some_samples(record: Record) -> bytes:
    """Rows all over the record: records that differ in them need not be compared."""
    rows = np.linspace(0, record.n_samples - 1, 16).astype(int)
    return np.nan_to_num(np.hstack([record.inputs[rows], record.outputs[rows]]) + 0.0, nan=np.inf).tobytes()


def _called(record: Record, number: int) -> str:
    return repr(record.name) if record.name else str(number)


def join_setups(records: Sequence[Record]) -> tuple[Record, ...]:
    """Records of one system in several set-ups, on the union of their channels: `modal.identify` joins them.

    An input that a record lacks did not act there (a roving hammer) and is 0; an output that it lacks was not measured
    there (roving sensors) and is NaN throughout.

    Args:
        records: of one system; inputs and outputs are told apart by name.

    Raises:
        InvalidDataError: other units, time steps or holds, a channel that is input here and output there, or set-ups
            that share no channel with the rest.

    Example:
        >>> first = Record([1.0, 0.0, 0.0], [0.0, 1.0, 0.5], 0.1, input_names=["hammer_1"], output_names=["tip"])
        >>> second = Record([1.0, 0.0, 0.0], [0.0, 0.8, 0.4], 0.1, input_names=["hammer_2"], output_names=["tip"])
        >>> joined = join_setups([first, second])
        >>> joined[1].input_names, joined[1].inputs[0].tolist()
        (('hammer_1', 'hammer_2'), [0.0, 1.0])
    """
    several = tuple(records)
    if not several or not all(isinstance(record, Record) for record in several):
        raise InvalidDataError("join_setups takes a sequence of okid.Record, at least one.")
    inputs: dict[str, str] = {}
    outputs: dict[str, str] = {}
    for record in several:
        for known, names, units in (
            (inputs, record.input_names, record.input_units),
            (outputs, record.output_names, record.output_units),
        ):
            for name, unit in zip(names, units, strict=True):
                if known.setdefault(name, unit) != unit:
                    raise InvalidDataError(
                        f"{name!r} is in {known[name] or 'no unit'} in one set-up and in {unit or 'no unit'} in "
                        f"{record.name or 'another'}; give it one unit."
                    )
        if record.input_hold != several[0].input_hold:
            raise InvalidDataError("set-ups of one system need one input_hold; give all of them the same.")
    both = sorted(inputs.keys() & outputs.keys())
    if both:
        raise InvalidDataError(f"{', '.join(map(repr, both))} is an input in one set-up and an output in another.")
    _check_connected(several)
    return as_records([_on_union(record, inputs, outputs) for record in several])


def _on_union(record: Record, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> Record:
    """The record with all channels, the absent inputs 0 and the absent outputs NaN."""
    if (record.input_names, record.output_names) == (tuple(inputs), tuple(outputs)):
        return record
    blocks = []
    for names, own, values, absent in (
        (inputs, record.input_names, record.inputs, 0.0),
        (outputs, record.output_names, record.outputs, np.nan),
    ):
        block = np.full((record.n_samples, len(names)), absent)
        block[:, [list(names).index(name) for name in own]] = values
        blocks.append(block)
    return replace(
        record,
        inputs=blocks[0],
        outputs=blocks[1],
        input_names=tuple(inputs),
        output_names=tuple(outputs),
        input_units=tuple(inputs.values()),
        output_units=tuple(outputs.values()),
    )


def _check_connected(records: Sequence[Record]) -> None:
    """Raise where a set-up shares nothing with the rest: how large its motion is against theirs could not be told."""
    channels = [set(record.input_names) | set(record.output_names) for record in records]
    reached, left = channels[0], list(range(1, len(records)))
    while joined := [i for i in left if channels[i] & reached]:
        reached = reached.union(*(channels[i] for i in joined))
        left = [i for i in left if i not in joined]
    if left:
        alone = records[left[0]].name or f"record {left[0]}"
        raise InvalidDataError(
            f"{alone} shares no channel with the other set-ups, so its motion cannot be scaled to theirs; keep a "
            "reference sensor or the hammer in its place."
        )


def stretch_of(record: Record, first: int, length: int) -> Record:
    """So many rows of a record from one on, under a name that says which."""
    name = f"{record.name or 'record'}, rows {first} to {first + length - 1}"
    return replace(record.samples(first, first + length), name=name)


def spread_stretches(records: Sequence[Record], n_rows: int, *, count: int = 10) -> tuple[Record, ...]:
    """About `n_rows` rows in about `count` stretches, spread evenly over the records; all of them if they are no more.

    A stretch in which an output never moves (a sensor off, a structure at rest) is left out.

    Example:
        >>> record = Record([], np.sin(np.arange(1000.0)), 0.1)
        >>> [(part.name, part.n_samples) for part in spread_stretches([record], 200, count=2)]
        [('record, rows 0 to 99', 100), ('record, rows 900 to 999', 100)]
    """
    total = sum(record.n_samples for record in records)
    if total <= n_rows:
        return tuple(records)
    parts, moving = [], []
    for record in records:
        n_parts = max(1, round(count * record.n_samples / total))
        length = max(record.n_inputs, record.n_outputs, record.n_samples * n_rows // (total * n_parts))
        for first in np.linspace(0, record.n_samples - length, n_parts).round().astype(int).tolist():
            parts.append(stretch_of(record, first, length))
            outputs = parts[-1].outputs
            moving.append(bool((outputs[1:] != outputs[:-1]).any(axis=0).all()))
    return tuple(itertools.compress(parts, moving)) or tuple(parts)


def usable_rows(complete: BoolArray, order: int) -> BoolArray:
    """True at k where k >= order and rows k - order ... k are all complete.

    Example:
        >>> usable_rows(np.array([True, True, False, True, True, True]), 1).tolist()
        [False, True, False, False, True, True]
    """
    position = np.arange(complete.size)
    last_missing = np.maximum.accumulate(np.where(complete, -1, position))
    usable: BoolArray = position - last_missing > order
    return usable


def complete_rows(block: FloatArray) -> BoolArray:
    """(n_rows,) True where no channel is NaN."""
    complete: BoolArray = ~np.asarray(np.isnan(block).any(axis=1))
    return complete


class Samples(Protocol):
    """What has measured rows: a record, or a stretch of one."""

    @property
    def inputs(self) -> FloatArray:
        """(n_samples, n_inputs)."""
        ...

    @property
    def outputs(self) -> FloatArray:
        """(n_samples, n_outputs)."""
        ...


def scaled_block(record: Samples, start: int, stop: int, scaling: ChannelScaling, *, out: FloatArray) -> bool:
    """Write scaled [u, y] of rows start ... stop into `out`; True when no sample in it is missing."""
    n_inputs = record.inputs.shape[1]
    np.subtract(record.inputs[start:stop], scaling.input_mean, out=out[:, :n_inputs])
    np.subtract(record.outputs[start:stop], scaling.output_mean, out=out[:, n_inputs:])
    out *= scaling.reciprocal
    # A NaN anywhere makes the sum NaN: one pass instead of a mask.
    return not np.isnan(out.sum())


def check_enough_rows(records: Sequence[Record], order: int) -> None:
    """Refuse an observer order for which there are fewer rows than unknowns.

    Raises:
        InvalidDataError: an order below 1.
        InsufficientDataError: too few samples, or too few rows left between the missing ones.
    """
    whole_number(order, name="an observer order", least=1)
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    n_unknowns = n_inputs + order * (n_inputs + n_outputs)
    lengths = [record.n_samples for record in records]
    what = f"{n_inputs} input{'s' * (n_inputs != 1)} and {n_outputs} output{'s' * (n_outputs != 1)}"
    if sum(max(0, length - order) for length in lengths) < n_unknowns:
        have = (
            f"the record has {lengths[0]}" if len(records) == 1 else f"the {len(records)} records have {sum(lengths)}"
        )
        raise InsufficientDataError(
            f"observer order {order} needs {n_unknowns + order * len(records)} samples for {what}; {have}. "
            f"Use {_largest(lengths, n_inputs, n_outputs)} or a longer record."
        )


def check_rows_left(records: Sequence[Record], order: int, n_rows: int) -> None:
    """Refuse a fit to which missing samples left fewer rows than unknowns, and name an order that works.

    Raises:
        InsufficientDataError: fewer rows than unknowns.
    """
    n_inputs, n_outputs = records[0].n_inputs, records[0].n_outputs
    n_unknowns = n_inputs + order * (n_inputs + n_outputs)
    if n_rows >= n_unknowns:
        return
    n_samples = sum(record.n_samples for record in records)
    complete = [record.complete_rows() for record in records]
    n_missing = n_samples - sum(int(rows.sum()) for rows in complete)
    runs = [stop - start for rows in complete for start, stop in runs_of(rows)]
    raise InsufficientDataError(
        f"observer order {order} needs {n_unknowns} rows of {order + 1} samples without a gap, but only {n_rows} are "
        f"left by the {n_missing} of {n_samples} samples that miss a channel. Use "
        f"{_largest(runs, n_inputs, n_outputs)}, leave out the channel that fails, or fill the gaps."
    )


def _largest(lengths: Sequence[int], n_inputs: int, n_outputs: int) -> str:
    """Words for the largest order that contiguous runs of these lengths allow."""

    def enough(order: int) -> bool:
        rows = sum(max(0, length - order) for length in lengths)
        return rows >= n_inputs + order * (n_inputs + n_outputs)

    low, high = 0, max(lengths, default=0)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if enough(middle) else (low, middle)
    return f"order <= {low}" if low else "fewer channels"


def runs_of(mask: BoolArray) -> list[tuple[int, int]]:
    """(start, stop) of each contiguous run of True.

    Example:
        >>> runs_of(np.array([False, True, True, False, True]))
        [(1, 3), (4, 5)]
    """
    change = np.flatnonzero(mask[1:] != mask[:-1]) + 1
    edges = [0, *change.tolist(), mask.size]
    first = 0 if mask.size and mask[0] else 1
    return list(zip(edges[first:-1:2], edges[first + 1 :: 2], strict=True))


def regressor_chunks(
    records: Sequence[Record], order: int, scaling: ChannelScaling, rows: Sequence[BoolArray] | None = None
) -> Iterator[FloatArray]:
    """Rows phi(k)' = [1, u(k)', y(k)', ..., u(k-order)', y(k-order)'] of scaled data, a bounded number at a time.

    The plain form of what `lag_gram` sums without building it; for factorisations that need the rows themselves.

    Yields:
        (n_chunk_rows, 1 + (order + 1) (n_inputs + n_outputs)) arrays.
    """
    n_channels = records[0].n_inputs + records[0].n_outputs
    width = (order + 1) * n_channels
    step = max(256, width, CHUNK_VALUES // width)
    for number, record in enumerate(records):
        for start in range(order, record.n_samples, step):
            stop = min(start + step, record.n_samples)
            block = np.empty((stop - start + order, n_channels))
            counted = np.ones(stop - start, np.bool_)
            if not scaled_block(record, start - order, stop, scaling, out=block):
                counted = usable_rows(complete_rows(block), order)[order:]
            if rows is not None:
                counted = counted & rows[number][start:stop]
            if counted.any():
                # Reversed time puts lag 0 first in every window.
                windows = np.lib.stride_tricks.sliding_window_view(block[::-1], order + 1, axis=0)[::-1]
                chunk = np.empty((int(counted.sum()), 1 + width))
                chunk[:, 0] = 1.0
                chunk[:, 1:] = windows[counted].transpose(0, 2, 1).reshape(-1, width)
                yield chunk


def whole_record_folds(records: Sequence[Record]) -> tuple[tuple[BoolArray, ...], ...]:
    """Masks of the held-out rows where the records can stand for each other: each fold holds out whole records.

    The first tenth of every record trains, so that its initial state is known when it is held out.

    Example:
        >>> record = Record([], np.arange(40.0), 0.1)
        >>> folds = whole_record_folds([record, record, record])
        >>> [[int(rows.sum()) for rows in fold] for fold in folds]
        [[36, 0, 0], [0, 36, 0], [0, 0, 36]]
    """
    folds = []
    for i in range(N_FOLDS):
        fold = []
        for r, record in enumerate(records):
            rows = np.zeros(record.n_samples, dtype=np.bool_)
            if r % N_FOLDS == i:
                rows[max(1, round(0.1 * record.n_samples)) :] = True
            fold.append(rows)
        folds.append(tuple(fold))
    return tuple(folds)


def interleaved_folds(
    records: Sequence[Record], *, n_blocks: int = 10, min_block: int = 10
) -> tuple[tuple[BoolArray, ...], ...]:
    """Masks of the held-out rows: [fold][record] -> (n_samples,) bool.

    Each record is cut into blocks of equal length. Its first block, which holds the free response to the initial state,
    always trains; the others go to the folds in turn, and the turn goes on from record to record, so that the folds
    stay equally large however many blocks a record has. A record too short for `n_blocks` blocks of `min_block` samples
    gets fewer blocks; one too short for two is a single block, which goes to a fold as a whole (the first such record
    trains).

    Args:
        records: of one system.
        n_blocks: blocks a record.
        min_block: fewest samples of a block.

    Raises:
        InsufficientDataError: the records are too short to give every fold a block.

    Example:
        >>> record = Record([], np.arange(40.0), 0.1)
        >>> for fold in interleaved_folds([record], n_blocks=4):
        ...     print(np.flatnonzero(fold[0])[[0, -1]])
        [10 19]
        [20 29]
        [30 39]
    """
    masks = [[np.zeros(record.n_samples, dtype=np.bool_) for record in records] for _ in range(N_FOLDS)]
    turn, first_single = 0, True
    for number, record in enumerate(records):
        own_blocks = min(n_blocks, record.n_samples // min_block)
        if own_blocks < 2:
            blocks = [] if first_single else [(0, record.n_samples)]
            first_single = False
        else:
            edges = np.linspace(0, record.n_samples, own_blocks + 1).round().astype(int).tolist()
            blocks = list(itertools.pairwise(edges[1:]))
        for start, stop in blocks:
            masks[turn % N_FOLDS][number][start:stop] = True
            turn += 1
    if turn < N_FOLDS:
        total = sum(record.n_samples for record in records)
        raise InsufficientDataError(
            f"{N_FOLDS} folds need at least {(N_FOLDS + 1) * min_block} samples in one record; there are {total} in "
            f"{len(records)} record{'s' * (len(records) != 1)}. Use a longer record, a smaller delay or less "
            "decimation."
        )
    for fold in masks:
        for mask in fold:
            mask.flags.writeable = False
    return tuple(tuple(fold) for fold in masks)
