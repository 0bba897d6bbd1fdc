"""MAT files: version 4 to 7 element by element, version 7.3 (which is HDF5) by h5py.

Function handles and objects in a file are passed over. A vector of MATLAB has two axes, one of length 1: it is
one channel, whichever way it lies. Fields of structures are arrays of their own, "run.tip", and lose the structure's
name where the field's alone is unique.
"""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from okid.readers.arrays import Content, table_from_arrays
from okid.readers.guard import DEFLATE_RATIO, MAX_DEPTH, Damage, check_memory, foreign, optional_package
from okid.readers.mat_elements import Value, read_elements
from okid.readers.table import Table

__all__ = ["mat_contents", "read_mat"]

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
MATLAB_USER_BLOCK = 512
"""A 7.3 file begins with 512 bytes of its own, then comes HDF5."""

HDF5_VERSION = (b"\x00\x02IM", b"\x02\x00MI")


def read_mat(path: Path) -> Table:
    """The arrays of a MAT file; see `okid.readers.arrays` for what their names mean.

    Raises:
        UnreadableFileError: damaged or cut off, or no array of samples in it.
    """
    contents, is_hdf5 = mat_contents(path)
    return table_from_arrays(contents, path=path, file_format="MAT 7.3" if is_hdf5 else "MAT")


def mat_contents(path: Path) -> tuple[dict[str, Content], bool]:
    """The arrays and texts of a MAT file by name, and whether it is one of version 7.3.

    Raises:
        UnreadableFileError: damaged or cut off.
    """
    with path.open("rb") as file:
        start = file.read(MATLAB_USER_BLOCK + len(HDF5_SIGNATURE))
    is_hdf5 = start.startswith(HDF5_SIGNATURE) or start.endswith(HDF5_SIGNATURE)
    with foreign(path, "MAT file"):
        if not is_hdf5 and (start.startswith(b"MATLAB 7.3") or start[124:128] in HDF5_VERSION):
            raise Damage("its header says version 7.3, but the signature of HDF5 behind it is gone")
        contents = _read_hdf5(path) if is_hdf5 else _read_version_5(path)
    return _shortened(contents), is_hdf5


def _read_version_5(path: Path) -> dict[str, Content]:
    contents: dict[str, Content] = {}
    for name, value in read_elements(path).items():
        _add_version_5(contents, name, value, depth=0)
    return contents


def _add_version_5(contents: dict[str, Content], name: str, value: Value, depth: int) -> None:
    if isinstance(value, dict) and depth < MAX_DEPTH:
        for field, part in value.items():
            _add_version_5(contents, f"{name}.{field}", part, depth + 1)
    elif isinstance(value, np.ndarray):
        contents[name] = _vector(value)
    elif isinstance(value, list):
        texts = [each[0] if isinstance(each, list) and len(each) == 1 else each for each in value]
        texts = ["" if isinstance(each, np.ndarray) and not each.size else each for each in texts]
        if all(isinstance(each, str) for each in texts):
            contents[name] = [str(each).strip() for each in texts]


def _read_hdf5(path: Path) -> dict[str, Content]:
    h5py = optional_package("h5py", path)
    contents: dict[str, Content] = {}
    with h5py.File(path, "r") as file:
        _add_group(contents, h5py, file, prefix="", path=path, depth=0)
    return contents


def _add_group(contents: dict[str, Content], h5py: Any, group: Any, *, prefix: str, path: Path, depth: int) -> None:
    for key in group:
        if key.startswith("#") or not isinstance(group.get(key, getlink=True), h5py.HardLink):
            continue  # MATLAB's own tables; and links, which may lead to other files
        item = group[key]
        if isinstance(item, h5py.Group):
            if depth < MAX_DEPTH:
                _add_group(contents, h5py, item, prefix=f"{prefix}{key}.", path=path, depth=depth + 1)
        elif isinstance(item, h5py.Dataset) and not (
            item.external or item.is_virtual or item.attrs.get("MATLAB_empty", 0)
        ):
            value = _dataset(h5py, item, path)
            if value is not None:
                contents[f"{prefix}{key}"] = value


def _dataset(h5py: Any, item: Any, path: Path) -> Content | None:
    if item.external or item.is_virtual or item.attrs.get("MATLAB_empty", 0):
        return None
    check_memory(path, 2.0 * float(item.nbytes))
    if item.nbytes > DEFLATE_RATIO * max(item.id.get_storage_size(), 64):
        raise Damage(f"{item.nbytes} bytes are announced in {item.id.get_storage_size()} that are there")
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
