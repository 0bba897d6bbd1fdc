"""The result for programs: JSON with every number, CSV with one row a mode."""

import csv
import datetime as dt
import io
import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import numpy as np

from modal.acceptance.check import check_limits
from modal.acceptance.test_file import Specification
from modal.identification.result import Identification
from modal.identification.trust import trust_of
from modal.modes.mode import Mode
from modal.modes.numbering import numbered
from modal.report.document_schema import SCHEMA, schema_text
from modal.sections.provenance import Provenance, installed_version
from modal.wording.names import csv_cell
from okid.record import Record

__all__ = ["SCHEMA", "as_json", "csv_text", "json_text", "number_cell", "record_document", "schema_text"]

_MODE_NUMBERS = tuple(
    field.name
    for field in fields(Mode)
    if field.name not in ("pole", "kind", "shape", "shape_std", "participation", "verdict", "reason")
)


def json_text(result: Identification, provenance: Provenance, *, specification: Specification | None = None) -> str:
    """The whole result but its time histories, as JSON; nan is null, a complex number is [real, imaginary].

    Args:
        result: of `modal.identify`.
        provenance: where it comes from.
        specification: of the test; the outcomes of its limits are among the numbers.
    """
    judgement = trust_of(result)
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
        "choices": result.choices,
        "excitation": result.excitation,
        "fit": {"mean": result.fit.mean, **_members(result.fit)},
        "modes": {
            "indicator_caution": result.modes.indicator_caution,
            "indicators_missing": result.modes.indicators_missing,
            "table": _mode_table(result),
        },
        "uncertainty": _uncertainty_document(result),
        "order_evidence": result.order_evidence,
        "residuals": result.residuals,
        "observer": {"order": result.observer.order, **_members(result.observer, leave_out=("dt",))},
        "markov": result.markov,
        "realisation": _members(result.realisation, leave_out=("factors",)),
    }
    return json.dumps(as_json(document), allow_nan=False, indent=1) + "\n"


def csv_text(result: Identification) -> str:
    """One row a mode in the order of its number; shapes in columns of their own, empty cells for what is not known."""
    outputs, inputs = result.records[0].output_names, result.records[0].input_names
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
