"""NPY and NPZ. Nothing is ever unpickled: a pickle may run any program."""

import zipfile
from pathlib import Path

import numpy as np

from okid.errors import UnreadableFileError
from okid.readers.arrays import Content, table_from_arrays
from okid.readers.guard import check_channel_count, check_memory, first_line
from okid.readers.table import Column, Table

__all__ = ["read_npy", "read_npz"]

_DAMAGE = (ValueError, EOFError, OSError, KeyError, zipfile.BadZipFile, NotImplementedError, SyntaxError)
"""What numpy raises for a file that is cut off or is not what its name says."""


def read_npy(path: Path) -> Table:
    """One array, (n_samples, n_channels), mapped and not loaded; its channels are column_0, column_1, ...

    The fields of a structured array are channels by their names.

    Raises:
        UnreadableFileError: damaged, pickled, or not an array of numbers.
    """
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except _DAMAGE as error:
        raise _unreadable(path, error) from error
    if array.dtype.names:
        fields: dict[str, Content] = {name: np.asarray(array[name]) for name in array.dtype.names}
        return table_from_arrays(fields, path=path, file_format="NPY")
    if array.dtype.kind not in "biuf" or array.ndim not in {1, 2}:
        raise UnreadableFileError(
            f"{path.name} holds an array of {array.dtype} with {array.ndim} axes; a record is an array of real numbers "
            "of shape (n_samples, n_channels)."
        )
    values = array if array.ndim == 2 else array[:, np.newaxis]
    check_channel_count(path, values.shape[1])
    columns = tuple(Column(name=f"column_{index}") for index in range(values.shape[1]))
    return Table(path=path, format="NPY", columns=columns, values=values)


def read_npz(path: Path) -> Table:
    """Named arrays; see `okid.readers.arrays` for what the names mean.

    Raises:
        UnreadableFileError: damaged, or an array in it is a pickle.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            check_memory(path, 2.0 * sum(entry.file_size for entry in archive.infolist()))
        with np.load(path, allow_pickle=False) as arrays:
            members = {name: arrays[name] for name in arrays.files}
    except UnreadableFileError:
        raise
    except _DAMAGE as error:
        raise _unreadable(path, error) from error
    # a member that is no array comes as its bytes: it is nothing to us
    contents = {name: _content(member) for name, member in members.items() if isinstance(member, np.ndarray)}
    return table_from_arrays(contents, path=path, file_format="NPZ")


def _content(array: np.ndarray[tuple[int, ...], np.dtype[np.generic]]) -> Content:
    if array.dtype.kind in "US":
        return [text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text) for text in array.ravel()]
    return array


def _unreadable(path: Path, error: Exception) -> UnreadableFileError:
    if "pickle" in str(error) or "Python objects" in str(error):
        return UnreadableFileError(
            f"{path.name} holds pickled Python objects, which are never loaded because they may run any program; save "
            "plain arrays of numbers."
        )
    return UnreadableFileError(
        f"{path.name} is damaged or is no {path.suffix} file ({first_line(error)}); save or copy it again."
    )
