"""Several files: records of one system, or the channels of one record.

Files whose chosen channels have the same names are several records, matched by name. Files whose chosen channels are
all different, on the same time grid, are joined to one record (analysers write one file a channel). Files that share
some channels are set-ups of one system: records on the union of the channels.
"""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from okid.arrays import column_block
from okid.errors import InvalidDataError
from okid.readers.table import Column, Table, as_names, choose_channels, chosen_names, stated_step, to_record
from okid.record import InputHold, Record
from okid.rows import join_setups

GRID_TOLERANCE = 0.1
"""How far two files' time grids may drift apart, in time steps."""


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
        InvalidDataError: different time grids, or different units of one channel.
    """
    held = [_held(table, inputs, outputs) for table in tables]
    for table, names in zip(tables, held, strict=True):
        if not names:  # none of the chosen channels: say which ones are missing, and what the file has
            choose_channels(table, inputs, outputs)
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


def _joined(tables: Sequence[Table], held: Sequence[frozenset[str]]) -> Table:
    steps = [stated_step(table) for table in tables]
    first, (step, start_time) = tables[0], steps[0]
    for table, (other_step, other_start) in zip(tables[1:], steps[1:], strict=True):
        drift = 0.0
        if step is not None and other_step is not None:
            drift = abs(other_start - start_time) + abs(other_step - step) * first.n_samples
        if (
            table.n_samples != first.n_samples
            or (step is None) != (other_step is None)
            or (step is not None and drift > GRID_TOLERANCE * step)
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
        start_time=start_time,
        inputs=tuple(name for table in tables for name in table.inputs or ()) if len(stated) == len(tables) else None,
        outputs=tuple(name for table in stated for name in table.outputs or ()) if len(stated) == len(tables) else None,
        left_out=tuple(left for table in tables for left in table.left_out),
    )


def _grid(table: Table, step: float | None, start_time: float) -> str:
    return f"{table.n_samples} samples" + ("" if step is None else f" of {step:.6g} s from {start_time:.6g} s")


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
