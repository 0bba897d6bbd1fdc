"""MAT files: version 4 to 7 element by element, version 7.3 (which is HDF5) by h5py.

Function handles and objects in a file are passed over. A vector of MATLAB has two axes, one of length 1: it is
one channel, whichever way it lies. Fields of structures are arrays of their own, "run.tip", and lose the structure's
name where the field's alone is unique.

A level 5 file is a header of 128 bytes and a row of elements, each a tag (type and number of bytes) and its data, which
may be elements in turn. Every number of samples that a file claims must be accounted for by the bytes that follow, so
damage is an error and never another number. Sparse matrices, function handles and objects are passed over.

References:
    MathWorks, MAT-File Format, R2019b, chapters 1 (level 5) and 2 (level 4).
"""

import math
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

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
from okid.readers.table import Table

Value = Any
"""An array of numbers, a text, a list (cells), a dict (fields of one structure), or None: nothing that we read."""


class Mat:
    """Numbers of the format, chapter 1 of its description."""

    HEADER: Final = 128
    UINT8: Final = 9  # a variable of bytes without a name is MATLAB's own
    OPAQUE: Final = 17
    PASSED_OVER: Final = (5, 16)  # sparse, a function handle
    NUMERIC: Final = range(6, 16)
    MATLAB_USER_BLOCK: Final = 512
    """A 7.3 file begins with 512 bytes of its own, then comes HDF5."""


NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Storage types of elements, chapter 1, table 1-1."""

TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
MATRIX, COMPRESSED, INT8, INT32, UINT32 = 14, 15, 1, 5, 6
CELL, STRUCT, OBJECT, CHAR = 1, 2, 3, 4
LEVEL_4 = ("f8", "f4", "i4", "i2", "u2", "u1")
IS_COMPLEX, IS_LOGICAL = 0x800, 0x200


def read_elements(path: Path) -> dict[str, Value]:
    """The variables of a file by name.

    Raises:
        Damage: a tag, a size or a checksum that does not fit what is there.
    """
    check_memory(path, 3.0 * path.stat().st_size)
    data = memoryview(path.read_bytes())
    if 0 in data[:4]:  # a level 5 header begins with words
        variables = _level_4(data)
    else:
        order = {b"IM": "<", b"MI": ">"}.get(bytes(data[126 : Mat.HEADER]))
        if order is None or struct.unpack(f"{order}H", data[124:126])[0] != 0x0100:
            raise Damage("its header names neither version 4, 5 nor 7.3")
        variables = _level_5(data[Mat.HEADER :], order, lambda n_bytes: check_memory(path, 3.0 * n_bytes))
    found: dict[str, Value] = {}
    for name, value in variables:
        if name in found:
            raise Damage(f"two variables are called {name!r}")
        if name:
            found[name] = value
        if len(found) > MAX_MEMBERS:
            raise Damage(f"it holds more than {MAX_MEMBERS} variables")
    return found


# --- level 4 ---------------------------------------------------------------------------------------------------------


def _level_4(data: memoryview) -> Iterator[tuple[str, Value]]:
    at = 0
    while at < len(data):
        _need(data, at, 20)
        order = "<" if struct.unpack_from("<I", data, at)[0] < 5000 else ">"
        mopt, n_rows, n_columns, is_complex, n_name = struct.unpack_from(f"{order}5I", data, at)
        machine, zero, storage, kind = (mopt // 10**power % 10 for power in (3, 2, 1, 0))
        if mopt >= 5000 or machine != (order == ">") or zero or storage >= len(LEVEL_4) or kind > 2 or is_complex > 1:
            raise Damage(f"a variable of type {mopt} at byte {at}")
        dtype, size = np.dtype(order + LEVEL_4[storage]), n_rows * n_columns
        at += 20
        _need(data, at, n_name + (1 + is_complex) * size * dtype.itemsize)
        name, at = bytes(data[at : at + n_name]).rstrip(b"\0").decode("latin-1"), at + n_name
        parts = []
        for _ in range(1 + is_complex):
            parts.append(np.frombuffer(data, dtype, size, at).reshape((n_rows, n_columns), order="F"))
            at += size * dtype.itemsize
        value: Value = parts[0] + 1j * parts[1] if is_complex else parts[0]
        if kind == 1:
            value = ["".join(chr(int(code) & 0xFF) for code in row) for row in value] if not is_complex else None
        yield name, None if kind == 2 else value


# --- level 5 ---------------------------------------------------------------------------------------------------------


def _level_5(data: memoryview, order: str, check: Callable[[float], None]) -> Iterator[tuple[str, Value]]:
    file = _Elements(data=data, order=order)
    while file.left:
        kind, content = file.following()
        if kind == COMPRESSED:
            kind, content = _inflated(content, order, check)
        if kind != MATRIX:
            raise Damage(f"a variable of type {kind}")
        yield _matrix(_Elements(data=content, order=order), 0)


@dataclass(slots=True, kw_only=True)
class _Elements:
    """A row of elements, and how far it is read."""

    data: memoryview
    order: str
    at: int = 0

    @property
    def left(self) -> int:
        """Bytes that are not read yet."""
        return len(self.data) - self.at

    def following(self, *kinds: int) -> tuple[int, memoryview]:
        """Type and data of the next element; four bytes of data or fewer stand in the tag itself.

        Raises:
            Damage: its type is none of `kinds`, or it is longer than what is left.
        """
        _need(self.data, self.at, 8)
        kind, size = struct.unpack_from(f"{self.order}2I", self.data, self.at)
        start, end = self.at + 8, self.at + 8 + size + (0 if kind == COMPRESSED else -size % 8)
        if kind >> 16:
            kind, size, start, end = kind & 0xFFFF, kind >> 16, self.at + 4, self.at + 8
        if start + size > end or (kinds and kind not in kinds):
            raise Damage(f"an element of type {kind} and {size} bytes at byte {self.at} of its part")
        _need(self.data, start, end - start)
        self.at = end
        return kind, self.data[start : start + size]

    def numbers(self, shape: tuple[int, ...]) -> npt.NDArray[Any]:
        """The next element as an array."""
        kind, content = self.following(*NUMBERS)
        dtype = np.dtype(self.order + NUMBERS[kind])
        if len(content) != math.prod(shape) * dtype.itemsize:
            raise Damage(f"an array of shape {shape} in {len(content)} bytes")
        return np.frombuffer(content, dtype).reshape(shape, order="F")

    def shape(self) -> tuple[int, ...]:
        """The next element as the lengths of axes."""
        _, content = self.following(INT32, UINT32)
        shape = struct.unpack(f"{self.order}{len(content) // 4}i", content)
        if len(shape) < 2 or min(shape) < 0:
            raise Damage(f"a matrix of shape {shape}")
        return shape

    def text(self) -> str:
        """The next element as a name."""
        return _name(self.following(INT8)[1])


def _need(data: memoryview, at: int, size: int) -> None:
    if at + size > len(data):
        raise Damage(f"{size} bytes are announced, and {max(0, len(data) - at)} are left")


def _inflated(packed: memoryview, order: str, check: Callable[[float], None]) -> tuple[int, memoryview]:
    """A compressed element: not one byte more is unpacked than its own tag announces."""
    stream = zlib.decompressobj()
    kind, size = struct.unpack(f"{order}2I", stream.decompress(packed, 8))
    if size > DEFLATE_RATIO * len(packed):
        raise Damage(f"{size} bytes are announced in {len(packed)} compressed ones")
    check(size)
    content = stream.decompress(stream.unconsumed_tail, max(1, size))
    more = stream.decompress(stream.unconsumed_tail, 8)  # the checksum is compared at the end of the stream
    if len(content) != size or more or not stream.eof or stream.unused_data:
        raise Damage(f"{size} bytes are announced, and its compressed data hold others")
    return kind, memoryview(content)


def _matrix(parts: _Elements, depth: int) -> tuple[str, Value]:
    """Name and value of the elements of a matrix."""
    if not parts.left:
        return "", np.empty((0, 0))
    _, content = parts.following(UINT32)
    _need(content, 0, 8)
    flags = struct.unpack(f"{parts.order}I", content[:4])[0]
    kind = flags & 0xFF
    if kind == Mat.OPAQUE:  # no shape follows, but its names
        return parts.text(), None
    shape, name = parts.shape(), parts.text()
    if not name and depth == 0 and kind != Mat.UINT8:
        raise Damage("a variable without a name")
    if kind in Mat.PASSED_OVER:
        return name, None
    value: Value
    if kind in Mat.NUMERIC:
        value = _numeric(parts, shape, flags)
    elif kind == CHAR:
        value = _rows(parts, shape)
    elif kind == CELL:
        value = _cells(parts, math.prod(shape), depth)
    elif kind in (STRUCT, OBJECT):
        value = _fields(parts, math.prod(shape), depth, is_object=kind == OBJECT)
    else:
        raise Damage(f"a matrix of class {kind}")
    if parts.left:
        raise Damage(f"{parts.left} bytes follow the samples of {name!r}")
    return name, value


def _numeric(parts: _Elements, shape: tuple[int, ...], flags: int) -> npt.NDArray[Any]:
    value = parts.numbers(shape)
    if flags & IS_COMPLEX:
        return np.asarray(value + 1j * parts.numbers(shape))
    if not flags & IS_LOGICAL:
        return value
    if value.size and not 0 <= value.min() <= value.max() <= 1:
        raise Damage("true and false are neither 1 nor 0")
    return value != 0


def _name(content: memoryview) -> str:
    name = bytes(content).rstrip(b"\0").decode("latin-1")
    if not (name.isascii() and name.isprintable()):
        raise Damage(f"a name of {name!r}")
    return name


def _rows(parts: _Elements, shape: tuple[int, ...]) -> list[str]:
    """One text a row."""
    kind, content = parts.following(*TEXTS)
    code = TEXTS[kind]
    if code in ("utf-16", "utf-32"):
        code += "-le" if parts.order == "<" else "-be"
    text = bytes(content).decode(code, "replace")
    count = math.prod(shape)
    if count not in (len(text), len(text.encode("utf-16-le", "surrogatepass")) // 2):
        raise Damage(f"a text of shape {shape} in {len(text)} letters")
    if len(text) != count or len(shape) != 2:
        return [text]  # letters of two codes
    return ["".join(text[row :: shape[0]]) for row in range(shape[0])]


def _fields(parts: _Elements, count: int, depth: int, *, is_object: bool) -> dict[str, Value] | None:
    """The fields of one structure; of several nothing."""
    if is_object:
        parts.text()
    _, content = parts.following(INT32)
    (length,) = struct.unpack(f"{parts.order}i", content)
    _, content = parts.following(INT8)
    if length < 1 or len(content) % length:
        raise Damage(f"{len(content)} bytes for field names of {length} letters")
    names = [_name(content[start : start + length]) for start in range(0, len(content), length)]
    if len(set(names)) < len(names) or "" in names:
        raise Damage("fields without a name of their own")
    values = _cells(parts, count * len(names), depth)  # several are walked as well: their sizes are claims too
    return dict(zip(names, values, strict=True)) if count == 1 else None


def _cells(parts: _Elements, count: int, depth: int) -> list[Value]:
    if 8 * count > parts.left:
        raise Damage(f"{count} parts are announced in {parts.left} bytes")
    within = (_Elements(data=parts.following(MATRIX)[1], order=parts.order) for _ in range(count))
    return [_matrix(each, depth + 1)[1] for each in within]


HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
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
        start = file.read(Mat.MATLAB_USER_BLOCK + len(HDF5_SIGNATURE))
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
        if item.size > 2**16 or not self.is_own(item):  # a longer text names no channel
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
