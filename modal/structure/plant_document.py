"""A plant with ports as plain values, and back: the part of a model file that `PlantModel.save` writes."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from modal.simulation.plant import LinearParameter, Plant, Port
from modal.structure.elements import Element
from modal.structure.plant_model import PlantModel
from okid.errors import InvalidDataError

__all__ = ["CHANNELS", "check_table", "plant_document", "plant_of", "table_of"]

CHANNELS = ("input_names", "output_names", "input_units", "output_units")
"""Keys that name the channels, in every kind of model file."""


def plant_document(model: PlantModel) -> dict[str, Any]:
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


def plant_of(given: Mapping[str, Any]) -> PlantModel:
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
    return PlantModel(plant, linear=linear)


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
