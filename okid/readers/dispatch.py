"""From a path to a table, by file type."""

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from okid.errors import UnreadableFileError
from okid.readers.guard import check_file
from okid.readers.mat import read_mat
from okid.readers.numpy_files import read_npy, read_npz
from okid.readers.parquet import read_parquet
from okid.readers.table import Table
from okid.readers.tdms import read_tdms
from okid.readers.text import read_text
from okid.readers.uff import read_uff

__all__ = ["READERS", "read_table"]

READERS: Mapping[str, Callable[[Path], Table]] = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".asc"), read_text),
    ".npy": read_npy,
    ".npz": read_npz,
    ".mat": read_mat,
    **dict.fromkeys((".uff", ".unv", ".ufb"), read_uff),
    **dict.fromkeys((".parquet", ".pq"), read_parquet),
    ".tdms": read_tdms,
}
"""One function a file type."""


def read_table(path: str | Path) -> Table:
    """The table in a file.

    Raises:
        UnreadableFileError: no such file, an unknown type, or damage; the message says which and what to do.
    """
    path = Path(path)
    check_file(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise UnreadableFileError(
            f"{path.name} is of type {path.suffix or 'none'}, which is not read; the types read are "
            f"{', '.join(READERS)}."
        )
    try:
        table = reader(path)
    except OSError as error:
        raise UnreadableFileError(f"{path} cannot be read ({error.strerror or error}); check the file.") from error
    double = [name for name, count in Counter(table.names).items() if count > 1]
    if double:
        raise UnreadableFileError(
            f"{path.name} has more than one column called {', '.join(map(repr, double[:5]))}; give each its own name."
        )
    if table.n_samples == 0:
        raise UnreadableFileError(f"{path.name} has columns ({', '.join(table.names[:8])}) but no samples.")
    return table
