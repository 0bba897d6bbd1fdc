"""A model in a file: TOML, JSON or NPZ, which hold numbers and words only, or a Python file that makes it.

Nothing of a TOML, JSON or NPZ file is ever run. A Python file is run, because the user named it: it must end in .py and
define `model`.

A small chain in TOML:

    masses = [1.0, 1.0]
    stiffnesses = [400.0, 400.0]
    dampings = [0.4, 0.4]
    force_dofs = [1]
    sensor_dofs = [0, 1]
    sensor_kind = "acceleration"

What a model that can be kept in a file has: `save` and `load`.
"""

import json
import math
import os
import runpy
import tomllib
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
import numpy.typing as npt

from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.structure.model_document import KEPT, document_of, model_of
from okid.errors import InvalidDataError, UnreadableFileError

__all__ = ["KeptModel", "read_model", "write_model"]

_MOST_TEXT = 1 << 25
"""Bytes of a text file that are read at most: 32 MiB, a matrix of more than a thousand DOFs."""

_MOST_ARRAYS = 1 << 28
"""Bytes of the arrays of an NPZ file that are read at most, unpacked: 256 MiB."""

_OPTIONS = "options"
"""Member of an NPZ file that holds, as JSON text, what is no array."""

_NUMBERS = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
"""Numbers that JSON has no words for."""

_DAMAGE = (
    zipfile.BadZipFile,
    KeyError,
    TypeError,
    ValueError,
    EOFError,
    OSError,
    NotImplementedError,
    OverflowError,
    RecursionError,
)
"""What the parsers, numpy and our own types raise at a file that is not what it says."""


def read_model(path: str | Path, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> Any:
    """The model in a file.

    Args:
        path: Ends in .toml, .json, .npz or .py.
        catalogue: What holds the effects that the file names.

    Returns:
        A `StructuralModel` for masses or M, C, K; a `PlantModel` for a state space; from a Python file whatever its
        `model` is.

    Raises:
        UnreadableFileError: No such file, another ending, damaged, too large, unknown keys, or values of no model.
    """
    path = _path(path, UnreadableFileError)
    readers = {".toml": _read_toml, ".json": _read_json, ".npz": _read_npz}
    ending = path.suffix.lower()
    if ending not in readers and ending != ".py":
        raise UnreadableFileError(
            f"a model file ends in .toml, .json, .npz or .py, but {path.name} does not; rename it."
        )
    if not path.is_file():
        raise UnreadableFileError(f"there is no file {path}; give the path of a model file.")
    if ending == ".py":
        return _run(path)
    try:
        return model_of(readers[ending](path), catalogue=catalogue)
    except UnreadableFileError:
        raise
    except InvalidDataError as error:
        raise UnreadableFileError(f"{path}: {error}") from error
    except _DAMAGE as error:
        words = " ".join(str(error).split()).rstrip(".")
        raise UnreadableFileError(
            f"{path} is damaged or no model file ({words or type(error).__name__}); save or write it again."
        ) from error


def write_model(model: "KeptModel", path: str | Path, *, existing: Literal["refuse", "replace"] = "refuse") -> Path:
    """Write a model into a file that `read_model` reads, every number exactly.

    Args:
        model: What to keep.
        path: Ends in .toml, .json or .npz.
        existing: "refuse" (an error when the file is there) or "replace".

    Returns:
        The path.

    Raises:
        InvalidDataError: No model, another ending, no folder, the file is there already, or it cannot be written.
    """
    _check_model(model)
    kept: Any = model
    path = _path(path, InvalidDataError)
    if existing not in get_args(Literal["refuse", "replace"]):
        raise InvalidDataError(f"existing must be refuse or replace, but is {existing!r}.")
    writers = {".toml": _write_toml, ".json": _write_json, ".npz": _write_npz}
    if path.suffix.lower() not in writers:
        raise InvalidDataError(f"a model is written to a file that ends in .toml, .json or .npz, but not {path.name}.")
    if path.is_dir() or (existing == "refuse" and path.exists()):
        raise InvalidDataError(f"{path} exists already; choose another name, or pass existing='replace' for a file.")
    if not path.parent.is_dir():
        raise InvalidDataError(f"the folder {path.parent} does not exist; make it first.")
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            writers[path.suffix.lower()](unfinished, document_of(kept))
            unfinished.replace(path)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise InvalidDataError(f"{path} cannot be written ({error.strerror or error}); use another place.") from error
    return path


def _check_model(model: object) -> None:
    if isinstance(model, KeptModel):
        return
    inner = isinstance(getattr(model, "model", None), KeptModel)
    remedy = "pass its .model" if inner else "make one of them first"
    raise InvalidDataError(
        f"write_model keeps a StructuralModel or a PlantModel, but a {type(model).__name__} was given; {remedy}."
    )


def _path(path: Any, error: type[UnreadableFileError | InvalidDataError]) -> Path:
    if not isinstance(path, str | os.PathLike):
        raise error(f"the path of a model file is text or a Path, but a {type(path).__name__} was given.")
    return Path(path)


# --- reading ---------------------------------------------------------------------------------------------------------


def _text(path: Path) -> str:
    if path.stat().st_size > _MOST_TEXT:
        raise UnreadableFileError(
            f"{path} has {path.stat().st_size} bytes, and a model in words at most {_MOST_TEXT}; use NPZ."
        )
    return path.read_text(encoding="utf-8")


def _read_toml(path: Path) -> Any:
    return tomllib.loads(_text(path))


def _read_json(path: Path) -> Any:
    return _with_numbers(json.loads(_text(path)))


def _with_numbers(value: Any) -> Any:
    """The value with "nan", "inf" and "-inf" in number places read as numbers; names are never these words."""
    if isinstance(value, dict):
        return {key: _with_numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_numbers(item) for item in value]
    return _NUMBERS.get(value, value) if isinstance(value, str) else value


def _read_npz(path: Path) -> Any:
    document: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
        if size > _MOST_ARRAYS:
            raise UnreadableFileError(f"{path} unpacks to {size} bytes, and a model to at most {_MOST_ARRAYS}.")
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            document[name] = _plain(_array(archive, member))
    options = document.pop(_OPTIONS, "{}")
    return {**_with_numbers(json.loads(options)), **document}


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> npt.NDArray[Any]:
    """One array, of which the header must not ask for more than the member holds."""
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        shape, _, dtype = read_header[version](stream)
        if dtype.hasobject or math.prod(shape) * dtype.itemsize > member.file_size:
            raise ValueError(f"{member.filename} is no plain array")
    with archive.open(member) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


def _plain(array: npt.NDArray[Any]) -> Any:
    """Words and single numbers as Python has them, other arrays as they are."""
    if array.dtype.kind in "US" or array.ndim == 0:
        return array.astype(str).tolist() if array.dtype.kind in "US" else array.item()
    return array


def _run(path: Path) -> Any:
    try:
        names = runpy.run_path(str(path))
    except (Exception, SystemExit) as error:
        words = " ".join(str(error).split()).rstrip(".")
        raise UnreadableFileError(f"{path} stopped with {type(error).__name__} ({words}); run it by itself.") from error
    if "model" not in names:
        raise UnreadableFileError(f"{path} must define `model`, but does not; add model = modal.StructuralModel(...).")
    return names["model"]


# --- writing ---------------------------------------------------------------------------------------------------------


def _write_json(path: Path, document: dict[str, Any]) -> None:
    path.write_text(json.dumps(_as_lists(document), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _write_toml(path: Path, document: dict[str, Any]) -> None:
    lines = [f"{key} = {_toml(value)}\n" for key, value in document.items()]
    path.write_text("".join(lines), encoding="utf-8")


def _write_npz(path: Path, document: dict[str, Any]) -> None:
    arrays = {name: value for name, value in document.items() if isinstance(value, np.ndarray)}
    options = {name: value for name, value in document.items() if name not in arrays}
    text = json.dumps(_as_lists(options), allow_nan=False)
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays, **{_OPTIONS: np.array(text)})


def _as_lists(value: Any) -> Any:
    """The value for JSON: arrays and tuples as lists, numbers that JSON lacks as words."""
    if isinstance(value, dict):
        return {key: _as_lists(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _as_lists(value.tolist())
    if isinstance(value, list | tuple):
        return [_as_lists(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def _toml(value: Any) -> str:
    """A value in TOML; tables stand in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, np.ndarray):
        return _toml(value.tolist())
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, str):
        return json.dumps(value).replace("\x7f", "\\u007f")
    return repr(float(value)) if isinstance(value, float) else str(value).lower()


class KeptModel:
    """Saving and loading, for the models that `modal.structure.model_file` knows."""

    __slots__ = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        KEPT[cls.__name__] = cls

    def save(self, path: str | Path, *, existing: Literal["refuse", "replace"] = "refuse") -> Path:
        """Write the model as TOML, JSON or NPZ, by the ending of the path; read it with `load`.

        Args:
            path: Of the file.
            existing: "refuse" (an error when the file is there) or "replace".

        Raises:
            InvalidDataError: Another ending, the file is there already, or it cannot be written.
        """
        return write_model(self, path, existing=existing)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read such a model from a file.

        Args:
            path: Of the file.

        Raises:
            UnreadableFileError: No such file, or one that holds no such model.
        """
        model = read_model(path)
        if not isinstance(model, cls):
            raise UnreadableFileError(
                f"{path} holds a {type(model).__name__}, not a {cls.__name__}; read it with modal.read_model."
            )
        return model
