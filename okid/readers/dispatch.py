"""From paths to tables, by file type, and from tables to records; what a file holds, in words.

Files whose chosen channels have the same names are several records, matched by name. Files whose chosen channels are
all different, on the same time grid, are joined to one record (analysers write one file a channel). Files that share
some channels are set-ups of one system: records on the union of the channels.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from itertools import combinations
from pathlib import Path

import numpy as np

from okid.arrays import column_block
from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers.arrays import read_npy, read_npz, table_from_arrays, table_of_channels
from okid.readers.clock import YEAR_2000
from okid.readers.guard import check_file, foreign
from okid.readers.mat import read_mat
from okid.readers.parquet import read_parquet
from okid.readers.table import (
    Column,
    LeftOut,
    Table,
    as_names,
    choose_channels,
    chosen_names,
    conversion_of,
    spread_names,
    spread_roles,
    stated_step,
    to_record,
)
from okid.readers.tdms import read_lvm, read_mdf, read_tdms, read_wav
from okid.readers.text import read_text
from okid.readers.uff import read_uff
from okid.readers.units import UnitConversion
from okid.record import InputHold, Record
from okid.rows import join_setups

READERS: Mapping[str, Callable[[Path], Table]] = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".asc"), read_text),
    ".npy": read_npy,
    ".npz": read_npz,
    ".mat": read_mat,
    **dict.fromkeys((".uff", ".unv", ".ufb"), read_uff),
    **dict.fromkeys((".parquet", ".pq"), read_parquet),
    ".tdms": read_tdms,
    ".lvm": read_lvm,
    ".wav": read_wav,
    **dict.fromkeys((".mf4", ".mdf"), read_mdf),
}
"""One function a file type."""

WORTH_SAYING = 1e-5
"""Say how well rounded times tell the time step from this share of it on: a tenth of what is warned of."""

A_FURTHER_TIME = "it gives the time of the record once more"
OTHERS = "okid.readers"
"""Group of entry points under which other packages offer readers, each named by its ending without the dot."""


def _reader_of_others(suffix: str) -> Callable[[Path], Table] | None:
    """A reader that another package offers: from a path to arrays by name, or to time series of SEP 005."""
    found = list(entry_points(group=OTHERS, name=suffix.lstrip("."))) if suffix else []
    if not found:
        return None

    def read(path: Path) -> Table:
        with foreign(path, f"{suffix} file, as {found[0].value} reads it,"):
            contents = found[0].load()(path)
            if not isinstance(contents, list):
                contents = dict(contents)
        if isinstance(contents, list):
            return table_of_channels(contents, path=path)
        return table_from_arrays(contents, path=path, file_format=suffix.lstrip(".").upper())

    return read


def read_table(path: str | Path) -> Table:
    """The table in a file.

    Raises:
        UnreadableFileError: no such file, an unknown type, or damage; the message says which and what to do.
    """
    path = check_file(path)
    reader = READERS.get(path.suffix.lower()) or _reader_of_others(path.suffix.lower())
    if reader is None:
        raise UnreadableFileError(
            f"{path.name} is of type {path.suffix or 'none'}, which is not read; the types read are "
            f"{', '.join(READERS)}, and what packages offer as entry points of {OTHERS!r}."
        )
    try:
        with np.errstate(all="ignore"):  # what is not finite is looked at afterwards
            table = reader(path)
    except OSError as error:
        raise UnreadableFileError(f"{path} cannot be read ({error.strerror or error}); check the file.") from error
    double = [name for name, count in Counter(table.names).items() if count > 1]
    if double:
        raise UnreadableFileError(
            f"{path.name} has more than one column called {', '.join(map(repr, double[:5]))}; give each its own name."
        )
    if not table.columns:
        raise UnreadableFileError(
            f"{path.name} holds {table.n_samples} samples of no channel; save at least one column."
        )
    if table.n_samples == 0:
        raise UnreadableFileError(f"{path.name} has columns ({', '.join(table.names[:8])}) but no samples.")
    return table


@dataclass(frozen=True, slots=True, kw_only=True)
class FileDescription:
    """What a file holds.

    Args:
        path: the file.
        format: what it is, in words.
        n_samples: number of rows.
        dt: time step [s], None if the file gives none.
        channels: one a channel: name, unit as written, unit in the record, and what turns one into the other.
        inputs: names of the inputs, if the file itself tells them apart, else None.
        outputs: likewise.
        left_out: what else is in the file, and why it is no channel.
        dt_within: how far the time step may be off, because the file's times are rounded [s].
        doubts: where the file contradicts itself in a unit, and which one was taken; why its inputs are not used.
    """

    path: Path
    format: str
    n_samples: int
    dt: float | None
    channels: tuple[UnitConversion, ...]
    inputs: tuple[str, ...] | None
    outputs: tuple[str, ...] | None
    left_out: tuple[LeftOut, ...]
    dt_within: float = 0.0
    doubts: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """One sentence for each way in which units were converted or kept; channels treated alike share one."""
        remarks = [*self.doubts, *remarks_on([each for each in self.channels if each.changed or each.note])]
        if self.dt and self.dt_within > WORTH_SAYING * self.dt:
            remarks.append(f"its times are rounded, so dt is known to {100.0 * self.dt_within / self.dt:.2g} %")
        return (*remarks, *(f"{left.name} left out: {left.reason}" for left in self.left_out))

    def __str__(self) -> str:
        step = "no time step" if self.dt is None else f"dt {self.dt:.6g} s"
        channels = "1 channel" if len(self.channels) == 1 else f"{len(self.channels)} channels"
        head = f"{self.path.name}: {self.format}, {channels}, {self.n_samples} samples, {step}"
        return "; ".join((head, *self.remarks))


def describe_file(path: str | Path) -> FileDescription:
    """What a file holds and what `read_record` makes of its units.

    Raises:
        UnreadableFileError: the file cannot be read.
        InvalidDataError: its time column is no uniform grid.
    """
    return describe_table(read_table(path))


def describe_table(
    table: Table,
    *,
    dt: float | None = None,
    inputs: Sequence[str] | str | None = None,
    outputs: Sequence[str] | str | None = None,
) -> FileDescription:
    """The description of a table that has been read already, and of what became of its inputs with these names.

    Raises:
        InvalidDataError: its time column is no uniform grid, and no time step is given.
    """
    step, _, within = stated_step(table) if dt is None else (dt, 0.0, 0.0)
    times = [table.names[index] for index in table.further_times()]
    return FileDescription(
        path=table.path,
        format=table.format,
        n_samples=table.n_samples,
        dt=step,
        dt_within=within,
        doubts=(*table.doubts, *_of_inputs(table, inputs, outputs)),
        channels=tuple(conversion_of(table, index) for index in table.channels()),
        inputs=table.inputs,
        outputs=table.outputs,
        left_out=(*table.left_out, *(LeftOut(name=name, reason=A_FURTHER_TIME) for name in times)),
    )


def _of_inputs(
    table: Table, inputs: Sequence[str] | str | None, outputs: Sequence[str] | str | None
) -> tuple[str, ...]:
    """Why the file's word on its inputs is not taken where no inputs are named."""
    if inputs is not None:
        return ()
    if outputs is None:
        return (table.undecided,) if table.undecided else ()
    named = spread_names([table], outputs) or ()
    dropped = [name for name in table.inputs or () if name not in named]
    if not dropped:
        return ()
    return (f"it states {', '.join(dropped)} as inputs, and only outputs were named: name the inputs too to use them",)


def remarks_on(conversions: Sequence[UnitConversion]) -> list[str]:
    """One sentence for the channels that were treated alike."""
    groups: dict[tuple[str, str, str, float, float], list[UnitConversion]] = {}
    for conversion in conversions:
        key = (conversion.written, conversion.unit, conversion.note, conversion.factor, conversion.offset)
        groups.setdefault(key, []).append(conversion)
    return [_shared(group) for group in groups.values()]


def _shared(group: list[UnitConversion]) -> str:
    names = ", ".join(conversion.channel for conversion in group[:4])
    more = f" and {len(group) - 4} more" if len(group) > 4 else ""
    _, _, rest = str(group[0]).partition(f"{group[0].channel}: ")
    return f"{names}{more}: {rest}"


def records_of_tables(
    tables: Sequence[Table],
    *,
    inputs: Sequence[str] | str | None,
    outputs: Sequence[str] | str | None,
    dt: float | None,
    input_hold: InputHold,
) -> tuple[Record, ...]:
    """One record for each table if they hold the same channels, one in all if their channels are all different.

    Where they share some, each is a set-up: all records then have all channels (`okid.join_setups`).

    Raises:
        InvalidDataError: different time grids, different units of one channel, or one sensor under two names.
    """
    inputs, outputs = spread_roles(tables, inputs, outputs)
    held = [_held(table, inputs, outputs) for table in tables]
    for table, names in zip(tables, held, strict=True):
        if not names:  # none of the chosen channels: say which ones are missing, and what the file has
            choose_channels(table, inputs, outputs)
    _check_one_name_a_sensor(tables, held)
    if len(tables) > 1 and all(one.isdisjoint(other) for one, other in combinations(held, 2)):
        joined = _joined(tables, held)
        return (to_record(joined, Record, inputs=inputs, outputs=outputs, dt=dt, input_hold=input_hold),)
    if any(names != held[0] for names in held):
        return join_setups(_setups(tables, held, inputs, outputs, dt=dt, input_hold=input_hold))
    into, out = chosen_names(tables[0], inputs, outputs)
    records = tuple(
        to_record(table, Record, inputs=into, outputs=out, dt=dt, input_hold=input_hold) for table in tables
    )
    _check_alike(records)
    return records


def _held(table: Table, inputs: Sequence[str] | str | None, outputs: Sequence[str] | str | None) -> frozenset[str]:
    """The chosen channels that this file holds; one that no file holds is found missing when it is looked up."""
    into, out = as_names(inputs), as_names(outputs)
    names = {table.columns[index].name for index in table.channels()}
    if out is not None:
        return frozenset(names.intersection([*(into or []), *out]))
    if into is None and table.outputs is not None:
        return frozenset([*(table.inputs or ()), *table.outputs])
    return frozenset(names)


def _check_one_name_a_sensor(tables: Sequence[Table], held: Sequence[frozenset[str]]) -> None:
    """Raise where files call one sensor differently: their runs would pass for different channels of one record."""
    called: dict[str, tuple[set[str], Path]] = {}
    for table, names in zip(tables, held, strict=True):
        own: dict[str, set[str]] = {}
        for column in table.columns:
            if column.measured and column.name in names:
                own.setdefault(column.measured, set()).add(column.name)
        for measured, here in own.items():
            there, path = called.setdefault(measured, (here, table.path))
            if here != there:
                raise InvalidDataError(
                    f"{path.name} and {table.path.name} both hold {measured}, under the names "
                    f"{', '.join(map(repr, sorted(there)))} and {', '.join(map(repr, sorted(here)))}, so they are two "
                    "runs whose channels do not match; export the same quantities to every file."
                )


def _joined(tables: Sequence[Table], held: Sequence[frozenset[str]]) -> Table:
    steps = [stated_step(table) for table in tables]
    first, (step, start_time, within) = tables[0], steps[0]
    for table, (other_step, other_start, _) in zip(tables[1:], steps[1:], strict=True):
        drift = 0.0
        if step is not None and other_step is not None:
            if (start_time < YEAR_2000) != (other_start < YEAR_2000):
                dated, other = (table, first) if start_time < YEAR_2000 else (first, table)
                raise InvalidDataError(
                    f"{dated.path.name} gives the date of its samples and {other.path.name} gives none, so whether "
                    "they are parts of one record cannot be told; export both with the date, or both without."
                )
            drift = abs(other_start - start_time) + abs(other_step - step) * first.n_samples
        if (
            table.n_samples != first.n_samples
            or (step is None) != (other_step is None)
            or (step is not None and drift > 0.1 * step)
        ):
            raise InvalidDataError(
                f"{first.path.name} and {table.path.name} hold different channels, so they are parts of one record, "
                f"but not on one time grid: {_grid(first, step, start_time)} and "
                f"{_grid(table, other_step, other_start)}; export them over the same span at the same rate."
            )
    columns: list[Column] = []
    blocks = []
    for table, names in zip(tables, held, strict=True):
        indices = [index for index in table.channels() if table.columns[index].name in names]
        columns += [table.columns[index] for index in indices]
        blocks.append(column_block(table.values, indices))
    stems = "+".join(table.path.stem for table in tables)
    stated = [table for table in tables if table.outputs is not None]
    return Table(
        path=Path(stems + first.path.suffix),
        format=first.format,
        columns=tuple(columns),
        values=np.column_stack(blocks),
        dt=step,
        dt_within=within,
        start_time=start_time,
        inputs=tuple(name for table in tables for name in table.inputs or ()) if stated else None,
        outputs=tuple(name for table in tables for name in _stated_outputs(table)) if stated else None,
        left_out=tuple(left for table in tables for left in table.left_out),
        doubts=tuple(doubt for table in tables for doubt in table.doubts),
    )


def _stated_outputs(table: Table) -> tuple[str, ...]:
    """What a file states as outputs; of one that states nothing, every channel."""
    return tuple(table.names[index] for index in table.channels()) if table.outputs is None else table.outputs


def _grid(table: Table, step: float | None, start_time: float) -> str:
    return f"{table.n_samples} samples" + ("" if step is None else f" of {step:.6g} s from {start_time:.12g} s")


def _setups(
    tables: Sequence[Table],
    held: Sequence[frozenset[str]],
    inputs: Sequence[str] | str | None,
    outputs: Sequence[str] | str | None,
    *,
    dt: float | None,
    input_hold: InputHold,
) -> tuple[Record, ...]:
    """A record a table, each with the chosen channels that it holds."""
    known = frozenset.union(*held)
    for name in (*(as_names(inputs) or ()), *(as_names(outputs) or ())):
        if name not in known:  # held by none: a misspelt name is not an absent channel
            choose_channels(tables[0], [name], None)
    records = []
    for table, names in zip(tables, held, strict=True):
        into, out = chosen_names(table, _among(inputs, names), _among(outputs, names))
        records.append(to_record(table, Record, inputs=into, outputs=out, dt=dt, input_hold=input_hold))
    return tuple(records)


def _among(names: Sequence[str] | str | None, held: frozenset[str]) -> list[str] | None:
    listed = as_names(names)
    return None if listed is None else [name for name in listed if name in held]


def _check_alike(records: Sequence[Record]) -> None:
    first = records[0]
    for record in records[1:]:
        names = first.input_names + first.output_names
        units = zip(
            names, first.input_units + first.output_units, record.input_units + record.output_units, strict=True
        )
        for name, unit, other in units:
            if unit != other:
                raise InvalidDataError(
                    f"{name!r} is in {unit or 'no unit'} in {first.name} and {other or 'no unit'} in {record.name}; "
                    "records of one system need one unit a channel, so correct the header."
                )
        if abs(record.dt - first.dt) > 1e-3 * first.dt:
            raise InvalidDataError(
                f"{first.name} has a time step of {first.dt:.6g} s and {record.name} of {record.dt:.6g} s; records "
                "of one system need one time step, so resample, or identify them one by one."
            )
