"""MAT files: version 5 to 7 by scipy, version 7.3 (which is HDF5) by h5py.

Function handles and objects in a file are looked at by neither. A vector of MATLAB has two axes, one of length 1: it is
one channel, whichever way it lies. Fields of structures are arrays of their own, "run.tip", and lose the structure's
name where the field's alone is unique.
"""

import zlib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from okid.errors import UnreadableFileError
from okid.readers.arrays import Content, table_from_arrays
from okid.readers.guard import check_memory, first_line, optional_package
from okid.readers.table import Table

__all__ = ["read_mat"]

MAX_DEPTH = 4
"""Structures within structures that are looked into."""

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
MATLAB_USER_BLOCK = 512
"""A 7.3 file begins with 512 bytes of its own, then comes HDF5."""


def read_mat(path: Path) -> Table:
    """The arrays of a MAT file; see `okid.readers.arrays` for what their names mean.

    Raises:
        UnreadableFileError: damaged or cut off, or no array of samples in it.
    """
    with path.open("rb") as file:
        start = file.read(MATLAB_USER_BLOCK + len(HDF5_SIGNATURE))
    is_hdf5 = start.startswith(HDF5_SIGNATURE) or start.endswith(HDF5_SIGNATURE)
    contents = _read_hdf5(path) if is_hdf5 else _read_version_5(path)
    return table_from_arrays(_shortened(contents), path=path, file_format="MAT 7.3" if is_hdf5 else "MAT")


def _read_version_5(path: Path) -> dict[str, Content]:
    import scipy

    try:
        # A compressed file can claim far more than it weighs: its table of contents is read first.
        check_memory(path, 16.0 * sum(float(np.prod(shape, dtype=float)) for _, shape, _ in scipy.io.whosmat(path)))
        loaded = scipy.io.loadmat(path, verify_compressed_data_integrity=True)
    except UnreadableFileError:
        raise
    except (
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        OSError,
        EOFError,
        OverflowError,
        MemoryError,
        zlib.error,
    ) as error:
        raise _unreadable(path, error) from error
    except Exception as error:  # scipy's own MatReadError derives from Exception alone
        if type(error).__name__ != "MatReadError":
            raise
        raise _unreadable(path, error) from error
    contents: dict[str, Content] = {}
    for name, value in loaded.items():
        if not name.startswith("__"):
            _add_version_5(contents, name, value, depth=0)
    return contents


def _add_version_5(contents: dict[str, Content], name: str, value: Any, depth: int) -> None:
    if not isinstance(value, np.ndarray) or depth > MAX_DEPTH:
        return
    if value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            _add_version_5(contents, f"{name}.{field}", value[field].item(), depth + 1)
    elif value.dtype.kind == "U":
        contents[name] = [str(text).strip() for text in value.ravel()]
    elif value.dtype == object and all(_is_text(cell) for cell in value.ravel()):
        contents[name] = [str(cell.ravel()[0]).strip() if cell.size else "" for cell in value.ravel()]
    elif value.dtype.kind in "biufc":
        contents[name] = _vector(value)


def _is_text(cell: Any) -> bool:
    return isinstance(cell, np.ndarray) and cell.dtype.kind == "U" and cell.size <= 1


def _read_hdf5(path: Path) -> dict[str, Content]:
    h5py = optional_package("h5py", path)
    contents: dict[str, Content] = {}
    try:
        with h5py.File(path, "r") as file:
            _add_group(contents, h5py, file, prefix="", path=path, depth=0)
    except UnreadableFileError:
        raise
    except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
        raise _unreadable(path, error) from error
    return contents


def _add_group(contents: dict[str, Content], h5py: Any, group: Any, *, prefix: str, path: Path, depth: int) -> None:
    for key in group:
        if key.startswith("#") or not isinstance(group.get(key, getlink=True), h5py.HardLink):
            continue  # MATLAB's own tables; and links, which may lead to other files
        item = group[key]
        if isinstance(item, h5py.Group):
            if depth < MAX_DEPTH:
                _add_group(contents, h5py, item, prefix=f"{prefix}{key}.", path=path, depth=depth + 1)
        elif not (item.external or item.is_virtual or item.attrs.get("MATLAB_empty", 0)):
            value = _dataset(h5py, item, path)
            if value is not None:
                contents[f"{prefix}{key}"] = value


def _dataset(h5py: Any, item: Any, path: Path) -> Content | None:
    check_memory(path, 2.0 * float(item.nbytes))
    kind = item.attrs.get("MATLAB_class", b"")
    if kind == b"char":
        return [_characters(item)]
    if kind == b"cell":
        cells = [item.file[reference] for reference in item[()].ravel() if reference]
        if all(isinstance(cell, h5py.Dataset) and cell.attrs.get("MATLAB_class", b"") == b"char" for cell in cells):
            return [_characters(cell) for cell in cells]
        return None
    value = item[()]
    if not isinstance(value, np.ndarray):
        return None
    if value.dtype.names == ("real", "imag"):
        value = value["real"] + 1j * value["imag"]
    return _vector(value.T) if kind else _vector(value)  # MATLAB stores columns first, so h5py sees the transpose


def _characters(item: Any) -> str:
    if item.attrs.get("MATLAB_empty", 0):
        return ""
    return "".join(chr(code) for code in item[()].T.ravel()).strip()


def _vector(value: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    return value.reshape(-1) if value.ndim == 2 and 1 in value.shape else value


def _shortened(contents: dict[str, Content]) -> dict[str, Content]:
    count = Counter(name.rpartition(".")[2] for name in contents)
    return {(last if count[last := name.rpartition(".")[2]] == 1 else name): value for name, value in contents.items()}


def _unreadable(path: Path, error: Exception) -> UnreadableFileError:
    return UnreadableFileError(
        f"{path.name} is damaged, cut off or no MAT file ({first_line(error)}); save or copy it again."
    )
