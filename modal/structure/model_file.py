"""A model in a file: TOML, JSON or NPZ, which hold numbers and words only, or a Python file that makes it.

Nothing of a TOML, JSON or NPZ file is ever run. A Python file is run, because the user named it: it must end in .py and
define `model`. TOML is for hands, JSON for programs, NPZ for matrices too large for words; each costs a few lines here.

In whatever format, a model is a table of plain values. Four kinds are told apart by their keys:
    masses ...   a chain, as StructuralModel.chain takes it;
    mass ...     (or M, C, K) matrices, as StructuralModel takes them;
    A, B, C, D   a state space, in continuous time unless it has a `dt`; D alone is a plant without dynamics;
    system ...   a plant with ports, as `save` writes it.
Any of them may have effects: [{effect = "cubic_stiffness", where = "element_1", values = {k3 = 2e5}}].

A small chain in TOML:

    masses = [1.0, 1.0]
    stiffnesses = [400.0, 400.0]
    dampings = [0.4, 0.4]
    force_dofs = [1]
    sensor_dofs = [0, 1]
    sensor_kind = "acceleration"
"""

import json
import math
import os
import runpy
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import numpy as np
import numpy.typing as npt

from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.simulation.plant import LinearParameter, Plant, Port
from modal.structure.placed import PlacedEffect, placed_effect
from modal.structure.structural_plant import Element, place_name, structural_plant
from modal.wording.text import shorten
from okid.display import Displayed
from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers.arrays import array_of
from okid.readers.guard import Existing, foreign, new_file, sound_archive

if TYPE_CHECKING:
    from modal.structure.given import PlantModel
    from modal.structure.structural_model import StructuralModel

_MOST_TEXT = 1 << 25
"""Read no text file of more bytes: 32 MiB, a matrix of more than a thousand DOFs."""

_OPTIONS = "options"
"""Member of an NPZ file that holds, as JSON text, what is no array."""

_NUMBERS = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
"""Numbers that JSON has no words for."""

CHANNELS = ("input_names", "output_names", "input_units", "output_units")
"""Keys that name the channels, in every kind of model file."""


_STRUCTURE = (
    *CHANNELS,
    "sensor_kind",
    "base_motion",
    "length_unit",
    "force_unit",
    "stiffness_tolerance",
    "damping_tolerance",
    "mass_tolerance",
)
_KEYS = {
    "a chain": ("masses", "stiffnesses", "dampings", "force_dofs", "sensor_dofs", *_STRUCTURE),
    "a structure": ("mass", "damping", "stiffness", "force_map", "sensor_map", "elements", *_STRUCTURE),
    "a state space": (
        "A",
        "B",
        "C",
        "D",
        "dt",
        "sensor_kind",
        "input_hold",
        "frequency_tolerance",
        "damping_tolerance",
        *CHANNELS,
    ),
    "a plant": ("system", "n_states", "n_inputs", "parameters", "ports", "linear", *CHANNELS),
}
_NEEDED = {
    "a chain": ("masses", "stiffnesses", "dampings", "force_dofs", "sensor_dofs"),
    "a structure": ("mass", "damping", "stiffness", "force_map", "sensor_map", "sensor_kind"),
    "a state space": ("D",),
    "a plant": ("system", "n_states", "n_inputs", "parameters", "ports", *CHANNELS),
}
_GROUND = "ground"


class KeptModel(Displayed):
    """A model that can be kept in a file.

    Class attributes:
        types: The types of such models by name: each enters itself where it is defined, so that this chapter can make
            them without importing those who import it.
    """

    __slots__ = ()
    types: ClassVar[dict[str, Any]] = {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        KeptModel.types[cls.__name__] = cls

    def save(self, path: str | Path, *, existing: Existing = "refuse") -> Path:
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
    with foreign(path, "model file"):
        document = readers[ending](path)
        try:
            return _model_of(document, catalogue=catalogue)
        except InvalidDataError as error:
            raise UnreadableFileError(f"{path}: {error}") from error


def write_model(model: "KeptModel", path: str | Path, *, existing: Existing = "refuse") -> Path:
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
    writers = {".toml": _write_toml, ".json": _write_json, ".npz": _write_npz}
    if path.suffix.lower() not in writers:
        raise InvalidDataError(f"a model is written to a file that ends in .toml, .json or .npz, but not {path.name}.")
    with new_file(path, existing) as part:
        writers[path.suffix.lower()](part, _document_of(kept))
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
    return path.read_text(encoding="utf-8-sig")


def _read_toml(path: Path) -> Any:
    return tomllib.loads(_text(path))


def _read_json(path: Path) -> Any:
    return _with_numbers(json.loads(_text(path), object_pairs_hook=_once))


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON, whose names must differ as those of TOML do: of two values nobody could say which is meant."""
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = next(name for name, _ in pairs if sum(name == other for other, _ in pairs) > 1)
        raise ValueError(f"{twice!r} is given twice")
    return found


def _with_numbers(value: Any) -> Any:
    """The value with "nan", "inf" and "-inf" in number places read as numbers; names are never these words."""
    if isinstance(value, dict):
        return {key: _with_numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_numbers(item) for item in value]
    return _NUMBERS.get(value, value) if isinstance(value, str) else value


def _read_npz(path: Path) -> Any:
    document: dict[str, Any] = {}
    with sound_archive(path, most=1 << 28) as archive:  # 256 MiB unpacked
        for member in archive.infolist():
            document[member.filename.removesuffix(".npy")] = _plain(array_of(archive, member))
    options = document.pop(_OPTIONS, "{}")
    return {**_with_numbers(json.loads(options)), **document}


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


# --- to plain values -------------------------------------------------------------------------------------------------


def _document_of(model: "StructuralModel | PlantModel") -> dict[str, Any]:
    """The model as a table of numbers, words, lists and tables; arrays stay arrays."""
    if hasattr(model, "plant"):
        document = _plant_table(cast("PlantModel", model))
    else:
        document = {name: getattr(model, name) for name in ("mass", "damping", "stiffness", "force_map", "sensor_map")}
        document |= {name: list(getattr(model, name)) for name in ("sensor_kind", *CHANNELS)}
        document |= {name: getattr(model, name) for name in ("length_unit", "force_unit")}
        document |= {name: getattr(model, name) for name in ("stiffness_tolerance", "damping_tolerance")}
        if model.mass_tolerance is not None:
            document["mass_tolerance"] = model.mass_tolerance
        document["elements"] = [_table_of(element) for element in model.elements]
        if model.base_motion is not None:
            document["base_motion"] = model.base_motion
    if model.effects:
        document["effects"] = [_effect_table(one) for one in model.effects]
    return document


def _effect_table(one: PlacedEffect) -> dict[str, Any]:
    values = zip(one.names, one.values, one.local_values, strict=True)
    table: dict[str, Any] = {
        "effect": one.effect,
        "where": one.where,
        "values": {name: list(own) if own else value for name, value, own in values},
    }
    known = {name: size for name, size in zip(one.names, one.deviations, strict=True) if not np.isnan(size)}
    if known:
        table["deviations"] = known
    if one.direction:
        table["direction"] = list(one.direction)
    return table


# --- from plain values -----------------------------------------------------------------------------------------------


def _model_of(
    document: Mapping[str, Any], *, catalogue: Mapping[str, Effect] = CATALOGUE
) -> "StructuralModel | PlantModel":
    """The model that a table of plain values describes.

    Raises:
        InvalidDataError: A key that is missing or not known, or a value that the model refuses.
    """
    if not isinstance(document, Mapping):
        raise InvalidDataError(f"a model is a table of keys and values, but this is a {type(document).__name__}.")
    given = dict(document)
    if {"M", "K"} <= given.keys():
        given |= {
            long: given.pop(short)
            for short, long in (("M", "mass"), ("C", "damping"), ("K", "stiffness"))
            if short in given
        }
    effects = given.pop("effects", [])
    kind = _kind(given)
    _check_keys(kind, given)
    builders: dict[str, Callable[[dict[str, Any]], Any]] = {
        "a chain": _chain,
        "a structure": _structure,
        "a state space": _state_space,
        "a plant": _plant,
    }
    model = builders[kind](given)
    if not isinstance(effects, Sequence) or isinstance(effects, str):
        raise InvalidDataError(f"effects must be a list of tables, but is {effects!r}.")
    plant = model.plant if hasattr(model, "plant") else structural_plant(model)
    return replace(model, effects=tuple(_effect(model, plant, one, catalogue) for one in effects))


def _kind(given: Mapping[str, Any]) -> str:
    for kind, key in (("a chain", "masses"), ("a structure", "mass"), ("a plant", "system"), ("a state space", "D")):
        if key in given:
            return kind
    if "A" in given:
        return "a state space"
    raise InvalidDataError(
        "a model file holds masses (a chain), mass or M (matrices), or A, B, C, D (a state space), but this one holds "
        f"{', '.join(given) or 'nothing'}."
    )


def _check_keys(kind: str, given: Mapping[str, Any]) -> None:
    unknown = [str(key) for key in given if key not in _KEYS[kind]]
    if unknown:
        raise InvalidDataError(
            f"{kind} has no key {shorten(', '.join(unknown), 200)}; the keys are "
            f"{', '.join(dict.fromkeys(_KEYS[kind]))}, effects."
        )
    missing = [key for key in _NEEDED[kind] if key not in given]
    if missing:
        raise InvalidDataError(f"{kind} needs {', '.join(_NEEDED[kind])}, but {', '.join(missing)} is missing.")


def _chain(given: dict[str, Any]) -> "StructuralModel":
    return cast("StructuralModel", KeptModel.types["StructuralModel"].chain(**given))


def _structure(given: dict[str, Any]) -> "StructuralModel":
    if "elements" in given:
        given["elements"] = tuple(_element(one) for one in given["elements"])
    return cast("StructuralModel", KeptModel.types["StructuralModel"](**given))


def _element(one: Any) -> Any:
    """An element from a table, or a pair of numbers in which "ground", null or -1 is the ground."""
    if isinstance(one, Mapping):
        _check_table(one, Element, "an element")
        end = one.get("end")
        return Element(**{**one, "end": None if end == _GROUND else end})
    if isinstance(one, Sequence | np.ndarray) and not isinstance(one, str):
        return tuple(None if end in (_GROUND, -1, None) else end for end in one)
    raise InvalidDataError(f'an element is a table or a pair such as [0, 1] or [0, "ground"], but is {one!r}.')


def _state_space(given: dict[str, Any]) -> "PlantModel":
    D = np.atleast_2d(np.asarray(given.pop("D", 0.0), dtype=np.float64))
    A = np.asarray(given.pop("A", np.zeros((0, 0))), dtype=np.float64)
    B, C = given.pop("B", np.zeros((0, D.shape[1]))), given.pop("C", np.zeros((D.shape[0], 0)))
    system = SimpleNamespace(A=A, B=B, C=C, D=D, dt=given.pop("dt", 0.0))
    if A.size and "sensor_kind" not in given:
        raise InvalidDataError(
            "a state space needs sensor_kind, which says what its outputs are: displacement, velocity or acceleration."
        )
    plant: type[PlantModel] = KeptModel.types["PlantModel"]
    return plant.from_state_space(system, sensor_kind=given.pop("sensor_kind", "displacement"), **given)


def _effect(
    model: "StructuralModel | PlantModel", plant: Plant, one: Any, catalogue: Mapping[str, Effect]
) -> PlacedEffect:
    keys = ("effect", "where", "values", "deviations", "direction")
    if not isinstance(one, Mapping) or not {"effect", "where", "values"} <= one.keys() or not one.keys() <= set(keys):
        raise InvalidDataError(
            f"an effect is a table of {', '.join(keys)}, of which the first three must be there, but is {one!r}."
        )
    return placed_effect(
        plant,
        catalogue.get(one["effect"], one["effect"]),
        one["where"] if hasattr(model, "plant") else place_name(model, one["where"]),
        one["values"],
        deviations=one.get("deviations"),
        direction=one.get("direction", ()),
    )


def _plant_table(model: "PlantModel") -> dict[str, Any]:
    """The plant of a model as a table; its arrays stay arrays."""
    plant = model.plant
    return {
        "system": plant.system,
        "n_states": plant.n_states,
        "n_inputs": plant.n_inputs,
        "linear": model.linear,
        "parameters": [_table_of(parameter) for parameter in plant.parameters],
        "ports": [{**_table_of(port), "accepts": sorted(port.accepts)} for port in plant.ports],
        **{name: list(getattr(plant, name)) for name in CHANNELS},
    }


def _plant(given: Mapping[str, Any]) -> "PlantModel":
    """The model that a table describes, without effects.

    Raises:
        InvalidDataError: A table with other keys, or parts that do not fit together.
    """
    linear: Any = given.get("linear")
    for one in given["parameters"]:
        _check_table(one, LinearParameter, "a linear parameter")
    for one in given["ports"]:
        _check_table(one, Port, "a port")
    channels: dict[str, Any] = {name: tuple(given[name]) for name in CHANNELS}
    plant = Plant(
        system=given["system"],
        n_states=int(given["n_states"]),
        n_inputs=int(given["n_inputs"]),
        parameters=tuple(LinearParameter(**one) for one in given["parameters"]),
        ports=tuple(_port(one) for one in given["ports"]),
        **channels,
    )
    _check_plant(plant)
    return cast("PlantModel", KeptModel.types["PlantModel"](plant, linear=linear))


def _port(one: Mapping[str, Any]) -> Port:
    rows = {
        name: None if one.get(name) is None else np.array(one[name], dtype=np.float64)
        for name in ("displacement", "velocity")
    }
    return Port(**{**one, **rows, "columns": tuple(one["columns"]), "accepts": frozenset(one["accepts"])})


def _check_plant(plant: Plant) -> None:
    """Raise unless the sizes fit together."""
    sizes = {
        "system": (plant.system.ndim, plant.system.shape[0]) == (3, 1 + len(plant.parameters)),
        "n_states": plant.n_states >= 0 and plant.n_forces >= 0,
        "input_names": len(plant.input_names) == len(plant.input_units) == plant.n_inputs,
        "output_names": len(plant.output_names) == len(plant.output_units) == plant.n_outputs,
    }
    width = plant.n_states + plant.n_inputs
    for port in plant.ports:
        rows = [row.shape == (width,) for row in (port.displacement, port.velocity) if row is not None]
        sizes[f"port {port.name}"] = all(rows) and all(0 <= column < plant.n_forces for column in port.columns)
    wrong = [name for name, fits in sizes.items() if not fits]
    if wrong:
        raise InvalidDataError(
            f"the parts of a plant must fit together, but {', '.join(wrong)} does not; save it again."
        )


def _table_of(value: LinearParameter | Port | Element) -> dict[str, Any]:
    """The fields that hold something."""
    named = {field.name: getattr(value, field.name) for field in fields(value)}
    return {name: item for name, item in named.items() if item is not None}


def _check_table(one: Any, kind: type, words: str) -> None:
    """Raise unless a table has no keys but the fields of a type.

    Raises:
        InvalidDataError: It has others, or is no table.
    """
    known = [field.name for field in fields(kind)]
    if not isinstance(one, Mapping) or not one.keys() <= set(known):
        raise InvalidDataError(f"{words} is a table of {', '.join(known)}, but is {one!r}.")
