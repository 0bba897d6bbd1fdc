"""Named arrays (NPZ, MAT) as one table: which array is the time, which the inputs, which a channel.

Rows are samples: an array whose first axis is not as long as the record's is left out, never transposed. Arrays called
`inputs` and `outputs` say what drives and what answers; their names and units are in `input_names`, `output_names`,
`input_units`, `output_units`. A number called `dt` (or `Ts`) is the time step, `fs` its inverse, a vector called `time`
or `t` the time axis. Every other vector is a channel called like the array, every other matrix one channel a column.

NPY and NPZ. Nothing is ever unpickled: a pickle may run any program.
"""

import math
import os
import shutil
import tempfile
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from okid.arrays import FloatArray
from okid.errors import UnreadableFileError
from okid.readers.guard import (
    Damage,
    check_channel_count,
    check_memory,
    first_line,
    foreign,
    in_memory,
    sound_archive,
)
from okid.readers.table import TIME_NAMES, Column, LeftOut, Table
from okid.readers.units import split_header

Content = npt.NDArray[np.generic] | Sequence[str]
"""An array of a file, or the texts of a list of texts."""

STEP_NAMES = frozenset(["dt", "ts", "sample_time", "sampling_time", "time_step"])
RATE_NAMES = frozenset(["fs", "sample_rate", "sampling_rate", "sampling_frequency"])
ROLES = ("inputs", "outputs")
TRANSPOSED = "rows are samples: save its transpose"
DISK_SHARE = 0.5
"""Take no more than this share of the free disk for a copy: others need some."""


def table_of_channels(channels: Sequence[Mapping[str, Any]], *, path: Path) -> Table:
    """The table of time series as SEP 005 of SDyPy hands them on: data, name, unit_str, and fs or time each.

    Raises:
        UnreadableFileError: a series without data, name, or fs and time, or series of different lengths or times.
    """
    try:
        data = [np.asarray(one["data"], dtype=np.float64) for one in channels]
        names = [str(one["name"]) for one in channels]
        axes = {
            (len(values), float(one["fs"] if one.get("fs") else (len(values) - 1) / (one["time"][-1] - one["time"][0])))
            for one, values in zip(channels, data, strict=True)
        }
    except (KeyError, TypeError, ValueError, IndexError, ZeroDivisionError) as error:
        raise UnreadableFileError(
            f"{path.name} gives a time series that is none of SEP 005 ({first_line(error)}); each needs data (one "
            "axis), name, unit_str, and fs or time."
        ) from error
    if len(axes) != 1 or any(values.ndim != 1 for values in data):
        listed = ", ".join(f"{count} samples at {rate:.6g} Hz" for count, rate in sorted(axes)[:4])
        raise UnreadableFileError(
            f"the time series of {path.name} have different time axes ({listed}); one record has one, so choose those "
            "of one rate."
        )
    stamps = next((one["time"] for one in channels if not one.get("fs")), None)
    columns = [
        Column(name=name, unit=str(one.get("unit_str") or "")) for name, one in zip(names, channels, strict=True)
    ]
    if stamps is not None:
        columns, data = [Column(name="time", unit="s"), *columns], [np.asarray(stamps, dtype=np.float64), *data]
    return Table(
        path=path,
        format="SEP 005",
        columns=tuple(columns),
        values=np.column_stack(data),
        dt=None if stamps is not None else 1.0 / next(iter(axes))[1],
    )


def table_from_arrays(contents: Mapping[str, Content], *, path: Path, file_format: str) -> Table:
    """The table that the named arrays of a file make up.

    Args:
        contents: array or list of texts by name; a name may have parts, "run.tip".
        path: of the file.
        file_format: in words.

    Raises:
        UnreadableFileError: no array that could be a channel.
    """
    arrays = {name: value for name, value in contents.items() if isinstance(value, np.ndarray)}
    texts = {_last(name): list(value) for name, value in contents.items() if not isinstance(value, np.ndarray)}
    steps = _stated_steps(arrays)
    series, left_out = _series(arrays)
    n_samples = _n_samples(series)
    columns: list[Column] = []
    blocks: list[FloatArray] = []
    roles: dict[str, tuple[str, ...]] = {}
    for name, block in series.items():
        if len(block) != n_samples:
            hint = f" ({TRANSPOSED})" if block.shape[1] == n_samples else ""
            reason = f"its shape is {block.shape}, but the record has {n_samples} samples{hint}"
            left_out.append(LeftOut(name=name, reason=reason))
            continue
        check_channel_count(path, len(columns) + block.shape[1])
        added = _columns(name, block.shape[1], texts, path)
        columns += added
        blocks.append(block)
        if _last(name) in ROLES:
            roles[_last(name)] = tuple(column.name for column in added)
    if not blocks:
        raise UnreadableFileError(
            f"{path.name} holds no array of samples (it holds {_listed(contents)}); save each channel as a vector, or "
            "inputs and outputs as matrices with one row a sample."
        )
    return Table(
        path=path,
        format=file_format,
        columns=tuple(columns),
        values=blocks[0] if len(blocks) == 1 else np.column_stack(blocks),
        dt=next(iter(steps.values()), None),
        steps=tuple(steps.items()),
        inputs=roles.get("inputs", ()) if "outputs" in roles else None,
        outputs=roles.get("outputs"),
        left_out=tuple(left_out),
    )


def _last(name: str) -> str:
    return name.rpartition(".")[2].lower()


def _stated_steps(arrays: Mapping[str, npt.NDArray[np.generic]]) -> dict[str, float]:
    """Time steps [s] by the names of the numbers that state them."""
    steps: dict[str, float] = {}
    for name, value in arrays.items():
        if value.size == 1 and value.dtype.kind in "iuf":
            number = float(value.reshape(-1)[0])
            if _last(name) in STEP_NAMES:
                steps[name] = number
            if _last(name) in RATE_NAMES and number > 0:
                steps[name] = 1.0 / number
    return steps


def _series(arrays: Mapping[str, npt.NDArray[np.generic]]) -> tuple[dict[str, FloatArray], list[LeftOut]]:
    """Every array of real numbers as (n_samples, n_channels), and what is none."""
    series: dict[str, FloatArray] = {}
    left_out = []
    for name, value in arrays.items():
        if value.size == 1:
            if _last(name) not in STEP_NAMES | RATE_NAMES:
                left_out.append(LeftOut(name=name, reason="it is a single number"))
        elif value.dtype.kind == "c":
            left_out.append(LeftOut(name=name, reason="it is complex; a channel is a time history of real numbers"))
        elif value.dtype.kind not in "biuf" or value.ndim not in {1, 2} or value.size == 0:
            reason = f"it is an array of {value.dtype} of shape {value.shape}, not samples of channels"
            left_out.append(LeftOut(name=name, reason=reason))
        else:
            block = value if value.ndim == 2 else value[:, np.newaxis]
            series[name] = block.astype(np.float64, copy=False)
    return series, left_out


def _n_samples(series: Mapping[str, FloatArray]) -> int:
    """Length of the time axis, of the outputs or inputs, or of the most channels."""
    for wanted in (TIME_NAMES, {"outputs"}, {"inputs"}):
        for name, block in series.items():
            if _last(name) in wanted:
                return len(block)
    lengths = Counter(len(block) for block in series.values())
    return max(lengths, key=lambda length: (lengths[length], length), default=0)


def _columns(name: str, count: int, texts: Mapping[str, list[str]], path: Path) -> list[Column]:
    key = _last(name)
    stem = key[:-1] if key in ROLES else key
    headers = texts.get(f"{stem}_names", [])
    units = texts.get(f"{stem}_units", [])
    for what, given in (("names", headers), ("units", units)):
        if given and len(given) != count:
            raise UnreadableFileError(
                f"{stem}_{what} of {path.name} holds {len(given)} texts, but {name} has {count} columns; give one for "
                "each."
            )
    if not headers:
        base, unit = split_header(name)
        if key in ROLES:
            base = name[: len(name) - 1]
        many = count > 1 or key in ROLES
        names = [f"{base}_{index}" for index in range(count)] if many else [base]
        split = [(each, unit) for each in names]
    else:
        split = [split_header(header) for header in headers]
    return [
        Column(name=label, unit=units[index] if units else unit, header=headers[index] if headers else name)
        for index, (label, unit) in enumerate(split)
    ]


def _listed(contents: Mapping[str, Content]) -> str:
    names = list(contents)
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return (", ".join(repr(name) for name in names[:8]) + more) or "nothing"


def read_npy(path: Path) -> Table:
    """One array, (n_samples, n_channels), on disk where it is large; its channels are column_0, column_1, ...

    The fields of a structured array are channels by their names. What becomes of the file afterwards changes nothing,
    unless it is large and no disk has room for a copy: then it must stay as it is as long as the record is used.

    Raises:
        UnreadableFileError: damaged, pickled, written to meanwhile, or not an array of numbers.
    """
    with foreign(path, ".npy file"), path.open("rb") as file:
        before = os.fstat(file.fileno())
        dtype = _check_header(file, before.st_size)
        if before.st_size <= 2**24 or dtype.names:  # fields are put together in memory anyway
            file.seek(0)
            array = np.lib.format.read_array(file, allow_pickle=False)
        else:
            if dtype != np.float64:  # made numbers of eight bytes
                check_memory(path, 16.0 * before.st_size / dtype.itemsize)
            array = _on_disk(file, before.st_size)
        after = path.stat()
        if any(getattr(before, kind) != getattr(after, kind) for kind in ("st_ino", "st_size", "st_mtime_ns")):
            raise Damage("it was written to while it was read")
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


def _on_disk(file: IO[bytes], size: int) -> npt.NDArray[np.generic]:
    """The array of a sound file, mapped from a copy without a name, or from the file where no disk has room for one.

    The system ends a process whose mapped file is cut, and one that is written anew would change the record.
    """
    usual = "/var/tmp"  # noqa: S108 - the copy has no name; /tmp often lies in memory
    folder = os.environ.get("TMPDIR") or (usual if os.access(usual, os.W_OK) else tempfile.gettempdir())
    try:
        if in_memory(Path(folder)) or size > DISK_SHARE * shutil.disk_usage(folder).free:
            return _mapped(file)
        with tempfile.TemporaryFile(dir=folder) as copy:
            file.seek(0)
            shutil.copyfileobj(file, copy)
            if copy.tell() != size:
                raise Damage("it was cut while it was read")
            return _mapped(copy)
    except OSError:
        return _mapped(file)


def _mapped(file: IO[bytes]) -> npt.NDArray[np.generic]:
    """The array of a sound file, on disk; it stays when the file is closed."""
    file.seek(0)
    shape, in_columns, dtype = array_header(file)
    return np.memmap(file, dtype, "r", file.tell(), shape, "F" if in_columns else "C")


def read_npz(path: Path) -> Table:
    """Named arrays; see `okid.readers.arrays` for what the names mean.

    Raises:
        UnreadableFileError: damaged, or an array in it is a pickle.
    """
    return table_from_arrays(npz_contents(path), path=path, file_format="NPZ")


def npz_contents(path: Path) -> dict[str, Content]:
    """The arrays and texts of an NPZ file by name; errors as in `read_npz`."""
    contents: dict[str, Content] = {}
    with foreign(path, ".npz file"), sound_archive(path) as archive:
        for member in archive.infolist():
            if member.filename.endswith(".npy"):
                contents[member.filename.removesuffix(".npy")] = _content(array_of(archive, member))
            else:
                _end_of(archive, member)
    return contents


def array_of(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> npt.NDArray[np.generic]:
    """The array that a member of an archive is, unpacked straight into its place.

    Raises:
        Damage: no array, Python objects, or not as many bytes as the header announces; numpy may raise others.
    """
    with archive.open(member) as stream:
        _check_header(stream, member.file_size)
    with archive.open(member) as stream:
        array = np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
        if stream.read(1):  # the end, where the checksum is compared
            raise Damage("bytes follow its array")
    return array


def _end_of(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Unpack a member to its end, for whatever it is, its checksum must be right."""
    with archive.open(member) as stream:
        while stream.read(2**20):
            pass


def array_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether a column's numbers stand together, and type of what follows; numpy may raise where it is damaged.

    Raises:
        Damage: no array.
    """
    start = stream.read(8)
    if start[:6] != np.lib.format.MAGIC_PREFIX:
        raise Damage("it does not begin as an array of numpy does")
    read = np.lib.format.read_array_header_1_0 if start[6] == 1 else np.lib.format.read_array_header_2_0
    return read(stream)


def _check_header(stream: IO[bytes], size: int) -> np.dtype[Any]:
    """The type of the numbers; raise unless the header accounts for every byte behind it."""
    shape, _, dtype = array_header(stream)
    if dtype.hasobject:
        raise Damage("it holds Python objects")
    claimed, there = math.prod(shape) * dtype.itemsize, size - stream.tell()
    if min(shape, default=0) < 0 or claimed != there:
        raise Damage(f"its header announces {claimed} bytes of {dtype} in shape {shape}, and {there} follow")
    return dtype


def _content(array: np.ndarray[tuple[int, ...], np.dtype[np.generic]]) -> Content:
    if array.dtype.kind in "US":
        return [text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text) for text in array.ravel()]
    return array
