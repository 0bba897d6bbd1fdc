"""A model as plain values (numbers, words, lists, tables), and back: what stands in a model file, whatever its format.

Four kinds of model, told apart by their keys:
    masses ...   a chain, as StructuralModel.chain takes it;
    mass ...     (or M, C, K) matrices, as StructuralModel takes them;
    A, B, C, D   a state space, in continuous time unless it has a `dt`; D alone is a plant without dynamics;
    system ...   a plant with ports, as `save` writes it.
Any of them may have effects: [{effect = "cubic_stiffness", where = "element_1", values = {k3 = 2e5}}].

A plant with ports as plain values, and back: the part of a model file that `PlantModel.save` writes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from modal.effects.catalogue import CATALOGUE
from modal.effects.effect import Effect
from modal.simulation.plant import LinearParameter, Plant, Port
from modal.structure.elements import Element
from modal.structure.placed import PlacedEffect, placed_effect
from modal.structure.structural_plant import place_name, structural_plant
from okid.errors import InvalidDataError

if TYPE_CHECKING:
    from modal.structure.plant_model import PlantModel
    from modal.structure.structural_model import StructuralModel

__all__ = ["CHANNELS", "KEPT", "check_table", "document_of", "model_of", "plant_document", "plant_of", "table_of"]

KEPT: dict[str, Any] = {}
"""The types of model that can be kept in a file, by name; each enters itself where it is defined."""

CHANNELS = ("input_names", "output_names", "input_units", "output_units")
"""Keys that name the channels, in every kind of model file."""


def plant_document(model: "PlantModel") -> dict[str, Any]:
    """The plant of a model as a table; its arrays stay arrays."""
    plant = model.plant
    return {
        "system": plant.system,
        "n_states": plant.n_states,
        "n_inputs": plant.n_inputs,
        "linear": model.linear,
        "parameters": [table_of(parameter) for parameter in plant.parameters],
        "ports": [{**table_of(port), "accepts": sorted(port.accepts)} for port in plant.ports],
        **{name: list(getattr(plant, name)) for name in CHANNELS},
    }


def plant_of(given: Mapping[str, Any]) -> "PlantModel":
    """The model that a table describes, without effects.

    Raises:
        InvalidDataError: A table with other keys, or parts that do not fit together.
    """
    linear: Any = given.get("linear")
    for one in given["parameters"]:
        check_table(one, LinearParameter, "a linear parameter")
    for one in given["ports"]:
        check_table(one, Port, "a port")
    plant = Plant(
        system=given["system"],
        n_states=int(given["n_states"]),
        n_inputs=int(given["n_inputs"]),
        parameters=tuple(LinearParameter(**one) for one in given["parameters"]),
        ports=tuple(_port(one) for one in given["ports"]),
        **{name: tuple(given[name]) for name in CHANNELS},
    )
    _check_plant(plant)
    return cast("PlantModel", KEPT["PlantModel"](plant, linear=linear))


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


def table_of(value: LinearParameter | Port | Element) -> dict[str, Any]:
    """The fields that hold something."""
    named = {field.name: getattr(value, field.name) for field in fields(value)}
    return {name: item for name, item in named.items() if item is not None}


def check_table(one: Any, kind: type, words: str) -> None:
    """Raise unless a table has no keys but the fields of a type.

    Raises:
        InvalidDataError: It has others, or is no table.
    """
    known = [field.name for field in fields(kind)]
    if not isinstance(one, Mapping) or not one.keys() <= set(known):
        raise InvalidDataError(f"{words} is a table of {', '.join(known)}, but is {one!r}.")


_STRUCTURE = (
    *CHANNELS,
    "sensor_kind",
    "base_motion",
    "length_unit",
    "force_unit",
    "stiffness_tolerance",
    "damping_tolerance",
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


# --- to plain values -------------------------------------------------------------------------------------------------


def document_of(model: "StructuralModel | PlantModel") -> dict[str, Any]:
    """The model as a table of numbers, words, lists and tables; arrays stay arrays."""
    if hasattr(model, "plant"):
        document = plant_document(cast("PlantModel", model))
    else:
        document = {name: getattr(model, name) for name in ("mass", "damping", "stiffness", "force_map", "sensor_map")}
        document |= {name: list(getattr(model, name)) for name in ("sensor_kind", *CHANNELS)}
        document |= {name: getattr(model, name) for name in ("length_unit", "force_unit")}
        document |= {name: getattr(model, name) for name in ("stiffness_tolerance", "damping_tolerance")}
        document["elements"] = [table_of(element) for element in model.elements]
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


def model_of(
    document: Mapping[str, Any], *, catalogue: Mapping[str, Effect] = CATALOGUE
) -> "StructuralModel | PlantModel":
    """The model that a table of plain values describes.

    Args:
        document: As read from a file.
        catalogue: What holds the effects.

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
        "a plant": plant_of,
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
            f"{kind} has no key {', '.join(unknown)}; the keys are {', '.join(dict.fromkeys(_KEYS[kind]))}, effects."
        )
    missing = [key for key in _NEEDED[kind] if key not in given]
    if missing:
        raise InvalidDataError(f"{kind} needs {', '.join(_NEEDED[kind])}, but {', '.join(missing)} is missing.")


def _chain(given: dict[str, Any]) -> "StructuralModel":
    structure: type[StructuralModel] = KEPT["StructuralModel"]
    return structure.chain(**given)


def _structure(given: dict[str, Any]) -> "StructuralModel":
    if "elements" in given:
        given["elements"] = tuple(_element(one) for one in given["elements"])
    structure: type[StructuralModel] = KEPT["StructuralModel"]
    return structure(**given)


def _element(one: Any) -> Any:
    """An element from a table, or a pair of numbers in which "ground", null or -1 is the ground."""
    if isinstance(one, Mapping):
        check_table(one, Element, "an element")
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
    plant: type[PlantModel] = KEPT["PlantModel"]
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
