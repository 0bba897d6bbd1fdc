"""What `modal.identify` returns: every stage of the road from records to modes, and why each choice was made.

An identification as one file, and back: every number bit for bit, nothing in it that could run.

The file is an .npz archive (a zip of .npy arrays, readable with `numpy.load`) with one JSON text, `result.json`, for
all that is not an array. What may stand in a field is told by the field's own type in the code: the file names no class
and no module, so no file can make us build anything but an `Identification`. Arrays are stored uncompressed, so a file
can never ask for more memory than its own size.
"""

import io
import json
import math
import os
import types
import zipfile
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from era.realisation import Realisation
from modal.modes.mode import Choice, Fit, ModalModel, Uncertainty, numbered
from modal.preparation.kind import RecordKind
from modal.verdict.stabilisation import StabilisationPoint
from modal.wording.text import fit_text
from okid.arrays import FloatArray, frozen_with_gaps
from okid.display import Displayed
from okid.errors import InvalidDataError, UnreadableFileError
from okid.excitation import Excitation
from okid.frequency_response import FrequencyResponse
from okid.markov import MarkovParameters
from okid.observer import ObserverFit
from okid.readers.guard import Existing, check_file, foreign, new_file, sound_archive
from okid.record import Record
from okid.residuals import ResidualCheck


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class OrderEvidence(Displayed):
    """What the model order was decided on.

    Attributes:
        singular_values: of the scaled block Hankel matrix, relative order kept.
        order: the order chosen.
        gap_order: where the largest ratio of neighbouring singular values stands.
        candidate_orders: (n_candidates,) model orders that were tried with the chosen observer and ridge.
        candidate_fits: (n_candidates,) their cross-validated fits, mean over outputs; nan where unstable.
        stabilisation: poles of all orders.
    """

    singular_values: FloatArray
    order: int
    gap_order: int
    candidate_orders: FloatArray
    candidate_fits: FloatArray
    stabilisation: tuple[StabilisationPoint, ...]

    def __post_init__(self) -> None:
        for name in ("singular_values", "candidate_orders", "candidate_fits"):
            object.__setattr__(self, name, frozen_with_gaps(getattr(self, name), name=name, shape=(None,)))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Identification(Displayed):
    """The result of `modal.identify`.

    Attributes:
        records: as used: means removed, decimated to the band (see `choices`); the realisation has their time step.
            Empty where frequency responses were identified.
        excitation: what the inputs allow to be identified, before the fit; None for responses.
        observer: the observer fit; None for responses.
        residuals: whiteness and input correlation of its residuals; None for responses.
        markov: Markov parameters recovered from it, or the pulse response of a table.
        realisation: state-space model in the units of the records, refined by output error where that paid.
        modes: every mode with its indicators and its verdict.
        order_evidence: what the model order was decided on.
        choices: every automatic choice (and every one taken from an argument) with its reason.
        fit: free-run fits.
        simulated: free run of the model for each record, same shape and channels as `records`; without inputs its
            one-step prediction.
        predicted: one-step prediction for each record.
        warnings: sentences that the user must read; empty when all is well.
        uncertainty: standard deviations of the modes (in their order) and of the realisation's Markov parameters; None
            in a file that was saved before there were any.
        innovations: whiteness and input correlation of the realisation's one-step errors; None where it has no gain or
            the records are too short for the test.
        fitted_model: the model that observer, Markov parameters and modes belong to: the realisation without the states
            that stand for input delays and integrators.
        innovation_covariance: (n_outputs, n_outputs) of these errors, for `era.forecast`; None without refinement.
        record_kind: "driven", "transient", "decay", "ambient" or "response" (`choices` says why); None in a file that
            was saved before there were any.
        response: the table of frequency responses that was identified, None where it was records.
        input_delay: (n_inputs,) samples of `records` by which each input acts late: those that the realisation has as
            states (below zero: early, as lead) and the modes do not; () in a file that was saved before it was kept.
    """

    records: tuple[Record, ...]
    excitation: Excitation | None
    observer: ObserverFit | None
    residuals: ResidualCheck | None
    markov: MarkovParameters
    realisation: Realisation
    modes: ModalModel
    order_evidence: OrderEvidence
    choices: tuple[Choice, ...]
    fit: Fit
    simulated: tuple[Record, ...]
    predicted: tuple[Record, ...]
    warnings: tuple[str, ...]
    uncertainty: Uncertainty | None = None
    innovations: ResidualCheck | None = None
    innovation_covariance: FloatArray | None = None
    fitted_model: Realisation | None = None
    record_kind: RecordKind | None = None
    response: FrequencyResponse | None = None
    input_delay: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """The realisation is of these channels, whatever stage made it."""
        Displayed.__post_init__(self)
        model, names = self.realisation, (self.channels.input_names, self.channels.output_names)
        fits = (model.n_inputs, model.n_outputs) == tuple(map(len, names))
        if fits and (model.input_names, model.output_names) != names:
            named = replace(model, input_names=names[0], output_names=names[1])
            object.__setattr__(self, "realisation", named)

    def display_rows(self) -> list[tuple[str, str]]:
        """The records, the fits, the modes of the system, and what the reader must know."""
        several = f"{len(self.records)}, {'' if len(self.records) == 1 else 'the first '}{self.channels}"
        rows = [
            ("records", several) if self.response is None else ("responses", f"{self.response}"),
            ("kind", f"{self.record_kind}"),
            ("fit", f"{fit_text(self.fit.mean)} of the motion on held-out rows"),
            ("modes", self.modes.display_title().removeprefix("ModalModel of ")),
        ]
        rows += [("warning", text) for text in self.warnings]
        return rows + [(f"mode {number}", mode.in_words()) for number, mode in numbered(self.modes.system)]

    @property
    def source(self) -> tuple[Record, ...] | FrequencyResponse:
        """What was identified: the records, or the table of frequency responses."""
        return self.records if self.response is None else self.response

    @property
    def channels(self) -> Record | FrequencyResponse:
        """What knows the names and units of inputs and outputs: the first record, or the table."""
        return self.records[0] if self.response is None else self.response

    def save(self, path: str | Path, *, existing: Existing = "refuse") -> Path:
        """Write all of it into one file without pickle; `modal.load` reads it back bit for bit.

        Args:
            path: of the file; the usual ending is .npz.
            existing: "refuse" (an error when the file is there) or "replace".

        Returns:
            The path.

        Raises:
            InvalidDataError: the file exists and may not be replaced, or it cannot be written.
        """
        return save(self, path, existing=existing)


SCHEMA_VERSION = 1
"""Raised when a field changes its meaning; a new field with a default does not need it."""

_TEXT = "result.json"
_MOST_TEXT = 1 << 27
"""Bytes of JSON text that are read at most: 128 MiB, some hundred times a large result's."""
_AT_ONCE = 1 << 24
"""Bytes that are written in one piece at most."""
_AS_THEY_ARE = {str, bool, int, types.NoneType}
_DTYPES = {np.dtype(name) for name in ("bool", "int32", "int64", "float64", "complex128")}


def save(identification: Identification, path: str | Path, *, existing: Existing = "refuse") -> Path:
    """Write everything that `identify` returned into one file; read it with `load`.

    The file appears under its name only when it is complete. The same result gives the same bytes.

    Args:
        identification: what to keep.
        path: of the file; the usual ending is .npz.
        existing: "refuse" (an error when the file is there) or "replace".

    Returns:
        The path.

    Raises:
        InvalidDataError: the file exists and may not be replaced, its folder does not exist, or it cannot be written.
    """
    return write_parts({"result": identification}, path, existing=existing)


def write_parts(
    parts: Mapping[str, object], path: str | Path, *, existing: Existing = "refuse", most: float = math.inf
) -> Path:
    """Write several frozen types into one file, each under its name; errors and the rest as in `save`.

    Parts with which the arrays would take more than `most` bytes, each counted once, are left out, but for the first.
    """
    path = Path(path)
    arrays: dict[int, tuple[str, npt.NDArray[Any]]] = {}
    encoded: dict[str, Any] = {}
    for name, part in parts.items():
        with_it = dict(arrays)
        document = _encode(part, with_it)
        if not encoded or sum(array.nbytes for _, array in with_it.values()) <= most:
            encoded[name], arrays = document, with_it
    text = json.dumps({"schema": SCHEMA_VERSION, **encoded}, allow_nan=False)
    with new_file(path, existing) as part:
        _write(part, text, dict(arrays.values()))
    return path


def load(path: str | Path) -> Identification:
    """Read what `save` wrote.

    Args:
        path: of the file, or of the folder of a report, which holds it as `result.npz`.

    Raises:
        UnreadableFileError: no such file, damaged, not written by `save`, or written by a newer version.
    """
    result = read_part(path, "result", Identification)
    if result is None:
        raise UnreadableFileError(
            f"{path} is damaged or no saved identification (of a result that is too large it holds a summary "
            "alone); identify again."
        )
    return cast("Identification", result)


def read_part(given: Any, name: str, kind: type[Any]) -> Any:
    """One part of what `write_parts` wrote, None where the file has no such part; errors as in `load`."""
    path = Path(given) if isinstance(given, str | os.PathLike) else check_file(given)
    path = path / "result.npz" if path.is_dir() else path
    if not path.is_file():
        raise UnreadableFileError(f"there is no file {path}; give the path of a saved identification.")
    part = None
    with foreign(path, "saved identification"), sound_archive(path) as archive:
        document = json.loads(_member(archive, _TEXT, most=_MOST_TEXT))
        version = document["schema"]
        if version == SCHEMA_VERSION and name in document:
            part = _decode(document[name], kind, archive, {})
    if version != SCHEMA_VERSION:
        raise UnreadableFileError(
            f"{path} has schema version {version}, this program reads {SCHEMA_VERSION}; identify again or use the "
            "version that wrote it."
        )
    return part


# --- writing ---------------------------------------------------------------------------------------------------------


def _encode(value: Any, arrays: dict[int, tuple[str, npt.NDArray[Any]]]) -> Any:
    kind: Any = type(value)
    if kind in _AS_THEY_ARE or (kind is float and math.isfinite(value)):  # most are: a result has a thousand values
        return value
    if names := _field_names(kind):
        return {name: _encode(getattr(value, name), arrays) for name in names}
    if isinstance(value, np.ndarray):
        if value.dtype not in _DTYPES:
            raise InvalidDataError(f"arrays of {value.dtype} cannot be saved; use float64 or complex128.")
        # one member for an array that several records share; the array is kept alive by the identification
        return {"array": arrays.setdefault(id(value), (f"array_{len(arrays)}", value))[0]}
    if isinstance(value, tuple):
        return [_encode(item, arrays) for item in value]
    if isinstance(value, complex):
        return [_encode_scalar(value.real), _encode_scalar(value.imag)]
    return _encode_scalar(value)


@cache
def _field_names(kind: type[Any]) -> tuple[str, ...]:
    """Of a frozen type, in its order; none of anything else."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else ()


def _encode_scalar(value: Any) -> Any:
    if isinstance(value, str | np.bool_):
        return str(value) if isinstance(value, str) else bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(float(value))  # JSON has no nan; text keeps all digits
    raise InvalidDataError(f"a value of type {type(value).__name__} cannot be saved; keep results in frozen types.")


def _write(path: Path, text: str, arrays: dict[str, npt.NDArray[Any]]) -> None:
    """A small archive is put together in memory: in a file each member seeks back twice, and each time is a write."""
    small = len(text) + sum(array.nbytes for array in arrays.values()) <= _AT_ONCE
    with path.open("xb") as file:
        whole = io.BytesIO() if small else file
        with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
            archive.writestr(zipfile.ZipInfo(_TEXT), text)  # ZipInfo: no clock, so the same result gives the same bytes
            for name, array in arrays.items():
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                    member.write(_header(array.shape, array.dtype))
                    member.write(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
        if isinstance(whole, io.BytesIO):
            file.write(whole.getbuffer())


@lru_cache(maxsize=256)
def _header(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bytes:
    """What a .npy file begins with; a result holds the same few shapes many times."""
    stream = io.BytesIO()
    said = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, said)
    return stream.getvalue()


# --- reading ---------------------------------------------------------------------------------------------------------


def _member(archive: zipfile.ZipFile, name: str, *, most: int | None = None) -> bytes:
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED or (most is not None and info.file_size > most):
        raise ValueError(f"member {name} is compressed or too large")
    return archive.read(info)


def _array(archive: zipfile.ZipFile, name: str) -> npt.NDArray[Any]:
    """A read-only view of the member's bytes; its header must account for every one of them."""
    data = _member(archive, f"{name}.npy")
    stream = io.BytesIO(data)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError(f"array {name} has an unknown format")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    if dtype not in _DTYPES or by_columns or math.prod(shape) * dtype.itemsize != len(data) - stream.tell():
        raise ValueError(f"array {name} is not what its header says")
    return np.frombuffer(data, dtype, offset=stream.tell()).reshape(shape)


def _decode(value: Any, hint: Any, archive: zipfile.ZipFile, arrays: dict[str, npt.NDArray[Any]]) -> Any:
    """Build what `hint` asks for, or raise ValueError; `arrays` keeps those that were read, for they may be shared."""
    if is_dataclass(hint):
        return _decode_dataclass(value, hint, archive, arrays)
    origin, choices = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None and types.NoneType in choices:
            return None
        (only,) = (choice for choice in choices if choice is not types.NoneType)
        return _decode(value, only, archive, arrays)
    if origin is tuple and isinstance(value, list):
        each = choices[:1] * len(value) if choices[-1] is Ellipsis else choices
        return tuple(_decode(item, one, archive, arrays) for item, one in zip(value, each, strict=True))
    if origin is np.ndarray and isinstance(value, dict):
        name = value["array"]
        if name not in arrays:
            arrays[name] = _array(archive, name)
        return arrays[name]
    return _decode_scalar(value, hint)


def _decode_scalar(value: Any, hint: Any) -> Any:
    if hint is complex and isinstance(value, list):
        real, imaginary = (_decode_scalar(part, float) for part in value)
        return complex(real, imaginary)
    if hint is float and (type(value) in (float, int) or value in ("nan", "inf", "-inf")):
        return float(value)
    if (hint in (int, bool, str) and type(value) is hint) or (get_origin(hint) is Literal and value in get_args(hint)):
        return value
    raise ValueError(f"a value of type {type(value).__name__} stands where {hint} belongs")


def _decode_dataclass(value: Any, hint: Any, archive: zipfile.ZipFile, arrays: dict[str, npt.NDArray[Any]]) -> Any:
    hints = get_type_hints(hint)
    known = {field.name: field for field in fields(hint)}
    if not isinstance(value, dict) or not value.keys() <= known.keys():
        raise ValueError(f"{hint.__name__} has fields that this program does not know")
    given = {name: _decode(item, hints[name], archive, arrays) for name, item in value.items()}
    for name, field in known.items():
        if name not in given and field.default is MISSING and field.default_factory is MISSING:
            raise ValueError(f"{hint.__name__} lacks its {name}")
    return hint(**given)
