"""From a path to a table, by file type.

What a file holds, in words: channels, units and what was done to them.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from okid.errors import UnreadableFileError
from okid.readers.arrays import read_npy, read_npz, table_from_arrays, table_of_channels
from okid.readers.guard import check_file, foreign
from okid.readers.mat import read_mat
from okid.readers.parquet import read_parquet
from okid.readers.table import LeftOut, Table, conversion_of, stated_step
from okid.readers.tdms import read_lvm, read_mdf, read_tdms, read_wav
from okid.readers.text import read_text
from okid.readers.uff import read_uff
from okid.readers.units import UnitConversion

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
    """

    path: Path
    format: str
    n_samples: int
    dt: float | None
    channels: tuple[UnitConversion, ...]
    inputs: tuple[str, ...] | None
    outputs: tuple[str, ...] | None
    left_out: tuple[LeftOut, ...]

    @property
    def remarks(self) -> tuple[str, ...]:
        """One sentence for each way in which units were converted or kept; channels treated alike share one."""
        groups: dict[tuple[str, str, str, float, float], list[UnitConversion]] = {}
        for conversion in self.channels:
            if conversion.changed or conversion.note:
                key = (conversion.written, conversion.unit, conversion.note, conversion.factor, conversion.offset)
                groups.setdefault(key, []).append(conversion)
        remarks = [_shared(group) for group in groups.values()]
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


def describe_table(table: Table, *, dt: float | None = None) -> FileDescription:
    """The description of a table that has been read already.

    Raises:
        InvalidDataError: its time column is no uniform grid, and no time step is given.
    """
    step = stated_step(table)[0] if dt is None else dt
    return FileDescription(
        path=table.path,
        format=table.format,
        n_samples=table.n_samples,
        dt=step,
        channels=tuple(conversion_of(table, index) for index in table.channels()),
        inputs=table.inputs,
        outputs=table.outputs,
        left_out=table.left_out,
    )


def _shared(group: list[UnitConversion]) -> str:
    names = ", ".join(conversion.channel for conversion in group[:4])
    more = f" and {len(group) - 4} more" if len(group) > 4 else ""
    _, _, rest = str(group[0]).partition(f"{group[0].channel}: ")
    return f"{names}{more}: {rest}"
