"""Frequency responses from files.

* Universal files: every function of type 4 (set 58 or 58b) is the response at one point to one reference; functions of
  type 6 and 26 are its coherence; the window is what sets 1858 state, where they agree.
* NPZ and MAT: `frequencies` (or f, freq) [Hz], `response` (or frf, H) complex (n_lines, n_outputs, n_inputs) or
  (n_lines, n_outputs); beside them, where known, `coherence`, `n_averages`, `window`, `window_time_constant`,
  `overlap`, `output_names`, `output_units`, `input_names`, `input_units`.
* Text tables: a column `frequency [Hz]`, then for each response two columns, `tip/hammer re [m/s^2/N]` and
  `tip/hammer im [m/s^2/N]`, or `tip/hammer magnitude [m/s^2/N]` and `tip/hammer phase [deg]`; `tip/hammer coherence`
  where it is known. Without a slash there is one input.

Units become SI. A response is output over input with motion as exp(+2 pi j f t); the sign of a direction ("12X-") stays
in the channel's name; the unit of the output states the motion (m, m/s, m/s^2).
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np

from okid.arrays import ComplexArray, FloatArray
from okid.errors import IdentificationError, InvalidDataError, UnreadableFileError
from okid.frequency_response import FrequencyResponse, ResponseWindow
from okid.readers.arrays import Content, npz_contents
from okid.readers.guard import check_channel_count, check_file, first_line
from okid.readers.mat import mat_contents
from okid.readers.table import Table
from okid.readers.text import read_text
from okid.readers.uff import (
    COHERENCE,
    MULTIPLE_COHERENCE,
    RESPONSE,
    label_of,
    open_uff,
    place_of,
    states_si,
    text_of,
    unit_of,
)
from okid.readers.units import convert_unit
from okid.record import channel_indices

TEXT_TYPES = (".csv", ".txt", ".tsv", ".dat", ".asc")
UNIVERSAL_TYPES = (".uff", ".unv", ".ufb")
FREQUENCY_NAMES = frozenset(["frequency", "frequencies", "freq", "freqs", "f", "frequency hz", "freq hz"])
RESPONSE_NAMES = frozenset(["response", "responses", "frf", "frfs", "h", "h1", "h2", "hv"])
WINDOWS_1858: Mapping[int, ResponseWindow] = {1: "hann", 2: "hann", 3: "flattop"}
"""Windows that a set 1858 tells for certain; its exponential ones state a factor whose meaning differs by program."""
_PARTS = {
    **dict.fromkeys(("re", "real"), "re"),
    **dict.fromkeys(("im", "imag", "imaginary"), "im"),
    **dict.fromkeys(("mag", "magnitude", "abs", "amplitude"), "magnitude"),
    **dict.fromkeys(("phase", "angle"), "phase"),
    **dict.fromkeys(("coh", "coherence"), "coherence"),
}
_OF_TIME = re.compile(r"m?s(?:ec)?\^?\*{0,2}\d?|s²|s\s*\*\s*s")
_NOTE = re.compile(r"averages (\d{1,9}); window ([a-z]+)(?: of ([0-9.e+-]+) s)?(?:; overlap (0(?:[.][0-9]{1,9})?))?")


@dataclass(slots=True)
class _Functions:
    """What a file holds, function by function: (output, input) -> values in SI."""

    frequencies: FloatArray
    responses: dict[tuple[str, str], ComplexArray] = field(default_factory=dict)
    coherences: dict[tuple[str, str], FloatArray] = field(default_factory=dict)  # input "" where multiple
    output_units: dict[str, str] = field(default_factory=dict)
    input_units: dict[str, str] = field(default_factory=dict)
    n_averages: int | None = None
    window: ResponseWindow = "unknown"
    time_constant: float | None = None
    overlap: float | None = None


def read_response(
    path: str | Path,
    *,
    inputs: Sequence[str] | str | None = None,
    outputs: Sequence[str] | str | None = None,
    window: ResponseWindow | Literal["as stated"] = "as stated",
    window_time_constant: float | None = None,
    n_averages: int | None = None,
    overlap: float | None = None,
) -> FrequencyResponse:
    """The frequency responses in a file, in SI units.

    Args:
        path: the file: .uff .unv .ufb (functions of type 4), .npz, .mat, .csv and other text tables; see this module
            for the names in them.
        inputs: names of the references to keep; all unless given.
        outputs: names of the outputs to keep; all unless given.
        window: of the blocks that were averaged; few files state it, and damping depends on it.
        window_time_constant: [s] of an exponential window; what the file states unless given.
        n_averages: number of averages; what the file states unless given.
        overlap: share of a block that the next one has as well; what the file states unless given.

    Returns:
        The responses, named after the file; NaN for an output that was not measured with a reference.

    Raises:
        UnreadableFileError: no such file, an unknown type, damage, or no frequency response in it.
        InvalidDataError: no such channel, or numbers that cannot be a response.
    """
    path = check_file(path)
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused by name
            found = _read(path)
    except IdentificationError:
        raise
    except Exception as error:  # whatever a damaged header leads the decoders to
        raise UnreadableFileError(
            f"{path.name} is damaged or holds no frequency responses ({first_line(error)}); export it again."
        ) from error
    if window != "as stated" or any(each is not None for each in (n_averages, window_time_constant, overlap)):
        found = replace(
            found,
            window=found.window if window == "as stated" else window,
            n_averages=found.n_averages if n_averages is None else n_averages,
            window_time_constant=found.window_time_constant if window_time_constant is None else window_time_constant,
            overlap=found.overlap if overlap is None else overlap,
        )
    return found if inputs is None and outputs is None else _chosen(found, inputs, outputs)


def _read(path: Path) -> FrequencyResponse:
    kind = path.suffix.lower()
    if kind in UNIVERSAL_TYPES:
        return _assembled(_universal(path), path)
    if kind in TEXT_TYPES:
        return _assembled(_columns(read_text(path)), path)
    if kind in {".npz", ".mat"}:
        return _of_arrays(npz_contents(path) if kind == ".npz" else mat_contents(path)[0], path)
    raise UnreadableFileError(
        f"{path.name} is of type {path.suffix or 'none'}, which is not read as frequency responses; the types read "
        f"are {', '.join((*UNIVERSAL_TYPES, '.npz', '.mat', *TEXT_TYPES))}."
    )


def holds_responses(path: Path) -> bool:
    """Whether a file holds frequency responses and no time histories, as far as can be told before it is read whole.

    Raises:
        UnreadableFileError: the file is damaged.
    """
    check_file(path)
    kind = path.suffix.lower()
    if kind in UNIVERSAL_TYPES:
        types = {int(head["func_type"]) for _, head in open_uff(path).sets(58, header_only=True)}
        return RESPONSE in types and 1 not in types
    if kind in {".npz", ".mat"}:
        contents = npz_contents(path) if kind == ".npz" else mat_contents(path)[0]
        return any(isinstance(value, np.ndarray) and value.dtype.kind == "c" for value in contents.values())
    if kind in TEXT_TYPES:
        with path.open("rb") as file:  # a long record is not read twice
            head = file.read(1 << 16).lower().replace(b"\0", b"")
        if b"freq" not in head and b"f [" not in head:
            return False
        table = read_text(path)
        return _frequency_column(table) is not None and any(
            _part(name)[1] in {"re", "magnitude"} for name in table.names
        )
    return False


def _chosen(
    found: FrequencyResponse, inputs: Sequence[str] | str | None, outputs: Sequence[str] | str | None
) -> FrequencyResponse:
    into = channel_indices(inputs, found.input_names, "input")
    out = channel_indices(outputs, found.output_names, "output")
    coherence = found.coherence
    if coherence is not None:
        coherence = coherence[:, out] if coherence.ndim == 2 else coherence[:, out][:, :, into]
    return replace(
        found,
        response=found.response[:, out][:, :, into],
        coherence=coherence,
        input_names=tuple(found.input_names[i] for i in into),
        output_names=tuple(found.output_names[i] for i in out),
        input_units=tuple(found.input_units[i] for i in into),
        output_units=tuple(found.output_units[i] for i in out),
    )


def _assembled(found: _Functions, path: Path) -> FrequencyResponse:
    """The functions of a file as one table; NaN where a pair was not measured."""
    if not found.responses:
        raise UnreadableFileError(f"{path.name} holds no frequency response; export complex responses over frequency.")
    outputs = list(dict.fromkeys(output for output, _ in found.responses))
    inputs = list(dict.fromkeys(input_ for _, input_ in found.responses))
    check_channel_count(path, len(outputs))
    check_channel_count(path, len(inputs))
    n_lines = len(found.frequencies)
    table = np.full((n_lines, len(outputs), len(inputs)), np.nan + 0j)
    for (output, input_), values in found.responses.items():
        if not np.isfinite(values).all():
            raise UnreadableFileError(
                f"the response of {output!r} to {input_!r} in {path.name} holds values that are no numbers; leave that "
                "response out, or export it again."
            )
        table[:, outputs.index(output), inputs.index(input_)] = values
    unit_names = [found.input_units.get(name, "") for name in inputs]
    labels = [f"input {name}" if name in outputs else name for name in inputs]  # a driving point is both
    try:
        return FrequencyResponse(
            table,
            found.frequencies,
            coherence=_coherence(found, outputs, inputs),
            n_averages=found.n_averages,
            window=found.window,
            window_time_constant=found.time_constant,
            overlap=found.overlap,
            input_names=tuple(labels),
            output_names=tuple(outputs),
            input_units=tuple(unit_names),
            output_units=tuple(found.output_units.get(name, "") for name in outputs),
            name=path.stem,
        )
    except UnreadableFileError:
        raise
    except InvalidDataError as error:
        raise UnreadableFileError(f"{path.name} cannot be read as frequency responses: {error}") from error


def _coherence(found: _Functions, outputs: list[str], inputs: list[str]) -> FloatArray | None:
    """(n_lines, n_outputs) or (n_lines, n_outputs, n_inputs) where every response has one, else None."""
    kept = found.coherences
    if all((output, "") in kept for output in outputs):
        return np.stack([kept[output, ""] for output in outputs], axis=1)
    if all(pair in kept for pair in found.responses):
        n_lines = len(found.frequencies)
        nothing = np.full(n_lines, np.nan)
        return np.stack([np.stack([kept.get((o, i), nothing) for i in inputs], axis=1) for o in outputs], axis=1)
    return None


# --- universal files -------------------------------------------------------------------------------------------------


def _universal(path: Path) -> _Functions:
    file = open_uff(path)
    heads = list(file.sets(58, header_only=True))
    wanted = [number for number, head in heads if int(head["func_type"]) in {RESPONSE, COHERENCE, MULTIPLE_COHERENCE}]
    check_channel_count(path, len(wanted))
    sets = [file.read(number) for number in wanted]
    if not any(int(each["func_type"]) == RESPONSE for each in sets):
        raise UnreadableFileError(
            f"{path.name} holds no frequency response (function of type {RESPONSE} in a data set 58); export the "
            "complex responses."
        )
    is_si = any(states_si(each) for _, each in file.sets(164))
    frequencies: FloatArray | None = None
    found: _Functions | None = None
    for each in sets:
        kind = int(each["func_type"])
        axis, values = _axis(each, path), _values(each, path)
        if frequencies is None:
            frequencies, found = axis, _Functions(axis)
        if found is None or axis.shape != frequencies.shape or not np.allclose(axis, frequencies, rtol=1e-5, atol=0):
            raise UnreadableFileError(
                f"the functions of {path.name} have different frequency axes; one table has one axis, so export them "
                "with the same lines, or in several files."
            )
        output, input_ = _names(each)
        if kind != RESPONSE:
            _add(found.coherences, (output, "" if kind == MULTIPLE_COHERENCE else input_), values.real, path)
        else:
            _add(found.responses, (output, input_), values, path)
            _add_units(found, each, output, input_, is_si=is_si)
    assert found is not None
    _qualify(found, [each for each in sets if int(each["func_type"]) == RESPONSE], [s for _, s in file.sets(1858)])
    return found


def _axis(each: Mapping[str, Any], path: Path) -> FloatArray:
    n_lines = int(each["num_pts"])
    if n_lines < 2 or len(each["data"]) < n_lines:
        raise UnreadableFileError(
            f"a data set of {path.name} announces {n_lines} lines but holds {len(each['data'])}: the file is cut off "
            "or damaged; copy or export it again."
        )
    if int(each["abscissa_spacing"]) == 1:
        axis = float(each["abscissa_min"]) + float(each["abscissa_inc"]) * np.arange(n_lines)
    else:
        axis = np.asarray(each["x"][:n_lines], dtype=np.float64)
    factor = _hertz(label_of(each, "abscissa_axis_units_lab"), path)
    if not np.isfinite(axis).all() or (np.diff(axis) <= 0).any() or axis[0] < 0:
        raise UnreadableFileError(
            f"the frequencies of a function in {path.name} do not increase from 0 or above: the file is damaged; "
            "export it again."
        )
    return np.asarray(axis * factor, dtype=np.float64)


def _hertz(unit: str, path: Path) -> float:
    """What turns an axis in this unit into Hz."""
    conversion = convert_unit("frequency", unit)
    if conversion.unit in {"", "Hz"} or conversion.unit == "1/s":
        return conversion.factor
    if conversion.unit == "rad/s" and "rpm" not in unit.lower():
        return conversion.factor / (2 * np.pi)
    raise UnreadableFileError(f"the frequency axis of {path.name} is in {unit!r}, which is no frequency; give Hz.")


def _values(each: Mapping[str, Any], path: Path) -> ComplexArray:
    values = np.asarray(each["data"])[: int(each["num_pts"])]
    if int(each["func_type"]) == RESPONSE and values.dtype.kind != "c":
        raise UnreadableFileError(
            f"a frequency response in {path.name} is stored as real numbers, without its phase; export real and "
            "imaginary part."
        )
    if not np.isfinite(values).all():
        raise UnreadableFileError(f"a function in {path.name} holds values that are no numbers; export it again.")
    return values.astype(np.complex128)


def _names(each: Mapping[str, Any]) -> tuple[str, str]:
    """Node and direction of response and reference; without nodes what the first line or the entity names say."""
    output, input_ = place_of(each, "rsp"), place_of(each, "ref")
    parts = text_of(each["id1"]).split(" / ")
    words = tuple(part.strip() for part in parts) if len(parts) == 2 else ("", "")
    output = output or words[0] or text_of(each["rsp_ent_name"]) or "output"
    return output, input_ or words[1] or text_of(each["ref_ent_name"]) or "input"


def _add(
    kept: dict[tuple[str, str], Any], pair: tuple[str, str], values: ComplexArray | FloatArray, path: Path
) -> None:
    if pair in kept:
        what = f"{pair[0]!r} to {pair[1]!r}" if pair[1] else repr(pair[0])
        raise UnreadableFileError(f"{path.name} holds more than one function of {what}; keep one of them.")
    kept[pair] = values


def _add_units(found: _Functions, each: Mapping[str, Any], output: str, input_: str, *, is_si: bool) -> None:
    """Units of numerator and denominator to SI; a quotient in the numerator's label is taken apart."""
    above, below = unit_of(each, "ordinate", is_si=is_si), unit_of(each, "orddenom", is_si=is_si)
    if not below and "/" in above:
        above, below = _quotient(above)
    _in_si(found, output, input_, above, below)


def _in_si(found: _Functions, output: str, input_: str, above: str, below: str) -> None:
    out = convert_unit(output, above)  # below another than a force stands one, of which g is no acceleration
    into = convert_unit(input_ if out.unit in {"N", "N m"} else f"force {input_}", below)
    found.responses[output, input_] = found.responses[output, input_] * (out.factor / into.factor)
    found.output_units.setdefault(output, out.unit)
    found.input_units.setdefault(input_, into.unit)


def _quotient(unit: str) -> tuple[str, str]:
    """Output and input unit of "m/s^2/N", "(m/s^2)/N", "N/(m/s^2)" or "g/N"; "m/s^2" alone is an output's."""
    whole = re.fullmatch(r"\s*([^()]+?)\s*/\s*\(([^()]+)\)\s*", unit)
    if whole and not _OF_TIME.fullmatch(whole[2].strip()):
        return whole[1], whole[2].strip()
    above, _, below = unit.rpartition("/")
    below = below.strip(" ()")
    if not above or _OF_TIME.fullmatch(below):
        return unit.strip(), ""
    above = above.strip()
    return (above[1:-1] if above.startswith("(") and above.endswith(")") else above), below


def _qualify(found: _Functions, responses: Iterable[Mapping[str, Any]], qualifiers: list[Mapping[str, Any]]) -> None:
    """Window and number of averages, where all functions agree."""
    notes = {match.groups() if (match := _NOTE.search(text_of(each["id5"]))) else None for each in responses}
    note = notes.pop() if len(notes) == 1 else None
    if note is not None and note[1] in get_args(ResponseWindow) and int(note[0]) >= 0:
        found.n_averages = int(note[0]) or None
        found.window = cast("ResponseWindow", note[1])
        found.time_constant = None if note[2] is None else _positive(note[2])
        found.overlap = None if note[3] is None else float(note[3])
        if found.window == "exponential" and found.time_constant is None:
            found.window = "unknown"
        return
    windows = {WINDOWS_1858.get(int(each["window_type"]), "unknown") for each in qualifiers}
    found.window = windows.pop() if len(windows) == 1 else "unknown"


def _positive(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if np.isfinite(number) and number > 0 else None


# --- text tables -----------------------------------------------------------------------------------------------------


def _frequency_column(table: Table) -> int | None:
    for index, name in enumerate(table.names):
        if name.strip().lower().replace("_", " ") in FREQUENCY_NAMES:
            return index
    return None


def _part(name: str) -> tuple[str, str]:
    """("tip/hammer", "re") of "tip/hammer re"; "" as the second where the name ends in no known word.

    Columns called re, im and coherence alone are those of the one response of a file.
    """
    alone = _PARTS.get(name.strip().lower(), "")
    if alone in {"re", "im", "coherence"}:
        return "output_0", alone
    match = re.fullmatch(r"(.*?)[\s_:,]+([A-Za-z]+)\.?", name.strip())
    word = _PARTS.get(match[2].lower(), "") if match else ""
    return (match[1].strip(), word) if match and word else (name.strip(), "")


def _columns(table: Table) -> _Functions:
    path, at = table.path, _frequency_column(table)
    if at is None:
        raise UnreadableFileError(
            f"{path.name} has no column called frequency (its columns are {', '.join(table.names[:8])}); a table of "
            "frequency responses begins with 'frequency [Hz]'."
        )
    axis = np.asarray(table.values[:, at]) * _hertz(table.columns[at].unit, path)
    if len(axis) < 2 or not np.isfinite(axis).all() or (np.diff(axis) <= 0).any() or axis[0] < 0:
        raise UnreadableFileError(
            f"the frequencies of {path.name} must be at least 0 and rise from row to row; sort them."
        )
    found = _Functions(axis)
    pieces: dict[str, dict[str, tuple[FloatArray, str]]] = {}
    for index, column in enumerate(table.columns):
        if index == at:
            continue
        function, part = _part(column.name)
        if not part:
            raise UnreadableFileError(
                f"column {column.name!r} of {path.name} does not say which part of a response it is; end its name with "
                "re, im, magnitude, phase or coherence."
            )
        if part in pieces.setdefault(function, {}):
            raise UnreadableFileError(f"{path.name} has more than one {part} of {function!r}; keep one.")
        pieces[function][part] = (np.asarray(table.values[:, index], dtype=np.float64), column.unit)
    for function, parts in pieces.items():
        _add_function(found, function, parts, path)
    return found


def _add_function(found: _Functions, function: str, parts: dict[str, tuple[FloatArray, str]], path: Path) -> None:
    output, slash, input_ = function.rpartition("/")
    output, input_ = (output.strip(), input_.strip()) if slash else (function, "input_0")
    names = set(parts) - {"coherence"}
    if names == {"re", "im"}:
        values, unit = parts["re"][0] + 1j * parts["im"][0], parts["re"][1]
        same = parts["im"][1] == unit
    elif names == {"magnitude", "phase"}:
        (size, unit), (angle, turn) = parts["magnitude"], parts["phase"]
        if turn.lower() not in {"deg", "°", "degree", "degrees", "rad"}:
            raise UnreadableFileError(f"the phase of {function!r} in {path.name} must say its unit: [deg] or [rad].")
        if (size < 0).any() or unit.lower() == "db":
            raise UnreadableFileError(
                f"the magnitude of {function!r} in {path.name} is in dB or below 0; give it linear."
            )
        values, same = size * np.exp(1j * (angle if turn.lower() == "rad" else np.radians(angle))), True
    else:
        held = ", ".join(sorted(parts))
        raise UnreadableFileError(
            f"{function!r} in {path.name} has the columns {held}; a response needs re and im, or magnitude and phase."
        )
    if not same:
        raise UnreadableFileError(f"re and im of {function!r} in {path.name} have different units; correct the header.")
    _add(found.responses, (output, input_), values, path)
    _in_si(found, output, input_, *_quotient(unit))
    if "coherence" in parts:
        found.coherences[output, input_] = parts["coherence"][0]


# --- arrays ----------------------------------------------------------------------------------------------------------


def _of_arrays(contents: Mapping[str, Content], path: Path) -> FrequencyResponse:
    arrays = {_key(name): value for name, value in contents.items() if isinstance(value, np.ndarray)}
    texts = {_key(name): list(value) for name, value in contents.items() if not isinstance(value, np.ndarray)}
    axes = [value for name, value in arrays.items() if name in FREQUENCY_NAMES and value.dtype.kind in "iuf"]
    tables = [value for name, value in arrays.items() if name in RESPONSE_NAMES and value.dtype.kind == "c"]
    tables = tables or [value for value in arrays.values() if value.dtype.kind == "c"]
    if len(axes) != 1 or len(tables) != 1:
        raise UnreadableFileError(
            f"{path.name} must hold one array of frequencies (called frequencies, freq or f) and one complex array "
            f"(called response, frf or H); it holds {', '.join(map(repr, list(contents)[:8])) or 'nothing'}."
        )
    axis, table = axes[0].astype(np.float64).ravel(), tables[0].astype(np.complex128)
    if table.ndim not in {1, 2, 3} or len(table) != axis.size:
        raise UnreadableFileError(
            f"the responses of {path.name} have shape {table.shape}, but there are {axis.size} frequencies; the first "
            "axis must be frequency, then outputs, then inputs."
        )
    table = table.reshape(axis.size, table.shape[1] if table.ndim > 1 else 1, -1)
    if not np.isfinite(table).all():
        raise UnreadableFileError(f"the responses of {path.name} hold values that are no numbers; leave those out.")
    units: dict[str, list[str]] = {}
    factors = {}
    for side, count in (("output", table.shape[1]), ("input", table.shape[2])):
        names = texts.get(f"{side}_names", [""] * count)
        written = texts.get(f"{side}_units", [""] * count)
        if len(names) != count or len(written) != count:
            raise UnreadableFileError(f"{path.name} needs one of {side}_names and {side}_units for each {side}.")
        turned = [
            convert_unit(f"force {name}" if side == "input" else name, unit)
            for name, unit in zip(names, written, strict=True)
        ]
        factors[side], units[side] = np.array([each.factor for each in turned]), [each.unit for each in turned]
    coherence = next((arrays[name] for name in ("coherence", "coh") if name in arrays), None)
    window = next(iter(texts.get("window", ["unknown"])), "unknown")
    averages, constant, overlap = (_single(arrays, f) for f in ("n_averages", "window_time_constant", "overlap"))
    try:
        return FrequencyResponse(
            table * factors["output"][:, np.newaxis] / factors["input"],
            axis,
            coherence=None if coherence is None else _shaped(coherence, table),
            n_averages=None if averages is None else cast("int", averages),
            window=cast("ResponseWindow", window),
            window_time_constant=constant,
            overlap=overlap if overlap is not None and 0 <= overlap < 1 else None,  # else of another meaning
            output_names=tuple(texts.get("output_names", ())),
            input_names=tuple(texts.get("input_names", ())),
            output_units=tuple(units["output"]),
            input_units=tuple(units["input"]),
            name=path.stem,
        )
    except (InvalidDataError, ValueError, TypeError) as error:
        raise UnreadableFileError(f"{path.name} cannot be read as frequency responses: {error}") from error


def _shaped(coherence: np.ndarray[Any, Any], table: ComplexArray) -> FloatArray:
    """As it stands, but for the one channel that MATLAB and numpy leave out."""
    values = coherence.astype(np.float64)
    return values.reshape(table.shape[:2]) if values.size == table[:, :, 0].size else values


def _single(arrays: Mapping[str, Any], name: str) -> float | None:
    value = arrays.get(name)
    return float(value.reshape(-1)[0]) if value is not None and value.size == 1 and value.dtype.kind in "iuf" else None


def _key(name: str) -> str:
    return name.rpartition(".")[2].strip().lower()


# --- writing ---------------------------------------------------------------------------------------------------------
