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
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from era.balanced import realise
from modal.modes.extraction import extract_modes
from modal.modes.mode import ModalModel
from modal.modes.shape_comparison import EVEN, assurance, pair_greatest_first
from okid.arrays import FloatArray, time_step, whole_number
from okid.display import Displayed
from okid.errors import IdentificationError, InsufficientDataError, InvalidDataError, UnreadableFileError
from okid.gram import LagGram, lag_gram
from okid.least_squares import solve
from okid.markov import recover_markov
from okid.observer import check_channels_move, observer_fit
from okid.readers.dispatch import READERS
from okid.readers.guard import check_file, foreign
from okid.readers.table import Column, Table, to_record
from okid.readers.text import more_rows, read_text, table_of_text
from okid.readers.units import convert_unit
from okid.record import InputHold, Record
from okid.scaling import ChannelScaling, channel_scaling

REBUILT = 10_000
"""Sum the window afresh after so many blocks: the rounding of what was added and taken off has grown till then."""

ON_TIME = 0.5
"""Take a block for the next one where it begins within so many time steps of the end of the last."""

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
    start: float
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
    n_blocks, end = 0, 0.0
    for block in blocks:
        record = _as_record(block, dt, end)
        _check(record, dt, window, observer_order, parts)
        late = record.start_time - end
        if parts and not -ON_TIME * dt <= late <= window:
            parts.clear()
            past.clear()
            total = None
        tail = parts[-1].record if parts and abs(late) <= ON_TIME * dt else None
        end = record.start_time + record.duration
        n_blocks += 1
        if scaling is None or n_blocks % REBUILT == 0:
            scaling = channel_scaling([part.record for part in parts] + [record])
            parts = deque(_part(part.record, None, part.start, observer_order, scaling) for part in parts)
            total = _sum(parts)
        parts.append(_part(record, tail, record.start_time, observer_order, scaling))
        total = parts[-1].gram if total is None else total + parts[-1].gram
        while end - parts[0].stop >= window - ON_TIME * dt:
            total = total - parts.popleft().gram
        if end - parts[0].start < window - ON_TIME * dt:
            continue
        estimate = _estimate(total, scaling, parts, order=order, ridge=ridge, n_lags=n_lags, past=past)
        past.append(estimate)
        while past[0].time < estimate.time - window - ON_TIME * dt:
            past.popleft()
        yield estimate


def _as_record(block: Block, dt: float, end: float) -> Record:
    if isinstance(block, Record):
        return block
    inputs, outputs = block
    return Record(inputs, outputs, dt, start_time=end)  # type: ignore[arg-type]  # the record makes arrays of them


def _check(record: Record, dt: float, window: float, observer_order: int, parts: Sequence[_Part]) -> None:
    n_channels = record.n_inputs + record.n_outputs
    needed = 1 + record.n_inputs + observer_order * n_channels
    if window < (needed + observer_order) * dt:
        raise InvalidDataError(
            f"an observer of order {observer_order} has {needed} numbers an output; a window of {window:.3g} s holds "
            f"{int(window / dt)} rows. Use a window of at least {(needed + observer_order) * dt:.3g} s, or a smaller "
            "order."
        )
    if abs(record.dt - dt) > 1e-9 * dt:
        raise InvalidDataError(f"a block has the time step {record.dt:.6g} s, but dt is {dt:.6g} s; give one for all.")
    if parts and (record.n_inputs, record.n_outputs) != (parts[0].record.n_inputs, parts[0].record.n_outputs):
        raise InvalidDataError("all blocks must have the same inputs and outputs; start again where channels change.")


def _part(record: Record, tail: Record | None, start: float, order: int, scaling: ChannelScaling) -> _Part:
    whole = record
    if tail is not None:
        # a row before the tail of `order` rows would count twice
        last = tail.samples(max(0, tail.n_samples - order)) if tail.n_samples > order else tail
        whole = Record(np.vstack([last.inputs, record.inputs]), np.vstack([last.outputs, record.outputs]), record.dt)
    stop = start + record.duration
    return _Part(record=record, start=start, stop=stop, gram=lag_gram([whole], order, scaling=scaling))


def _sum(parts: Iterable[_Part]) -> LagGram | None:
    total: LagGram | None = None
    for part in parts:
        total = part.gram if total is None else total + part.gram
    return total


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
    time = 0.5 * (parts[0].start + parts[-1].stop)
    try:
        check_channels_move([part.record for part in parts], channel_scaling([part.record for part in parts]))
        gram, own = _own_scaling(total, scaling)
        observer = observer_fit(solve(gram, ridge), own, dt)
        modes = extract_modes(realise(recover_markov(observer, n_lags=n_lags), order=order))
    except (IdentificationError, InsufficientDataError) as error:
        nothing = ModalModel(modes=(), dt=dt, indicator_caution=np.nan)
        return LiveEstimate(time=time, modes=nothing, n_rows=total.n_rows, warnings=(str(error),))
    span = parts[-1].stop - parts[0].start
    return LiveEstimate(time=time, modes=modes, n_rows=total.n_rows, warnings=_smeared(modes, past, time, span))


def _own_scaling(gram: LagGram, scaling: ChannelScaling) -> tuple[LagGram, ChannelScaling]:
    """The Gram matrix of channels that have mean 0 and size 1 over its own rows: exact, as phi' = T phi."""
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


POLL = 0.02
"""Look into the file again after so many seconds: a tenth of what a reader notices."""
OFF_GRID = 0.5
"""End a block where a stamp is off the grid by so many time steps: a row is missing, or the clock was set."""
HEAD_BYTES = 1 << 16
"""Tell the layout of a text table from so many bytes of its beginning."""
FEWEST_ROWS = 20
"""Wait for so many rows before the layout and the time step are told."""


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
        UnreadableFileError: no such file, no table, or one that was cut shorter while it was read.
        InvalidDataError: no time column and no dt, or a channel that is not there.
    """
    path = Path(path)
    check_file(path)
    source = _Numpy(path) if path.suffix.lower() == ".npy" else _Text(path)
    table: Table | None = None
    held = np.empty((0, 0))
    end: float | None = None
    last, complete = time.monotonic(), False
    while not complete:
        fresh = source.rows()
        if len(fresh):
            last = time.monotonic()
            held = fresh if not held.size else np.vstack([held, fresh])
        complete = stop() or time.monotonic() - last > patience
        if table is None:
            if len(held) < FEWEST_ROWS and not complete:
                time.sleep(POLL)
                continue
            table = source.table(held)
            step = _step(table, held, dt)
            recorded = partial(to_record, kind=Record, inputs=inputs, outputs=outputs, dt=step, input_hold=input_hold)
        n_rows = max(1, round(block / step))
        while len(held) >= n_rows or (complete and len(held)):
            first = _unbroken(table, held[:n_rows], step)
            if end is not None:
                _tell_break(table, held, end, step, tell)
            record = _record(table, held[:first], recorded, 0.0 if end is None else end)
            held = held[first:]
            if record is not None:
                end = record.start_time + record.duration
                yield record
        if not len(fresh) and not complete:
            time.sleep(POLL)
    tell(
        f"{path.name} has not grown for {patience:.3g} s, so its end was taken for the end of the measurement; "
        "give a longer --patience if it may pause."
        if not stop()
        else f"stopped while {path.name} was growing."
    )


class _Text:
    """Whole lines of a text table, as they come."""

    def __init__(self, path: Path) -> None:
        if READERS.get(path.suffix.lower()) is not read_text:
            raise UnreadableFileError(
                f"{path.name} is of type {path.suffix or 'none'}, whose rows cannot be followed while it grows; write "
                "a text table (.csv, .txt, ...) or .npy."
            )
        self._path, self._at, self._head = path, 0, b""

    def rows(self) -> FloatArray:
        size = self._path.stat().st_size
        if size < self._at:
            raise UnreadableFileError(f"{self._path.name} became shorter while it was followed; start again.")
        with self._path.open("rb") as file:
            if not self._head:
                data = file.read()
                whole = data[: data.rfind(b"\n") + 1]
                if whole.count(b"\n") < FEWEST_ROWS:
                    return np.empty((0, 0))
                self._head, self._at = whole[: whole[:HEAD_BYTES].rfind(b"\n") + 1], len(whole)
                return np.array(self._parsed(whole).values)
            file.seek(self._at)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        if not whole.strip():
            return np.empty((0, 0))
        self._at += len(whole)
        return more_rows(whole, self._head, self._path)[:, : self._n_columns]

    def table(self, values: FloatArray) -> Table:
        return replace(self._table, values=values)

    def _parsed(self, whole: bytes) -> Table:
        self._table = table_of_text(whole, self._path)
        self._n_columns = len(self._table.columns)
        return self._table


class _Numpy:
    """Rows behind the header of an array, however many the header says that there are."""

    def __init__(self, path: Path) -> None:
        with foreign(path, ".npy file"), path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, by_columns, self._dtype = read(file)
            self._at = file.tell()
        if by_columns or len(shape) != 2 or self._dtype.kind not in "iuf":
            raise UnreadableFileError(
                f"{path.name} holds an array of {self._dtype} of shape {shape}; rows can be followed in an array of "
                "real numbers with a row a sample, in C order."
            )
        self._path, self._n_columns = path, shape[1]

    def rows(self) -> FloatArray:
        size = self._path.stat().st_size
        if size < self._at:
            raise UnreadableFileError(f"{self._path.name} became shorter while it was followed; start again.")
        width = self._n_columns * self._dtype.itemsize
        count = (size - self._at) // width
        if not count:
            return np.empty((0, 0))
        with self._path.open("rb") as file:
            file.seek(self._at)
            data = file.read(count * width)
        self._at += count * width
        return np.frombuffer(data, self._dtype).reshape(count, -1).astype(np.float64)

    def table(self, values: FloatArray) -> Table:
        columns = tuple(Column(name=f"column_{index}") for index in range(self._n_columns))
        return Table(path=self._path, format="NPY", columns=columns, values=values)


def _seconds(table: Table, values: FloatArray) -> FloatArray | None:
    """The stamps of rows [s]; None where there is no time column."""
    index = table.time_column()
    if index is None:
        return None
    column = table.columns[index]
    conversion = convert_unit("time", column.unit)
    stamps: FloatArray = values[:, index] * (conversion.factor if conversion.unit == "s" else 1.0)
    return stamps


def _step(table: Table, values: FloatArray, dt: float | None) -> float:
    stamps = _seconds(table, values)
    if dt is not None:
        return time_step(dt)
    if stamps is None:
        raise InvalidDataError(f"{table.path.name} has no time column, so the time step must be given: --dt SECONDS.")
    return time_step(float(np.median(np.diff(stamps))))


def _unbroken(table: Table, values: FloatArray, step: float) -> int:
    """Rows before the first that does not follow the one before it."""
    stamps = _seconds(table, values)
    if stamps is None or len(values) < 2:
        return len(values)
    off = np.abs(np.diff(stamps) - step) > OFF_GRID * step
    return int(np.argmax(off)) + 1 if off.any() else len(values)


def _tell_break(table: Table, values: FloatArray, end: float, step: float, tell: Callable[[str], None]) -> None:
    stamps = _seconds(table, values[:1])
    if stamps is None:
        return
    late = float(stamps[0]) - end
    if late > OFF_GRID * step:
        tell(f"{late:.4g} s are missing before {stamps[0]:.6g} s; rows after the gap look back to nothing before it.")
    elif late < -OFF_GRID * step:
        tell(f"the clock jumped back by {-late:.4g} s to {stamps[0]:.6g} s; a new window begins there.")


def _record(table: Table, values: FloatArray, to: Callable[[Table], Record], end: float) -> Record | None:
    """The record of unbroken rows; None where they are fewer than the channels."""
    if len(values) < len(table.columns):
        return None
    stamps = _seconds(table, values)
    without = table.time_column()
    kept = [k for k in range(len(table.columns)) if k != without]
    record = to(replace(table, columns=tuple(table.columns[k] for k in kept), values=values[:, kept]))
    return replace(record, start_time=end if stamps is None else float(stamps[0]))
