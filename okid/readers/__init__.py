"""Records from files: CSV and other text tables, NPY, NPZ, MAT, universal files, Parquet, TDMS, LVM, WAV.

`read_record` reads one file, `read_records` several, `describe_file` says what a file holds and what becomes of its
units, `read_described` does both in one reading. Nothing in a file is ever executed; sizes that do not fit into memory
are refused before they are read.
"""

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from okid.errors import IdentificationWarning, InvalidDataError
from okid.readers.arrays import TRANSPOSED
from okid.readers.dispatch import (
    FileDescription,
    describe_file,
    describe_table,
    read_table,
    records_of_tables,
    remarks_on,
)
from okid.readers.guard import check_file
from okid.readers.table import Table, conversion_of, to_record
from okid.readers.units import UnitConversion
from okid.record import InputHold, Record

__all__ = ["FileDescription", "UnitConversion", "describe_file", "read_described", "read_record", "read_records"]


def read_record(
    path: str | Path,
    *,
    inputs: Sequence[str] | str | None = None,
    outputs: Sequence[str] | str | None = None,
    dt: float | None = None,
    input_hold: InputHold = "band_limited",
) -> Record:
    """The record in a file, in SI units.

    Args:
        path: the file; its type is told by its extension: .csv .txt .tsv .dat .asc (text tables), .npy, .npz, .mat,
            .uff .unv .ufb (universal files, data set 58), .parquet .pq, .tdms.
        inputs: names of the channels that drive the system; the name of a matrix means all its columns, "force*" all
            channels that begin so.
        outputs: names of the channels that answer, as for inputs; a pattern leaves out what is an input by name. Inputs
            alone: every other channel is an output. Outputs alone: no inputs, whatever the file states. Neither: what
            the file itself states, else every channel is an output.
        dt: time step [s]. Needed where the file has no time axis; where it has one (a column called time or t), the
            step is the mean over the whole span, and a given dt may differ from it by 0.1 % at most.
        input_hold: what the inputs did between samples. What stands in a file was as a rule measured, through the same
            anti-alias filter as the outputs: "band_limited". Say "zero_order" if the file holds the command that a
            converter put out and held. Poles do not depend on it; the inputs' part in a mode and the first Markov
            parameters do.

    Returns:
        The record, named after the file. A large .npy stays on disk, in a copy of its own where a disk has room. A unit
        that is known is converted to SI; others are kept as they are, see `describe_file`.

    Raises:
        UnreadableFileError: no such file, an unknown type, damage, or text where a number is expected.
        InvalidDataError: no such channel, no time step, a time column off the uniform grid by more than 0.1 dt, or
            numbers that cannot be a record.

    Warns:
        IdentificationWarning: a channel may be in another unit than the record says; a matrix lies on its side; a file
            of several hits, whose forces are no inputs.
    """
    table = read_table(path)
    record = to_record(table, Record, inputs=inputs, outputs=outputs, dt=dt, input_hold=input_hold)
    _warn([table], [record], inputs, outputs)
    return record


def read_records(
    paths: Sequence[str | Path] | str | Path,
    *,
    inputs: Sequence[str] | str | None = None,
    outputs: Sequence[str] | str | None = None,
    dt: float | None = None,
    input_hold: InputHold = "band_limited",
) -> tuple[Record, ...]:
    """The records in one or several files.

    Files that hold the same chosen channels are several records of one system, matched by name: their columns may stand
    in any order. Files whose chosen channels are all different, on the same time grid, are joined to one record.

    Args:
        paths: the files, or one.
        inputs: as in `read_record`.
        outputs: as in `read_record`; with several files, inputs and outputs are those of the first where not named.
        dt: as in `read_record`.
        input_hold: as in `read_record`.

    Raises:
        UnreadableFileError: as in `read_record`.
        InvalidDataError: as in `read_record`; or files that share some channels and not others, or that do not fit
            together in time step or units.
    """
    tables = _tables(paths)
    records = records_of_tables(tables, inputs=inputs, outputs=outputs, dt=dt, input_hold=input_hold)
    _warn(tables, records, inputs, outputs)
    return records


def read_described(
    paths: Sequence[str | Path] | str | Path,
    *,
    inputs: Sequence[str] | str | None = None,
    outputs: Sequence[str] | str | None = None,
    dt: float | None = None,
    input_hold: InputHold = "band_limited",
) -> tuple[tuple[Record, ...], tuple[FileDescription, ...]]:
    """The records in one or several files, and what each file holds; every file is read once."""
    tables = _tables(paths)
    records = records_of_tables(tables, inputs=inputs, outputs=outputs, dt=dt, input_hold=input_hold)
    return records, tuple(describe_table(table, dt=dt, inputs=inputs, outputs=outputs) for table in tables)


def _warn(
    tables: Sequence[Table],
    records: Sequence[Record],
    inputs: Sequence[str] | str | None,
    outputs: Sequence[str] | str | None,
) -> None:
    """Warn of channels that may be in another unit than their record says, or no inputs, and of matrices on their side.

    Who names the channels misses none, and need not be told that the file does not say which are inputs.
    """
    used = {name for record in records for name in (*record.input_names, *record.output_names)}
    said: dict[str, None] = {}
    for table in tables:
        every = [conversion_of(table, index) for index in table.channels()]
        said |= dict.fromkeys(remarks_on([each for each in every if each.channel in used and each.doubtful]))
        left_out = table.left_out if outputs is None else ()
        undecided = [table.undecided] if table.undecided and inputs is None and outputs is None else []
        said |= dict.fromkeys(f"{table.path.name}: {doubt}" for doubt in (*table.doubts, *undecided))
        said |= {f"{left.name} was left out: {left.reason}": None for left in left_out if TRANSPOSED in left.reason}
    for sentence in said:
        warnings.warn(f"{sentence}.", IdentificationWarning, stacklevel=3)


def _tables(paths: Sequence[str | Path] | str | Path) -> list[Table]:
    given: Any = paths  # a caller may hand on anything
    several = [given] if isinstance(given, str | bytes | Path) or not isinstance(given, Iterable) else given
    listed = [Path(path) if isinstance(path, str | Path) else check_file(path) for path in several]
    if not listed:
        raise InvalidDataError("no file was given; name at least one.")
    files = [path.resolve() for path in listed]  # a link to a record is that record
    double = sorted({str(path) for path, file in zip(listed, files, strict=True) if files.count(file) > 1})
    if double:
        raise InvalidDataError(f"{', '.join(double)} is given more than once; a record counts once; leave it out.")
    return [read_table(path) for path in listed]
