"""Parquet: one column a channel, the unit in the column's metadata or in its name."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers.arrays import table_of_channels
from okid.readers.guard import Damage, check_channel_count, check_memory, first_line, foreign
from okid.readers.table import Column, LeftOut, Table, unique_names
from okid.readers.units import split_header

UNITS_OF_STAMPS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds in the units of Arrow's stamps."""

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
        fields = list(file.schema_arrow)
        table = file.read(columns=[field.name for field in fields if is_numbers(field.type)])
    others = [field for field in fields if not is_numbers(field.type)]
    with foreign(path, "Parquet file"):
        _check_others(path, others)
    left_out = [_no_numbers(field) for field in others]
    return table_of_arrow(table, path=path, file_format="Parquet", left_out=left_out)


def _check_others(path: Path, fields: Sequence[Any]) -> None:
    """Raise where a column that is left out is damaged, for a file is whole or not.

    One after the other, and texts stay in their dictionary: they may unpack to thousands of times their size.
    """
    import pyarrow as pa
    from pyarrow import parquet

    kinds = (pa.types.is_string, pa.types.is_large_string, pa.types.is_binary, pa.types.is_large_binary)
    texts = [field.name for field in fields if any(is_one(field.type) for is_one in kinds)]
    with parquet.ParquetFile(path, page_checksum_verification=True, read_dictionary=texts) as file:
        for field in fields:
            column = file.read(columns=[field.name])
            column.validate(full=True)
            if any(len(values) != file.metadata.num_rows for values in column.itercolumns()):
                raise Damage(f"column {field.name} has not {file.metadata.num_rows} rows")


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


def table_of_arrow(table: Any, *, path: Path, file_format: str, left_out: Sequence[LeftOut] = ()) -> Table:
    """The columns of numbers of an Arrow table.

    Raises:
        UnreadableFileError: no column of numbers.
    """
    headers, units, series, origins, without = [], [], [], [], list(left_out)
    for field, column in zip(table.schema, table.itercolumns(), strict=True):
        if not is_numbers(field.type):
            without.append(_no_numbers(field))
            continue
        with foreign(path, "Parquet file"):
            header = _header(field, table.schema)
            values, unit = _numbers(column, field)
        if not header:
            without.append(LeftOut(name=field.name, reason="it is the index of the frame, which has no name"))
            continue
        headers.append(header)
        origins.append(_origin(column))
        units.append(unit)
        series.append(values)
    if not series:
        raise UnreadableFileError(f"{path.name} holds no column of numbers; a record has one column a channel.")
    split = [split_header(header) for header in headers]
    names = unique_names([name for name, _ in split], headers)
    columns = tuple(
        Column(name=name, unit=unit or written, header=header, origin=origin)
        for name, unit, (_, written), header, origin in zip(names, units, split, headers, origins, strict=True)
    )
    return Table(
        path=path, format=file_format, columns=columns, values=np.column_stack(series), left_out=tuple(without)
    )


def is_numbers(kind: Any) -> bool:
    """Whether a type of Arrow is one of numbers or of times."""
    import pyarrow as pa

    return any(
        is_one(kind)
        for is_one in (
            pa.types.is_timestamp,
            pa.types.is_duration,
            pa.types.is_integer,
            pa.types.is_floating,
            pa.types.is_boolean,
            pa.types.is_decimal,
        )
    )


def _no_numbers(field: Any) -> LeftOut:
    return LeftOut(name=field.name, reason=f"it holds {field.type}, not numbers")


def _header(field: Any, schema: Any) -> str:
    """The name of a column; "time" where it is the times that pandas counts its rows by, "" where it counts only."""
    import pyarrow as pa

    index = (schema.pandas_metadata or {}).get("index_columns", ())
    if field.name not in index or not re.fullmatch(r"__index_level_\d+__", field.name):
        return str(field.name)
    return "time" if pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type) else ""


def _origin(column: Any) -> float:
    """The first stamp [s since 1970], which `_numbers` counts from; 0 for other numbers."""
    import pyarrow as pa

    if not pa.types.is_timestamp(column.type) or column.null_count == len(column):
        return 0.0
    return float(column.drop_null()[0].value) * UNITS_OF_STAMPS[column.type.unit]


def _numbers(column: Any, field: Any) -> tuple[Any, str]:
    """The column as float64 with its unit."""
    import pyarrow as pa
    import pyarrow.compute

    metadata = field.metadata or {}
    unit = next((metadata[key].decode("utf-8", "replace") for key in UNIT_KEYS if key in metadata), "")
    kind = field.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        column, unit = column.cast(pa.int64()), kind.unit
        known = column.drop_null()
        if pa.types.is_timestamp(kind) and len(known):
            # as integers: nanoseconds since 1970 have more digits than a float64
            column = pa.compute.subtract(column, known[0])
    safe = not pa.types.is_integer(column.type)  # the nearest number: a counter may have more digits
    return column.cast(pa.float64(), safe=safe).to_numpy(), unit
