"""What a comparison needs to know of a result, whether it comes from memory, a saved result or a report's JSON."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from modal.identification.result import Identification, load
from modal.identification.words import trust_of
from modal.modes.choice import Choice
from modal.modes.mode import Mode
from modal.wording.names import shorten, visible
from okid.errors import InvalidDataError, UnreadableFileError

__all__ = ["Channel", "ResultSummary", "read_result", "summary_of"]

_MOST_TEXT = 1 << 28
"""Bytes of a report's JSON that are read at most: 256 MiB."""

_MOST_MODES = 2000
"""More than any identification has; every mode of one result is weighed against every one of the other."""

_LARGEST = 1e100
"""No number of a mode is larger; the squares of such would overflow."""

_LONGEST_NAME = 200
_PREFIX = "modal-report/"


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """A channel of the records.

    Attributes:
        name: of the channel.
        unit: of its values.
    """

    name: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResultSummary:
    """A result without its time histories and matrices.

    Attributes:
        name: for a reader, e.g. the folder it came from.
        modes: every mode, whatever its verdict.
        inputs: channels of the records.
        outputs: channels of the records, in the order of the shapes' components.
        dt: time step of the identified records [s].
        n_samples: of each record.
        choices: every setting, chosen or given.
        fit: cross-validated fit, mean over outputs.
        trust: "carried", "with care" or "not carried".
        degrees_of_freedom: of the residuals behind the standard deviations; infinite where not known.
        data: "file" or "samples", and the SHA-256 of each measured file or of each record's samples; empty where
            neither is known.
    """

    name: str
    modes: tuple[Mode, ...]
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    dt: float
    n_samples: tuple[int, ...]
    choices: tuple[Choice, ...]
    fit: float
    trust: str
    degrees_of_freedom: float
    data: frozenset[str]


def summary_of(result: Identification, *, name: str = "") -> ResultSummary:
    """The summary of a result in memory.

    Args:
        result: of `modal.identify` or `modal.load`.
        name: for a reader; that of its first record unless given.
    """
    record = result.records[0]
    known = result.uncertainty
    return ResultSummary(
        name=name or record.name or "result",
        modes=result.modes.modes,
        inputs=tuple(map(_channel, record.input_names, record.input_units)),
        outputs=tuple(map(_channel, record.output_names, record.output_units)),
        dt=record.dt,
        n_samples=tuple(one.n_samples for one in result.records),
        choices=result.choices,
        fit=result.fit.mean,
        trust=trust_of(result).trust,
        degrees_of_freedom=math.inf if known is None else known.degrees_of_freedom,
        data=frozenset(f"samples {_digest(one.inputs, one.outputs)}" for one in result.records),
    )


def read_result(path: str | Path) -> ResultSummary:
    """The summary of a result in a file or folder.

    Args:
        path: a folder that `modal-report run` wrote, its report.json, or a saved result (.npz).

    Raises:
        UnreadableFileError: no such file, damaged, too large, or no result.
    """
    path = Path(path)
    name = _shown(path.resolve().name if path.name in ("", "..") else path.name)
    try:
        file = _file_of(path)
        if file.suffix.lower() == ".npz":
            return _checked(summary_of(load(file), name=name))
        return _checked(_of_document(json.loads(_text(file)), name))
    except OSError as error:
        raise UnreadableFileError(f"{_shown(path)!r} cannot be read ({error.strerror or error}).") from error
    except UnreadableFileError:
        raise
    except (LookupError, TypeError, ValueError, ArithmeticError, RecursionError, AttributeError) as error:
        words = _shown(str(error)).rstrip(".")
        raise UnreadableFileError(
            f"{_shown(path)!r} is damaged or no result of modal-report run ({words or type(error).__name__}); give its "
            "folder, its report.json or a saved result (.npz)."
        ) from error


def _checked(summary: ResultSummary) -> ResultSummary:
    if len(summary.modes) > _MOST_MODES:
        raise InvalidDataError(f"it has {len(summary.modes)} modes, more than {_MOST_MODES}")
    if not all(np.isfinite(mode.pole) and np.isfinite(mode.frequency) for mode in summary.modes):
        raise InvalidDataError("a pole is not finite")
    return summary


def _file_of(path: Path) -> Path:
    if path.is_dir():
        found = next((path / name for name in ("report.json", "result.npz") if (path / name).is_file()), None)
        if found is None:
            raise UnreadableFileError(
                f"{_shown(path)!r} holds neither report.json nor result.npz; give a folder that modal-report run wrote."
            )
        return found
    if not path.is_file():
        raise UnreadableFileError(f"there is no {_shown(path)!r}; give a folder that modal-report run wrote.")
    return path


def _text(file: Path) -> str:
    if file.stat().st_size > _MOST_TEXT:
        raise UnreadableFileError(f"{_shown(file)!r} has more than {_MOST_TEXT} bytes; give the saved result (.npz).")
    return file.read_text(encoding="utf-8")


def _shown(text: object) -> str:
    return shorten(visible(str(text)), _LONGEST_NAME)


def _channel(name: str, unit: str) -> Channel:
    return Channel(name=name, unit=unit)


def _digest(*arrays: Any) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


# --- from JSON -------------------------------------------------------------------------------------------------------


def _of_document(document: Mapping[str, Any], name: str) -> ResultSummary:
    schema = document.get("schema")
    if schema is None:
        raise UnreadableFileError(
            f"{name!r} is JSON, but no report.json of modal-report run; give that, or its folder."
        )
    if not str(schema).startswith(_PREFIX):
        raise UnreadableFileError(
            f"{name!r} has schema {_shown(schema)!r}, but only the result of an identification can be compared."
        )
    records = document["records"]
    uncertainty = document.get("uncertainty") or {}
    modes = tuple(_mode(row) for row in document["modes"]["table"])
    outputs = tuple(_channel(str(one["name"]), str(one["unit"])) for one in records[0]["outputs"])
    if any(mode.shape.shape != (len(outputs),) for mode in modes):
        raise InvalidDataError("a shape has not one component an output")
    if any(mode.shape_std is not None and mode.shape_std.shape != (len(outputs),) for mode in modes):
        raise InvalidDataError("the deviations of a shape are not one an output")
    return ResultSummary(
        name=name,
        modes=modes,
        inputs=tuple(_channel(str(one["name"]), str(one["unit"])) for one in records[0]["inputs"]),
        outputs=outputs,
        dt=float(records[0]["dt"]),
        n_samples=tuple(int(one["n_samples"]) for one in records),
        choices=tuple(
            Choice(**{key: str(one[key]) for key in ("what", "value", "reason")}) for one in document["choices"]
        ),
        fit=_number(document["fit"]["mean"]),
        trust=str(document["trust"]),
        degrees_of_freedom=float(uncertainty.get("degrees_of_freedom") or math.inf),
        data=frozenset(
            f"file {one['sha256']}"
            for one in document.get("files", ())
            if one["name"] in document.get("sources", ())  # a test file or a geometry is no measured data
        ),
    )


def _mode(row: Mapping[str, Any]) -> Mode:
    hints = get_type_hints(Mode)
    given = {}
    for field in fields(Mode):
        if field.name in row:
            given[field.name] = _value(row[field.name], hints[field.name])
        elif field.default is MISSING:
            raise KeyError(field.name)
    return Mode(**given)


def _value(value: Any, hint: Any) -> Any:
    """A field of a mode as JSON has it, as its type asks; ValueError where it is another."""
    if hint is float:
        return _number(value)
    if hint is complex:
        return _complex(value)
    if get_origin(hint) is Literal and value in get_args(hint):
        return value
    if hint in (str, bool) and type(value) is hint:
        return value
    if isinstance(value, list) and hint not in (str, bool) and get_origin(hint) is not Literal:
        numbers = [_complex(item) if isinstance(item, list) else _number(item) for item in value]
        array = np.array(numbers, dtype=np.complex128 if hint == get_type_hints(Mode)["shape"] else np.float64)
        array.flags.writeable = False
        return array
    if value is None and type(None) in get_args(hint):
        return None
    raise ValueError(f"a mode has {_shown(value)!r} where it cannot be")


def _number(value: Any) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{_shown(value)!r} is no number")
    if abs(value) > _LARGEST:
        raise ValueError(f"{value:.3g} is no number of a mode")
    return float(value)


def _complex(value: Any) -> complex:
    real, imaginary = value
    return complex(_number(real), _number(imaginary))
