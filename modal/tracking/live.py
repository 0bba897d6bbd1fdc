"""Modes while the record is still growing: an observer over a sliding window, block by block.

The Gram matrix of the window is that of its blocks: the newest is added, the oldest taken off, so a block costs what
its own rows cost, however long the window. The constant among the regressors lets the sum be scaled anew to the mean
and the size that the channels have in the window. An estimate belongs to the middle of its window: where a mode drifts,
this stamp takes the lag of half a window away. Rows after a gap look back to nothing before it.

A live estimate has no verdict: repeatability asks for the data again, which are gone. The order that is asked for and
the indicators tell a mode of the system; `modal.identify` on a stretch that was kept tells it with a verdict.

The blocks may be rows that another program is appending to a text table or to a NumPy array. Only whole lines are
read, so a row that is half written waits for its end. Stamps in a time column tell where rows are lost or a clock was
set: there a block ends, and the next one says when it begins, which is all that `follow` needs to take a gap for a gap.
What a disturbed logger writes (an infinite cell, a row without its time, a channel that is gone for a while) counts as
missing and is said once: a session ends only where the file is no longer the one that it was.
"""

import contextlib
import itertools
import operator
import os
import re
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from era.balanced import realise
from modal.modes.extraction import extract_modes
from modal.modes.mode import ModalModel
from modal.modes.shape_comparison import EVEN, assurance, pair_greatest_first
from modal.wording.text import listed
from okid.arrays import ROUNDED, FloatArray, time_step, whole_number
from okid.display import Displayed
from okid.errors import IdentificationError, InsufficientDataError, InvalidDataError, UnreadableFileError
from okid.gram import LagGram, lag_gram
from okid.least_squares import solve
from okid.markov import recover_markov
from okid.observer import check_channels_move, observer_fit
from okid.readers.arrays import array_header
from okid.readers.dispatch import READERS
from okid.readers.guard import check_file, foreign
from okid.readers.table import Column, Table, choose_channels, to_record
from okid.readers.text import more_rows, read_text, table_of_text
from okid.readers.units import convert_unit
from okid.record import InputHold, Record
from okid.scaling import ChannelScaling, channel_scaling

ON_TIME = 0.5
"""Take a block, or a row, for the next one where it begins within so many time steps of the end of the last; else
one is missing, or the clock was set."""

LIVE_RIDGE = 1e-8
"""Keep the observer of a window in which inputs rest for a while from growing without bound."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class LiveEstimate(Displayed):
    """The modes of one window.

    Attributes:
        time: middle of the window [s].
        modes: of the model of the window, without verdicts; empty where the window carries none.
        n_rows: rows of the window that counted.
        warnings: a sentence for each thing that a reader must know: smeared modes, channels at rest.
    """

    time: float
    modes: ModalModel
    n_rows: int
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Part:
    """One block with the rows before it that its own rows look back to."""

    record: Record
    stop: float
    gram: LagGram


Block = Record | tuple[npt.ArrayLike, npt.ArrayLike]


def follow(
    blocks: Iterable[Block],
    *,
    dt: float,
    window: float,
    observer_order: int,
    order: int | Literal["auto"] = "auto",
    ridge: float = LIVE_RIDGE,
    n_lags: int | None = None,
) -> Iterator[LiveEstimate]:
    """Modes of a sliding window, one estimate a block once the first window is full.

    Args:
        blocks: records, or (inputs, outputs) with a row a sample, in order of time; blocks of at least ten observer
            orders cost least. A record whose `start_time` is later than the end of the last has lost rows before it;
            one that begins before it, or a window later, starts a new window.
        dt: time step [s].
        window: length of the window [s]; a drift of r Hz/s smears a mode by r times this.
        observer_order: number of past samples that the observer uses, a few times the number of states over outputs.
        order: number of states; "auto" takes it from the largest drop of the singular values, each window anew.
        ridge: relative to the unit diagonal of scaled channels.
        n_lags: Markov parameters that are realised; unless given twice the observer order, which is short where a mode
            needs many samples for a period. `modal.choose_orders` of a first stretch gives all four.

    Yields:
        Estimates, stamped at the middle of their windows.

    Raises:
        InvalidDataError: a window that holds fewer rows than the observer has numbers, or blocks of other channels.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> force, tip = rng.standard_normal(2000), np.zeros(2000)
        >>> for k in range(2, 2000):  # 5 Hz, 2 % damping, 50 samples a second
        ...     tip[k] = 1.597828 * tip[k - 1] - 0.975180 * tip[k - 2] + force[k - 1]
        >>> blocks = [(force[k : k + 200], tip[k : k + 200]) for k in range(0, 2000, 200)]
        >>> last = list(follow(blocks, dt=0.02, window=20.0, observer_order=4, order=2))[-1]
        >>> round(last.time, 6), round(last.modes.modes[0].frequency, 2)
        (30.0, 5.0)
    """
    dt, observer_order = time_step(dt), whole_number(observer_order, name="observer_order", least=1)
    parts: deque[_Part] = deque()
    past: deque[LiveEstimate] = deque()
    scaling: ChannelScaling | None = None
    total: LagGram | None = None
    taken_off, end = np.zeros(1), 0.0
    for block in blocks:
        try:
            record = block if isinstance(block, Record) else Record(*block, dt=dt, start_time=end)  # type: ignore[arg-type]
        except TypeError:
            raise InvalidDataError("a block must be a record or a pair (inputs, outputs); give one of them.") from None
        _check(record, dt, window, observer_order, parts)
        if parts and not -ON_TIME * dt <= record.start_time - end <= window:
            parts.clear()
            past.clear()
            total = None
        end = record.start_time + record.duration
        if scaling is None:
            scaling = channel_scaling([record])
        parts.append(_part(record, parts, observer_order, scaling))
        total = parts[-1].gram if total is None else total + parts[-1].gram
        while end - parts[0].stop >= window - ON_TIME * dt:
            gone = parts.popleft().gram
            total, taken_off = total - gone, taken_off + np.diag(gone.matrix)
        if (taken_off / 10_000 > np.diag(total.matrix)).any():  # its rounding stays behind till then
            scaling = channel_scaling([part.record for part in parts])
            afresh: deque[_Part] = deque()
            for part in parts:
                afresh.append(_part(part.record, afresh, observer_order, scaling))
            parts, taken_off = afresh, np.zeros(1)
            total = reduce(operator.add, (part.gram for part in parts))
        if end - parts[0].record.start_time < window - ON_TIME * dt:
            continue
        estimate = _estimate(total, scaling, parts, order=order, ridge=ridge, n_lags=n_lags, past=past)
        past.append(estimate)
        while past[0].time < estimate.time - window - ON_TIME * dt:
            past.popleft()
        yield estimate


def _check(record: Record, dt: float, window: float, observer_order: int, parts: Sequence[_Part]) -> None:
    needed = 1 + record.n_inputs + observer_order * (record.n_inputs + record.n_outputs)
    if window < (needed + observer_order) * dt:
        raise InvalidDataError(
            f"an observer of order {observer_order} has {needed} numbers an output; a window of {window:.3g} s holds "
            f"{int(window / dt)} rows. Use a window of at least {(needed + observer_order) * dt:.3g} s, or a smaller "
            "order."
        )
    if abs(record.dt - dt) > ROUNDED * dt:
        raise InvalidDataError(f"a block has the time step {record.dt:.6g} s, but dt is {dt:.6g} s; give one for all.")
    if parts and (record.n_inputs, record.n_outputs) != (parts[0].record.n_inputs, parts[0].record.n_outputs):
        raise InvalidDataError("all blocks must have the same inputs and outputs; start again where channels change.")


def _part(record: Record, before: Sequence[_Part], order: int, scaling: ChannelScaling) -> _Part:
    most = order + record.n_samples  # more rows of the past would count twice
    start, inputs, outputs = record.start_time, record.inputs, record.outputs
    for part in reversed(before):
        if len(outputs) >= most or abs(start - part.stop) > ON_TIME * record.dt:
            break
        start = part.record.start_time
        inputs, outputs = np.vstack([part.record.inputs, inputs]), np.vstack([part.record.outputs, outputs])
    whole = Record(inputs[-most:], outputs[-most:], record.dt)
    with np.errstate(over="ignore", invalid="ignore"):  # said below
        gram = lag_gram([whole], order, scaling=scaling)
    if not np.isfinite(gram.matrix).all():
        raise InvalidDataError(
            "the squares of all values must add up to a number below 1e308, but those of the block at "
            f"{record.start_time:.6g} s do not; remove the samples that are no measurements."
        )
    return _Part(record=record, stop=record.start_time + record.duration, gram=gram)


def _estimate(
    total: LagGram,
    scaling: ChannelScaling,
    parts: Sequence[_Part],
    *,
    order: int | Literal["auto"],
    ridge: float,
    n_lags: int | None,
    past: Sequence[LiveEstimate],
) -> LiveEstimate:
    dt = parts[0].record.dt
    span = parts[-1].stop - parts[0].record.start_time
    time = parts[-1].stop - 0.5 * span
    try:
        check_channels_move([part.record for part in parts], channel_scaling([part.record for part in parts]))
        gram, own = _own_scaling(total, scaling)
        observer = observer_fit(solve(gram, ridge), own, dt)
        modes = extract_modes(realise(recover_markov(observer, n_lags=n_lags), order=order))
    except (IdentificationError, InsufficientDataError) as error:
        nothing = ModalModel(modes=(), dt=dt, indicator_caution=np.nan)
        return LiveEstimate(time=time, modes=nothing, n_rows=total.n_rows, warnings=(str(error),))
    return LiveEstimate(time=time, modes=modes, n_rows=total.n_rows, warnings=_smeared(modes, past, time, span))


def _own_scaling(gram: LagGram, scaling: ChannelScaling) -> tuple[LagGram, ChannelScaling]:
    """The Gram matrix of channels that have mean 0 and size 1 over its own rows: exact, as phi' = T phi."""
    if not gram.n_rows:
        raise InsufficientDataError(
            f"no row of the window and the {gram.order} rows before it have a number in every channel; leave out the "
            "channel without, or use a smaller order."
        )
    n_channels = gram.n_inputs + gram.n_outputs
    now = slice(1, 1 + n_channels)
    mean = gram.matrix[0, now] / gram.n_rows
    size = np.sqrt(np.maximum(np.diag(gram.matrix)[now] / gram.n_rows - mean**2, 0.0))
    size = np.where(size > 0.0, size, 1.0)
    factor = np.concatenate([[1.0], np.tile(1.0 / size, gram.order + 1)])
    shift = np.concatenate([[0.0], np.tile(mean, gram.order + 1)])
    first = np.outer(shift, gram.matrix[0] - 0.5 * gram.n_rows * shift)
    matrix = (gram.matrix - first - first.T) * factor * factor[:, np.newaxis]
    m = gram.n_inputs
    own = ChannelScaling(
        input_mean=scaling.input_mean + scaling.input_scale * mean[:m],
        input_scale=scaling.input_scale * size[:m],
        output_mean=scaling.output_mean + scaling.output_scale * mean[m:],
        output_scale=scaling.output_scale * size[m:],
    )
    return replace(gram, matrix=matrix), own


def _smeared(modes: ModalModel, past: Sequence[LiveEstimate], time: float, span: float) -> tuple[str, ...]:
    """Modes that moved by more than their bandwidth since one window ago: their damping is that of the smear."""
    if not past or past[0].time > time - 0.9 * span or not len(past[0].modes) or not len(modes):
        return ()
    before = past[0].modes.modes
    shapes, earlier = (np.array([mode.shape for mode in some]).T for some in (modes.modes, before))
    alike = assurance(shapes, earlier)
    f, g = (np.array([mode.frequency for mode in some]) for some in (modes.modes, before))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = f[:, np.newaxis] / g
        nearness = np.nan_to_num(np.minimum(ratio, 1.0 / ratio))
    partner = pair_greatest_first(np.where(alike > EVEN, alike * nearness, 0.0))
    texts = []
    for mode, at in zip(modes.modes, partner, strict=True):
        moved = abs(mode.frequency - g[at]) if at >= 0 and mode.emac > EVEN and before[at].emac > EVEN else 0.0
        if mode.kind == "oscillatory" and moved > 2.0 * mode.damping_ratio * mode.frequency > 0.0:
            texts.append(
                f"the mode at {mode.frequency:.4g} Hz is smeared: it moved by {moved:.2g} Hz within one window of "
                f"{span:.3g} s, more than its bandwidth; use a shorter window."
            )
    return tuple(texts)


FEWEST_ROWS = 20
"""Wait for so many rows before the layout and the time step are told."""
PAUSE = 0.02
"""Look for new rows no sooner than so many seconds after the last look: a tenth of what a reader notices."""
SEEN_BYTES = 64
"""Compare so many of the bytes that were read last: where they have changed, the file was written anew."""
_BEGINS_AS_A_ROW = re.compile(rb"[\s\0\"'+.,;|-]*(\d|nan|inf|$)", re.IGNORECASE)
LARGEST = 1e150
"""Count a cell beyond this as missing: sums of its square are no numbers."""


def growing_blocks(
    path: str | Path,
    *,
    inputs: Sequence[str] | str | None,
    outputs: Sequence[str] | str | None = None,
    dt: float | None = None,
    input_hold: InputHold = "band_limited",
    block: float,
    patience: float = 10.0,
    tell: Callable[[str], None] = lambda _text: None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[Record]:
    """Records of about `block` seconds each, in the order in which they are written, until the file stops growing.

    Args:
        path: CSV, TSV, TXT or another text table; or NPY, to which rows are appended behind its header.
        inputs: names of the channels that drive the system.
        outputs: names of the others; all others unless given.
        dt: time step [s]; unless given, the median step of the time column.
        input_hold: what the inputs did between samples.
        block: length of a block [s]; the last one may be shorter.
        patience: seconds without a new row after which the file counts as complete.
        tell: takes a sentence for each gap, each jump of the clock, and the end.
        stop: asked while waiting; True ends as if the file had stopped.

    Raises:
        UnreadableFileError: no such file, no table, or one that is removed, replaced or cut while it is read.
        InvalidDataError: no time column and no dt, a channel that is not there, or too few rows.
    """
    path = Path(path)
    check_file(path)
    missing = _Missing(path.name, tell)
    with contextlib.closing(_Numpy(path) if path.suffix.lower() == ".npy" else _Text(path, missing)) as source:
        pieces = _pieces(source, path.name, patience, stop)
        for first in itertools.islice(pieces, 1):
            table = source.table(np.vstack(first[0]))
            step = _step(table, dt)
            into, out = choose_channels(table, inputs, outputs)
            kept = [*into, *out]
            chosen = replace(table, columns=tuple(table.columns[k] for k in kept))
            n_rows = len(kept), max(len(kept), round(block / step))
            for start, rows in _runs(table, itertools.chain([first], pieces), step, n_rows, missing):
                if not missing.channels(table, rows, kept):
                    record = to_record(
                        replace(chosen, values=rows[:, kept]),
                        Record,
                        inputs=[table.names[k] for k in into],
                        outputs=[table.names[k] for k in out],
                        dt=step,
                        input_hold=input_hold,
                    )
                    yield replace(record, start_time=start)
    missing.tell_all()
    tell(
        f"{path.name} has not grown for {patience:.3g} s, so its end was taken for the end of the measurement; "
        "give a longer --patience if it may pause."
        if not stop()
        else f"stopped while {path.name} was growing."
    )


def _pieces(
    source: "_Text | _Numpy", name: str, patience: float, stop: Callable[[], bool]
) -> Iterator[tuple[list[FloatArray], bool]]:
    """Rows as they come, and whether they are the last; the first ones are enough to tell the layout."""
    waiting: list[FloatArray] = []
    last, begun, complete = time.monotonic(), False, False
    while not complete:
        asked = time.monotonic()
        fresh = source.rows()
        if len(fresh):
            last = time.monotonic()
            waiting.append(fresh)
        complete = stop() or time.monotonic() - last > patience
        begun = begun or sum(map(len, waiting)) >= FEWEST_ROWS
        if begun:
            yield waiting, complete
            waiting = []
        elif complete and not stop():
            raise InvalidDataError(
                f"{name} has not grown for {patience:.3g} s and holds fewer than the {FEWEST_ROWS} rows that tell its "
                "layout and time step; write more, or give a longer --patience."
            )
        if not complete:  # however often somebody writes: a handful of rows costs as much to read as a thousand
            time.sleep(max(0.0, asked + PAUSE - time.monotonic()))


def _runs(
    table: Table,
    pieces: Iterable[tuple[list[FloatArray], bool]],
    step: float,
    n_rows: tuple[int, int],
    missing: "_Missing",
) -> Iterator[tuple[float, FloatArray]]:
    """Rows without a gap, at least and at most so many at a time, with the time of the first [s]."""
    fewest, most = n_rows
    held = missing.left(table, table.values[:0])
    end: float | None = None
    for fresh, complete in pieces:
        held = np.vstack([held, *(missing.left(table, rows) for rows in fresh)])
        while len(held) >= most or (complete and len(held)):
            n_unbroken = _unbroken(table, held[:most], step)
            rows, held = held[:n_unbroken], held[n_unbroken:]
            stamps = _seconds(table, rows)
            start = float(stamps[0]) if stamps is not None else end or 0.0
            if end is not None:
                _tell_break(start, end, step, missing.tell)
            if len(rows) >= fewest:
                end = start + len(rows) * step
                yield start, rows


class _Missing:
    """What counts as missing in a growing file: each kind is said where it first occurs, and all of it at the end."""

    def __init__(self, name: str, tell: Callable[[str], None]) -> None:
        self._name, self.tell = name, tell
        self._n_rows = 0
        self._counts: Counter[str] = Counter()

    def left(self, table: Table, values: FloatArray) -> FloatArray:
        """The rows that have a time, without cells that are no measurement; behind each its number in the file."""
        wild = ~np.isnan(values) & ~(np.abs(values) <= LARGEST)
        for row, k in np.argwhere(wild)[:1]:
            what = f"row {self._n_rows + row + 1} of {self._name} holds {values[row, k]:g} in {table.names[k]!r}"
            self._say("cells that are no measurement", what, int(wild.sum()))
        numbers = self._n_rows + 1.0 + np.arange(len(values))
        self._n_rows += len(values)
        values = np.column_stack([np.where(wild, np.nan, values), numbers])
        stamps = _seconds(table, values)
        lost = np.zeros(len(values), dtype=np.bool_) if stamps is None else np.isnan(stamps)
        if lost.any():
            self._say("rows without a time", f"row {values[lost][0, -1]:.0f} of {self._name} has no time", lost.sum())
        return values[~lost]

    def channels(self, table: Table, rows: FloatArray, kept: Sequence[int]) -> bool:
        """Whether a channel has no number in any of these rows."""
        empty = [table.names[k] for k in kept if np.isnan(rows[:, k]).all()]
        if empty:
            where = f"rows {rows[0, -1]:.0f} to {rows[-1, -1]:.0f} of {self._name}"
            self._say("rows without a channel", f"{where} hold no number of {listed(empty)}", len(rows))
        return bool(empty)

    def torn(self, error: UnreadableFileError) -> None:
        """A line as a logger leaves it that lost its power, or two that write at once."""
        self._say("lines that are no row", str(error).partition("; ")[0], 1)

    def _say(self, kind: str, what: str, count: int) -> None:
        if not self._counts[kind]:
            self.tell(f"{what}; {kind} count as missing, here and later.")
        self._counts[kind] += count

    def tell_all(self) -> None:
        """Say how much counted as missing."""
        if self._counts:
            said = [f"{kind} ({count})" for kind, count in self._counts.items()]
            self.tell(f"missing in {self._name}: {listed(said)}.")


class _Growing:
    """The bytes that are appended to a file, which is held open: no other one is then taken for it."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("rb", buffering=0)
        except OSError as error:
            raise UnreadableFileError(f"{path} cannot be opened ({error.strerror}); check the path.") from error
        self._path, self._at, self._last = path, 0, b""

    def close(self) -> None:
        self._file.close()

    def _behind(self) -> bytes:
        """What stands behind all that was taken."""
        try:
            named, opened = self._path.stat(), os.fstat(self._file.fileno())
        except OSError as error:
            raise UnreadableFileError(
                f"{self._path.name} was removed while it was followed ({error.strerror}); start again."
            ) from error
        self._file.seek(self._at - len(self._last))
        data = self._file.readall()
        for how, done in (
            ("was replaced by another file", not os.path.samestat(named, opened)),
            ("became shorter", opened.st_size < self._at),
            ("was written anew", not data.startswith(self._last)),
        ):
            if done:
                raise UnreadableFileError(f"{self._path.name} {how} while it was followed; start again.")
        return data[len(self._last) :]

    def _take(self, data: bytes) -> None:
        self._at += len(data)
        self._last = (self._last + data[-SEEN_BYTES:])[-SEEN_BYTES:]


class _Text(_Growing):
    """Whole lines of a text table, as they come."""

    _table: Table

    def __init__(self, path: Path, missing: _Missing) -> None:
        if READERS.get(path.suffix.lower()) is not read_text:
            raise UnreadableFileError(
                f"{path.name} is of type {path.suffix or 'none'}, whose rows cannot be followed while it grows; write "
                "a text table (.csv, .txt, ...) or .npy."
            )
        super().__init__(path)
        self._head, self._n_lines, self._missing = b"", 0, missing

    def rows(self) -> FloatArray:
        data = self._behind()
        whole = data[: data.rfind(b"\n") + 1]
        if not whole.strip() or (not self._head and whole.count(b"\n") < FEWEST_ROWS):
            return np.empty((0, 0))
        if self._head:
            values = self._more(whole.splitlines(keepends=True), self._n_lines)
        else:
            self._head = whole[: whole.find(b"\n", min(1 << 16, len(whole) - 1)) + 1]  # enough to tell the layout
            self._table = table_of_text(whole, self._path)
            values = self._table.values
        self._take(whole)
        self._n_lines += whole.count(b"\n")
        return values

    def _more(self, lines: list[bytes], n_before: int) -> FloatArray:
        """The rows of lines, NaN where a line is torn."""
        width = len(self._table.columns)
        try:
            return more_rows(b"".join(lines), self._head, self._path, n_lines=n_before)[:, :width]
        except UnreadableFileError as error:
            if (half := len(lines) // 2) > 0:
                return np.vstack([self._more(lines[:half], n_before), self._more(lines[half:], n_before + half)])
            if not lines[0].strip():
                return np.empty((0, width))
            if not _BEGINS_AS_A_ROW.match(lines[0]):  # another table begins
                raise
            self._missing.torn(error)
            return np.full((1, width), np.nan)

    def table(self, values: FloatArray) -> Table:
        return replace(self._table, values=values)


class _Numpy(_Growing):
    """Rows behind the header of an array, however many the header says that there are."""

    def __init__(self, path: Path) -> None:
        with foreign(path, ".npy file"), path.open("rb") as file:
            shape, by_columns, self._dtype = array_header(file)
            header = file.tell()
        if by_columns or len(shape) != 2 or shape[1] < 1 or self._dtype.kind not in "iuf":
            raise UnreadableFileError(
                f"{path.name} holds an array of {self._dtype} of shape {shape}; rows can be followed in an array of "
                "real numbers with a row a sample, in C order."
            )
        super().__init__(path)
        self._at, self._n_columns = header, shape[1]

    def rows(self) -> FloatArray:
        data, width = self._behind(), self._n_columns * self._dtype.itemsize
        whole = data[: len(data) // width * width]
        self._take(whole)
        return np.frombuffer(whole, self._dtype).reshape(-1, self._n_columns).astype(np.float64)

    def table(self, values: FloatArray) -> Table:
        columns = tuple(Column(name=f"column_{index}") for index in range(self._n_columns))
        return Table(path=self._path, format="NPY", columns=columns, values=values)


def _seconds(table: Table, values: FloatArray) -> FloatArray | None:
    """The stamps of rows [s]; None where there is no time column."""
    index = table.time_column()
    if index is None:
        return None
    conversion = convert_unit("time", table.columns[index].unit)
    stamps: FloatArray = values[:, index] * (conversion.factor if conversion.unit == "s" else 1.0)
    return stamps


def _step(table: Table, dt: float | None) -> float:
    stamps = _seconds(table, table.values)
    if dt is not None:
        return time_step(dt)
    if stamps is None:
        raise InvalidDataError(f"{table.path.name} has no time column, so the time step must be given: --dt SECONDS.")
    stamps = stamps[np.abs(stamps) <= LARGEST]
    if len(stamps) < 2:
        raise InvalidDataError(f"{table.path.name} has no times in its first rows; correct them, or give --dt SECONDS.")
    return time_step(float(np.median(np.diff(stamps))))


def _unbroken(table: Table, values: FloatArray, step: float) -> int:
    """Rows before the first that does not follow the one before it."""
    stamps = _seconds(table, values)
    if stamps is None or len(values) < 2:
        return len(values)
    off = np.abs(np.diff(stamps) - step) > ON_TIME * step
    return int(np.argmax(off)) + 1 if off.any() else len(values)


def _tell_break(start: float, end: float, step: float, tell: Callable[[str], None]) -> None:
    late = start - end
    if late > ON_TIME * step:
        tell(f"{late:.4g} s are missing before {start:.6g} s; rows after the gap look back to nothing before it.")
    elif late < -ON_TIME * step:
        tell(f"the clock jumped back by {-late:.4g} s to {start:.6g} s; a new window begins there.")
