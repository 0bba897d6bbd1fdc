"""The result for programs: JSON with the numbers and its JSON Schema (draft 2020-12), CSV with one row a mode.

The schema is made from the types that the document is written from. Each number's meaning and unit stand in the
docstring of its type, under "Attributes:", and nowhere else; they become the descriptions of the schema. A test
compares the file `schema.json` beside this one with what is made here.
"""

import csv
import datetime as dt
import inspect
import io
import json
import math
import re
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from era.realisation import Realisation
from modal.acceptance.check import check_limits
from modal.acceptance.test_file import Specification
from modal.identification.result import Identification, OrderEvidence
from modal.modes.mode import Choice, Fit, Mode, numbered
from modal.preparation.kind import RecordKind
from modal.quality import DataQuality
from modal.sections.validation import Provenance, SourceFile, installed_version
from modal.sections.words import judgement_of
from modal.wording.text import csv_cell
from okid.excitation import Excitation
from okid.markov import MarkovParameters
from okid.observer import ObserverFit
from okid.record import Record
from okid.residuals import ResidualCheck

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
        **_closed(properties),
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


LARGE = (
    *("stabilisation", "autocorrelation", "system", "gain"),
    *("input_coefficients", "output_coefficients", "residual_covariance"),
)
"""Leave to result.npz what grows with the square of the channels, with the lags or with the square of the order."""

SCHEMA = "modal-report/2"
"""Name and version of the layout; the number rises when a reader of the old layout would go wrong."""


def schema_text() -> str:
    """The schema as it stands in `schema.json`."""
    return json.dumps(document_schema(), indent=1, ensure_ascii=False) + "\n"


def document_schema() -> dict[str, Any]:
    """The JSON Schema of what `modal.report.machine.json_text` writes."""
    texts = {"type": "array", "items": {"type": "string"}}
    several = type_schema(tuple[SourceFile, ...])
    properties: dict[str, Any] = {
        "schema": {"description": "name and version of this layout", "const": SCHEMA},
        "version": {"description": "of the program", "type": "string"},
        "command": {"description": "that made the result, empty where there was none", "type": "string"},
        "sources": {"description": "files as they were given", **texts},
        "files": {"description": "size and hash of each file that was read", **several},
        "remarks": {"description": "what the reader did to the data", **texts},
        "test": {"description": "what the test file says; null where there was none", **_nullable(_test())},
        "limits": {"description": "what became of each limit of the test file", "type": "array", "items": _limit()},
        "trust": {"enum": ["carried", "with care", "not carried"]},
        "words": {"description": "why, in sentences", **texts},
        "warnings": {"description": "sentences that the user must read", **texts},
        "records": {"description": "as used, without their samples", "type": "array", "items": record_schema()},
        "record_kind": _nullable(
            {"description": "as the data or the caller said it", "enum": list(get_args(RecordKind))}
        ),
        "choices": type_schema(tuple[Choice, ...]),
        "excitation": _nullable(described(Excitation)),
        "fit": described(Fit, more={"mean": {"description": "cross-validated fit, mean over outputs", **NUMBER}}),
        "modes": _modes(),
        "uncertainty": {"description": "null where it is not known", **_nullable(_uncertainty())},
        "order_evidence": described(OrderEvidence, leave_out=LARGE),
        "residuals": _nullable(described(ResidualCheck, leave_out=LARGE)),
        "observer": _nullable(described(ObserverFit, leave_out=("dt", *LARGE), more={"order": {"type": "integer"}})),
        "markov": described(MarkovParameters, leave_out=LARGE, more={"n_lags": {"type": "integer"}}),
        "realisation": described(Realisation, leave_out=("factors",)),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:okid-modal:{SCHEMA.replace('/', ':')}",
        "title": "Report of a modal identification",
        "description": "The numbers. Time histories, coefficients of the observer, pulse responses and the "
        "poles of the other model orders are in result.npz alone (modal.load). A number that is not finite is null.",
        **_closed(properties),
        "$defs": {"numbers": NUMBERS},
    }


def _modes() -> dict[str, Any]:
    number = {"description": "of the mode on every page: modes of the system first", "type": "integer", "minimum": 1}
    return _closed(
        {
            "indicator_caution": {"description": "n / (p q): model order over observer order times outputs", **NUMBER},
            "indicators_missing": {"description": "why the indicators are null", "type": "string"},
            "table": {"type": "array", "items": described(Mode, more={"number": number})},
        }
    )


def _uncertainty() -> dict[str, Any]:
    return _closed(
        {
            "method": {"enum": ["output error", "propagation"]},
            "degrees_of_freedom": {"description": "of the residuals; null where infinite", **NUMBER},
        }
    )


def _test() -> dict[str, Any]:
    text = {"type": "string"}
    day = _nullable({"type": "string", "format": "date"})
    words = ("channel", "kind", "maker", "model", "serial", "sensitivity", "dof", "note")
    sensor = _closed({**dict.fromkeys(words, text), "calibrated": day})
    return _closed(
        {
            **dict.fromkeys(("article", "operator", "place", "notes"), text),
            "date": day,
            "sensors": {"type": "array", "items": sensor},
        }
    )


def _limit() -> dict[str, Any]:
    text = {"type": "string"}
    return _closed(
        {
            **dict.fromkeys(("what", "required", "found", "sentence", "reason"), text),
            "state": {"enum": ["met", "not met", "cannot be told"]},
        }
    )


def _nullable(schema: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [schema, {"type": "null"}]}


_MODE_NUMBERS = tuple(
    field.name
    for field in fields(Mode)
    if field.name not in ("pole", "kind", "shape", "shape_std", "mass_std", "participation", "verdict", "reason")
    and field.name not in ("reappears", "doubts")
)


def json_text(
    result: Identification,
    provenance: Provenance,
    *,
    specification: Specification | None = None,
    quality: DataQuality | None = None,
) -> str:
    """The result without time histories and `LARGE` arrays; nan is null, a complex number is [real, imaginary]."""
    judgement = judgement_of(result, quality)
    document = {
        "schema": SCHEMA,
        "version": installed_version(),
        "command": provenance.command,
        "sources": provenance.sources,
        "files": provenance.files,
        "remarks": provenance.remarks,
        "test": None if specification is None else _test_document(specification),
        "limits": [] if specification is None else [_members(one) for one in check_limits(result, specification)],
        "trust": judgement.trust,
        "words": judgement.reasons,
        "warnings": result.warnings,
        "records": [record_document(record) for record in result.records],
        "record_kind": result.record_kind,
        "choices": result.choices,
        "excitation": result.excitation,
        "fit": {"mean": result.fit.mean, **_members(result.fit)},
        "modes": {
            "indicator_caution": result.modes.indicator_caution,
            "indicators_missing": result.modes.indicators_missing,
            "table": _mode_table(result),
        },
        "uncertainty": _uncertainty_document(result),
        "order_evidence": _members(result.order_evidence, leave_out=LARGE),
        "residuals": None if result.residuals is None else _members(result.residuals, leave_out=LARGE),
        "observer": None
        if result.observer is None
        else {"order": result.observer.order, **_members(result.observer, leave_out=("dt", *LARGE))},
        "markov": {"n_lags": result.markov.n_lags, **_members(result.markov, leave_out=LARGE)},
        "realisation": _members(result.realisation, leave_out=("factors",)),
    }
    lines = (f"{json.dumps(name)}: {json.dumps(as_json(value), allow_nan=False)}" for name, value in document.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def csv_text(result: Identification) -> str:
    """One row a mode in the order of its number; shapes in columns of their own, empty cells for what is not known."""
    outputs, inputs = result.channels.output_names, result.channels.input_names
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    header = ["mode", "verdict", "kind", *_MODE_NUMBERS, "pole_real", "pole_imaginary", "reason"]
    for word, names in (("shape", outputs), ("participation", inputs)):
        header += [csv_cell(f"{word} {name} {part}") for name in names for part in ("real", "imaginary")]
    header += [csv_cell(f"shape_std {name}") for name in outputs]
    writer.writerow(header)
    for number, mode in numbered(result.modes):
        row: list[object] = [number, mode.verdict, mode.kind]
        row += [number_cell(getattr(mode, name)) for name in _MODE_NUMBERS]
        row += [number_cell(mode.pole.real), number_cell(mode.pole.imag), csv_cell(mode.reason)]
        for component in (*mode.shape, *mode.participation):
            row += [number_cell(component.real), number_cell(component.imag)]
        row += [""] * len(outputs) if mode.shape_std is None else [number_cell(value) for value in mode.shape_std]
        writer.writerow(row)
    return file.getvalue()


def _test_document(specification: Specification) -> dict[str, object]:
    """What the test file says but the geometry, which is in the UFF file, and the limits, which stand beside it."""
    return _members(specification, leave_out=("geometry", "limits"))


def _uncertainty_document(result: Identification) -> dict[str, object] | None:
    known = result.uncertainty
    return None if known is None else {"method": known.method, "degrees_of_freedom": known.degrees_of_freedom}


def _mode_table(result: Identification) -> list[dict[str, object]]:
    """Every mode by frequency, as the model has them, with the number that it has on every page."""
    numbers = {id(mode): number for number, mode in numbered(result.modes)}
    return [{"number": numbers[id(mode)], **_members(mode)} for mode in result.modes]


def number_cell(value: object) -> object:
    """A number as a cell of a table: every digit of it, empty where it is not finite, yes or no for a truth value."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    number = float(value)  # type: ignore[arg-type]  # every other number of a mode is a float
    return repr(number) if math.isfinite(number) else ""


def record_document(record: Record) -> dict[str, object]:
    """What a record is, without its samples."""
    return {
        "name": record.name,
        "n_samples": record.n_samples,
        "dt": record.dt,
        "start_time": record.start_time,
        "input_hold": record.input_hold,
        "inputs": [{"name": n, "unit": u} for n, u in zip(record.input_names, record.input_units, strict=True)],
        "outputs": [{"name": n, "unit": u} for n, u in zip(record.output_names, record.output_units, strict=True)],
        "n_missing": int(record.n_samples - record.complete_rows().sum()),
    }


def _members(value: object, *, leave_out: tuple[str, ...] = ()) -> dict[str, object]:
    names = [field.name for field in fields(value)] if is_dataclass(value) else []
    return {name: getattr(value, name) for name in names if name not in leave_out and not name.startswith("_")}


def as_json(value: object) -> object:
    """Any value of a result as what JSON knows."""
    if isinstance(value, np.ndarray):
        plain = value.dtype.kind in "biu" or (value.dtype.kind == "f" and np.isfinite(value).all())
        return value.tolist() if plain else [as_json(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): as_json(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [as_json(item) for item in value]
    if is_dataclass(value):
        return as_json(_members(value))
    return _scalar(value)


def _scalar(value: object) -> object:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, complex):
        return [_scalar(value.real), _scalar(value.imag)]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dt.date):
        return value.isoformat()
    return value
