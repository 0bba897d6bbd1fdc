"""The whole schema of a report's JSON: the keys of the document, and the types behind them."""

import json
from typing import Any

from era.realisation import Realisation
from modal.identification.result import Choice, Fit, OrderEvidence
from modal.modes.mode import Mode
from modal.report.schema import NUMBER, NUMBERS, described, record_schema, type_schema
from modal.sections.provenance import SourceFile
from okid.excitation import Excitation
from okid.markov import MarkovParameters
from okid.observer import ObserverFit
from okid.residuals import ResidualCheck

__all__ = ["SCHEMA", "document_schema", "schema_text"]

SCHEMA = "modal-report/1"
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
        "choices": type_schema(tuple[Choice, ...]),
        "excitation": described(Excitation),
        "fit": described(Fit, more={"mean": {"description": "cross-validated fit, mean over outputs", **NUMBER}}),
        "modes": _modes(),
        "uncertainty": {"description": "null where it is not known", **_nullable(_uncertainty())},
        "order_evidence": described(OrderEvidence),
        "residuals": described(ResidualCheck),
        "observer": described(ObserverFit, leave_out=("dt",), more={"order": {"type": "integer"}}),
        "markov": described(MarkovParameters),
        "realisation": described(Realisation, leave_out=("factors",)),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:okid-modal:{SCHEMA.replace('/', ':')}",
        "title": "Report of a modal identification",
        "description": "Every number of the result but its time histories. A number that is not finite is null.",
        **_object(properties),
        "$defs": {"numbers": NUMBERS},
    }


def _modes() -> dict[str, Any]:
    number = {"description": "of the mode on every page: modes of the system first", "type": "integer", "minimum": 1}
    return _object(
        {
            "indicator_caution": {"description": "n / (p q): model order over observer order times outputs", **NUMBER},
            "indicators_missing": {"description": "why the indicators are null", "type": "string"},
            "table": {"type": "array", "items": described(Mode, more={"number": number})},
        }
    )


def _uncertainty() -> dict[str, Any]:
    return _object(
        {
            "method": {"enum": ["output error", "propagation"]},
            "degrees_of_freedom": {"description": "of the residuals; null where infinite", **NUMBER},
        }
    )


def _test() -> dict[str, Any]:
    text = {"type": "string"}
    day = _nullable({"type": "string", "format": "date"})
    words = ("channel", "kind", "maker", "model", "serial", "sensitivity", "dof", "note")
    sensor = _object({**dict.fromkeys(words, text), "calibrated": day})
    return _object(
        {
            **dict.fromkeys(("article", "operator", "place", "notes"), text),
            "date": day,
            "sensors": {"type": "array", "items": sensor},
        }
    )


def _limit() -> dict[str, Any]:
    text = {"type": "string"}
    return _object(
        {
            **dict.fromkeys(("what", "required", "found", "sentence", "reason"), text),
            "state": {"enum": ["met", "not met", "cannot be told"]},
        }
    )


def _nullable(schema: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [schema, {"type": "null"}]}


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}
