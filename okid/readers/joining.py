"""Several files: records of one system, or the channels of one record.

Files whose chosen channels have the same names are several records, matched by name. Files whose chosen channels are
all different, on the same time grid, are joined to one record (analysers write one file a channel). Anything between
the two is an error: no rule could say what was meant.

From a table to a record: channels chosen, units converted to SI, time step checked.

Which columns of a table are inputs and which are outputs.
"""

import difflib
from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NoReturn

import numpy as np

from okid.arrays import FloatArray, column_block
from okid.errors import InvalidDataError
from okid.readers.table import Column, Table, stated_step, table_time_step
from okid.readers.units import UnitConversion, convert_unit
from okid.record import InputHold, Record

__all__ = ["as_names", "choose_channels", "chosen_names", "records_of_tables", "to_record"]

Names = Sequence[str] | str | None


def as_names(names: Names) -> list[str] | None:
    """A list of names; a single name is a list of one, None stays None."""
    return [names] if isinstance(names, str) else None if names is None else list(names)


def chosen_names(table: Table, inputs: Names, outputs: Names) -> tuple[list[str], list[str]]:
    """Names of the inputs and outputs, as `choose_channels` decides, not yet looked up."""
    into, out = as_names(inputs), as_names(outputs)
    if into is None and out is None and table.outputs is not None:
        return list(table.inputs or ()), list(table.outputs)
    into = into or []
    if out is None:
        taken = {index for name in into if (index := _find(table, name)) is not None}
        out = [table.columns[index].name for index in table.channels() if index not in taken]
    return into, out


def choose_channels(table: Table, inputs: Names, outputs: Names) -> tuple[list[int], list[int]]:
    """Column indices of the inputs and of the outputs, in the order of the names.

    Inputs and outputs given: these. Inputs alone: every other channel is an output. Outputs alone: no inputs. Neither:
    what the file itself states, else every channel is an output. The time column and a sample counter are no channels.

    Raises:
        InvalidDataError: no such channel, one that is both input and output or named twice, or no output left.
    """
    into, out = chosen_names(table, inputs, outputs)
    _check_once(into, out)
    indices = _indices(table, into), _indices(table, out)
    if not table.channels():
        left = [f"{left.name!r} was left out: {left.reason}" for left in table.left_out[:3]]
        why = left or ["save each channel as a column of numbers beside the time"]
        raise InvalidDataError(
            f"{table.path.name} holds {', '.join(table.names[:3])} but no channel; {'; '.join(why)}."
        )
    if not indices[1]:
        raise InvalidDataError(
            f"no output is left in {table.path.name}: its channels are {_listed(table)}, and all of them are inputs; "
            "name at least one output."
        )
    return indices


def _check_once(into: list[str], out: list[str]) -> None:
    both = sorted(set(into) & set(out))
    if both:
        raise InvalidDataError(f"{', '.join(map(repr, both))} cannot be both input and output; name each channel once.")
    double = sorted(name for name, count in Counter(into + out).items() if count > 1)
    if double:
        raise InvalidDataError(f"channel {', '.join(map(repr, double))} is named more than once; name each once.")


def _find(table: Table, name: str) -> int | None:
    """A column by its name, or by its whole header."""
    for index, column in enumerate(table.columns):
        if name in {column.name, column.header}:
            return index
    return None


def _indices(table: Table, names: Sequence[str]) -> list[int]:
    places = {column.header: index for index, column in enumerate(table.columns)}
    places |= {column.name: index for index, column in enumerate(table.columns)}
    channels = set(table.channels())
    for name in names:
        if places.get(name) not in channels:
            _refuse(table, name, places.get(name))
    return [places[name] for name in names]


def _refuse(table: Table, name: str, index: int | None) -> NoReturn:
    if index is not None:
        what = "the time axis" if index == table.time_column() else "a counter of the samples"
        raise InvalidDataError(
            f"column {name!r} of {table.path.name} is {what}, not a channel; the channels are {_listed(table)}."
        )
    for left in table.left_out:
        if left.name == name:
            raise InvalidDataError(f"{name!r} of {table.path.name} cannot be a channel: {left.reason}.")
    names = [table.columns[each].name for each in table.channels()]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    folded = [each for each in names if each.lower() == name.lower()]
    guess = f"did you mean {(folded or close)[0]!r}? Its" if folded or close else "its"
    raise InvalidDataError(f"there is no channel {name!r} in {table.path.name}; {guess} channels are {_listed(table)}.")


def _listed(table: Table) -> str:
    names = [table.columns[index].name for index in table.channels()]
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return (", ".join(names[:20]) + more) or "none"


def to_record(
    table: Table,
    *,
    inputs: Sequence[str] | str | None,
    outputs: Sequence[str] | str | None,
    dt: float | None,
    input_hold: InputHold,
) -> Record:
    """The record that the chosen channels of a table make up, in SI.

    Raises:
        InvalidDataError: as `choose_channels`, `table_time_step` and `Record` say, with the file's name before it.
    """
    into, out = choose_channels(table, inputs, outputs)
    _check_orientation(table, into, out)
    step, start_time = table_time_step(table, dt)
    input_units = [_conversion(table, index) for index in into]
    output_units = [_conversion(table, index) for index in out]
    try:
        return Record(
            _in_si(column_block(table.values, into), input_units),
            _in_si(column_block(table.values, out), output_units),
            step,
            input_names=tuple(unit.channel for unit in input_units),
            output_names=tuple(unit.channel for unit in output_units),
            input_units=tuple(unit.unit for unit in input_units),
            output_units=tuple(unit.unit for unit in output_units),
            input_hold=input_hold,
            name=table.path.stem,
            start_time=start_time,
        )
    except InvalidDataError as error:
        raise type(error)(f"{table.path.name}: {error}") from error


def _check_orientation(table: Table, into: Sequence[int], out: Sequence[int]) -> None:
    """Refuse more channels than samples here, where the remedy is to save the file otherwise."""
    for kind, indices in (("inputs", into), ("outputs", out)):
        if len(indices) > table.n_samples:
            raise InvalidDataError(
                f"{table.path.name} holds {len(indices)} {kind} but only {table.n_samples} samples; rows must be "
                f"samples and columns channels, so save its transpose, or name fewer {kind}."
            )


def _conversion(table: Table, index: int) -> UnitConversion:
    column = table.columns[index]
    return convert_unit(column.name, column.unit)


def _in_si(values: FloatArray, conversions: Sequence[UnitConversion]) -> FloatArray:
    """The values in SI; the array itself where nothing has to be converted, so that a mapped file stays mapped."""
    if not any(conversion.changed for conversion in conversions):
        return values
    converted = np.multiply(values, [conversion.factor for conversion in conversions])
    converted += [conversion.offset for conversion in conversions]
    converted.flags.writeable = False  # fresh and held by nobody else: the record need not copy it
    return converted


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

    Raises:
        InvalidDataError: some channels shared and some not, different time grids, or different units of one channel.
    """
    held = [_held(table, inputs, outputs) for table in tables]
    for table, names in zip(tables, held, strict=True):
        if not names:  # none of the chosen channels: say which ones are missing, and what the file has
            choose_channels(table, inputs, outputs)
    if len(tables) > 1 and all(one.isdisjoint(other) for one, other in combinations(held, 2)):
        joined = _joined(tables, held)
        return (to_record(joined, inputs=inputs, outputs=outputs, dt=dt, input_hold=input_hold),)
    if any(names != held[0] for names in held):
        raise InvalidDataError(_in_between(tables, held))
    into, out = chosen_names(tables[0], inputs, outputs)
    records = tuple(to_record(table, inputs=into, outputs=out, dt=dt, input_hold=input_hold) for table in tables)
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


def _in_between(tables: Sequence[Table], held: Sequence[frozenset[str]]) -> str:
    shared = frozenset.intersection(*held)
    parts = []
    for table, names in zip(tables, held, strict=True):
        if own := sorted(names - shared):
            more = f" and {len(own) - 6} more" if len(own) > 6 else ""
            parts.append(f"{', '.join(own[:6])}{more} ({table.path.name})")
    return (
        "files must hold either the same channels (several records) or all different ones (parts of one record), but "
        f"these share {', '.join(sorted(shared)[:6]) or 'some in pairs'} and do not share {'; '.join(parts[:4])}; name "
        "the channels that all of them hold as inputs and outputs."
    )


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
