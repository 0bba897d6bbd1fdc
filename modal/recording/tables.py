"""Tables of numbers on a timeline that counts rows: modes, orders, outputs, records.

A value that is not known is left out of its row rather than stored as nan: it shows as empty, and two recordings of
one result compare equal (nan never equals nan).
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import rerun

__all__ = ["log_table"]

MATRIX: Final = 2


def log_table(
    recording: "rerun.RecordingStream",
    path: str,
    timeline: str,
    index: npt.ArrayLike,
    columns: Mapping[str, Iterable[object]],
) -> None:
    """Log one row an index.

    Args:
        recording: the stream.
        path: entity of the table.
        timeline: what the index counts.
        index: (n_rows,) whole numbers.
        columns: by name, n_rows values each: numbers, words, or sequences of numbers for a list in each cell; an array
            (n_rows, n) is the same, quick, and a row of it that is nan throughout is left out.
    """
    import rerun as rr

    rows = np.asarray(index, dtype=np.int64)
    if not rows.size:
        return
    made: list[object] = []
    for name, values in columns.items():
        if isinstance(values, np.ndarray) and values.ndim <= MATRIX and values.dtype == np.float64:
            made += _lists(name, values.reshape(rows.size, -1))
            continue
        cells = [_known(value) for value in values]
        flat = [value for part in cells for value in part]
        # a column without any value has no type; Rerun would keep or drop it by what the process has logged before
        if flat:
            made += rr.AnyValues.columns(**{name: flat}).partition([len(part) for part in cells])
    if made:
        recording.send_columns(path, [rr.TimeColumn(timeline, sequence=rows)], made, strict=True)


def _lists(name: str, values: npt.NDArray[np.float64]) -> list[object]:
    """A list of numbers in each cell, none where nothing is known; in Arrow's form, so that Rerun need not look."""
    import pyarrow as pa
    import rerun as rr

    there = ~np.isnan(values).all(axis=1)
    if not there.any() or not values.shape[1]:
        return []
    offsets = np.concatenate([[0], np.cumsum(there * values.shape[1])]).astype(np.int32)
    cells = pa.ListArray.from_arrays(offsets, pa.array(values[there].reshape(-1)))
    return list(rr.AnyValues.columns(**{name: cells}))


def _known(value: object) -> list[object]:
    if isinstance(value, np.ndarray | list | tuple):
        return [float(part) for part in value]  # cells of several numbers keep their places, so nan stays
    if isinstance(value, float | np.floating) and np.isnan(value):
        return []
    return [value.item() if isinstance(value, np.generic) else value]
