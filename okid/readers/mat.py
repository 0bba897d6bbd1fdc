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
from okid.readers.guard import (
    DEFLATE_RATIO,
    MAX_CHANNELS,
    MAX_DEPTH,
    MAX_MEMBERS,
    Damage,
    check_memory,
    foreign,
    optional_package,
)
from okid.readers.mat_elements import Value, read_elements
from okid.readers.table import Table

__all__ = ["mat_contents", "read_mat"]

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
MATLAB_USER_BLOCK = 512
"""A 7.3 file begins with 512 bytes of its own, then comes HDF5."""

LONGEST_TEXT = 2**16
"""Leave out texts of more characters: they name no channel."""

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
    with h5py.File(path, "r") as file:
        found = _Hdf5(h5py, path)
        found.add_group(file, prefix="", depth=0)
    return found.contents


class _Hdf5:
    """What is read of a file so far. Names may be links of any number to one place: each place is entered once."""

    def __init__(self, h5py: Any, path: Path) -> None:
        self.h5py, self.path = h5py, path
        self.contents: dict[str, Content] = {}
        self.groups: set[int] = set()
        self.n_names, self.n_bytes = 0, 0.0

    def add_group(self, group: Any, *, prefix: str, depth: int) -> None:
        """Take up all that is read of a group and of the groups in it."""
        place = self.h5py.h5o.get_info(group.id).addr
        if place in self.groups:
            return
        self.groups.add(place)
        self.count(len(group))
        for key in group:
            if key.startswith("#") or not isinstance(group.get(key, getlink=True), self.h5py.HardLink):
                continue  # MATLAB's own tables; and links, which may lead to other files
            item = group[key]
            if isinstance(item, self.h5py.Group):
                if depth < MAX_DEPTH:
                    self.add_group(item, prefix=f"{prefix}{key}.", depth=depth + 1)
            elif isinstance(item, self.h5py.Dataset):
                value = self.content(item)
                if value is not None:
                    self.contents[f"{prefix}{key}"] = value

    def count(self, more: int) -> None:
        """Raise where a file has more names than channels can give it, whatever they are of."""
        self.n_names += more
        if self.n_names > MAX_MEMBERS:
            raise Damage(f"it holds more than {MAX_MEMBERS} arrays")

    def content(self, item: Any) -> Content | None:
        """The array or the texts of a dataset; None where it is neither."""
        if not self.is_own(item):
            return None
        kind = item.attrs.get("MATLAB_class", b"")
        if kind == b"char":
            text = self.text(item)
            return None if text is None else [text]
        if kind == b"cell":
            return self.texts(item)
        value = item[()]
        if not isinstance(value, np.ndarray):
            return None
        if value.dtype.names == ("real", "imag"):
            value = value["real"] + 1j * value["imag"]
        return _vector(value.T) if kind else _vector(value)  # MATLAB stores columns first, so h5py sees the transpose

    def texts(self, item: Any) -> list[str] | None:
        """The texts of a cell array, None where it holds anything else or more than there are channels."""
        if item.size > MAX_CHANNELS:
            return None
        found = []
        for reference in item[()].ravel():
            cell = item.file[reference] if reference else None
            if cell is None:
                continue
            if not isinstance(cell, self.h5py.Dataset) or cell.attrs.get("MATLAB_class", b"") != b"char":
                return None
            text = "" if cell.attrs.get("MATLAB_empty", 0) else self.text(cell)
            if text is None:
                return None
            found.append(text)
        return found

    def text(self, item: Any) -> str | None:
        """The characters of a dataset, None where they are no name or are not in this file."""
        if item.size > LONGEST_TEXT or not self.is_own(item):
            return None
        return "".join(chr(code) for code in item[()].T.ravel()).strip()

    def is_own(self, item: Any) -> bool:
        """Whether what a dataset holds is in this file, as much as it claims, and together not too much."""
        if item.external or item.is_virtual or item.attrs.get("MATLAB_empty", 0):
            return False
        self.n_bytes += float(item.nbytes)
        check_memory(self.path, 2.0 * self.n_bytes)
        if item.nbytes > DEFLATE_RATIO * max(item.id.get_storage_size(), 64):
            raise Damage(f"{item.nbytes} bytes are announced in {item.id.get_storage_size()} that are there")
        return True


def _vector(value: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    return value.reshape(-1) if value.ndim == 2 and 1 in value.shape else value


def _shortened(contents: dict[str, Content]) -> dict[str, Content]:
    count = Counter(name.rpartition(".")[2] for name in contents)
    return {(last if count[last := name.rpartition(".")[2]] == 1 else name): value for name, value in contents.items()}
