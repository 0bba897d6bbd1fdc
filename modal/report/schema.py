"""The JSON Schema (draft 2020-12) of a report's JSON, made from the types that it is written from.

Each number's meaning and unit stand in the docstring of its type, under "Attributes:", and nowhere else; they become
the descriptions of the schema. The file `schema.json` beside this one is what `modal.report.document_schema` makes; a
test compares the two.
"""

import datetime as dt
import inspect
import re
import types
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

__all__ = ["described", "record_schema", "schema_file", "type_schema"]

NUMBER = {"type": ["number", "null"]}
"""A float: null where it is not finite."""

COMPLEX = {"type": "array", "prefixItems": [NUMBER, NUMBER], "items": False, "minItems": 2}
"""Real and imaginary part."""

NUMBERS = {
    "description": "numbers, nested as deep as the array has dimensions; a complex one is [real, imaginary]",
    "type": "array",
    "items": {"anyOf": [NUMBER, {"$ref": "#/$defs/numbers"}]},
}

_SIMPLE: dict[Any, dict[str, Any]] = {
    float: NUMBER,
    complex: COMPLEX,
    int: {"type": "integer"},
    bool: {"type": "boolean"},
    str: {"type": "string"},
    types.NoneType: {"type": "null"},
    dt.date: {"type": "string", "format": "date"},
}


def schema_file() -> Path:
    """Where the schema lies in the installed package."""
    return Path(__file__).with_name("schema.json")


def type_schema(hint: Any) -> dict[str, Any]:
    """The schema of what JSON holds for a value of a type.

    Args:
        hint: a type as it stands in a field of a frozen dataclass.

    Raises:
        TypeError: a type that no result has.

    Example:
        >>> type_schema(float), type_schema(Literal["a", "b"]), type_schema(int | None)
        ({'type': ['number', 'null']}, {'enum': ['a', 'b']}, {'anyOf': [{'type': 'integer'}, {'type': 'null'}]})
    """
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (np.ndarray, Literal):
        return {"$ref": "#/$defs/numbers"} if origin is np.ndarray else {"enum": list(parts)}
    if origin in (Union, types.UnionType):
        return {"anyOf": [type_schema(part) for part in parts]}
    if origin is tuple and parts[-1] is Ellipsis:
        return {"type": "array", "items": type_schema(parts[0])}
    if origin is tuple:
        items = [type_schema(part) for part in parts]
        return {"type": "array", "prefixItems": items, "items": False, "minItems": len(items)}
    if is_dataclass(hint):
        return described(hint)
    raise TypeError(f"no schema for {hint}")


def described(kind: Any, *, leave_out: tuple[str, ...] = (), more: dict[str, Any] | None = None) -> dict[str, Any]:
    """An object with the fields of a dataclass, each with the words of its docstring; other keys are not allowed.

    Args:
        kind: the dataclass.
        leave_out: fields that the JSON does not have.
        more: keys that it has beside the fields, with their schemas; they come first.
    """
    hints, words = get_type_hints(kind), _attributes(kind)
    properties = dict(more or {})
    for field in fields(kind):
        if field.name not in leave_out and not field.name.startswith("_"):
            description = {"description": words[field.name]} if field.name in words else {}
            properties[field.name] = {**description, **type_schema(hints[field.name])}
    return {
        "description": (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " "),
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def record_schema() -> dict[str, Any]:
    """A record without its samples."""
    channel = _closed({"name": {"type": "string"}, "unit": {"type": "string"}})
    return _closed(
        {
            "name": {"type": "string"},
            "n_samples": {"type": "integer"},
            "dt": {"description": "time step [s]", **NUMBER},
            "start_time": {"description": "[s]", **NUMBER},
            "input_hold": {"enum": ["zero_order", "linear", "band_limited"]},
            "inputs": {"type": "array", "items": channel},
            "outputs": {"type": "array", "items": channel},
            "n_missing": {"description": "rows with a missing value", "type": "integer"},
        }
    )


def _closed(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}


def _attributes(kind: Any) -> dict[str, str]:
    """Name and words of each entry under "Attributes:" or "Args:" in a docstring."""
    text = inspect.getdoc(kind) or ""
    found = re.search(r"^(?:Attributes|Args):\n((?:[ ]{4}.*\n?|\n)*)", text, re.MULTILINE)
    if found is None:
        return {}
    entries = re.findall(r"^ {4}([\w, ]+?)(?: \([^)]*\))?: (.*(?:\n {8,}.*)*)", found[1], re.MULTILINE)
    return {name.strip(): " ".join(words.split()) for names, words in entries for name in names.split(",")}
