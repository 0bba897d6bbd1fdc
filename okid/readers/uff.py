"""Universal files, data sets 58 and 58b: each time history in a file is one channel; frequency responses are written.

pyuff finds and decodes the data sets, but takes what it gets: it returns more or fewer values than a set announces,
reads any byte order and passes over a last set that is not closed. All that is checked here. What fills up the last
line is no value: some programs write zeros there (https://github.com/ladisk/pyuff/issues/22).
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any, Final

import numpy as np

from okid.arrays import ComplexArray, FloatArray
from okid.errors import InvalidDataError, UnreadableFileError
from okid.frequency_response import FrequencyResponse, line_spacing
from okid.readers.guard import Existing, check_channel_count, check_memory, foreign, new_file, optional_package
from okid.readers.table import Column, LeftOut, Table
from okid.readers.units import convert_unit


class Universal:
    """Numbers of the data sets and of what they hold."""

    TIME_RESPONSE: Final = 1
    ABSCISSA_TIME: Final = 17
    MEASUREMENT: Final = 58
    UNITS: Final = 164
    REAL_ORDINATES: Final = (2, 4)


_NODE = re.compile(r"(\d{1,9})(R?[XYZ])([+-])")
DATA_TYPES = {"m": 8, "m/s": 11, "m/s^2": 12, "N": 13, "Pa": 15}
QUANTITIES = {8: "displacement", 9: "reaction force", 11: "velocity", 12: "acceleration", 13: "force", 15: "pressure"}
RESPONSE, COHERENCE, MULTIPLE_COHERENCE = 4, 6, 26
FUNCTION_TYPES = {
    0: "general function",
    1: "complex time response",
    2: "auto spectrum",
    3: "cross spectrum",
    4: "frequency response function",
    5: "transmissibility",
    6: "coherence",
    7: "auto correlation",
    8: "cross correlation",
    9: "power spectral density",
    10: "energy spectral density",
    12: "spectrum",
}
DIRECTIONS = ("", "X", "Y", "Z", "RX", "RY", "RZ")
SI_OF_DATA_TYPE = {number: unit for unit, number in DATA_TYPES.items()}
"""Unit in SI of the specific data types that are measured in a modal test."""

Set = Mapping[str, Any]
"""One data set as pyuff returns it."""


def read_uff(path: Path) -> Table:
    """The time histories of a universal file as channels, named by node and direction ("12X+").

    Those that the file states as excitation force are the inputs ("force 12X+"), unless their unit says otherwise; a
    force of reaction is an output. In a file of several hits none is: the answers to one hit are no answers to another.

    Raises:
        UnreadableFileError: cut off, no time history in it, or time histories of different length or time step.
    """
    file = open_uff(path)
    kinds = file.kinds
    check_channel_count(path, kinds.count(Universal.MEASUREMENT))
    heads = dict(file.sets(Universal.MEASUREMENT, header_only=True))
    chosen = [number for number, head in heads.items() if _is_time_history(head)]
    if not chosen:
        raise UnreadableFileError(_what_it_holds(path, kinds, list(heads.values())))
    sets = [file.read(number) for number in chosen]
    ordinates = [np.asarray(each["data"], dtype=np.float64) for each in sets]
    forces = [int(each["ordinate_spec_data_type"]) == DATA_TYPES["N"] for each in sets]
    no_forces = [force and _measured_otherwise(each) for force, each in zip(forces, sets, strict=True)]
    drives = [force and not otherwise for force, otherwise in zip(forces, no_forces, strict=True)]
    names = _names(sets, drives)
    several = _several_hits(sets, drives)
    _check_same_axis(sets, names, path)
    is_si = any(states_si(each) for _, each in file.sets(Universal.UNITS))
    columns = [
        Column(name=name, unit=unit_of(each, "ordinate", is_si=is_si), header=name, measured=_measured_at(each))
        for name, each in zip(names, sets, strict=True)
    ]
    step, start_time = None, 0.0
    if sets[0]["abscissa_spacing"] == 1:
        factor = convert_unit("time", label_of(sets[0], "abscissa_axis_units_lab")).factor
        step, start_time = factor * sets[0]["abscissa_inc"], factor * sets[0]["abscissa_min"]
    else:
        columns.insert(0, Column(name="time", unit=label_of(sets[0], "abscissa_axis_units_lab"), header="time"))
        ordinates.insert(0, np.asarray(sets[0]["x"], dtype=np.float64))
    left_out = [
        LeftOut(name=f"data set {number + 1}", reason=f"it is a {_kind(head)}, not a time history")
        for number, head in heads.items()
        if number not in chosen
    ]
    return Table(
        path=path,
        format="universal file",
        columns=tuple(columns),
        values=np.column_stack(ordinates),
        dt=step,
        start_time=start_time,
        inputs=tuple(compress(names, drives)) if any(drives) and not several else None,
        outputs=tuple(compress(names, np.logical_not(drives))) if any(drives) and not several else None,
        left_out=tuple(left_out),
        doubts=tuple(
            f"{name} is stated as a force but in {label_of(each, 'ordinate_axis_units_lab')}, which is no unit of a "
            "force, so it was not taken as an input"
            for name, each in compress(zip(names, sets, strict=True), no_forces)
        ),
        undecided=several,
    )


def _guarded(path: Path, read: Callable[[], Any]) -> Any:
    with foreign(path, "universal file"):
        return read()


@dataclass(frozen=True, slots=True)
class UniversalFile:
    """The data sets of an open universal file: the kind of each, and each as pyuff returns it."""

    path: Path
    file: Any
    kinds: tuple[int, ...]

    def read(self, number: int, *, header_only: bool = False) -> Set:
        """One data set by its number; raises where a measurement announces something else than it holds."""
        result: Set = _guarded(self.path, lambda: self.file.read_sets(number, header_only=header_only))
        if header_only or self.kinds[number] != Universal.MEASUREMENT:
            return result
        return _as_announced(result, f"data set {number + 1} of {self.path.name}")

    def sets(self, kind: int, *, header_only: bool = False) -> Iterator[tuple[int, Set]]:
        """Number and contents of every data set of a kind."""
        for number, each in enumerate(self.kinds):
            if each == kind:
                yield number, self.read(number, header_only=header_only)


def open_uff(path: Path) -> UniversalFile:
    """The data sets of a file that is whole.

    Raises:
        UnreadableFileError: cut off, too large, or no universal file.
    """
    pyuff = optional_package("pyuff", path)
    check_memory(path, 8.0 * path.stat().st_size)
    _check_end(path)
    file = _guarded(path, lambda: pyuff.UFF(str(path)))
    return UniversalFile(path, file, tuple(int(kind) for kind in _guarded(path, file.get_set_types)))


def _check_end(path: Path) -> None:
    """A whole file ends with the line that closes its last data set."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 256))
        end = file.read().rstrip(b" \t\r\n\0\x1a")
    if not end.endswith(b"    -1"):
        raise UnreadableFileError(
            f"{path.name} does not end with the line -1 that closes a data set: it is cut off or no universal file; "
            "copy or export it again."
        )


def _kind(head: Set) -> str:
    return FUNCTION_TYPES.get(head["func_type"], f"function of type {head['func_type']}")


def _is_time_history(head: Set) -> bool:
    """Type 1, or a function of unknown type over time, as some analysers write."""
    over_time = head["func_type"] == 0 and head["abscissa_spec_data_type"] == Universal.ABSCISSA_TIME
    return head["ord_data_type"] in Universal.REAL_ORDINATES and (
        head["func_type"] == Universal.TIME_RESPONSE or over_time
    )


def _what_it_holds(path: Path, kinds: Sequence[int], heads: Sequence[Set]) -> str:
    if heads:
        counts = Counter(_kind(head) for head in heads)
        held = ", ".join(f"{count} of the kind {kind}" for kind, count in counts.items())
        return (
            f"{path.name} holds no time history, but {held}; identification needs the measured inputs and outputs "
            "themselves, so export the time histories (function type 1)."
        )
    sets = ", ".join(map(str, sorted(set(kinds)))) or "none"
    return f"{path.name} holds no data set 58 (its sets: {sets}), so no measurement; export time histories as set 58."


def _as_announced(data_set: Set, name: str) -> Set:
    """The data set without what fills up its end: zeros in its last line of text, line ends behind binary values."""
    if "data" not in data_set:
        raise UnreadableFileError(
            f"{name} states ordinates of type {data_set['ord_data_type']}, and the format knows 2, 4, 5 and 6; export "
            "it again."
        )
    announced, held = int(data_set["num_pts"]), len(data_set["data"])
    numbers = [data_set["data"].real]
    if np.iscomplexobj(data_set["data"]):
        numbers.append(data_set["data"].imag)
    if data_set["abscissa_spacing"] == 0:
        numbers.insert(0, data_set["x"])
    is_double = data_set["ord_data_type"] in {4, 6}
    if data_set["binary"]:
        behind = np.column_stack([part[announced:] for part in numbers]).astype("f8" if is_double else "f4").tobytes()
        is_filling = not behind.strip()
    else:
        a_line = (4 if is_double else 6) // len(numbers)
        is_filling = held <= -(-announced // a_line) * a_line and not data_set["data"][announced:].any()
    if announced < 1 or held < announced or not is_filling:
        cause = "the file is cut off or damaged" if held < announced else "the number is wrong, or lines are doubled"
        raise UnreadableFileError(
            f"{name} announces {announced} samples but holds {held}: {cause}; copy or export it again."
        )
    if data_set["binary"]:
        _check_binary(data_set, name, announced * (8 if is_double else 4), len(numbers))
    start, step = data_set["abscissa_min"], data_set["abscissa_inc"]
    if data_set["abscissa_spacing"] == 1 and not np.isfinite([start, step]).all():
        raise UnreadableFileError(
            f"{name} states {start:g} as the start of its axis and {step:g} as its step, and both must be numbers; "
            "export it again."
        )
    return {**data_set, "x": data_set["x"][:announced], "data": data_set["data"][:announced]}


def _check_binary(data_set: Set, name: str, ordinate_bytes: int, n_numbers: int) -> None:
    """Raise unless the line that says how the binary values are stored agrees with what they are.

    pyuff writes the bytes of one real ordinate a sample, whatever else it stores.
    """
    order, form = data_set["byte_ordering"], data_set["fp_format"]
    if (order, form) not in {(1, 2), (2, 2)}:
        raise UnreadableFileError(
            f"{name} states byte order {order} and number format {form}; read are the orders 1 (little-endian) and 2 "
            "(big-endian) of the format 2 (IEEE 754), so export it so, or as text."
        )
    if data_set["n_bytes"] not in {ordinate_bytes * n_numbers, ordinate_bytes}:
        raise UnreadableFileError(
            f"{name} announces {data_set['n_bytes']} bytes, but its {data_set['num_pts']} samples are "
            f"{ordinate_bytes * n_numbers}: the file is damaged; copy or export it again."
        )


def _check_same_axis(sets: Sequence[Set], names: Sequence[str], path: Path) -> None:
    first = sets[0]
    for other, name in zip(sets[1:], names[1:], strict=True):
        keys = ("num_pts", "abscissa_spacing", "abscissa_inc", "abscissa_min")
        differing = [key for key in keys if other[key] != first[key]]
        same_times = first["abscissa_spacing"] == 1 or np.array_equal(first["x"], other["x"], equal_nan=True)
        if differing or not same_times:
            key = differing[0] if differing else "x"
            words = {"num_pts": "samples", "abscissa_inc": "s as time step", "abscissa_min": "s as start"}
            numbers = f": {first[key]} and {other[key]} {words[key]}" if key in words else ""
            raise UnreadableFileError(
                f"channels {names[0]!r} and {name!r} of {path.name} have different time axes{numbers}; one file is one "
                "record, so export them with the same length and rate."
            )


def _names(sets: Sequence[Set], drives: Sequence[bool]) -> list[str]:
    """The first way that tells all sets apart: node and direction, these and the quantity, entity, first line.

    A force is called one ("force 12X+"), so a sensor beside it has the same name in every file of a roving hammer where
    the first way tells all apart; files in which another does are refused beside these when records are made of them.
    """
    places = [place_of(each, "rsp") for each in sets]
    ways: list[list[str]] = [
        [f"force {at}" if at and drive else at for at, drive in zip(places, drives, strict=True)],
        [(at := place_of(each, "rsp")) and f"{at} {label_of(each, 'ordinate_axis_lab')}".strip() for each in sets],
        [text_of(each["rsp_ent_name"]) for each in sets],
        [text_of(each["id1"]) for each in sets],
    ]
    for names in ways:
        if all(names) and len(set(names)) == len(names):
            return names
    return [f"{place_of(each, 'rsp') or 'channel'}_{number}" for number, each in enumerate(sets)]


def _measured_otherwise(data_set: Set) -> bool:
    """Whether the unit is that of another quantity which sensors of a modal test measure, as that of motion."""
    unit = convert_unit("", label_of(data_set, "ordinate_axis_units_lab")).unit
    return unit != "N" and unit in DATA_TYPES


def _several_hits(sets: Sequence[Set], drives: Sequence[bool]) -> str:
    """Why the forces are no inputs of one record: what was measured at a place is there again; "" where nothing is.

    Without nodes only a force tells: sensors that nobody named are not told apart either.
    """
    places = [_measured_at(each) for each in sets]
    sources = [
        at or text_of(each["rsp_ent_name"]) or text_of(each["id1"]) for at, each in zip(places, sets, strict=True)
    ]
    counts = Counter((source, drive) for at, source, drive in zip(places, sources, drives, strict=True) if at or drive)
    again = [(source or "a force", count) for (source, _), count in counts.items() if count > 1]
    if not any(drives) or not again:
        return ""
    what, count = again[0]
    return (
        f"it holds {what} {count} times, so it seems to hold several hits, and no force was taken as an input; write "
        "one file for each hit, or name the inputs"
    )


def _measured_at(data_set: Set) -> str:
    """Quantity and place of a measurement, "acceleration at 12X+"; "" where it has no node."""
    at, kind = place_of(data_set, "rsp"), int(data_set["ordinate_spec_data_type"])
    quantity = QUANTITIES.get(kind) or label_of(data_set, "ordinate_axis_lab") or f"data of type {kind}"
    return f"{quantity} at {at}" if at else ""


def place_of(data_set: Set, side: str) -> str:
    """Node and direction of the response ("rsp") or the reference ("ref"), e.g. "12X+"; "" where there is no node."""
    node, direction = int(data_set[f"{side}_node"]), int(data_set[f"{side}_dir"])
    if node <= 0 or not 0 <= abs(direction) < len(DIRECTIONS):
        return ""
    sign = "" if direction == 0 else "+" if direction > 0 else "-"
    return f"{node}{DIRECTIONS[abs(direction)]}{sign}"


def text_of(value: object) -> str:
    """A text of a file without what cannot be printed; "" for NONE."""
    text = "".join(letter if letter.isprintable() else " " for letter in str(value)).strip()
    return "" if text.upper() == "NONE" else text


def label_of(data_set: Set, key: str) -> str:
    """A label of a data set, "" where it has none."""
    return text_of(data_set.get(key, ""))


def unit_of(data_set: Set, axis: str, *, is_si: bool) -> str:
    """The axis label; without one the unit of the quantity, if the file says that its numbers are in SI."""
    label = label_of(data_set, f"{axis}_axis_units_lab")
    return label or (SI_OF_DATA_TYPE.get(int(data_set[f"{axis}_spec_data_type"]), "") if is_si else "")


def states_si(units: Set) -> bool:
    """Whether a data set 164 states SI units."""
    return all(units.get(key) == 1.0 for key in ("length", "force"))


def write_response(response: FrequencyResponse, path: str | Path, *, existing: Existing = "refuse") -> Path:
    """Write responses, and their coherence, as a universal file with one data set 58 a function (text, 12 digits).

    Args:
        response: known at every line.
        path: of the file; the usual ending is .uff.
        existing: "refuse" (an error when the file is there) or "replace".

    Returns:
        The path; `read_response` gives the same table, its frequencies to six digits, as the format has it.

    Raises:
        InvalidDataError: a response that is not known at every line, or a file that exists or cannot be written.
    """
    path = Path(path)
    measured = np.isfinite(response.response).all(axis=0)
    if (np.isfinite(response.response).any(axis=0) & ~measured).any():
        raise InvalidDataError("a universal file has no mark for a missing line; leave out the lines that hold a NaN.")
    sets = []
    for i, o in np.argwhere(measured.T).tolist():
        sets.append(_set_58(response, o, i, response.response[:, o, i], RESPONSE))
        if response.coherence is not None and response.coherence.ndim == 3:
            sets.append(_set_58(response, o, i, response.coherence[:, o, i], COHERENCE))
    if response.coherence is not None and response.coherence.ndim == 2:
        sets += [
            _set_58(response, o, 0, response.coherence[:, o], MULTIPLE_COHERENCE) for o in range(response.n_outputs)
        ]
    with new_file(path, existing) as part:
        part.write_text("".join(sets), encoding="ascii", errors="replace")
    return path


def _set_58(response: FrequencyResponse, output: int, input_: int, values: ComplexArray | FloatArray, kind: int) -> str:
    is_complex, f = kind == RESPONSE, response.frequencies
    try:
        spacing = line_spacing(response)
    except InvalidDataError:
        spacing = 0.0
    names = response.output_names[output], response.input_names[input_]
    units = response.output_units[output], response.input_units[input_]
    constant = "" if response.window_time_constant is None else f" of {response.window_time_constant:.9g} s"
    shared = "" if response.overlap is None else f"; overlap {min(response.overlap, 0.999999):.6f}"
    note = f"averages {response.n_averages or 0}; window {response.window}{constant}{shared}"
    nodes = "".join(f" {'NONE':10s}{node:10d}{direction:4d}" for node, direction in map(_node, names))
    even = spacing > 0
    points = f"{(6 if is_complex else 4):10d}{f.size:10d}{int(even):10d}"
    points += "".join(f"{value:13.5E}" for value in ((f[0], spacing, 0.0) if even else (0.0, 0.0, 0.0)))
    coherence = kind != RESPONSE
    lines = [
        _line(f"{names[0]} / {names[1]}"),
        *(_line(text) for text in (response.name, "", "", note)),
        f"{kind:5d}{0:10d}{0:5d}{0:10d}{nodes}",
        points,
        _quantity(18, "Frequency", "Hz"),
        _quantity(1 if coherence else DATA_TYPES.get(units[0], 0), "", "" if coherence else units[0]),
        _quantity(0 if coherence else DATA_TYPES.get(units[1], 0), "", "" if coherence else units[1]),
        _quantity(0, "", ""),
    ]
    numbers = np.column_stack([values.real, values.imag] if is_complex else [values])
    if even:
        flat = numbers.ravel().tolist()
        lines += ["".join(f"{value:20.12E}" for value in flat[at : at + 4]) for at in range(0, len(flat), 4)]
    else:
        lines += [
            f"{frequency:13.5E}" + "".join(f"{value:20.12E}" for value in row)
            for frequency, row in zip(f.tolist(), numbers.tolist(), strict=True)
        ]
    return "\n".join(["    -1", f"{58:6d}", *lines, "    -1"]) + "\n"


def _node(name: str) -> tuple[int, int]:
    match = _NODE.fullmatch(name.removeprefix("input "))
    if not match:
        return 0, 0
    return int(match[1]), DIRECTIONS.index(match[2]) * (1 if match[3] == "+" else -1)


def _quantity(kind: int, label: str, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {(label or 'NONE')[:20]:20s} {(unit or 'NONE')[:20]:20s}"


def _line(words: str) -> str:
    return "".join(letter if " " <= letter <= "~" else "?" for letter in words)[:80].rstrip() or "NONE"
