"""A measured or simulated record: what went in, what came out, at which time step.

Time-major arrays, one column a channel. A NaN in an output is a missing sample, a NaN in an input a gap; every stage
that reads a record leaves out the rows that they touch. A record is never changed: each method returns a new one.

What must hold of the parts of a record; each check raises one sentence that says what to change.

Detrending and decimation of time-major arrays with missing samples; decimation in chunks, so maps stay on disk.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from okid.arrays import (
    ROUNDED,
    BoolArray,
    FloatArray,
    any_number,
    check_not_empty,
    column_block,
    real_number,
    row_chunks,
    time_major,
    time_step,
    whole_number,
)
from okid.display import Displayed, first_names
from okid.errors import InsufficientDataError, InvalidDataError, encodable

if TYPE_CHECKING:
    import pyarrow as pa

CUT_OFF = 0.75
"""Cut-off of the filter over the new Nyquist frequency: with this and the window, its stop band begins there."""

KAISER_BETA = 8.0
"""Window parameter: about 80 dB in the stop band."""

HALF_LENGTH = 10
"""Half the filter's length in new samples."""


def filter_half_length(factor: int) -> int:
    """Samples on either side that the anti-alias filter of `decimated` reaches to."""
    return HALF_LENGTH * factor


def detrended(array: FloatArray, degree: int) -> FloatArray:
    """Each channel less its least-squares polynomial over the samples that are there.

    Legendre polynomials over the whole span, so that the fit is well conditioned at any degree.

    Args:
        array: (n_samples, n_channels), NaN where missing.
        degree: of the polynomial.
    """
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(array)), degree)
    result = np.array(array, order="C")
    complete = ~np.isnan(result.sum(axis=0))
    if complete.all():
        result -= basis @ np.linalg.lstsq(basis.T @ basis, basis.T @ result, rcond=None)[0]
        return result
    for index in range(array.shape[1]):
        rows = ~np.isnan(result[:, index])
        if not rows.any():
            continue
        coefficients, *_ = np.linalg.lstsq(basis[rows], result[rows, index], rcond=None)
        result[rows, index] -= basis[rows] @ coefficients
    return result


def decimated(array: FloatArray, factor: int) -> FloatArray:
    """Every `factor`-th row of the low-passed array, without the rows at the ends that the filter does not fill.

    Args:
        array: (n_samples, n_channels), NaN where missing; a row within the filter's reach of a NaN becomes NaN.
        factor: of decimation, at least 2.

    Returns:
        (n_rows, n_channels): row r is centred at sample `filter_half_length(factor) + r * factor`.
    """
    import scipy

    half = filter_half_length(factor)
    taps = scipy.signal.firwin(2 * half + 1, CUT_OFF / factor, window=("kaiser", KAISER_BETA))
    n_samples, n_channels = array.shape
    n_rows = (n_samples - 2 * half - 1) // factor + 1
    result = np.empty((n_rows, n_channels))
    for rows in row_chunks(n_rows, n_channels * factor):
        part = array[rows.start * factor : (rows.stop - 1) * factor + 2 * half + 1]
        missing = np.isnan(part)
        touched = missing.any()
        # Output k of upfirdn is centred at k * factor - half: the first 2 HALF_LENGTH ones reach before the part.
        filtered = scipy.signal.upfirdn(taps, np.where(missing, 0.0, part) if touched else part, 1, factor, axis=0)
        result[rows] = filtered[2 * HALF_LENGTH : 2 * HALF_LENGTH + rows.stop - rows.start]
        if touched:
            count = np.cumsum(np.vstack([np.zeros((1, n_channels), dtype=np.intp), missing]), axis=0)
            first = np.arange(rows.stop - rows.start) * factor
            result[rows][count[first + 2 * half + 1] > count[first]] = np.nan
    return result


def as_inputs(values: npt.ArrayLike, n_samples: int) -> FloatArray:
    """The inputs as an array; nothing at all means no inputs, (n_samples, 0)."""
    inputs = time_major(values, name="inputs")
    return inputs if inputs.size else time_major(np.empty((n_samples, 0)), name="inputs")


def check_lengths(inputs: FloatArray, outputs: FloatArray) -> None:
    """Raise unless there are samples and outputs, as many rows of both, and no more channels than rows."""
    if outputs.shape[1] == 0 or len(outputs) == 0:
        raise InvalidDataError(
            f"a record needs at least one output and one sample, but its outputs have the shape {outputs.shape}."
        )
    for kind, array in (("inputs", inputs), ("outputs", outputs)):
        n_samples, n_channels = array.shape
        if n_channels > n_samples:
            raise InvalidDataError(
                f"{kind} have {n_channels} channels but only {n_samples} samples; rows are samples, so pass {kind}.T."
            )
    if inputs.shape[0] != outputs.shape[0]:
        raise InvalidDataError(
            f"inputs have {inputs.shape[0]} samples and outputs {outputs.shape[0]}; give both over the same rows."
        )


def labels(given: Sequence[str] | None, count: int, kind: str, *, named: bool) -> tuple[str, ...]:
    """The names or units of the channels: those given, else input_0, ... or empty units."""
    what = "names" if named else "units"
    if isinstance(given, str):
        given = (given,)
    if given is not None and not isinstance(given, Iterable):
        raise InvalidDataError(f"{kind} {what} must be a sequence of words, one for each channel, but are {given!r}.")
    given = () if given is None else tuple(given)
    if len(given) == 0:
        return tuple(f"{kind}_{i}" if named else "" for i in range(count))
    if len(given) != count:
        raise InvalidDataError(f"{len(given)} {kind} {what} were given for {count} {kind}s; give one for each channel.")
    return tuple(encodable(str(label)) for label in given)


def own_names(values: object, given: Any) -> Any:
    """What is given, else the names that a data frame or one column of it gives its channels; none of an array.

    Example:
        >>> own_names([[1.0, 2.0]], ()), own_names([[1.0, 2.0]], ["a", "b"])
        ((), ['a', 'b'])
    """
    if given is not None and not (isinstance(given, tuple | list) and not given):
        return given
    if hasattr(values, "to_frame"):  # one column of pandas or polars
        values = values.to_frame()
    names = tuple(getattr(values, "columns", ()))
    return names if all(isinstance(name, str) and name for name in names) else ()


def check_names(names: tuple[str, ...]) -> None:
    """Raise if a channel name stands more than once."""
    double = sorted(name for name, count in Counter(names).items() if count > 1)
    if double:
        raise InvalidDataError(
            f"channel names must be unique, but {', '.join(map(repr, double))} stand more than once; rename them."
        )


def channel_indices(chosen: Sequence[str | int] | None, names: tuple[str, ...], kind: str) -> list[int]:
    """Indices of channels given by name or index; None means all."""
    if chosen is None:
        return list(range(len(names)))
    if isinstance(chosen, str):
        chosen = [chosen]
    indices = []
    for channel in chosen:
        if isinstance(channel, str) and channel in names:
            indices.append(names.index(channel))
        elif not isinstance(channel, str) and 0 <= channel < len(names):
            indices.append(int(channel))
        else:
            raise InvalidDataError(f"there is no {kind} {channel!r}; the {kind}s are {', '.join(names) or 'none'}.")
    return indices


InputHold = Literal["zero_order", "linear", "band_limited"]
"""What the input did between samples: held by a DAC, straight lines, or measured through an anti-alias filter."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Record(Displayed):
    """Inputs and outputs of one uninterrupted experiment on a uniform time grid.

    Args:
        inputs: (n_samples, n_inputs); n_inputs may be 0. One-dimensional values are one channel.
        outputs: (n_samples, n_outputs); NaN marks a missing sample, NaN throughout a channel that another record has.
        dt: time step [s].
        input_names: one a channel, unique over inputs and outputs; by default those of a frame, else "input_0" ...
        output_names: likewise, else "output_0" ...
        input_units: one a channel, "" where unknown.
        output_units: likewise.
        input_hold: "zero_order" (a DAC held it), "linear", or "band_limited" (measured through an anti-alias filter, as
            most measured forces are and as the readers take files). Modal masses depend on it, modes do not; the phases
            of the modes tell a wrong one.
        name: of the record, for messages and reports.
        start_time: time of the first sample [s].

    Raises:
        InvalidDataError: the arrays do not fit together, hold infinite values, or a channel holds no number at all.

    Example:
        >>> record = Record([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5], 0.01, output_names=["tip"])
        >>> record.n_samples, record.output_names, record.duration
        (4, ('tip',), 0.04)
    """

    inputs: FloatArray
    outputs: FloatArray
    dt: float
    _: KW_ONLY
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    input_units: tuple[str, ...] = ()
    output_units: tuple[str, ...] = ()
    input_hold: InputHold = "zero_order"
    name: str = ""
    start_time: float = 0.0

    def __post_init__(self) -> None:
        named = own_names(self.inputs, self.input_names), own_names(self.outputs, self.output_names)
        outputs = time_major(self.outputs, name="outputs")
        inputs = as_inputs(self.inputs, outputs.shape[0])
        check_lengths(inputs, outputs)
        dt = time_step(self.dt)
        if not np.isfinite(real_number(self.start_time)):
            raise InvalidDataError(f"start_time must be a finite time in seconds, but is {self.start_time}.")
        if self.input_hold not in get_args(InputHold):
            choices = ", ".join(get_args(InputHold))
            raise InvalidDataError(f"input_hold must be one of {choices}, but is {self.input_hold!r}.")
        set_ = object.__setattr__
        set_(self, "inputs", inputs)
        set_(self, "outputs", outputs)
        set_(self, "dt", dt)
        set_(self, "start_time", float(self.start_time))
        set_(self, "name", encodable(str(self.name)))
        set_(self, "input_names", labels(named[0], inputs.shape[1], "input", named=True))
        set_(self, "output_names", labels(named[1], outputs.shape[1], "output", named=True))
        set_(self, "input_units", labels(self.input_units, inputs.shape[1], "input", named=False))
        set_(self, "output_units", labels(self.output_units, outputs.shape[1], "output", named=False))
        check_names(self.input_names + self.output_names)
        check_not_empty(inputs, self.input_names, "input")
        if not any_number(outputs):
            check_not_empty(outputs, self.output_names, "output")

    def __repr__(self) -> str:
        name = f"{self.name!r}: " if self.name else ""
        return (
            f"Record({name}{self.n_samples} samples every {self.dt:.6g} s, inputs {first_names(self.input_names)}, "
            f"outputs {first_names(self.output_names)})"
        )

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return len(self.outputs)

    @property
    def n_inputs(self) -> int:
        """Number of inputs, 0 when nothing that drives the system was measured."""
        return len(self.input_names)

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.output_names)

    @property
    def duration(self) -> float:
        """Number of samples times the time step [s]."""
        return self.n_samples * self.dt

    @property
    def sampling_frequency(self) -> float:
        """Samples a second [Hz]."""
        return 1.0 / self.dt

    @property
    def time(self) -> FloatArray:
        """(n_samples,) time of each sample [s]."""
        return self.start_time + self.dt * np.arange(self.n_samples, dtype=np.float64)

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        *,
        inputs: Sequence[str] | str,
        outputs: Sequence[str] | str,
        dt: float | None = None,
        input_hold: InputHold = "band_limited",
    ) -> "Record":
        """A record from a data frame of pandas, polars or Arrow, read as a file with the same columns would be.

        Also from the time series that other readers hand on as SEP 005 of SDyPy has them: a list of dictionaries.

        Args:
            frame: one column a channel; a unit stands in the name (`tip [g]`) or in the metadata of the field.
            inputs: names of the channels that drive the system; () for none.
            outputs: names of the channels that answer.
            dt: time step [s]; None where a column called time gives it.
            input_hold: what the inputs did between samples.

        Raises:
            InvalidDataError: no such channel, no time step, or columns that are no numbers.

        Example:
            >>> import pyarrow as pa
            >>> frame = pa.table({"time": [0.0, 0.1, 0.2], "force [kN]": [1.0, 0.0, 0.0], "tip": [0.0, 1.0, 0.5]})
            >>> record = Record.from_frame(frame, inputs="force", outputs="tip")
            >>> record.dt, float(record.inputs[0, 0]), record.input_units
            (0.1, 1000.0, ('N',))
        """
        from okid.readers.parquet import table_of_frame
        from okid.readers.table import to_record

        return to_record(table_of_frame(frame), cls, inputs=inputs, outputs=outputs, dt=dt, input_hold=input_hold)

    def to_table(self) -> "pa.Table":
        """Time [s] and every channel as columns of an Arrow table, units in the metadata of each field.

        For pandas and polars: `record.to_table().to_pandas()`, `polars.from_arrow(record.to_table())`.
        """
        import pyarrow as pa

        names = ("time", *self.input_names, *self.output_names)
        units = ("s", *self.input_units, *self.output_units)
        roles = ("", *("input" for _ in self.input_names), *("output" for _ in self.output_names))
        columns = [self.time, *self.inputs.T, *self.outputs.T]
        fields = [
            pa.field(name, pa.float64(), metadata={"unit": unit, "role": role})
            for name, unit, role in zip(names, units, roles, strict=True)
        ]
        return pa.table([pa.array(column) for column in columns], schema=pa.schema(fields))

    def complete_rows(self) -> BoolArray:
        """(n_samples,) True where no channel is missing; made in chunks, so a mapped file stays on disk."""
        complete = np.empty(self.n_samples, dtype=np.bool_)
        for rows in row_chunks(self.n_samples, self.n_inputs + self.n_outputs):
            inputs, outputs = self.inputs[rows], self.outputs[rows]
            complete[rows] = True
            if np.isnan(inputs.sum() + outputs.sum()):  # one NaN anywhere makes it NaN
                complete[rows] = ~(np.isnan(inputs).any(axis=1) | np.isnan(outputs).any(axis=1))
        return complete

    def samples(self, start: int = 0, stop: int | None = None) -> "Record":
        """Samples `start` to `stop` (exclusive), as Python slices count.

        Raises:
            InsufficientDataError: nothing would be left, or fewer samples than channels.
            InvalidDataError: something else than whole numbers.
        """
        if not all(end is None or isinstance(end, int | np.integer) for end in (start, stop)):
            raise InvalidDataError(
                f"samples must be whole numbers, but are {start!r} to {stop!r}; take `seconds` for times."
            )
        first, last, _ = slice(start, stop).indices(self.n_samples)
        if last <= first:
            raise InsufficientDataError(
                f"samples {start} to {'the end' if stop is None else stop} of a record of {self.n_samples} samples are "
                "none; choose a range inside it."
            )
        n_channels = max(self.n_inputs, self.n_outputs)
        if last - first < n_channels:
            raise InsufficientDataError(
                f"samples {first} to {last} are {last - first} rows, fewer than the {n_channels} channels; take a "
                "longer part."
            )
        return replace(
            self,
            inputs=self.inputs[first:last],
            outputs=self.outputs[first:last],
            start_time=self.start_time + first * self.dt,
        )

    def seconds(self, start: float | None = None, stop: float | None = None) -> "Record":
        """Samples whose time lies in start <= time < stop [s]; None leaves an end open."""
        return self.samples(self._first_at(start, 0), self._first_at(stop, self.n_samples))

    def _first_at(self, time: float | None, otherwise: int) -> int:
        """Index of the first sample at or after a time [s], within the record."""
        if time is None:
            return otherwise
        if np.isnan(real_number(time)):
            raise InvalidDataError(f"a time must be a number of seconds or None, but is {time!r}.")
        index = np.ceil((time - self.start_time) / self.dt - ROUNDED)
        return int(np.clip(index, 0, self.n_samples))

    def split(self, *shares: float) -> tuple["Record", ...]:
        """Consecutive parts in the given shares; what the shares leave up to 1 is one more part.

        Example:
            >>> record = Record([], [[0.0]] * 8, 1.0)
            >>> [part.n_samples for part in record.split(0.5, 0.25)]
            [4, 2, 2]

        Raises:
            InvalidDataError: a share that is not positive, or shares of more than 1 together.
        """
        numbers = [real_number(share) for share in shares]
        if not numbers or not all(number > 0 for number in numbers) or sum(numbers) > 1 + 1e-12:
            raise InvalidDataError(f"shares must be positive and at most 1 together, but are {shares}.")
        edges = np.round(np.cumsum([0.0, *shares]) * self.n_samples).astype(int).tolist()
        if edges[-1] < self.n_samples:
            edges.append(self.n_samples)
        return tuple(self.samples(first, last) for first, last in pairwise(edges))

    def select(
        self, *, inputs: Sequence[str | int] | None = None, outputs: Sequence[str | int] | None = None
    ) -> "Record":
        """The record with these channels in this order.

        Args:
            inputs: names or indices of the inputs to keep; None keeps all, an empty sequence none.
            outputs: names or indices of the outputs to keep; None keeps all.

        Raises:
            InvalidDataError: no such channel; the message lists those there are.
        """
        into = channel_indices(inputs, self.input_names, "input")
        out = channel_indices(outputs, self.output_names, "output")
        return replace(
            self,
            inputs=column_block(self.inputs, into),
            outputs=column_block(self.outputs, out),
            input_names=tuple(self.input_names[i] for i in into),
            output_names=tuple(self.output_names[i] for i in out),
            input_units=tuple(self.input_units[i] for i in into),
            output_units=tuple(self.output_units[i] for i in out),
        )

    def detrended(self, degree: int = 0) -> "Record":
        """Every channel less its least-squares polynomial (degree 0: its mean), fitted to the samples that are there.

        Raises:
            InvalidDataError: a degree below 0.
        """
        degree = whole_number(degree, name="the degree of a trend", least=0)
        return replace(self, inputs=detrended(self.inputs, degree), outputs=detrended(self.outputs, degree))

    def decimated(self, factor: int) -> "Record":
        """Every `factor`-th sample after an anti-alias filter, the same for inputs and outputs.

        The filter is a symmetric (zero-phase) FIR low-pass, so it cancels in the relation of output to input; samples
        nearer to an end or to a missing sample than half its length (ten new samples) are left out or marked missing,
        so the relation stays exact. Up to half the new Nyquist frequency the filter's gain is 1 within 0.03 %; what
        lies above that frequency comes down by more than 70 dB. A filtered input is no longer held between samples: the
        result's hold is "band_limited".

        Raises:
            InvalidDataError: a factor below 1.
            InsufficientDataError: the record is shorter than the filter.
        """
        factor = whole_number(factor, name="a decimation factor", least=1)
        if factor == 1:
            return self
        half = filter_half_length(factor)
        needed = 2 * half + factor * max(self.n_inputs, self.n_outputs)
        if self.n_samples <= needed:
            raise InsufficientDataError(
                f"decimating by {factor} needs more than {needed} samples for its filter and channels; the record has "
                f"{self.n_samples}. Use a smaller factor or a longer record."
            )
        return replace(
            self,
            inputs=decimated(self.inputs, factor),
            outputs=decimated(self.outputs, factor),
            dt=self.dt * factor,
            start_time=self.start_time + half * self.dt,
            input_hold="band_limited",
        )
