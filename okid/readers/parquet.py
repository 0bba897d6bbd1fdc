"""Parquet: one column a channel, the unit in the column's metadata or in its name."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers.arrays import table_of_channels
from okid.readers.guard import check_channel_count, check_memory, first_line, foreign
from okid.readers.table import Column, LeftOut, Table, split_header, unique_names

__all__ = ["read_parquet", "table_of_frame"]

UNIT_KEYS = (b"unit", b"units", b"Unit", b"Units")


def read_parquet(path: Path) -> Table:
    """The columns of numbers of a Parquet file; a column of time stamps becomes seconds after the first.

    Raises:
        UnreadableFileError: damaged or cut off, or no column of numbers.
    """
    from pyarrow import parquet

    with foreign(path, "Parquet file"), parquet.ParquetFile(path, page_checksum_verification=True) as file:
        check_channel_count(path, file.metadata.num_columns)
        check_memory(path, 24.0 * file.metadata.num_rows * file.metadata.num_columns)
        table = file.read()
    return table_of_arrow(table, path=path, file_format="Parquet")


def table_of_frame(frame: Any) -> Table:
    """The columns of numbers of a data frame: pandas, polars, Arrow, or time series of SEP 005.

    Raises:
        InvalidDataError: no data frame, or one that does not give its columns away.
    """
    import pyarrow as pa

    if isinstance(frame, list) and frame and all(isinstance(one, Mapping) and "data" in one for one in frame):
        return table_of_channels(frame, path=Path("the list"))
    try:
        table = frame if isinstance(frame, pa.Table) else pa.table(frame)
    except (TypeError, ValueError, pa.ArrowException) as error:
        raise InvalidDataError(
            f"a {type(frame).__name__} is no data frame that can be read ({first_line(error)}); pass a frame of "
            "pandas, polars or Arrow, or arrays to Record."
        ) from error
    return table_of_arrow(table, path=Path("frame"), file_format="data frame")


def table_of_arrow(table: Any, *, path: Path, file_format: str) -> Table:
    """The columns of numbers of an Arrow table.

    Args:
        table: of pyarrow.
        path: where it comes from, for messages.
        file_format: in words.

    Raises:
        UnreadableFileError: no column of numbers.
    """
    headers, units, series, left_out = [], [], [], []
    for field, column in zip(table.schema, table.itercolumns(), strict=True):
        with foreign(path, "Parquet file"):
            values, unit = _numbers(column, field)
        if values is None:
            left_out.append(LeftOut(name=field.name, reason=f"it holds {field.type}, not numbers"))
            continue
        headers.append(field.name)
        units.append(unit)
        series.append(values)
    if not series:
        raise UnreadableFileError(f"{path.name} holds no column of numbers; a record has one column a channel.")
    split = [split_header(header) for header in headers]
    names = unique_names([name for name, _ in split], headers)
    columns = tuple(
        Column(name=name, unit=unit or written, header=header)
        for name, unit, (_, written), header in zip(names, units, split, headers, strict=True)
    )
    return Table(
        path=path, format=file_format, columns=columns, values=np.column_stack(series), left_out=tuple(left_out)
    )


def _numbers(column: Any, field: Any) -> tuple[Any, str]:
    """The column as float64 with its unit; None if it holds no numbers."""
    import pyarrow as pa

    metadata = field.metadata or {}
    unit = next((metadata[key].decode("utf-8", "replace") for key in UNIT_KEYS if key in metadata), "")
    kind = field.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        ticks = column.cast(pa.int64()).to_numpy()
        if pa.types.is_timestamp(kind) and len(ticks):
            ticks = ticks - ticks[0]  # as integers: nanoseconds since 1970 have more digits than a float64
        return ticks.astype(np.float64), kind.unit
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
        return column.cast(pa.float64()).to_numpy(), unit
    if pa.types.is_decimal(kind):
        return column.cast(pa.float64()).to_numpy(), unit
    return None, ""
