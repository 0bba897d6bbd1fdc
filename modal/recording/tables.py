"""Tables of numbers on a timeline that counts rows: modes, orders, outputs, records.

A value that is not known is left out of its row rather than stored as nan: it shows as empty, and two recordings of
one result compare equal (nan never equals nan).
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import rerun

__all__ = ["log_table"]


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
        columns: by name, n_rows values each: numbers, words, or sequences of numbers for a list in each cell.
    """
    import rerun as rr

    rows = np.asarray(index, dtype=np.int64)
    if not rows.size:
        return
    made: list[object] = []
    for name, values in columns.items():
        cells = [_known(value) for value in values]
        flat = [value for part in cells for value in part]
        # a column without any value has no type; Rerun would keep or drop it by what the process has logged before
        if flat:
            made += rr.AnyValues.columns(**{name: flat}).partition([len(part) for part in cells])
    if made:
        recording.send_columns(path, [rr.TimeColumn(timeline, sequence=rows)], made, strict=True)


def _known(value: object) -> list[object]:
    if isinstance(value, np.ndarray | list | tuple):
        return [float(part) for part in value]  # cells of several numbers keep their places, so nan stays
    if isinstance(value, float | np.floating) and np.isnan(value):
        return []
    return [value.item() if isinstance(value, np.generic) else value]
