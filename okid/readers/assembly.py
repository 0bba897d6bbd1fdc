"""From a table to a record: channels chosen, units converted to SI, time step checked."""

from collections.abc import Sequence

import numpy as np

from okid.arrays import FloatArray, column_block
from okid.errors import InvalidDataError
from okid.readers.channels import choose_channels
from okid.readers.table import Table
from okid.readers.time_axis import time_step
from okid.readers.units import UnitConversion, convert_unit
from okid.record import InputHold, Record

__all__ = ["to_record"]


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
        InvalidDataError: as `choose_channels`, `time_step` and `Record` say, with the file's name before it.
    """
    into, out = choose_channels(table, inputs, outputs)
    _check_orientation(table, into, out)
    step, start_time = time_step(table, dt)
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
